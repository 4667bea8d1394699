"""A truck in place that begins to move: how soon each sensor shows it, and what does not look like it."""

from dataclasses import replace
from itertools import groupby

import pytest

from bench.guidance.rolling import echoes
from gateway.config import GuidanceConfig, VisitConfig
from gateway.core import rolling
from gateway.core.detection import Circle
from gateway.core.events import EventKind
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import Fused, GuidanceCode, ReferencePosition
from tests.long import mostly_long
from tests.visit_bench import Bench, Levels, gateway, truck

STANDS_S = 10.0  # this long the truck is in place before it moves, from world time 0
SETTLED = {"distance_cm": 27, "speed_cm_s": 30, "hold_s": STANDS_S}
LATEST_S = {1: (0.9, 1.3), 5: (0.3, 0.5), 50: (0.3, 0.4)}
"""By speed in cm/s, from the first motion, at 100 cm/s^2: with the marker seen, and covered, s."""


def moving(
    speed_cm_s: float, *, covered: bool, seed: int, to_cm: float = 60.0, writes: bool = True
) -> tuple[Bench, float]:
    """A truck in place, and when it begins to move."""
    leg = {"distance_cm": to_cm, "speed_cm_s": speed_cm_s, "acceleration_cm_s2": 100}
    faults = ({"kind": "marker_hidden", "at_s": 8, "for_s": 60},) if covered else ()
    scenario = truck(SETTLED, leg, faults=faults, start={"distance_cm": 60}, seed=seed)
    bench = Bench(scenario, gateway(writes=writes), seed=seed)
    begins_s = next(s.start_s for s in bench.world._segments[1:])
    bench.run(begins_s)
    assert bench.state.in_place
    assert not bench.state.visit.rolling
    return bench, begins_s


@pytest.mark.mostly_long
@pytest.mark.one_interpreter
@pytest.mark.parametrize("covered", [False, True])
@pytest.mark.parametrize("speed_cm_s", [1, 5, 50])
def test_a_truck_that_begins_to_move_is_reported(speed_cm_s: int, covered: bool) -> None:
    for seed in range(2):
        bench, begins_s = moving(speed_cm_s, covered=covered, seed=seed)
        bench.run_until(lambda state: state.visit.rolling, 5.0)
        assert bench.t_s - begins_s <= LATEST_S[speed_cm_s][covered]
        (event,) = [event for event in bench.events if event.kind is EventKind.ROLLING]
        assert event.detail.startswith("by range: Z 27" if covered else "by vision: Z 27")


@pytest.mark.one_interpreter
def test_under_the_spout_the_driver_is_told_to_brake_until_it_stands_again() -> None:
    bench, _ = moving(2, covered=True, seed=1, to_cm=29.5)
    bench.run_until(lambda state: state.visit.rolling)
    assert (bench.state.in_place, bench.state.stop, bench.state.guidance.code) == (True, True, GuidanceCode.BRAKE)
    bench.run(bench.t_s + 4.0)  # 25 mm on, within the band, it stands
    assert (bench.state.in_place, bench.state.visit.rolling) == (True, False)
    assert bench.state.guidance.code is GuidanceCode.OK


@pytest.mark.one_interpreter
@pytest.mark.parametrize("covered", [False, True])
def test_a_truck_that_creeps_rolls_all_the_way(covered: bool) -> None:
    """1 cm/s is slower than still_mm_s, what a truck in place may do: it has not stopped."""
    bench, _ = moving(1, covered=covered, seed=2, to_cm=31.5)
    bench.run_until(lambda state: state.visit.rolling)
    begun_s = bench.t_s
    bench.run(begun_s + 3.0)
    assert all(moment.state.visit.rolling for moment in bench.moments if moment.t_s >= begun_s)
    assert sum(event.kind is EventKind.ROLLING for event in bench.events) == 1
    bench.run(bench.t_s + 2.5)  # it stands at 31.5 cm
    assert not bench.state.visit.rolling


@pytest.mark.one_interpreter
@pytest.mark.parametrize(("rolling_mm", "settle_s"), mostly_long([(8.0, 1.0), (12.0, 1.0), (8.0, 3.0), (12.0, 5.0)]))
def test_a_truck_that_stands_again_rolls_no_more_whatever_the_noise(rolling_mm: float, settle_s: float) -> None:
    """At the latest after two times settle_s: the first may still have seen the end of the motion."""
    config = gateway(visit={"rolling_mm": rolling_mm, "settle_s": settle_s})
    for seed in range(3):
        leg = {"distance_cm": 29, "speed_cm_s": 3, "hold_s": 30}
        scenario = truck(SETTLED, leg, start={"distance_cm": 60}, ranger={"jitter_mm": 2.5}, seed=seed)
        bench = Bench(scenario, config, seed=seed)
        bench.run(next(s.start_s for s in bench.world._segments[1:]))
        bench.run_until(lambda state: state.visit.rolling, 2.0)
        stands_s = next(s.end_s for s in bench.world._segments if s.start_s > STANDS_S)
        bench.run_until(lambda state: not state.visit.rolling, stands_s - bench.t_s + 2 * settle_s + 1)


@pytest.mark.one_interpreter
@pytest.mark.parametrize("speed_cm_s", mostly_long([10, 3, 50]))
def test_without_writes_a_truck_that_departs_is_not_told_to_brake(speed_cm_s: int) -> None:
    """Each departure rolls there."""
    for seed in range(5):
        bench, _ = moving(speed_cm_s, covered=False, seed=seed, writes=False)
        bench.run_until(lambda state: state.visit.rolling)
        bench.run(bench.t_s + 2)
        assert not any(moment.state.unintended_motion for moment in bench.moments)


@pytest.mark.one_interpreter
@pytest.mark.parametrize("speed_cm_s", [2, 10, 50])
def test_without_writes_a_truck_that_comes_nearer_is_told_to_brake_until_it_stands(speed_cm_s: int) -> None:
    bench, begins_s = moving(speed_cm_s, covered=False, seed=1, to_cm=18.0, writes=False)
    bench.run_until(lambda state: state.unintended_motion, 1.0)
    assert bench.state.guidance.code is GuidanceCode.BRAKE
    bench.run_until(lambda state: not state.unintended_motion, 9.0 / speed_cm_s * 10 + 4)
    codes = [moment.state.guidance.code for moment in bench.moments if moment.t_s >= begins_s]
    assert [code for code, _ in groupby(codes)][:3] == [GuidanceCode.OK, GuidanceCode.BRAKE, GuidanceCode.BACK]


def test_which_way_it_rolls_is_kept_while_no_distance_is_heard() -> None:
    """Nearer by more than half of rolling_mm, 6 mm, and not on its way back."""
    rolls = ReferencePosition(270.0, rolling_since_ns=1, sensor="vision")
    config = VisitConfig(), GuidanceConfig()
    for mm, speed, was, nearer in (
        (265.0, 50.0, False, False),
        (263.0, 50.0, False, True),
        (263.0, -25.0, True, False),
        (263.0, None, False, True),
        (None, None, True, True),
        (None, None, False, False),
    ):
        quality = Quality.NO_ECHO if mm is None else Quality.GOOD
        state = Fused(2, range=RangeReading(2, quality, mm))
        assert rolling.step(replace(rolls, nearer=was), state, speed, *config).nearer is nearer


def test_a_pause_between_two_readings_begins_anew() -> None:
    """What a sensor did not see is not a motion: the visit's bands judge how far the truck is from its place."""
    moved = Circle(330.0, 240.0, 200.0)
    for pause_ms, rolls in ((400, True), (600, False)):
        reference: ReferencePosition | None = None
        for t_ms, mm, circle in ((1000, 270.0, Circle(320.0, 240.0, 200.0)), (1000 + pause_ms, 300.0, moved)):
            t_ns = t_ms * 1_000_000
            state = Fused(
                t_ns,
                vision=VisionReading(t_ns, Quality.GOOD, circle, visible=1.0),
                range=RangeReading(t_ns, Quality.GOOD, mm, oldest_ns=t_ns - 1),
            )
            reference = rolling.step(reference, state, 0.0, VisitConfig(), GuidanceConfig())
        assert reference is not None
        assert (reference.rolling_since_ns is not None) is rolls
        assert reference.odd_frames == (1 if rolls else 0)


def test_a_circle_that_is_contradicted_is_forgotten() -> None:
    reference = ReferencePosition(270.0, circle=Circle(320.0, 240.0, 200.0), odd_frames=1)
    assert rolling.without_marker(reference) == ReferencePosition(270.0)
    assert rolling.without_marker(ReferencePosition(270.0)) == ReferencePosition(270.0)


@pytest.mark.one_interpreter
@pytest.mark.parametrize("jitter_mm", mostly_long([2.5, 1.5]))
def test_noise_is_no_motion(jitter_mm: float) -> None:
    """Two minutes, with the marker seen and covered, the spout down and up, dropouts, and an engine that idles."""
    faults = (
        {"kind": "spout_down", "at_s": 20, "for_s": 25},
        {"kind": "marker_hidden", "at_s": 60, "for_s": 60},
    )
    scenario = truck(
        SETTLED, faults=faults, start={"distance_cm": 60}, ranger={"jitter_mm": jitter_mm, "dropout": 0.02}
    )
    bench = Bench(scenario)
    bench.run(150)
    assert bench.state.in_place
    assert not [event for event in bench.events if event.kind is EventKind.ROLLING]


@pytest.mark.parametrize(
    ("heard_mm", "rolls_at"),
    [
        ([300.0, 300.0, 270.0, 270.0, 270.0] * 12, None),  # two odd echoes: 2 (12 - 5) mm
        ([300.0, 300.0, 300.0], 2),
        ([240.0, 240.0, 240.0], 2),
        ([274.9] * 200, None),  # within the slack
        ([276.0] * 20, 16),  # 1 mm each: 17 of them are beyond 16 mm
        ([270.0 + 1.2 * n for n in range(20)], 9),  # 2 cm/s: 1.0, 2.2, ... beyond 5 mm
        ([300.0, 240.0] * 30, None),
    ],
)
def test_single_echoes_show_a_motion_before_the_median_does(heard_mm: list[float], rolls_at: int | None) -> None:
    reference: ReferencePosition | None = None
    for number, echo_mm in enumerate([270.0, *heard_mm]):
        t_ns = 1_000_000_000 + number * 60_000_000
        reading = RangeReading(t_ns, Quality.GOOD, 270.0, oldest_ns=t_ns - 60_000_000, echo_mm=echo_mm)
        reference = rolling.step(reference, Fused(t_ns, range=reading), 0.0, VisitConfig(), GuidanceConfig())
        if reference.rolling_since_ns is not None:
            assert number - 1 == rolls_at
            return
    assert rolls_at is None


@pytest.mark.parametrize(
    ("echo_mm", "oldest_ms", "rolls"),
    [(283.0, 60, True), (283.0, 0, False), (None, 0, True)],
)
def test_a_distance_of_a_single_echo_is_one_echo(echo_mm: float | None, oldest_ms: int, rolls: bool) -> None:
    """After a lost one. A ranger that does not report its echoes is judged by its distances."""
    reference: ReferencePosition | None = None
    for number, mm in enumerate((270.0, 283.0)):
        t_ns = 1_000_000_000 + number * 60_000_000
        oldest_ns = t_ns - oldest_ms * 1_000_000
        reading = RangeReading(t_ns, Quality.GOOD, mm, oldest_ns=oldest_ns, echo_mm=echo_mm)
        reference = rolling.step(reference, Fused(t_ns, range=reading), 0.0, VisitConfig(), GuidanceConfig())
    assert reference is not None
    assert (reference.rolling_since_ns is not None) is rolls


@pytest.mark.one_interpreter
def test_twenty_minutes_of_echoes_from_a_truck_that_stands_are_no_motion() -> None:
    assert echoes((2.5, 0)) == (0, 0)


@pytest.mark.parametrize(("mm_s", "rolls"), [(0.5, False), (3.0, True)])
def test_a_truck_that_sinks_on_its_springs_does_not_roll(mm_s: float, rolls: bool) -> None:
    """Its marker sinks 0.5 mm a second, R 200 px of 90 mm, for a minute; six times as fast is a motion."""
    reference: ReferencePosition | None = None
    for frame in range(60 * 30):
        t_ns = 1_000_000_000 + frame * 33_333_333
        circle = Circle(320.0, 240.0 + mm_s * frame / 30 * 200 / 90, 200.0)
        state = Fused(t_ns, vision=VisionReading(t_ns, Quality.GOOD, circle, visible=1.0))
        reference = rolling.step(reference, state, 0.0, VisitConfig(), GuidanceConfig())
        if reference.rolling_since_ns is not None:
            break
    assert reference is not None
    assert (reference.rolling_since_ns is not None) is rolls


@pytest.mark.one_interpreter
def test_a_released_truck_leaves_and_does_not_roll() -> None:
    bench, _ = moving(20, covered=False, seed=3, to_cm=130)
    levels = Levels(bench)
    bench.run(bench.t_s)
    levels.release()
    bench.run(bench.t_s + 6)
    assert not bench.state.visit.rolling
