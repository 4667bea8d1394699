"""Which files of a bay's recording are to be deleted. Pure: (files, limits, time, free space) -> files.

The oldest first, by number: a clock that jumps changes no order. What somebody has pinned goes last, and only for size
and free space, never for its age. The newest file and the segment
that is being written stay.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from gateway.records.names import PICTURES, FileName

DAY_S = 86_400


@dataclass(frozen=True, slots=True)
class StoredFile:
    name: FileName
    size_bytes: int
    pinned: bool = False


@dataclass(frozen=True, slots=True)
class Limits:
    """`max_bytes`: of the bay. `max_days`, `picture_days`: 0: no limit of age."""

    max_bytes: int
    max_days: float
    picture_days: float


def surplus(
    files: Sequence[StoredFile],
    limits: Limits,
    unix_s: float | None,
    missing_bytes: int = 0,
    being_written: int | None = None,
) -> list[StoredFile]:
    """What is to be deleted, in that order. `unix_s`: now, None where the clock is not to be believed.

    `missing_bytes`: what the disk lacks of the free space that must be left. `being_written`: number of a file.
    """
    if not files:
        return []
    kept = {max(file.name.number for file in files), being_written}
    closed = sorted(
        (f for f in files if f.name.number not in kept), key=lambda f: (f.pinned, f.name.number, f.name.kind)
    )
    over_bytes = max(sum(file.size_bytes for file in files) - limits.max_bytes, missing_bytes)
    deleted = []
    for file in closed:
        too_much = over_bytes > 0
        if too_much or (not file.pinned and _too_old(file, limits, unix_s)):
            deleted.append(file)
            over_bytes -= file.size_bytes
    return deleted


def _too_old(file: StoredFile, limits: Limits, unix_s: float | None) -> bool:
    days = [limits.max_days, limits.picture_days] if file.name.kind == PICTURES else [limits.max_days]
    least = min((d for d in days if d), default=0)
    return unix_s is not None and least > 0 and unix_s - file.name.unix_s > least * DAY_S
