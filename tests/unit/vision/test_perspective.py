"""A disc in space, projected through a lens, and its centre found again from the ellipse."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from gateway.config import Intrinsics, VisionConfig
from gateway.core.detection import Ellipse
from gateway.vision.detect.robust.conic import from_matrix
from gateway.vision.detect.robust.detect import detect
from gateway.vision.detect.robust.perspective import PossibleCentre, disc_centre, possible_centres
from tests.examples import examples

PINHOLE = Intrinsics(fx=1200, fy=1190, cx=960, cy=540)
BARREL = Intrinsics(fx=1200, fy=1190, cx=960, cy=540, distortion=(-0.25, 0.08, 0.001, -0.0005))
RADIUS_MM = 75.0


@dataclass(frozen=True)
class Disc:
    """The truth: centre in mm, unit normal towards the camera, both in camera axes."""

    centre: NDArray[np.float64]
    normal: NDArray[np.float64]

    def across(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        one = np.cross(self.normal, [0.0, 1.0, 0.0])
        one = one / np.linalg.norm(one)
        return one, np.cross(self.normal, one)

    def project(self, points: NDArray[np.float64], lens: Intrinsics) -> NDArray[np.float64]:
        camera = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1.0]])
        still, distortion = np.zeros(3), np.array(lens.distortion or (0.0,) * 4)
        return np.asarray(cv2.projectPoints(points, still, still, camera, distortion)[0].reshape(-1, 2), np.float64)

    def ellipse(self, lens: Intrinsics) -> Ellipse:
        """Least squares conic through 360 projected points of the rim."""
        one, other = self.across()
        phi = np.radians(np.arange(360))
        rim = self.centre + RADIUS_MM * (np.outer(np.cos(phi), one) + np.outer(np.sin(phi), other))
        pixels = self.project(rim, lens)
        middle, size = pixels.mean(axis=0), 100.0
        x, y = ((pixels - middle) / size).T
        a, b, c, d, e, f = np.linalg.svd(
            np.stack([x * x, x * y, y * y, x, y, np.ones(360)], axis=1), full_matrices=False
        )[2][-1]
        local = from_matrix(np.array([[a, b / 2, d / 2], [b / 2, c, e / 2], [d / 2, e / 2, f]]))
        assert local is not None
        return Ellipse(
            local.u_px * size + middle[0],
            local.v_px * size + middle[1],
            local.semi_major_px * size,
            local.semi_minor_px * size,
            local.angle_rad,
        )

    def own_centre(self, lens: Intrinsics) -> tuple[float, float]:
        u, v = self.project(self.centre[np.newaxis], lens)[0]
        return float(u), float(v)


def standing(x: float, y: float, z: float, tilt_deg: float, toward_deg: float) -> Disc:
    """Tilted by `tilt_deg` out of the image plane, towards `toward_deg` (0: its right edge is the farther one)."""
    tilt, toward = math.radians(tilt_deg), math.radians(toward_deg)
    normal = np.array([math.sin(tilt) * math.cos(toward), math.sin(tilt) * math.sin(toward), -math.cos(tilt)])
    return Disc(np.array([x, y, z]), normal)


def centres(disc: Disc, lens: Intrinsics) -> tuple[PossibleCentre, PossibleCentre]:
    found = possible_centres(disc.ellipse(lens), lens)
    assert found is not None
    return found


def weighted(disc: Disc, lens: Intrinsics) -> tuple[float, float]:
    found = disc_centre(disc.ellipse(lens), lens)
    assert found is not None
    return found


@settings(max_examples=examples(40), deadline=None)
@given(
    st.floats(-0.35, 0.35),
    st.floats(-0.2, 0.2),
    st.floats(500, 3000),
    st.floats(0, 40),
    st.floats(0, 360),
    st.sampled_from([PINHOLE, BARREL]),
)
def test_one_of_the_two_centres_is_the_true_one(
    right: float, down: float, z: float, tilt_deg: float, toward_deg: float, lens: Intrinsics
) -> None:
    disc = standing(right * z, down * z, z, tilt_deg, toward_deg)
    u, v = disc.own_centre(lens)
    best = min(centres(disc, lens), key=lambda found: math.hypot(found.u_px - u, found.v_px - v))
    # A barrel makes the rim a little other than an ellipse: 0.01 px and a hundredth of a degree for these sizes.
    loose = bool(lens.distortion)
    assert math.hypot(best.u_px - u, best.v_px - v) < (0.02 if loose else 1e-4)
    sight = float(np.dot(-disc.normal, disc.centre) / np.linalg.norm(disc.centre))
    assume(sight < math.cos(math.radians(3)))  # straight on, the tilt's direction says nothing
    assert best.off_rad == pytest.approx(math.radians(tilt_deg), abs=0.01 if loose else 1e-4)


def test_the_ellipse_s_centre_is_not_the_disc_s() -> None:
    """R^2 / f sin(tilt) cos(tilt), the docstring's rule, and the correction takes it away."""
    disc = standing(0.0, 0.0, 900.0, 30.0, 0.0)  # R = 100 px
    ellipse, (u, v) = disc.ellipse(PINHOLE), disc.own_centre(PINHOLE)
    assert ellipse.semi_major_px == pytest.approx(100, abs=1)
    off = math.hypot(ellipse.u_px - u, ellipse.v_px - v)
    assert off == pytest.approx(100**2 / 1200 * math.sin(math.radians(30)) * math.cos(math.radians(30)), rel=0.05)
    assert min(math.hypot(one.u_px - u, one.v_px - v) for one in centres(disc, PINHOLE)) < 1e-3


def test_a_disc_parallel_to_the_image_plane_needs_no_correction_and_gets_little() -> None:
    """Its image is a circle round its own centre; the other pose leans by twice the angle it is off the axis."""
    disc = standing(250.0, 120.0, 900.0, 0.0, 0.0)
    lens = Intrinsics(fx=1200, fy=1200, cx=960, cy=540)
    right, wrong = centres(disc, lens)
    assert right.off_rad < 1e-3
    assert wrong.off_rad == pytest.approx(2 * math.atan(math.hypot(250, 120) / 900), rel=0.02)
    (u, v), found = disc.own_centre(lens), weighted(disc, lens)
    off_px = math.dist(found, (u, v))
    assert off_px < 0.1 * math.hypot(wrong.u_px - u, wrong.v_px - v)
    assert off_px < 0.4


@pytest.mark.one_interpreter
@pytest.mark.parametrize("range_deg", [(0.0, 10.0), (10.0, 20.0), (20.0, 30.0)])
def test_the_weighted_centre_is_no_worse_than_the_ellipse_s_in_95_of_100_cases(range_deg: tuple[float, float]) -> None:
    """Tilts of any size towards any side: nobody mounts markers so, and still the correction does no harm."""
    chance, lens = np.random.default_rng(7), Intrinsics(fx=1200, fy=1200, cx=960, cy=540)
    before, after = [], []
    for _ in range(300):
        z = float(chance.uniform(700, 1600))
        right, down = chance.uniform(-0.25, 0.25) * z, chance.uniform(-0.15, 0.15) * z
        disc = standing(right, down, z, float(chance.uniform(*range_deg)), float(chance.uniform(0, 360)))
        ellipse, (u, v), found = disc.ellipse(lens), disc.own_centre(lens), weighted(disc, lens)
        before.append(math.hypot(ellipse.u_px - u, ellipse.v_px - v))
        after.append(math.dist(found, (u, v)))
    assert np.percentile(after, 95) <= np.percentile(before, 95)
    assert np.median(after) < np.median(before)


def test_centres_that_cannot_be_distinguished_are_averaged() -> None:
    """On the axis both sides are as likely but for a trifle."""
    disc = standing(0.0, 0.0, 2000.0, 20.0, 0.0)
    one, other = centres(disc, PINHOLE)
    found, apart = weighted(disc, PINHOLE), math.hypot(one.u_px - other.u_px, one.v_px - other.v_px)
    share = math.dist(found, (other.u_px, other.v_px)) / apart
    assert 0.5 <= share < 0.75


@pytest.mark.parametrize(
    "ellipse",
    [
        Ellipse(math.nan, 0.0, 10.0, 10.0, 0.0),
        Ellipse(100.0, 100.0, 10.0, 0.0, 0.0),
        Ellipse(100.0, 100.0, math.inf, 10.0, 0.0),
    ],
)
def test_what_is_no_ellipse_has_no_centre(ellipse: Ellipse) -> None:
    assert disc_centre(ellipse, PINHOLE) is None
    assert disc_centre(ellipse, BARREL) is None


def test_beyond_the_lens_model_s_range_there_is_no_centre() -> None:
    """So strong a barrel folds the picture's edge over: no direction belongs to such pixels."""
    folded = Intrinsics(fx=500, fy=500, cx=320, cy=240, distortion=(-0.6, 0.0, 0.0, 0.0))
    assert disc_centre(Ellipse(320.0, 240.0, 30.0, 28.0, 0.0), folded) is not None
    assert disc_centre(Ellipse(900.0, 240.0, 30.0, 28.0, 0.0), folded) is None


@settings(max_examples=examples(60), deadline=None)
@given(st.builds(Ellipse, *[st.one_of(st.floats(-100, 2500), st.floats())] * 5), st.sampled_from([PINHOLE, BARREL]))
def test_no_ellipse_raises(ellipse: Ellipse, lens: Intrinsics) -> None:
    found = disc_centre(ellipse, lens)
    assert found is None or all(map(math.isfinite, found))


def test_the_detector_corrects_the_centre_where_the_lens_is_known() -> None:
    """Parallel to the image plane but for 4 degrees, at the side of the frame: the usual prior leans the right way."""
    lens = Intrinsics(fx=500, fy=500, cx=320, cy=240)
    disc = standing(150.0, 60.0, 500.0, 4.0, 0.0)
    phi = np.radians(np.arange(0, 360, 0.25))
    one, other = disc.across()
    rim = disc.project(disc.centre + RADIUS_MM * (np.outer(np.cos(phi), one) + np.outer(np.sin(phi), other)), lens)
    image = np.full((480, 640, 3), (120, 128, 122), np.uint8)
    cv2.fillPoly(image, [np.rint(rim * 256).astype(np.int32)], (40, 45, 190), cv2.LINE_AA, 8)
    image = np.asarray(cv2.GaussianBlur(image, (0, 0), 0.7), np.uint8)
    known = detect(image, VisionConfig(method="robust", intrinsics=lens))
    unknown = detect(image, VisionConfig(method="robust"))
    assert known.circle is not None
    assert unknown.circle is not None
    assert known.ellipse == unknown.ellipse
    u, v = disc.own_centre(lens)
    before = math.hypot(unknown.circle.u_px - u, unknown.circle.v_px - v)
    after = math.hypot(known.circle.u_px - u, known.circle.v_px - v)
    assert before > 0.5
    assert after < 0.75 * before
    assert known.circle.radius_px == unknown.circle.radius_px
    assert known.x_n == pytest.approx((known.circle.u_px - 320) / 500)
