"""The web process's life, seen from the main process: started by the first visitor, answered, watched, replaced. IO.

Without clients there is no such process: a connection waits in the listening socket until it has started.
"""

import asyncio
import logging
import os
import socket
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress

from msgspec.structs import replace

from gateway.bay_file import folder_of
from gateway.config import GatewayConfig
from gateway.errors import ConfigError, LinkError
from gateway.net import own_host, tls
from gateway.net.listener import listening
from gateway.processes.channel import Failed, Gone
from gateway.processes.deadlines import LOOK_S, SignsOfLife, StartDeadline
from gateway.processes.request_service import readable
from gateway.processes.slot import ProcessSlot
from gateway.processes.start import Role
from gateway.web.host.config_file_requests import ConfigFileRequests
from gateway.web.host.request_handler import PagesRequestHandler
from gateway.web.host.settings_file import SettingsFile
from gateway.web.ipc.messages import (
    FROM_WEB,
    Command,
    FileRequest,
    FromWeb,
    StateRequest,
    ToWeb,
    WebSetup,
)
from gateway.web.languages import memory_of, usable

log = logging.getLogger(__name__)

START_S = 30.0  # real time, as the next; a first start on an idle machine takes 2 s of the processor, at low priority
SILENT_S = 15.0  # the web process sends a request at least once a second
CERTIFICATE_S = 60.0  # between two looks at the machine's names and addresses
PAUSE_S = 0.01  # between two turns: a web process is not served more often
MAX_MESSAGES = 8  # read in one turn; a web process in order has one request pending, and now and then a command
MAX_FULL_TURNS = 100  # in a row with more messages than that, more than a second: it is out of control
MODULE = "gateway.web.server.process"


def of_pages(config: GatewayConfig) -> GatewayConfig:
    """What the web process gets to know of it. `state_dir = "auto"` would mean another folder to its user."""
    return config.model_copy(update={"mqtt": None, "sinks": {}, "state_dir": str(folder_of(config) or "")})


class WebProcessService:
    """A row of the task table: `run` ends with LinkError when the web process does.

    `sockets`: listening already; without any, `run` binds them itself, as often as it takes. `settings`: of the
    operator's own file; None: there is none.
    """

    def __init__(
        self,
        handler: PagesRequestHandler,
        setup: WebSetup,
        sockets: tuple[socket.socket, ...],
        settings: SettingsFile | None = None,
    ) -> None:
        self._handler = handler
        self._setup = setup
        self._sockets = sockets
        self._settings = settings
        self._texts = usable(setup.config)
        self._slot: ProcessSlot[ToWeb, FromWeb] | None = None
        self._outdated = False
        self._life = SignsOfLife(StartDeadline(START_S), SILENT_S)

    def apply(self, config: GatewayConfig) -> None:
        """Continue with another configuration, of the same address: the web process, if there is one, is replaced."""
        self._setup = replace(self._setup, config=of_pages(config))
        self._texts = usable(config)
        self._outdated = True
        if self._slot is not None:
            self._slot.wake()

    async def run(self) -> None:
        """Until cancelled. Raises LinkError when the port is taken or the web process ended or hung.

        Also for what only people can mend, such as a certificate that can't be read any more: a ConfigError would end
        the gateway, and no page is worth a bay.
        """
        try:
            with ExitStack() as own:
                hmi = self._setup.config.hmi
                sockets = self._sockets or own.enter_context(listening("hmi", hmi.host, hmi.port))
                while True:
                    with ExitStack() as of_process:
                        await self._serve(sockets, of_process)
        except ConfigError as error:
            raise LinkError(str(error)) from error

    async def _serve(self, sockets: tuple[socket.socket, ...], own: ExitStack) -> None:
        """Until the configuration has changed."""
        await readable(*sockets)
        self._outdated = False
        await asyncio.to_thread(self._check_certificate, sockets)
        role = self._role(sockets, own)
        thread = ThreadPoolExecutor(1, thread_name_prefix="file")
        own.callback(thread.shutdown, wait=False, cancel_futures=True)
        async with ProcessSlot[ToWeb, FromWeb]("hmi", self._setup.clock, FROM_WEB) as slot:
            requests = ConfigFileRequests(self._settings, self._setup.clock, thread, slot.wake, self._handler.execute)
            self._slot = slot
            own.callback(self._forget_slot)
            slot.start(role)
            now_s = asyncio.get_running_loop().time
            self._life.begin(now_s())
            full = 0
            while not self._outdated:
                with suppress(TimeoutError):
                    async with asyncio.timeout(LOOK_S):
                        await slot.wait(None)
                request: StateRequest | None = None
                messages = slot.messages(most=MAX_MESSAGES)
                if why := self._life.missing(now_s(), heard=bool(messages)):
                    raise LinkError(f"the web process {why}")
                full = full + 1 if len(messages) >= MAX_MESSAGES else 0
                if full > MAX_FULL_TURNS:
                    raise LinkError("the web process sends messages without pause")
                for message in messages:
                    match message:
                        case StateRequest():
                            request = message  # the newest answers all before it
                        case Command() | FileRequest():
                            if (reply := requests.submit(message)) is not None:
                                slot.send(reply)
                        case Failed(why):
                            raise LinkError(why)
                        case Gone(how):
                            raise LinkError(f"the web process {how}")
                for reply in requests.finished():
                    slot.send(reply)
                if request is not None:
                    slot.send(self._handler.answer(request))
                await asyncio.sleep(PAUSE_S)

    def _role(self, sockets: tuple[socket.socket, ...], own: ExitStack) -> Role[ToWeb]:
        """The process to start, with what it inherits."""
        rings = tuple(fd for ring in self._setup.rings.values() for fd in ring.fds)
        listening = tuple(sock.fileno() for sock in sockets)
        source = self._setup.source.encode(
            errors="backslashreplace"
        ).decode()  # a name need not be UTF-8, a message must
        texts = memory_of(self._texts) if self._texts else None
        if texts is not None:
            own.callback(os.close, texts)
        job = replace(self._setup, sockets=listening, source=source, languages=texts)
        self._setup = replace(self._setup, login=None)  # the next web process is no restart of the gateway
        others = tuple(fd for fd in (job.questions, job.devices, job.test_sets, job.updates, texts) if fd is not None)
        return Role(MODULE, "gw-hmi", job, (*rings, *listening, *others))

    async def keep_certificate(self) -> None:
        """Until cancelled; logs where the pages are opened, too. Raises LinkError where it can't be written."""
        said = ""
        while True:
            try:
                await asyncio.to_thread(self._make_certificate)
            except (ConfigError, OSError) as error:
                raise LinkError(f"hmi.tls_cert: {error}") from error
            if (where := self.where()) != said:
                said = where
                log.info("hmi: %s", where)
            await asyncio.sleep(CERTIFICATE_S)

    def where(self) -> str:
        """Where the pages are opened, in words; empty: at the address that is configured."""
        hmi = self._setup.config.hmi
        if not hmi.own_hosts or not self._sockets:
            return ""
        urls = " or ".join(own_host.page_urls(self._sockets[0].getsockname()[1]))
        return f"nobody has made the first password yet, at {urls}" if hmi.awaits_first_user else f"pages at {urls}"

    def _make_certificate(self) -> None:
        """Raises ConfigError, OSError."""
        config = self._setup.config
        if config.hmi.own_certificate and (files := tls.TlsFiles.of_pages(config)) is not None:
            from gateway.net import own_certificate  # noqa: PLC0415 - only where it makes its certificate itself

            own_certificate.keep(files, self._setup.clock)

    def _check_certificate(self, sockets: tuple[socket.socket, ...]) -> None:
        """Raises ConfigError where the web process would not start; then the connections that wait are closed."""
        try:
            with suppress(OSError):
                self._make_certificate()
            tls.check(tls.TlsFiles.of_pages(self._setup.config))
        except ConfigError:
            for sock in sockets:
                with suppress(OSError):  # there are no more
                    while True:
                        sock.accept()[0].close()
            raise

    def _forget_slot(self) -> None:
        self._slot = None
