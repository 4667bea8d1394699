"""The web process: the client that pulls, and the server that answers. Ends when the main process does. IO.

It serves any network client, so it gives up all rights that it does not need before the first request: see `sandbox`.
"""

import asyncio
import logging
import socket
from contextlib import closing

import cv2
import uvicorn

from gateway import event_loop
from gateway.clock import Clock, SystemClock
from gateway.durations import NS_PER_S
from gateway.net.rate_limit import LogThrottle
from gateway.net.tls import ReloadingContext, TlsFiles
from gateway.processes import sandbox
from gateway.processes.channel import Channel
from gateway.processes.child import lower_priority
from gateway.web.auth import slow_clients
from gateway.web.auth.audit_log import WARNINGS, AuditRecord
from gateway.web.auth.logins import Logins
from gateway.web.ipc.messages import TO_WEB, FromWeb, ToWeb, WebSetup
from gateway.web.server.app import app
from gateway.web.server.gateway_client import GatewayClient
from gateway.web.server.services import services_of

log = logging.getLogger(__name__)

CODEC = TO_WEB

NICE = 10  # pages must not take the processor from the camera and the PLC
GRACE_S = 1  # of open connections at the end
LIBRARIES = ("uvicorn.error", "asyncio")  # they log an error, some with a traceback, for many a bad request
MAX_TEXT = 4096  # of one WebSocket message from a page


class ErrorThrottle(logging.Filter):
    """Of the libraries' errors, one of a kind in 10 s: a peer must not be able to fill the log."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self._clock = clock
        self._throttle = LogThrottle()

    def filter(self, record: logging.LogRecord) -> bool:
        text = record.getMessage()
        kind = record.name, text.partition("\n")[0][:80]
        line = self._throttle.line(kind, text.rstrip("\n"), self._clock.now_ns() / NS_PER_S)
        if line is not None:
            record.msg, record.args = line, ()
        return line is not None


def run(channel: Channel[FromWeb, ToWeb], about: WebSetup) -> None:
    """Until the main process has ended. One that does not answer is waited for."""
    lower_priority(NICE)
    cv2.setNumThreads(1)
    log.setLevel(logging.INFO)  # who logged in and who changed something is always logged
    limit = ErrorThrottle(SystemClock())
    for name in LIBRARIES:
        logging.getLogger(name).addFilter(limit)
    for line in sandbox.enter(about.config.hmi.run_as):
        log.warning("hmi: the web process keeps a right that it does not need: %s", line)
    event_loop.run(_serve(about, channel))


async def _serve(about: WebSetup, channel: Channel[FromWeb, ToWeb]) -> None:
    pace = SystemClock()
    client = GatewayClient(about, channel, pace)
    config = about.config.hmi
    for line in config.warnings():
        log.warning("%s", line)
    files = TlsFiles.of_pages(about.config)
    tls = None if files is None else ReloadingContext(files, pace)
    logins = Logins(config, pace, _log, instance=about.config.instance)
    if about.login is not None:
        logins.resume(about.login)
    services = services_of(client, pace)
    server = uvicorn.Server(
        uvicorn.Config(
            app(services, logins, pace),
            **slow_clients.settings(None if tls is None else tls.initial, config.trusted_proxies),
            ws_max_size=MAX_TEXT,
            limit_concurrency=4 * config.max_viewers + 64,
            timeout_graceful_shutdown=GRACE_S,
        )
    )
    sockets = [socket.socket(fileno=fd) for fd in about.sockets]
    with closing(services.tuning), closing(services.test_sets):
        async with asyncio.TaskGroup() as group:
            pulling = group.create_task(client.keep(), name="gateway-client")
            fresh = None if tls is None else group.create_task(tls.keep_current(), name="tls")
            await server.serve(sockets)
            pulling.cancel()
            if fresh is not None:
                fresh.cancel()
    logins.close()


def _log(record: AuditRecord) -> None:
    log.log(logging.WARNING if record.kind in WARNINGS else logging.INFO, "hmi: %s", record)
