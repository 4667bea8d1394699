"""R x Z from visit to visit: when it is believed, what is kept, and a visit that differs."""

from dataclasses import replace

import pytest

from gateway.core.scale import MarkerScale, ScaleSample, distance_of, expected_radius_px, learned, with_visit

S = 1_000_000_000


def samples(*products: float, recipe: int = 0) -> tuple[ScaleSample, ...]:
    """Trucks in place at 200 mm, 201 mm, ..., with these R x Z."""
    return tuple(ScaleSample(recipe, px_mm / (200.0 + n), 200.0 + n) for n, px_mm in enumerate(products))


def test_three_visits_of_the_recipe_are_believed() -> None:
    others = samples(9_000, 9_000, 9_000, recipe=7)
    assert learned((), 0) is None
    assert learned((*others, *samples(50_000, 51_000)), 0) is None
    visits = samples(50_000, 51_000, 50_500, 52_000)
    found = learned((*visits[:2], *others, *visits[2:]), 0)
    assert found is not None
    assert found.px_mm == pytest.approx(50_750)
    assert (found.distance_mm, found.visits) == (201.5, 4)
    assert found.spread == pytest.approx(2_000 / 50_750)
    assert (found.newest, found.jump) == (visits[3], None)
    assert learned(visits[:3], 0) is not None


@pytest.mark.parametrize(
    ("newest", "jump"), [(54_900, None), (55_100, 0.102), (45_100, None), (44_900, -0.102), (90_000, 0.8)]
)
def test_a_visit_that_differs_by_more_than_a_tenth_from_those_before(newest: float, jump: float | None) -> None:
    found = learned(samples(49_000, 50_000, 51_000, newest), 0)
    assert found is not None
    assert found.jump == (None if jump is None else pytest.approx(jump, abs=1e-6))
    assert found.visits == 4


def test_sixty_visits_are_kept_and_the_newest_is_last() -> None:
    kept: tuple[ScaleSample, ...] = ()
    for n in range(61):
        kept = with_visit(kept, ScaleSample(0, 193.0, 280.0, n))
        assert kept[-1].t_ns == n
    assert [sample.t_ns for sample in kept] == list(range(1, 61))


def test_the_date_of_a_visit() -> None:
    sample = ScaleSample(0, 193.0, 280.0, t_ns=7 * S)
    assert sample.date_s(1_700_000_000 * S + 999_999_999) == 1_700_000_007
    assert replace(sample, unix_s=1_600_000_000).date_s(1_700_000_000 * S) == 1_600_000_000, "of before the restart"


def test_a_radius_is_expected_up_to_one_and_a_half_times_the_learned_distance() -> None:
    scale = MarkerScale(54_000.0, 280.0, 0.02, 9, ScaleSample(0, 193.0, 280.0))
    assert expected_radius_px(scale, 420.0, 0.2) == pytest.approx((54_000 / 420 / 1.2, 54_000 / 420 * 1.2))
    assert expected_radius_px(scale, 420.1, 0.2) is None
    assert expected_radius_px(scale, None, 0.2) is None
    assert expected_radius_px(None, 280.0, 0.2) is None
    assert distance_of(scale, 200.0) == 270.0
