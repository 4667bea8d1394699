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
from gateway.web.host.request_handler import forbidden_by_waiting
from gateway.web.host.settings_file import SettingsFile
from gateway.web.ipc.messages import (
    ActOnRelease,
    ChangedOnDiskError,
    Command,
    CommandReply,
    FileErrorKind,
    FilePreview,
    FileRequest,
    FileResult,
    FileSaved,
    FileSettings,
    KeepCameraPassword,
    MakeFirstUser,
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
    """`settings`: of the operator's own file; None: there is none. `execute` carries out a command. `wake` is called on
    the event loop when something is done."""

    def __init__(
        self,
        settings: SettingsFile | None,
        clock: Clock,
        thread: Executor,
        wake: Callable[[], None],
        execute: Callable[[Command, tuple[str, ...]], CommandReply],
    ) -> None:
        self._settings = settings
        self._clock = clock
        self._thread = thread
        self._wake = wake
        self._execute = execute
        self._bucket = rate_limit.Bucket()
        self._running: list[asyncio.Future[Callable[[], CommandReply]]] = []

    def submit(self, request: FileRequest | Command) -> CommandReply | None:
        """The reply, if there is one at once; None: `finished` returns it. A command waits for the file only where
        what waits there for a restart forbids it."""
        if isinstance(request, FileRequest):
            self._bucket, unreported = rate_limit.take(self._bucket, self._clock.now_ns())
            refused = unreported is None
        elif self._settings is None or not forbidden_by_waiting(request):
            return self._execute(request, ())
        else:
            refused = False
        if refused or len(self._running) >= MAX_WAITING:
            return CommandReply(request.number, TOO_MANY)
        future = asyncio.get_running_loop().run_in_executor(self._thread, self._perform, request)
        self._running.append(future)
        future.add_done_callback(lambda _: self._wake())
        return None

    def finished(self) -> list[CommandReply]:
        """The replies that are ready. Raises what the work raised unexpectedly: that is a bug."""
        ready = [future for future in self._running if future.done()]
        self._running = [future for future in self._running if future not in ready]
        return [future.result()() for future in ready]

    def _perform(self, request: FileRequest | Command) -> Callable[[], CommandReply]:
        """What is left to do on the event loop: a command is carried out there."""
        if isinstance(request, Command):
            return partial(self._execute, request, self._waiting(request))
        try:
            reply = CommandReply(request.number, result=self._result(request))
        except ConfigError as error:
            kind = FileErrorKind.CHANGED if isinstance(error, ChangedOnDiskError) else FileErrorKind.WRONG
            reply = CommandReply(request.number, str(error)[:MAX_WHY], kind)
        return lambda: reply

    def _waiting(self, command: Command) -> tuple[str, ...]:
        if self._settings is None or not isinstance(command.action, SetFunctionCheck | ActOnRelease):
            raise ValueError(command)
        return self._settings.waiting(command.action.bay)

    def _result(self, request: FileRequest) -> FileResult:
        settings = self._settings
        if settings is None:
            raise ConfigError(config_file.NO_FILE)
        path = settings.path
        found: FileResult
        match request.action:
            case ReadFile(bay):
                found = _read(path, bay, settings.waiting(bay))
            case PreviewFile():
                found = _plan(path, request.action)
            case SaveFile():
                found = _save(path, request.action, request.who)
            case ReadSettings():
                found = settings.read()
            case PreviewSettings():
                found = settings.preview(request.action, request.who)
            case SaveSettings():
                found = settings.save(request.action, request.who)
            case MakeFirstUser():
                found = settings.make_first_user(request.action, request.who)
            case KeepCameraPassword():
                found = settings.keep_camera_password(request.action)
        return found


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
