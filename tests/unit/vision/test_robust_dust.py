"""The robust method in thick dust: the veil's estimate, what is left after it, discs behind veils of known share."""

import math

import cv2
import numpy as np
import pytest

from gateway.config import VisionConfig
from gateway.core.detection import Circle, Ellipse
from gateway.sim.weather import dust
from gateway.vision.detect.robust import clearest_rim as clearest
from gateway.vision.detect.robust import veil
from gateway.vision.detect.robust.clearest_rim import clearest_rim, rim_behind_veil
from gateway.vision.detect.robust.decision import Limits
from gateway.vision.detect.robust.detect import detect
from gateway.vision.detect.robust.red_change import red_regions
from gateway.vision.detect.robust.redness import PyramidLevel, pyramid, redness
from gateway.vision.detect.robust.search import search_expected
from gateway.vision.detect.robust.veil import Veil, contrast_left, estimate, less_veil, unveiled
from gateway.vision.pixels import Colours, Image
from tests import decoys
from tests.long import mostly_long

pytestmark = pytest.mark.one_interpreter

PARAMS = VisionConfig()
PLACE = Circle(163.3, 118.8, 41.7)
AT = (PLACE.u_px, PLACE.v_px)


def scene(ground: str = "concrete", seed: int = 1, *, decoy: str = "") -> Image:
    sheet = decoys.sheet(320, 240, ground, seed)
    if decoy:
        decoys.DECOYS[decoy](sheet, 158.0, 122.0, 44.0)
    else:
        sheet.disc(PLACE.u_px, PLACE.v_px, PLACE.radius_px)
    return sheet.finished(noise=0)


def veiled_grey(share: float) -> Image:
    """A grey wall with a black gap in every eighth of it, behind a veil of airlight 200."""
    clear = np.full((120, 160, 3), 120.0)
    clear[7::15, :, :] = clear[8::15, :, :] = clear[9::15, :, :] = 0.0
    return np.rint((1 - share) * clear + share * np.array((200.0, 204.0, 208.0))).astype(np.uint8)


@pytest.mark.parametrize("share", [0.8, 0.9, 0.95])
def test_the_veil_is_that_of_the_darkest(share: float) -> None:
    veil = estimate(veiled_grey(share))
    assert veil is not None

    assert veil.share * veil.airlight[1] == pytest.approx(share * 204, rel=0.03)
    assert veil.airlight[2] > veil.airlight[1] > veil.airlight[0]


@pytest.mark.parametrize("share", [0.0, 0.2, 0.4])
def test_no_veil_is_subtracted_where_the_air_is_clear_enough(share: float) -> None:
    assert estimate(veiled_grey(share)) is None


def test_neither_green_nor_darkness_nor_a_bright_part_is_dust() -> None:
    dusty = veiled_grey(0.9)
    green = (dusty * np.array((0.8, 1.0, 0.8))).astype(np.uint8)
    part = veiled_grey(0.0)
    part[:, :60] = dusty[:, :60]

    assert estimate(dusty) is not None
    assert estimate(green) is None
    assert estimate(dusty // 16) is None
    assert estimate(part) is None
    assert estimate(dusty[:7]) is None


def test_what_the_veil_leaves_has_the_ratio_of_the_paint() -> None:
    share, airlight = 0.9, np.array((200.0, 204.0, 208.0))
    seen = np.full((32, 32, 3), (1 - share) * np.array((40.0, 50.0, 200.0)) + share * airlight, np.float32)
    (level,) = unveiled([PyramidLevel(seen, 4)], Veil(np.full((4, 6), share, np.float32), (200.0, 204.0, 208.0)))

    assert level.bgr[20, 7] == pytest.approx([4, 5, 20], abs=1e-3)
    assert level.bgr.dtype == np.float32
    assert float(redness(level.bgr)[20, 7]) == pytest.approx(math.log(28 / 13), abs=1e-4)
    assert (level.factor, level.veil_at(125.0, 1.0), level.veil_at(-99.0, 999.0)) == (4, *[pytest.approx(0.9)] * 2)


def test_what_is_left_of_eight_bits_uses_them() -> None:
    seen = np.full((32, 32, 3), (184, 189, 207), np.uint8)
    veil = Veil(np.full((4, 6), 0.9, np.float32), (200.0, 204.0, 208.0))
    fine, coarse = unveiled([PyramidLevel(seen, 2), PyramidLevel(seen[::2, ::2], 4)], veil)

    assert fine.gain == coarse.gain == 8  # the most: 19.8 grey levels are left of red
    assert fine.bgr[5, 5].tolist() == [32, 43, 158]
    assert float(redness(fine.bgr, fine.gain)[5, 5]) == pytest.approx(math.log(27.8 / 13.4), abs=2e-3)


def test_more_than_there_is_cannot_be_subtracted() -> None:
    full = Veil(np.ones((1, 1), np.float32), (99.0, 99.0, 99.0))
    (level,) = unveiled([PyramidLevel(np.full((8, 8, 3), 90, np.uint8), 1)], full)

    assert level.bgr.max() == 0


def test_in_clear_air_the_levels_are_untouched() -> None:
    levels = pyramid(scene(), 1, 8)

    assert less_veil(levels) is levels
    assert levels[0].veil_at(3, 4) == 0


@pytest.mark.parametrize(("share", "left"), [(0.0, 1.0), (0.5, 0.924), (0.85, 0.687), (0.93, 0.491), (1.0, 0.0)])
def test_how_much_redness_a_veil_leaves(share: float, left: float) -> None:
    assert contrast_left(share) == pytest.approx(left, abs=0.001)


@pytest.mark.parametrize("uneven", mostly_long([True, False]))
@pytest.mark.parametrize(("share", "within_px"), [(0.8, 0.15), (0.85, 0.2), (0.9, 0.25), (0.93, 0.4)])
@pytest.mark.parametrize("ground", decoys.GROUNDS)
def test_a_disc_is_found_behind_thick_dust(ground: str, share: float, within_px: float, uneven: bool) -> None:
    found = detect(dust(scene(ground), share, at=AT, uneven=uneven, seed=5), PARAMS)
    assert found.circle is not None, found.rejected

    assert math.hypot(found.circle.u_px - PLACE.u_px, found.circle.v_px - PLACE.v_px) <= within_px
    assert found.circle.radius_px == pytest.approx(PLACE.radius_px, abs=0.5)
    assert found.veil is not None
    assert share - 0.05 <= found.veil <= share + 0.12  # nothing in these scenes is black: it is an upper bound


def test_a_sure_marker_before_an_even_wall_is_searched_for_once(monkeypatch: pytest.MonkeyPatch) -> None:
    wall = np.full((240, 320, 3), (176, 181, 178), np.uint8)
    cv2.circle(wall, (80, 70), 30, (40, 35, 190), -1, cv2.LINE_AA)
    assert estimate(wall[::2, ::2].copy()) is not None  # the wall looks like dust
    monkeypatch.setattr(veil, "unveiled", lambda *_: pytest.fail("searched a second time"))

    found = detect(wall, PARAMS)

    assert found.circle is not None
    assert found.circle.radius_px == pytest.approx(30, abs=0.7)
    assert found.veil == 0


def test_clear_air_is_reported_as_such() -> None:
    assert detect(scene(), PARAMS).veil == 0
    assert detect(scene(decoy="square"), PARAMS).veil is None


@pytest.mark.parametrize("share", mostly_long([0.85, 0.96, 0.5, 0.7, 0.9, 0.93], short=2))
@pytest.mark.parametrize("name", [name for name in decoys.DECOYS if name != "text"])
def test_no_decoy_is_a_marker_behind_dust(name: str, share: float) -> None:
    assert detect(dust(scene(decoy=name), share, at=AT, uneven=True, seed=3), PARAMS).circle is None


@pytest.mark.parametrize("ground", decoys.GROUNDS)
@pytest.mark.parametrize("share", [0.9, 0.96, 0.99])
def test_dust_alone_is_no_marker(ground: str, share: float) -> None:
    empty = decoys.sheet(320, 240, ground, 31).finished(noise=0)

    assert detect(dust(empty, share, at=AT, uneven=True, seed=4), PARAMS).circle is None


def wall(colour: tuple[float, float, float], disc: tuple[float, float, float]) -> Image:
    sheet = decoys.sheet(320, 240, "concrete", 5)
    sheet.paint[:] = np.array(colour, np.float32)
    sheet.disc(PLACE.u_px, PLACE.v_px, PLACE.radius_px, disc)
    return sheet.finished()


@pytest.mark.parametrize("grey", [110.0, 130.0, 180.0])
@pytest.mark.parametrize("colour", [(150, 150, 100), (150, 150, 138), (120, 150, 115)])
def test_the_cyan_of_a_wall_makes_no_grey_disc_red(colour: tuple[float, float, float], grey: float) -> None:
    assert detect(wall(colour, (grey, grey, grey)), PARAMS).circle is None


@pytest.mark.parametrize(("colour", "grey"), [((140, 145, 105), 98), ((165, 161, 121), 122), ((221, 221, 216), 185)])
def test_nor_does_it_beside_something_dark_where_no_veil_was_estimated(colour: tuple[int, int, int], grey: int) -> None:
    image = np.empty((240, 320, 3), np.uint8)
    image[:] = colour
    image[60:90, 230:242] = 40
    cv2.circle(image, (170, 159), 40, (grey, grey, grey), -1, cv2.LINE_AA)

    assert detect(image, PARAMS).circle is None
    assert detect(cv2.GaussianBlur(image, (0, 0), 0.8).astype(np.uint8), PARAMS).circle is None


@pytest.mark.parametrize("ground", [90.0, 120.0])
def test_what_is_much_lighter_than_dust_has_to_be_red_by_itself(ground: float) -> None:
    pale = detect(wall((ground, ground, ground), (178, 178, 188)), PARAMS)
    pink = detect(wall((ground, ground, ground), (124, 122, 198)), PARAMS)

    assert pale.circle is None
    assert "colour" in [rejected.why for rejected in pale.rejected]
    assert pink.circle is not None


def test_the_tracked_place_is_measured_behind_dust_too() -> None:
    limits = Limits(min_radius_px=5.0, max_radius_px=200.0, min_confidence=0.5)
    image = dust(scene(), 0.92, at=AT, uneven=False, seed=6)
    found = search_expected(image[40:200, 80:250], Circle(AT[0] - 78.0, AT[1] - 42.0, 43.0), limits)
    assert found is not None

    assert (found.rim.ellipse.u_px + 80, found.rim.ellipse.v_px + 40) == pytest.approx(AT, abs=0.3)


def test_a_faint_rim_is_where_it_is_and_its_contrast_in_grey_levels() -> None:
    image = dust(scene(), 0.96, at=AT, uneven=False, seed=8)
    seed = Ellipse(AT[0] + 1, AT[1] - 1, 43.0, 43.0, 0.0)
    as_they_are, rim = clearest_rim(image, seed), rim_behind_veil(image, seed, 0.95)
    assert rim is not None
    assert rim_behind_veil(image, seed, 0.0) == rim  # by its contrast, whatever the veil

    assert as_they_are is None or as_they_are.support < rim.support
    assert (rim.ellipse.u_px, rim.ellipse.v_px, rim.ellipse.semi_major_px) == pytest.approx((*AT, 41.7), abs=0.6)
    assert rim.contrast == pytest.approx(0.04 * math.dist((121, 125, 125), (45, 35, 190)), abs=1.5)


@pytest.mark.parametrize("radius_px", [17.0, 41.7, 70.0])
def test_in_a_twentieth_of_the_light_the_rim_is_found_in_the_noise(radius_px: float) -> None:
    sheet = decoys.sheet(320, 240, "concrete", 4)
    sheet.disc(*AT, radius_px)
    sheet.paint *= 0.05
    found = detect(sheet.finished(noise=2.5), PARAMS)

    assert found.circle is not None
    assert (found.circle.u_px, found.circle.v_px, found.circle.radius_px) == pytest.approx((*AT, radius_px), abs=1.0)


def test_another_red_thing_is_noticed_behind_dust() -> None:
    sheet = decoys.sheet(400, 240, "concrete", 1)
    sheet.disc(*AT, PLACE.radius_px)
    sheet.box(320.0, 120.0, 25.0, 25.0)
    (box,) = red_regions(dust(sheet.finished(noise=0), 0.9, at=AT, uneven=False, seed=2), PLACE).boxes

    assert box.tolist() == pytest.approx([295, 95, 346, 146], abs=4)


@pytest.mark.parametrize(("beside", "smoothed"), [((90, 90, 90), True), ((255, 255, 255), False)])
def test_a_part_that_spans_half_of_the_grey_levels_is_not_stretched(
    beside: tuple[int, int, int], smoothed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    shot = np.full((240, 320, 3), (60, 60, 60), np.float64)
    cv2.circle(shot, (160, 120), 40, (58, 58, 68), -1)
    shot[:, 205:] = beside
    image = np.clip(np.rint(shot + np.random.default_rng(5).normal(0, 6, shot.shape)), 0, 255).astype(np.uint8)
    parts: list[Colours] = []
    stretched = clearest._stretched

    def seen(part: Colours, sigma_px: float) -> tuple[Image, float]:
        parts.append(part)
        return stretched(part, sigma_px)

    monkeypatch.setattr(clearest, "_stretched", seen)
    rim_behind_veil(image, Ellipse(160.0, 120.0, 40.0, 40.0, 0.0), 0.95)
    assert len(parts) == smoothed


def test_a_stretched_part_is_that_of_a_gaussian_to_a_grey_level() -> None:
    part = np.random.default_rng(3).integers(40, 90, (60, 70, 3), np.uint8)
    bright, gain = clearest._stretched(part, 1.5)
    smooth = cv2.GaussianBlur(part.astype(np.float32), (0, 0), 1.5)
    low, high = np.percentile(smooth[::4, ::4], (1, 99))

    assert gain == pytest.approx(min(8.0, 230 / (high - low)))
    expected = np.clip(np.rint((smooth - (low + high) / 2) * gain + 128), 0, 255)
    assert np.abs(bright - expected).max() <= 1
