"""Which views of a board are worth taking, and which kinds are still missing. Pure.

A view is described by where the board is, how large it is and how it is tilted: three things that fix the camera. A
view that differs from every taken one in none of them adds nothing.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.config import Intrinsics
from gateway.durations import NS_PER_S
from gateway.explained import ExplainedStr
from gateway.vision.offline.calibration.boards import Board, CalibrationBoardKind, Grey, Points, spacing_px
from gateway.vision.offline.calibration.solve import COVERED, GOOD_VIEWS, TILTED_DEG, coverage

SPACING_PX = 8.0  # of neighbouring points: nearer together they are too far away
AREA = 0.03  # the least share of the picture that the board fills
HOLD_S = 0.5  # this long it is held
STILL = 0.004  # share of the diagonal that the points may move meanwhile: 3.2 px of 640 x 480
BLURRED = 0.006  # share of the diagonal over which an edge may extend: 4.8 px of 640 x 480
BLURRED_PX = 4.0  # and in small pictures
BLURRED_SPACING = 0.35  # nor more than this share of the distance of neighbours
APART = 0.1  # share of the diagonal, between the middles of two boards
APART_RATIO = 1.3  # of their sizes
APART_DEG = 12.0  # between their tilts
DISTANCES = 1.5  # ratio of the largest to the smallest size: near and far
_PATCHES = 48  # at which edges are measured


class ViewVerdict(ExplainedStr):
    """Why a view was not taken, or that it was."""

    NOT_FOUND = "not_found", "the board is not in the picture as a whole"
    TOO_FAR = "too_far", "it is too small in the picture"
    MOVING = "moving", "it has not been held still for long enough"
    BLURRED = "blurred", "its edges are blurred"
    SIMILAR = "similar", "a view like this one was taken already"
    TAKEN = "taken", "a view was taken"
    NO_PICTURE = "no_picture", "there is no new picture"
    OTHER_SIZE = "other_size", "the picture's size has changed since the calibration began"
    FULL = "full", "no more views are kept: remove some"


class Missing(ExplainedStr):
    """A kind of view that is still needed."""

    VIEWS = "views", "more views"
    LEFT = "left", "one with the left edge farther away"
    RIGHT = "right", "one with the right edge farther away"
    TOP = "top", "one with the upper edge farther away"
    BOTTOM = "bottom", "one with the lower edge farther away"
    DISTANCE = "distance", "another distance"
    COVERAGE = "coverage", "more of the picture"


@dataclass(frozen=True, slots=True)
class Appearance:
    """How a board appears. Angles in degrees: positive `right_deg`: its right edge is farther away than the left one;
    positive `bottom_deg`: the lower edge."""

    middle: tuple[float, float]  # in diagonals of the picture
    size: float  # square root of the share of the picture that it fills
    right_deg: float
    bottom_deg: float

    @property
    def tilt_deg(self) -> float:
        """Between the board's normal and the optical axis."""
        squared = math.sin(math.radians(self.right_deg)) ** 2 + math.sin(math.radians(self.bottom_deg)) ** 2
        return math.degrees(math.asin(min(1.0, math.sqrt(squared))))


def appearance(board: Board, points: Points, size_px: tuple[int, int], lens: Intrinsics | None = None) -> Appearance:
    """`lens`: None: a focal length as long as the picture is wide, which gives tilts to some degrees."""
    width, height = size_px
    diagonal = math.hypot(width, height)
    middle = points.mean(axis=0)
    area = float(cv2.contourArea(cv2.convexHull(points)))
    if lens is None:
        focal = float(max(size_px))
        lens = Intrinsics(fx=focal, fy=focal, cx=(width - 1) / 2, cy=(height - 1) / 2)
    matrix = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1.0]])
    distortion = np.array(lens.distortion or (0.0,) * 4)
    # Not SOLVEPNP_IPPE: in OpenCV 5.0 it is wrong where the first point is not the board's origin.
    _, turn, shift = cv2.solvePnP(board.points_mm, points, matrix, distortion, flags=cv2.SOLVEPNP_SQPNP)
    rotation, _ = cv2.Rodrigues(turn)
    normal = np.asarray(rotation, np.float64)[:, 2]
    normal = -normal if float(normal @ np.ravel(shift)) > 0 else normal  # the side that the camera sees
    return Appearance(
        (float(middle[0]) / diagonal, float(middle[1]) / diagonal),
        math.sqrt(area / (width * height)),
        math.degrees(math.asin(float(np.clip(normal[0], -1, 1)))),
        math.degrees(math.asin(float(np.clip(normal[1], -1, 1)))),
    )


def apart(a: Appearance, b: Appearance) -> float:
    """1 and more: each of the two tells something that the other one does not."""
    moved = math.dist(a.middle, b.middle) / APART
    scaled = math.log(a.size / b.size) / math.log(APART_RATIO)
    tilted = math.hypot(a.right_deg - b.right_deg, a.bottom_deg - b.bottom_deg) / APART_DEG
    return math.hypot(moved, scaled, tilted)


def edge_px(board: Board, grey: Grey, points: Points) -> float:
    """Over how many pixels an edge at the points extends: about 2 in a sharp picture. The larger of two directions, so
    that a board that moves across one of them is noticed. Noise makes it appear sharper."""
    grid = points.reshape(board.rows, board.columns, 2)
    half = int(np.clip(spacing_px(board, points) / 2, 2, 24))
    widths = []
    axes = np.array([np.diff(grid, axis=axis).mean(axis=(0, 1)) for axis in (1, 0)])
    axes /= np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), 1e-9)
    chosen = points[np.unique(np.linspace(0, len(points) - 1, _PATCHES).astype(int))]
    for u, v in np.rint(chosen).astype(int):
        patch = grey[max(0, v - half) : v + half + 1, max(0, u - half) : u + half + 1].astype(np.float32)
        if min(patch.shape) < 5:
            continue
        low, high = np.percentile(patch, (5, 95))
        across = cv2.Sobel(patch, cv2.CV_32F, 1, 0) / 8, cv2.Sobel(patch, cv2.CV_32F, 0, 1) / 8
        steepest = [max(1e-6, float(np.abs(across[0] * du + across[1] * dv)[1:-1, 1:-1].max())) for du, dv in axes]
        widths.append([float(high - low) / one for one in steepest])
    return float(np.median(np.array(widths), axis=0).max()) if widths else math.inf


def blurred_px(board: Board, points: Points, size_px: tuple[int, int]) -> float:
    """A larger `edge_px` is a blurred view."""
    limits = BLURRED * math.hypot(*size_px), BLURRED_SPACING * spacing_px(board, points)
    return max(BLURRED_PX, min(limits))


def worth(
    board: Board, points: Points, grey: Grey, taken: Sequence[Points], lens: Intrinsics | None = None
) -> ViewVerdict:
    """Of a board that is held still: TAKEN, or why it is not to be. `taken`: the points of the views so far."""
    size_px = grey.shape[1], grey.shape[0]
    seen = appearance(board, points, size_px, lens)
    if spacing_px(board, points) < SPACING_PX or seen.size**2 < AREA:
        return ViewVerdict.TOO_FAR
    if edge_px(board, grey, points) > blurred_px(board, points, size_px):
        return ViewVerdict.BLURRED
    if any(apart(seen, appearance(board, other, size_px, lens)) < 1 for other in taken):
        return ViewVerdict.SIMILAR
    return ViewVerdict.TAKEN


class Stillness:
    """Since when the board has been held. Times are monotonic, ns."""

    def __init__(self) -> None:
        self._points: Points | None = None
        self._since_ns = 0

    def held_s(self, board: Board, points: Points | None, size_px: tuple[int, int], now_ns: int) -> float:
        """How long all points have stayed where they are now, s; 0: they have moved, or were not found."""
        still = self._points is not None and points is not None
        if points is None or not still or _moved(board, self._points, points) > STILL * math.hypot(*size_px):
            self._points, self._since_ns = points, now_ns
            return 0.0
        return (now_ns - self._since_ns) / NS_PER_S


def _moved(board: Board, before: Points | None, now: Points) -> float:
    """The largest distance that a point has moved, px. A finder may number the points from another corner."""
    assert before is not None
    grid = now.reshape(board.rows, board.columns, 2)
    turns = range(4) if board.rows == board.columns and board.kind is not CalibrationBoardKind.ASYMMETRIC else (0, 2)
    orders = [np.rot90(grid, turn).reshape(-1, 2) for turn in turns]
    return min(float(np.hypot(*(order - before).T).max()) for order in orders)


@dataclass(frozen=True, slots=True)
class Progress:
    """What has been seen so far, and which kinds of views are still missing."""

    coverage: NDArray[np.int64]  # as `solve.coverage`
    tilted: dict[Missing, int]  # views with that edge farther away, by TILTED_DEG and more
    distances: float  # ratio of the largest to the smallest size; 1: one distance, or no view
    missing: tuple[Missing, ...]


def progress(board: Board, views: Sequence[Points], size_px: tuple[int, int], lens: Intrinsics | None) -> Progress:
    seen = [appearance(board, points, size_px, lens) for points in views]
    cells = coverage(views, size_px)
    tilted = {
        Missing.LEFT: sum(one.right_deg <= -TILTED_DEG for one in seen),
        Missing.RIGHT: sum(one.right_deg >= TILTED_DEG for one in seen),
        Missing.TOP: sum(one.bottom_deg <= -TILTED_DEG for one in seen),
        Missing.BOTTOM: sum(one.bottom_deg >= TILTED_DEG for one in seen),
    }
    sizes = [one.size for one in seen] or [1.0]
    distances = max(sizes) / min(sizes)
    needed = {
        Missing.VIEWS: len(views) < GOOD_VIEWS,
        **{edge: not count for edge, count in tilted.items()},
        Missing.DISTANCE: distances < DISTANCES,
        Missing.COVERAGE: float((cells > 0).mean()) < COVERED,
    }
    return Progress(cells, tilted, distances, tuple(kind for kind, is_missing in needed.items() if is_missing))
