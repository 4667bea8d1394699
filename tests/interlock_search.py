"""Every state that the real `interlock.step` can reach in a bounded space, judged by tests/stated_conditions.py.

The space is one configuration and a list of moves. A move is one observation (a reading with one of a few values, a
write, a function check, a restart) or a tick that lets `step_ms` pass; any move may follow any other, in any order, at
any time. The search is breadth first, so that the first history that ends in a fault is a shortest one.

Two states are taken for one when all that the future depends on is equal: every field of the state vector but those
in OUTPUTS_ONLY, with each time as an age. An age beyond the longest time constant that it is compared with is as any
older one, and one that nothing compares is left out. `unlike` tests that: it lets pairs of states that were taken for
one take every move, and compares what follows.
"""

import dataclasses
import random
from collections import deque
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter
from typing import Any, NamedTuple, get_type_hints

from gateway.config import GatewayConfig, parse
from gateway.core import interlock
from gateway.core.detection import Circle
from gateway.core.fusion import Observation
from gateway.core.interlock import Rules
from gateway.core.movement import DriveMemory
from gateway.core.plc import Control, PlcConnection, PlcWrite, Writer
from gateway.core.readings import DEAD, VISION_FINE, Quality, RangeReading, VisionReading
from gateway.core.retained import RetainedState
from gateway.core.shown import shown
from gateway.core.state import FunctionCheck, Reason, StateVector, Tick
from gateway.modbus.registers.register_map import encode
from tests.stated_conditions import Known, StatedConditions

MS = 1_000_000
T0 = 1_000_000_000_000
PLC, OTHER = Writer("10.0.0.9"), Writer("10.0.0.8")
STOP, MAY_MOVE, IN_PLACE, ENABLE, SPEED = 4, 5, 36, 110, 112  # addresses, as docs/registers.md has them
TRACK_NS = 1_000_000_000  # older distances say nothing about the speed

# What the next state does not depend on. A field that is not here counts, also one that is added later.
OUTPUTS_ONLY = frozenset(
    {
        # counters, texts and what is only published
        "bay", "seq", "heartbeat", "reason", "z_vision_mm", "t_ns",
        "vision.frame_id", "vision.x_n", "vision.y_n", "vision.detail", "vision.stats", "vision.stage_ns",
        "vision.ellipse", "vision.confidence", "vision.visible", "vision.contrast", "vision.tracking",
        "vision.predicted", "marker",
        "vision.picture", "range.seq", "range.detail", "range.stats",
        "memory.target_seen", "memory.restarts", "memory.restarted_ns",
        "plc.write_verdict", "plc.writes", "plc.conflicts",
        "plc.recipe_asked", "plc.recipe_verdict", "plc.reset_verdict",
        "visit.phase", "visit.ended", "visit.in_place_since_ns",
        "guidance.code", "guidance.amount_mm", "guidance.offset_u_px", "guidance.offset_v_px", "guidance.offset_mm",
        "guidance.to_go_mm",
        # as old as the newest tick, which the judge knows; `shown` is judged at each state
        "valid_until_ns",
        # the writes of the moves have a changed heartbeat or the same one, whatever its number
        "plc.heartbeat",
        # no move is a trigger: the age of the oldest echo and of the trigger have no reader
        "range.oldest_ns", "plc.trigger_ns", "plc.acquisition",
        # listed by `_learned_key` without their dates
        "memory.scale_samples", "memory.scale",
        # listed by `_track_key`
        "memory.track",
        # listed by `key` and `_drive_key`
        "memory.drive", "setpoint", "pose",
        # no bay of the spaces has a beacon
        "memory.beacon", "vision.beacon", "range.beacon",
    }
)  # fmt: skip


class Move(NamedTuple):
    """One thing that can happen. `seen` makes the observation at a time, of a gateway in that state."""

    name: str
    seen: Callable[[int, StateVector], Observation | None]  # None: the gateway restarts
    ms: int = 0  # that pass before it


@dataclass(frozen=True)
class Space:
    """A bounded space: configuration and moves. `learns`: what R x Z was learned counts for the future."""

    name: str
    why: str
    config: GatewayConfig
    moves: tuple[Move, ...]
    step_ms: int
    learns: bool = False

    @cached_property
    def rules(self) -> Rules:
        return Rules.of(self.config.bays[0], self.config)

    @cached_property
    def conditions(self) -> StatedConditions:
        return StatedConditions(self.config)

    @cached_property
    def limits_ns(self) -> Mapping[str, int]:
        """Time of the state vector -> the age from which on nothing distinguishes it from an older one.

        Compared by >=, that is the longest time constant that the age is compared with; by >, 1 ns more.
        """
        bay, plc = self.config.bays[0], self.config.modbus.handshake
        fusion, visit = bay.fusion, bay.visit
        lasting_s = fusion.cross_check.lasting_s if fusion.cross_check else fusion.scale_lasting_s
        hold_s = fusion.clear_hold_s if fusion.decision == "held" else 0.0
        latch_s = fusion.latch_leave_s if fusion.latch_stop else 0.0
        reached = {
            "memory.pending_since_ns": max(fusion.raise_debounce_s, fusion.clear_debounce_s),
            "memory.disagree_since_ns": lasting_s,
            "memory.no_cause_since_ns": hold_s,
            "memory.vision_failure.alive_since_ns": fusion.recovery_s,
            "memory.range_failure.alive_since_ns": fusion.recovery_s,
            "memory.absent_since_ns": latch_s,
            "visit.still_since_ns": visit.settle_s,
            "visit.covered_since_ns": max(visit.hold_limit_s, visit.hold_grace_s),
            "visit.unconfirmed_since_ns": visit.hold_grace_s,
            "visit.clear_since_ns": visit.leave_s,
            "visit.unseen_since_ns": visit.leave_s,
            "visit.usable_since_ns": hold_s,
            "cause_ns": hold_s,
            "doubt_ns": hold_s,
            "apart_ns": lasting_s,
            "contradiction_ns": visit.hold_grace_s,
            "stood_ns": visit.settle_s,
            "blind_ns": visit.hold_grace_s,
            "unseen_ns": visit.hold_limit_s,
            "clear_ns": max(visit.leave_s, latch_s),
            "alive_ns": fusion.recovery_s,
        }
        exceeded = {
            "vision.t_ns": max(fusion.vision_deadline_s, fusion.start_grace_s),
            "range.t_ns": max(fusion.range_deadline_s, fusion.start_grace_s),
            "plc.beat_ns": plc.heartbeat_deadline_s,
            "plc.owner_ns": plc.heartbeat_deadline_s,
            "beat_ns": plc.heartbeat_deadline_s,
            "tick_ns": self.rules.valid_for_ns / (1000 * MS),
        }
        limits = {name: round(s * 1000) * MS for name, s in reached.items()}
        return limits | {name: round(s * 1000) * MS + 1 for name, s in exceeded.items()}

    @cached_property
    def time_limits_ns(self) -> tuple[int, ...]:
        """In the order of TIMES."""
        return tuple(self.limits_ns[path] for path in TIMES)

    @cached_property
    def known_limits_ns(self) -> tuple[int, ...]:
        """In the order of the judge's times."""
        return tuple(self.limits_ns[name] for name in _KNOWN_TIMES)

    def named(self, name: str) -> int:
        return next(n for n, move in enumerate(self.moves) if move.name == name)


class Node(NamedTuple):
    """One reachable state, and what the judge knows there."""

    state: StateVector
    known: Known
    now_ns: int


@dataclass
class Found:
    """What a search has found so far."""

    states: int = 0
    transitions: int = 0
    depth: int = 0  # moves from a root; every state up to `depth` - 1 has been expanded, unless `left` is 0
    left: int = 0  # states that were not expanded; 0: the space is searched completely
    reached: dict[str, int] = field(default_factory=dict)  # situation -> states in it
    faults: list[tuple[str, list[str]]] = field(default_factory=list)  # complaint, history as names of moves
    unlike: list[str] = field(default_factory=list)
    compared: int = 0


def root(space: Space) -> Node:
    return Node(interlock.initial("bay1", T0, space.rules), space.conditions.start(T0), T0)


def taken(space: Space, node: Node, move: Move) -> Node:
    """The node after `move`. Raises whatever the step raises."""
    state, known, now_ns = node
    now_ns += move.ms * MS
    seen = move.seen(now_ns, state)
    if seen is None:
        state = interlock.initial("bay1", now_ns, space.rules, RetainedState.of(state))
        return Node(state, space.conditions.restarted(known, now_ns), now_ns)
    state = interlock.step(state, seen, now_ns, space.rules)
    return Node(state, space.conditions.after(known, seen, state, now_ns), now_ns)


def complaints(space: Space, node: Node) -> Iterator[str]:
    """What must not be at this node: by the stated conditions, in the registers, and once the ticks have ended."""
    state, known, now_ns = node
    yield from space.conditions.complaints(known, state, now_ns)
    image = encode(shown(state, now_ns), 0, "big")
    outputs = (state.stop, state.may_move, state.in_place, state.setpoint.enable, round(state.setpoint.speed_mm_s))
    if tuple(image[address] for address in (STOP, MAY_MOVE, IN_PLACE, ENABLE, SPEED)) != outputs:
        yield "the registers differ from the state"
    late_ns = state.valid_until_ns + 1
    late = encode(shown(state, late_ns), 0, "big")
    if (late[STOP], late[MAY_MOVE], late[IN_PLACE], late[ENABLE], late[SPEED]) != (1, 0, 0, 0, 0):
        yield "without ticks, the registers do not show stop alone"
    if late_ns - now_ns > 2 * max(space.rules.valid_for_ns, space.step_ms * MS):
        yield "a state is valid for too long"


# -- which states are one -------------------------------------------------------------------------------------------


def _paths(kind: type, prefix: str = "") -> Iterator[tuple[str, bool]]:
    """Every field that counts, with those of the records that are always there; and whether it is a time."""
    hints = get_type_hints(kind)
    for each in dataclasses.fields(kind):
        path = prefix + each.name
        if path in OUTPUTS_ONLY:
            continue
        inner = hints[each.name]
        if dataclasses.is_dataclass(inner) and isinstance(inner, type):
            # Of a reading the time counts, of the state as a whole it is 0.
            yield from _paths(inner, path + ".")
        else:
            yield path, each.name.endswith("_ns")


_PATHS = tuple(_paths(StateVector))
VALUES = tuple(path for path, is_time in _PATHS if not is_time)
TIMES = tuple(path for path, is_time in _PATHS if is_time)
_values, _times = attrgetter(*VALUES), attrgetter(*TIMES)
_KNOWN_TIMES = tuple(f.name for f in dataclasses.fields(Known) if f.name.endswith("_ns"))
_KNOWN_VALUES = tuple(f.name for f in dataclasses.fields(Known) if f.name not in {*_KNOWN_TIMES, "vision", "range"})
_KNOWN_VALUES = tuple(name for name in _KNOWN_VALUES if name != "beat")
_known_values, _known_times = attrgetter(*_KNOWN_VALUES), attrgetter(*_KNOWN_TIMES)
_sensor_values = attrgetter("quality", "mm", "circle", "was_dead")
_SENSOR_TIMES = ("vision.t_ns", "alive_ns", "range.t_ns", "alive_ns")
IN_PLACE_ONLY = frozenset({"blind_ns", "unseen_ns"})  # set anew when in_place begins


def key(space: Space, node: Node) -> Hashable:
    """Equal for two nodes that have the same future."""
    state, known, now_ns = node
    track = tuple([(now_ns - t, mm) for t, mm in state.memory.track if now_ns - t <= TRACK_NS])
    learned = _learned_key(state) if space.learns else None
    vision, rng, limits = known.vision, known.range, space.limits_ns
    sensors = (vision.t_ns, vision.alive_ns, rng.t_ns, rng.alive_ns)
    uncompared = _uncompared(state)
    return (
        _values(state),
        tuple([
            None if path in uncompared else age
            for path, age in zip(TIMES, _ages(_times(state), space.time_limits_ns, now_ns), strict=True)
        ]),
        track,
        _drive_key(state.memory.drive, now_ns),
        state.setpoint,
        learned,
        _known_values(known),
        known.beat is None,
        known.stood_at is not None and known.stood_at is known.place,
        tuple([
            None if name in IN_PLACE_ONLY and not known.in_place else age
            for name, age in zip(_KNOWN_TIMES, _ages(_known_times(known), space.known_limits_ns, now_ns), strict=True)
        ]),
        _sensor_values(vision),
        _sensor_values(rng),
        tuple(_ages(sensors, [limits[name] for name in _SENSOR_TIMES], now_ns)),
    )  # fmt: skip


def _ages(times: Sequence[int | None], limits_ns: Sequence[int], now_ns: int) -> list[int | None]:
    return [None if t is None else min(now_ns - t, limit) for t, limit in zip(times, limits_ns, strict=True)]


def _uncompared(state: StateVector) -> set[str]:
    """Times that nothing compares in this state, nor in a later one before they are set anew."""
    memory, found = state.memory, set()
    if state.vision.quality not in VISION_FINE and memory.vision_failure.alive_since_ns is None:
        found.add("vision.t_ns")
    if state.range.quality in DEAD - {Quality.STUCK} and memory.range_failure.alive_since_ns is None:
        found.add("range.t_ns")
    if state.plc.owner is None or state.plc.owner_beats:
        found.add("plc.owner_ns")
    if state.visit.place is None:
        found.add("visit.covered_since_ns")
    return found


def _drive_key(drive: DriveMemory, now_ns: int) -> Hashable:
    """All of it, with its times as ages and the setpoint's integral counted from now."""
    if drive == DriveMemory():
        return None
    movement, history = drive.movement, drive.history
    return (
        now_ns - history.t_ns,
        movement and (now_ns - movement.t_ns, dataclasses.replace(movement, t_ns=0)),
        (drive.still_mm, now_ns - drive.still_ns),
        tuple((now_ns - t_ns, mm - history.way_mm, mm_s) for t_ns, mm, mm_s in history.ways),
        drive.begun and (now_ns - drive.begun[0], drive.begun[1], drive.begun[2]),
        (history.follows_mm_s, drive.peak_mm_s, now_ns - drive.peak_ns),
        (drive.speed_mm_s, drive.rise_mm_s2, drive.run_mm_s, drive.cut, drive.lag_s, drive.slips_s),
        (drive.there, drive.tries, drive.tried_mm),
    )


def _learned_key(state: StateVector) -> Hashable:
    return tuple((sample.recipe, sample.radius_px, sample.distance_mm) for sample in state.memory.scale_samples)


# -- the search -----------------------------------------------------------------------------------------------------


def search(
    space: Space,
    roots: Sequence[Sequence[str]] = ((),),
    *,
    transitions: int,
    compare: float = 0.0,
    seed: int = 0,
    most_faults: int = 5,
    progress: Callable[[Found], None] = lambda _: None,
) -> Found:
    """Breadth first from the roots, which are histories from the start, up to so many transitions.

    `compare`: share of the states taken for one whose futures are compared. `progress` is called every 4096
    transitions; it may raise StopIteration to end the search.
    """
    found, chance = Found(), random.Random(seed)
    visited: dict[int, int] = {}  # hash of the key -> number of the node
    came: list[tuple[int, int]] = []  # by number: the node before, the move
    samples: dict[int, Node] = {}  # number -> node, for the comparison
    queue: deque[tuple[int, int, Node]] = deque()  # number, depth, node

    def add(node: Node, before: int, move: int, depth: int) -> int:
        digest = hash(key(space, node))
        number = visited.get(digest)
        if number is not None:
            if (sample := samples.pop(number, None)) is not None:
                found.compared += 1
                found.unlike += unlike(space, sample, node)
            return number
        number = visited[digest] = len(came)
        came.append((before, move))
        found.states += 1
        if compare and chance.random() < compare:
            samples[number] = node
        for situation in situations(node.state):
            found.reached[situation] = found.reached.get(situation, 0) + 1
        for complaint in complaints(space, node):
            found.faults.append((complaint, history(number)))
        queue.append((number, depth, node))
        return number

    def history(number: int) -> list[str]:
        names: list[str] = []
        while number > 0:
            number, move = came[number]
            names.append(space.moves[move].name)
        return names[::-1]

    for names in roots:
        node, number = root(space), add(root(space), 0, 0, 0)
        for name in names:
            named = space.named(name)
            node = taken(space, node, space.moves[named])
            number = add(node, number, named, 0)
    try:
        while queue and found.transitions < transitions and len(found.faults) < most_faults:
            number, depth, node = queue.popleft()
            found.depth = depth
            for n, move in enumerate(space.moves):
                found.transitions += 1
                add(taken(space, node, move), number, n, depth + 1)
                if found.transitions % 4096 == 0:
                    found.left = len(queue)
                    progress(found)
    except StopIteration:
        pass
    found.left = len(queue)
    return found


def unlike(space: Space, one: Node, other: Node) -> list[str]:
    """Moves after which two nodes differ that were taken for one."""
    differ = []
    for move in space.moves:
        a, b = taken(space, one, move), taken(space, other, move)
        said = [(n.state.stop, n.state.may_move, n.state.in_place, n.state.guidance.code) for n in (a, b)]
        if key(space, a) != key(space, b) or said[0] != said[1]:
            differ.append(f"{move.name}: {_difference(space, a, b)}")
    return differ


def _difference(space: Space, a: Node, b: Node) -> str:
    flat = [
        [*zip(VALUES, _values(n.state), strict=True), *zip(_KNOWN_VALUES, _known_values(n.known), strict=True)]
        for n in (a, b)
    ]
    return "; ".join(f"{x[0]} {x[1]} / {y[1]}" for x, y in zip(*flat, strict=True) if x != y) or "times"


def situations(state: StateVector) -> Iterator[str]:
    """What of docs/visit.md this state is an instance of: a search that reaches none of them shows nothing."""
    yield state.visit.phase.name.lower()
    if state.may_move:
        yield "may_move"
    if state.visit.moved:
        yield "moved"
    if state.visit.released and state.may_move and state.d is not False:
        yield "leaves though D is not 0"
    if state.memory.disagree:
        yield "contradiction"
    if state.reason is Reason.PLC_LOST:
        yield "PLC lost"
    if state.function_check is not FunctionCheck.OFF:
        yield "function check"
    if state.visit.restored:
        yield "in place before the restart"
    if state.setpoint.speed_mm_s:
        yield "driven"


# -- spaces ---------------------------------------------------------------------------------------------------------

PX_MM = 54_000.0  # R Z of the simulated marker: 180 px at 300 mm
MARK_MM, BACK_MM, ROLLED_MM, AWAY_MM = 280.0, 310.0, 340.0, 1100.0  # `back`: off the mark, within its band
_CIRCLES: Mapping[str, Circle] = {
    "mark": Circle(320.0, 240.0, 193.0),
    "back": Circle(320.0, 240.0, 174.0),
    "rolled": Circle(320.0, 240.0, 159.0),
    "away": Circle(320.0, 240.0, 49.0),
    "aside": Circle(430.0, 240.0, 193.0),
    "lamp": Circle(410.0, 180.0, 20.0),
}
_DISTANCES = {"mark": MARK_MM, "back": BACK_MM, "rolled": ROLLED_MM, "away": AWAY_MM}


def _camera(name: str) -> Move:
    circle = _CIRCLES.get(name)
    quality = Quality.GOOD if circle else Quality[name]
    return Move(f"camera:{name.lower()}", lambda now_ns, _: VisionReading(now_ns, quality, circle))


def _ranger(name: str) -> Move:
    mm = _DISTANCES.get(name)
    quality = Quality.GOOD if mm else Quality[name]
    return Move(f"ranger:{name.lower()}", lambda now_ns, _: RangeReading(now_ns, quality, mm))


def _plc(name: str, *bits: Control, who: Writer = PLC, alive: bool = True) -> Move:
    word = sum(1 << bit for bit in bits)

    def seen(_: int, state: StateVector) -> Observation:
        return PlcWrite(who, heartbeat=(state.plc.heartbeat + alive) & 0xFFFF, control=word)

    return Move(f"plc:{name}", seen)


def _moves(step_ms: int, camera: str, ranger: str, plc: Sequence[Move], checks: str) -> tuple[Move, ...]:
    return (
        Move("tick", lambda *_: Tick(), step_ms),
        *map(_camera, camera.split()),
        *map(_ranger, ranger.split()),
        *plc,
        *(Move(f"check:{name.lower()}", lambda *_, mode=FunctionCheck[name]: mode) for name in checks.split()),
        Move("restart", lambda *_: None),
    )


def _config(heartbeat: bool = True, **sections: Any) -> GatewayConfig:
    """Time constants of a few steps, so that a search can come to an end."""
    plc = {"heartbeat_deadline_s": 0.3, "heartbeat_required": heartbeat, "enable_required": False}
    data: dict[str, Any] = {
        "modbus": {"writes": True, "plc_addresses": [PLC.address, OTHER.address], "handshake": plc},
        "fusion": {
            "vision_deadline_s": 0.3, "range_deadline_s": 0.3, "start_grace_s": 0.3, "clear_hold_s": 0.3,
            "recovery_s": 0.3, "scale_lasting_s": 0.3, "latch_leave_s": 0.3, "period_s": 0.2,
        },
        "visit": {"settle_s": 0.3, "hold_limit_s": 0.6, "hold_grace_s": 0.3, "leave_s": 0.3},
    }  # fmt: skip
    for name, keys in sections.items():
        data[name] = data.get(name, {}) | keys
    return parse(data)


CHECKED = {"cross_check": {"focal_px": 600.0, "marker_radius_mm": 90.0, "lasting_s": 0.3}}
_IDLE, _RELEASE, _RESET = _plc("idle"), _plc("release", Control.RELEASE), _plc("reset", Control.RESET)
_STUCK = _plc("stuck-release", Control.RELEASE, alive=False)
_OTHER = _plc("other-release", Control.RELEASE, who=OTHER)
_STILL = Move("late-tick", lambda *_: Tick(), 260)  # the readings are fresh then, the decision was not valid
_GONE = Move("plc:disconnected", lambda *_: PlcConnection(PLC, open=False))


def spaces() -> dict[str, Space]:
    """By name."""
    every = "mark rolled away aside lamp NO_TARGET COASTED LINK_DOWN"
    made = (
        Space(
            "core",
            "the least that has every phase of a visit; searched to its end",
            _config(fusion=CHECKED),
            _moves(300, "mark rolled NO_TARGET LINK_DOWN", "mark rolled STUCK", (_IDLE, _RELEASE), ""),
            300,
        ),
        Space(
            "band",
            "a truck that leaves the mark, but not its band; release, reset, restart",
            _config(fusion=CHECKED),
            _moves(300, "mark back rolled NO_TARGET", "mark back rolled", (_IDLE, _RELEASE, _RESET), ""),
            300,
        ),
        Space(
            "visit",
            "each kind of reading, release, reset, function check, restart; R x Z by a cross-check",
            _config(fusion=CHECKED),
            _moves(300, every, "mark rolled away NO_ECHO UNSTABLE STUCK", (_IDLE, _RELEASE, _RESET, _STUCK),
                   "OFF MAY_MOVE_OFF MAY_MOVE_KEPT"),
            300,
        ),
        Space(
            "learned",
            "as visit, with R x Z compared with itself, as shipped",
            _config(),
            _moves(300, every, "mark rolled away NO_ECHO STUCK", (_IDLE, _RELEASE, _RESET), "OFF MAY_MOVE_OFF"),
            300,
            learns=True,
        ),
        Space(
            "latch",
            "as visit, with a latched stop",
            _config(fusion=CHECKED | {"latch_stop": True}),
            _moves(300, "mark rolled away aside lamp NO_TARGET LINK_DOWN", "mark rolled away NO_ECHO STUCK",
                   (_IDLE, _RELEASE, _RESET), "OFF MAY_MOVE_OFF"),
            300,
        ),
        Space(
            "owners",
            "two PLCs, one with a heartbeat that stands still, one that connects and leaves",
            _config(fusion=CHECKED),
            _moves(300, "mark rolled NO_TARGET", "mark rolled NO_ECHO", (_IDLE, _RELEASE, _STUCK, _OTHER, _GONE), ""),
            300,
        ),
        Space(
            "plain",
            'decision = "plain": equation 14 at every step',
            _config(fusion=CHECKED | {"decision": "plain"}),
            _moves(300, "mark rolled away aside lamp NO_TARGET LINK_DOWN", "mark rolled away NO_ECHO STUCK",
                   (_IDLE, _RELEASE, _RESET), "OFF MAY_MOVE_OFF"),
            300,
        ),
        Space(
            "shipped",
            "as visit, with the time constants as shipped and steps of 100 ms, and a control task that stands still",
            parse({"modbus": {"writes": True, "plc_addresses": [PLC.address, OTHER.address]}, "fusion": CHECKED}),
            _moves(100, every, "mark rolled away NO_ECHO UNSTABLE STUCK", (_IDLE, _RELEASE, _RESET, _STUCK, _STILL),
                   "OFF MAY_MOVE_OFF MAY_MOVE_KEPT"),
            100,
        ),
        Space(
            "drive",
            "as visit, with a drive and steps of 100 ms",
            _config(fusion=CHECKED, drive={"lag_s": 0.2, "latency_s": 0.1}),
            _moves(100, "mark rolled away lamp NO_TARGET LINK_DOWN", "mark back rolled away NO_ECHO STUCK",
                   (_IDLE, _RELEASE, _STUCK, _STILL), "OFF MAY_MOVE_OFF MAY_MOVE_KEPT"),
            100,
        ),
    )  # fmt: skip
    return {space.name: space for space in made}


def visits(space: Space) -> list[list[str]]:
    """Histories that lead to each phase of a visit, so that a short search begins in all of them."""
    names = {move.name for move in space.moves}
    steps = 300 // space.step_ms

    def lasting(camera: str, ranger: str, plc: str, for_s: float) -> list[str]:
        beat = [f"camera:{camera}", f"ranger:{ranger}", f"plc:{plc}", "tick"]
        return beat * round(for_s / 0.3 * steps)

    scale = 1 if space.step_ms == 300 else 3
    rolled = lasting("rolled", "rolled", "idle", 0.9 * scale)
    placed = rolled + lasting("mark", "mark", "idle", 2.4 * scale)
    covered = placed + lasting("no_target", "mark", "idle", 0.3)
    histories = [rolled, placed, covered]
    if "plc:release" in names:
        released = placed + lasting("mark", "mark", "release", 0.6 * scale)
        left = released + lasting("rolled", "rolled", "release", 0.9 * scale)
        histories += [released, left]
    histories.append(placed + lasting("rolled", "rolled", "idle", 0.6))
    if "camera:back" in names:
        histories.append(placed + lasting("back", "back", "idle", 0.9))
    histories.append([*placed, "restart", *lasting("mark", "mark", "idle", 0.3 * scale)])
    histories.append([*placed, "restart", *lasting("rolled", "rolled", "idle", 0.3 * scale)])
    return histories
