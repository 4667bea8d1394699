"""A configuration with a fault, under a service manager: the file is waited for, or the manager would start the gateway
again once a second, and fill its log. Started otherwise, the fault is the end, with exit code 2."""

import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from gateway.config import GatewayConfig
from gateway.errors import ConfigError
from gateway.logs.setup import to_journal
from gateway.net.tls import stamps
from gateway.systemd import Notifier, notify_address

LOOK_S = 1.0  # between two looks at the file
PAUSE_S = 8.0  # the manager was told that the gateway ends: less than TimeoutStopSec= of the unit
TRY_S = 30  # also without a change: a certificate that it names may be there now


def wait_for_valid_config(load: Callable[[], GatewayConfig], path: Path) -> GatewayConfig:
    """What `load` returns. Raises ConfigError where no service manager has started this process."""
    address = notify_address()
    if not address:
        return load()
    # No Event: a handler runs in the midst of this thread, which may hold the lock that set() waits for.
    asked: list[int] = []
    tick = threading.Event()
    former = signal.signal(signal.SIGHUP, lambda number, _: asked.append(number))
    try:
        with Notifier(address) as notifier:
            reported = ""
            while True:
                seen = stamps([str(path)])
                try:
                    return load()
                except ConfigError as error:
                    if str(error) != reported:
                        reported = str(error)
                        _report(reported, notifier)
                for _ in range(round(TRY_S / LOOK_S)):
                    tick.wait(LOOK_S)
                    if asked or stamps([str(path)]) != seen:
                        break
                asked.clear()
    finally:
        signal.signal(signal.SIGHUP, former)


def pause(path: Path) -> None:
    """After a fault that only the running gateway could find, before the manager starts it again: PAUSE_S, or until the
    file is changed."""
    seen, tick = stamps([str(path)]), threading.Event()
    for _ in range(round(PAUSE_S / LOOK_S)):
        if tick.wait(LOOK_S) or stamps([str(path)]) != seen:
            break


def _report(fault: str, notifier: Notifier) -> None:
    lines = [*fault.split("\n"), "no register is served; waiting until the file is changed (gateway check FILE)"]
    prefix = "<3>" if to_journal(sys.stderr) else ""
    print("\n".join(f"{prefix}{line}" for line in lines), file=sys.stderr, flush=True)
    notifier.send(STATUS=f"waits for its configuration to be mended: {lines[0]}")
