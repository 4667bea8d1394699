"""An outbox that survives the gateway: memory for the order, a journal for the moment, a file for the rest. IO.

    put ──► memory (what is delivered, and the drop rule)
        └─► journal (SQLite in shared memory: survives SIGKILL) ──► file (SQLite, a thread: survives a power cut)

A put takes some 30 microseconds and never waits for the disk, and the disk has no influence on what is delivered:
memory holds the events while the gateway runs. When the file can't be written (full, read-only, locked, corrupt) the
thread reports it, keeps trying, and makes the file equal to memory as soon as it can; what is on a disk that can only
be read is read all the same, before anything is delivered. What the broker acknowledges within a quarter of a second
never goes to the file (`pace`).
docs/decisions/0023-event-journal-is-sqlite.md has the reason for the journal.
"""

import contextlib
import logging
import os
import shutil
import stat
import threading
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

from gateway.clock import machine_ns
from gateway.durations import NS_PER_S
from gateway.errors import ConfigError
from gateway.shared_state import folder
from gateway.sinks.contract import StoreStatus
from gateway.sinks.outbox.outbox import MemoryOutbox, Outbox, OutboxEntry, OutboxLimits, in_order
from gateway.sinks.outbox.pace import AT_ONCE, WritePace
from gateway.sinks.outbox.store import EventFile, StoreError, entries_in, put_aside
from gateway.systemd import default_folder

log = logging.getLogger(__name__)

FIRST_RETRY_S, LAST_RETRY_S = 0.25, 30.0
SHRINK_RETRY_S = 3600.0
CLOSE_S = 1.0  # for the disk to take what is left at the end; the journal keeps the rest
RELEASED_AT_ONCE = 20  # from the journal: there may be many, and a put must not wait for all
JOURNAL_EVENTS = 1024  # twice what may wait for the disk by pace.AT_ONCE


class OutboxSettings(Protocol):
    """The keys of a section whose sink has an outbox."""

    @property
    def outbox_events(self) -> int: ...

    @property
    def outbox_mb(self) -> int: ...

    @property
    def outbox_days(self) -> float: ...


def limits(settings: OutboxSettings) -> OutboxLimits:
    """What may wait in the outbox."""
    return OutboxLimits(
        settings.outbox_events, settings.outbox_mb * 1_000_000, round(settings.outbox_days * 86_400_000)
    )


@contextlib.contextmanager
def opened_outbox(limits: OutboxLimits, file: str, journal: str, auto: str) -> Iterator[Outbox]:
    """The outbox of one sink of one gateway. `file`: as `outbox_file` of the configuration has it; `auto`: its name,
    where that is `auto`; `journal`: that of the journal on this machine. Raises ConfigError where another gateway of
    this name runs."""
    if not file:
        yield MemoryOutbox(limits)
        return
    with DurableOutbox(journal, default_folder() / auto if file == "auto" else Path(file), limits) as outbox:
        yield outbox


class OutboxJournal:
    """The events that the file on disk does not have yet, in shared memory. A context manager; nothing in it waits.

    Entering raises ConfigError where another gateway of this name runs. What it has no room for is left out, changes of
    stop last, and counted in the journal itself until it is released: a kill would lose it.
    """

    def __init__(self, name: str, *, events: int = JOURNAL_EVENTS) -> None:
        self._path = folder() / f"loading-gateway-journal.{name}" / "events.sqlite"
        self._held = MemoryOutbox(OutboxLimits(events))
        self._left_out: set[str] = set()  # ids
        self._noted = 0  # how many, in the file
        self.lost = 0  # by an earlier gateway: left out, and neither delivered nor on disk when it ended

    def __enter__(self) -> Self:
        # Any user may write into the parent folder; in this one only the gateway has access to SQLite's files.
        private = self._path.parent
        with contextlib.suppress(OSError):
            private.mkdir(mode=0o700)
        found = private.lstat()
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.geteuid() or found.st_mode & 0o077:
            raise ConfigError(f"{private} belongs to another user, or is open to others")
        try:
            self._file = EventFile(self._path, synced=False)
        except StoreError as error:
            if error.locked:
                raise ConfigError(f"{self._path} is in use by another gateway") from error
            if not error.corrupt:
                raise ConfigError(f"cannot be used for the events: {error}") from error
            self._begin_anew()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if len(self):  # what the disk does not have yet must still be there at the next start
            self._file.close()
        else:
            self._file.remove()
            with contextlib.suppress(OSError):  # another gateway of this name may begin just now
                self._path.parent.rmdir()

    def recover(self) -> list[OutboxEntry]:
        """What an earlier gateway left, oldest first; it stays in the journal until it is released."""
        try:
            found = self._file.entries()
            self.lost = self._noted = self._file.left_out
        except StoreError:  # not written by a gateway
            self._file.close()
            self._begin_anew()
            found = []
        for entry in found:
            self._held.put(entry)
        return found

    def put(self, entry: OutboxEntry) -> None:
        """Never waits, never raises."""
        gone = {lost.id for lost in self._held.put(entry)}
        self._left_out |= gone
        try:
            self._write([entry] if entry.id not in gone else [], gone, len(self._left_out))
        except StoreError:
            self._held.acknowledge(entry.id)
            self._left_out.add(entry.id)

    def release(self, ids: Iterable[str]) -> None:
        """They are on disk, or not needed any more."""
        if gone := [one for one in ids if one in self._left_out or one in self._held]:
            with contextlib.suppress(StoreError):
                self._write((), gone, len(self._left_out) - sum(one in self._left_out for one in gone))
                self._left_out.difference_update(gone)
                for one in gone:
                    self._held.acknowledge(one)

    def copy_of(self, path: Path) -> list[OutboxEntry]:
        """What is in a file that can't even be read where it is: SQLite's `-shm` is gone, and there is no room for a
        new one. Raises StoreError."""
        copy = self._path.with_name("copy.sqlite")
        try:
            EventFile.delete(copy)
            shutil.copyfile(path, copy, follow_symlinks=False)
            with contextlib.suppress(FileNotFoundError):  # there is one only after a kill
                shutil.copyfile(f"{path}-wal", f"{copy}-wal", follow_symlinks=False)
            with contextlib.closing(EventFile(copy, synced=False)) as file:
                return file.entries()
        except OSError as error:
            raise StoreError(f"{path}: {error.strerror or error}") from error
        finally:
            EventFile.delete(copy)

    def __len__(self) -> int:
        """Events that the disk does not have, those left out, too."""
        return len(self._held) + len(self._left_out)

    def _write(self, added: Collection[OutboxEntry], removed: Collection[str], left_out: int) -> None:
        self._file.write(added, removed, left_out=None if left_out == self._noted else left_out)
        self._noted = left_out

    def _begin_anew(self) -> None:
        put_aside(self._path).unlink()
        self._file = EventFile(self._path, synced=False)


class DurableOutbox:
    """A context manager around an `Outbox`. Entering may wait for the disk, nothing after it does.

    Entering raises ConfigError where another gateway of the same name runs. A file that can't be used is not an error:
    `store` reports it. `open_file` makes the tests' faults possible.
    """

    def __init__(
        self,
        name: str,
        path: Path,
        limits: OutboxLimits,
        *,
        open_file: Callable[[Path], EventFile] = EventFile,
    ) -> None:
        self._path = path
        self._open_file = open_file
        self._limits = limits
        self._memory = MemoryOutbox(limits)
        self._journal = OutboxJournal(name)
        self._changed = threading.Condition()  # guards everything below and the two above; held for microseconds
        self._added: dict[str, tuple[int, OutboxEntry]] = {}  # and since when (monotonic ns), the oldest first
        self._journaled: set[str] = set()  # ids the journal had at the start; the file may have them, too
        self._removed: dict[str, int] = {}  # since when
        self._in_flight = 0  # of `added`, on their way to the disk
        self._stale = False  # the file is not what `_added` and `_removed` start from: write all of it
        self._read = False  # what an earlier gateway left in the file has been taken over
        self._closing = False
        self._fault = ""
        self._faults = 0
        self._recovered = 0
        self._file: EventFile | None = None
        self._pace = WritePace()
        self._shrink_ns = 0  # not before; the thread's own
        self._thread = threading.Thread(target=self._run, name="outbox", daemon=True)  # a dead disk holds up no exit

    def __enter__(self) -> Self:
        self._journal.__enter__()
        journaled = self._journal.recover()
        self._recovered = len(journaled)
        self._added = {entry.id: (machine_ns(), entry) for entry in journaled}
        self._journaled = set(self._added)
        self._forget([lost for entry in journaled for lost in self._memory.put(entry)])
        try:
            self._open()
        except StoreError as error:
            self._failed(error)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(CLOSE_S)
        with self._changed:  # a thread that hangs in the disk keeps its file; the process ends, and the kernel with it
            self._journal.__exit__(kind, error, trace)

    @property
    def dropped(self) -> int:
        return self._memory.dropped + self._journal.lost

    @property
    def unused_dropped(self) -> int:
        return self._memory.unused_dropped

    @property
    def store(self) -> StoreStatus:
        unwritten = len(self._memory) if self._stale else len(self._added) + self._in_flight
        return StoreStatus(self._fault, self._faults, self._recovered, unwritten)

    def put(self, entry: OutboxEntry) -> None:
        with self._changed:
            self._journal.put(entry)
            self._to_write(entry)
            self._forget(self._memory.put(entry))
            self._changed.notify()

    def batch(self, limit: int, without: Collection[str] = ()) -> list[OutboxEntry]:
        with self._changed:
            return self._memory.batch(limit, without)

    def acknowledge(self, entry_id: str) -> None:
        with self._changed:
            if (entry := self._memory.acknowledge(entry_id)) is not None:
                self._forget([entry])
                self._changed.notify()

    def count(self, topics: Iterable[str]) -> int:
        with self._changed:
            return self._memory.count(topics)

    def set_unused(self, topic: str, unused: bool) -> None:
        with self._changed:
            self._memory.set_unused(topic, unused)

    def expire(self, topic: str, age_ms: int, now_ms: int, limit: int) -> list[OutboxEntry]:
        with self._changed:
            if gone := self._memory.expire(topic, age_ms, now_ms, limit):
                self._forget(gone)
                self._changed.notify()
            return gone

    def __len__(self) -> int:
        return len(self._memory)

    # Under the lock.

    def _to_write(self, entry: OutboxEntry) -> None:
        if not self._stale:
            self._added[entry.id] = machine_ns(), entry

    def _forget(self, entries: list[OutboxEntry]) -> None:
        self._journal.release(entry.id for entry in entries)
        for entry in entries:
            if not self._stale and self._added.pop(entry.id, None) is None:
                self._removed[entry.id] = machine_ns()

    # The thread.

    def _run(self) -> None:
        retry_s, first = FIRST_RETRY_S, True
        while True:
            with self._changed:
                if self._fault:
                    self._changed.wait_for(lambda: self._closing, retry_s)
                elif not first:
                    self._wait_for_changes()
                over, first = self._closing, False
            try:
                self._open()
                if self._write():
                    self._pace.wrote()
                if not over:
                    self._shrink()
            except StoreError as error:
                self._failed(error)
                retry_s = min(LAST_RETRY_S, 2 * retry_s)
            else:
                retry_s = FIRST_RETRY_S
                if self._fault:
                    log.warning("%s: events are kept on disk again", self._path)
                    self._fault = ""
            if over:
                self._close()
                return

    def _open(self) -> None:
        if self._file is not None:
            return
        try:
            self._file = self._open_file(self._path)
            if not self._read:
                self._take_over(self._file.entries())
        except StoreError as error:
            self._close()
            if not error.corrupt:
                self._read_only(error)
                raise
            log.error("%s: renamed to %s; a new file is begun", error, put_aside(self._path).name)
            self._file = self._open_file(self._path)
            self._read = self._stale = True

    def _read_only(self, error: StoreError) -> None:
        """A disk that takes nothing can be read all the same: what is on it is older than all that happens now."""
        if not (self._read or error.locked):
            with contextlib.suppress(StoreError):
                try:
                    found = entries_in(self._path)
                except StoreError:
                    found = self._journal.copy_of(self._path)
                self._take_over(found)

    def _take_over(self, found: list[OutboxEntry]) -> None:
        """Long work where much is found, so that the lock is held only for what was added meanwhile."""
        # What the journal had may have been delivered already, where the file could be opened only now.
        old = [entry for entry in found if entry.id not in self._journaled]
        memory = MemoryOutbox(self._limits)
        gone = [lost for entry in old for lost in memory.put(entry)]
        with self._changed:
            gone += memory.append(self._memory)
            self._memory = memory
            self._recovered += len(old)
            self._forget(gone)
            self._read = True

    def _wait_for_changes(self) -> None:
        """Under the lock: until there are some that must be written now."""
        while not (self._closing or self._stale or len(self._added) + len(self._removed) >= AT_ONCE):
            since = [next(iter(self._added.values()))[0]] if self._added else []
            since += [next(iter(self._removed.values()))] if self._removed else []
            wait_s = self._pace.wait_s(min(since), machine_ns()) if since else None
            if wait_s == 0:
                return
            self._changed.wait(wait_s)

    def _write(self) -> bool:
        """False: there was nothing to write any more."""
        file = self._file
        if file is None:
            return False
        with self._changed:
            stale = self._stale
            added = [entry for _, entry in self._added.values()]
            everything = self._memory.numbered() if stale else None
            removed = list(self._removed)
            self._added, self._removed, self._stale = {}, {}, False
            self._in_flight = len(self._memory) if stale else len(added)
        if everything is not None:
            added = list(in_order(everything))
        elif not (added or removed):
            return False
        file.write(added, removed, instead=stale)
        with self._changed:
            self._in_flight = 0
        for n in range(0, len(added), RELEASED_AT_ONCE):
            with self._changed:
                self._journal.release(entry.id for entry in added[n : n + RELEASED_AT_ONCE])
        return True

    def _shrink(self) -> None:
        """Puts do not wait for it. A disk without room for it is not a fault: nothing is lost by a large file."""
        if self._file is None or machine_ns() < self._shrink_ns:
            return
        try:
            self._file.shrink()
        except StoreError as error:
            if error.corrupt:
                raise
            log.warning("%s; it is tried again later", error)
            self._shrink_ns = machine_ns() + round(SHRINK_RETRY_S * NS_PER_S)

    def _failed(self, error: StoreError) -> None:
        with self._changed:
            self._added, self._removed, self._stale, self._in_flight = {}, {}, True, 0
            if str(error) != self._fault:
                self._faults += not self._fault
                self._fault = str(error)
                log.error("events can't be kept on disk, only in memory: %s", error)
        self._close()

    def _close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None
