"""What `run` and `simulate` share: logging, signals, a bounded life, and the exit code."""

import asyncio
import atexit
import contextlib
import faulthandler
import logging
import signal
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from gateway import app
from gateway.cli.output import LossyOutput
from gateway.clock import SystemClock
from gateway.config import GatewayConfig
from gateway.hub import Hub
from gateway.logs import setup as logs
from gateway.supervisor import Task
from gateway.systemd import Notifier

REPEATS_S = 10.0  # between two looks at what the log has not written
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def setup_logging(level: str, form: str = "text") -> Callable[[], None]:
    """One line a record on stderr; stdout belongs to the verb's own output. An unread log blocks nothing.

    To be called now and then: what is returned writes how often lines were repeated.
    """
    outlet = LossyOutput(sys.stderr)
    atexit.register(outlet.close)
    handler = logs.setup(level, form, outlet)
    atexit.register(partial(handler.report, all_of_them=True))  # before the outlet is closed
    # The MQTT library logs every lost broker as an error; the gateway reports its links itself.
    logging.getLogger("mqtt").setLevel(logging.CRITICAL)
    return handler.report


def shipped(*parts: str) -> Path:
    """A file of the project's config/ folder: beside the package in a checkout, inside it once installed."""
    package = Path(__file__).resolve().parent.parent
    beside = package.parent / "config"
    return (beside if (beside / "gateway.toml").is_file() else package / "shipped").joinpath(*parts)


async def serve(
    config: GatewayConfig,
    ports: app.Ports,
    clock: SystemClock,
    *,
    duration_s: float | None = None,
    on_started: Callable[[app.Running], None] = lambda _: None,
    extra_tasks: Callable[[Hub], Sequence[Task]] = lambda _: (),
    stop: asyncio.Event | None = None,
    source: str = "",
    report_repeats: Callable[[], None] = lambda: None,
) -> None:
    """`app.run` until a signal (SIGHUP: the terminal went away), `stop`, or `duration_s` of `clock` after the start.

    `report_repeats`: see `setup_logging`."""
    stop = stop or asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in SIGNALS:
        loop.add_signal_handler(number, stop.set)

    async def repeats() -> None:
        while True:
            await asyncio.sleep(REPEATS_S)
            report_repeats()

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
            )
    finally:
        for number in SIGNALS:
            with contextlib.suppress(ValueError, RuntimeError):
                loop.remove_signal_handler(number)
