"""An outbox that survives the gateway: memory for the order, a journal for the moment, a file for the rest. IO.

    put ──► memory (what is delivered, and the drop rule)
        └─► journal (shared memory: survives SIGKILL) ──► file (a thread: survives a power cut) ──► journal slot freed

Nobody waits for the disk, and what the disk does has no influence on what is delivered: memory holds the truth while
the gateway runs. When the file can't be written (full, read-only, locked, corrupt) the thread says so, keeps trying,
and makes the file what memory says as soon as it can.
"""

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from gateway.bay_file import default_folder
from gateway.config import MqttConfig
from gateway.sinks.outbox.journal import Journal
from gateway.sinks.outbox.outbox import Entry, Limits, MemoryOutbox, Outbox
from gateway.sinks.outbox.store import EventFile, StoreError, put_aside

log = logging.getLogger(__name__)

FIRST_RETRY_S, LAST_RETRY_S = 0.25, 30.0
CLOSE_S = 1.0  # at the end the disk gets so long for what is left; the journal keeps what it does not take


@dataclass(frozen=True, slots=True)
class Health:
    """What a technician must know of the file. `fault` is empty while it works."""

    fault: str = ""
    faults: int = 0  # times it began to fail
    recovered: int = 0  # events found that an earlier gateway had not delivered
    unwritten: int = 0  # events that only memory holds at the moment


def limits(config: MqttConfig) -> Limits:
    """What may wait in the outbox."""
    return Limits(config.outbox_events, config.outbox_mb * 1_000_000, round(config.outbox_days * 86_400_000))


def path_of(config: MqttConfig, site: str, instance: str) -> Path | None:
    """Where the configured outbox lies; None: in memory only."""
    if config.outbox_file != "auto":
        return Path(config.outbox_file) if config.outbox_file else None
    return default_folder() / f"outbox-{site}-{instance}.sqlite"


@contextlib.contextmanager
def outbox_of(config: MqttConfig, site: str, instance: str) -> Iterator[Outbox]:
    """The outbox of one gateway. Raises ConfigError where another gateway of this name runs."""
    path = path_of(config, site, instance)
    if path is None:
        yield MemoryOutbox(limits(config))
        return
    with DurableOutbox(instance, path, limits(config)) as outbox:
        yield outbox


class DurableOutbox:
    """A context manager around an `Outbox`. Entering may wait for the disk, nothing after it does.

    Entering raises ConfigError where another gateway of the same name runs. A file that can't be used is no error:
    `health` tells of it. `open_file` makes the tests' faults possible.
    """

    def __init__(
        self,
        name: str,
        path: Path,
        limits: Limits,
        *,
        open_file: Callable[[Path], EventFile] = EventFile,
    ) -> None:
        self._path = path
        self._open_file = open_file
        self._limits = limits
        self._memory = MemoryOutbox(limits)
        self._journal = Journal(name)
        self._changed = threading.Condition()  # guards everything below and the two above; held for microseconds
        self._added: dict[str, Entry] = {}
        self._journaled: set[str] = set()  # ids the journal had at the start; the file may have them, too
        self._removed: dict[str, None] = {}
        self._in_flight = 0  # of `added`, on their way to the disk
        self._stale = False  # the file is not what `_added` and `_removed` start from: write all of it
        self._read = False  # what an earlier gateway left in the file has been taken over
        self._over = False
        self._fault = ""
        self._faults = 0
        self._recovered = 0
        self._file: EventFile | None = None
        self._thread = threading.Thread(target=self._run, name="outbox", daemon=True)  # a dead disk holds up no exit

    def __enter__(self) -> Self:
        self._journal.__enter__()
        journaled = self._journal.recover()
        self._recovered = len(journaled)
        self._added = {entry.id: entry for entry in journaled}
        self._journaled = set(self._added)
        for gone in self._memory.prepend(journaled):
            self._forget(gone.id)
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
            self._over = True
            self._changed.notify()
        self._thread.join(CLOSE_S)
        with self._changed:  # a thread that hangs in the disk keeps its file; the process ends, and the kernel with it
            self._journal.__exit__(kind, error, trace)

    @property
    def dropped(self) -> int:
        return self._memory.dropped

    @property
    def health(self) -> Health:
        unwritten = len(self._memory) if self._stale else len(self._added) + self._in_flight
        return Health(self._fault, self._faults, self._recovered, unwritten)

    def put(self, entry: Entry) -> None:
        with self._changed:
            self._journal.put(entry)
            self._to_write(entry)
            for gone in self._memory.put(entry):
                self._forget(gone.id)
            self._changed.notify()

    def oldest(self) -> Entry | None:
        with self._changed:
            return self._memory.oldest()

    def acknowledge(self, entry_id: str) -> None:
        with self._changed:
            if self._memory.acknowledge(entry_id):
                self._forget(entry_id)
                self._changed.notify()

    def __len__(self) -> int:
        return len(self._memory)

    # Under the lock.

    def _to_write(self, entry: Entry) -> None:
        if not self._stale:
            self._added[entry.id] = entry

    def _forget(self, entry_id: str) -> None:
        self._journal.release(entry_id)
        if not self._stale and self._added.pop(entry_id, None) is None:
            self._removed[entry_id] = None

    # The thread.

    def _run(self) -> None:
        retry_s = FIRST_RETRY_S
        while True:
            with self._changed:
                if self._fault:
                    self._changed.wait_for(lambda: self._over, retry_s)
                else:
                    self._changed.wait_for(lambda: self._over or self._stale or self._added or self._removed)
                over = self._over
            try:
                self._open()
                self._write()
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
                raise
            log.error("%s: put aside as %s; a new file is begun", error, put_aside(self._path).name)
            self._file = self._open_file(self._path)
            self._read = self._stale = True

    def _take_over(self, found: list[Entry]) -> None:
        """Long work where much is found, so that the lock is held only for what came meanwhile."""
        # What the journal had may have been delivered already, where the file could be opened only now.
        old = [entry for entry in found if entry.id not in self._journaled]
        memory = MemoryOutbox(self._limits)
        gone = [lost for entry in old for lost in memory.put(entry)]
        with self._changed:
            gone += memory.append(self._memory)
            self._memory = memory
            self._recovered += len(old)
            for entry in gone:
                self._forget(entry.id)
            self._read = True

    def _write(self) -> None:
        file = self._file
        if file is None:
            return
        with self._changed:
            stale = self._stale
            added = list(self._added.values())
            everything = self._memory.copy() if stale else None
            removed = list(self._removed)
            self._added, self._removed, self._stale = {}, {}, False
            self._in_flight = len(everything or added)
        if everything is not None:
            added = everything.waiting()
        elif not (added or removed):
            return
        file.write(added, removed, instead=stale)
        with self._changed:
            self._in_flight = 0
        for entry in added:  # one at a time: there may be many, and a put must not wait for all
            with self._changed:
                self._journal.release(entry.id)

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
