"""One bay's control task: a thin shell that feeds fusion, publishes each state as one record, and never waits."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace

from gateway.clock import Clock
from gateway.config import BayConfig, GatewayConfig
from gateway.core import details, events, fusion, interlock, visit_progress
from gateway.core.events import MAX_DETAIL_CHARS, Event, EventKind
from gateway.core.plc import PlcConnection, PlcWrite, Writer, WriteVerdict
from gateway.core.pose import Sight
from gateway.core.readings import RangeReading, VisionReading
from gateway.core.retained import RetainedState
from gateway.core.scale import possible_radii_px
from gateway.core.shown import valid
from gateway.core.state import FunctionCheck, Reason, StateVector, Tick
from gateway.core.visit_progress import VisitProgress
from gateway.core.visit_summary import VisitSummary
from gateway.durations import NS_PER_S
from gateway.hub import Hub
from gateway.marker_history import MarkerHistory
from gateway.net import rate_limit

log = logging.getLogger(__name__)

WRITE_EVENTS = frozenset(
    {EventKind.PLC_WRITE, EventKind.WRITE_REFUSED, EventKind.OWNER_CHANGED, EventKind.RECIPE_CHANGED}
)
CHECK_EVENTS = frozenset({EventKind.FUNCTION_CHECK_BEGUN, EventKind.FUNCTION_CHECK_ENDED})


# What entered the control step (None: nothing), the state after it, what happened, and the visit that goes on, if it is
# asked for. It must not wait or raise.
Recorder = Callable[[fusion.Observation | None, StateVector, Sequence[Event], Callable[[], VisitSummary | None]], None]


def _no_watchdog(bay: str) -> None:
    """Nothing needs to know of the ticks."""


class BayControl:
    """Observations in, states out. All methods run on the event loop and return at once."""

    def __init__(
        self,
        config: BayConfig,
        hub: Hub,
        clock: Clock,
        mirrors: tuple[Callable[[StateVector], None], ...] = (),
        gateway: GatewayConfig | None = None,  # for recipes and writes; None: without both
        retained: RetainedState | None = None,  # from before the restart
        untried: Sequence[str] = (),  # keys that differ from those last tried: why it begins with a function check
        record: Recorder | None = None,
        ticked: Callable[[str], None] = _no_watchdog,  # called with the bay's name after each control tick
        marker: MarkerHistory | None = None,  # None: one that is kept in memory
    ) -> None:
        self.name = config.name
        self._config = config.fusion
        self._hub = hub
        self._clock = clock
        self._mirrors = mirrors
        self._record = record
        self._ticked = ticked
        self._shut_down = False
        self._rules = interlock.Rules.of(config, gateway)
        self._buckets = {kind: rate_limit.Bucket() for kind in WRITE_EVENTS}
        self._visits = VisitProgress()  # read by nothing that decides
        self._waiting: dict[type, VisionReading | RangeReading] = {}  # came while the control task did not run
        state = interlock.initial(self.name, clock.now_ns(), self._rules, retained)
        detail = details.KEPT[bool(state.function_check), state.visit.restored]
        started = Event(EventKind.START, self.name, state.t_ns, state, detail=detail)
        begun = Event(EventKind.FUNCTION_CHECK_BEGUN, self.name, state.t_ns, state, detail=_untried(untried))
        self._publish(state, [started, *([begun] if state.function_check and untried else [])])
        self._marker = marker or MarkerHistory(config.camera.picture)
        if self._marker.wear is not None:
            self._step(self._marker.wear)

    def on_reading(self, reading: VisionReading | RangeReading) -> None:
        """While the control task does not run, the newest of each sensor waits for it: numbers and counters stand."""
        if valid(self._hub.state(self.name), self._clock.now_ns()):
            self._step(reading)
        else:
            self._waiting[type(reading)] = reading

    def on_write(self, write: PlcWrite) -> WriteVerdict:
        """Take a write to the handshake block, if its writer may make it.

        A write must not make a bay look alive whose control task is dead.
        """
        if self._shut_down or not valid(self._hub.state(self.name), self._clock.now_ns()):
            return WriteVerdict.UNDECIDED
        self._step(write)
        return self._hub.state(self.name).plc.write_verdict or WriteVerdict.UNDECIDED

    def on_connection(self, change: PlcConnection) -> None:
        """A permitted writer has connected or disconnected. It matters only for the owner of the block."""
        owner = self._hub.state(self.name).plc.owner
        if owner is not None and owner.identity == change.writer.identity:
            self._step(change)

    def on_refused(self, writer: Writer, why: str) -> None:
        """A write was refused. Reported without a new state: it must not make a dead bay look alive."""
        now_ns = self._clock.now_ns()
        detail = f"{writer}: {why}"
        refused = Event(EventKind.WRITE_REFUSED, self.name, now_ns, self.state(), detail=detail, writer=writer)
        if reported := self._rate_limited([refused]):  # thousands of tries by a scanner cost only a counter
            self._report(self._hub.state(self.name), reported)

    def check_function(self, mode: FunctionCheck, who: Writer | None = None) -> None:
        """A technician begins a function check, or ends it."""
        self._step(mode, by=who)

    def check_untried(self, untried: Sequence[str], who: Writer) -> None:
        """Other keys than those last tried come into force: a bay at work begins a function check."""
        if untried and self._hub.state(self.name).function_check is FunctionCheck.OFF:
            log.warning("%s: %s: a function check begins", self.name, _untried(untried))
            self.check_function(FunctionCheck.MAY_MOVE_OFF, who)

    def vision_changed(self, config: BayConfig) -> None:
        """Other settings of vision are in effect."""
        self._rules = replace(self._rules, sight=Sight.of(config))

    def settings_changed(self, what: str, who: Writer) -> None:
        """Other settings were put into effect: an event for the record."""
        self.report(EventKind.SETTINGS_CHANGED, f"{who}: {what}")

    def mark(self, note: str, who: Writer) -> None:
        """A person wants this moment to be looked at later: an event, with pictures where they are recorded."""
        self.report(EventKind.OPERATOR_MARK, f"{who}: {note}" if note else str(who))

    def report(self, kind: EventKind, detail: str) -> None:
        """What people have done, as an event: the state stays as it is."""
        happened = Event(kind, self.name, self._clock.now_ns(), self.state(), detail=detail)
        self._report(self._hub.state(self.name), [happened])

    def resume_visit(self, earlier: VisitSummary) -> None:
        """The visit that was open when the gateway ended before goes on, or has ended meanwhile."""
        self._visits, ended = visit_progress.resumed(self._visits, earlier, self._clock.wall_ns())
        if found := _of_visit(self.state(), ended):
            self._report(self._hub.state(self.name), found)
        self._follow_marker(ended)

    def open_visit(self) -> VisitSummary | None:
        """The visit that goes on, as far as it is known; None: no visit."""
        return self._visits.open(self._hub.state(self.name).t_ns)

    async def run(self) -> None:
        """Tick for ever: ages grow, the heartbeat counts."""
        period_ns = round(self._config.period_s * NS_PER_S)
        due_ns = self._clock.now_ns()
        while True:
            self._step(Tick())
            waiting, self._waiting = self._waiting, {}
            for reading in waiting.values():
                self._step(reading)
            if not self._shut_down:
                self._ticked(self.name)
            now_ns = self._clock.now_ns()
            due_ns = max(due_ns + period_ns, now_ns - period_ns)  # keeps its pace; what was missed is not made up for
            await self._clock.sleep(max(0, due_ns - now_ns) / NS_PER_S)

    def state(self) -> StateVector:
        """The state as it may be shown now."""
        return self._hub.shown(self.name, self._clock.now_ns())

    def marker_radii_px(self) -> tuple[float, float] | None:
        """Which radii the marker can have where the ranger has the truck now, by what was learned; None: unknown."""
        config = self._config
        if config.cross_check is not None or config.decision != "held" or not config.scale_tolerance:
            return None
        state = self.state()
        return possible_radii_px(
            state.memory.scale, state.range.distance_mm, state.guidance.closing_mm_s, config.scale_tolerance
        )

    def shut_down(self) -> None:
        """The final state: stop on, no values, and no observation changes it any more."""
        if self._shut_down:
            return
        self._shut_down = True
        old = self._hub.state(self.name)
        new = fusion.forced_stop(old, Reason.SHUTDOWN, self._clock.now_ns())
        kinds = (EventKind.OUTPUTS_WITHDRAWN, EventKind.STOP_RAISED)
        stop_raised = [event for event in events.diff(old, new) if event.kind in kinds]
        self._publish(new, [*stop_raised, Event(EventKind.SHUTDOWN, self.name, new.t_ns, new)])

    def _step(self, observation: fusion.Observation, by: Writer | None = None) -> None:
        if self._shut_down:
            return
        old = self._hub.state(self.name)
        new = interlock.step(old, observation, self._clock.now_ns(), self._rules)
        written = events.of_write(old, new, observation) if isinstance(observation, PlcWrite) else []
        happened = events.diff(old, new)
        if by is not None:
            happened = [replace(e, detail=str(by)) if e.kind in CHECK_EVENTS else e for e in happened]
        self._visits, ended = visit_progress.step(
            self._visits, old, new, self._rules.limits(new.plc.recipe), self._clock.wall_ns()
        )
        self._publish(new, [*self._rate_limited([*written, *happened]), *_of_visit(new, ended)], observation)
        self._follow_marker(ended)

    def _follow_marker(self, ended: VisitSummary | None) -> None:
        if ended is not None and (wear := self._marker.visited(ended)) is not None:
            self._step(wear)

    def _rate_limited(self, happened: list[Event]) -> list[Event]:
        """Without those about writes that arrive too fast to be read; these are counted."""
        kept: list[Event] = []
        for event in happened:
            if event.kind not in WRITE_EVENTS:
                kept.append(event)
                continue
            self._buckets[event.kind], suppressed = rate_limit.take(self._buckets[event.kind], event.t_ns)
            if suppressed is not None:
                detail = details.NOT_REPORTED(event.detail, suppressed) if suppressed else event.detail
                kept.append(replace(event, detail=detail))
        return kept

    def _publish(
        self, state: StateVector, happened: list[Event], observation: fusion.Observation | None = None
    ) -> None:
        for mirror in self._mirrors:
            mirror(state)
        self._report(state, happened, observation)

    def _report(self, state: StateVector, happened: list[Event], observation: fusion.Observation | None = None) -> None:
        self._hub.publish(state, happened)
        if self._record is not None:
            self._record(observation, state, happened, self.open_visit)
        for event in happened:
            log.info(
                "%s: %s%s%s",
                self.name,
                event.kind.value.replace("_", " "),
                f" ({event.sensor} {event.quality.name.lower()})" if event.sensor else "",
                f": {event.detail}" if event.detail else f", reason {state.reason.name.lower()}",
                extra={"fields": _fields(event, state)},
            )


def _fields(event: Event, state: StateVector) -> dict[str, str | float | None]:
    """Of a log line, for programs. None: not known now."""
    circle = state.vision.circle
    return {
        "bay": state.bay,
        "event": event.kind.value,
        "radius_px": None if circle is None else round(circle.radius_px, 1),
        "distance_mm": None if state.range.distance_mm is None else round(state.range.distance_mm, 1),
        "reason": state.reason.name.lower(),
    }


def _untried(keys: Sequence[str]) -> str:
    return details.UNTRIED(", ".join(keys))[:MAX_DETAIL_CHARS]


def _of_visit(state: StateVector, ended: VisitSummary | None) -> list[Event]:
    if ended is None:
        return []
    return [Event(EventKind.VISIT, state.bay, state.t_ns, state, detail=ended.text, summary=ended)]
