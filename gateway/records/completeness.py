"""Is a bay's recording complete? Each segment's head names the segment before it, with its size and hash. IO.

What is between two segments that are there is proven; what was before the first or behind the last is not, nor who has
written it.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
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

    def each() -> Iterator[Path]:
        for path in paths:
            yield path
            advance()

    faults = [item.why for item in recording.records(each()) if isinstance(item, MissingItem)]
    proven = unchained = 0
    for before, path in pairwise(paths):
        known = before_of(path)
        if known is None:
            unchained += 1
        elif known.name == before.name:
            if why := _changed(before, known):
                faults.append(f"{before.name}: {why}, by {path.name}")
            else:
                proven += 1
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
