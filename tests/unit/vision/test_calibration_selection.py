"""Which views are worth taking: judged with drawn boards whose pose is known."""

import xml.etree.ElementTree as ET

import cv2
import numpy as np
import pytest

from gateway.config import Intrinsics
from gateway.durations import NS_PER_S
from gateway.vision.offline.calibration import boards, drawing, selection
from gateway.vision.offline.calibration.boards import Board, Points, find, grey_of, look, parse
from gateway.vision.offline.calibration.selection import (
    Missing,
    Stillness,
    ViewVerdict,
    apart,
    appearance,
    edge_px,
    worth,
)
from gateway.vision.pixels import Image
from tests.unit.vision.board_pictures import POSES, Camera, Pose, shot, truth

BOARD = parse("checkerboard:8x6:18mm")
SIZE = (480, 360)
LENS = Intrinsics(fx=520, fy=516, cx=246, cy=172, distortion=(-0.24, 0.09, 0.0008, -0.0006))  # as Camera()
MIDDLE = Pose(0, 0, 420, (0, 0, 0))


def points(pose: Pose, board: Board = BOARD) -> Points:
    return np.asarray(truth(board, pose), np.float32)


@pytest.mark.parametrize(
    ("turn_deg", "right_deg", "bottom_deg"),
    [((0, 0, 0), 0, 0), ((25, 0, 0), 0, 25), ((-25, 0, 0), 0, -25), ((0, 30, 0), -30, 0), ((0, -30, 0), 30, 0)],
)
def test_tilt_is_read_from_one_picture(
    turn_deg: tuple[float, float, float], right_deg: float, bottom_deg: float
) -> None:
    """Turned about x by 25 degrees, the lower edge is farther away; also where the points count from the other end."""
    for order in (points(Pose(0, 0, 420, turn_deg)), points(Pose(0, 0, 420, turn_deg))[::-1].copy()):
        seen = appearance(BOARD, order, SIZE, LENS)
        assert [seen.right_deg, seen.bottom_deg] == pytest.approx([right_deg, bottom_deg], abs=0.5)
        rough = appearance(BOARD, order, SIZE)
        assert [rough.right_deg, rough.bottom_deg] == pytest.approx([right_deg, bottom_deg], abs=6)
    assert seen.tilt_deg == pytest.approx(max(abs(right_deg), abs(bottom_deg)), abs=0.6)


def test_how_far_apart_two_views_are() -> None:
    base = appearance(BOARD, points(MIDDLE), SIZE, LENS)
    assert apart(base, base) == 0

    def moved(x_mm: float = 0, z_mm: float = 420, turn_deg: tuple[float, float, float] = (0, 0, 0)) -> float:
        return apart(base, appearance(BOARD, points(Pose(x_mm, 0, z_mm, turn_deg)), SIZE, LENS))

    assert moved(x_mm=24) == pytest.approx(0.5, abs=0.05)  # 24 mm * 520 / 420 = 30 px of 600
    assert moved(x_mm=48) == pytest.approx(1.0, abs=0.1)
    assert moved(z_mm=420 * 1.3) == pytest.approx(1.0, abs=0.05)
    assert moved(z_mm=420 / 1.3) == pytest.approx(1.0, abs=0.1)
    assert moved(turn_deg=(0, 20, 0)) > 1.2
    assert moved(turn_deg=(0, 0, 30)) < 0.5, "turned in its own plane, it tells little"


@pytest.mark.long
@pytest.mark.one_interpreter
def test_the_views_of_the_other_tests_are_all_worth_taking_once() -> None:
    taken: list[Points] = []
    for n, pose in enumerate(POSES):
        picture = shot(BOARD, pose, seed=n)
        seen = look(BOARD, picture)
        assert seen is not None
        assert worth(BOARD, seen, grey_of(picture), taken) is ViewVerdict.TAKEN
        taken.append(seen)
        assert worth(BOARD, seen, grey_of(picture), taken) is ViewVerdict.SIMILAR


def test_too_far_and_blurred() -> None:
    far = shot(BOARD, Pose(0, 0, 1800, (0, 0, 0)))
    seen = look(BOARD, far)
    assert seen is not None
    assert boards.spacing_px(BOARD, seen) == pytest.approx(18 * 516 / 1800, abs=0.3)
    assert worth(BOARD, seen, grey_of(far), []) is ViewVerdict.TOO_FAR

    sharp = grey_of(shot(BOARD, POSES[1]))
    seen = look(BOARD, shot(BOARD, POSES[1]))
    assert seen is not None
    assert edge_px(BOARD, sharp, seen) == pytest.approx(2.4, abs=0.2)
    assert selection.blurred_px(BOARD, seen, SIZE) == 4.0
    assert worth(BOARD, seen, sharp, []) is ViewVerdict.TAKEN
    across, down = np.full((1, 9), 1 / 9, np.float32), np.full((9, 1), 1 / 9, np.float32)
    for kernel in (across, down):  # moved by 9 px while the shutter was open
        moved = np.asarray(cv2.filter2D(sharp, -1, kernel), np.uint8)
        assert edge_px(BOARD, moved, seen) == pytest.approx(8.8, abs=0.5)
        assert worth(BOARD, seen, moved, []) is ViewVerdict.BLURRED


@pytest.mark.parametrize("spec", ["circles:8x6:20mm", "asymmetric-circles:4x9:12mm"])
def test_circles_are_judged_likewise(spec: str) -> None:
    board = parse(spec)
    picture = shot(board, POSES[1])
    seen = look(board, picture)
    assert seen is not None
    assert worth(board, seen, grey_of(picture), []) is ViewVerdict.TAKEN
    soft = np.asarray(cv2.GaussianBlur(grey_of(picture), (0, 0), 2.5), np.uint8)
    assert worth(board, seen, soft, []) is ViewVerdict.BLURRED


def test_it_must_be_held_still() -> None:
    """Within 0.004 of the diagonal, 2.4 px; points counted from the other end are the same points."""
    still, seen = Stillness(), points(MIDDLE)
    assert still.held_s(BOARD, seen, SIZE, 0) == 0
    assert still.held_s(BOARD, seen[::-1].copy(), SIZE, NS_PER_S // 4) == 0.25
    assert still.held_s(BOARD, seen + np.float32(1.5), SIZE, NS_PER_S // 2) == 0.5
    assert still.held_s(BOARD, seen + np.float32(2.0), SIZE, NS_PER_S) == 0, "2.8 px away from where it was first"
    assert still.held_s(BOARD, seen + np.float32(2.0), SIZE, 2 * NS_PER_S) == 1
    assert still.held_s(BOARD, None, SIZE, 3 * NS_PER_S) == 0
    assert still.held_s(BOARD, seen, SIZE, 4 * NS_PER_S) == 0


def test_which_kinds_are_missing() -> None:
    nothing = selection.progress(BOARD, [], SIZE, None)
    assert nothing.missing == tuple(Missing)
    assert (nothing.distances, int(nothing.coverage.sum())) == (1.0, 0)
    poses = (MIDDLE, Pose(0, 0, 420, (25, 0, 0)), Pose(0, 0, 420, (0, 30, 0)), Pose(0, 0, 660, (0, 0, 0)))
    some = selection.progress(BOARD, [points(pose) for pose in poses], SIZE, None)
    assert some.tilted == {Missing.LEFT: 1, Missing.RIGHT: 0, Missing.TOP: 0, Missing.BOTTOM: 1}
    assert some.distances == pytest.approx(660 / 420, rel=0.03)
    assert some.missing == (Missing.VIEWS, Missing.RIGHT, Missing.TOP, Missing.COVERAGE)
    corners = [(x, y) for x in (-90, 90) for y in (-60, 60)]
    more = [*POSES, *poses, *(Pose(x, y, 420, (0, 0, 0)) for x, y in corners)]
    assert selection.progress(BOARD, [points(pose) for pose in more], SIZE, None).missing == ()


@pytest.mark.long
@pytest.mark.one_interpreter
def test_a_quick_search_finds_the_very_points_of_a_thorough_one() -> None:
    """In a large picture the board is searched in a smaller one, and refined at full size."""
    camera = Camera(1280, 720, 1130.0, 1130.0, 640.0, 360.0, (-0.2, 0.05, 0.0, 0.0))
    pose = Pose(20, 10, 500, (20, 15, 5))
    picture = shot(BOARD, pose, camera)
    quick, thorough, watched = find(BOARD, picture, thorough=False), find(BOARD, picture), look(BOARD, picture)
    assert quick is not None
    assert watched is not None
    assert thorough is not None
    assert np.array_equal(quick, thorough)
    true = truth(BOARD, pose, camera)
    away = np.hypot(*(quick[:, None] - true[None]).transpose(2, 0, 1)).min(axis=1)
    assert np.sqrt((away**2).mean()) < 0.04
    assert np.hypot(*(watched - quick).T).max() < 2
    assert (watched - quick).mean(axis=0) == pytest.approx([0, 0], abs=0.15)  # pixel centres lie at integers
    assert find(BOARD, np.full_like(picture, 128), thorough=False) is None
    assert boards.other_size(parse("checkerboard:9x7:18mm"), picture) == (8, 6)


@pytest.mark.parametrize("spec", ["checkerboard:9x6:25mm", "circles:7x5:30mm", "asymmetric-circles:4x11:20mm"])
def test_the_drawn_board_is_the_board(spec: str) -> None:
    board = parse(spec)
    assert parse(board.spec) == board
    picture = painted(drawing.svg(board), 3.0)
    found = find(board, picture)
    assert found is not None
    grid = found.reshape(board.rows, board.columns, 2)
    step = 2 if "asymmetric" in spec else 1
    assert np.linalg.norm(np.diff(grid, axis=1), axis=2) == pytest.approx(3 * step * board.pitch_mm, abs=0.5)
    assert "print at 100 %: the line is 100 mm long" in drawing.svg(board)


def painted(svg: str, px_a_mm: float) -> Image:
    """What the drawing's rectangles and circles make, 3 px a mm."""
    root = ET.fromstring(svg)
    left, top, width, height = (float(one) for one in root.attrib["viewBox"].split())
    assert root.attrib["width"] == f"{width:g}mm"
    image = np.full((round(height * px_a_mm), round(width * px_a_mm), 3), 255, np.uint8)
    for shape in root:
        a = {
            name: float(value)
            for name, value in shape.attrib.items()
            if name in ["x", "y", "cx", "cy", "r", "width", "height"]
        }
        if shape.tag.endswith("rect") and shape.attrib["fill"] == "#000":
            x, y = round((a["x"] - left) * px_a_mm), round((a["y"] - top) * px_a_mm)
            side = round(a["width"] * px_a_mm)
            image[y : y + side, x : x + side] = 0
        elif shape.tag.endswith("circle"):
            middle = round((a["cx"] - left) * px_a_mm), round((a["cy"] - top) * px_a_mm)
            cv2.circle(image, middle, round(a["r"] * px_a_mm), (0, 0, 0), -1, cv2.LINE_AA)
    return image
