"""The trend of the marker's rim over visits and days: expected numbers."""

import random

import pytest

from gateway.config import PictureConfig
from gateway.core.marker_wear import DAY_S, KEPT_DAYS, OF_A_DAY, MarkerWear, RimSeen, WearTrend, wear, with_visit

LIMITS = PictureConfig(rim_visible_min=0.6, rim_contrast_min=0.5, rim_forecast_days=7)
BEGIN_S = 20_000 * DAY_S
HOUR_S = 3600


def at(day: int, visit: int, visible: float, contrast: float = 1.2) -> RimSeen:
    return RimSeen(BEGIN_S + day * DAY_S + visit * HOUR_S, visible, contrast)


def over(*days: tuple[float, ...], contrast: float = 1.2) -> tuple[RimSeen, ...]:
    """The visits of some days, as they are kept."""
    rims: tuple[RimSeen, ...] = ()
    for day, values in enumerate(days):
        for n, visible in enumerate(values):
            rims = with_visit(rims, at(day, n, visible, contrast))
    return rims


def found(rims: tuple[RimSeen, ...], *, worn: bool = False, limits: PictureConfig = LIMITS) -> MarkerWear:
    known = wear(rims, limits, worn=worn)
    assert known is not None
    return known


def test_nothing_is_known_of_nine_visits_and_the_median_of_ten() -> None:
    rims = over((0.9, 0.8, 0.9), (0.8, 0.9, 0.8), (0.9, 0.8, 0.9))
    assert wear(rims, LIMITS, worn=False) is None
    rims = with_visit(rims, at(2, 5, 0.84))
    assert found(rims) == MarkerWear(10, WearTrend(0.87), WearTrend(1.2), worn=False)


def test_a_steady_fall_is_forecast_in_days() -> None:
    # 1.5 % a day from 94 %; of 3 visits a day the median of the newest 10 is that of the day before.
    rims = over(*((0.94 - 0.015 * day,) * 3 for day in range(9)))
    known = found(rims)
    assert known.visible.value == pytest.approx(0.835)
    assert known.visible.per_day == pytest.approx(-0.015)
    assert known.visible.days_left == pytest.approx(15.667, abs=0.001)  # 0.235 / 0.015
    assert known.days_left == known.visible.days_left
    assert known.contrast == WearTrend(1.2)
    assert not known.worn


def test_it_is_worn_seven_days_before_it_is_below_the_limit() -> None:
    days = [(0.94 - 0.015 * day,) * 3 for day in range(30)]
    worn = [found(over(*days[:n])).worn for n in range(4, 30)]
    first = worn.index(True) + 4
    # (value - 0.6) / 0.015 < 7 is value < 0.705; of 10 visits 8 are of three days: 0.94 - 0.015 (n - 3) after n days.
    assert first == 19
    assert all(worn[first - 4 :])


def test_a_fall_of_five_days_is_not_certain_and_one_of_six_is() -> None:
    fall = [(0.95 - 0.03 * day,) * 3 for day in range(6)]
    assert found(over(*fall[:5])).visible.per_day is None
    assert found(over(*fall)).visible.per_day == pytest.approx(-0.03)


def test_chance_alone_is_no_trend() -> None:
    chance = random.Random(41)
    forecasts = []
    for _ in range(200):
        days = [tuple(chance.gauss(0.9, 0.03) for _ in range(4)) for _ in range(14)]
        known = found(over(*days))
        assert not known.worn
        forecasts.append(known.visible.per_day is not None)
    assert sum(forecasts) <= 10  # 2 in 100 are to be expected of a test on both sides


def test_one_dirty_truck_of_four_is_neither_a_trend_nor_worn() -> None:
    """It comes once a day, with ever less of its rim."""
    days = [(0.93, 0.95, 0.91 - 0.02 * day, 0.94) for day in range(20)]
    known = found(over(*days))
    assert known.visible.value >= 0.93
    assert known.visible.days_left is None
    assert not known.worn


def test_below_the_limit_it_is_worn_and_clean_visits_end_it() -> None:
    rims = over((0.9,) * 4, (0.58,) * 6, (0.58,) * 6)
    assert found(rims) == MarkerWear(16, WearTrend(0.58, None, 0.0), WearTrend(1.2), worn=True)
    worn, ended_after = True, 0
    while worn:
        ended_after += 1
        rims = with_visit(rims, at(3, ended_after, 0.95))
        worn = found(rims, worn=worn).worn
    assert ended_after == 8  # of the newest 10


def test_just_above_the_limit_it_stays_worn_until_it_is_better_by_a_tenth() -> None:
    just = over((0.65,) * 5, (0.65,) * 6)
    better = over((0.67,) * 5, (0.67,) * 6)
    assert [found(just, worn=worn).worn for worn in (False, True)] == [False, True]
    assert [found(better, worn=worn).worn for worn in (False, True)] == [False, False]


def test_a_forecast_ends_later_than_it_begins() -> None:
    falling = over(*((0.90 - 0.015 * day,) * 3 for day in range(14)))  # 0.72
    assert found(falling).days_left == pytest.approx(8.0)
    assert [found(falling, worn=worn).worn for worn in (False, True)] == [False, True]


def test_cleaned_markers_begin_a_new_trend() -> None:
    falling = over(*((0.95 - 0.03 * day,) * 4 for day in range(10)))
    assert found(falling).worn
    rims = falling
    for n in range(12):
        rims = with_visit(rims, at(10 + n // 4, n % 4, 0.96))
    assert len(rims) < 20
    known = found(rims, worn=True)
    assert (known.visible.value, known.days_left, known.worn) == (0.96, None, False)


def test_fading_paint_is_forecast_by_its_contrast() -> None:
    rims: tuple[RimSeen, ...] = ()
    for day in range(10):
        for n in range(3):
            rims = with_visit(rims, at(day, n, 0.95, 1.0 - 0.04 * day))
    known = found(rims)
    assert known.contrast.value == pytest.approx(0.68)
    assert known.contrast.days_left == pytest.approx(4.5)
    assert (known.visible.days_left, known.worn) == (None, True)


def test_a_limit_of_zero_is_off() -> None:
    off = PictureConfig(rim_visible_min=0, rim_contrast_min=0)
    rims = over(*((0.5 - 0.03 * day,) * 3 for day in range(10)), contrast=0.01)
    known = found(rims, limits=off)
    assert (known.days_left, known.worn) == (None, False)
    no_forecast = PictureConfig(rim_visible_min=0.6, rim_forecast_days=0)
    nearly = found(over(*((0.95 - 0.03 * day,) * 3 for day in range(10))), limits=no_forecast)
    assert nearly.days_left == pytest.approx((0.71 - 0.6) / 0.03)
    assert not nearly.worn


def test_what_is_kept_is_bounded_in_visits_and_in_days() -> None:
    rims = over(*((0.9,) * 20 for _ in range(40)))
    assert len(rims) == KEPT_DAYS * OF_A_DAY
    assert rims[0].unix_s // DAY_S == 20_000 + 40 - KEPT_DAYS
    assert rims[-1] == at(39, 19, 0.9)


def test_a_visit_before_the_others_means_that_the_clock_was_wrong() -> None:
    rims = over((0.9,) * 3, (0.9,) * 3)
    assert with_visit(rims, at(0, 1, 0.8)) == (at(0, 0, 0.9), at(0, 1, 0.9), at(0, 1, 0.8))


def test_day_and_night_are_not_taken_for_cleaning() -> None:
    rims: tuple[RimSeen, ...] = ()
    for day in range(20):
        for hour in range(24):
            rims = with_visit(rims, at(day, hour, 0.95 - 0.004 * day, 1.32 if 6 <= hour < 18 else 1.08))
    assert len(rims) == 20 * OF_A_DAY
    assert found(rims).visible.per_day == pytest.approx(-0.004)


@pytest.mark.one_interpreter
def test_a_fleet_of_clean_and_dirty_trucks_makes_no_flood_of_alarms() -> None:
    for dirty, most in ((0.3, 1), (0.5, 3)):
        chance, rims, worn, alarms = random.Random(7), over(), False, 0
        for day in range(60):
            for hour in range(24):
                rims = with_visit(rims, at(day, hour, 0.55 if chance.random() < dirty else 0.98))
                known = wear(rims, LIMITS, worn=worn)
                was, worn = worn, known is not None and known.worn
                alarms += worn and not was
        assert alarms <= most


@pytest.mark.parametrize("dirty", [0.8, 1.0])
def test_a_day_after_all_were_cleaned_it_is_in_order(dirty: float) -> None:
    chance, rims = random.Random(8), over()
    for day in range(5):
        for hour in range(24):
            rims = with_visit(rims, at(day, hour, 0.55 if chance.random() < dirty else 0.98))
    worn = found(rims).worn
    assert worn
    for hour in range(24):
        rims = with_visit(rims, at(5, hour, 0.98))
        worn = found(rims, worn=worn).worn
    assert not worn


def test_a_high_limit_can_be_met_again() -> None:
    high = PictureConfig(rim_visible_min=0.95)
    assert found(over((0.97,) * 12), worn=True, limits=high).worn  # below 0.975
    assert not found(over((0.98,) * 12), worn=True, limits=high).worn
