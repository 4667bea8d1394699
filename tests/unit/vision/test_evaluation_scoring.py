"""Verdicts and figures with numbers worked out by hand."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.core.detection import Circle, Detection, Ellipse, Tracking
from gateway.vision.offline.evaluation.constancy import constancy
from gateway.vision.offline.evaluation.labels import Label
from gateway.vision.offline.evaluation.scoring import (
    Closeness,
    ScoredPicture,
    acquisition,
    badness,
    judge,
    scores,
    wilson,
)
from gateway.vision.offline.evaluation.summary import UNGROUPED, as_json, in_sequence, series_by, summary

TRUE = Label(file="a.png", found=True, u=100, v=50, r=40)
EMPTY = Label(file="e.png", found=False)


def seen(u: float = 100, v: float = 50, r: float = 40) -> Detection:
    return Detection(Circle(u, v, r))


@pytest.mark.parametrize(
    ("found", "verdict"),
    [
        (seen(), Closeness.CLOSE),
        (seen(u=102), Closeness.CLOSE),
        (seen(u=102.01), Closeness.LOOSE),
        (seen(r=42), Closeness.CLOSE),
        (seen(r=37.9), Closeness.LOOSE),
        (seen(u=110, r=50), Closeness.LOOSE),
        (seen(u=110.1), Closeness.WRONG),
        (seen(r=50.1), Closeness.WRONG),
        (seen(r=29.9), Closeness.WRONG),
        (Detection(None), Closeness.MISSED),
        (Detection(None, tracking=Tracking.COASTED, predicted=Circle(100, 50, 40)), Closeness.MISSED),
    ],
)
def test_verdicts_at_their_limits(found: Detection, verdict: Closeness) -> None:
    assert judge(TRUE, found).verdict is verdict


def test_an_empty_picture_wants_no_answer() -> None:
    assert judge(EMPTY, Detection(None)).verdict is Closeness.CLEAR
    assert judge(EMPTY, seen()).verdict is Closeness.FALSE


def test_errors_are_those_of_the_circle_round_the_rim() -> None:
    label = Label(file="a", found=True, u=100, v=50, r=40, a=50, b=32)
    rim = Ellipse(103, 54, 51, 30, 0.3)
    outcome = judge(label, Detection(Circle(103, 54, 51), ellipse=rim))
    assert outcome.centre_px == pytest.approx(5)
    assert outcome.radius_share == pytest.approx(0.02)
    assert outcome.mean_radius_share == pytest.approx(math.sqrt(51 * 30) / 40 - 1)
    assert outcome.verdict is Closeness.LOOSE  # 5 px of 50: beyond 5 %
    assert judge(label, Detection(Circle(100, 50, 40))).mean_radius_share == pytest.approx(0)
    mean = judge(label, Detection(Circle(100, 50, 51), ellipse=Ellipse(100, 50, 51, 25, 0)), mean=True)
    assert (mean.verdict, mean.radius_share) == (Closeness.LOOSE, mean.mean_radius_share)
    assert judge(label, Detection(Circle(100, 50, 51), ellipse=Ellipse(100, 50, 51, 25, 0))).verdict is Closeness.CLOSE


def test_figures_by_hand() -> None:
    outcomes = [
        judge(TRUE, seen(u=101), 2_000_000),
        judge(TRUE, seen(v=52, r=39.2), 4_000_000),
        judge(TRUE, seen(u=104, r=44), 6_000_000),
        judge(TRUE, seen(u=400), 8_000_000),
        judge(TRUE, Detection(None, tracking=Tracking.COASTED), 10_000_000),
        judge(EMPTY, Detection(None), 12_000_000),
        judge(EMPTY, seen(), 14_000_000),
        judge(Label(file="v", found=True, u=100, v=50, r=40, tol_px=2.1), Detection(None), 16_000_000),
    ]
    f = scores(outcomes)
    assert (f.pictures, f.with_marker, f.without) == (8, 6, 2)
    assert (f.on_target, f.close, f.wrong, f.missed, f.coasted, f.false, f.vague_labels) == (3, 2, 1, 2, 1, 1, 1)
    assert [f.detected_share, f.close_share] == pytest.approx([1 / 2, 1 / 3])
    assert f.centre_median_px == pytest.approx(2)
    assert f.centre_p95_px == pytest.approx(3.8)  # between 2 and 4, linear
    assert f.radius_median_pct == pytest.approx(2)
    assert f.radius_bias_pct == pytest.approx(0)
    assert f.radius_p95_pct == pytest.approx(9.2)
    assert [f.ms_median, f.ms_p95] == pytest.approx([9, 15.3])


def test_nothing_to_measure_is_none_and_not_zero() -> None:
    f = scores([judge(EMPTY, Detection(None))])
    assert (f.detected_share, f.detected_low, f.close_share, f.centre_median_px, f.radius_p95_pct) == (None,) * 5
    assert scores([]).ms_median is None


def test_wilson_against_tabulated_values() -> None:
    assert list(wilson(10, 10)) == pytest.approx([0.7225, 1], abs=1e-4)
    assert list(wilson(0, 10)) == pytest.approx([0, 0.2775], abs=1e-4)
    assert list(wilson(51, 53)) == pytest.approx([0.8725, 0.9896], abs=2e-4)


@given(st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_the_interval_holds_the_share(of: tuple[int, int]) -> None:
    low, high = wilson(*of)
    assert 0 <= low <= of[0] / of[1] + 1e-12
    assert of[0] / of[1] - 1e-12 <= high <= 1


def test_acquisition_counts_what_came_before_and_after() -> None:
    row = [Detection(None), seen(u=300), seen(), Detection(None, tracking=Tracking.COASTED), seen(u=101), seen(u=300)]
    found = acquisition("s", [judge(TRUE, detection) for detection in row])
    assert (found.frames, found.acquired_after) == (6, 2)
    assert found.after is not None
    assert (found.after.on_target, found.after.wrong, found.after.coasted) == (2, 1, 1)
    assert found.after.detected_share == 0.5
    never = acquisition("s", [judge(TRUE, Detection(None))])
    assert (never.acquired_after, never.after) == (None, None)


def test_the_worst_are_first() -> None:
    order = [judge(EMPTY, seen()), judge(TRUE, seen(u=400)), judge(TRUE, seen(u=150)), judge(TRUE, Detection(None))]
    order += [judge(TRUE, seen(u=108)), judge(TRUE, seen(r=43)), judge(TRUE, seen()), judge(EMPTY, Detection(None))]
    mixed = order[::-1]
    assert sorted(mixed, key=badness) == order


def test_r_times_z_of_a_perfect_pinhole_whose_tape_starts_elsewhere() -> None:
    z = [50.0, 100, 200, 400]
    found = constancy("s", [12_000 / (at + 6) for at in z], z, [12_000 / at for at in z])
    assert found.offset_cm == pytest.approx(6, abs=0.05)
    assert found.largest_with_offset_pct == pytest.approx(0, abs=0.05)
    assert found.label_largest_pct == pytest.approx(0, abs=1e-9)
    products = sorted(12_000 * at / (at + 6) for at in z)
    middle = (products[1] + products[2]) / 2
    assert found.median_px_cm == pytest.approx(middle)
    assert found.largest_pct == pytest.approx(100 * (1 - products[0] / middle))
    assert constancy("s", [10.0, 5.0], [1.0, 2.0], [10.0, 6.0]).offset_cm is None


def on(file: str, r: float = 40, **more: object) -> ScoredPicture:
    label = Label.model_validate({"file": file, "found": True, "u": 9, "v": 9, "r": 40, **more})
    return judge(label, Detection(Circle(9, 9, r)))


def test_groups_halves_series_and_sequences() -> None:
    outcomes = [
        on("cam1_a.png", group="x", z_cm=100),
        on("cam1_b.png", r=41, group="y", z_cm=100),
        on("cam1_c.png", r=90, group="y", z_cm=100),  # wrong: no radius to go by
        on("cam2_a.png", z_cm=100),
        on("cam2_b.png", series="mine", frame=7),
        on("cam2_c.png", series="mine", frame=2),
    ]
    series = series_by("^(cam[0-9])_")
    found = summary("m", outcomes, series, split=True, followed=True)
    assert {name: part.pictures for name, part in found.groups.items()} == {"x": 1, "y": 2, UNGROUPED: 3}
    assert sum(part.pictures for part in found.halves.values()) == 6
    tuning = sum(outcome.label.tuning_half for outcome in outcomes)
    assert found.halves["tuning half"].pictures == tuning
    (constant,) = found.constancy
    assert (constant.series, constant.pictures, constant.median_px_cm) == ("cam1", 2, 4050)
    assert [(s.series, s.frames) for s in found.sequences] == [("mine", 2)]
    assert [label.frame for label in in_sequence([o.label for o in outcomes], series)["mine"]] == [2, 7]
    rows = as_json(found, series)["pictures"]
    assert [row["series"] for row in rows] == ["cam1"] * 3 + ["cam2", "mine", "mine"]
    assert rows[2]["verdict"] == "wrong"
    assert rows[1]["radius_error_pct"] == pytest.approx(2.5)
    assert series_by(None)(outcomes[0].label) == "x"
    assert series_by("zzz")(outcomes[0].label) == ""
    plain = summary("m", [on("a")], series, split=False, followed=False)
    assert (plain.groups, plain.halves, plain.sequences, plain.constancy) == ({}, {}, (), ())
