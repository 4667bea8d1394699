"""What one process of the simulator tells another: a file with the newest records, each in a slot of its own.

It never grows, and needs no lock: a record is written at once.
"""

import os
import struct
from pathlib import Path
from typing import Any


class RingFile:
    """The writer's end, made with the first record."""

    def __init__(self, path: str, record: struct.Struct, slots: int) -> None:
        self._path, self._record, self._slots = path, record, slots
        self._file: int | None = None
        self._count = 0

    def put(self, *values: float) -> None:
        """The first of the values ascends."""
        if self._file is None:
            self._file = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        os.pwrite(self._file, self._record.pack(*values), self._count % self._slots * self._record.size)
        self._count += 1

    def close(self) -> None:
        if self._file is not None:
            os.close(self._file)
        self._file = None


def records(path: str, record: struct.Struct) -> list[tuple[Any, ...]]:
    """What the file has, sorted; nothing where nothing was written yet."""
    try:
        data = Path(path).read_bytes()
    except FileNotFoundError:
        return []
    return sorted(record.iter_unpack(data[: len(data) // record.size * record.size]))
