"""Which of several red things is the marker: of rings the outermost, of discs the largest or none, of polygons none."""

import math
from collections.abc import Iterable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gateway.config import VisionConfig
from gateway.core.detection import Circle, Ellipse
from gateway.vision.detect import registry
from gateway.vision.detect.robust import facets
from gateway.vision.detect.robust.decision import AMBIGUOUS, SHAPE, Candidate, chosen, confidence, ragged
from gateway.vision.detect.robust.detect import detect
from gateway.vision.detect.robust.evidence import Evidence
from gateway.vision.detect.robust.rim_fine import Rim
from gateway.vision.detect.robust.rings import of_its_paint
from gateway.vision.pixels import Image
from gateway.vision.track.distractors import SIZE, WEAKER
from tests import decoys
from tests.decoys import RED, Colour

pytestmark = pytest.mark.one_interpreter

WIDTH, HEIGHT = 320, 240
PARAMS = VisionConfig()
WHITE, PALE, DEEP = (228.0, 232.0, 230.0), (75.0, 70.0, 200.0), (15.0, 15.0, 140.0)
PERIOD_NS = 33_000_000
RIM = Rim(Ellipse(80.0, 60.0, 30.0, 30.0, 0.0), 0.0, 1.0, 1.0, 100.0, 190, 1.0, 0.0)
PERFECT = Evidence(RIM.ellipse, 1, 0, 0, 1, 1, 1, 0, 1, 0, 1, 0, 0, (40, 40, 190))
Disc = tuple[float, float, float, Colour]


def discs(painted: Iterable[Disc], blur_px: float = 0.7, seed: int = 1) -> Image:
    sheet = decoys.sheet(WIDTH, HEIGHT, "concrete", seed)
    for u, v, radius, colour in painted:
        sheet.disc(u, v, radius, colour)
    return sheet.finished(blur_px)


def corners(count: int, radius: float, turn: float, flat: float = 1.0) -> list[tuple[float, float]]:
    at = turn + np.arange(count) * 2 * np.pi / count
    return [(161.3 + radius * math.cos(a), 119.2 + flat * radius * math.sin(a)) for a in at]


@pytest.mark.parametrize("count", [6, 8, 10])
@pytest.mark.parametrize(("radius", "flat"), [(70.0, 1.0), (70.0, 0.75), (24.0, 1.0)])
def test_what_has_corners_is_no_disc(count: int, radius: float, flat: float) -> None:
    sheet = decoys.sheet(WIDTH, HEIGHT, "concrete", count)
    sheet.polygon(corners(count, radius, 0.2, flat))
    found = detect(sheet.finished(), PARAMS)

    assert found.circle is None
    assert SHAPE in [rejected.why for rejected in found.rejected]


@pytest.mark.parametrize("radius", [18.0, 20.0])
@pytest.mark.parametrize("octagon", [True, False])
def test_brightness_shows_the_corners_that_the_coarse_colours_of_a_jpeg_hide(octagon: bool, radius: float) -> None:
    sheet = decoys.sheet(WIDTH, HEIGHT, "concrete", 2)
    if octagon:
        sheet.polygon(corners(8, radius, 0.3))
    else:
        sheet.disc(161.3, 119.2, radius)
    stored = cv2.imencode(".jpg", sheet.finished(1.0), [cv2.IMWRITE_JPEG_QUALITY, 60])[1]
    found = detect(np.asarray(cv2.imdecode(stored, cv2.IMREAD_COLOR), np.uint8), PARAMS)

    assert (found.circle is None) == octagon
    assert (SHAPE in {rejection.why for rejection in found.rejected}) == octagon


def test_nor_is_a_stop_sign_or_a_letter_on_it() -> None:
    sheet = decoys.sheet(WIDTH, HEIGHT, "concrete", 3)
    sheet.polygon(corners(8, 80.0, math.pi / 8), WHITE)
    sheet.polygon(corners(8, 74.0, math.pi / 8))
    sheet.text("STOP", 161.3 - 45, 119.2 + 14, 38.0, WHITE)

    assert detect(sheet.finished(), PARAMS).circle is None


def test_nor_is_an_octagon_that_the_frame_cuts() -> None:
    sheet = decoys.sheet(WIDTH, HEIGHT, "concrete", 4)
    sheet.polygon([(u - 140.0, v) for u, v in corners(8, 70.0, 0.1)])

    assert detect(sheet.finished(), PARAMS).circle is None


def test_the_curve_of_a_polygon_explains_its_edges_and_not_those_of_a_chipped_disc() -> None:
    seen = np.ones(facets.RAYS, np.bool_)
    t = np.arange(facets.RAYS) * 2 * np.pi / facets.RAYS
    octagon = math.cos(math.pi / 8) / np.cos((t + 0.1) % (np.pi / 4) - np.pi / 8) - 0.97
    chipped = np.where((t > 1) & (t < 2), -0.1, 0.001 * np.cos(11 * t))

    explained, swing = facets.polygon_share(octagon, seen)
    assert explained > 0.9
    assert swing == pytest.approx(1, abs=0.05)
    assert facets.polygon_share(np.where(t < 0.3, 0.09, octagon), seen)[0] > 0.9  # a few stray edges
    assert facets.polygon_share(chipped, seen)[1] < 0.4
    assert facets.polygon_share(octagon, t < 2.2) == (0.0, 0.0)  # too few


def test_edges_that_are_sharper_than_they_are_round_are_ragged() -> None:
    assert ragged(replace(RIM, rms_px=1.2, wave_px=0.9))
    assert not ragged(replace(RIM, rms_px=1.2, wave_px=0.9, blur_px=2.5))  # a soft edge is not known better
    assert not ragged(replace(RIM, rms_px=1.2, wave_px=0.1))  # noise


@pytest.mark.parametrize("colour", [WHITE, (30.0, 32.0, 30.0), (60.0, 200.0, 220.0)])
@pytest.mark.parametrize(("outer", "inner"), [(0.8, 0.55), (0.93, 0.5), (0.6, 0.4), (0.9, 0.8)])
def test_of_concentric_rims_the_outermost_is_the_markers(colour: Colour, outer: float, inner: float) -> None:
    radius = 70.0
    image = discs(
        [(160.4, 120.7, radius, RED), (161.9, 120.2, outer * radius, colour), (162.4, 120.0, inner * radius, RED)]
    )
    full = detect(image, PARAMS)
    near = detect(image, PARAMS, window=(70, 25, 260, 220), expected=Circle(162.4, 120.0, inner * radius))

    for found in (full, near):
        assert found.circle is not None
        assert found.circle.radius_px == pytest.approx(radius, abs=0.7)
        assert math.hypot(found.circle.u_px - 160.4, found.circle.v_px - 120.7) < 0.5


@pytest.mark.parametrize("rust", [(62.0, 80.0, 104.0), (70.0, 84.0, 110.0)])
def test_rust_round_a_faded_marker_is_not_within_its_rim(rust: Colour) -> None:
    faded = (112.0, 108.0, 180.0)
    image = discs([(163.4, 124.7, 64.0, rust), (160.4, 120.7, 52.0, faded)])
    inner, outer = Ellipse(160.4, 120.7, 52.0, 52.0, 0.0), Ellipse(163.4, 124.7, 64.0, 62.0, 0.3)

    assert not of_its_paint(image, outer, inner)
    assert of_its_paint(discs([(163.4, 124.7, 64.0, faded)]), outer, inner)
    assert of_its_paint(image, Ellipse(160.4, 120.7, 53.0, 53.0, 0.0), inner)  # too little between them


@pytest.mark.parametrize("u", [20.4, 300.4])
def test_of_rims_that_the_frame_cuts_the_part_in_the_picture_counts(u: float) -> None:
    image = discs([(u, 120.7, 64.0, (62.0, 78.0, 112.0)), (u, 120.7, 48.0, RED)])

    assert not of_its_paint(image, Ellipse(u, 120.7, 64.0, 64.0, 0.0), Ellipse(u, 120.7, 48.0, 48.0, 0.0))


def test_a_target_of_five_rings_and_a_darker_middle_are_one_marker() -> None:
    rings = [(160.0, 120.0, 80.0 * share, WHITE if n % 2 else RED) for n, share in enumerate((1, 0.8, 0.6, 0.4, 0.2))]
    dark = [(160.0, 120.0, 80.0, PALE), (160.0, 120.0, 45.0, DEEP)]
    for painted in (rings, dark):
        found = detect(discs(painted), PARAMS)
        assert found.circle is not None
        assert found.circle.radius_px == pytest.approx(80.0, abs=0.7)


LARGE, SMALL = (215.4, 120.7, 62.0, PALE), (70.3, 90.6, 33.0, DEEP)


@pytest.mark.parametrize("painted", [(LARGE, SMALL), (SMALL, LARGE)])
def test_the_larger_of_two_discs_is_taken_though_the_other_one_is_redder(painted: tuple[Disc, Disc]) -> None:
    found = detect(discs(painted), PARAMS)

    assert found.circle is not None
    assert found.circle.radius_px == pytest.approx(62.0, abs=0.5)
    assert [rejected.why for rejected in found.rejected][:1] == [WEAKER]


def test_but_not_where_the_ranger_knows_better() -> None:
    found = detect(discs((LARGE, SMALL)), PARAMS, radii_px=(28.0, 38.0))

    assert found.circle is not None
    assert found.circle.radius_px == pytest.approx(33.0, abs=0.5)
    assert [rejected.why for rejected in found.rejected][:1] == [SIZE]


def test_two_equal_discs_are_ambiguous() -> None:
    found = detect(discs([(80.3, 110.6, 40.0, RED), (230.4, 130.7, 40.8, RED)]), PARAMS)

    assert found.circle is None
    assert [rejected.why for rejected in found.rejected][:2] == [AMBIGUOUS, AMBIGUOUS]


def test_of_two_of_about_one_size_the_one_with_clearly_more_evidence_is_taken() -> None:
    disc = Candidate(RIM, PERFECT)
    elsewhere = replace(RIM, ellipse=Ellipse(300.0, 60.0, 31.0, 31.0, 0.0))
    reflected = Candidate(elsewhere, replace(PERFECT, redness=0.5))

    assert chosen([reflected, disc]) == (disc, [(reflected, WEAKER)])
    assert chosen([disc, Candidate(elsewhere, PERFECT)])[0] is None
    larger = Candidate(replace(elsewhere, ellipse=Ellipse(300.0, 60.0, 40.0, 40.0, 0.0)), replace(PERFECT, redness=0.5))
    assert chosen([disc, larger])[0] is larger
    faint = replace(larger, evidence=replace(PERFECT, redness=0.2))
    assert chosen([disc, faint])[0] is disc
    assert chosen([]) == (None, [])


@pytest.mark.parametrize("radius_px", [34.0, 90.0])
def test_a_larger_disc_that_is_only_less_sure_leaves_a_doubt(radius_px: float) -> None:
    """As a marker of which half the picture was lost, beside a valve wheel."""
    wheel = Candidate(RIM, PERFECT)
    cut = Candidate(
        replace(RIM, ellipse=Ellipse(300.0, 60.0, radius_px, radius_px, 0.0), support=0.5),
        replace(PERFECT, coverage=0.65),
    )
    assert 0.5 < confidence(cut) < 0.6 * confidence(wheel)

    assert chosen([wheel, cut]) == (None, [(wheel, AMBIGUOUS), (cut, AMBIGUOUS)])
    reflection = replace(cut, rim=replace(cut.rim, ellipse=Ellipse(300.0, 60.0, 32.0, 32.0, 0.0)))
    assert chosen([wheel, reflection]) == (wheel, [(reflection, WEAKER)])


@pytest.mark.mostly_long
@pytest.mark.parametrize("radius", [40.5, 53.0])
def test_the_followed_one_of_two_stays(radius: float) -> None:
    """An equal disc that comes into view, or a somewhat larger one, does not take the track."""
    find = registry.detector(VisionConfig(method="robust", tracking=True))
    marker, other = (80.3, 110.6, 40.0, RED), (230.4, 120.7, radius, RED)
    for n in range(30):
        found = find(discs([marker, other][: 1 + (n >= 6)], seed=1 + n % 3), n * PERIOD_NS)
        assert found.circle is not None, n
        assert found.circle.radius_px == pytest.approx(40.0, abs=0.5)
