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


def verified(paths: Sequence[Path], advance: Callable[[], None] = lambda: None) -> Verified:
    """All segments of a bay, read and compared. Raises OSError."""

    faults: list[str] = []
    proven = unchained = 0

    def each() -> Iterator[Path]:
        """Each is compared as soon as it was read: minutes later the limits may have deleted it."""
        nonlocal proven, unchained
        before: Path | None = None
        for path in paths:
            if before is not None:
                known = before_of(path)
                if known is None:
                    unchained += 1
                elif known.name == before.name and (why := _changed(before, known)):
                    faults.append(f"{before.name}: {why}, by {path.name}")
                elif known.name == before.name:
                    proven += 1
            yield path
            before = path
            advance()

    for item in recording.records(each()):
        if isinstance(item, MissingItem):
            faults.append(item.why)
    return Verified(tuple(faults), proven, unchained)


def before_of(path: Path) -> SegmentBefore | None:
    """What a segment says of the one before it; None: nothing. Raises OSError."""
    head = recording.head_in(path)
    return None if head is None else head.before


def _changed(path: Path, known: SegmentBefore) -> str:
    if not known.sha256:
        return "not proven: it could not be read when the next one was begun"
    size_bytes = path.stat().st_size
    if size_bytes < known.size_bytes:
        return f"cut at its end: {size_bytes} of {known.size_bytes} bytes are there"
    return "" if digest(path) == known.sha256 else "not the bytes that were written"
