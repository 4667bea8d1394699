"""Is a bay's recording complete? Each segment's head names the segment before it, with its size and hash. IO.

What is between two segments that are there is proven; what was before the first or behind the last is not, nor who has
written it.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from gateway.records import recording
from gateway.records.recording import MissingItem
from gateway.records.segment import SegmentBefore
from gateway.records.store import digest


@dataclass(frozen=True, slots=True)
class Verified:
    """`faults`: what is missing, damaged, cut or changed, in words. `proven`: segments that are what the next one
    names; the newest is never among them. `unchained`: segments that do not name the one before them, of an earlier
    version."""

    faults: tuple[str, ...]
    proven: int
    unchained: int

    @property
    def lines(self) -> list[str]:
        """For people."""
        faults = len(self.faults)
        proven = f"{self.proven} are proven by the segment behind them, {faults} fault{'' if faults == 1 else 's'}"
        unchained = f"{self.unchained} name no segment before them: an earlier version wrote them"
        return [*self.faults, proven, *([unchained] if self.unchained else [])]


def verified(paths: Sequence[Path], advance: Callable[[], None] = lambda: None) -> Verified:
    """All segments of a bay, read and compared. Raises OSError."""

    faults: list[str] = []
    proven = unchained = 0

    def each() -> Iterator[Path]:
        """Each is compared as soon as it was read: minutes later the limits may have deleted it."""
        nonlocal proven, unchained
        newest: dict[str, Path] = {}  # of each recording, as folders may have been merged
        for path in paths:
            head = recording.head_in(path)
            if head is None:  # damaged, which is a fault already
                newest = dict.fromkeys(newest, path)
            else:
                if newest and head.recording not in newest:
                    faults.append(f"{path.name}: of another recording: {head.recording}, not {', '.join(newest)}")
                before, newest[head.recording] = newest.get(head.recording), path
                known = head.before
                if before is not None and known is None:
                    unchained += 1
                elif before is not None and known is not None and known.name == before.name:
                    why = _changed(before, known)
                    faults.extend([f"{before.name}: {why}, says {path.name}"] if why else [])
                    proven += not why
            yield path
            advance()

    for item in recording.records(each()):
        if isinstance(item, MissingItem):
            faults.append(item.why)
    return Verified(tuple(faults), proven, unchained)


def _changed(path: Path, known: SegmentBefore) -> str:
    if not known.sha256:
        return "not proven: it could not be read when the next one was begun"
    size_bytes = path.stat().st_size
    if size_bytes < known.size_bytes:
        return f"cut at its end: {size_bytes} of {known.size_bytes} bytes are there"
    return "" if digest(path) == known.sha256 else "not the bytes that were written"
