"""Boards: what may be written, and finding every point to a fraction of a pixel."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from gateway.errors import ConfigError
from gateway.vision.offline.calibration.boards import Board, CalibrationBoardKind, find, other_size, parse
from tests.unit.vision.board_pictures import POSES, Camera, Pose, shot, truth

CHECKER = parse("checkerboard:8x6:18mm")
SYMMETRIC = parse("circles:8x6:20mm")
ASYMMETRIC = parse("asymmetric-circles:4x9:12mm")


@pytest.mark.parametrize(
    ("text", "board"),
    [
        ("checkerboard:9x6:25mm", Board(CalibrationBoardKind.CHECKERBOARD, 9, 6, 25)),
        (" Circles:7x5:3.5cm ", Board(CalibrationBoardKind.CIRCLES, 7, 5, 35)),
        ("asymmetric-circles:4x11:0.02m", Board(CalibrationBoardKind.ASYMMETRIC, 4, 11, 20)),
        ("checkerboard:9x6:25", Board(CalibrationBoardKind.CHECKERBOARD, 9, 6, 25)),
    ],
)
def test_boards_in_words(text: str, board: Board) -> None:
    assert parse(text) == board


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("9x6", "expected KIND:COLUMNSxROWS:SIZE"),
        ("", "expected KIND:COLUMNSxROWS:SIZE"),
        ("checkerboard:9x6:25inch", "expected KIND:COLUMNSxROWS:SIZE"),
        ("checkerboard:9x-6:25mm", "expected KIND:COLUMNSxROWS:SIZE"),
        ("charuco:9x6:25mm", "there is no board charuco; there is: checkerboard, circles, asymmetric-circles"),
        ("checkerboard:2x6:25mm", "3 to 100 points a side; 2 x 6 were given"),
        ("checkerboard:9x101:25mm", "3 to 100 points a side"),
        ("checkerboard:9x6:0mm", "the size must be 0.1 mm to 10 m"),
        ("checkerboard:9x6:11m", "the size must be 0.1 mm to 10 m"),
    ],
)
def test_boards_that_must_be_edited(text: str, says: str) -> None:
    with pytest.raises(ConfigError) as error:
        parse(text)
    assert says in str(error.value)


def test_where_the_points_are() -> None:
    even = Board(CalibrationBoardKind.CIRCLES, 3, 3, 10).points_mm.tolist()
    assert even[:5] == [[0, 0, 0], [10, 0, 0], [20, 0, 0], [0, 10, 0], [10, 10, 0]]
    shifted = Board(CalibrationBoardKind.ASYMMETRIC, 3, 3, 10).points_mm.tolist()
    assert shifted[:4] == [[0, 0, 0], [20, 0, 0], [40, 0, 0], [10, 10, 0]]
    assert shifted[-1] == [40, 20, 0]


@pytest.mark.one_interpreter
@pytest.mark.parametrize(("board", "rms_px"), [(CHECKER, 0.06), (SYMMETRIC, 0.05), (ASYMMETRIC, 0.08)], ids=str)
def test_every_point_is_found_where_it_is(board: Board, rms_px: float) -> None:
    for pose in (POSES[1], POSES[7]):
        points = find(board, shot(board, pose))
        assert points is not None
        assert points.shape == (board.columns * board.rows, 2)
        true = truth(board, pose)
        away = np.hypot(*(points[:, None] - true[None]).transpose(2, 0, 1))
        assert sorted(away.argmin(axis=1)) == list(range(len(points))), "each point once"
        assert np.sqrt((away.min(axis=1) ** 2).mean()) < rms_px


def test_light_circles_on_dark_are_found_too() -> None:
    picture = shot(SYMMETRIC, POSES[1])
    assert find(SYMMETRIC, np.asarray(255 - picture, np.uint8)) is not None


@pytest.mark.one_interpreter
def test_circles_larger_than_the_built_in_limit() -> None:
    board = parse("circles:4x3:100mm")
    camera = Camera(width=960, height=720, fx=1000, fy=1000, cx=480, cy=360, distortion=(0.0, 0.0, 0.0, 0.0))
    picture = shot(board, Pose(0, 0, 500, (0, 0, 0)), camera)  # radius 60 px: 11,000 px^2
    points = find(board, picture)
    assert points is not None
    assert np.ptp(points[:, 0]) == pytest.approx(3 * 200, abs=0.3)


def test_a_board_without_a_light_rim_is_found_by_the_older_finder(monkeypatch: pytest.MonkeyPatch) -> None:
    picture = shot(CHECKER, POSES[1])
    with_newer = find(CHECKER, picture)

    def finds_nothing(*_: object, **__: object) -> tuple[bool, None]:
        return False, None

    monkeypatch.setattr(cv2, "findChessboardCornersSB", finds_nothing)
    with_older = find(CHECKER, picture)
    assert with_newer is not None
    assert with_older is not None
    away = np.hypot(*(with_older[:, None] - with_newer[None]).transpose(2, 0, 1)).min(axis=1)
    assert away.max() < 0.02, "both are refined in the same way"


def grey() -> NDArray[np.uint8]:
    return np.full((200, 300, 3), 128, np.uint8)


@pytest.mark.long
@pytest.mark.one_interpreter
def test_no_board_and_the_wrong_size() -> None:
    for board in (CHECKER, SYMMETRIC, ASYMMETRIC):
        assert find(board, grey()) is None
    picture = shot(CHECKER, POSES[1])
    wrong = parse("checkerboard:9x7:18mm")  # squares counted instead of corners
    assert find(wrong, picture) is None
    found = other_size(wrong, picture)
    assert found == (8, 6)
    assert other_size(parse("checkerboard:7x9:18mm"), picture) == (6, 8)
    assert other_size(CHECKER, picture) is None, "that is the one asked for"
    assert other_size(wrong, grey()) is None
    assert other_size(SYMMETRIC, picture) is None
