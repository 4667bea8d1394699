"""One bay's folder of segments: append, begin a new one, delete what is over the limits. IO; may raise OSError.

Each block is one `write` to the end of the file; `sync` brings what was written to the disk. A segment whose write has
failed is given up: the next block begins another one, so that damage stays where it was.
"""

import contextlib
import errno
import fcntl
import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from gateway.durations import NS_PER_S
from gateway.files import sync_folder, write_all
from gateway.records import incident, kept_pictures, retention, row_files
from gateway.records.files import files_in
from gateway.records.names import PICTURES, PIN, SEGMENT, FileName
from gateway.records.retention import RetentionLimits, StoredFile
from gateway.records.segment import Head, SegmentBefore, head_block

SEGMENT_NS = 900 * NS_PER_S


@dataclass(slots=True)
class Store:
    """`head` makes the head of a new segment with this number."""

    folder: Path
    limits: RetentionLimits
    min_free_share: float
    head: Callable[[int], Head]
    _fd: int | None = None
    _begun_ns: int = 0
    _number: int | None = None  # the newest
    _open_number: int | None = None
    _dirty: bool = False
    _matter: dict[int, bool] = field(default_factory=dict)  # by number: pictures of more than a routine stop

    def append(self, data: bytes, t_ns: int, *, begins: bool) -> None:
        """One block to the segment that is open. `begins`: it is the right place for a new segment to begin."""
        if self._fd is None or (begins and t_ns - self._begun_ns >= SEGMENT_NS):
            self.sync()
            self.close()
            self._open(t_ns)
        assert self._fd is not None
        try:
            self._make_room(len(data))
            write_all(self._fd, data)
        except OSError:
            self.close()
            raise
        self._dirty = True

    def sync(self) -> None:
        if self._fd is None or not self._dirty:
            return
        try:
            os.fdatasync(self._fd)
        except OSError:  # what the kernel has dropped now is not written by a second try
            self.close()
            raise
        self._dirty = False

    def close(self) -> None:
        if self._fd is not None:
            fd, self._fd, self._open_number = self._fd, None, None
            os.close(fd)

    def pictures(self, blocks: list[bytes], *, matter: bool) -> Path:
        """A file of pictures, complete or not there at all. Those that do not `matter` take the place of none that
        do."""
        number = self._next_number(sum(map(len, blocks)), spare=not matter)
        self._matter[number] = matter
        head = self.head(number)
        path = self.folder / str(FileName(number, head.unix_ns // NS_PER_S, PICTURES))
        fresh = path.with_name(f"{path.name}.new")
        fresh.unlink(missing_ok=True)
        fd = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o640)
        try:
            for block in (head_block(head), *blocks):
                write_all(fd, block)
            os.fdatasync(fd)
        except OSError:
            with contextlib.suppress(OSError):
                fresh.unlink()
            raise
        finally:
            os.close(fd)
        fresh.replace(path)
        sync_folder(self.folder)
        return path

    def delete_surplus(self, unix_s: float | None, room: int = 0, *, spare: bool = False) -> list[StoredFile]:
        """Bring the folder within its limits, with `room` bytes more; what was deleted. `spare`: no picture that
        matters. A file that can't be deleted stops nothing."""
        if not self.folder.exists():
            return []
        deleted = []
        missing = max(0, self._missing_bytes() + room)
        files = self.files()
        for file in retention.surplus(files, self.limits, unix_s, missing, self._open_number, self._matters):
            if spare and file.name.kind == PICTURES and self._matters(file):
                continue
            path = self.folder / str(file.name)
            try:
                path.unlink(missing_ok=True)
                path.with_name(path.name + PIN).unlink(missing_ok=True)
            except OSError:
                continue
            deleted.append(file)
            self._matter.pop(file.name.number, None)
        return deleted

    def files(self) -> list[StoredFile]:
        """All files of the recording, by number."""
        return files_in(self.folder) if self.folder.exists() else []

    def _missing_bytes(self) -> int:
        """What the disk lacks of the free space that must be left; negative: so much may be written."""
        system = os.statvfs(self.folder)
        return int(self.min_free_share * system.f_blocks * system.f_frsize) - system.f_bavail * system.f_frsize

    def _matters(self, file: StoredFile) -> bool:
        """Of a file of pictures. One that cannot be read does not."""
        number = file.name.number
        if number not in self._matter:
            self._matter[number] = False
            with contextlib.suppress(OSError):
                first = next(kept_pictures.heads(self.folder / str(file.name)), None)
                self._matter[number] = first is not None and incident.matters(first.head.why)
        return self._matter[number]

    def _make_room(self, length: int, *, spare: bool = False) -> None:
        """Delete what `delete_surplus` does first. Raises OSError where `length` bytes more would still take what
        others on this disk need: events, bay files."""
        if self._missing_bytes() + length > 0:
            self.delete_surplus(None, length, spare=spare)
        if self._missing_bytes() + length > 0:
            raise OSError(errno.ENOSPC, f"less than {100 * self.min_free_share:g} % of the disk would be free")

    def _open(self, t_ns: int) -> None:
        number = self._next_number(0)
        head = msgspec.structs.replace(self.head(number), before=self._before())
        path = self.folder / str(FileName(number, head.unix_ns // NS_PER_S, SEGMENT))
        fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_NOFOLLOW, 0o640)
        try:
            with contextlib.suppress(OSError):  # a network's file system without locks
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)  # until the last write of this process has ended
            data = head_block(head)
            write_all(fd, data)
            sync_folder(self.folder)
        except OSError:
            os.close(fd)
            raise
        self._fd, self._begun_ns, self._dirty, self._open_number = fd, t_ns, True, number

    def _before(self) -> SegmentBefore:
        """The newest segment, so that the next one proves that it was there, and as what. Raises BlockingIOError while
        a recorder that was replaced may still write it."""
        newest = next((file for file in reversed(self.files()) if file.name.kind == SEGMENT), None)
        if newest is None:
            return SegmentBefore()
        path = self.folder / str(newest.name)
        try:
            with path.open("rb") as file:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            size_bytes, found = path.stat().st_size, digest(path)
        except BlockingIOError:
            raise BlockingIOError(errno.EAGAIN, f"the recorder before this one still writes {path.name}") from None
        except OSError:  # it cannot be proven; recording goes on
            size_bytes, found = newest.size_bytes, ""
        return SegmentBefore(path.name, size_bytes, found)

    def _next_number(self, length: int, *, spare: bool = False) -> int:
        """The number of a new file of about `length` bytes."""
        if self._number is None:
            self.folder.mkdir(parents=True, exist_ok=True, mode=0o750)
            for leftover in self.folder.glob("*.new"):
                leftover.unlink(missing_ok=True)
            numbers = [file.name.number for file in self.files()]
            self._number = max([*numbers, row_files.newest_segment(self.folder)])
        self._make_room(length, spare=spare)
        self._number += 1
        return self._number


def digest(path: Path) -> str:
    """SHA-256 of a file, hexadecimal. Raises OSError."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
