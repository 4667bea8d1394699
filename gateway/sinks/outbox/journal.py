"""Where an event stands from the moment it happens until the disk has it. IO, but to memory alone.

The store on disk is written by a thread a few milliseconds later. A gateway that is killed in between would lose what
the thread had not yet written; the slots of this file lie in shared memory, outlive the process, and are taken over by
the next start. A put costs microseconds and never waits, so it may stand in the control path. A power cut clears it:
then the few milliseconds are lost.
"""

import fcntl
import mmap
import os
import struct
import zlib
from pathlib import Path
from types import TracebackType
from typing import Self

from gateway.errors import ConfigError
from gateway.shared_state import folder
from gateway.sinks.outbox.outbox import Entry

SLOT_BYTES = 4096  # an event is 1 to 2 kB; a longer one is not journaled, and counted
SLOTS = 1024  # several seconds of the worst flood while the disk is busy
_HEAD = struct.Struct("<IIQqHHHxx")  # crc of the rest, length of the rest, order, unix_ms, id, topic, precious


class Journal:
    """A context manager that owns the file of one gateway. Raises ConfigError where another gateway has it."""

    def __init__(self, name: str, *, slots: int = SLOTS) -> None:
        self._path = folder() / f"loading-gateway-events.{name}"
        self._slots = slots
        self._order = 0
        self._held: dict[str, int] = {}  # id -> slot
        self._free = list(range(slots))
        self.overflowed = 0  # entries that found no room

    def __enter__(self) -> Self:
        while not self._locked():
            pass
        return self

    def _locked(self) -> bool:
        """False: the file was removed, by the gateway that had it, just before it was locked here."""
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW
        try:
            self._fd = os.open(self._path, flags, 0o600)
        except OSError as error:
            raise ConfigError(f"{self._path}: cannot be opened for the events: {error.strerror}") from error
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not _is_at(self._fd, self._path):
                os.close(self._fd)
                return False
            if os.fstat(self._fd).st_uid != os.geteuid():
                raise ConfigError(f"{self._path} belongs to another user")
            os.posix_fallocate(self._fd, 0, self._slots * SLOT_BYTES)  # full memory fails here, not at a put
            self._map = mmap.mmap(self._fd, self._slots * SLOT_BYTES)
        except BlockingIOError:
            os.close(self._fd)
            raise ConfigError(f"{self._path} is in use by another gateway") from None
        except OSError as error:
            os.close(self._fd)
            raise ConfigError(f"{self._path}: cannot be used for the events: {error.strerror}") from error
        except ConfigError:
            os.close(self._fd)
            raise
        return True

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._held:  # what the disk does not have yet must still be there at the next start
            self._path.unlink(missing_ok=True)
        self._map.close()
        os.close(self._fd)

    def recover(self) -> list[Entry]:
        """What an earlier gateway left, oldest first; it stays in the journal until it is released.

        A slot that was being written when the gateway died fails its checksum: that event had not happened yet.
        """
        found: list[tuple[int, Entry, int]] = []
        for slot in range(self._slots):
            entry = self._read(slot)
            if entry is not None:
                found.append((entry[0], entry[1], slot))
        found.sort(key=lambda item: item[0])
        self._held = {entry.id: slot for _, entry, slot in found}
        taken = set(self._held.values())
        self._free = [slot for slot in range(self._slots) if slot not in taken]
        self._order = found[-1][0] if found else 0
        return [entry for _, entry, _ in found]

    def put(self, entry: Entry) -> None:
        """Never waits, never raises; without room the entry is only counted."""
        name, topic = entry.id.encode(), entry.topic.encode()
        rest = name + topic + entry.payload
        if not self._free or _HEAD.size + len(rest) > SLOT_BYTES:
            self.overflowed += 1
            return
        self._order += 1
        slot = self._free.pop()
        head = _HEAD.pack(0, len(rest), self._order, entry.unix_ms, len(name), len(topic), entry.precious)
        body = head[4:] + rest
        at = slot * SLOT_BYTES
        self._map[at + 4 : at + 4 + len(body)] = body
        self._map[at : at + 4] = zlib.crc32(body).to_bytes(4, "little")  # last: now it has happened
        self._held[entry.id] = slot

    def release(self, entry_id: str) -> None:
        """The disk has it, or nobody needs it any more."""
        slot = self._held.pop(entry_id, None)
        if slot is not None:
            at = slot * SLOT_BYTES
            self._map[at : at + 8] = bytes(8)
            self._free.append(slot)

    def __len__(self) -> int:
        return len(self._held)

    def _read(self, slot: int) -> tuple[int, Entry] | None:
        at = slot * SLOT_BYTES
        crc, size, order, unix_ms, name, topic, precious = _HEAD.unpack(self._map[at : at + _HEAD.size])
        if not 0 < size <= SLOT_BYTES - _HEAD.size or name + topic > size:
            return None
        body = self._map[at + 4 : at + _HEAD.size + size]
        if zlib.crc32(body) != crc:
            return None
        rest = body[_HEAD.size - 4 :]
        try:
            entry = Entry(
                rest[:name].decode(),
                rest[name : name + topic].decode(),
                rest[name + topic :],
                bool(precious),
                unix_ms,
            )
        except UnicodeDecodeError:
            return None
        return order, entry


def _is_at(fd: int, path: Path) -> bool:
    """Is the open file the one that stands at `path`?"""
    try:
        return os.path.samestat(os.fstat(fd), os.stat(path, follow_symlinks=False))
    except FileNotFoundError:
        return False
