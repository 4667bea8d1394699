"""Orders about the configuration's file, in the main process: the web process can write nothing, and need not even be
able to read it. What is written is made here, of a bay's settings: nothing but `[vision]` can be changed this way. IO.

One at a time, on a thread: a disk may take its time, and so may reading a long file.
"""

import asyncio
import logging
from collections.abc import Callable
from concurrent.futures import Executor
from pathlib import Path

from gateway import audit
from gateway.clock import Clock
from gateway.errors import ConfigError
from gateway.hmi.guard.telling import shown
from gateway.hmi.orders import Done, FileError, FileOrder, InFile, PlanFile, Planned, ReadFile, Saved, SaveFile
from gateway.hmi.workbench import configfile, profile
from gateway.hmi.workbench.configfile import ChangedOnDiskError
from gateway.plc import Writer

log = logging.getLogger(__name__)

MOST_WAITING = 8
MAX_DIFF = 20_000  # characters; a message holds some more
MAX_WHY = 4000


class FileOrders:
    """`path`: None where there is no file. `wake` is called on the event loop when something is done."""

    def __init__(self, path: Path | None, clock: Clock, thread: Executor, wake: Callable[[], None]) -> None:
        self._path = path
        self._clock = clock
        self._thread = thread
        self._wake = wake
        self._bucket = audit.Bucket()
        self._at_work: list[asyncio.Future[Done]] = []

    def take(self, order: FileOrder) -> Done | None:
        """What is wrong with it; None: it is under work, and `done` will tell."""
        self._bucket, untold = audit.take(self._bucket, self._clock.now_ns())
        if untold is None or len(self._at_work) >= MOST_WAITING:
            return Done(order.number, "too many ask for the file one after the other: wait a little")
        future = asyncio.get_running_loop().run_in_executor(self._thread, _carried_out, order, self._path)
        self._at_work.append(future)
        future.add_done_callback(lambda _: self._wake())
        return None

    def done(self) -> list[Done]:
        """Raises what nobody expected of the work: that is a bug."""
        ready = [future for future in self._at_work if future.done()]
        self._at_work = [future for future in self._at_work if future not in ready]
        return [future.result() for future in ready]


def _carried_out(order: FileOrder, path: Path | None) -> Done:
    try:
        found = configfile.named(path)
        match order.what:
            case ReadFile(bay):
                return Done(order.number, result=_read(found, bay))
            case PlanFile():
                return Done(order.number, result=_plan(found, order.what))
            case SaveFile():
                return Done(order.number, result=_save(found, order.what, order.who))
    except ConfigError as error:
        kind = FileError.CHANGED if isinstance(error, ChangedOnDiskError) else FileError.WRONG
        return Done(order.number, str(error)[:MAX_WHY], kind)


def _read(path: Path, bay: str) -> InFile:
    loaded = configfile.load(path)
    return InFile(profile.in_file(loaded.text, bay, source=str(path)), configfile.why_not_writable(path))


def _plan(path: Path, wanted: PlanFile) -> Planned:
    loaded = configfile.load(path)
    proposal = profile.propose(loaded.text, wanted.bay, wanted.vision, source=str(path))
    diff = proposal.diff if len(proposal.diff) <= MAX_DIFF else f"{proposal.diff[:MAX_DIFF]}\n(and more)\n"
    return Planned(diff, tuple(proposal.changes), loaded.digest, configfile.why_not_writable(path))


def _save(path: Path, wanted: SaveFile, who: Writer) -> Saved:
    loaded = configfile.load(path)
    configfile.same(loaded, wanted.digest)
    proposal = profile.propose(loaded.text, wanted.bay, wanted.vision, source=str(path))
    backup = configfile.save(loaded, proposal.text)
    keys = ", ".join(proposal.changes) or "nothing new"
    log.info("%s: %s of %s saved by %s", path, keys, wanted.bay, shown(str(who)))
    return Saved(tuple(proposal.changes), str(backup))
