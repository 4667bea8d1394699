"""Plays a schedule of faults and judges it by the simulator's truth: no unsafe permit, and recovery. Pure.

A permit is an output of the PLC's program (docs/registers.md, "Use it only while it is alive"): the truck may move, or
loading may run. What is unsafe, from docs/visit.md and docs/reaction-time.md:

- loading begins at a truck that does not stand at the mark, or goes on at one that has left its place or at another
  truck, or while both permits are on;
- a truck may move that stands where D is 1 and was not released, that has left its place without release, or that was
  released and comes back;
- a drive's setpoint without enable and permit, or from which the vehicle, as fast as it truly is, could not stop before
  `guidance.overshoot_mm`, or within `drive.dead_band_mm` of its place;
- either permit while a sensor, the decision or the gateway is dead, later than docs/reaction-time.md guarantees.

Each is unsafe from the moment on at which the gateway must have noticed: `Limits.late_s`, made of the configuration's
deadlines. What no sensor can tell is taken into account: with the marker covered, an echo from where the truck stood is
that of the truck; and another truck that takes its place within no time, at the same place, is the same one.

A PLC whose program stands still is judged by docs/handshake.md, "Heartbeat": its deadline begins when the gateway
accepted the last heartbeat that counts, `Bay.beat_s`. That can be later than the program stopped. While the control
task is dead, writes are refused; the program's last number is then written again and again, and is a change when the
first of these writes is accepted: the gateway cannot know how old it is. And once the PLC is lost, the block may be
another's, whose heartbeat is the one that counts ("One writer at a time").

Recovery: once all faults have ended, the truck drives to WAITS_CM and may move within RECOVERY_S; then it drives to the
mark, and is in place within RECOVERY_S. Where R x Z of something else was taken for the marker's, that may need a clear
bay first (docs/visit.md, "Limits"): the truck drives out to CLEAR_CM and comes again; `Outcome.cleared`.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from gateway.core.state import FunctionCheck, Reason
from gateway.sim.ranger import faults_of
from gateway.sim.ranger_board import RangerFault
from gateway.sim.world import Truth
from tests.fault_bay import RELEASE, RESET, STEP_MS, Bay, bay_of
from tests.fault_schedules import SETTINGS, Fault, Schedule, undisturbed

SENSOR_MM = 17.0  # no distance of the simulated ranger is further off
SENSOR_PX = 3.0
SENSOR_S = 0.24  # two ranger cycles, the line on the wire, the service's step; a result of the camera needs less
SCAN_S = STEP_MS / 1000
RECOVERY_S = 7.0  # a board whose protocol version was wrong says hello every 5 s; then recovery_s and clear_hold_s
NEARER = (1, 3, 4, 5, 11)  # of register 62, guidance: forward, left, right, slow, drive up
CLEAR_CM, WAITS_CM, MARK_CM = 130.0, 40.0, 28.0


@dataclass
class Outcome:
    """What came of one schedule."""

    schedule: Schedule
    unsafe: list[str] = field(default_factory=list)
    recovered: bool = False
    stuck: str = ""  # why it did not recover, as the gateway reports it
    cleared: bool = False  # the bay had to be clear before the sensors agreed again
    moved_s: float = 0.0  # from the end of the faults until a truck may move
    placed_s: float = 0.0  # from there until it is in place, its way to the mark included
    simulated_s: float = 0.0
    driven: int = 0  # scans with a setpoint

    @property
    def failed(self) -> bool:
        return bool(self.unsafe) or not self.recovered


class Limits:
    """How late each thing may be noticed, s, for one configuration and PLC cycle."""

    def __init__(self, made: Schedule) -> None:
        config = SETTINGS[made.settings]
        self.config = config
        bay, plc = config.bays[0], config.modbus.handshake
        fusion, visit = bay.fusion, bay.visit
        slow = any(failure.fault is Fault.PLC_SLOW for failure in made.failures)
        cycle_s = made.cycle_ms / 1000 * (4 if slow else 1)
        chain_s = fusion.period_s + cycle_s + 2 * SCAN_S
        contradiction_s = fusion.cross_check.lasting_s if fusion.cross_check else fusion.scale_lasting_s
        self.late_s = (
            max(fusion.vision_deadline_s, fusion.range_deadline_s, contradiction_s + visit.hold_grace_s)
            + SENSOR_S
            + chain_s
        )
        camera_s, ranger_s = fusion.vision_deadline_s + chain_s, fusion.range_deadline_s + chain_s
        dead_s = max(0.25, 2 * fusion.period_s) + cycle_s + 2 * SCAN_S
        beat_s = plc.heartbeat_deadline_s + chain_s
        # Of docs/reaction-time.md, "Guaranteed": from the fault to both permits off.
        self.dead_s: dict[Fault, float] = {
            Fault.CAMERA_FREEZE: camera_s,
            Fault.CAMERA_LOST: camera_s,
            Fault.CAMERA_STUCK: camera_s,
            Fault.VISION_HUNG: camera_s,
            Fault.RANGER_SILENT: ranger_s,
            Fault.RANGER_STUCK: ranger_s,
            Fault.RANGER_UNPLUGGED: ranger_s,
            Fault.RANGER_WRONG_VERSION: ranger_s + SENSOR_S,
            Fault.RANGER_NO_ECHO: max(ranger_s, visit.hold_grace_s + chain_s) + SENSOR_S,
            Fault.RANGER_BACKLOG: ranger_s,
            Fault.CONTROL_DEAD: dead_s,
            Fault.LOOP_BLOCKED: cycle_s + SCAN_S,
            Fault.RESTARTED: cycle_s + SCAN_S,
            Fault.SUSPENDED: cycle_s + SCAN_S,
            Fault.FUNCTION_CHECK: chain_s,
        }
        self.beat_s = beat_s if config.modbus.writes and plc.heartbeat_required else None


class Judge:
    """Follows one run. `scan` at each scan of the PLC's program."""

    def __init__(self, made: Schedule, bay: Bay) -> None:
        self.made, self.bay, self.limits = made, bay, Limits(made)
        config = self.limits.config
        self.fusion, self.visit, self.guidance = config.bays[0].fusion, config.bays[0].visit, config.bays[0].guidance
        self.drive, self.writes = config.bays[0].drive, config.modbus.writes
        self.place: Truth | None = None  # where the truck was when loading was permitted last
        self.loading = bay.plc.permits(bay.t_s)[1]
        if self.loading or made.phase in ("held", "released"):
            self.place = bay.truth()
        self.away_s: float | None = None  # it has been away from there since
        self.left_s: float | None = None  # and had no release; cleared by what ends `moved`
        self.released: Truth | None = None  # farthest place of a truck that was released
        self.rose_s = bay.rose_s if made.phase == "released" else -9.0
        if made.phase == "released":
            self.released = bay.truth()
        self.at_mark_s: float | None = None
        self.nearer_s: float | None = None
        self.near_s: float | None = None  # too near to drive on since
        self.resumed_s = -9.0  # the gateway last ran again after it was stopped
        self.recent: deque[Truth] = deque(maxlen=round(self.limits.late_s / SCAN_S))
        self.began: dict[Fault, float] = {}

    def scan(self) -> Iterator[str]:
        """What is unsafe now."""
        bay = self.bay
        t_s, truth = bay.t_s, bay.truth()
        move, load = bay.plc.permits(t_s)
        active = {failure.fault for failure in bay.failures if failure.at_s <= t_s < failure.end_s}
        if active & {Fault.SUSPENDED, Fault.LOOP_BLOCKED, Fault.RESTARTED}:
            self.resumed_s = t_s
        self.recent.append(truth)
        self._follow(truth, t_s, load=load, active=active)
        if move and load:
            yield "both permits"
        words = bay.plc.words
        if words is not None and words[4] and words[62] in NEARER:
            yield f"stop is on, and the guidance is {words[62]}"
        if load:
            yield from self._loading(truth, t_s)
        if move:
            yield from self._moving(truth, t_s)
        if move or load:
            yield from self._dead(t_s, move=move)
        yield from self._driving(truth, t_s)
        self.loading = load

    def _late(self, since_s: float | None, t_s: float) -> bool:
        return since_s is not None and t_s - max(since_s, self.resumed_s) > self.limits.late_s

    def _follow(self, truth: Truth, t_s: float, *, load: bool, active: set[Fault]) -> None:
        if load and not self.loading:
            self.place, self.away_s, self.left_s, self.released = truth, None, None, None
        if self.place is not None:
            self.away_s = (t_s if self.away_s is None else self.away_s) if self._away(truth, self.place) else None
        if self.bay.rose_s > self.rose_s:
            self.rose_s = self.bay.rose_s
            self.released, self.left_s = truth, None
        if self.released is not None and truth.distance_mm > self.released.distance_mm:
            self.released = truth if truth.truck == self.released.truck else self.released
        far = truth.distance_mm > self.fusion.distance_threshold_mm + 600
        ends_moved = far or t_s - self.bay.reset_s < 0.3
        another = self.place is not None and truth.truck != self.place.truck
        if ends_moved or another or self.place is None or self.released is not None:
            self.left_s = None
        elif self.away_s is not None and self.left_s is None and self._echo_mm() is None:
            self.left_s = t_s

    def _away(self, truth: Truth, place: Truth) -> bool:
        """Surely not where it stood, as far as the sensors can tell; of another truck at its place they can not."""
        covered = not truth.marker_visible
        heard_mm = self._heard_mm(truth) if covered else truth.distance_mm
        if abs(heard_mm - place.distance_mm) > self.visit.band_mm + 2 * SENSOR_MM:
            return True
        shift_px = max(abs(truth.u_px - place.u_px), abs(truth.v_px - place.v_px))
        return not covered and shift_px > self.visit.band_share * place.radius_px + 4 * SENSOR_PX

    def _heard_mm(self, truth: Truth) -> float:
        """What the sound meets: the truck, or something nearer."""
        echo_mm = self._echo_mm()
        return truth.distance_mm if echo_mm is None else min(echo_mm, truth.distance_mm)

    def _echo_mm(self) -> float | None:
        return faults_of(self.bay.scenario, self.bay.world_s()).get(RangerFault.ECHO)

    def _loading(self, truth: Truth, t_s: float) -> Iterator[str]:
        if not self.loading and self._echo_mm() is None:
            # The sensors are late; and D is held until the truck is away_mm and away_px off the mark.
            nearest_mm = min(then.distance_mm for then in self.recent)
            slowest_mm_s = min(then.speed_mm_s for then in self.recent)
            if nearest_mm > self.fusion.distance_threshold_mm + self.fusion.away_mm + SENSOR_MM:
                yield f"loading begins at {truth.distance_mm:.0f} mm"
            if slowest_mm_s > self.guidance.still_mm_s + 10:
                yield f"loading begins at a truck that drives {truth.speed_mm_s:.0f} mm/s"
        if self._late(self.away_s, t_s) and self.place is not None:
            off_mm = truth.distance_mm - self.place.distance_mm
            yield f"loading, {off_mm:+.0f} mm from its place for {t_s - (self.away_s or 0):.2f} s, truck {truth.truck}"

    def _moving(self, truth: Truth, t_s: float) -> Iterator[str]:
        surely = (
            truth.distance_mm <= self.fusion.distance_threshold_mm - SENSOR_MM
            and truth.radius_px >= self.fusion.radius_threshold_px + SENSOR_PX
        )
        self.at_mark_s = (t_s if self.at_mark_s is None else self.at_mark_s) if surely else None
        if self.released is None and self._late(self.at_mark_s, t_s):
            yield f"may move at the mark, {truth.distance_mm:.0f} mm, not released"
        if self.released is not None:
            band_mm = self.visit.band_mm + 2 * SENSOR_MM
            nearer = truth.distance_mm < self.released.distance_mm - band_mm or truth.truck != self.released.truck
            wrong = nearer and surely
            self.nearer_s = (t_s if self.nearer_s is None else self.nearer_s) if wrong else None
            if self._late(self.nearer_s, t_s):
                yield f"may move though released and back again, {truth.distance_mm:.0f} mm, truck {truth.truck}"
        if self.writes and self._late(self.left_s, t_s):
            yield f"may move though it left its place without release, {truth.distance_mm:.0f} mm"

    def _driving(self, truth: Truth, t_s: float) -> Iterator[str]:
        words, drive = self.bay.plc.words, self.drive
        if words is None or drive is None:
            return
        if words[112] and not (words[110] and words[5] and not words[4]):
            yield f"a setpoint of {words[112]} mm/s, enable {words[110]}, may_move {words[5]}, stop {words[4]}"
        before = self.recent[-2] if len(self.recent) > 1 else truth
        closing_mm_s = max(0.0, (before.distance_mm - truth.distance_mm) / SCAN_S) if before.truck == truth.truck else 0
        past_mm = truth.distance_mm - self.fusion.distance_threshold_mm
        stopping_mm = closing_mm_s * (drive.lag_s + drive.latency_s) + closing_mm_s**2 / (2 * drive.brake_mm_s2)
        short = stopping_mm > past_mm + self.guidance.overshoot_mm
        there = past_mm + drive.place_mm <= drive.dead_band_mm - SENSOR_MM
        near = (short or there) and self.bay.plc.drives(t_s) > 0 and self._echo_mm() is None
        self.near_s = (t_s if self.near_s is None else self.near_s) if near else None
        if self._late(self.near_s, t_s):
            yield f"a setpoint at {truth.distance_mm:.0f} mm and {closing_mm_s:.0f} mm/s"

    def _dead(self, t_s: float, *, move: bool) -> Iterator[str]:
        what = "may move" if move else "loading"
        for failure in self.bay.failures:
            bound_s = self.limits.dead_s.get(failure.fault)
            on = failure.at_s <= t_s < failure.end_s
            if failure.fault is Fault.FUNCTION_CHECK and move and self.bay.check is FunctionCheck.MAY_MOVE_KEPT:
                continue  # as the technician chose
            if bound_s is not None and on and t_s - failure.at_s > bound_s + self._stalled_s(failure.at_s, t_s):
                yield f"{what} {t_s - failure.at_s:.2f} s after {failure.fault}"
            stopped = failure.fault is Fault.PLC_STOPPED and on and self.limits.beat_s is not None
            since_s = max(failure.at_s, self.bay.beat_s)
            if stopped and move and t_s - since_s > (self.limits.beat_s or 0) + self._stalled_s(since_s, t_s):
                yield f"may move {t_s - since_s:.2f} s after the PLC's last heartbeat, its program stopped"

    def _stalled_s(self, from_s: float, to_s: float) -> float:
        """For this time the gateway did not run meanwhile."""
        stalls = (Fault.SUSPENDED, Fault.LOOP_BLOCKED, Fault.RESTARTED)
        return sum(
            max(0.0, min(f.end_s, to_s) - max(f.at_s, from_s)) + self.limits.late_s
            for f in self.bay.failures
            if f.fault in stalls and f.at_s < to_s and f.end_s > from_s - self.limits.late_s
        )


def play(made: Schedule, tell: Callable[[str], None] | None = None) -> Outcome:
    """One schedule to its end. The same schedule gives the same outcome. `tell` gets each change of an output."""
    bay = bay_of(made)
    if tell is not None:
        bay.watch = Watch(tell)
    outcome = Outcome(made)
    judge = Judge(made, bay)
    plan = _writes(made)
    try:
        while bay.t_s < max(made.ends_s, 0.2) and not outcome.unsafe:
            bay.plc.bits = plan(bay.t_s)
            bay.step()
            outcome.unsafe += [f"{bay.t_s:.2f} s: {line}" for line in judge.scan()]
            outcome.driven += bay.plc.drives(bay.t_s) > 0
        if not outcome.unsafe:
            _recover(bay, outcome)
    except Exception as error:  # noqa: BLE001 - whatever is raised is a finding, with the seed that brings it
        outcome.unsafe.append(f"raised {error!r}")
    outcome.unsafe += bay.errors
    outcome.simulated_s = bay.t_s
    return outcome


class Watch:
    """Reports each change of what the gateway shows and of the permits."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._last: tuple[object, ...] = ()

    def __call__(self, bay: Bay) -> None:
        state, truth = bay.state, bay.truth()
        seen: tuple[object, ...] = (
            "D " + ("-" if state.d is None else str(int(state.d))),
            f"stop {state.stop:d} may_move {state.may_move:d} in_place {state.in_place:d}",
            "PLC: move {:d} load {:d}".format(*bay.plc.permits(bay.t_s)),
            state.reason.name.lower(),
            f"vision {state.vision.quality.name.lower()}",
            f"range {state.range.quality.name.lower()}",
            state.visit.phase.name.lower(),
            f"PLC {state.plc.link.name.lower()}",
        )
        if seen != self._last:
            self._last = seen
            radius_px = state.vision.circle.radius_px if state.vision.circle else 0.0
            measured = (
                f"truck {truth.distance_mm:.0f} mm, Z {state.range.distance_mm or 0:.0f} mm, R {radius_px:.0f} px"
            )
            self._tell(f"{bay.t_s:6.2f} s  {measured:<42} {'  '.join(map(str, seen))}")


def _writes(made: Schedule) -> Callable[[float], int]:
    """The PLC's bits: as in a real program, it releases a loaded truck in the phase that says so."""
    if made.phase != "released":
        return lambda t_s: 0
    until_s = (made.seed * 7 % 20) / 10  # the bit goes back somewhere on the way

    return lambda t_s: RELEASE if t_s < until_s else 0


def _recover(bay: Bay, outcome: Outcome) -> None:
    """A truck waits before the bay, then drives to the mark. The PLC resets what wants to be reset."""
    bay.failures = ()
    _comes(bay, outcome)
    learns = bay.config.bays[0].fusion.cross_check is None
    if outcome.stuck and learns and bay.state.reason is Reason.SENSORS_DISAGREE:
        outcome.cleared, outcome.stuck = True, ""
        bay.show(undisturbed(bay.truth(), CLEAR_CM))
        if _until(bay, bay.t_s, loads=False):
            _comes(bay, outcome)
        else:
            outcome.stuck = f"no may_move at {CLEAR_CM:g} cm: {_why(bay)}"
    outcome.recovered = not outcome.stuck
    z_mm = bay.truth().distance_mm
    if outcome.recovered and abs(z_mm - 10 * MARK_CM) > SENSOR_MM:
        outcome.unsafe.append(f"{bay.t_s:.2f} s: in place at {z_mm:.0f} mm, on its way")


def _comes(bay: Bay, outcome: Outcome) -> None:
    """To WAITS_CM, and to the mark."""
    bay.show(undisturbed(bay.truth(), WAITS_CM))
    begun_s = bay.t_s
    if not _until(bay, begun_s, loads=False):
        outcome.stuck = f"no may_move at {WAITS_CM:g} cm: {_why(bay)}"
        return
    outcome.moved_s = bay.t_s - begun_s
    bay.plc.bits = 0
    bay.show(undisturbed(bay.truth(), MARK_CM))
    begun_s = bay.t_s
    if _until(bay, begun_s, loads=True):
        outcome.placed_s = bay.t_s - begun_s
    else:
        outcome.stuck = f"not in place at {MARK_CM:g} cm: {_why(bay)}"


def _until(bay: Bay, begun_s: float, *, loads: bool) -> bool:
    while bay.t_s - begun_s < RECOVERY_S:
        # A truck that was in place has gone: an operator resets the stop after it.
        bay.plc.bits = RESET if not loads and int(bay.t_s * 2.5) % 2 else 0
        bay.step()
        # The permit may still be that of the truck before: this one has waited once the gateway has seen it there.
        if bay.plc.permits(bay.t_s)[loads] and (loads or bay.state.d is False):
            return True
    return False


def _why(bay: Bay) -> str:
    state = bay.state
    return (
        f"reason {state.reason.name.lower()}, vision {state.vision.quality.name.lower()}, "
        f"range {state.range.quality.name.lower()}, {state.visit.phase.name.lower()}, D {state.d}"
    )


def shrunk(made: Schedule) -> Schedule:
    """A schedule that still fails, with as few of the faults as leaving out one at a time can reach."""
    numbers = tuple(range(len(made.failures)))
    n = 0
    while n < len(numbers):
        fewer = numbers[:n] + numbers[n + 1 :]
        if play(made.only(fewer)).failed:
            numbers = fewer
        else:
            n += 1
    return made.only(numbers)
