"""What `run` and `simulate` share: logging, signals, a bounded life, and the exit code."""

import asyncio
import atexit
import contextlib
import faulthandler
import logging
import os
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from gateway import app, interrupts
from gateway.cli.in_place_restart import InPlaceRestart
from gateway.cli.output import LossyOutput
from gateway.clock import SystemClock
from gateway.config import GatewayConfig
from gateway.hub import Hub
from gateway.logs import setup as logs
from gateway.logs.folding import LogCounts
from gateway.logs.setup import FoldingHandler
from gateway.parts import Ports
from gateway.reload import ReloadRequests
from gateway.supervisor import Task
from gateway.systemd import Notifier
from gateway.web.host.startup import ALONE, LOGIN, Restart, Startup

REPEATS_S = 10.0  # between two looks at what the log has not written
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def setup_logging(level: str, form: str = "text") -> FoldingHandler:
    """One line a record on stderr; stdout belongs to the verb's own output. An unread log blocks nothing."""
    outlet = LossyOutput(sys.stderr)
    atexit.register(outlet.close)
    handler = logs.setup(level, form, outlet)
    atexit.register(partial(handler.report, all_of_them=True))  # before the outlet is closed
    # The MQTT library logs every lost broker as an error; the gateway reports its links itself.
    logging.getLogger("mqtt").setLevel(logging.CRITICAL)
    return handler


def shipped(*parts: str) -> Path:
    """A file of the project's config/ folder: beside the package in a checkout, inside it once installed."""
    package = Path(__file__).resolve().parent.parent
    beside = package.parent / "config"
    return (beside if (beside / "gateway.toml").is_file() else package / "shipped").joinpath(*parts)


async def serve(
    config: GatewayConfig,
    ports: Ports,
    clock: SystemClock,
    *,
    duration_s: float | None = None,
    on_started: Callable[[app.Running], None] = lambda _: None,
    extra_tasks: Callable[[Hub], Sequence[Task]] = lambda _: (),
    stop: asyncio.Event | None = None,
    source: str = "",
    lines: FoldingHandler | None = None,
    reload: ReloadRequests | None = None,
    startup: Startup = ALONE,
    in_place_restart: InPlaceRestart | None = None,
) -> None:
    """`app.run` until a signal, `stop`, or `duration_s` of `clock` after the start.

    `lines`: of the log. `reload`: SIGHUP asks for it; without it, and where the terminal went away, SIGHUP is the end.
    `startup`: what the pages are told of the command line. `in_place_restart`: starts the program again at its end,
    where the pages requested that.
    """
    stop = stop or asyncio.Event()
    restart = Restart(stop)
    if in_place_restart is not None:
        startup = replace(startup, restart=restart, login=os.environ.pop(LOGIN, ""))
    loop = asyncio.get_running_loop()
    for number in SIGNALS:
        loop.add_signal_handler(number, stop.set)
    if interrupts.asked():  # while modules were imported, in code that has swallowed it
        stop.set()
    if reload is not None:
        loop.add_signal_handler(signal.SIGHUP, partial(_hung_up, reload, stop, had_terminal=_has_terminal()))

    async def repeats() -> None:
        while True:
            await asyncio.sleep(REPEATS_S)
            if lines is not None:
                lines.report()

    async def lifetime() -> None:
        await clock.sleep(duration_s or 0.0)
        stop.set()

    def table(hub: Hub) -> list[Task]:
        return [
            Task("log", repeats),
            *extra_tasks(hub),
            *([Task("lifetime", lifetime)] if duration_s is not None else []),
        ]

    try:
        with Notifier.of_environment() as notifier:
            if notifier.watchdog_ns is not None:
                faulthandler.enable()  # the watchdog's SIGABRT then shows where every thread stands
            await app.run(
                config,
                ports,
                clock,
                stop=stop,
                on_started=on_started,
                extra_tasks=table,
                source=source,
                notifier=notifier,
                reload=reload,
                log_counts=LogCounts if lines is None else lines.counts,
                startup=startup,
            )
            if in_place_restart is not None and startup.starts_again:
                in_place_restart.request({**notifier.given, **restart.environment})
    finally:
        for number in SIGNALS:
            with contextlib.suppress(ValueError, RuntimeError):
                loop.remove_signal_handler(number)


def _hung_up(reload: ReloadRequests, stop: asyncio.Event, *, had_terminal: bool) -> None:
    """SIGHUP: the terminal went away, or somebody asks for the configuration to be read again."""
    (stop if had_terminal and not _has_terminal() else reload.requested).set()


def _has_terminal() -> bool:
    """Has this process a controlling terminal? It loses it before it gets the signal."""
    try:
        os.close(os.open("/dev/tty", os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK))
    except OSError:
        return False
    return True
