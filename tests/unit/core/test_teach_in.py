"""The values of a teach-in: the numbers, that they hold on other days, what is refused, and what no input can break."""

import math
from dataclasses import astuple, replace
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.teach_in import PLACES, Day, Place, first_stop_mm, share_of_stop, taught, with_values
from gateway.config import BayConfig, CrossCheck, FusionConfig, GuidanceConfig, VisitConfig
from gateway.config.sections.common import MAX_DISTANCE_MM
from gateway.core.detection import Circle
from gateway.core.scale import MarkerScale, ScaleSample
from gateway.core.teach_in import BEFORE_MM, Spread, Suggestion, TeachSample, spreads_of, suggest, toml_lines

NS_PER_S = 1_000_000_000
SIZE = (640, 480)
PLAIN = BayConfig(fusion=FusionConfig(decision="plain"))


def minute(radius_px: float = 150.0, distance_mm: float = 360.0, *, u_px: float = 330.0) -> list[TeachSample]:
    """Ten samples a second; R goes by 0, +0.2 and -0.2 px in turn, Z by 0, +2 and -2 mm: sigma is 1.4826 of that."""
    step = (0, 1, -1)
    return [
        TeachSample(
            n * NS_PER_S // 10,
            n,
            Circle(u_px + 0.1 * step[n % 3], 240.0, radius_px + 0.2 * step[n % 3]),
            n,
            distance_mm + 2.0 * step[n % 3],
        )
        for n in range(600)
    ]


def values(suggestion: Suggestion) -> dict[str, float]:
    return {".".join(value.path): value.value for value in suggestion.values}


def as_numbers(spread: Spread | None) -> tuple[float, ...]:
    assert spread is not None
    return astuple(spread)


def test_the_values_are_medians_with_margins() -> None:
    found = suggest(minute(), PLAIN, SIZE)
    assert found.refusals == ()
    assert as_numbers(found.spreads.radius_px) == pytest.approx((600, 150.0, 0.29652, 149.8, 150.2, 0.0))
    assert as_numbers(found.spreads.distance_mm) == pytest.approx((600, 360.0, 2.9652, 358.0, 362.0, 0.0))
    assert values(found) == {
        "fusion.radius_threshold_px": 147.3,  # 150 - 4 * 0.29652 - 1.5 = 147.31, rounded down
        "fusion.distance_threshold_mm": 390.0,  # 360 + 4 * 2.9652 + 18 = 389.86, rounded up
        "guidance.aim_u_px": 330.0,
        "guidance.aim_v_px": 240.0,
        "guidance.tolerance_px": 20.0,
    }
    assert [value.old for value in found.values] == [180.0, 300.0, None, None, 20.0]
    assert found.before_mm == pytest.approx(360 * (150 / 147.3 - 1))
    assert "noise 1.2, drift 0.0, other marker and light 1.5" in found.values[0].why
    assert "noise 12, drift 0, colder air 18" in found.values[1].why
    assert "kept" in found.values[4].why


def test_outliers_do_not_move_the_medians_and_noise_at_the_edge_counts() -> None:
    samples = minute()
    for n in range(0, 600, 50):  # 2 % of the readings
        samples[n] = replace(samples[n], circle=Circle(330, 240, 140.0), distance_mm=420.0)
    found = suggest(samples, PLAIN, SIZE)
    assert as_numbers(found.spreads.radius_px)[1] == 150.0
    assert values(found)["fusion.radius_threshold_px"] == 138.5  # the outermost 0.5 %: 10 px and 1 %
    assert values(found)["fusion.distance_threshold_mm"] == 438.0


def test_slow_drift_is_part_of_the_margin() -> None:
    samples = [replace(one, distance_mm=(one.distance_mm or 0) + 6 * n / 600) for n, one in enumerate(minute())]
    found = suggest(samples, PLAIN, SIZE)
    assert as_numbers(found.spreads.distance_mm)[5] == pytest.approx(5.0, abs=0.5)
    assert values(found)["fusion.distance_threshold_mm"] == pytest.approx(399, abs=2)
    smaller = [replace(one, circle=Circle(330, 240, 150 - 3 * n / 600)) for n, one in enumerate(minute())]
    found = suggest(smaller, PLAIN, SIZE)
    _, middle, sigma, _, _, drift = as_numbers(found.spreads.radius_px)
    assert (middle, sigma, drift) == pytest.approx((148.5, 1.4826 * 0.75, 2.5), abs=0.02)
    assert values(found)["fusion.radius_threshold_px"] == pytest.approx(148.5 - 4.45 - 2.5 - 1.49, abs=0.1)


@pytest.mark.parametrize(
    "circle",
    [Circle(330, 240, math.nan), Circle(math.inf, 240, 150), Circle(330, 2e9, 150), Circle(330, 240, 0), None],
)
def test_circles_and_distances_that_can_not_be_do_not_count(circle: Circle | None) -> None:
    among = [replace(one, circle=circle) if n % 20 == 0 else one for n, one in enumerate(minute())]
    found = spreads_of(among)
    assert as_numbers(found.radius_px) == pytest.approx((570, 150.0, 0.29652, 149.8, 150.2, 0.0))
    assert found.valid == 0.95
    far = [replace(one, distance_mm=math.nan) if n % 20 == 0 else one for n, one in enumerate(minute())]
    assert as_numbers(spreads_of(far).distance_mm)[0] == 570


def test_a_camera_behind_the_ranger_sees_r_change_less() -> None:
    behind = CrossCheck(focal_px=600, marker_radius_mm=90 * 2360 / 360, camera_offset_mm=2000)
    found = suggest(minute(), BayConfig(fusion=FusionConfig(cross_check=behind)), SIZE)
    assert found.before_mm == pytest.approx(min(30.0, 2360 * (150 / 147.3 - 1)))
    far = BayConfig(fusion=FusionConfig(cross_check=behind, distance_hysteresis_mm=40))  # by Z alone it is too early
    assert "R is 150.0 px, 143.9 px there" in refused(noisy(3.0), far)
    assert suggest(noisy(3.0), PLAIN, SIZE).refusals == ()


def noisy(step_px: float) -> list[TeachSample]:
    """R in steps of this, up and down."""
    return [replace(one, circle=Circle(330, 240, 150 + step_px * (n % 3 - 1))) for n, one in enumerate(minute())]


def test_a_wide_spread_to_the_side_needs_more_tolerance() -> None:
    samples = [replace(one, circle=Circle(330 + 9.0 * (-1) ** n, 240, 150)) for n, one in enumerate(minute())]
    found = {value.path[1]: value for value in suggest(samples, PLAIN, SIZE).values}["tolerance_px"]
    assert (found.value, found.old) == (56.0, 20.0)  # 4 * 1.4826 * 9 + 2 = 55.4


@pytest.mark.mostly_long
@pytest.mark.one_interpreter
@pytest.mark.parametrize("place", PLACES, ids=lambda place: f"{place.distance_mm:.0f}mm-{place.sigma_px}px")
@pytest.mark.parametrize("decision", ["plain", "held"])
def test_on_other_days_d_is_1_at_the_place_and_0_before_it(place: Place, decision: str) -> None:
    """Air 25 K colder or warmer, R by 0.8 % off: in 99.9 % of the ticks there, in none of them 10 cm before."""
    chance = Random(f"{place} {decision}")
    bay = BayConfig(fusion=FusionConfig(decision=decision))
    suggestion = taught(place, bay, chance)
    assert suggestion.refusals == ()
    config = with_values(bay.fusion, suggestion)
    there, before = [], []
    for day in (Day(), Day(25, -0.008), Day(25, 0.008), Day(-25, -0.008), Day(-25, 0.008)):
        there.append(share_of_stop(place, day, chance, config, start_mm=place.distance_mm, seconds=10))
        before.append(share_of_stop(place, day, chance, config, start_mm=place.distance_mm + BEFORE_MM, seconds=10))
        assert -10 < first_stop_mm(place, day, chance, config) < BEFORE_MM  # at 10 cm/s, frames are 6 mm apart
    assert sum(there) / len(there) >= 0.999
    assert max(before) == 0


def refused(samples: list[TeachSample], bay: BayConfig = PLAIN, scale: MarkerScale | None = None) -> str:
    found = suggest(samples, bay, SIZE, scale)
    assert found.values == ()
    assert found.before_mm is None
    return "; ".join(found.refusals)


def test_too_few_readings_are_refused() -> None:
    assert "too few readings of the marker: 0, at least 100" in refused([])
    assert refused([replace(one, frame_ns=n // 10) for n, one in enumerate(minute())]) == (
        "too few readings of the marker: 60, at least 100 are needed"
    )
    assert refused([replace(one, echo_ns=n // 10) for n, one in enumerate(minute())]) == (
        "too few readings of the distance: 60, at least 100 are needed"
    )
    gaps = [replace(one, distance_mm=None) if n % 8 == 0 else one for n, one in enumerate(minute())]
    assert "good together in 88 % of the time only; at least 90 %" in refused(gaps)


def test_a_truck_that_moves_is_refused() -> None:
    away = [replace(one, distance_mm=(one.distance_mm or 0) + 20 * n / 600) for n, one in enumerate(minute())]
    assert "Z changed by 17 mm, at most 10 mm" in refused(away)
    and_back = [replace(one, distance_mm=375.0) if 200 <= n < 300 else one for n, one in enumerate(minute())]
    assert "Z changed by 15 mm" in refused(and_back)
    smaller = [replace(one, circle=Circle(330, 240, 150 - n / 100)) for n, one in enumerate(minute())]
    assert "R changed by 5.0 px, at most 4.1 px" in refused(smaller)
    aside = [replace(one, circle=Circle(330 + n / 20, 240, 150)) for n, one in enumerate(minute())]
    assert "centre changed by 25.0 px, at most 15.0 px" in refused(aside)


def test_a_marker_that_the_picture_cuts_or_cannot_hold_is_refused() -> None:
    assert suggest(minute(u_px=152), PLAIN, SIZE).refusals == ()
    assert "cut by the picture's edge in 600 of 600 samples" in refused(minute(u_px=150))
    assert "does not fit into the picture: it is 490 px across, the picture 640 x 480 px" in refused(
        minute(245.0, 220.0)
    )
    assert "no picture was available" in suggest(minute(u_px=150), PLAIN, None).notes[0]


def test_values_that_contradict_the_scale_are_refused() -> None:
    fits = BayConfig(fusion=FusionConfig(cross_check=CrossCheck(focal_px=600, marker_radius_mm=90)))
    assert suggest(minute(), fits, SIZE).refusals == ()
    other = BayConfig(fusion=FusionConfig(cross_check=CrossCheck(focal_px=600, marker_radius_mm=120)))
    assert "by [fusion.cross_check] R 150.0 px is at 480 mm, Z is 360 mm" in refused(minute(), other)
    sample = ScaleSample(0, 150.0, 360.0)
    learned = MarkerScale(54_000.0, 360.0, 0.01, 5, sample)
    assert suggest(minute(), BayConfig(), SIZE, learned).notes[:-1] == ()
    assert "differs by +20 %" in suggest(minute(180.0), BayConfig(), SIZE, learned).notes[0]
    assert "by earlier visits R is 111 to 202 px at Z 360 mm, and it is 210.0 px" in refused(
        minute(210.0), BayConfig(), learned
    )
    contradicting = [replace(one, contradicts=n % 8 == 0) for n, one in enumerate(minute())]
    assert "contradicted each other in 12 % of the time" in refused(contradicting)


def test_a_place_at_which_10_cm_can_not_be_told_apart_is_refused() -> None:
    assert "D could be 1 already 100 mm before the place" in refused(minute(12.0, 2500.0))
    hysteresis = BayConfig(fusion=FusionConfig(decision="plain", radius_hysteresis_px=50, distance_hysteresis_mm=100))
    assert "less hysteresis" in refused(minute(), hysteresis)


def test_values_outside_their_ranges_are_refused() -> None:
    leaves = BayConfig(visit=VisitConfig(leave_distance_mm=400.0))
    assert refused(minute(), leaves) == (
        "not allowed: visit.leave_distance_mm: must be at least 430 mm: Z_th, its hysteresis and visit.band_mm"
    )


def test_a_note_tells_where_little_overshoot_is_left() -> None:
    bay = BayConfig(guidance=GuidanceConfig(overshoot_mm=10.0, aim_u_px=320))
    assert "D becomes 1 7 mm before the place" in suggest(minute(), bay, SIZE).notes[0]
    assert suggest(minute(), BayConfig(guidance=GuidanceConfig(aim_u_px=320)), SIZE).notes == ()


def test_the_lines_for_the_file() -> None:
    assert toml_lines("A", suggest(minute(), PLAIN, SIZE)) == (
        'name = "A"  # of [[bays]]\n'
        "fusion.radius_threshold_px = 147.3\n"
        "fusion.distance_threshold_mm = 390.0\n"
        "guidance.aim_u_px = 330.0\n"
        "guidance.aim_v_px = 240.0\n"
    )


numbers = st.floats() | st.floats(0, 500)
circles = st.none() | st.builds(Circle, numbers, numbers, numbers)
wild = st.builds(
    TeachSample, st.integers(-(2**63), 2**63), st.integers(), circles, st.integers(), st.none() | numbers, st.booleans()
)


@pytest.mark.one_interpreter
@given(
    st.lists(wild, max_size=30),
    st.integers(1, 200),
    st.tuples(st.floats(1, 1000), st.floats(1, 5000), st.floats(-100, 900)),
    st.none() | st.tuples(st.integers(1, 5000), st.integers(1, 5000)),
    st.none() | st.builds(MarkerScale, st.floats(1, 1e6), st.floats(1, 4000), st.just(0.0), st.just(3), st.none()),
)
def test_whatever_was_measured_the_values_are_allowed(
    among: list[TeachSample],
    every: int,
    place: tuple[float, float, float],
    size_px: tuple[int, int] | None,
    scale: MarkerScale | None,
) -> None:
    radius_px, distance_mm, u_px = place
    samples = minute(radius_px, distance_mm, u_px=u_px)
    for n, sample in enumerate(among):
        samples.insert(n * every % len(samples), sample)
    found = suggest(samples, BayConfig(), size_px, scale)
    assert bool(found.values) != bool(found.refusals)
    if not found.values:
        return
    named = values(found)
    assert 0 < named["fusion.radius_threshold_px"] < radius_px
    assert distance_mm < named["fusion.distance_threshold_mm"] <= MAX_DISTANCE_MM
    FusionConfig(
        radius_threshold_px=named["fusion.radius_threshold_px"],
        distance_threshold_mm=named["fusion.distance_threshold_mm"],
    )
    GuidanceConfig(
        **{key.removeprefix("guidance."): value for key, value in named.items() if key.startswith("guidance")}
    )
    assert found.before_mm is not None
    assert 0 <= found.before_mm < 1000
