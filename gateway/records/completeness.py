"""Is a bay's recording complete? Each segment's head names the segment before it, with its size and hash. IO.

What is between two segments that are there is proven; what was before the first or behind the last is not, nor who has
written it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from gateway.records import recording
from gateway.records.recording import MissingItem
from gateway.records.segment import SegmentBefore


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
        proven = f"proven by the segment behind them: {self.proven}; faults: {len(self.faults)}"
        unchained = f"{self.unchained} name no segment before them: an earlier version wrote them"
        return [*self.faults, proven, *([unchained] if self.unchained else [])]


def verified(
    paths: Sequence[Path],
    advance: Callable[[], None] = lambda: None,
    read: Callable[[Path], bytes] = Path.read_bytes,
) -> Verified:
    """All segments of a bay, each read once and compared. Raises OSError."""

    faults: list[str] = []
    proven = unchained = 0
    newest: dict[str, SegmentBefore] = {}  # of each recording, as folders may have been merged: as it is there

    def compared(path: Path) -> bytes:
        nonlocal proven, unchained, newest
        data = read(path)
        there = SegmentBefore(path.name, len(data), sha256(data).hexdigest())
        head = recording.head_from(data)
        if head is None:  # damaged, which is a fault already
            newest = dict.fromkeys(newest, there)
        else:
            before, newest[head.recording] = newest.get(head.recording), there
            known = head.before
            if before is not None and known is None:
                unchained += 1
            elif before is not None and known is not None and known.name == before.name:
                why = _changed(before, known)
                faults.extend([f"{before.name}: {why}, says {path.name}"] if why else [])
                proven += not why
        advance()
        return data

    for item in recording.records(paths, compared):
        if isinstance(item, MissingItem):
            faults.append(item.why)
    return Verified(tuple(faults), proven, unchained)


def _changed(there: SegmentBefore, known: SegmentBefore) -> str:
    if not known.sha256:
        return "not proven: it could not be read when the next one was begun"
    if there.size_bytes < known.size_bytes:
        return f"cut at its end: {there.size_bytes} of {known.size_bytes} bytes are there"
    return "" if there.sha256 == known.sha256 else "not the bytes that were written"
