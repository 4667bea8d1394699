"""The refined rim on pictures whose truth is known, and on anything at all."""

import math
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from gateway.core.detection import Ellipse
from gateway.vision.detect.robust import constants, refinement
from gateway.vision.detect.robust.conic import from_ellipse
from gateway.vision.detect.robust.refinement import load, refine, refine_plain
from gateway.vision.detect.robust.rim_fine import Rim
from gateway.vision.pixels import Image
from tests.examples import examples


@pytest.fixture(params=["opencv", "kernel"], scope="module", autouse=True)
def path(request: pytest.FixtureRequest, library: Path) -> Iterator[None]:
    """All of it by NumPy and OpenCV, and again by the compiled kernel."""
    kernel = load(library) if request.param == "kernel" else None
    assert (kernel is None) == (request.param == "opencv")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(refinement, "compiled_kernel", lambda: kernel)
        yield


RED, GREY = (40.0, 45.0, 190.0), (120.0, 128.0, 122.0)
SEARCH_PX = 9.0  # a sixth of the radius
TRUTH = Ellipse(80.37, 76.81, 52.2, 52.2, 0.0)
TILTED = Ellipse(80.37, 76.81, 56.2, 49.9, 0.7)


def coverage(ellipse: Ellipse, width: int, height: int, grid: int = 8) -> NDArray[np.float64]:
    """How much of every pixel the ellipse covers: means over grid x grid points."""
    u = (np.arange(width * grid) + 0.5) / grid - 0.5 - ellipse.u_px
    v = (np.arange(height * grid) + 0.5)[:, np.newaxis] / grid - 0.5 - ellipse.v_px
    c, s = math.cos(ellipse.angle_rad), math.sin(ellipse.angle_rad)
    inside = ((u * c + v * s) / ellipse.semi_major_px) ** 2 + ((-u * s + v * c) / ellipse.semi_minor_px) ** 2 <= 1
    return np.asarray(inside.reshape(height, grid, width, grid).mean(axis=(1, 3)), np.float64)


def picture(
    ellipse: Ellipse,
    *,
    size: tuple[int, int] = (160, 160),
    blur: float = 0.7,
    noise: float = 0.0,
    seed: int = 0,
    disc: tuple[float, float, float] = RED,
    ground: tuple[float, float, float] = GREY,
) -> Image:
    cover = coverage(ellipse, *size)[..., np.newaxis]
    clear = cover * np.array(disc) + (1 - cover) * np.array(ground)
    return finish(clear, blur, noise, seed)


def finish(clear: NDArray[np.float64], blur: float, noise: float = 0.0, seed: int = 0) -> Image:
    if blur:
        clear = np.asarray(cv2.GaussianBlur(clear, (0, 0), blur), np.float64)
    shot = clear + np.random.default_rng(seed).normal(0, 1, clear.shape) * noise
    return np.clip(np.rint(shot), 0, 255).astype(np.uint8)


def rough(ellipse: Ellipse, off: float = 0.04) -> Ellipse:
    """A seed as a detector would give: a circle, off in place and size."""
    radius = ellipse.semi_major_px * (1 + off)
    return Ellipse(ellipse.u_px + 0.7 * off * radius, ellipse.v_px - 0.7 * off * radius, radius, radius, 0.0)


def found(image: Image, seed: Ellipse) -> Rim:
    rim = refine(image, seed, max(4.0, seed.semi_minor_px / 6))
    assert rim is not None
    return rim


def check(rim: Rim, truth: Ellipse, tolerance_px: float) -> None:
    e = rim.ellipse
    assert math.hypot(e.u_px - truth.u_px, e.v_px - truth.v_px) <= tolerance_px
    assert e.semi_major_px == pytest.approx(truth.semi_major_px, abs=tolerance_px)
    assert e.semi_minor_px == pytest.approx(truth.semi_minor_px, abs=tolerance_px)


# -- exact to a hundredth ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("truth", [TRUTH, TILTED])
@pytest.mark.parametrize("blur", [0.0, 0.7, 1.5, 2.5])
def test_a_clear_rim_is_found_to_two_hundredths(truth: Ellipse, blur: float) -> None:
    rim = found(picture(truth, blur=blur), rough(truth))
    check(rim, truth, 0.02)
    assert rim.support >= 0.99
    assert rim.visible >= 0.99
    assert rim.contrast == pytest.approx(math.dist(RED, GREY), rel=0.1)
    # What is measured is the lens's blur, the pixel's and the sampling's: variances add, some 0.25 px^2 for the latter.
    assert rim.blur_px == pytest.approx(math.sqrt(blur**2 + 0.25), abs=0.25)


def test_the_angle_of_a_tilted_disc() -> None:
    assert found(picture(TILTED), rough(TILTED)).ellipse.angle_rad == pytest.approx(TILTED.angle_rad, abs=0.003)


@pytest.mark.parametrize("radius", [8.0, 12.0, 20.0])
def test_blur_does_not_shrink_a_small_disc(radius: float) -> None:
    """The edge of a blurred disc lies inside the rim, by half its variance times the curvature: here to 0.1 px."""
    truth = Ellipse(40.2, 39.7, radius, radius, 0.0)
    check(found(picture(truth, size=(80, 80), blur=1.2), rough(truth)), truth, 0.03)


@pytest.mark.mostly_long
@pytest.mark.one_interpreter
def test_a_disc_of_a_thousand_pixels() -> None:
    """Only its band is drawn: the picture would be 40 million points otherwise."""
    truth = Ellipse(1050.3, 1049.8, 1000.4, 1000.4, 0.0)
    v, u = np.mgrid[0:2100, 0:2100].astype(np.float64)
    cover = np.clip(truth.semi_major_px - np.hypot(u - truth.u_px, v - truth.v_px) + 0.5, 0, 1)[..., np.newaxis]
    image = (cover * np.array(RED) + (1 - cover) * np.array(GREY) + 0.5).astype(np.uint8)
    check(found(image, rough(truth, 0.02)), truth, 0.02)


def test_motion_blur_keeps_the_place_of_mid_exposure() -> None:
    kernel = np.zeros((9, 9))
    kernel[4, 1:8] = 1 / 7
    clear = coverage(TRUTH, 160, 160)[..., np.newaxis]
    moved = np.asarray(cv2.filter2D(clear * np.array(RED) + (1 - clear) * np.array(GREY), -1, kernel), np.float64)
    check(found(finish(moved, 0.6), rough(TRUTH)), TRUTH, 0.06)


# -- noise ------------------------------------------------------------------------------------------------------------


@pytest.mark.mostly_long
@pytest.mark.one_interpreter
def test_noise_is_averaged_down_to_near_the_floor() -> None:
    """Twice the Cramer-Rao floor, which for this disc at sigma 10 is some 0.010 px (centre) and 0.005 px (radius)."""
    contrast, sigma, blur = math.dist(RED, GREY), 10.0, 0.9  # blur with the pixel's own
    # Per px of rim the information on its place is contrast^2 / (2 sqrt(pi) blur sigma^2).
    information = contrast**2 / (2 * math.sqrt(math.pi) * blur * sigma**2) * 2 * math.pi * TRUTH.semi_major_px
    centre_floor, radius_floor = math.sqrt(2 * 2 / information), math.sqrt(1 / information)
    centre, radius = [], []
    for seed in range(40):
        e = found(picture(TRUTH, noise=sigma, seed=seed), rough(TRUTH)).ellipse
        centre.append(math.hypot(e.u_px - TRUTH.u_px, e.v_px - TRUTH.v_px))
        radius.append(e.semi_major_px - TRUTH.semi_major_px)
    assert 0.9 * centre_floor < math.sqrt(np.mean(np.square(centre))) < 2 * centre_floor
    assert math.sqrt(np.mean(np.square(radius))) < 3 * radius_floor
    assert abs(float(np.mean(radius))) < radius_floor


@pytest.mark.mostly_long
@pytest.mark.one_interpreter
def test_a_noisy_circle_is_not_taken_for_an_ellipse(monkeypatch: pytest.MonkeyPatch) -> None:
    """A free ellipse fit makes the semi-major axis of a circle too long, in every picture."""
    shots = [picture(TRUTH, noise=10.0, seed=seed) for seed in range(20)]
    doubting = [found(shot, rough(TRUTH)).ellipse for shot in shots]
    monkeypatch.setattr(constants, "DOUBT", 0.0)
    free = [rim.ellipse for shot in shots if (rim := refine_plain(shot, rough(TRUTH), SEARCH_PX))]
    assert len(free) == len(shots)
    flatness = [np.mean([e.semi_major_px - e.semi_minor_px for e in some]) for some in (doubting, free)]
    assert flatness[0] < 0.5 * flatness[1]


def test_a_real_tilt_is_not_shrunk_to_a_circle() -> None:
    truth = Ellipse(80.3, 79.6, 52.0, 51.0, 1.1)
    e = found(picture(truth, noise=3.0), rough(truth)).ellipse
    assert e.semi_major_px - e.semi_minor_px == pytest.approx(1.0, abs=0.1)


# -- what hides and disfigures ----------------------------------------------------------------------------------------


def test_a_third_of_the_rim_behind_something() -> None:
    clear = coverage(TRUTH, 160, 160)[..., np.newaxis] * (np.array(RED) - np.array(GREY)) + np.array(GREY)
    cv2.ellipse(clear, (80, 77), (90, 90), 20, 0, 108, (60.0, 70.0, 75.0), -1)
    rim = found(finish(clear, 0.7, 3.0), rough(TRUTH))
    check(rim, TRUTH, 0.05)
    assert rim.support == pytest.approx(0.7, abs=0.05)
    assert rim.visible == pytest.approx(0.7, abs=0.05)


def test_burrs_have_no_effect() -> None:
    clear = coverage(TRUTH, 160, 160)[..., np.newaxis] * (np.array(RED) - np.array(GREY)) + np.array(GREY)
    for degrees in (10, 75, 190, 300):
        at = np.radians(degrees)
        spot = (round(TRUTH.u_px + 53 * np.cos(at)), round(TRUTH.v_px + 53 * np.sin(at)))
        cv2.circle(clear, spot, 5, RED, -1)
    check(found(finish(clear, 0.7, 3.0), rough(TRUTH)), TRUTH, 0.04)


@pytest.mark.parametrize(("u", "v"), [(20.3, 80.2), (80.2, 20.3), (139.6, 80.2), (80.2, 139.6)])
def test_the_border_of_the_frame_cuts_the_disc(u: float, v: float) -> None:
    truth = Ellipse(u, v, 52.2, 52.2, 0.0)
    rim = found(picture(truth, noise=3.0), rough(truth))
    check(rim, truth, 0.1)
    # 20.3 px of 52.2: the border hides 2 acos(20.3 / 52.2) of the rim.
    assert rim.visible == pytest.approx(1 - 2 * math.acos(20.3 / 52.2) / (2 * math.pi), abs=0.06)
    assert rim.support > 0.95


def test_another_background_behind_either_half() -> None:
    """Brighter than the disc on the left, darker on the right: no single grey threshold shows the rim."""
    cover = coverage(TRUTH, 160, 160)[..., np.newaxis]
    ground = np.full((160, 160, 3), 215.0)
    ground[:, 80:] = 25.0
    rim = found(finish(cover * np.array((90.0, 90.0, 130.0)) + (1 - cover) * ground, 0.7, 3.0), rough(TRUTH))
    check(rim, TRUTH, 0.05)
    assert rim.support > 0.9


def test_colour_alone_shows_the_rim() -> None:
    """Disc and ground of the same grey level: an edge in B, G, R, none in luma."""
    luma = 0.114 * 40 + 0.587 * 60 + 0.299 * 180
    image = picture(TRUTH, disc=(40.0, 60.0, 180.0), ground=(luma, luma, luma), noise=3.0)
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    assert abs(float(grey[60:90, 60:90].mean()) - float(grey[:15].mean())) < 1.5
    check(found(image, rough(TRUTH)), TRUTH, 0.04)


# -- equivariance -----------------------------------------------------------------------------------------------------


def test_turning_the_picture_turns_the_rim() -> None:
    image = picture(TILTED, noise=3.0)
    before = found(image, rough(TILTED)).ellipse
    turned = np.ascontiguousarray(np.rot90(image))  # (u, v) -> (v, width - 1 - u)
    seed = Ellipse(TILTED.v_px + 1.0, 159 - TILTED.u_px, 55.0, 55.0, 0.0)
    after = found(turned, seed).ellipse
    assert (after.u_px, after.v_px) == pytest.approx((before.v_px, 159 - before.u_px), abs=0.02)
    assert after.semi_major_px == pytest.approx(before.semi_major_px, abs=0.02)
    assert math.cos(2 * (after.angle_rad - before.angle_rad + math.pi / 2)) > 0.9999


def test_shifting_the_picture_shifts_the_rim() -> None:
    image = picture(TILTED, noise=3.0)
    wide = np.full((260, 300, 3), GREY, np.uint8)
    wide[60:220, 90:250] = image
    before = found(image, rough(TILTED)).ellipse
    seed = rough(TILTED)
    after = found(wide, Ellipse(seed.u_px + 90, seed.v_px + 60, seed.semi_major_px, seed.semi_minor_px, 0.0)).ellipse
    assert (after.u_px - 90, after.v_px - 60) == pytest.approx((before.u_px, before.v_px), abs=1e-3)
    assert after.semi_major_px == pytest.approx(before.semi_major_px, abs=1e-3)


def test_the_result_does_not_depend_on_the_seed() -> None:
    image = picture(TILTED, noise=5.0)
    one, other = found(image, rough(TILTED, 0.05)).ellipse, found(image, rough(TILTED, -0.05)).ellipse
    assert (one.u_px, one.v_px) == pytest.approx((other.u_px, other.v_px), abs=0.02)
    assert one.semi_major_px == pytest.approx(other.semi_major_px, abs=0.02)


# -- nothing there, and anything at all -------------------------------------------------------------------------------


@pytest.mark.parametrize("level", [0, 128, 255])
def test_a_plain_picture_has_no_rim(level: int) -> None:
    assert refine(np.full((100, 100, 3), level, np.uint8), Ellipse(50.0, 50.0, 30.0, 30.0, 0.0), SEARCH_PX) is None


def test_noise_has_no_rim_that_counts() -> None:
    random = np.random.default_rng(3)
    for _ in range(20):
        rim = refine(
            random.integers(0, 256, (120, 120, 3), dtype=np.uint8), Ellipse(60.0, 60.0, 40.0, 40.0, 0.0), SEARCH_PX
        )
        assert rim is None or rim.support < 0.5


@pytest.mark.parametrize(
    "seed",
    [
        Ellipse(math.nan, 50.0, 30.0, 30.0, 0.0),
        Ellipse(50.0, 50.0, math.inf, 30.0, 0.0),
        Ellipse(50.0, 50.0, 30.0, 30.0, math.nan),
        Ellipse(50.0, 50.0, 1e300, 1e300, 0.0),
        Ellipse(50.0, 50.0, 0.0, 0.0, 0.0),
        Ellipse(50.0, 50.0, 30.0, 1.0, 0.0),
        Ellipse(50.0, 50.0, -30.0, -30.0, 0.0),
        Ellipse(50.0, 50.0, 30.0, 30.0, 1e308),
        Ellipse(500.0, 50.0, 30.0, 30.0, 0.0),
        Ellipse(50.0, -1e9, 30.0, 30.0, 0.0),
    ],
)
def test_an_absurd_seed_finds_nothing(seed: Ellipse) -> None:
    assert refine(picture(Ellipse(50.0, 50.0, 30.0, 30.0, 0.0), size=(100, 100)), seed, SEARCH_PX) is None


numbers = st.one_of(st.floats(-50, 150), st.floats())


@pytest.mark.mostly_long
@pytest.mark.one_interpreter
@settings(max_examples=examples(200), deadline=None)
@given(
    st.builds(Ellipse, numbers, numbers, numbers, numbers, numbers),
    st.integers(1, 70),
    st.integers(1, 70),
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, 2.0, 9.0, 1e9]),
    st.sampled_from([2, 3, 256]),
)
def test_no_picture_and_no_seed_raises(
    seed: Ellipse, width: int, height: int, random: int, search_px: float, levels: int
) -> None:
    image = np.random.default_rng(random).integers(0, levels, (height, width, 3)).astype(np.uint8) * (
        255 // (levels - 1)
    )
    rim = refine(image, seed, search_px)
    if rim is not None:
        assert from_ellipse(rim.ellipse).real
        assert 0 < rim.visible <= 1
        assert 0 < rim.support <= 1
        assert math.isfinite(rim.rms_px)
