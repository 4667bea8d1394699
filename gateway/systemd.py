"""What systemd gives a service: folders for its state, and a socket on which it reports its own. IO.

sd_notify(3), systemd.exec(5). Started otherwise, a gateway has neither, and nothing here has any effect.
"""

import os
import socket
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from gateway.clock import machine_ns

SYSTEM_FOLDER = Path("/var/lib/loading-gateway")
FEEDS = 4  # of the watchdog within its time: three may be lost
VARIABLES = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")
STATUS_NS = 2_000_000_000  # between two looks at the status where there is no watchdog
US_NS = 1000
START_NS = 60_000_000_000  # for a start in its own place, until the outputs are served


def state_directory() -> Path | None:
    """`StateDirectory=` of the unit, of several the first; None: there is none."""
    first = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
    return Path(first) if first else None


def default_folder() -> Path:
    """The gateway's folder for what it keeps, where the configuration names none: the one that systemd made for the
    service; the system's for root and for a user without a home; else the user's own."""
    if (given := state_directory()) is not None:
        return given
    try:
        home = Path.home()
    except RuntimeError:  # a user unknown to the system
        return SYSTEM_FOLDER
    return SYSTEM_FOLDER if os.geteuid() == 0 or not home.is_dir() else home / ".local" / "state" / "loading-gateway"


def state_folder(state_dir: str) -> Path | None:
    """Of the configuration's `state_dir`, which may be `auto`; None: nothing is kept."""
    if not state_dir:
        return None
    return default_folder() if state_dir == "auto" else Path(state_dir)


def runtime_directory() -> Path | None:
    """`RuntimeDirectory=` of the unit, in memory, of several the first; None: there is none."""
    first = os.environ.get("RUNTIME_DIRECTORY", "").split(":")[0]
    return Path(first) if first else None


def notify_address() -> str:
    """Of the service manager's datagram socket; empty: there is no manager."""
    return os.environ.get("NOTIFY_SOCKET", "")


class Notifier:
    """Sends this process's state to the service manager. Never waits, never raises.

    `address`: of the manager's datagram socket, a path or, with a leading `@`, an abstract name; empty: there is no
    manager. `watchdog_ns`: within it the manager must be told WATCHDOG=1 again; None: it does not ask for that.
    `lost`: messages that the manager did not take. `given`: the variables that were removed, for a start in its own
    place.
    """

    def __init__(self, address: str = "", watchdog_ns: int | None = None) -> None:
        self.watchdog_ns = watchdog_ns if address else None
        self.lost = 0
        self.given: dict[str, str] = {}
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        self._socket: socket.socket | None = None

    @classmethod
    def of_environment(cls) -> Self:
        """As systemd says. Children must not speak for the gateway: the variables are removed."""
        given = {name: os.environ.pop(name) for name in VARIABLES if name in os.environ}
        time_us, pid = given.get("WATCHDOG_USEC", ""), given.get("WATCHDOG_PID", "")
        meant = time_us.isascii() and time_us.isdigit() and pid in ("", str(os.getpid()))
        made = cls(given.get("NOTIFY_SOCKET", ""), int(time_us) * US_NS if meant else None)
        made.given = given
        return made

    def __enter__(self) -> Self:
        if self._address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.setblocking(False)
        return self

    def __exit__(self, *_: object) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def send(self, **variables: str) -> None:
        """One datagram, `NAME=value` on each line."""
        if self._socket is None or not variables:
            return
        text = "\n".join(f"{name}={' '.join(value.split())}" for name, value in variables.items())
        try:
            self._socket.sendto(text.encode(errors="backslashreplace"), self._address)
        except OSError:
            self.lost += 1


@dataclass(slots=True)
class ServiceState:
    """The gateway's state as the service manager sees it: READY=1 once outputs are served, STATUS= in words.

    The watchdog is fed by the control ticks of the bays and by nothing else: each bay must have ticked since it was fed
    last. A gateway whose event loop, or one bay's control task, does not run is ended and started again.
    """

    notifier: Notifier
    bays: Sequence[str]
    status: Callable[[], str] = lambda: ""
    now_ns: Callable[[], int] = machine_ns  # the manager's time is the machine's, not that of a simulation
    _waiting_for: set[str] = field(default_factory=set)
    _due_ns: int = 0
    _told: str = ""
    _ready: bool = False

    def __post_init__(self) -> None:
        self._waiting_for = set(self.bays)

    def on_tick(self, bay: str) -> None:
        """A control tick of this bay has been calculated."""
        self._waiting_for.discard(bay)
        if self._waiting_for or (now_ns := self.now_ns()) < self._due_ns:
            return
        time_ns = self.notifier.watchdog_ns
        self._due_ns = now_ns + (STATUS_NS if time_ns is None else time_ns // FEEDS)
        self._waiting_for = set(self.bays)
        self.notifier.send(**({} if time_ns is None else {"WATCHDOG": "1"}), **self._changed_status())

    def ready(self) -> None:
        """The outputs are served."""
        self._ready = True
        time_ns = self.notifier.watchdog_ns
        watchdog = {} if time_ns is None else {"WATCHDOG_USEC": str(time_ns // US_NS)}  # after a start in its own place
        self.notifier.send(READY="1", **watchdog, **self._changed_status())

    def reloading(self) -> None:
        """The configuration is read again."""
        if self._ready:
            self.notifier.send(RELOADING="1")

    def reloaded(self) -> None:
        """A gateway that was not ready before is not ready by this."""
        if self._ready:
            self.notifier.send(READY="1", **self._changed_status())

    def stopping(self, *, again: bool = False) -> None:
        """`again`: the same process starts again at once. To the manager that is a reload, with more time before the
        watchdog."""
        if not again:
            self.notifier.send(STOPPING="1", STATUS="ends: stop is on in every register")
            return
        watchdog = {} if self.notifier.watchdog_ns is None else {"WATCHDOG_USEC": str(START_NS // US_NS)}
        self.notifier.send(
            RELOADING="1",
            MONOTONIC_USEC=str(self.now_ns() // US_NS),
            **watchdog,
            STATUS="starts again: stop is on in every register",
        )

    def _changed_status(self) -> dict[str, str]:
        status = self.status()
        if status == self._told:
            return {}
        self._told = status
        return {"STATUS": status}
