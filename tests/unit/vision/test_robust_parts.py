"""The parts of the robust method by themselves: redness, candidates, fits, evidence, confidence."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gateway.core.detection import Ellipse
from gateway.vision.detect.geometry import same_ellipse
from gateway.vision.detect.robust import candidates, constants, ellipses, measurement
from gateway.vision.detect.robust.candidates import Seed
from gateway.vision.detect.robust.clearest_rim import EVEN_PX, GOOD, clearest_rim, even, quality, roundness
from gateway.vision.detect.robust.decision import (
    ODDS,
    POWERS,
    Candidate,
    Limits,
    candidate,
    confidence,
    failed_gate,
    hopeless,
    weight,
)
from gateway.vision.detect.robust.evidence import Evidence, masked_median
from gateway.vision.detect.robust.redness import pyramid, redness
from gateway.vision.detect.robust.refinement import refine
from gateway.vision.detect.robust.rim_fine import Rim
from gateway.vision.detect.robust.search import _rim_near
from tests import decoys
from tools.detection_methods import SHARE_MEANING

LIMITS = Limits(min_radius_px=5.0, max_radius_px=200.0, min_confidence=0.5)
RIM = Rim(
    Ellipse(80.0, 60.0, 30.0, 30.0, 0.0), rms_px=0.0, support=1.0, visible=1.0, contrast=100.0, inliers=190,
    blur_px=1.0, wave_px=0.0,
)  # fmt: skip
PERFECT = Evidence(
    RIM.ellipse, coverage=1, leak=0, covered=0, visible=1, contrast=1, rise=1, noise=0, fill=1, hollow=0, redness=1,
    veil=0, haze=0, colour=(40, 40, 190),
)  # fmt: skip


def around(u: float, v: float, a: float, b: float, turn: float, n: int = 48) -> ellipses.Floats:
    t = np.arange(n) * 2 * np.pi / n
    x, y = a * np.cos(t), b * np.sin(t)
    return np.stack([u + x * np.cos(turn) - y * np.sin(turn), v + x * np.sin(turn) + y * np.cos(turn)], axis=1)


def test_redness_is_a_ratio_that_shade_hardly_changes() -> None:
    paint = np.array([[[30, 40, 200]]], np.uint8)
    lit, shaded = float(redness(paint)[0, 0]), float(redness(paint // 2)[0, 0])

    assert lit == pytest.approx(math.log(208 / 48), abs=1e-6)
    assert shaded == pytest.approx(math.log(108 / 28), abs=1e-6)
    assert float(redness(np.array([[[90, 90, 90]]], np.uint8))[0, 0]) == 0
    assert float(redness(np.array([[[60, 120, 60]]], np.uint8))[0, 0]) < 0


def test_a_level_knows_where_its_pixels_lie_in_the_full_frame() -> None:
    image = np.zeros((64, 96, 3), np.uint8)
    image[32:40, 48:56] = 255
    levels = pyramid(image, 2, 4)

    assert [level.factor for level in levels] == [2, 4, 8, 16]
    rows, columns = np.nonzero(levels[2].bgr[..., 0])
    assert (levels[2].to_full(columns[0]), levels[2].to_full(rows[0])) == (51.5, 35.5)
    assert levels[2].to_level(51.5) == columns[0]


@pytest.mark.parametrize("wrong", [0.0, 0.4])
def test_the_circle_most_points_agree_on(wrong: float) -> None:
    points = around(50, 40, 20, 20, 0)
    points[: int(wrong * 48)] += np.random.default_rng(1).uniform(4, 30, (int(wrong * 48), 2))
    (found,) = ellipses.circles_by_consensus(points[None], np.ones((1, 48)), np.array([1.0]))

    assert found == pytest.approx([50, 40, 20], abs=1e-6)


def test_no_circle_through_too_few_points() -> None:
    weight = np.zeros((1, 48))
    weight[0, :2] = 1
    assert np.isnan(ellipses.circles_by_consensus(around(0, 0, 9, 9, 0)[None], weight, np.array([1.0]))).all()


@pytest.mark.parametrize("turn", [0.0, 0.4, 1.7, 3.0])
def test_an_ellipse_through_points_a_quarter_of_which_are_wrong(turn: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(constants, "ELLIPSE_ROUNDS", 12)
    points = around(50, 40, 24, 18, turn)
    points[5:17] = 1.6 * points[5:17] - 0.6 * np.array([50, 40])  # farther out by 11 px and more
    start = np.array([[51.0, 39.0, 21.0, 21.0, 0.0]])
    (found,) = ellipses.ellipses_by_weights(points[None], np.ones((1, 48)), start, np.array([5.0]))

    assert found[:4] == pytest.approx([50, 40, 24, 18], abs=0.05)
    assert abs((found[4] - turn + math.pi / 2) % math.pi - math.pi / 2) < 0.02


def test_distances_are_signed_and_in_pixels() -> None:
    shapes = np.array([[0.0, 0.0, 10.0, 5.0, 0.0]])
    points = np.array([[[12.0, 0.0], [0.0, 4.0], [-10.0, 0.0]]])

    assert ellipses.distances(shapes, points)[0] == pytest.approx([2, -1, 0])


def test_points_on_a_line_are_no_ellipse_and_do_no_harm_to_their_neighbours() -> None:
    line = np.stack([np.arange(48.0), np.zeros(48)], axis=1)
    both = np.stack([line, around(50, 40, 20, 20, 0)])
    start = np.array([[24.0, 0, 24, 24, 0], [50, 40, 19, 19, 0]])
    found = ellipses.ellipses_by_weights(both, np.ones((2, 48)), start, np.array([50.0, 5.0]))

    assert found[1, :4] == pytest.approx([50, 40, 20, 20], abs=0.01)


def test_votes_name_the_centre_of_a_disc_that_red_touches_on_one_side() -> None:
    sheet = decoys.sheet(160, 120, "concrete", 2)
    sheet.box(110, 61, 30, 6)
    sheet.disc(70.0, 60.0, 9.0)
    (level, *_) = pyramid(sheet.finished(), 1, 8)
    best = max(candidates.votes(level, candidates.red_plane(level)), key=lambda seed: seed.weight)

    assert (best.u_px, best.v_px) == pytest.approx((70, 60), abs=2)
    assert best.radius_px == pytest.approx(9, abs=1.5)


def test_equal_seeds_are_measured_once() -> None:
    seeds = [Seed(50, 50, 20, 1), Seed(52, 49, 21, 0.9), Seed(50, 50, 40, 0.8), Seed(90, 50, 20, 0.7)]

    assert candidates.distinct(seeds, 9) == [seeds[0], seeds[2], seeds[3]]
    assert candidates.distinct(seeds, 2) == [seeds[0], seeds[2]]


def test_evidence_tells_a_disc_from_a_tube() -> None:
    sheet = decoys.sheet(320, 120, "concrete", 2)
    sheet.disc(70.0, 60.0, 30.0)
    sheet.box(230, 60, 28, 200)
    levels = pyramid(sheet.finished(), 1, 8)
    disc, tube = measurement.of_ellipses(levels, [Ellipse(70, 60, 30, 30, 0), Ellipse(230, 60, 28, 28, 0)])
    assert disc is not None
    assert tube is not None

    assert (disc.coverage, disc.leak) == pytest.approx((1, 0), abs=0.03)
    assert disc.fill == pytest.approx(1, abs=0.02)
    assert disc.contrast > 1
    assert tube.leak > 0.25
    assert tube.coverage < 0.75


def test_evidence_follows_the_seeds_from_a_quarter_of_the_radius_away() -> None:
    sheet = decoys.sheet(160, 120, "wood", 2)
    sheet.disc(80.0, 60.0, 30.0)
    (found,) = measurement.gather(pyramid(sheet.finished(), 1, 8), [Seed(86, 56, 24, 1)])
    assert found is not None

    e = found.ellipse
    assert (e.u_px, e.v_px, e.semi_major_px) == pytest.approx((80, 60, 30), abs=0.6)


def test_a_median_over_a_mask() -> None:
    values = np.array([[1, 9, 5, 7], [1, 2, 3, 4]], np.float32)
    mask = np.array([[1, 0, 1, 1], [0, 0, 0, 0]], bool)

    assert masked_median(values, mask).tolist() == [5, 0]


def test_confidence_is_the_product_of_odds() -> None:
    perfect = confidence(Candidate(RIM, PERFECT))
    assert perfect == pytest.approx(ODDS * (1 / 1.03) ** 1.5 / (1 + ODDS * (1 / 1.03) ** 1.5))

    half_seen = confidence(Candidate(replace(RIM, support=0.5), PERFECT))
    assert half_seen / (1 - half_seen) == pytest.approx(perfect / (1 - perfect) * 0.5 ** POWERS["support"])
    assert set(POWERS) == set(SHARE_MEANING)


@pytest.mark.parametrize(
    ("code", "change"),
    [
        ("contrast", {"contrast": 0.1, "rise": 0.1, "redness": 0.2}),
        ("surroundings", {"contrast": 0.3, "rise": 0.3}),
        ("colour", {"redness": 0.05, "colour": (180.0, 181.0, 190.0)}),
        ("colour", {"colour": (220.0, 40.0, 190.0)}),
        ("colour", {"colour": (250.0, 20.0, 255.0)}),
        ("colour", {"colour": (30.0, 140.0, 255.0)}),
        ("colour", {"colour": (18.0, 91.0, 231.0)}),
        ("colour", {"colour": (44.0, 62.0, 128.0), "contrast": 0.7, "rise": 0.7}),
        ("coverage", {"coverage": 0.55, "leak": 0.1}),
        ("coverage", {"coverage": 0.55}),
        (None, {"coverage": 0.45, "covered": 0.5, "fill": 0.65}),
        ("coverage", {"coverage": 0.45, "covered": 0.5, "fill": 0.65, "leak": 0.1}),
        ("coverage", {"coverage": 0.45, "covered": 0.5, "fill": 0.55}),
        ("coverage", {"coverage": 0.45, "covered": 0.4, "fill": 0.65}),
        ("coverage", {"coverage": 0.35, "covered": 0.65, "fill": 0.65}),
        ("leak", {"leak": 0.45}),
        ("fill", {"fill": 0.45}),
        ("hollow", {"hollow": 0.8}),
        ("blur", {"rise": 2.5}),
        ("confidence", {"coverage": 0.65, "leak": 0.39, "fill": 0.5, "noise": 1.0}),
        (None, {}),
        (None, {"contrast": 0.1, "rise": 0.1, "redness": 0.1, "haze": 0.6}),
        ("colour", {"redness": 0.05, "colour": (92.0, 92.0, 100.0), "haze": 0.27}),
        (None, {"colour": (255.0, 180.0, 255.0)}),
        (None, {"colour": (32.0, 68.0, 218.0)}),
        (None, {"colour": (150.0, 90.0, 220.0)}),
    ],
)
def test_each_gate_of_the_evidence(code: str | None, change: dict[str, float]) -> None:
    assert failed_gate(candidate(RIM, replace(PERFECT, **change), LIMITS), LIMITS) == code  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("code", "change"),
    [
        ("radius", {"ellipse": Ellipse(0, 0, 4.9, 4.9, 0)}),
        ("radius", {"ellipse": Ellipse(0, 0, 201, 201, 0)}),
        ("shape", {"ellipse": Ellipse(0, 0, 30, 16, 0)}),
        ("visible", {"visible": 0.39}),
        ("support", {"support": 0.4}),
        ("blur", {"blur_px": 8.0}),
        ("confidence", {"rms_px": 1.7}),
    ],
)
def test_each_gate_of_the_rim(code: str, change: dict[str, float]) -> None:
    assert failed_gate(Candidate(replace(RIM, **change), PERFECT), LIMITS) == code  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("code", "change"),
    [
        (None, {}),
        (None, {"contrast": 0.5 * 0.15 + 0.001, "redness": 0.3, "colour": (80, 80, 95)}),
        ("contrast", {"contrast": 0.5 * 0.15 - 0.001, "redness": 0.3}),
        (None, {"contrast": 0.075, "redness": 0.3, "haze": 0.2}),  # behind haze less is enough
        (None, {"contrast": 0.5 * 0.4 + 0.001}),
        ("surroundings", {"contrast": 0.5 * 0.4 - 0.001}),
        (None, {"colour": (40, 78, 190)}),  # orange, but it may be nearer on the exact rim
        ("colour", {"colour": (190, 40, 60)}),
        ("colour", {"colour": (90, 90, 90)}),
        (None, {"ellipse": Ellipse(80.0, 60.0, 2.1, 2.1, 0.0)}),  # the rim is searched for within 3 px
        ("radius", {"ellipse": Ellipse(80.0, 60.0, 1.9, 1.9, 0.0)}),
        (None, {"ellipse": Ellipse(80.0, 60.0, 215.0, 215.0, 0.0)}),  # within 8 %
        ("radius", {"ellipse": Ellipse(80.0, 60.0, 218.0, 218.0, 0.0)}),
    ],
)
def test_no_rim_is_measured_where_a_gate_is_missed_by_half(code: str | None, change: dict[str, Any]) -> None:
    assert hopeless(replace(PERFECT, **change), LIMITS) == code


def test_what_is_not_red_weighs_nothing() -> None:
    assert weight(Candidate(RIM, PERFECT)) > 0
    assert weight(Candidate(RIM, replace(PERFECT, redness=-0.1))) == 0


def test_of_less_than_half_a_rim_in_the_picture_more_must_be_an_edge() -> None:
    cut = replace(RIM, support=0.95, visible=0.45)

    assert failed_gate(Candidate(cut, PERFECT), LIMITS) is None
    assert failed_gate(Candidate(replace(cut, rms_px=0.5), PERFECT), LIMITS) == "visible"
    assert failed_gate(Candidate(replace(cut, rms_px=0.5, visible=0.6), PERFECT), LIMITS) is None


def test_roundness_and_quality() -> None:
    assert roundness(RIM) == 1
    assert roundness(replace(RIM, rms_px=0.8)) == pytest.approx(0.5)
    assert quality(replace(RIM, rms_px=0.8, support=0.5)) == pytest.approx(0.25)


def test_a_rim_is_even_if_it_waves_no_more_than_its_noise_explains() -> None:
    assert even(replace(RIM, wave_px=EVEN_PX))
    assert not even(replace(RIM, wave_px=0.2, rms_px=0.1))
    assert even(replace(RIM, wave_px=0.2, rms_px=1.0))
    assert not even(replace(RIM, wave_px=0.2, rms_px=1.0, inliers=1000))


def test_rims_are_alike_within_a_share_of_their_size() -> None:
    one = Ellipse(50, 50, 30, 28, 0)

    assert same_ellipse(one, Ellipse(53, 47, 31, 27, 1))
    assert not same_ellipse(one, Ellipse(58, 50, 30, 28, 0))
    assert not same_ellipse(one, Ellipse(50, 50, 38, 28, 0))


def test_the_rim_of_a_dark_sign_with_a_white_line_is_measured_in_red_against_green() -> None:
    sheet = decoys.sheet(160, 120, "concrete", 2)
    sheet.fill(np.ones(sheet.paint.shape[:2], np.float32), (10, 8, 9))
    sheet.disc(80.0, 60.0, 21.5, (210, 210, 210))
    sheet.disc(80.0, 60.0, 20.0, (12, 12, 70))
    image, seed = sheet.finished(), Ellipse(80.5, 59.5, 20.3, 20.3, 0)
    by_all_colours, rim = refine(image, seed, 3.0), clearest_rim(image, seed)
    assert rim is not None
    assert by_all_colours is None or quality(by_all_colours) < quality(rim)

    assert rim.ellipse.semi_major_px == pytest.approx(20, abs=0.3)
    assert (rim.ellipse.u_px, rim.ellipse.v_px) == pytest.approx((80, 60), abs=0.2)


@pytest.mark.parametrize(("reach_px", "dark"), [(3, 0.0), (5, 0.5)])
def test_the_rim_of_a_ball_with_a_shadow_on_the_floor_is_measured_in_red_against_green(
    reach_px: float, dark: float
) -> None:
    """Below it, the floor gets lighter with the distance and the ball darker towards its rim: no plain step there."""
    sheet = decoys.sheet(160, 120, "concrete", 2)
    du, dv = sheet.far(80.0, 60.0)
    share = np.hypot(du, dv) / 32
    low = np.clip(dv / 32 / np.maximum(share, 0.1) + 0.3, 0, 1)
    floor = 1 - 0.9 * low * np.exp(-np.maximum(share - 1, 0) * 32 / reach_px)
    sheet.paint[:] = floor[..., None] * np.array((150, 155, 160))
    light = 1 - dark * low * np.clip(share, 0, 1) ** 6
    sheet.paint[share < 1] = (light[..., None] * np.array((60, 55, 200)))[share < 1]
    image, seed = sheet.finished(1.5), Ellipse(80.5, 59.5, 32.3, 32.3, 0)
    by_all_colours, rim = refine(image, seed, 3.0), clearest_rim(image, seed)
    assert by_all_colours is not None
    assert rim is not None

    assert by_all_colours.wave_px > EVEN_PX
    assert by_all_colours.ellipse.v_px > 60.5
    assert (rim.ellipse.u_px, rim.ellipse.v_px) == pytest.approx((80, 60), abs=0.15)
    assert rim.ellipse.semi_major_px == pytest.approx(32, abs=0.2)


def test_half_hidden_but_even_rims_stay_with_all_colours() -> None:
    sheet = decoys.sheet(160, 120, "concrete", 2)
    sheet.disc(80.0, 60.0, 32.0)
    sheet.polygon([(80, 60), (120, 20), (120, 75)], (190, 140, 60))
    image, seed = sheet.finished(), Ellipse(80.5, 59.5, 32.3, 32.3, 0)
    by_all_colours, rim = refine(image, seed, 3.0), clearest_rim(image, seed)
    assert by_all_colours is not None

    assert quality(by_all_colours) < GOOD
    assert rim == by_all_colours


def test_a_rim_that_was_seen_drawn_out_along_a_red_band_is_found_round() -> None:
    """Before the band there is no edge of redness, only one of brightness."""
    sheet = decoys.sheet(200, 120, "concrete", 2)
    sheet.box(100.0, 60.0, 99.0, 28.0, (24.0, 22.0, 105.0))
    sheet.disc(100.0, 60.0, 40.0)
    image, seen = sheet.finished(), Ellipse(100.0, 60.0, 58.0, 33.0, 0.0)
    drawn_out, rim = clearest_rim(image, seen), _rim_near(image, seen)
    assert rim is not None

    assert drawn_out is None or drawn_out.ellipse.semi_major_px > 45
    assert rim.ellipse.semi_major_px == pytest.approx(40, abs=0.1)
    assert (rim.ellipse.u_px, rim.ellipse.v_px) == pytest.approx((100, 60), abs=0.1)


@pytest.mark.parametrize(("contrast", "taken"), [(20.0, False), (90.0, True)])
def test_a_crease_in_red_cloth_is_not_taken_for_its_rim(
    monkeypatch: pytest.MonkeyPatch, contrast: float, taken: bool
) -> None:
    """However well its edges lie on an ellipse: most of the fall from red to not red must be there."""
    sheet = decoys.sheet(160, 120, "concrete", 2)
    sheet.disc(80.0, 60.0, 30.0)
    uneven, crease = replace(RIM, support=0.7, wave_px=0.5), replace(RIM, contrast=contrast)
    monkeypatch.setattr(
        "gateway.vision.detect.robust.clearest_rim.refine",
        lambda *_, opponent=False, **__: crease if opponent else uneven,
    )
    assert clearest_rim(sheet.finished(), RIM.ellipse) == (crease if taken else uneven)
