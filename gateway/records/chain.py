"""The chain of causes: each change of the outputs, what entered the step that made it, and what led to it. Pure.

`links` follows replayed steps in order. A link is a change, or something earlier that led to one: the newest frame
before the camera was silent, the write that released a truck.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

from gateway.core import events
from gateway.core.fusion import Observation
from gateway.core.interlock import Rules
from gateway.core.marker_wear import MarkerWear
from gateway.core.plc import PlcConnection, PlcWrite
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import FunctionCheck, Reason, StateVector
from gateway.durations import NS_PER_S
from gateway.records import sentences as say
from gateway.records.factors import Cause, Factor, causes, position
from gateway.records.moment import unix_ns
from gateway.records.record import Decision
from gateway.records.replay import NoTick, Step
from gateway.records.segment import Head

FOLLOWED = ("stop", "may_move", "in_place", "moved", "reason", "latched", "function_check", "recipe")
RESTART_S = 10.0  # what was restarted this long before a change may have to do with it
MOST_BETWEEN = 12  # changes listed between the first and those round the moment


@dataclass(frozen=True, slots=True)
class Link:
    """`what`: which outputs changed; empty: it led to the link behind it. `by`: what entered the step. Unix ns."""

    unix_ns: int
    why: str
    what: str = ""
    by: str = ""
    factor: Factor | None = None


def links(steps: Iterable[Step], rules_of: Callable[[Head], Rules]) -> Iterator[Link]:
    """Every change of the outputs in these steps, each behind what led to it; the first step begins without one."""
    past = _Past()
    before: Step | None = None
    told: set[Link] = set()
    head, rules = None, Rules({})
    for step in steps:
        if step.place.head is not head:
            head = step.place.head
            rules = rules_of(head)
        if before is None or step.observation is None:
            past = _Past()
        old = None if before is None else before.state
        if before is not None and (step.observation is None or _followed(before.state) != _followed(step.state)):
            for link in _change(before, step, past, rules):
                if link not in told:  # a frame after which the camera was silent may have led to several changes
                    told.add(link)
                    yield link
        past.note(old if step.observation is not None else None, step, rules)
        before = step


def within(links: Iterable[Link], begin_ns: int, end_ns: int) -> list[Link]:
    """The changes of that time, each with what led to it, however long before."""
    found: list[Link] = []
    led: list[Link] = []
    for link in links:
        led.append(link)
        if link.what:
            found += led if begin_ns <= link.unix_ns <= end_ns else []
            led = []
    return found


def relevant(earlier: list[Link], before: list[Link], since_ns: int | None) -> tuple[Link, ...]:
    """The chain back to `since_ns`: the first change with what led to it, those between shortened, then the newest."""
    window_ns = before[0].unix_ns if before else None
    old = [link for link in earlier if window_ns is None or link.unix_ns < window_ns]
    if len(old) > 2 * MOST_BETWEEN:
        left_out = len(old) - 2 * MOST_BETWEEN
        told = Link(old[MOST_BETWEEN].unix_ns, say.MORE_CHANGES(left_out))
        old = [*old[:MOST_BETWEEN], told, *old[-MOST_BETWEEN:]]
    if since_ns is None:
        return (*old, *before)
    root = next((n for n, link in enumerate(before) if link.what and link.unix_ns >= since_ns), len(before))
    while root > 0 and not before[root - 1].what:
        root -= 1  # with what led to it
    return (*old, *before[root:])


def changed(was: Decision, now: Decision) -> str:
    """`stop 0 -> 1, reason none -> vision_stale`."""
    pairs = ((name, getattr(was, name), getattr(now, name)) for name in FOLLOWED)
    return ", ".join(f"{name} {_short(old)} -> {_short(new)}" for name, old, new in pairs if old != new)


def entered(observation: Observation | NoTick | None, old: StateVector | None, state: StateVector) -> str:
    """What entered the step that made `state` of `old`, in words."""
    text = say.TICK()
    match observation:
        case VisionReading():
            age_ms = (state.t_ns - observation.t_ns) / 1e6
            circle = observation.circle
            seen = observation.quality.name.lower() if circle is None else f"R {circle.radius_px:.1f} px"
            text = say.FRAME(observation.frame_id, f"{age_ms:.0f}", seen)
        case RangeReading():
            z_mm = observation.distance_mm
            text = say.OF_RANGER(observation.quality.name.lower() if z_mm is None else f"Z {z_mm:.0f} mm")
        case PlcWrite():
            changes = [] if old is None else events.changes(old.plc, state.plc)
            text = say.WRITE(observation.writer, ", ".join(map(str, changes)) or say.NOTHING_NEW())
        case PlcConnection():
            text = (say.CONNECTED if observation.open else say.DISCONNECTED)(observation.writer)
        case FunctionCheck():
            text = say.CHECK(observation.name.lower())
        case MarkerWear():
            text = say.WEAR()
        case NoTick():
            text = say.NO_TICK()
        case None:
            text = say.THE_END() if state.reason is Reason.SHUTDOWN else say.ANEW()
    return text


def _followed(state: StateVector) -> tuple[object, ...]:
    return (
        state.stop, state.may_move, state.reason, state.visit.in_place, state.visit.moved, state.memory.latched,
        state.function_check, state.plc.recipe,
    )  # fmt: skip


def _short(value: object) -> str:
    if isinstance(value, bool):
        return str(int(value))
    name = getattr(value, "name", None)
    return str(value) if name is None else str(name).lower()


def _change(before: Step, step: Step, past: "_Past", rules: Rules) -> Iterator[Link]:
    cause = causes(step.state, rules)[0]
    for led_ns, why in sorted(past.led_to(cause, before, step)):
        yield Link(led_ns, why, factor=cause.factor)
    what = changed(Decision.of(before.state), Decision.of(step.state))
    by = entered(step.observation, before.state, step.state)
    yield Link(_unix(step), cause.text, what or "the state", by, cause.factor)


def _unix(step: Step) -> int:
    return unix_ns(step.place.head, step.state.t_ns)


@dataclass(slots=True)
class _Past:
    """What the steps so far have shown, as far as it may lead to a change."""

    seen: StateVector | None = None  # the newest state with a marker
    heard: StateVector | None = None  # with a distance
    fitting: StateVector | None = None  # with both, and no contradiction pending
    large_ns: int | None = None  # R >= R_th since
    near_ns: int | None = None  # Z <= Z_th since
    target_ns: int | None = None  # D last became 1
    placed: tuple[int, str] | None = None  # when and where it was last in place
    ended: tuple[int, str] | None = None  # the last cause of a stop ended then
    restarts: deque[tuple[int, str]] = field(default_factory=lambda: deque(maxlen=4))

    def note(self, old: StateVector | None, step: Step, rules: Rules) -> None:
        state = step.state
        vision, rng, memory = state.vision, state.range, state.memory
        self.seen = state if vision.circle is not None else self.seen
        self.heard = state if rng.distance_mm is not None else self.heard
        if vision.circle is not None and rng.distance_mm is not None and memory.disagree_since_ns is None:
            self.fitting = state
        fusion = rules.recipes.get(state.plc.recipe, rules.recipes[0]).fusion
        large = vision.circle is not None and vision.circle.radius_px >= fusion.radius_threshold_px
        near = rng.distance_mm is not None and rng.distance_mm <= fusion.distance_threshold_mm
        self.large_ns = (self.large_ns or state.t_ns) if large else None
        self.near_ns = (self.near_ns or state.t_ns) if near else None
        if state.visit.in_place_since_ns is not None and state.visit.place is not None:
            self.placed = state.visit.in_place_since_ns, say.PLACED(position(state.visit.place))
        if state.d is True and (old is None or old.d is not True):
            self.target_ns = state.t_ns
        if old is None:
            return
        if memory.no_cause_since_ns is not None and old.memory.no_cause_since_ns is None:
            self.ended = (state.t_ns, causes(old, rules)[0].text)
        if memory.restarts != old.memory.restarts:
            self.restarts += ((state.t_ns, text) for text in _restarted(old, state))

    def led_to(self, cause: Cause, before: Step, step: Step) -> Iterator[tuple[int, str]]:
        """(Unix ns, in words), in any order."""
        if step.observation is None:
            return
        state, head = step.state, step.place.head
        for t_ns, text in self._of(cause.factor, before.state, state):
            yield unix_ns(head, t_ns), text
        if cause.factor in (Factor.CAMERA, Factor.RANGER):
            for t_ns, text in self.restarts:
                if state.t_ns - t_ns <= RESTART_S * NS_PER_S:
                    yield unix_ns(head, t_ns), text

    def _of(self, factor: Factor, old: StateVector, state: StateVector) -> Iterator[tuple[int, str]]:
        plc = state.plc
        if factor in (Factor.CAMERA, Factor.NO_TRUCK):
            yield from self._camera(old, state)
        if factor in (Factor.RANGER, Factor.NO_TRUCK):
            yield from self._ranger(state)
        if factor is Factor.CONTRADICTION:
            yield from self._contradiction(state)
        if factor is Factor.PLC_LOST and plc.owner_beats:
            yield plc.beat_ns, say.LAST_BEAT(plc.heartbeat, plc.owner)
        if factor in (Factor.MOVED, Factor.IN_PLACE, Factor.RELEASED):
            yield from self._place(old, state)
        if factor is Factor.TARGET and state.memory.pending_since_ns is None:
            yield self.large_ns or state.t_ns, say.R_FROM_HERE()
            yield self.near_ns or state.t_ns, say.Z_FROM_HERE()
        if factor is Factor.LATCH and self.target_ns is not None:
            yield self.target_ns, say.D_BECAME_1()
        of_this_stop = self.ended is not None and self.ended[0] == state.memory.no_cause_since_ns  # not an earlier one
        if factor in (Factor.HOLD, Factor.CLEAR) and self.ended is not None and of_this_stop:
            yield self.ended[0], say.LAST_CAUSE(self.ended[1])

    def _contradiction(self, state: StateVector) -> Iterator[tuple[int, str]]:
        if self.fitting is not None:
            yield self.fitting.t_ns, say.LAST_FITTING(_values(self.fitting))
        if (since_ns := state.memory.disagree_since_ns) is not None and since_ns != state.t_ns:
            yield since_ns, say.NO_FIT()

    def _camera(self, old: StateVector, state: StateVector) -> Iterator[tuple[int, str]]:
        if state.vision.quality is Quality.STALE:
            never, number = old.vision.quality is Quality.WAITING, old.vision.frame_id
            yield old.vision.t_ns, say.NO_FRAME_HERE() if never else say.NEWEST_FRAME(number)
            return
        if self.seen is not None and self.seen.vision.circle is not None:
            circle = self.seen.vision.circle
            where = f"{circle.radius_px:.1f}", f"{circle.u_px:.0f}", f"{circle.v_px:.0f}"
            yield self.seen.vision.t_ns, say.LAST_MARKER(self.seen.vision.frame_id, *where)

    def _ranger(self, state: StateVector) -> Iterator[tuple[int, str]]:
        if self.heard is not None and self.heard.range.distance_mm is not None:
            yield self.heard.range.t_ns, say.LAST_DISTANCE(f"{self.heard.range.distance_mm:.0f}")

    def _place(self, old: StateVector, state: StateVector) -> Iterator[tuple[int, str]]:
        visit = old.visit
        if self.placed is not None and visit.place is not None:
            yield self.placed
        if visit.covered_since_ns is not None and visit.place is not None:
            yield visit.covered_since_ns, say.COVERED_HERE()
        if not visit.in_place and state.visit.in_place and visit.still_since_ns is not None:
            yield visit.still_since_ns, say.STOOD_HERE()


def _restarted(old: StateVector, state: StateVector) -> Iterator[str]:
    was, now = old.vision.stats, state.vision.stats
    for count, before, text in (
        (now.restarts, was.restarts, say.REPLACED()),
        (now.reopens, was.reopens, say.CAMERA_OPENED()),
        (now.lost, was.lost, say.FRAME_LOST()),
        (state.range.stats.reopens, old.range.stats.reopens, say.PORT_OPENED()),
    ):
        if count > before:
            why = state.vision.detail
            yield say.COUNT_WHY(text, before, count, why) if why else say.COUNT(text, before, count)


def _values(state: StateVector) -> str:
    circle, z_mm = state.vision.circle, state.range.distance_mm
    assert circle is not None
    assert z_mm is not None
    return f"R {circle.radius_px:.1f} px, Z {z_mm:.0f} mm"
