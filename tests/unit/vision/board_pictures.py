"""Pictures of calibration boards through a known camera with distortion: the truth of the calibration's tests.

The middle of each pixel is traced back: undistorted, met with the board's plane, and given the board's shade there;
edges are ramps as wide as a pixel, so that they are grey as in a camera.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.vision.offline.calibration.boards import Board, CalibrationBoardKind

LIGHT, DARK, WALL = 225.0, 30.0, 120.0


@dataclass(frozen=True)
class Camera:
    width: int = 480
    height: int = 360
    fx: float = 520.0
    fy: float = 516.0
    cx: float = 246.0
    cy: float = 172.0
    distortion: tuple[float, ...] = (-0.24, 0.09, 0.0008, -0.0006)

    @property
    def matrix(self) -> NDArray[np.float64]:
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])


@dataclass(frozen=True)
class Pose:
    """Where the board's middle is, and how the board is turned; degrees about x, y and z."""

    x_mm: float
    y_mm: float
    z_mm: float
    turn_deg: tuple[float, float, float]


POSES = tuple(
    Pose(x, y, z, (a, b, c))
    for x, y, z, a, b, c in (
        (0, 0, 420, 0, 0, 0), (-55, -35, 440, 25, 0, 4), (60, 40, 430, -28, 5, -6), (-60, 45, 450, 0, 30, 3),
        (65, -45, 450, 4, -30, 0), (0, 0, 520, 35, 20, 10), (-70, 0, 480, -20, -25, -8), (40, 50, 460, 18, 28, 20),
        (-40, -50, 470, -30, 18, -15), (0, -45, 500, 38, -5, 2), (75, 10, 490, -10, 35, 5), (-10, 40, 380, 12, -15, -3),
    )
)  # fmt: skip
FRONTAL = tuple(Pose(x, y, z, turn) for x, y, z, turn in (
    (0, 0, 420, (8, 0, 0)), (40, 20, 500, (-8, 0, 5)), (-40, 0, 460, (0, 8, -5)), (10, -30, 560, (0, -8, 9))
))  # fmt: skip


def shot(
    board: Board, pose: Pose, camera: Camera | None = None, *, noise: float = 1.5, seed: int = 0
) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 BGR."""
    camera = camera or Camera()
    rotation, _ = cv2.Rodrigues(np.radians(np.array(pose.turn_deg, np.float64)))
    middle = board.points_mm.mean(axis=0).astype(np.float64)
    start = -(rotation.T @ np.array([pose.x_mm, pose.y_mm, pose.z_mm]))
    turned = _rays(camera) @ rotation  # in the board's axes
    place = start + turned * (-start[2] / turned[:, 2:])
    pixel_mm = pose.z_mm / camera.fx
    seen = shade(board, place[:, 0] + middle[0], place[:, 1] + middle[1], pixel_mm)
    blurred = cv2.GaussianBlur(seen.reshape(camera.height, camera.width), (0, 0), 0.6)
    noisy = blurred + np.random.default_rng(seed).normal(0, noise, blurred.shape)
    grey = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), np.uint8)


@lru_cache(maxsize=4)
def _rays(camera: Camera) -> NDArray[np.float64]:
    """(n, 3): direction (x, y, 1) of every pixel."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float64)
    end = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 1e-10)
    pixels = np.stack((u, v), axis=-1).reshape(-1, 1, 2)
    flat = cv2.undistortPoints(pixels, camera.matrix, np.array(camera.distortion), criteria=end).reshape(-1, 2)
    return np.asarray(np.column_stack((flat, np.ones(len(flat)))), np.float64)


def shade(board: Board, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64], soft_mm: float) -> NDArray[np.float64]:
    """The board's grey level at places of its plane; edges are ramps of width soft_mm, so that none is quantised."""
    pitch = board.pitch_mm
    points = board.points_mm[:, :2].astype(np.float64)
    low, high = points.min(axis=0) - 2 * pitch, points.max(axis=0) + 2 * pitch
    paper = (x_mm > low[0]) & (x_mm < high[0]) & (y_mm > low[1]) & (y_mm < high[1])
    if board.kind is CalibrationBoardKind.CHECKERBOARD:
        squares = (x_mm > -pitch) & (x_mm < board.columns * pitch) & (y_mm > -pitch) & (y_mm < board.rows * pitch)
        dark = (1 + _wave(x_mm / pitch, soft_mm / pitch) * _wave(y_mm / pitch, soft_mm / pitch)) / 2 * squares
    else:
        row = np.clip(np.rint(y_mm / pitch), 0, board.rows - 1)
        step, shift = (2, row % 2) if board.kind is CalibrationBoardKind.ASYMMETRIC else (1, 0 * row)
        column = np.clip(np.rint((x_mm / pitch - shift) / step), 0, board.columns - 1)
        radius = (0.55 if board.kind is CalibrationBoardKind.ASYMMETRIC else 0.3) * pitch
        near = np.hypot(x_mm - (step * column + shift) * pitch, y_mm - row * pitch)
        dark = np.clip((radius - near) / soft_mm + 0.5, 0, 1)
    return np.where(paper, dark * DARK + (1 - dark) * LIGHT, WALL)


def _wave(x: NDArray[np.float64], soft: float) -> NDArray[np.float64]:
    """A square wave of +-1 that changes sign at every integer, by a ramp."""
    edge = np.rint(x)
    sign = np.where(edge % 2 == 0, 1.0, -1.0)
    return np.asarray(sign * np.clip((x - edge) / (soft / 2), -1, 1))


def truth(board: Board, pose: Pose, camera: Camera | None = None) -> NDArray[np.float64]:
    """(n, 2), px: where the board's points are in the picture."""
    camera = camera or Camera()
    turn = np.radians(np.array(pose.turn_deg, np.float64))
    rotation, _ = cv2.Rodrigues(turn)
    points = board.points_mm.astype(np.float64)
    shift = np.array([[pose.x_mm], [pose.y_mm], [pose.z_mm]]) - rotation @ points.mean(axis=0).reshape(3, 1)
    projected, _ = cv2.projectPoints(points, turn, shift, camera.matrix, np.array(camera.distortion))
    return np.asarray(projected, np.float64).reshape(-1, 2)
