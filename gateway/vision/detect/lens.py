"""From a pixel to a direction: equation 11, with the lens's distortion taken out. Pure."""

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.config import Intrinsics

Floats = NDArray[np.float64]

_ITERATIONS = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
_LARGEST_RESIDUAL_PX = 1e-3


def camera_matrix(lens: Intrinsics) -> Floats:
    return np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]], np.float64)


def project(points: Floats, lens: Intrinsics) -> Floats:
    """(n, 3) in camera axes to (n, 2) px."""
    still = np.zeros(3)
    distortion = np.array(lens.distortion or (0.0,) * 4, np.float64)
    pixels = cv2.projectPoints(points[:, np.newaxis], still, still, camera_matrix(lens), distortion)[0]
    return np.asarray(pixels, np.float64).reshape(-1, 2)


def undistorted(pixels: Floats, lens: Intrinsics) -> Floats | None:
    """(n, 2) px to (n, 2) directions x / z and y / z, found by iteration and checked by projecting them back.

    None where one of them is not within 1e-3 px: so far out that the distortion model has no inverse there. Beyond its
    range the inverse returns points that are merely wrong.
    """
    distortion = np.array(lens.distortion, np.float64)
    found = cv2.undistortPoints(pixels[:, np.newaxis], camera_matrix(lens), distortion, criteria=_ITERATIONS)
    straight = np.asarray(found, np.float64).reshape(-1, 2)
    back = project(np.column_stack([straight, np.ones(len(straight))]), lens)
    return straight if bool((np.abs(back - pixels) <= _LARGEST_RESIDUAL_PX).all()) else None  # a NaN fails this, too


def normalise(u_px: float, v_px: float, lens: Intrinsics) -> tuple[float, float] | None:
    """Equation 11: x_n = (u - c_x) / f_x, y_n = (v - c_y) / f_y, for a pinhole without distortion.

    With distortion coefficients (OpenCV's order) the undistorted point; None where there is none.
    """
    if not lens.distortion:
        return (u_px - lens.cx) / lens.fx, (v_px - lens.cy) / lens.fy
    found = undistorted(np.array([[u_px, v_px]], np.float64), lens)
    return None if found is None else (float(found[0, 0]), float(found[0, 1]))
