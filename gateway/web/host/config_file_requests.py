"""Requests about the configuration file, in the main process: the web process cannot write it, and need not be able to
read it. The text is made here from the requested changes, and checked completely before it is written. IO.

One at a time, on a thread: a disk or a long file may be slow.
"""

import asyncio
import logging
from collections.abc import Callable
from concurrent.futures import Executor
from functools import partial
from pathlib import Path

from gateway.clock import Clock
from gateway.core.plc import Writer
from gateway.errors import ConfigError
from gateway.net import rate_limit
from gateway.web.auth.audit_log import printable
from gateway.web.host import config_file
from gateway.web.host.settings_file import SettingsFile
from gateway.web.ipc.messages import (
    ChangedOnDiskError,
    Command,
    CommandReply,
    FileErrorKind,
    FilePreview,
    FileRequest,
    FileResult,
    FileSaved,
    FileSettings,
    PreviewFile,
    PreviewSettings,
    ReadFile,
    ReadSettings,
    SaveFile,
    SaveSettings,
    SetFunctionCheck,
)
from gateway.web.profile import profile

log = logging.getLogger(__name__)

MAX_WAITING = 8
MAX_DIFF = 20_000  # characters; a message holds some more
MAX_WHY = 4000
TOO_MANY = "too many requests for the file in a short time: wait a moment"


class ConfigFileRequests:
    """`path`: None where there is no file; `settings`: of that file. `wake` is called on the event loop when something
    is done."""

    def __init__(
        self, path: Path | None, settings: SettingsFile | None, clock: Clock, thread: Executor, wake: Callable[[], None]
    ) -> None:
        self._path = path
        self._settings = settings
        self._clock = clock
        self._thread = thread
        self._wake = wake
        self._bucket = rate_limit.Bucket()
        self._running: list[asyncio.Future[CommandReply]] = []
        self._asked: list[tuple[Command, asyncio.Future[tuple[str, ...]]]] = []

    def submit(self, request: FileRequest) -> CommandReply | None:
        """The refusal; None: it is being worked on, and `finished` returns the reply."""
        self._bucket, unreported = rate_limit.take(self._bucket, self._clock.now_ns())
        if unreported is None or len(self._running) >= MAX_WAITING:
            return CommandReply(request.number, TOO_MANY)
        future = asyncio.get_running_loop().run_in_executor(self._thread, self._perform, request)
        self._running.append(future)
        future.add_done_callback(lambda _: self._wake())
        return None

    def look_up(self, command: Command) -> CommandReply | None:
        """What of the file waits for a restart, before `command` ends a function check. The refusal; None: it is being
        read, and `looked_up` returns it."""
        if not isinstance(command.action, SetFunctionCheck) or self._settings is None:
            raise ValueError(command)
        if len(self._asked) >= MAX_WAITING:
            return CommandReply(command.number, TOO_MANY)
        look = partial(self._settings.waiting, command.action.bay)
        future = asyncio.get_running_loop().run_in_executor(self._thread, look)
        self._asked.append((command, future))
        future.add_done_callback(lambda _: self._wake())
        return None

    def looked_up(self) -> list[tuple[Command, tuple[str, ...]]]:
        """The commands that can be executed, with what waits. Raises as `finished`."""
        ready = [(command, future.result()) for command, future in self._asked if future.done()]
        self._asked = [row for row in self._asked if not row[1].done()]
        return ready

    def finished(self) -> list[CommandReply]:
        """The replies that are ready. Raises what the work raised unexpectedly: that is a bug."""
        ready = [future for future in self._running if future.done()]
        self._running = [future for future in self._running if future not in ready]
        return [future.result() for future in ready]

    def _perform(self, request: FileRequest) -> CommandReply:
        try:
            return CommandReply(request.number, result=self._result(request))
        except ConfigError as error:
            kind = FileErrorKind.CHANGED if isinstance(error, ChangedOnDiskError) else FileErrorKind.WRONG
            return CommandReply(request.number, str(error)[:MAX_WHY], kind)

    def _result(self, request: FileRequest) -> FileResult:
        path, settings = self._path, self._settings
        if path is None or settings is None:
            raise ConfigError(config_file.NO_FILE)
        match request.action:
            case ReadFile(bay):
                return _read(path, bay, settings.waiting(bay))
            case PreviewFile():
                return _plan(path, request.action)
            case SaveFile():
                return _save(path, request.action, request.who)
            case ReadSettings():
                return settings.read()
            case PreviewSettings():
                return settings.preview(request.action)
            case SaveSettings():
                return settings.save(request.action, request.who)


def _read(path: Path, bay: str, waiting: tuple[str, ...]) -> FileSettings:
    loaded = config_file.load(path)
    vision = profile.in_file(loaded.text, bay, source=str(path))
    return FileSettings(vision, config_file.why_not_writable(path), waiting)


def _plan(path: Path, requested: PreviewFile) -> FilePreview:
    loaded = config_file.load(path)
    proposal = profile.propose(loaded.text, requested.bay, requested.vision, source=str(path))
    diff = proposal.diff if len(proposal.diff) <= MAX_DIFF else f"{proposal.diff[:MAX_DIFF]}\n(and more)\n"
    return FilePreview(diff, tuple(proposal.changes), loaded.digest, config_file.why_not_writable(path))


def _save(path: Path, requested: SaveFile, who: Writer) -> FileSaved:
    loaded = config_file.load(path)
    if loaded.digest != requested.digest:
        raise ChangedOnDiskError(f"{path}: was changed elsewhere since it was shown; nothing was written")
    proposal = profile.propose(loaded.text, requested.bay, requested.vision, source=str(path))
    previous = config_file.save(loaded, proposal.text)
    keys = ", ".join(proposal.changes) or "nothing new"
    log.info("%s: %s of %s saved by %s", path, keys, requested.bay, printable(str(who)))
    return FileSaved(tuple(proposal.changes), str(previous))
