"""Thresholds, gates and exposure advice from drawn examples whose answer is known."""

import dataclasses
import math
import tomllib

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from gateway import config
from gateway.config import VisionConfig
from gateway.core.detection import Circle
from gateway.errors import ConfigError
from gateway.vision.detect.paper import stages
from gateway.vision.offline.evaluation.labels import Label
from gateway.vision.offline.tuning import exposure, histograms, proposal, report, samples, thresholds
from gateway.vision.offline.tuning.exposure import PictureLight, advice, measure, noise
from gateway.vision.offline.tuning.samples import Example
from gateway.vision.offline.tuning.study import study
from gateway.vision.offline.tuning.thresholds import Red, admission, bound_that_cuts, current, propose, remarks, score
from tests.discs import painted, rounded
from tests.self_contained import fetches_nothing

Picture = NDArray[np.uint8]
PAPER = VisionConfig()
TABLE_I = Red(24, 10, 43, 46)
DISC = Circle(80, 60, 30)
RED, WOOD, GREY = (40, 35, 190), (60, 110, 160), (130, 128, 126)  # H 179, S 208 / H 15, S 159 / nearly grey


def hsv(*colours: tuple[int, int, int]) -> samples.HsvColours:
    return np.array(colours, np.int16)


def bay(
    marker: tuple[int, int, int] = RED, ground: tuple[int, int, int] = GREY, r: float = 30, seed: int = 0
) -> Picture:
    """A disc at (80, 60), soft by 1 px, on a plain ground, with a little noise."""
    plain = painted(80, 60, r, marker, ground, (120, 160))
    return rounded(cv2.GaussianBlur(plain, (0, 0), 1.0) + np.random.default_rng(seed).normal(0, 2, plain.shape))


def example(image: Picture, circle: Circle | None = DISC, name: str = "a.png") -> Example:
    return samples.example(name, image, circle, PAPER)


def test_pixels_go_where_they_belong() -> None:
    found = example(bay())
    assert found.marked
    assert found.marker_px == pytest.approx(math.pi * 900, rel=0.01)
    assert len(found.marker) == pytest.approx(math.pi * (0.85 * 30) ** 2, rel=0.02)
    assert found.marker[:, 1].min() > 180
    assert found.ring[:, 1].max() < 40
    assert found.far_px + found.marker_px < 120 * 160
    assert abs(found.marker[:, 0]).max() <= 3, "hue is signed about red"
    empty = example(bay(), None)
    assert (empty.marked, empty.far_px, len(empty.far)) == (False, 120 * 160, 4800)
    assert not example(bay(), Circle(-30, 60, 31)).marked, "what is hardly in the picture has no pixels"


@pytest.mark.one_interpreter
@given(st.lists(st.tuples(st.integers(0, 179), st.integers(0, 255), st.integers(0, 255)), min_size=1, max_size=200),
       st.integers(1, 40), st.integers(0, 40), st.integers(0, 255), st.integers(0, 255))  # fmt: skip
def test_a_setting_admits_exactly_what_the_method_does(
    colours: list[tuple[int, int, int]], low: int, high: int, s: int, v: int
) -> None:
    red = Red(low, high, s, v)
    picture = np.array([colours], np.uint8)
    params = red.apply(PAPER)
    VisionConfig.model_validate(params.model_dump())
    mask = stages.red_mask(picture, *stages.ranges(params))
    signed = picture[0].astype(np.int16)
    signed[:, 0] = (signed[:, 0] + 90) % 180 - 90
    assert (red.admits(signed) == (mask[0] > 0)).all()


def test_the_present_setting() -> None:
    assert current(PAPER) == TABLE_I
    assert TABLE_I.apply(PAPER) == PAPER


def test_wood_is_distinguished_from_red_and_the_middle_is_taken() -> None:
    wood = (90, 105, 140)  # H 9, S 91: Table I lets it in
    examples = [example(bay(ground=wood, seed=n), name=f"{n}.png") for n in range(3)]
    before = admission(TABLE_I, examples)
    assert before.ring > 0.8
    assert before.brown_of_background > 0.9
    words = " / ".join(remarks(before, TABLE_I))
    assert "too broad: 9" in words or "too broad: 100" in words
    assert "S >= 43 admits wood, rust and warm light" in words
    red, margins = propose(examples)
    after = admission(red, examples)
    assert [after.marker_worst, after.ring, after.far_markers] == pytest.approx([1, 0, 0], abs=0.01)
    assert remarks(after, red) == []
    assert score(red, examples) == pytest.approx(1, abs=0.01)
    by_name = {margin.name: margin for margin in margins}
    for name, margin in by_name.items():
        assert margin.low <= margin.value <= margin.high
        assert margin.value == (margin.low + margin.high) // 2
        assert getattr(red, name) == margin.value
    s, hue = by_name["s_min"], by_name["hue_high"]
    assert s.high - s.low > 40 or hue.high - hue.low > 2, "somewhere between marker and wood there is room"


def test_each_bound_is_scored_as_if_it_were_tried() -> None:
    examples = [
        example(bay(ground=WOOD, seed=1)),
        example(bay(marker=(70, 60, 150), seed=2)),
        example(bay(ground=RED), None),
    ]
    for name in ("hue_low", "hue_high", "s_min", "v_min"):
        values, scores = thresholds._scores(TABLE_I, name, examples)
        for at in range(0, len(values), 13):
            changed = Red(**({f: getattr(TABLE_I, f) for f in TABLE_I.__slots__} | {name: int(values[at])}))
            assert scores[at] == pytest.approx(score(changed, examples), abs=1e-9), (name, values[at])


def test_red_elsewhere_counts_in_markers_and_in_pictures_without_one() -> None:
    image = bay()
    image[:8, :] = RED  # 1280 px; the blur adds most of a row
    found = admission(TABLE_I, [example(image, Circle(80, 60, 20))])
    assert found.far_markers == pytest.approx(8.8 * 160 / (math.pi * 400), rel=0.05)
    empty = example(bay(marker=RED), None)
    both = thresholds._elsewhere(TABLE_I, [example(bay()), empty])
    assert both == pytest.approx([0, 1.1], abs=0.05), (
        "a disc in a picture said to be empty: one marker, swollen by the blur"
    )


def test_too_narrow_names_the_picture_and_the_bound() -> None:
    pale = bay(marker=(120, 118, 150))  # S 54
    examples = [example(bay(), name="good.png"), example(pale, name="pale.png")]
    strict = Red(20, 10, 120, 46)
    found = admission(strict, examples)
    assert found.worst_name == "pale.png"
    assert found.marker_worst == pytest.approx(0, abs=0.01)
    assert remarks(found, strict) == ["too narrow: only 0 % of the marker passes in pale.png"]
    assert bound_that_cuts(strict, examples[1]) == "S >= 120"
    assert bound_that_cuts(Red(20, 10, 20, 180), examples[1]) == "V >= 180"
    assert bound_that_cuts(Red(1, 10, 20, 20), example(bay(marker=(120, 40, 180)))) == "H >= 179"


def labels(count: int) -> list[Label]:
    marked = [Label(file=f"{n}.png", found=True, u=80, v=60, r=30) for n in range(count)]
    return [*marked, Label(file="empty.png", found=False)]


def look(label: Label) -> Picture:
    wood = (90, 105, 140)
    return bay(ground=wood, seed=hash(label.u)) if label.found else np.full((120, 160, 3), wood, np.uint8)


@pytest.mark.one_interpreter
def test_a_study_shows_what_the_method_finds_before_and_after() -> None:
    steps = []
    found = study(labels(8), look, PAPER, lambda: steps.append(1))
    assert len(steps) == 27
    now, then = found.effect["now"], found.effect["proposed thresholds and gates"]
    assert (now.on_target, now.wrong, now.false) == (0, 8, 1), "the wood is all red to Table I"
    assert (then.on_target, then.close, then.wrong, then.false) == (8, 8, 0, 0)
    assert list(found.effect) == [
        "now", "proposed thresholds", "thresholds from the other half", "proposed thresholds and gates",
    ]  # fmt: skip
    assert found.effect["thresholds from the other half"].on_target == 8
    assert 0.3 * math.pi * 900 == pytest.approx(found.gates["min_area_px2"], rel=0.06)
    assert found.gates["min_circularity"] == 0.8
    text = proposal.toml(found.proposed, found.margins, found.gates, 8) + proposal.robust(found.examples)
    red, green, blue = bytes.fromhex(text.rstrip()[-7:-1])
    assert (blue, green, red) == pytest.approx(RED, abs=6)
    loaded = config.parse(tomllib.loads(text), text=text).bays[0].vision
    assert loaded == found.proposed.apply(PAPER).model_copy(update=dict(found.gates))
    page = report.html(found, text, ("fact",), ["a note <of> ours"])
    assert fetches_nothing(page)
    assert "a note &lt;of&gt; ours" in page
    assert page.count("<svg") == 3
    few = study(labels(2), look, PAPER)
    assert "thresholds from the other half" not in few.effect
    assert list(few.gates) == ["min_area_px2"], "two markers say nothing of the shape of others"


def test_the_colour_of_a_marker_where_signed_hue_wraps() -> None:
    """H 89 and H -90: one teal, in one picture or in two."""
    found = [example(bay(marker=bgr)) for bgr in ((163, 157, 20), (157, 163, 20))]
    both = dataclasses.replace(found[0], marker=np.concatenate([e.marker for e in found]))
    for examples in (found, [both], found[:1]):
        red, green, blue = bytes.fromhex(proposal.robust(examples).rstrip()[-7:-1])
        assert (blue, green, red) == pytest.approx((160, 160, 20), abs=6)


def test_markers_without_a_pixel_are_no_examples() -> None:
    outside = [Label(file="a.png", found=True, u=-30, v=60, r=31)]
    with pytest.raises(ConfigError, match="no example has a pixel well inside its marker"):
        study(outside, lambda _: bay(), PAPER)


def test_gates_leave_room() -> None:
    assert proposal._gate(0.90) == pytest.approx(0.8)
    assert proposal._gate(0.6) == pytest.approx(0.5)
    assert proposal._gate(0.0) == 0
    assert proposal._two_digits(848.2) == 850
    assert proposal.gates([]) == {}


def test_histograms_and_the_background_table() -> None:
    found = [example(bay(ground=(90, 105, 140)))]
    table = histograms.background_by_colour(found)
    assert table.shape == (4, 5)
    assert table[2, 2] == pytest.approx(100, abs=4), "H 9, S 91"
    lines = histograms.lines(found, Red(10, 5, 100, 100), width=64)
    assert len(lines) == 15
    assert {len(line) for line in lines if "|" in line} == {17 + 66}
    s_marker, s_passes = lines[5], lines[8]
    assert s_marker.startswith("S   marker")
    top = s_marker.index("█") - 18
    assert top == pytest.approx(64 * 208 / 256, abs=2)
    assert s_passes.index("=") - 18 == 64 * 100 // 256


def light(**changes: float | None) -> PictureLight:
    fine = {"clipped": 0.0, "marker_clipped": 0.0, "marker_v": 190.0, "marker_s": 200.0, "noise": 2.0}
    return PictureLight(**({**fine, "edge_px": 2.5, "smear_px": 0.5, "smear_deg": 0.0, "warmth": 1.0} | changes))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({}, "exposure, noise, focus and white balance are fine"),
        ({"marker_clipped": 0.3}, "over-exposed: the red channel is clipped in 30 % of the marker"),
        (
            {"marker_v": 50.0},
            "too dark: the marker's brightest channel is 50 of 255; more light, or a longer exposure by 1.6",
        ),
        ({"clipped": 0.2}, "20 % of the picture is clipped to white"),
        ({"marker_s": 60.0}, "pale: the marker's saturation is 60 of 255"),
        ({"noise": 9.0}, "noisy: 9 grey levels"),
        (
            {"smear_px": 8.0, "smear_deg": 170.0},
            "motion blur: about 8 px, along 170 degrees (0: level); an exposure of 1/8",
        ),
        ({"edge_px": 9.0}, "out of focus: the rim is 9 px wide"),
        ({"warmth": 1.6}, "colour cast: red over blue is 1.60"),
        ({"warmth": 0.6}, "colour cast: red over blue is 0.60"),
    ],
)
def test_each_advice_alone(changes: dict[str, float], says: str) -> None:
    (line,) = advice([light(**changes)] * 3)
    assert line.startswith(says)
    none = advice([PictureLight(0, None, None, None, 0, None, None, None, None)])
    assert none == ["exposure, noise, focus and white balance are fine in these pictures"]
    assert advice([light(**changes), light(), light()])[0].startswith("exposure"), "one of three is not the rule"


def test_noise_is_that_of_a_pixel_and_not_texture() -> None:
    rng = np.random.default_rng(3)
    grey = np.full((200, 300, 3), 128.0)
    grey[:, ::60] = 30  # edges
    for sigma in (2.0, 6.0, 12.0):
        noisy = np.clip(np.rint(grey + rng.normal(0, sigma, grey.shape)), 0, 255).astype(np.uint8)
        assert noise(noisy) == pytest.approx(sigma, rel=0.12)
    assert noise(np.full((200, 300, 3), 128, np.uint8)) == 0
    assert noise(np.zeros((4, 4, 3), np.uint8)) == 0


@pytest.mark.parametrize("angle_deg", [0, 30, 90, 135])
def test_motion_blur_is_measured_along_its_direction(angle_deg: float) -> None:
    large = cv2.resize(bay(r=30), None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
    kernel = np.zeros((31, 31), np.float32)
    for t in np.linspace(-6, 6, 241):  # 12 px
        kernel[
            round(15 + t * math.sin(math.radians(angle_deg))), round(15 + t * math.cos(math.radians(angle_deg)))
        ] += 1
    blurred = np.asarray(cv2.filter2D(large, -1, kernel / kernel.sum()), np.uint8)
    circle = Circle(241, 181, 90)
    still, moved = measure(np.asarray(large, np.uint8), circle), measure(blurred, circle)
    assert still.smear_px is not None
    assert still.smear_px < 2
    assert moved.smear_px == pytest.approx(12, abs=2.5)
    assert moved.smear_deg is not None
    assert abs((moved.smear_deg - angle_deg + 90) % 180 - 90) < 10
    assert moved.edge_px == pytest.approx(still.edge_px, abs=2)


def test_a_shadow_on_one_side_is_no_motion() -> None:
    sharp = bay()
    shaded = sharp.copy()
    shaded[:, 80:] = cv2.GaussianBlur(sharp, (0, 0), 5)[:, 80:]
    found, plain = measure(shaded, DISC), measure(sharp, DISC)
    assert found.smear_px is not None
    assert found.smear_px < 2
    assert found.edge_px == pytest.approx(plain.edge_px, abs=0.5)


def test_focus_is_the_same_all_round() -> None:
    circle = Circle(80, 60, 30)
    for sigma in (1.5, 2.5, 3.5):
        soft = np.asarray(cv2.GaussianBlur(bay(), (0, 0), sigma), np.uint8)
        found = measure(soft, circle)
        assert found.edge_px == pytest.approx(2.563 * math.hypot(sigma, 1.04), rel=0.2)
        assert found.smear_px is not None
        assert found.smear_px < 2


def test_light_of_a_marker() -> None:
    found = measure(bay(marker=(90, 80, 255)), Circle(80, 60, 30))
    assert found.marker_clipped == pytest.approx(1, abs=0.05)
    assert found.marker_v == pytest.approx(255, abs=3)
    assert found.marker_s == pytest.approx(175, abs=4)
    assert found.clipped == 0
    white = bay()
    white[:60] = 255
    assert measure(white, None) == measure(white, None)
    assert measure(white, None).clipped == pytest.approx(0.5)
    assert measure(white, None).marker_v is None
    warm = measure(bay(ground=(100, 125, 150)), None)
    assert warm.warmth == pytest.approx(1.5, rel=0.05)
    assert measure(np.full((50, 50, 3), (0, 0, 255), np.uint8), None).warmth is None, "nothing in it is grey"
    dim = np.asarray(bay() // 8, np.uint8)
    assert measure(dim, Circle(80, 60, 30)).edge_px is None, "the rim does not stand out"
    assert exposure.measure(bay(), Circle(158, 60, 30)).edge_px is None, "half of the rim is outside"
