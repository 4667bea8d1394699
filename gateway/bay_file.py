"""The bay files: what of a bay outlives a restart or a crash, one small JSON file a bay. IO.

An active function check, because a technician works on the bay and may_move must stay off; the visits from which
R times Z is learned; and a truck that is in place and was not released, because it must not leave unnoticed while the
gateway starts. Nothing else: no value of before the restart is ever shown as one of now (gateway/core/retained.py).

Beside it lies the tried file: the keys of the bay's decision (gateway/config/decision.py) as they were when a function
check was ended, or at the first start. A start with others begins a function check. It is a file of its own, because an
older version would take a bay file with a further key for damaged.

Files are read before anything starts. After that no task waits for the disk: states are noted, and a task hands changes
to a thread. A file that is damaged or can't be read counts as one with an active function check. A missing file means
a first start, which begins with a function check where `initial_function_check` is on: nobody has tried the bay yet.
"""

import asyncio
import contextlib
import json
import logging
import os
import stat
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn

from gateway import systemd
from gateway.bay_file_format import decoded, encoded
from gateway.clock import Clock
from gateway.config import BayConfig, GatewayConfig, decision
from gateway.core.retained import RetainedState
from gateway.core.state import FunctionCheck, Reason, StateVector
from gateway.errors import LinkError
from gateway.files import write_file

log = logging.getLogger(__name__)

TRIED_VERSION = 1
MAX_BYTES = 100_000  # 60 visits take 6 kB
SLOW_S = 5.0  # a disk that takes longer is at fault, however it ends


def folder_of(config: GatewayConfig) -> Path | None:
    """`state_dir`, the gateway's folder for what it keeps; None: nothing is kept."""
    return systemd.state_folder(config.state_dir)


def path_of(config: GatewayConfig, bay: str) -> Path | None:
    """The path of a bay's file; None: nothing is kept. None of the three names contains a dot."""
    folder = folder_of(config)
    return None if folder is None else folder / f"bay.{config.site}.{config.instance}.{bay}.json"


def tried_path_of(config: GatewayConfig, bay: str) -> Path | None:
    """The path of a bay's tried file; None: nothing is kept."""
    path = path_of(config, bay)
    return None if path is None else _tried_beside(path)


def _tried_beside(path: Path) -> Path:
    return path.with_suffix(".tried.json")


def read_file(path: Path) -> bytes | None:
    """None: no file. Never waits for a pipe, never follows a link. Raises OSError."""
    try:
        fd = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError:
        return None
    with os.fdopen(fd, "rb") as file:
        if not stat.S_ISREG(os.fstat(fd).st_mode):
            raise OSError("not a regular file")
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise OSError("too large")
    return data


def begin_with_function_check(config: GatewayConfig, bay: BayConfig) -> bool:
    """The bay's next start begins with a function check, may_move off: for a bay that does not run yet, which nobody
    has tried. What else its file keeps stays. False: nothing is kept (`state_dir`). Raises OSError."""
    path = path_of(config, bay.name)
    if path is None:
        return False
    data = read_file(path)
    try:
        kept = RetainedState() if data is None else decoded(data, bay)
    except ValueError:
        return True  # a damaged file counts as one with a function check
    write_file(path, encoded(replace(kept, function_check=FunctionCheck.MAY_MOVE_OFF), bay, 0))
    return True


def _run_in_thread(work: Callable[[], None]) -> None:
    """A failed disk may block it for ever: nothing waits for it at the exit."""
    threading.Thread(target=work, name="bay-files", daemon=True).start()


@dataclass(slots=True)
class _Bay:
    config: BayConfig
    path: Path
    wanted: RetainedState
    written: RetainedState | None = None  # None: what is in the file is not known to be `wanted`
    damaged: str = ""  # why the file could not be read; until a technician has begun or ended a function check
    tried: Mapping[str, Any] = field(default_factory=dict)
    tried_written: bool = False

    @property
    def tried_path(self) -> Path:
        return _tried_beside(self.path)


@dataclass(slots=True)
class BayFiles:
    """The files of all bays. `fault`: why they can't be written, in words; empty: they can."""

    clock: Clock
    write: Callable[[Path, bytes], None] = write_file
    start: Callable[[Callable[[], None]], None] = _run_in_thread
    fault: str = ""
    in_force: Callable[[str], Mapping[str, Any]] = lambda _: {}  # the keys of a bay's decision now
    first: RetainedState = field(default_factory=RetainedState)  # what a bay begins with of which nothing is kept
    _bays: dict[str, _Bay] = field(default_factory=dict)
    _others: dict[Path, bytes | None] = field(default_factory=dict)
    _changed: asyncio.Event = field(default_factory=asyncio.Event)

    @staticmethod
    def read(
        config: GatewayConfig, clock: Clock, in_force: Callable[[str], Mapping[str, Any]] | None = None
    ) -> "BayFiles":
        """Of all bays; may wait for the disk. Faults of a file are logged and listed in `damaged`. `in_force`: the keys
        of a bay's decision now; None: those of `config`."""
        check = FunctionCheck.MAY_MOVE_OFF if config.initial_function_check else FunctionCheck.OFF
        now = {bay.name: decision.keys_of(bay, config) for bay in config.bays}
        files = BayFiles(clock, in_force=in_force or now.__getitem__, first=RetainedState(check))
        for bay in config.bays:
            if (path := path_of(config, bay.name)) is not None:
                files._bays[bay.name] = _with_tried(_read(bay, path, files.first), now[bay.name])
        return files

    @property
    def damaged(self) -> Mapping[str, str]:
        """Bays whose file could not be read, and why, until a function check was begun or ended there."""
        return {name: bay.damaged for name, bay in self._bays.items() if bay.damaged}

    def retained(self, bay: str) -> RetainedState:
        """What a bay starts with."""
        return self._bays[bay].wanted if bay in self._bays else self.first

    def untried(self, bay: str) -> list[str]:
        """The keys of its decision that differ from those last tried. Nothing where nothing is kept."""
        return decision.differing(self._bays[bay].tried, self.in_force(bay)) if bay in self._bays else []

    def note(self, state: StateVector) -> None:
        """Called with every state that is published. Never waits."""
        bay = self._bays.get(state.bay)
        if bay is None or state.reason is Reason.SHUTDOWN:  # the last state has no values, but its truck is there
            return
        retained = RetainedState.of(state)
        if retained == bay.wanted:
            return
        if retained.function_check is not bay.wanted.function_check:
            bay.damaged = ""
            if retained.function_check is FunctionCheck.OFF:
                bay.tried, bay.tried_written = self.in_force(state.bay), False
        bay.wanted = retained
        self._changed.set()

    def keep(self, path: Path, data: bytes | None) -> None:
        """Another file of a bay, written as these are; None: deleted. Never waits."""
        self._others[path] = data
        self._changed.set()

    async def run(self) -> NoReturn:
        """Write changes at once, and everything after a start. Raises LinkError when the disk refuses."""
        while True:
            self._changed.clear()
            faults = [fault for bay in self._bays.values() if (fault := await self._update(bay))]
            faults += [fault for path in tuple(self._others) if (fault := await self._update_other(path))]
            if faults:
                self.fault = faults[0]
                raise LinkError(self.fault)
            if self.fault:
                log.warning("the bay files can be written again")
                self.fault = ""
            await self._changed.wait()

    async def _update(self, bay: _Bay) -> str:
        """Write the bay's file if it needs to be; what went wrong."""
        # The bay file first: cut off between the two, the next start begins a function check, which is safe.
        return await self._update_bay(bay) or await self._update_tried(bay)

    async def _update_bay(self, bay: _Bay) -> str:
        wanted = bay.wanted
        if wanted == bay.written:
            return ""
        bay.written = None  # a write that fails may have written
        data = encoded(wanted, bay.config, self.clock.wall_ns() - self.clock.now_ns())
        error = await self._written(bay.path, data)
        if error is not None:
            return f"{bay.path}: {error.strerror or error}"
        bay.written = wanted
        return ""

    async def _update_tried(self, bay: _Bay) -> str:
        if bay.tried_written:
            return ""
        tried = bay.tried
        text = json.dumps({"version": TRIED_VERSION, "keys": tried}, indent=1)
        if (error := await self._written(bay.tried_path, f"{text}\n".encode())) is not None:
            return f"{bay.tried_path}: {error.strerror or error}"
        bay.tried_written = tried is bay.tried
        return ""

    async def _update_other(self, path: Path) -> str:
        data = self._others[path]
        if (error := await self._written(path, data)) is not None:
            return f"{path}: {error.strerror or error}"
        if self._others[path] is data:  # else there is something newer
            del self._others[path]
        return ""

    async def _written(self, path: Path, data: bytes | None) -> OSError | None:
        """In a thread. Longer than SLOW_S is a fault; a second write must not begin meanwhile."""
        loop = asyncio.get_running_loop()
        done: asyncio.Future[OSError | None] = loop.create_future()

        def settle(error: OSError | None) -> None:
            if not done.done():
                done.set_result(error)

        def work() -> None:
            error: OSError | None = None
            try:
                if data is None:
                    path.unlink(missing_ok=True)
                else:
                    self.write(path, data)
            except OSError as failed:
                error = failed
            with contextlib.suppress(RuntimeError):  # the loop is closed: the result is not needed any more
                loop.call_soon_threadsafe(settle, error)

        self.start(work)
        try:
            async with self.clock.timeout(SLOW_S):
                return await asyncio.shield(done)
        except TimeoutError:
            self.fault = f"{path}: not written within {SLOW_S:g} s"
            log.warning("%s; waiting", self.fault)
        return await done


def _read(bay: BayConfig, path: Path, first: RetainedState) -> _Bay:
    try:
        data = read_file(path)
        if data is None and first.function_check is not FunctionCheck.OFF:
            log.warning(
                "%s: there is no %s: the bay starts with a function check (initial_function_check)", bay.name, path
            )
        return _Bay(bay, path, first if data is None else decoded(data, bay))
    except OSError as error:
        why = error.strerror or str(error)
    except ValueError as error:
        why = str(error)
    log.error(
        "%s: %s cannot be read (%s): the bay starts with a function check, because a technician may be working on it",
        bay.name,
        path,
        why,
    )
    aside = path.with_name(f"{path.name}.damaged")
    with contextlib.suppress(OSError):  # a copy for inspection; a link, so that the file itself is never missing
        aside.unlink(missing_ok=True)
        os.link(path, aside, follow_symlinks=False)
    return _Bay(bay, path, RetainedState(FunctionCheck.MAY_MOVE_OFF), damaged=why)


def _with_tried(bay: _Bay, now: Mapping[str, Any]) -> _Bay:
    """A start with other keys than those last tried begins a function check, unless one is on."""
    name, path = bay.config.name, bay.tried_path
    bay.tried = now
    try:
        data = read_file(path)
        if data is not None:
            found = json.loads(data)
            if found["version"] != TRIED_VERSION or not isinstance(found["keys"], dict):
                raise ValueError(f"not of version {TRIED_VERSION}")
            bay.tried, bay.tried_written = found["keys"], True
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        bay.tried, bay.tried_written = {}, True
        if bay.wanted.function_check is FunctionCheck.OFF:
            log.error("%s: %s cannot be read (%s): the bay starts with a function check", name, path, error)
            bay.wanted = replace(bay.wanted, function_check=FunctionCheck.MAY_MOVE_OFF)
        return bay
    other = decision.differing(bay.tried, now)
    if other and bay.wanted.function_check is FunctionCheck.OFF:
        log.warning(
            "%s: these keys are not those last tried: %s: the bay starts with a function check", name, ", ".join(other)
        )
        bay.wanted = replace(bay.wanted, function_check=FunctionCheck.MAY_MOVE_OFF)
    return bay
