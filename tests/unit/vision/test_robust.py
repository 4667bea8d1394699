"""The robust method on drawn scenes with exact truth: what it finds, how exactly, and what does not lead it astray."""

import math
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from gateway.config import Intrinsics, VisionConfig
from gateway.core.detection import Circle, Detection
from gateway.vision.detect.robust.decision import AMBIGUOUS, GATES
from gateway.vision.detect.robust.detect import _received as received
from gateway.vision.detect.robust.detect import detect
from gateway.vision.detect.robust.frame_sum import MOVED
from gateway.vision.detect.robust.method import REJECTIONS, STAGES
from gateway.vision.pixels import Image
from gateway.vision.track.distractors import WEAKER
from gateway.vision.track.follower import JUMP
from tests import decoys

pytestmark = pytest.mark.one_interpreter

WIDTH, HEIGHT = 320, 240
PARAMS = VisionConfig()
PLACE = Circle(163.3, 118.8, 41.7)
RED, GREY = decoys.RED, (120, 122, 121)
Painting = Callable[[decoys.Drawing], None]


def scene(*paintings: Painting, ground: str = "concrete", seed: int = 1) -> Image:
    sheet = decoys.sheet(WIDTH, HEIGHT, ground, seed)
    for paint in paintings:
        paint(sheet)
    return sheet.finished()


def disc(place: Circle = PLACE) -> Painting:
    return lambda sheet: sheet.disc(place.u_px, place.v_px, place.radius_px)


def off_by(found: Detection, place: Circle) -> tuple[float, float]:
    """Distance of the centres and difference of the radii, px."""
    assert found.circle is not None, found.rejected
    centre = math.hypot(found.circle.u_px - place.u_px, found.circle.v_px - place.v_px)
    return centre, found.circle.radius_px - place.radius_px


def assert_found(image: Image, place: Circle, within_px: float, **how: object) -> Detection:
    found = detect(image, PARAMS, **how)  # type: ignore[arg-type]
    centre, radius = off_by(found, place)
    assert centre <= within_px
    assert abs(radius) <= within_px
    return found


@pytest.mark.parametrize("ground", decoys.GROUNDS)
def test_a_disc_on_any_ground_is_measured_to_a_tenth_of_a_pixel(ground: str) -> None:
    found = assert_found(scene(disc(), ground=ground), PLACE, 0.15)

    assert found.visible == pytest.approx(1, abs=0.05)
    assert found.confidence is not None
    assert found.confidence > 0.9
    assert found.circularity == pytest.approx(1, abs=0.01)
    assert found.fill == pytest.approx(1, abs=0.02)
    assert found.area_px2 == pytest.approx(math.pi * PLACE.radius_px**2, rel=0.01)


def test_a_shaded_ball_with_a_highlight_is_as_good_as_a_disc() -> None:
    image = scene(lambda sheet: sheet.ball(PLACE.u_px, PLACE.v_px, PLACE.radius_px), ground="wood")

    assert_found(image, PLACE, 0.5)


@pytest.mark.parametrize("radius", [8.0, 14.0, 25.0, 60.0, 105.0])
def test_every_octave_of_radii_is_searched(radius: float) -> None:
    place = Circle(160.4, 119.7, radius)

    assert_found(scene(disc(place)), place, 0.2)


def test_of_a_tilted_disc_the_radius_is_the_semi_major_axis() -> None:
    sheet = decoys.sheet(WIDTH, HEIGHT, "concrete", 1)
    du, dv = sheet.far(PLACE.u_px, PLACE.v_px)
    turn, major, minor = 0.5, 50.0, 40.0
    along, across = du * np.cos(turn) + dv * np.sin(turn), dv * np.cos(turn) - du * np.sin(turn)
    sheet.fill((along / major) ** 2 + (across / minor) ** 2 <= 1, RED)
    found = assert_found(sheet.finished(), Circle(PLACE.u_px, PLACE.v_px, major), 0.15)

    assert found.ellipse is not None
    assert found.ellipse.semi_minor_px == pytest.approx(minor, abs=0.15)
    assert found.ellipse.angle_rad == pytest.approx(turn, abs=0.02)
    assert found.fill == pytest.approx(minor / major, abs=0.01)


@pytest.mark.parametrize(("apart", "hidden"), [(0.9, 0.15), (0.55, 0.3)])
def test_a_part_may_be_hidden(apart: float, hidden: float) -> None:
    edge_px = PLACE.u_px + apart * PLACE.radius_px
    hide: Painting = lambda sheet: sheet.box(edge_px + 40, PLACE.v_px, 40, 200, (90, 100, 95))  # noqa: E731
    found = assert_found(scene(disc(), hide), PLACE, 0.3)

    assert math.acos(apart) / math.pi == pytest.approx(hidden, abs=0.03)
    assert found.visible == pytest.approx(1 - math.acos(apart) / math.pi, abs=0.05)


@pytest.mark.parametrize("place", [Circle(12.0, 120.0, 45.0), Circle(160.0, 225.0, 45.0), Circle(285.0, 30.0, 45.0)])
def test_the_frame_may_cut_a_part_off(place: Circle) -> None:
    found = assert_found(scene(disc(place)), place, 1.0)

    assert found.visible is not None
    assert 0.4 < found.visible < 0.85


@pytest.mark.parametrize("channel", range(3))
def test_rows_are_received_that_differ_in_one_channel_from_those_lost_below(channel: int) -> None:
    image = np.full((60, 80, 3), 128, np.uint8)
    image[:40, :, channel] = 90
    assert received(image) == 40

    image[30:40, 40:, channel] = 128  # an even ground begins here and there
    assert received(image) == 40
    image[30:40, 16:, channel] = 128
    assert received(image) == 60


@pytest.mark.parametrize("lost", [0.2, 0.4])
def test_rows_that_were_lost_are_beyond_the_frame(lost: float) -> None:
    """A decoder fills them with one colour."""
    image = scene(disc())
    image[round(PLACE.v_px + (1 - 2 * lost) * PLACE.radius_px) :] = 128
    found = assert_found(image, PLACE, 0.5)

    assert found.confidence is not None
    assert found.confidence > 0.9
    assert off_by(detect(image, PARAMS, window=(100, 60, 230, 200)), PLACE) == pytest.approx((0, 0), abs=0.5)


def test_an_even_ground_below_the_marker_is_seen() -> None:
    image = np.full((HEIGHT, WIDTH, 3), 128, np.uint8)
    cv2.circle(image, (160, 120), 40, (40, 35, 190), -1, cv2.LINE_AA)

    assert assert_found(image, Circle(160, 120, 40), 1.0).visible == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize("name", decoys.DECOYS)
def test_no_decoy_beside_it_wins(name: str) -> None:
    def beside(sheet: decoys.Drawing) -> None:
        decoys.DECOYS[name](sheet, 245.0, 130.0, 38.0)

    place = Circle(90.3, 110.6, 30.4)
    assert_found(scene(beside, disc(place)), place, 0.2)


@pytest.mark.parametrize("name", ["square", "oblong", "lorry"])
def test_a_red_thing_behind_it_does_not_carry_the_rim_away(name: str) -> None:
    def behind(sheet: decoys.Drawing) -> None:
        decoys.DECOYS[name](sheet, PLACE.u_px + 75.0, PLACE.v_px, 40.0)

    assert_found(scene(behind, disc()), PLACE, 0.5)


@pytest.mark.parametrize("other_px", [18.0, 27.0])
def test_of_two_discs_the_larger_one_is_taken_and_the_other_one_reported(other_px: float) -> None:
    large, small = Circle(100.2, 120.4, 34.3), Circle(240.6, 110.1, other_px)
    found = assert_found(scene(disc(large), disc(small)), large, 0.15)

    reported = [rejection for rejection in found.rejected if rejection.why == "weaker"]
    assert len(reported) == 1
    assert reported[0].circle.u_px == pytest.approx(small.u_px, abs=0.3)
    assert reported[0].circle.radius_px == pytest.approx(other_px, abs=0.3)


def test_a_thin_white_line_round_the_disc_is_not_its_rim() -> None:
    def framed(sheet: decoys.Drawing) -> None:
        sheet.disc(PLACE.u_px, PLACE.v_px, PLACE.radius_px + 4, (220, 222, 221))
        sheet.disc(PLACE.u_px, PLACE.v_px, PLACE.radius_px, (20, 18, 90))

    sheet = decoys.sheet(WIDTH, HEIGHT, "concrete", 1)
    sheet.fill(np.ones(sheet.paint.shape[:2], np.float32), (12, 10, 11))
    framed(sheet)
    assert_found(sheet.finished(), PLACE, 0.5)


@pytest.mark.parametrize(("name", "change"), [("shift", (7, -5)), ("turn", (0, 0))])
def test_shifts_and_quarter_turns_move_the_answer_and_nothing_else(name: str, change: tuple[int, int]) -> None:
    image = scene(disc(), ground="rust")
    if name == "shift":
        moved = np.roll(image, change, axis=(1, 0))
        place = Circle(PLACE.u_px + change[0], PLACE.v_px + change[1], PLACE.radius_px)
    else:
        moved = np.ascontiguousarray(np.rot90(image))
        place = Circle(PLACE.v_px, WIDTH - 1 - PLACE.u_px, PLACE.radius_px)
    before, after = off_by(detect(image, PARAMS), PLACE), off_by(detect(moved, PARAMS), place)

    assert after == pytest.approx(before, abs=0.05)


@pytest.mark.parametrize("gain", [0.35, 0.6, 1.3])
def test_light_does_not_matter(gain: float) -> None:
    dimmed = np.clip(scene(disc(), ground="wood").astype(np.float32) * gain, 0, 255).astype(np.uint8)

    assert_found(dimmed, PLACE, 0.2)


def test_a_window_gives_the_same_answer_in_the_coordinates_of_the_full_frame() -> None:
    image = scene(disc(), ground="wood")
    full = detect(image, PARAMS)
    window = (95, 50, 235, 190)
    assert full.circle is not None
    for expected in (None, PLACE, Circle(PLACE.u_px + 5, PLACE.v_px - 4, PLACE.radius_px * 1.06)):
        near = detect(image, PARAMS, window=window, expected=expected)
        assert off_by(near, full.circle) == pytest.approx((0, 0), abs=0.03)


def test_a_prediction_that_is_wrong_costs_time_but_changes_nothing() -> None:
    image = scene(disc(), ground="wood")
    elsewhere = Circle(60.0, 60.0, 20.0)

    assert_found(image, PLACE, 0.15, window=(0, 0, WIDTH, HEIGHT), expected=elsewhere)
    assert detect(image, PARAMS, expected=elsewhere).circle == detect(image, PARAMS).circle


def test_a_window_beside_the_marker_holds_none() -> None:
    assert detect(scene(disc()), PARAMS, window=(0, 0, 70, 240)).circle is None


def test_radius_limits_are_shares_of_the_diagonal() -> None:
    image, diagonal_px = scene(disc()), math.hypot(WIDTH, HEIGHT)
    share = PLACE.radius_px / diagonal_px

    assert detect(image, VisionConfig(min_radius_share=share * 0.95)).circle is not None
    too_small = detect(image, VisionConfig(min_radius_share=share * 1.05))
    assert too_small.circle is None
    assert "radius" in {rejection.why for rejection in too_small.rejected}
    assert detect(image, VisionConfig(max_radius_share=share * 0.95)).circle is None


def test_less_confidence_than_asked_for_is_no_marker() -> None:
    image = scene(disc())
    confidence = detect(image, PARAMS).confidence
    assert confidence is not None
    unsure = detect(image, VisionConfig(min_confidence=(1 + confidence) / 2))

    assert unsure.circle is None
    assert "confidence" in {rejection.why for rejection in unsure.rejected}


def test_with_intrinsics_the_direction_is_reported() -> None:
    lens = Intrinsics(fx=500, fy=510, cx=160, cy=120)
    found = detect(scene(disc()), VisionConfig(intrinsics=lens))

    assert found.x_n == pytest.approx((PLACE.u_px - 160) / 500, abs=1e-3)
    assert found.y_n == pytest.approx((PLACE.v_px - 120) / 510, abs=1e-3)


def test_stages_are_timed_under_their_names() -> None:
    ticks = iter(range(0, 100_000, 10))
    full = detect(scene(disc()), PARAMS, lambda: next(ticks))
    near = detect(scene(disc()), PARAMS, lambda: next(ticks), window=(80, 40, 250, 200), expected=PLACE)

    names = [stage.name for stage in STAGES]
    assert [name for name, _ in full.stage_ns] == names[1:]
    assert [name for name, _ in near.stage_ns] == ["expected", "normalise"]
    assert {ns for _, ns in full.stage_ns} == {10}


def test_the_same_picture_gives_the_same_answer_bit_for_bit() -> None:
    image = scene(disc(), ground="rust")

    assert detect(image, PARAMS) == detect(image.copy(), PARAMS)


def test_every_code_of_a_rejection_is_explained() -> None:
    codes = {code for code, _ in GATES} | {"rim", WEAKER, AMBIGUOUS, JUMP, MOVED}

    assert codes == set(REJECTIONS)


def test_a_large_picture_is_searched_like_a_small_one() -> None:
    small = scene(disc(), ground="wood")
    large = np.asarray(cv2.resize(small, None, fx=6, fy=6, interpolation=cv2.INTER_CUBIC), np.uint8)
    place = Circle(PLACE.u_px * 6 + 2.5, PLACE.v_px * 6 + 2.5, PLACE.radius_px * 6)

    assert_found(large, place, 1.0)
