"""The interface of a sink: it passes the states and events of every bay on to another system. Pure.

A sink gets a `SinkContext` and reports a `LinkStatus`; `gateway/sinks/registry.py` finds it. It must not hold up the
control path:

- `deliver` runs as a separate supervised task. It ends with LinkError when the link breaks, and is started again
  after the backoff in `reconnect`; it returns only after `close`.
- States are pulled (`newer`, `shown`): a slow sink skips states. It shows a bay through `shown` only, so that an old
  state never looks valid.
- Events are read from a bounded queue (`subscribe`), which drops and counts what a slow sink does not fetch. A sink
  that must have an event before anything else happens registers a listener (`listen`): it must return within
  microseconds and must not raise.
- `link` is read about once a second by the alarms and the pages, and must not wait.
"""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any, Protocol

from gateway.clock import Clock
from gateway.config import GatewayConfig, Reconnect
from gateway.config.strict.section import Section
from gateway.core.events import Event
from gateway.core.state import StateVector
from gateway.errors import SettingError  # noqa: F401 - sinks of others import it from here
from gateway.values.gateway_values import GatewayFacts


class EventQueue(Protocol):
    """A bounded queue of events; the oldest is dropped first, and counted."""

    @property
    def dropped(self) -> int: ...

    async def get(self) -> Event: ...

    def drain(self) -> list[Event]: ...


class Bays(Protocol):
    """What a sink sees of the hub."""

    @property
    def bays(self) -> tuple[str, ...]: ...

    def shown(self, bay: str, now_ns: int) -> StateVector:
        """The newest state as it may be shown at `now_ns` (monotonic)."""

    async def newer(self, bay: str, seq: int) -> int:
        """Wait for a state with a sequence number above `seq`; returns the newest one's."""

    def subscribe(self, limit: int = 1000) -> EventQueue:
        """The events of all bays from now on."""

    def listen(self, listener: Callable[[Event], None]) -> None:
        """`listener` is called with every event at once."""


ALARM_PRIORITIES = ("low", "medium", "high")


@dataclass(frozen=True, slots=True)
class ShownAlarm:
    """One alarm as it may be shown now. Times are the gateway's clock (monotonic). docs/alarms.md has the kinds."""

    id: str
    kind: str
    title: str
    priority: str  # of ALARM_PRIORITIES
    state: str  # of ISA-18.2, by its name
    unacknowledged: bool  # that state waits for an operator
    active: bool  # its cause holds
    since_ns: int  # in this state
    raised_ns: int | None = None  # last announced; None: never
    occurrences: int = 0
    detail: str = ""
    who: str = ""
    note: str = ""
    shelved_until_ns: int | None = None

    @property
    def normal(self) -> bool:
        return self.state == "normal"


@dataclass(frozen=True, slots=True)
class BayAlarms:
    """All alarms of a bay and of its gateway, the normal ones too, the most important first. Not `evaluated`: nothing
    looks at their causes now, so none of it may be shown but which alarms there are."""

    bay: tuple[ShownAlarm, ...] = ()
    gateway: tuple[ShownAlarm, ...] = ()
    evaluated: bool = False

    @property
    def unacknowledged(self) -> int:
        return sum(alarm.unacknowledged for alarm in (*self.bay, *self.gateway))

    @property
    def active(self) -> int:
        return sum(alarm.active for alarm in (*self.bay, *self.gateway))

    @property
    def by_priority(self) -> dict[str, int]:
        """How many are active, of each of ALARM_PRIORITIES."""
        active = [alarm.priority for alarm in (*self.bay, *self.gateway) if alarm.active]
        return {priority: active.count(priority) for priority in ALARM_PRIORITIES}

    @property
    def highest_priority(self) -> str | None:
        """Of the active ones; None: none is."""
        counts = self.by_priority
        return next((priority for priority in reversed(ALARM_PRIORITIES) if counts[priority]), None)


@dataclass(frozen=True, slots=True)
class AlarmStep:
    """One change of one alarm, numbered over all alarms since the start of the gateway. `t_ns`: the gateway's clock."""

    number: int
    t_ns: int
    alarm: str  # its id, as of ShownAlarm
    kind: str
    bay: str | None  # None: of the gateway itself
    title: str
    priority: str  # of ALARM_PRIORITIES
    event: str  # what happened, by its name in docs/alarms.md
    before: str  # state of ISA-18.2
    state: str  # since then
    detail: str = ""
    who: str = ""  # the user who did it; empty: nobody
    note: str = ""


AlarmSource = Callable[[str, int], BayAlarms]  # bay, now (monotonic ns); never waits


def no_alarms(bay: str, now_ns: int) -> BayAlarms:
    """Where nothing evaluates any."""
    return BayAlarms()


def no_alarm_steps(listener: Callable[[AlarmStep], None]) -> None:
    """Likewise."""


@dataclass(frozen=True, slots=True)
class StoreStatus:
    """The file in which a sink keeps undelivered events. `fault` is empty while the file works."""

    fault: str = ""
    faults: int = 0  # times it began to fail
    recovered: int = 0  # events found in it that an earlier start had not delivered
    unwritten: int = 0  # events that only memory holds now


@dataclass(frozen=True, slots=True)
class LinkStatus:
    """The link of one sink. Counters count since the start of the gateway."""

    sink: str  # name of its type
    connected: bool  # what is delivered now reaches the other system
    detail: str  # of `connected`, as text for display; without addresses, because /healthz is public
    peer: str = ""  # address of the other system, without a password
    events_lost: int = 0  # given up before the other system had them
    figures: dict[str, int] = field(default_factory=dict)  # counters and gauges by name, for /metrics
    store: StoreStatus | None = None  # None: the sink keeps events in memory only
    fault: str = ""  # why there is no connection, for the detail of an alarm; without a password
    alarms: dict[str, str] = field(default_factory=dict)  # of the gateway that it raises: id -> detail


@dataclass(frozen=True, slots=True)
class SinkContext:
    """What a sink is made of. `settings`: its section of the configuration. `boot`: random number of this start.
    `listen_to_alarms`: as Bays.listen, of each change of an alarm but those that are suppressed by design. `facts`: of
    the gateway itself, now; never waits."""

    config: GatewayConfig
    settings: Any
    bays: Bays
    clock: Clock
    boot: str
    resources: ExitStack  # closed after `close`
    alarms: AlarmSource = no_alarms
    listen_to_alarms: Callable[[Callable[[AlarmStep], None]], None] = no_alarm_steps
    facts: Callable[[], GatewayFacts] = GatewayFacts


class Sink(Protocol):
    """One configured sink; see above."""

    task: str  # name of its row in the supervisor's table
    reconnect: Reconnect

    @property
    def link(self) -> LinkStatus: ...

    async def deliver(self) -> None: ...

    async def close(self, timeout_s: float) -> object:
        """Deliver the final states and what is queued, beside a running `deliver` or without one, in `timeout_s`."""


@dataclass(frozen=True, slots=True)
class SinkType:
    """The record that a type of sink exports.

    `section`: the model of its table `[sinks.<name>]`. A sink with its own top-level section has `settings`
    instead, which reads it; None there: not configured. `checks`: what can be checked without connecting; each raises
    SettingError.
    """

    name: str
    open: Callable[[SinkContext], Sink]
    section: type[Section] | None = None
    settings: Callable[[GatewayConfig], object | None] = lambda config: None
    checks: Callable[[GatewayConfig], Sequence[Callable[[], object]]] = lambda config: ()
