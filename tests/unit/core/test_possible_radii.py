"""What the main process makes of the learned R x Z: which radii the search may take, and what a refused one means."""

from dataclasses import replace
from typing import Any

import pytest

from gateway import parts
from gateway.bay import BayControl
from gateway.config import BayConfig, CrossCheck, FusionConfig, GuidanceConfig, VisitConfig
from gateway.core import fusion, interlock, visit
from gateway.core.detection import Circle
from gateway.core.interlock import Rules
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.retained import RetainedState
from gateway.core.scale import MarkerScale, ScaleSample, possible_radii_px
from gateway.core.state import Fused, Reason, StateVector, Tick
from gateway.hub import Hub
from tests import fused
from tests.virtual_time import HandClock

MS = 1_000_000
T0 = 10_000 * MS
SAMPLES = (ScaleSample(0, 192.0, 281.25),) * 3  # 54,000 px mm
SCALE = MarkerScale(px_mm=54_000.0, distance_mm=280.0, spread=0.02, visits=9, newest=SAMPLES[0])
MARKER, LAMP = Circle(320.0, 240.0, 193.0), Circle(40.0, 400.0, 20.0)


# -- the radii ---------------------------------------------------------------------------------------------------------


def test_the_radii_of_a_standing_truck_reach_a_little_farther_than_fusions() -> None:
    radii = possible_radii_px(SCALE, 280.0, 0.0, 0.35)
    assert radii == pytest.approx((192.86 / 1.5525, 192.86 * 1.5525), abs=0.05)


@pytest.mark.parametrize("speed", [200.0, -200.0])
def test_a_truck_that_moves_may_be_elsewhere_by_the_time_of_the_frame(speed: float) -> None:
    """0.7 s at 200 mm/s: 140 mm either way."""
    assert possible_radii_px(SCALE, 260.0, speed, 0.35) == pytest.approx(
        (54_000 / 400 / 1.5525, 54_000 / 120 * 1.5525), abs=0.05
    )


def test_a_fast_one_is_not_behind_the_sensor() -> None:
    radii = possible_radii_px(SCALE, 100.0, 300.0, 0.35)
    assert radii == pytest.approx((54_000 / 310 / 1.5525, 54_000 / 25 * 1.5525), abs=0.05)


@pytest.mark.parametrize(
    ("scale", "distance_mm", "speed"),
    [
        (None, 280.0, 0.0),
        (SCALE, None, 0.0),
        (SCALE, 280.0, None),  # nobody knows where it will be
        (SCALE, 421.0, 0.0),  # too far from where it was learned
        (SCALE, 300.0, 200.0),  # it may be too far by then
    ],
)
def test_where_anything_is_unknown_every_radius_is_possible(
    scale: MarkerScale | None, distance_mm: float | None, speed: float | None
) -> None:
    assert possible_radii_px(scale, distance_mm, speed, 0.35) is None


# -- of a bay ----------------------------------------------------------------------------------------------------------


class Vision:
    """Remembers what it was told."""

    def __init__(self) -> None:
        self.told: list[tuple[float, float] | None] = []

    def expect(self, radii_px: tuple[float, float] | None) -> None:
        self.told.append(radii_px)


class Bay:
    def __init__(self, samples: tuple[ScaleSample, ...] = SAMPLES, **keys: Any) -> None:
        self.clock, self.vision = HandClock(), Vision()
        config = BayConfig(name="north", fusion=FusionConfig(recovery_s=0, **keys))
        self.control = BayControl(config, Hub(["north"]), self.clock, retained=RetainedState(scale_samples=samples))

    def hears(self, quality: Quality, distance_mm: float | None = None) -> tuple[float, float] | None:
        self.clock.t_ns += 60 * MS
        reading = RangeReading(self.clock.t_ns, quality, distance_mm)
        self.control.on_reading(reading)
        parts._expect(self.control, self.vision, reading)  # type: ignore[arg-type]  # a stand-in
        return self.vision.told[-1]

    def stands(self, distance_mm: float = 280.0) -> tuple[float, float] | None:
        return [self.hears(Quality.GOOD, distance_mm) for _ in range(4)][-1]


def test_each_distance_gives_the_search_the_possible_radii() -> None:
    bay = Bay()
    assert bay.stands() == pytest.approx((124.2, 299.4), abs=0.1)
    assert bay.vision.told[:3] == [None] * 3  # its speed was not known yet


@pytest.mark.parametrize(
    "keys",
    [
        {"decision": "plain"},
        {"scale_tolerance": 0},
        {"cross_check": CrossCheck(focal_px=600, marker_radius_mm=90)},
    ],
)
def test_where_fusion_does_not_go_by_what_was_learned_neither_does_the_search(keys: dict[str, Any]) -> None:
    assert Bay(**keys).stands() is None


def test_no_radii_are_given_that_were_not_learned() -> None:
    assert Bay(samples=SAMPLES[:2]).stands() is None


@pytest.mark.parametrize("quality", [Quality.NO_ECHO, Quality.TOO_FAR, Quality.LINK_DOWN, Quality.UNSTABLE])
def test_without_a_distance_it_is_withdrawn(quality: Quality) -> None:
    bay = Bay()
    assert bay.stands() is not None
    assert bay.hears(quality) is None


def test_a_dead_control_task_gives_no_radii() -> None:
    bay = Bay()
    assert bay.stands() is not None
    assert bay.hears(Quality.GOOD, 280.0) is None  # 300 ms without a tick


def test_a_truck_in_place_is_one_visit() -> None:
    bay = Visit()
    state = bay.for_s(1.5, Quality.GOOD, circle=MARKER)
    assert state.visit.in_place_since_ns is not None
    assert state.memory.scale_samples == (ScaleSample(0, 193.0, 280.0, state.visit.in_place_since_ns),)


# -- what a refused disc means -----------------------------------------------------------------------------------------


class Visit:
    """A bay in simulated time: a frame, a distance and a tick every 20 ms."""

    def __init__(self) -> None:
        self.now_ns = T0
        self.rules = Rules.of(BayConfig(name="north", fusion=FusionConfig(recovery_s=0)))
        self.state = interlock.initial("north", T0, self.rules)

    def for_s(
        self, seconds: float, quality: Quality, circle: Circle | None = None, wrong_size: Circle | None = None
    ) -> StateVector:
        for _ in range(round(seconds / 0.02)):
            self.now_ns += 20 * MS
            for observation in (
                VisionReading(self.now_ns, quality, circle, wrong_size=wrong_size),
                RangeReading(self.now_ns, Quality.GOOD, 280.0),
                Tick(),
            ):
                self.state = interlock.step(self.state, observation, self.now_ns, self.rules)
                assert self.state.stop
                assert not self.state.may_move
        return self.state


def test_a_disc_of_the_wrong_size_contradicts_as_a_circle_would() -> None:
    bay = Visit()
    assert bay.for_s(1.5, Quality.GOOD, circle=MARKER).in_place
    assert bay.for_s(3.0, Quality.NO_TARGET).in_place  # covered: held
    doubtful = bay.for_s(0.2, Quality.NO_TARGET, wrong_size=LAMP)
    assert (doubtful.in_place, doubtful.reason) == (True, Reason.NO_TARGET)
    ended = bay.for_s(0.8, Quality.NO_TARGET, wrong_size=LAMP)
    assert (ended.in_place, ended.visit.ended, ended.reason) == (False, "contradiction", Reason.SENSORS_DISAGREE)
    again = bay.for_s(1.5, Quality.GOOD, circle=MARKER)
    assert (again.in_place, again.reason) == (True, Reason.TARGET_REACHED)


@pytest.mark.parametrize("quality", [Quality.LINK_DOWN, Quality.PROCESS_FAULT, Quality.WAITING])
def test_only_a_processed_frame_reports_it(quality: Quality) -> None:
    config, state = FusionConfig(scale_lasting_s=0), fusion.initial("north", T0)
    state = fused.step(state, RangeReading(T0, Quality.GOOD, 280.0), T0, config)
    told = fused.step(state, VisionReading(T0, quality, wrong_size=LAMP), T0, config)
    assert told.vision.wrong_size is None
    assert not told.memory.disagree


def test_a_frame_that_is_too_old_reports_it_no_more() -> None:
    config, state = FusionConfig(), fusion.initial("north", T0)
    state = fused.step(state, VisionReading(T0, Quality.NO_TARGET, wrong_size=LAMP), T0, config)
    assert state.vision.wrong_size == LAMP
    assert fused.step(state, Tick(), T0 + 301 * MS, config).vision.wrong_size is None


def test_a_bay_with_a_red_disc_of_the_wrong_size_is_not_clear() -> None:
    limits = visit.VisitLimits(VisitConfig(leave_distance_mm=350), FusionConfig(), GuidanceConfig())
    state = Fused(T0, range=RangeReading(T0, Quality.GOOD, 400.0))
    empty = replace(state, vision=VisionReading(T0, Quality.NO_TARGET))
    assert visit.clear(empty, limits)
    assert not visit.clear(replace(empty, vision=VisionReading(T0, Quality.NO_TARGET, wrong_size=MARKER)), limits)
