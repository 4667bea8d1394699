"""The composed paper method on pictures with known truth, and the documentation's tables."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis.extra.numpy import array_shapes, arrays
from numpy.typing import NDArray

from gateway.config import Intrinsics, VisionConfig
from gateway.core.detection import Circle, Detection
from gateway.vision.detect import lens as intrinsics
from gateway.vision.detect.paper import method, pipeline, stages
from tests import example_scene
from tests.discs import CONCRETE, VIVID, Colour, disc
from tests.discs import circle_of as found_in
from tests.examples import examples

ROOT = Path(__file__).parents[3]
PAPER = VisionConfig()
STAGES = [stage.name for stage in method.STAGES]
FADED = (60, 60, 170)


def plain(image: NDArray[np.uint8]) -> tuple[tuple[float, float], float] | None:
    """The paper's method as one would write it down with OpenCV, in one go."""
    hsv = cv2.cvtColor(cv2.GaussianBlur(image, (5, 5), 0), cv2.COLOR_BGR2HSV)
    low, high = cv2.inRange(hsv, (0, 43, 46), (10, 255, 255)), cv2.inRange(hsv, (156, 43, 46), (180, 255, 255))
    mask = cv2.bitwise_or(low, high)
    kernel = np.ones((3, 3), np.uint8)
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, kernel, iterations=2)
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, kernel, iterations=2)
    found = [c for c in cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0] if cv2.contourArea(c) > 100]
    if not found:
        return None
    (u, v), radius = cv2.minEnclosingCircle(max(found, key=cv2.contourArea))
    return (u, v), radius


def circle_of(image: NDArray[np.uint8], params: VisionConfig = PAPER) -> Circle:
    return found_in(pipeline.detect(image, params))


# -- accuracy ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("r", [18.0, 45.3, 90.7])
@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.5, 0.5), (0.25, -0.4)])
@pytest.mark.parametrize(("colour", "swell"), [(VIVID, 1.27), (FADED, 0.96)])
def test_a_disc_is_found_where_it_is(r: float, shift: tuple[float, float], colour: Colour, swell: float) -> None:
    """Measured: centre within 0.06 px; the mask swells the radius by an amount that only the colours decide."""
    u, v = 160 + shift[0], 118 + shift[1]
    found = pipeline.detect(disc(u, v, r, colour), PAPER)
    circle = found_in(found)
    assert circle.u_px == pytest.approx(u, abs=0.1)
    assert circle.v_px == pytest.approx(v, abs=0.1)
    assert circle.radius_px == pytest.approx(r + swell, abs=0.15)
    assert found.area_px2 == pytest.approx(np.pi * (circle.radius_px - 0.35) ** 2, rel=0.04)
    assert found.circularity == pytest.approx(0.9, abs=0.025)
    assert found.fill == pytest.approx(0.975, abs=0.026)
    assert found.candidates == 1


@pytest.mark.one_interpreter
def test_the_drawn_scene() -> None:
    """Scratches of paint leave the rim: the enclosing circle holds their stumps."""
    found = pipeline.detect(example_scene.scene(), PAPER)
    circle = found_in(found)
    assert (circle.u_px, circle.v_px) == pytest.approx((example_scene.TRUTH.u_px, example_scene.TRUTH.v_px), abs=1)
    assert 2.5 < circle.radius_px - example_scene.TRUTH.radius_px < 4
    assert found.candidates > 1


@pytest.mark.one_interpreter
@pytest.mark.parametrize("seed", range(8))
def test_same_bits_as_the_plain_opencv_program(seed: int) -> None:
    rng = np.random.default_rng(seed)
    image = cv2.resize(rng.integers(0, 256, (24, 32, 3), dtype=np.uint8), (320, 240)) if seed else example_scene.scene()
    circle = circle_of(np.asarray(image, np.uint8))
    assert plain(np.asarray(image, np.uint8)) == ((circle.u_px, circle.v_px), circle.radius_px)


# -- what has no marker, and strange pictures --------------------------------------------------------------------------


@pytest.mark.parametrize(
    "image",
    [
        np.full((1, 1, 3), (0, 0, 255), np.uint8),
        np.full((1, 500, 3), (0, 0, 255), np.uint8),
        np.full((200, 200, 3), 128, np.uint8),
        np.full((200, 200, 3), 255, np.uint8),
        np.zeros((200, 200, 3), np.uint8),
        disc(100, 100, 50, colour=(200, 30, 30)),
        disc(100, 100, 4),  # area below S_min
    ],
)
def test_no_marker(image: NDArray[np.uint8]) -> None:
    found = pipeline.detect(image, VisionConfig())
    assert (found.circle, found.candidates, found.area_px2) == (None, 0, 0)
    assert (found.x_n, found.y_n) == (None, None)


def test_a_picture_that_is_all_red_is_one_blob() -> None:
    circle = circle_of(np.full((60, 80, 3), (0, 0, 255), np.uint8))
    assert (circle.u_px, circle.v_px) == pytest.approx((39.5, 29.5), abs=1e-3)
    assert circle.radius_px == pytest.approx(np.hypot(79, 59) / 2, abs=1e-3)


@pytest.mark.parametrize("shape", [(0, 5, 3), (5, 5), (5, 5, 1), (5, 5, 4)])
def test_not_a_picture(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="uint8 picture"):
        pipeline.detect(np.zeros(shape, np.uint8), PAPER)
    with pytest.raises(ValueError, match="float64"):
        pipeline.detect(np.zeros((5, 5, 3)), PAPER)  # type: ignore[arg-type]  # the caller's mistake under test


def test_views_of_a_larger_picture_give_the_same() -> None:
    image = disc(90, 80, 40)
    wide = np.zeros((240, 640, 3), np.uint8)
    wide[:, ::2] = image
    assert pipeline.detect(wide[:, ::2], PAPER) == pipeline.detect(image, PAPER)
    assert circle_of(image[::-1]).v_px == pytest.approx(239 - circle_of(image).v_px, abs=1e-3)


@settings(max_examples=examples(50), deadline=None)
@given(arrays(np.uint8, array_shapes(min_dims=2, max_dims=2, max_side=40).map(lambda s: (*s, 3))))
def test_any_picture_gives_a_circle_or_none(image: NDArray[np.uint8]) -> None:
    found = pipeline.detect(image, VisionConfig(min_area_px2=0))
    if found.circle is None:
        assert found.candidates == 0
    else:
        assert -0.5 <= found.circle.u_px <= image.shape[1] - 0.5
        assert -0.5 <= found.circle.v_px <= image.shape[0] - 0.5
        assert 0 < found.fill <= 1
        assert 0 < found.circularity <= 1


# -- settings ----------------------------------------------------------------------------------------------------------


def test_the_ranges_are_the_configuration_s() -> None:
    green = disc(100, 90, 40, colour=(40, 200, 40))
    settings = VisionConfig(red_low_1=(50, 43, 46), red_high_1=(70, 255, 255))
    assert pipeline.detect(green, PAPER).circle is None
    assert circle_of(green, settings).u_px == pytest.approx(100, abs=0.1)
    for image, range_1, range_2 in ((disc(50, 50, 30), True, False), (disc(50, 50, 30, (60, 30, 200)), False, True)):
        only_1 = VisionConfig(red_low_2=(90, 0, 0), red_high_2=(90, 0, 0))
        only_2 = VisionConfig(red_low_1=(90, 0, 0), red_high_1=(90, 0, 0))
        assert range_1 is (pipeline.detect(image, only_1).circle is not None)
        assert range_2 is (pipeline.detect(image, only_2).circle is not None)


def test_every_number_of_the_settings_reaches_its_stage() -> None:
    image = np.maximum(disc(80, 80, 30), 0)
    image[10:12, 10:300] = VIVID  # 2 px: gone after opening
    image[150:220, 150:300] = VIVID  # larger than the disc, less round
    assert circle_of(image).u_px > 150
    # The rectangle has a circularity of 0.68 and a fill of 0.48.
    assert circle_of(image, VisionConfig(min_circularity=0.6, min_fill=0.4)).u_px > 150
    assert circle_of(image, VisionConfig(min_circularity=0.75)).u_px == pytest.approx(80, abs=0.1)
    assert circle_of(image, VisionConfig(min_fill=0.55)).u_px == pytest.approx(80, abs=0.1)
    assert circle_of(image, VisionConfig(min_circularity=0.8)).u_px == pytest.approx(80, abs=0.1)
    assert circle_of(image, VisionConfig(min_fill=0.8)).u_px == pytest.approx(80, abs=0.1)
    assert pipeline.detect(image, VisionConfig(min_area_px2=5000)).candidates == 1
    assert pipeline.detect(image, PAPER).candidates == 2
    assert pipeline.detect(image, VisionConfig(morph_iterations=0)).candidates == 3
    sharp, soft = (pipeline.trace(image, VisionConfig(gaussian_kernel_px=side)).blurred for side in (1, 9))
    assert np.array_equal(image, sharp)
    assert not np.array_equal(pipeline.trace(image, PAPER).blurred, soft)
    assert pipeline.detect(image, VisionConfig(morph_kernel_px=31)).candidates == 1
    pair = np.full((100, 200, 3), CONCRETE, np.uint8)
    pair[30:70, 30:90] = pair[30:70, 102:160] = VIVID  # 12 px apart: closing joins them where it reaches so far
    assert pipeline.detect(pair, PAPER).candidates == 2
    assert pipeline.detect(pair, VisionConfig(morph_kernel_px=15, morph_iterations=1)).candidates == 1
    assert pipeline.detect(pair, VisionConfig(morph_iterations=7)).candidates == 1
    sigma = pipeline.trace(image, VisionConfig(gaussian_sigma_px=3)).blurred
    assert np.array_equal(stages.gaussian(image, 5, 3), sigma)


# -- time and trace ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("image", [disc(100, 90, 40), np.zeros((9, 9, 3), np.uint8)])
def test_each_stage_is_timed(image: NDArray[np.uint8]) -> None:
    times = iter([100, 101, 103, 107, 115, 131, 163, 227, 355, 611])
    found = pipeline.detect(image, PAPER, lambda: next(times))
    assert dict(found.stage_ns) == {name: 2**n for n, name in enumerate(STAGES)}
    assert [name for name, _ in found.stage_ns] == STAGES
    assert sum(ns for _, ns in pipeline.detect(image, PAPER).stage_ns) == 0


@pytest.mark.one_interpreter
def test_trace_holds_what_each_stage_gives() -> None:
    image = example_scene.scene()
    trace = pipeline.trace(image, PAPER)

    assert trace.image is image
    assert np.array_equal(stages.gaussian(image), trace.blurred)
    assert np.array_equal(stages.bgr_to_hsv(trace.blurred), trace.hsv)
    assert np.array_equal(stages.red_mask(trace.hsv), trace.initial)
    assert np.array_equal(stages.opening(trace.initial), trace.opened)
    assert np.array_equal(stages.closing(trace.opened), trace.cleaned)
    assert len(stages.contours(trace.cleaned)) == len(trace.contours)
    assert trace.chosen is not None
    assert stages.contour_area(trace.chosen) == trace.detection.area_px2
    found = pipeline.detect(image, PAPER)
    assert (found.circle, found.fill) == (trace.detection.circle, trace.detection.fill)


# -- equation 11 -------------------------------------------------------------------------------------------------------


def bent(x: float, y: float, lens: Intrinsics) -> tuple[float, float]:
    """Pixel of a direction by the Brown-Conrady model: k1 k2 p1 p2 k3."""
    k1, k2, p1, p2, k3 = (*lens.distortion, 0.0, 0.0)[:5]
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    x_d = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    y_d = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return lens.fx * x_d + lens.cx, lens.fy * y_d + lens.cy


def test_a_pinhole_follows_equation_11() -> None:
    lens = Intrinsics(fx=800, fy=820, cx=319.5, cy=239.5)
    assert intrinsics.normalise(319.5, 239.5, lens) == (0, 0)
    assert intrinsics.normalise(719.5, 34.5, lens) == (0.5, -0.25)


@pytest.mark.parametrize("distortion", [(-0.3, 0.1, 0.001, -0.002), (-0.3, 0.1, 0.001, -0.002, 0.02), (0.2, 0, 0, 0)])
@pytest.mark.parametrize("direction", [(0.0, 0.0), (0.3, -0.2), (-0.4, 0.35)])
def test_distortion_is_taken_out(distortion: tuple[float, ...], direction: tuple[float, float]) -> None:
    lens = Intrinsics(fx=800, fy=820, cx=319.5, cy=239.5, distortion=distortion)
    assert intrinsics.normalise(*bent(*direction, lens), lens) == pytest.approx(direction, abs=1e-8)


def test_no_direction_where_the_distortion_has_no_inverse() -> None:
    lens = Intrinsics(fx=800, fy=800, cx=320, cy=240, distortion=(-0.9, 0.1, 0, 0))
    assert intrinsics.normalise(-1500, -1000, lens) is None


def test_detection_carries_the_direction() -> None:
    image = disc(200, 100, 40)
    lens = Intrinsics(fx=500, fy=400, cx=160, cy=120)
    found = pipeline.detect(image, VisionConfig(intrinsics=lens))
    assert found.x_n == pytest.approx(0.08, abs=2e-4)
    assert found.y_n == pytest.approx(-0.05, abs=2e-4)
    assert pipeline.detect(image, PAPER).x_n is None
    assert pipeline.detect(np.zeros_like(image), VisionConfig(intrinsics=lens)) == Detection(
        circle=None, stage_ns=tuple((name, 0) for name in STAGES)
    )
