"""The speed setpoint: a vehicle in virtual time that follows it, and when it must be 0."""

import random
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.config import GatewayConfig, decision, parse
from gateway.config.strict.errors import FaultsError
from gateway.core import drive, interlock, lag, movement, stopping_way
from gateway.core.detection import Circle
from gateway.core.interlock import Rules
from gateway.core.movement import DriveMemory, Movement
from gateway.core.plc import Control, PlcWrite, Writer
from gateway.core.readings import AgeProof, Quality, RangeReading, VisionReading
from gateway.core.setpoint import DriveState, Setpoint
from gateway.core.setpoint_history import SetpointHistory
from gateway.core.state import FunctionCheck, Reason, StateVector, Tick, Visit, VisitPhase

pytestmark = pytest.mark.one_interpreter

MS = 1_000_000
T0 = 1_000_000_000_000
PX_MM = 54_000.0
CHECK = {"focal_px": 540.0, "marker_radius_mm": 100.0}
PLACE_MM = 290.0  # Z_th 300, R_th 178 px at 303 mm, place_mm 10


def config(drive: Mapping[str, Any] | None = None, **sections: Any) -> GatewayConfig:
    fusion = {"radius_threshold_px": 178.0, "cross_check": CHECK}
    return parse({"fusion": fusion, "drive": drive or {}} | sections)


def rules(drive: Mapping[str, Any] | None = None) -> Rules:
    made = config({"latency_s": 0.3} | dict(drive or {}))
    return Rules.of(made.bays[0], made)


@dataclass
class Vehicle:
    """Follows the setpoint `lag_s` late and within its brake; a ranger with steps, noise and a median sees it, and a
    camera."""

    rules: Rules
    at_mm: float
    lag_s: float = 0.5
    brake_mm_s2: float = 150.0
    seed: int = 1
    poll_ms: int = 100
    follows: bool = True
    drops: float = 0.02
    lost_ms: int | None = None  # from then on no poll is answered; the life sign ends `latency_s` after the last one
    frozen_mm: float = 0.0  # the ranger hears nothing that is nearer
    repeats_ms: int | None = None  # from then on both sensors show where it was then
    dead: bool = False  # then without noise
    now_ms: int = 0
    speed_mm_s: float = 0.0
    nearest_mm: float = field(init=False)
    states: list[StateVector] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.chance = random.Random(self.seed)
        self.state = interlock.initial("bay1", T0, self.rules)
        self.polled: deque[tuple[int, float]] = deque([(0, 0.0)])
        self.echoes: deque[tuple[int, float]] = deque(maxlen=3)
        self.coming: list[tuple[int, RangeReading | VisionReading]] = []
        self.nearest_mm = self.seen_mm = self.at_mm

    @property
    def now_ns(self) -> int:
        return T0 + self.now_ms * MS

    def _noise_px(self) -> float:
        repeats = self.repeats_ms is not None and self.now_ms >= self.repeats_ms
        return 0.0 if self.dead and repeats else self.chance.gauss(0, 0.3)

    def runs(self, seconds: float) -> None:
        for _ in range(round(seconds * 50)):
            self._step()

    def _step(self) -> None:
        while len(self.polled) > 1 and self.polled[1][0] <= self.now_ms - self.lag_s * 1000:
            self.polled.popleft()
        told = self.polled[0][1] if self.polled[0][0] <= self.now_ms - self.lag_s * 1000 else 0.0
        if self.follows:
            rise = (told - self.speed_mm_s) / 0.15
            self.speed_mm_s += max(-self.brake_mm_s2, min(120.0, rise)) * 0.02
            if told == 0 and self.speed_mm_s < 0.5:
                self.speed_mm_s = 0.0
        self.at_mm -= self.speed_mm_s * 0.02
        self.nearest_mm = min(self.nearest_mm, self.at_mm)
        if self.repeats_ms is None or self.now_ms < self.repeats_ms:
            self.seen_mm = self.at_mm
        if self.now_ms % 60 == 0 and self.chance.random() >= self.drops:
            heard_mm = max(self.seen_mm, self.frozen_mm)
            self.echoes.append((self.now_ns, round((heard_mm + self.chance.gauss(0, 1.5)) / 4) * 4.0))
            if len(self.echoes) == 3:
                middle_mm = sorted(mm for _, mm in self.echoes)[1]
                self.coming.append((40, RangeReading(self.echoes[1][0], Quality.GOOD, middle_mm)))
        if self.now_ms % 80 == 0:
            circle = Circle(320.0, 240.0, PX_MM / self.seen_mm + self._noise_px())
            self.coming.append((60, VisionReading(self.now_ns, Quality.GOOD, circle)))
        due = [seen for left, seen in self.coming if left <= 0]
        self.coming = [(left - 20, seen) for left, seen in self.coming if left > 0]
        for seen in [*due, Tick()]:
            self.state = interlock.step(self.state, seen, self.now_ns, self.rules)
            self.states.append(self.state)
        drive_config = self.rules.recipes[0].drive
        latency_ms = drive_config.latency_s * 1000 if drive_config else 0
        if self.lost_ms is not None and self.now_ms >= self.lost_ms:
            if self.now_ms >= self.lost_ms - self.lost_ms % self.poll_ms + latency_ms:
                self.polled.append((self.now_ms, 0.0))
        elif self.now_ms % self.poll_ms == 0:
            self.polled.append((self.now_ms, self.state.setpoint.speed_mm_s))
        self.now_ms += 20


@pytest.mark.mostly_long(short=1)
@pytest.mark.parametrize(("lag_s", "at_mm"), [(0.5, 1500.0), (0.15, 900.0), (1.0, 700.0)])
def test_a_vehicle_comes_to_its_place_without_passing_it(lag_s: float, at_mm: float) -> None:
    vehicle = Vehicle(rules({"lag_s": max(0.5, lag_s)}), at_mm, lag_s)
    vehicle.runs(20 if lag_s < 1 else 30)
    assert vehicle.state.setpoint.state is DriveState.AT_PLACE
    assert vehicle.state.in_place
    assert abs(vehicle.at_mm - PLACE_MM) <= 10.0
    assert vehicle.nearest_mm >= PLACE_MM - 10.0
    assert max(state.setpoint.speed_mm_s for state in vehicle.states) > 100.0


@pytest.mark.parametrize("frozen_mm", [340.0, 600.0, 1000.0])
def test_a_ranger_that_freezes_on_the_way_does_not_let_the_vehicle_pass_the_limit(frozen_mm: float) -> None:
    """Nor does it go on: camera and ranger contradict each other."""
    vehicle = Vehicle(rules(), frozen_mm + 100.0, frozen_mm=frozen_mm)
    vehicle.runs(10)
    assert vehicle.nearest_mm < frozen_mm - 50.0
    assert vehicle.nearest_mm >= 200.0
    assert vehicle.state.reason is Reason.SENSORS_DISAGREE
    assert vehicle.state.setpoint == Setpoint(DriveState.INHIBITED, stopping_mm=vehicle.state.setpoint.stopping_mm)


@pytest.mark.parametrize("frozen_mm", [308.0, 320.0])
def test_nor_near_the_place_with_a_focal_length_that_is_wrong_by_6_percent(frozen_mm: float) -> None:
    """The two agree for longer then. By R alone, which is R_th at 303 mm, the vehicle is nearer than the ranger says:
    without that it comes to 203 mm, and 3 mm nearer with another noise."""
    fusion = {"radius_threshold_px": 178.0, "cross_check": {"focal_px": 540.0 * 1.06, "marker_radius_mm": 100.0}}
    made = config({"latency_s": 0.3}, fusion=fusion)
    vehicle = Vehicle(Rules.of(made.bays[0], made), frozen_mm + 100.0, frozen_mm=frozen_mm)
    vehicle.runs(14)
    assert 207.0 < vehicle.nearest_mm < 260.0
    assert (vehicle.speed_mm_s, vehicle.state.setpoint.speed_mm_s) == (0.0, 0.0)


@pytest.mark.mostly_long(short=1)
@pytest.mark.parametrize("repeats_ms", [3000, 2200, 4500])
def test_sensors_that_repeat_what_they_saw_together_do_not_let_the_vehicle_pass_the_limit(repeats_ms: int) -> None:
    """They agree with each other: only what was set tells that the vehicle is not there any more."""
    vehicle = Vehicle(rules(), 1500.0, repeats_ms=repeats_ms, dead=True)
    vehicle.runs(repeats_ms / 1000)
    assert vehicle.speed_mm_s > 20
    vehicle.runs(20)
    assert (vehicle.state.setpoint.state, vehicle.state.setpoint.speed_mm_s) == (DriveState.INHIBITED, 0.0)
    assert vehicle.nearest_mm > 300.0, "before its place, and for as long as nothing else is seen"
    vehicle.repeats_ms = None
    vehicle.runs(20)
    assert vehicle.state.setpoint.state is DriveState.AT_PLACE


def test_nor_is_a_slow_creep_speed_forgotten_before_it_adds_up() -> None:
    """At 10 mm/s, what is kept of the setpoint is less than 60 mm; and the ranger's noise is no movement."""
    vehicle = Vehicle(rules({"creep_speed_mm_s": 10}), 900.0, repeats_ms=5500, dead=True)
    vehicle.runs(30)
    assert (vehicle.state.setpoint.state, vehicle.speed_mm_s) == (DriveState.INHIBITED, 0.0)
    assert vehicle.nearest_mm > 200.0


@pytest.mark.parametrize(("overshoot_mm", "repeats_ms"), [(60.0, 6300), (50.0, 5900)])
def test_nor_do_they_where_the_limit_is_less_than_60_mm_past_the_place(overshoot_mm: float, repeats_ms: int) -> None:
    """The drive goes on by 60 % of the limit, and its lag."""
    check = CHECK | {"tolerance_mm": 30.0, "tolerance_share": 0.05, "lasting_s": 0.3}
    fusion = {"radius_threshold_px": 178.0, "cross_check": check}
    drive_keys = {"latency_s": 0.3, "creep_speed_mm_s": 15}
    made = config(drive_keys, fusion=fusion, guidance={"overshoot_mm": overshoot_mm})
    vehicle = Vehicle(Rules.of(made.bays[0], made), 900.0, repeats_ms=repeats_ms, dead=True)
    vehicle.runs(26)
    assert (vehicle.state.setpoint.state, vehicle.speed_mm_s) == (DriveState.INHIBITED, 0.0)
    assert 300.0 - overshoot_mm < vehicle.nearest_mm < 290.0


def test_a_vehicle_that_is_held_on_its_way_is_driven_on_when_it_is_let_go() -> None:
    """The PLC's program has stopped it; the gateway offers the setpoint all the while."""
    vehicle = Vehicle(rules(), 1500.0)
    vehicle.runs(4)
    vehicle.follows, vehicle.speed_mm_s = False, 0.0
    vehicle.runs(20)
    assert vehicle.state.setpoint.enable
    vehicle.follows = True
    vehicle.runs(20)
    assert vehicle.state.setpoint.state is DriveState.AT_PLACE


def test_sensors_that_are_dead_before_the_vehicle_was_seen_to_follow_do_not_let_it_pass_the_limit() -> None:
    """It stands until the PLC's program starts. The same picture again and again shows nothing any more."""
    vehicle = Vehicle(rules(), 1500.0, follows=False, repeats_ms=2500, dead=True)
    vehicle.runs(2.5)
    vehicle.follows = True
    vehicle.runs(30)
    assert vehicle.state.setpoint.speed_mm_s == 0
    assert vehicle.nearest_mm > 300.0


@pytest.mark.parametrize("pushed_mm_s", [0.0, 200.0])
def test_a_start_of_the_plc_s_program_may_be_late(pushed_mm_s: float) -> None:
    """Nobody follows the setpoint before it, whether the vehicle stood there or was pushed there."""
    vehicle = Vehicle(rules(), 1500.0 + 4 * pushed_mm_s, follows=False, speed_mm_s=pushed_mm_s)
    vehicle.runs(3)
    while vehicle.speed_mm_s > 0:
        vehicle.speed_mm_s = max(0.0, vehicle.speed_mm_s - 3.0)
        vehicle.runs(0.02)
    vehicle.runs(10)
    assert vehicle.state.setpoint.speed_mm_s > 100.0
    vehicle.follows = True
    vehicle.runs(20)
    assert vehicle.state.setpoint.state is DriveState.AT_PLACE


def test_a_vehicle_beyond_the_ranger_s_range_may_move_but_has_no_distance_to_be_driven_by() -> None:
    bay_rules = replace(rules(), max_range_mm=3000.0)
    state = interlock.initial("bay1", T0, bay_rules)
    for n in range(200):
        now_ns = T0 + n * 20 * MS
        far = VisionReading(now_ns, Quality.GOOD, Circle(320.0, 240.0, PX_MM / 4000.0))
        for seen in (far, RangeReading(now_ns, Quality.NO_ECHO), Tick()):
            state = interlock.step(state, seen, now_ns, bay_rules)
    assert state.may_move
    assert state.setpoint == Setpoint(DriveState.NO_DISTANCE)


@pytest.mark.parametrize("lost_ms", [3020, 4510, 5010, 5510, 6010, 6510, 7010, 7510, 8010, 9010])
def test_polls_that_end_at_the_worst_moment_leave_it_before_the_limit(lost_ms: int) -> None:
    """The worst brake, and a lag of 0.35 s beside the 0.15 s by which it follows; the PLC holds the newest setpoint."""
    vehicle = Vehicle(rules(), 1800.0, lag_s=0.35, lost_ms=lost_ms)
    vehicle.runs(lost_ms / 1000 + 6)
    assert vehicle.speed_mm_s == 0.0
    assert vehicle.nearest_mm > 300.0 - 100.0


FALLS = SetpointHistory(T0 + 1300 * MS, 112.0, 40.0, ((T0, 0.0, 0.0), (T0 + 1000 * MS, 100.0, 100.0)))


def test_what_was_set_goes_on_for_the_longest_delay_each_setpoint_until_a_lower_one_acts() -> None:
    """100 mm/s for 1 s, then 40 mm/s for 0.3 s: after 0.8 s, 0.5 s of the former and 0.3 s of the latter are to come.
    In the other order the higher one may act in all of the time."""
    now_ns = T0 + 1300 * MS
    assert FALLS.worst(0.8) == pytest.approx((62.0, 100.0))
    rises = SetpointHistory(now_ns, 70.0, 100.0, ((T0, 0.0, 0.0), (T0 + 1000 * MS, 40.0, 40.0)))
    assert rises.worst(0.8) == pytest.approx((80.0, 100.0))
    assert SetpointHistory(now_ns, 0.0, 50.0).worst(0.8) == pytest.approx((40.0, 50.0))
    assert SetpointHistory(now_ns, 70.0, 0.0, ((T0, 70.0, 0.0),)).worst(0.8) == (0.0, 0.0)


@pytest.mark.parametrize(("limit_mm", "safe_mm_s"), [(200.0, 117.45), (80.0, 19.95), (60.0, 0.0)])
def test_a_drive_a_tenth_faster_than_its_setpoint_stops_before_the_limit(limit_mm: float, safe_mm_s: float) -> None:
    """Set down from 100 to 40 mm/s; 62 mm are to come, at worst 68.2 mm. Of 80 mm, 8 mm are the reserve: 19.95 mm/s,
    driven at 21.95 mm/s for 0.1 s, needs 2.2 mm, and 1.6 mm to brake."""
    made = config({"latency_s": 0.3}).bays[0].drive
    assert made is not None
    way = stopping_way.at_worst(FALLS, 80.0, made)
    assert way.mm == pytest.approx(68.2 + 44.0**2 / 300)
    assert stopping_way.safe_mm_s(way, limit_mm, FALLS.follows_mm_s, made) == pytest.approx(safe_mm_s, abs=0.01)


def test_a_setpoint_that_drops_counts_as_the_worst_brake_follows_it() -> None:
    """From 300 mm/s at 150 mm/s2: 0.3 * 300 - 0.3^2 * 150 / 2 = 83.25 mm in 0.3 s."""
    history = SetpointHistory(T0, follows_mm_s=300.0).advanced(T0 + 300 * MS, 0.0, 150.0, 0.8)
    assert (history.follows_mm_s, history.way_mm) == pytest.approx((255.0, 83.25))


def test_how_late_a_falling_setpoint_acts_is_found_from_the_way() -> None:
    """It falls by 100 mm/s2 from 300 mm/s; the vehicle is 0.4 s late: from 1 s to 2 s it goes as set from 0.6 to 1.6 s,
    300 - 100 * 1.1 = 190 mm."""
    history = SetpointHistory(T0, follows_mm_s=300.0)
    for n in range(1, 101):
        history = history.advanced(T0 + n * 20 * MS, 300.0 - 2 * n, 150.0, 0.8)
    assert history.way_mm == pytest.approx(400.0, abs=4.0)
    assert lag._late_s(history, T0 + 1000 * MS, T0 + 2000 * MS, 190.0, 0.8) == pytest.approx(0.4, abs=0.02)


def test_an_integral_is_that_of_any_time_in_between() -> None:
    """Kept each 50 ms for the longest delay and 3 s; before the oldest and after the newest nothing is added."""
    history = SetpointHistory()
    for n in range(400):
        history = history.advanced(T0 + n * 20 * MS, 100.0, 150.0, 0.8)
    assert len(history.ways) == pytest.approx(3.8 / 0.06, abs=2)
    assert history.way_at(history.t_ns - 1010 * MS) == pytest.approx(history.way_mm - 101.0)
    assert history.way_at(T0) == history.ways[0][1]
    assert history.way_at(history.t_ns + 500 * MS) == history.way_mm
    assert history.moved_mm(history.t_ns - 2000 * MS, history.t_ns, 0.5) == pytest.approx(200.0)
    assert history.acting_mm_s(1.0) == pytest.approx(100.0)
    assert history.left_mm(0.7) == pytest.approx(70.0)


def test_of_what_was_set_long_ago_nothing_is_kept() -> None:
    history = SetpointHistory().advanced(T0, 100.0, 150.0, 0.8)
    for n in range(1, 300):
        history = history.advanced(T0 + n * 20 * MS, 0.0, 150.0, 0.8)
    assert len(history.ways) == 1
    assert history.rests


def test_a_short_way_is_run_so_slowly_that_its_run_out_fits() -> None:
    """30 mm to go, 1.1 s of delay and PULSE_S: 18 mm/s, not the 30 mm/s of creep speed."""
    vehicle = standing(320.0)
    fastest = max(state.setpoint.speed_mm_s for state in vehicle.states)
    assert 10.0 <= fastest <= 24.0


def test_without_a_drive_there_is_no_setpoint() -> None:
    made = parse({"fusion": {"radius_threshold_px": 178.0}})
    vehicle = Vehicle(Rules.of(made.bays[0], made), 900.0)
    vehicle.runs(2)
    assert vehicle.state.may_move
    assert {state.setpoint for state in vehicle.states} == {Setpoint()}
    assert {state.memory.drive for state in vehicle.states} == {DriveMemory()}


def test_what_is_learned_of_an_approach_is_what_the_vehicle_does() -> None:
    """It follows 0.3 s late, is polled every 0.1 s, and needs 0.15 s more to change its speed."""
    first = Vehicle(rules(), 900.0, 0.3, seed=5)
    first.runs(16)
    learned = first.state.memory.drive
    assert len(learned.slips_s) == 1
    assert 0.3 <= learned.slips_s[0] <= 0.9
    assert learned.lag_s is not None
    assert 0.3 <= learned.lag_s <= 0.6


def test_a_vehicle_that_does_not_move_is_not_learned_from_and_the_setpoint_stays_limited() -> None:
    vehicle = Vehicle(rules(), 900.0, follows=False)
    vehicle.runs(8)
    assert vehicle.state.memory.drive.slips_s == ()
    assert vehicle.state.memory.drive.lag_s is None
    assert 0 < max(state.setpoint.speed_mm_s for state in vehicle.states) <= 500.0


def standing(at_mm: float, drives: Mapping[str, Any] | None = None, **sections: Any) -> Vehicle:
    """It has stood there for so long that it may move, and does not follow."""
    made = config(drives, **sections)
    vehicle = Vehicle(Rules.of(made.bays[0], made), at_mm, follows=False, drops=0.0)
    vehicle.runs(3)
    return vehicle


def test_short_of_the_place_it_is_moved_again_a_limited_number_of_times() -> None:
    """It stands 25 mm short. After the last try it stays there, with enable off."""
    state = standing(315.0, {"lag_s": 0.1, "latency_s": 0.1}).state
    stood = replace(
        state.memory.drive,
        speed_mm_s=0.0,
        run_mm_s=None,
        cut=None,
        tried_mm=315.0,
        history=SetpointHistory(state.t_ns),
    )
    for tries in (0, drive.TRIES - 1):
        setpoint = stepped(state, memory=replace(state.memory, drive=replace(stood, tries=tries)))
        assert (setpoint.state, setpoint.enable) == (DriveState.CREEP, True)
        assert setpoint.speed_mm_s >= 10.0
    setpoint = stepped(state, memory=replace(state.memory, drive=replace(stood, tries=drive.TRIES)))
    assert (setpoint.state, setpoint.enable, setpoint.speed_mm_s) == (DriveState.SETTLE, False, 0.0)


def test_a_doubt_gives_no_further_tries_and_arriving_leaving_or_a_person_does() -> None:
    """All tries are spent 25 mm short of the place."""
    state = standing(315.0, {"lag_s": 0.1, "latency_s": 0.1}).state
    spent = replace(state.memory.drive, speed_mm_s=0.0, run_mm_s=None, cut=None, tries=drive.TRIES, tried_mm=315.0)
    state = replace(state, memory=replace(state.memory, drive=spent))

    def tries(**fields: Any) -> int:
        recipe = rules().recipes[0]
        assert recipe.drive is not None
        memory, setpoint = drive.step(replace(state, **fields), recipe.drive, recipe.fusion, recipe.guidance)
        assert not setpoint.enable
        return memory.tries

    hidden = VisionReading(state.t_ns, Quality.NO_TARGET)
    for doubt in ({}, {"stop": True}, {"vision": hidden}, {"range": RangeReading(state.t_ns, Quality.NO_ECHO)}):
        assert tries(**doubt) == drive.TRIES
    assert spent.resumed().tries == drive.TRIES
    for anew in (
        {"visit": Visit(in_place=True), "d": True, "stop": True, "may_move": False},
        {"visit": Visit(phase=VisitPhase.EMPTY), "vision": hidden},
        {"visit": Visit(phase=VisitPhase.LEAVING)},
        {"function_check": FunctionCheck.MAY_MOVE_KEPT},
    ):
        assert tries(**anew) == 0
    for tried_mm, enable in ((315.0 - drive.ANEW_MM - 20.0, True), (315.0 - drive.ANEW_MM + 20.0, False)):
        farther = replace(state.memory, drive=replace(spent, tried_mm=tried_mm))
        assert stepped(state, memory=farther).enable is enable


@pytest.mark.parametrize(("at_mm", "dead_band_mm"), [(312.0, 22.0), (301.0, 10.0)])
def test_at_the_dead_band_s_edge_the_state_does_not_flicker(at_mm: float, dead_band_mm: float) -> None:
    """The filtered distance moves by some mm around the edge; where D comes and goes with it, too."""
    vehicle = standing(at_mm, {"dead_band_mm": dead_band_mm})
    vehicle.runs(27)
    found = [state.setpoint.state for state in vehicle.states]
    first = found.index(DriveState.AT_PLACE)
    assert first < len(found) / 2
    assert set(found[first:]) == {DriveState.AT_PLACE}
    assert not any(state.setpoint.enable for state in vehicle.states[first:])


def test_a_stop_that_has_just_ended_does_not_end_the_place() -> None:
    """Where D comes and goes, CLEARING holds the stop for a while."""
    state = standing(292.0).state
    assert state.setpoint.state is DriveState.AT_PLACE
    clearing: dict[str, Any] = {
        "visit": Visit(),
        "d": False,
        "stop": True,
        "may_move": False,
        "reason": Reason.CLEARING,
    }
    for there, reached in ((True, DriveState.AT_PLACE), (False, DriveState.INHIBITED)):
        memory = replace(state.memory, drive=replace(state.memory.drive, there=there))
        assert stepped(state, memory=memory, **clearing).state is reached


@pytest.mark.parametrize(
    ("to_go_mm", "distance_mm", "stays"),
    [(100.0, 421.0, True), (100.0, 419.0, False), (0.5, 421.0, True), (-0.5, 421.0, False), (None, 421.0, False)],
)
def test_a_setpoint_stays_while_the_vehicle_can_stop_and_is_not_there(
    to_go_mm: float | None, distance_mm: float, stays: bool
) -> None:
    """The limit is at 200 mm, and 220 mm are needed to stop; the place begins 10 mm past it, less the dead band."""
    state, recipe = driven(), rules().recipes[0]
    assert recipe.drive is not None
    near = replace(state.range, distance_mm=distance_mm)
    now = replace(state, guidance=replace(state.guidance, to_go_mm=to_go_mm), range=near)
    told = replace(state.setpoint, stopping_mm=220.0)
    assert drive.stays(now, told, recipe.drive, recipe.fusion, recipe.guidance) is stays
    assert drive.stays(now, Setpoint(), recipe.drive, recipe.fusion, recipe.guidance)


def test_between_control_ticks_the_setpoint_stays_unless_something_is_against_it() -> None:
    vehicle = standing(900.0)
    state, now_ns = vehicle.state, vehicle.now_ns + 10 * MS
    for same in (
        VisionReading(now_ns, Quality.GOOD, Circle(320.0, 240.0, PX_MM / 900.0)),
        RangeReading(now_ns, Quality.GOOD, 890.0),
        FunctionCheck.OFF,
    ):
        assert interlock.step(state, same, now_ns, vehicle.rules).setpoint is state.setpoint
    for against in (
        VisionReading(now_ns, Quality.GOOD, Circle(320.0, 240.0, 190.0)),
        VisionReading(now_ns, Quality.COASTED),
        RangeReading(now_ns, Quality.GOOD, 330.0),
        RangeReading(now_ns, Quality.UNSTABLE),
        FunctionCheck.MAY_MOVE_KEPT,
    ):
        setpoint = interlock.step(state, against, now_ns, vehicle.rules).setpoint
        assert (setpoint.enable, setpoint.speed_mm_s) == (False, 0.0)


@pytest.mark.parametrize("at_mm", [292.0, 270.0])
def test_within_the_tolerance_and_beyond_it_the_setpoint_is_never_more_than_0(at_mm: float) -> None:
    vehicle = standing(at_mm)
    assert {state.setpoint.speed_mm_s for state in vehicle.states} == {0.0}
    assert not any(state.setpoint.enable for state in vehicle.states)
    there = DriveState.AT_PLACE if at_mm > 280 else DriveState.INHIBITED
    assert vehicle.state.setpoint.state in (there, DriveState.AT_PLACE)


def test_within_the_dead_band_it_is_not_driven_on_though_d_is_0() -> None:
    vehicle = standing(312.0, {"dead_band_mm": 30.0})
    assert (vehicle.state.d, vehicle.state.may_move) == (False, True)
    assert {state.setpoint.speed_mm_s for state in vehicle.states} == {0.0}
    assert vehicle.state.setpoint.state is DriveState.AT_PLACE


def test_the_setpoint_rises_by_acceleration_and_jerk() -> None:
    vehicle = standing(2500.0, {"acceleration_mm_s2": 80.0, "jerk_mm_s3": 100.0})
    ticks = list({s.t_ns: s for s in vehicle.states if s.setpoint.speed_mm_s > 0}.values())
    rises = [
        (later.setpoint.speed_mm_s - earlier.setpoint.speed_mm_s) / ((later.t_ns - earlier.t_ns) / 1e9)
        for earlier, later in pairwise(ticks)
        if later.t_ns > earlier.t_ns
    ]
    assert rises[0] <= 100.0 * 0.06
    assert max(rises) <= 80.0 + 1e-6
    assert max(after - before for before, after in pairwise(rises)) <= 100.0 * 0.02 + 1e-6
    assert min(s.setpoint.speed_mm_s for s in ticks) >= 10.0


def driven() -> StateVector:
    vehicle = Vehicle(rules(), 1200.0)
    vehicle.runs(3)
    assert vehicle.state.setpoint.speed_mm_s > 50.0
    assert vehicle.state.setpoint.enable
    return vehicle.state


def stepped(state: StateVector, **fields: Any) -> Setpoint:
    recipe = rules().recipes[0]
    assert recipe.drive is not None
    return drive.step(replace(state, **fields), recipe.drive, recipe.fusion, recipe.guidance)[1]


@pytest.mark.parametrize(
    "fields",
    [
        {"stop": True},
        {"may_move": False},
        {"d": True},
        {"d": None},
        {"function_check": FunctionCheck.MAY_MOVE_KEPT},
        {"function_check": FunctionCheck.MAY_MOVE_OFF},
        {"range": RangeReading(T0, Quality.STALE)},
        {"range": RangeReading(T0, Quality.NO_ECHO)},
        {"vision": VisionReading(T0, Quality.NO_TARGET)},
        {"visit": Visit(phase=VisitPhase.LEAVING)},
        {"visit": Visit(phase=VisitPhase.RELEASED)},
        {"visit": Visit(released=True)},
        {"visit": Visit(restored=True)},
    ],
    ids=str,
)
def test_anything_in_doubt_is_a_setpoint_of_0(fields: Mapping[str, Any]) -> None:
    state = driven()
    assert stepped(state).speed_mm_s > 50.0
    setpoint = stepped(state, **fields)
    assert (setpoint.enable, setpoint.speed_mm_s) == (False, 0.0)
    assert setpoint.state in (DriveState.INHIBITED, DriveState.NO_DISTANCE)


def test_a_contradiction_an_unproven_age_and_a_missed_heartbeat_are_a_setpoint_of_0() -> None:
    state = driven()
    doubts: list[dict[str, Any]] = [
        {"memory": replace(state.memory, disagree=True)},
        {"memory": replace(state.memory, disagree_since_ns=state.t_ns)},
        {"vision": replace(state.vision, age_proof=AgeProof.UNPROVEN)},
        {"plc": replace(state.plc, missed=True)},
    ]
    for doubt in doubts:
        setpoint = stepped(state, **doubt)
        assert (setpoint.state, setpoint.enable, setpoint.speed_mm_s) == (DriveState.INHIBITED, False, 0.0)


def test_without_ticks_the_setpoint_is_withdrawn_and_begins_anew() -> None:
    vehicle = standing(900.0)
    late_ns = vehicle.now_ns + 400 * MS
    state = interlock.step(vehicle.state, Tick(), late_ns, vehicle.rules)
    assert state.setpoint.speed_mm_s == 0.0
    assert not state.setpoint.enable
    assert state.memory.drive.speed_mm_s == 0.0


def test_a_vehicle_that_is_too_fast_to_stop_before_the_limit_is_told_0() -> None:
    """From 500 mm/s it needs 500 * (0.8 + 0.1) + 500^2 / 300 = 1283 mm."""
    state = driven()
    seen = state.memory.drive
    moves = Movement(state.range.t_ns, 900.0, 500.0, 1.0, 0.0, 1.0)
    fast = replace(seen, movement=moves, speed_mm_s=0.0, history=SetpointHistory(state.t_ns))
    setpoint = stepped(state, memory=replace(state.memory, drive=fast))
    assert setpoint.speed_mm_s == 0.0
    assert setpoint.stopping_mm is not None
    assert 1200.0 < setpoint.stopping_mm < 1800.0


def test_the_filter_knows_distance_and_speed_at_a_later_time() -> None:
    found = Movement(T0, 1000.0)
    for n in range(1, 60):
        found = movement.measured(found, 1000.0 - 6.0 * n, T0 + n * 60 * MS, 0.0, 75.0)
    later = movement.at(found, T0 + 59 * 60 * MS + 200 * MS, 0.0, 75.0)
    assert later.distance_mm == pytest.approx(1000.0 - 6.0 * 59 - 20.0, abs=0.5)
    assert later.excess_mm_s == pytest.approx(100.0, abs=1.0)
    assert later.speed_sd_mm_s > found.speed_sd_mm_s > 5.0
    assert later.distance_sd_mm > found.distance_sd_mm
    assert movement.measured(found, 500.0, T0 + 3600 * MS, 0.0, 75.0) == Movement(T0 + 3600 * MS, 500.0)


distances = st.one_of(st.floats(1.0, 4000.0), st.sampled_from([290.0, 301.0, 320.0, 900.0]))
seen = st.one_of(
    st.builds(lambda mm, age: ("range", mm, age), distances, st.integers(0, 900)),
    st.builds(lambda mm, age: ("camera", mm, age), distances, st.integers(0, 900)),
    st.builds(lambda mm: ("both", mm, 0), distances),
    st.sampled_from([("fault", 0.0, 0), ("check", 1.0, 0), ("check", 0.0, 0), ("release", 0.0, 0), ("plc", 0.0, 0)]),
)
moments = st.lists(st.tuples(seen, st.sampled_from([0, 1, 20, 20, 60, 100, 240, 3000, -50])), max_size=60)


@given(moments, st.booleans())
def test_on_any_observations_the_setpoint_keeps_to_the_decision(happens: list[Any], writes: bool) -> None:
    plc = {"modbus": {"writes": writes, "plc_addresses": ["10.0.0.9"]}}
    made = config(None, **plc)
    bay_rules, section = Rules.of(made.bays[0], made), made.bays[0].drive
    assert section is not None
    now_ns, beat = T0, 0
    state = interlock.initial("bay1", now_ns, bay_rules)
    for (what, mm, age_ms), wait_ms in happens:
        now_ns += wait_ms * MS
        then_ns, circle = now_ns - age_ms * MS, Circle(320.0, 240.0, PX_MM / max(mm, 1.0))
        beat += 1
        told: Any = {
            "range": [RangeReading(then_ns, Quality.GOOD, mm)],
            "camera": [VisionReading(then_ns, Quality.GOOD, circle)],
            "both": [RangeReading(then_ns, Quality.GOOD, mm), VisionReading(then_ns, Quality.GOOD, circle)],
            "fault": [RangeReading(now_ns, Quality.UNSTABLE)],
            "check": [FunctionCheck.MAY_MOVE_KEPT if mm else FunctionCheck.OFF],
            "release": [PlcWrite(Writer("10.0.0.9"), heartbeat=beat, control=1 | 1 << Control.RELEASE)],
            "plc": [PlcWrite(Writer("10.0.0.9"), heartbeat=beat, control=1)],
        }[what]
        for observation in [*told, Tick()]:
            state = interlock.step(state, observation, now_ns, bay_rules)
            setpoint = state.setpoint
            assert 0.0 <= setpoint.speed_mm_s <= section.max_speed_mm_s
            assert not setpoint.enable or (state.may_move and not state.stop)
            if setpoint.speed_mm_s == 0.0:
                continue
            assert setpoint.enable
            assert setpoint.speed_mm_s >= section.min_speed_mm_s
            assert state.range.quality is Quality.GOOD
            assert state.range.distance_mm is not None
            assert state.guidance.to_go_mm is not None
            assert state.guidance.to_go_mm + section.place_mm > section.dead_band_mm
            assert setpoint.stopping_mm is not None
            assert setpoint.stopping_mm <= state.range.distance_mm - 300.0 + 100.0
            assert state.function_check is FunctionCheck.OFF


@pytest.mark.parametrize(
    ("sections", "place"),
    [
        ({"drive": {"creep_speed_mm_s": 60.0, "max_speed_mm_s": 50.0}}, "drive.creep_speed_mm_s"),
        ({"drive": {"min_speed_mm_s": 40.0}}, "drive.min_speed_mm_s"),
        ({"drive": {"place_mm": 95.0}}, "drive.place_mm"),
        ({"drive": {"lag_s": 3.0}}, "drive.creep_speed_mm_s"),
        ({"drive": {}, "recipes": [{"id": 1, "name": "a", "drive": {"place_mm": 95.0}}]}, "recipes.0.drive.place_mm"),
        ({"drive": {}, "fusion": {}}, "fusion.cross_check"),
        ({"drive": {}, "fusion": {"cross_check": CHECK | {"tolerance_mm": 70.0}}}, "fusion.cross_check"),
        (
            {"drive": {}, "recipes": [{"id": 1, "name": "a", "fusion": {"distance_threshold_mm": 500.0}}]},
            "recipes.0.fusion.distance_threshold_mm",
        ),
    ],
    ids=str,
)
def test_a_drive_that_could_not_stop_is_refused(sections: Mapping[str, Any], place: str) -> None:
    with pytest.raises(FaultsError, match=place.replace(".", r"\.")):
        parse({"fusion": {"cross_check": CHECK}, **sections})


@pytest.mark.parametrize(
    ("section", "told"),
    [
        (
            {"place_mm": 95.0},
            r"drive\.place_mm.*must be at most 90: guidance\.overshoot_mm, 100, less dead_band_mm, 10",
        ),
        ({"dead_band_mm": 120.0}, r"drive\.dead_band_mm.*must be at most guidance\.overshoot_mm, 100"),
        ({"lag_s": 4.0}, r"drive\.creep_speed_mm_s.*must be at most 17: at 30 mm/s a vehicle needs 153 mm to stop"),
    ],
    ids=str,
)
def test_the_refusal_names_the_largest_value_that_would_do(section: Mapping[str, Any], told: str) -> None:
    with pytest.raises(FaultsError, match=told):
        parse({"fusion": {"cross_check": CHECK}, "drive": section})


def test_a_recipe_changes_the_drive() -> None:
    made = config(recipes=[{"id": 7, "name": "wagon", "drive": {"creep_speed_mm_s": 20.0}}])
    recipe = Rules.of(made.bays[0], made).recipes[7].drive
    assert recipe is not None
    assert (recipe.creep_speed_mm_s, recipe.max_speed_mm_s) == (20.0, 500.0)


def test_a_release_is_void_when_the_drive_changes_but_not_by_its_mere_existence() -> None:
    recipe: dict[str, Any] = {"id": 7, "name": "wagon"}
    fusion = {"cross_check": CHECK}
    none, off, on, other = (
        decision.keys_of(made.bays[0], made)
        for made in (
            parse({"recipes": [recipe], "fusion": fusion}),
            parse({"recipes": [recipe | {"drive": {}}], "fusion": fusion}),
            parse({"drive": {}, "recipes": [recipe], "fusion": fusion}),
            parse({"drive": {}, "recipes": [recipe | {"drive": {"place_mm": 5.0}}], "fusion": fusion}),
        )
    )
    assert none["recipes"] == [{"id": 7, "fusion": {}, "guidance": {}}]
    assert decision.differing(none, off) == []
    assert decision.differing(none, on) == ["drive"]
    assert decision.differing(on, other) == ["recipes"]
