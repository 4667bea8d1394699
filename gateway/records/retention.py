"""Which files of a bay's recording are to be deleted. Pure: (files, limits, time, free space) -> files.

The oldest first, by number: a clock that jumps changes no order. Pictures of routine stops go before those that
matter. What somebody has pinned goes last, and only for size and free space, never for its age. The newest file, the
newest segment, which the next one names, and the segment that is being written stay. Files of rows have limits of their
own: they stay when the segments are gone.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from gateway.records.names import PICTURES, ROWS, SEGMENT, FileName

DAY_S = 86_400
ROWS_SHARE = 0.1  # of max_bytes


@dataclass(frozen=True, slots=True)
class StoredFile:
    name: FileName
    size_bytes: int
    pinned: bool = False


Matters = Callable[[StoredFile], bool]


@dataclass(frozen=True, slots=True)
class RetentionLimits:
    """`max_bytes`: of the bay. `max_days`, `picture_days`, `visit_days`: 0: no limit of age."""

    max_bytes: int
    max_days: float
    picture_days: float
    visit_days: float = 0


def surplus(
    files: Sequence[StoredFile],
    limits: RetentionLimits,
    unix_s: float | None,
    missing_bytes: int = 0,
    being_written: int | None = None,
    matters: Matters = lambda _: False,
) -> list[StoredFile]:
    """What is to be deleted, in that order. `unix_s`: now, None where the clock is not to be believed.

    `missing_bytes`: what the disk lacks of the free space that must be left. `being_written`: number of a file.
    `matters`: is this file of pictures of more than a routine stop? Asked of as few as possible.
    """
    rows = [file for file in files if file.name.kind == ROWS]
    deleted = _surplus_rows(rows, limits, unix_s)
    rows_bytes = sum(file.size_bytes for file in rows) - sum(file.size_bytes for file in deleted)
    files = [file for file in files if file.name.kind != ROWS]
    if not files:
        return deleted
    segments = [file.name.number for file in files if file.name.kind == SEGMENT]
    kept = {max(file.name.number for file in files), max(segments, default=None), being_written}
    closed = sorted(
        (f for f in files if f.name.number not in kept), key=lambda f: (f.pinned, f.name.number, f.name.kind)
    )
    over_bytes = max(sum(file.size_bytes for file in files) + rows_bytes - limits.max_bytes, missing_bytes)
    gone: list[StoredFile] = []
    rest: list[StoredFile] = []
    for file in closed:
        (gone if not file.pinned and _too_old(file, limits, unix_s) else rest).append(file)
    over_bytes -= sum(file.size_bytes for file in gone)
    for file in _least_first(rest, matters):
        if over_bytes <= 0:
            break
        gone.append(file)
        over_bytes -= file.size_bytes
    return deleted + gone


def _least_first(files: Sequence[StoredFile], matters: Matters) -> Iterator[StoredFile]:
    """In order, but where it is the turn of pictures, the oldest go that do not matter, as long as there are any."""
    pictures = [file for file in files if file.name.kind == PICTURES and not file.pinned]
    of_routine = (file for file in pictures if not matters(file))
    gone: set[FileName] = set()
    oldest = (file for file in pictures if file.name not in gone)
    for file in files:
        if file.name.kind != PICTURES or file.pinned:
            yield file
            continue
        least = next(of_routine, None) or next(oldest)
        gone.add(least.name)
        yield least


def _surplus_rows(files: Sequence[StoredFile], limits: RetentionLimits, unix_s: float | None) -> list[StoredFile]:
    """A file is older than its newest row, and that older than the begin of the next file, whatever the clock did."""
    over_bytes = sum(file.size_bytes for file in files) - ROWS_SHARE * limits.max_bytes
    deleted = []
    for file, after in pairwise(sorted(files, key=lambda file: file.name.number)):
        ended_s = max(file.name.unix_s, after.name.unix_s)
        old = unix_s is not None and limits.visit_days > 0 and unix_s - ended_s > limits.visit_days * DAY_S
        if over_bytes > 0 or old:
            deleted.append(file)
            over_bytes -= file.size_bytes
    return deleted


def _too_old(file: StoredFile, limits: RetentionLimits, unix_s: float | None) -> bool:
    days = [limits.max_days, limits.picture_days] if file.name.kind == PICTURES else [limits.max_days]
    least = min((d for d in days if d), default=0)
    return unix_s is not None and least > 0 and unix_s - file.name.unix_s > least * DAY_S
