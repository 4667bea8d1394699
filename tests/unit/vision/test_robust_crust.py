"""A red disc under a crust that ends where the disc does: what is found of it, and what only looks like it."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from gateway.config import VisionConfig
from gateway.core.detection import Detection, Ellipse
from gateway.vision.detect.geometry import crosses
from gateway.vision.detect.robust import measurement
from gateway.vision.detect.robust.decision import Candidate, Limits
from gateway.vision.detect.robust.detect import detect
from gateway.vision.detect.robust.evidence import Evidence, masked_rank
from gateway.vision.detect.robust.redness import pyramid
from gateway.vision.detect.robust.rim_fine import Rim
from gateway.vision.detect.robust.search import _decided, _rims_near
from gateway.vision.pixels import Image
from tests import decoys

pytestmark = pytest.mark.one_interpreter

U, V, R = 161.4, 118.7, 60.0
CEMENT, PORT = (168.0, 172.0, 176.0), (70.0, 72.0, 71.0)
LIMITS = Limits(min_radius_px=5.0, max_radius_px=200.0, min_confidence=0.5)
Lump = tuple[float, float]  # direction (degrees, 90: down), radius in disc radii, centred on the rim


def crusted(below: float, lumps: Sequence[Lump] = (), red: bool = True, rest: decoys.Colour = CEMENT) -> Image:
    """A disc before the dark ring of a port; `rest` over all of it that lies lower than `below` radii and in lumps."""
    sheet = decoys.sheet(320, 240, "concrete", 5)
    sheet.disc(U, V, 1.3 * R, PORT)
    if red:
        sheet.disc(U, V, R)
    du, dv = sheet.far(U, V)
    inside = du * du + dv * dv <= (1.01 * R) ** 2
    wave = 0.04 * R * np.sin(du / (0.07 * R))
    cover = dv + wave > below * R
    for turn, size in lumps:
        across, along = (0.97 * R * way(math.radians(turn)) for way in (math.cos, math.sin))
        cover |= (du - across) ** 2 + (dv - along) ** 2 <= (size * R) ** 2
    sheet.fill(inside & cover, rest)
    return sheet.finished(0.9)


def seen(image: Image) -> Detection:
    return detect(image, VisionConfig())


@pytest.mark.parametrize(
    ("below", "lumps"),
    [
        (0.36, ()),
        (0.36, ((-20.0, 0.2),)),
        (0.36, ((195.0, 0.25),)),
        (0.36, ((205.0, 0.3), (-60.0, 0.14))),
        (0.15, ()),
    ],
)
def test_half_of_the_rim_may_be_under_a_crust(below: float, lumps: Sequence[Lump]) -> None:
    circle = seen(crusted(below, lumps)).circle

    assert circle is not None
    assert (circle.u_px, circle.v_px, circle.radius_px) == pytest.approx((U, V, R), abs=0.02 * R)


@pytest.mark.parametrize("rest", [PORT, (122.0, 125.0, 124.0)])
def test_a_part_of_a_disc_with_nothing_over_the_rest_is_no_marker(rest: decoys.Colour) -> None:
    """No crust ends at the rim: the same is left of a red plate that is cut straight."""
    sheet = decoys.sheet(320, 240, "concrete", 5)
    sheet.disc(U, V, R)
    sheet.box(U, V + 0.1 * R + 200, 200, 200, rest)

    assert seen(sheet.finished(0.9)).circle is None


def test_nor_is_a_disc_that_is_red_by_half() -> None:
    assert seen(crusted(-0.1)).circle is None


def test_a_crust_counts_neither_as_leak_nor_against_the_contrast() -> None:
    image = crusted(0.1)
    (found,) = measurement.of_ellipses(pyramid(image, 1, 8), [Ellipse(U, V, R, R, 0.0)])
    (clean,) = measurement.of_ellipses(pyramid(crusted(1.2), 1, 8), [Ellipse(U, V, R, R, 0.0)])
    assert found is not None
    assert clean is not None

    assert found.coverage == pytest.approx(0.5, abs=0.08)
    assert found.coverage + found.covered == pytest.approx(1, abs=0.05)
    assert found.leak == 0
    assert found.contrast == pytest.approx(clean.contrast, rel=0.1)
    assert clean.covered == 0


def test_what_hides_a_disc_and_does_not_end_at_its_rim_is_not_a_crust() -> None:
    sheet = decoys.sheet(320, 240, "concrete", 5)
    sheet.disc(U, V, R)
    sheet.box(U, V + 0.4 * R + 100, 200, 100, CEMENT)
    (found,) = measurement.of_ellipses(pyramid(sheet.finished(0.9), 1, 8), [Ellipse(U, V, R, R, 0.0)])
    assert found is not None

    assert found.covered <= 0.05


def test_a_rank_over_a_mask() -> None:
    values = np.array([[1, 9, 5, 7, 3], [1, 2, 3, 4, 5]], np.float32)
    mask = np.array([[1, 0, 1, 1, 1], [0, 0, 0, 0, 0]], bool)

    assert masked_rank(values, mask, 2, 3).tolist() == [5, 0]
    assert masked_rank(values, mask, 1, 1).tolist() == [7, 0]


@pytest.mark.parametrize(
    ("u", "major", "expected"),
    [
        (10.0, 40.0, True),
        (10.0, 45.0, True),
        (2.0, 52.0, False),
        (0.0, 40.0, False),
        (10.0, 25.0, False),
        (25.0, 40.0, False),
    ],
)
def test_rims_that_cross_are_not_one_in_the_other(u: float, major: float, expected: bool) -> None:
    one, other = Ellipse(0.0, 0.0, 40.0, 38.0, 0.3), Ellipse(u, 0.0, major, major - 2, 1.0)

    assert crosses(one, other) is expected
    assert crosses(other, one) is expected


def test_of_rims_that_cross_the_surest_counts_not_the_largest() -> None:
    image = np.full((240, 320, 3), 120, np.uint8)
    levels = pyramid(image, 1, 8)
    at = Ellipse(U, V, 40.0, 40.0, 0.0)
    sure = Candidate(
        Rim(at, rms_px=0.0, support=1.0, visible=1.0, contrast=100.0, inliers=190, blur_px=1.0, wave_px=0.0),
        Evidence(at, 1, 0, 0, 1, 1, 1, 0, 1, 0, 1, 0, 0, (40, 40, 190)),
    )
    larger = replace(at, u_px=U + 9, semi_major_px=43.0, semi_minor_px=43.0)
    drawn_out = Candidate(replace(sure.rim, ellipse=larger, support=0.7), replace(sure.evidence, ellipse=larger))
    beside = replace(drawn_out, rim=replace(drawn_out.rim, ellipse=replace(larger, u_px=U + 120)))

    assert _decided(image, levels, [sure, drawn_out], LIMITS)[0] == sure
    assert _decided(image, levels, [sure, beside], LIMITS)[0] == beside


def test_the_rim_of_a_disc_in_part_hidden_is_also_searched_for_farther_off() -> None:
    drawn_in = Ellipse(U, V - 0.18 * R, 0.98 * R, 0.8 * R, 0.0)
    image = crusted(0.36, ((195.0, 0.25),))
    (found,) = measurement.of_ellipses(pyramid(image, 1, 8), [drawn_in])
    assert found is not None
    *_, rim = rims = list(_rims_near(image, found))

    assert len(rims) == 2
    e = rim.ellipse
    assert (e.u_px, e.v_px, e.semi_major_px) == pytest.approx((U, V, R), abs=0.02 * R)

    clean = crusted(1.2)
    (whole,) = measurement.of_ellipses(pyramid(clean, 1, 8), [Ellipse(U, V, R, R, 0.0)])
    assert whole is not None
    assert len(list(_rims_near(clean, whole))) == 1
