"""From a pixel to a direction: equation 11, with the lens's distortion taken out. Pure."""

import cv2
import numpy as np

from gateway.config import Intrinsics

_ITERATIONS = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
_LARGEST_RESIDUAL_PX = 1e-3


def normalise(u_px: float, v_px: float, lens: Intrinsics) -> tuple[float, float] | None:
    """Equation 11: x_n = (u - c_x) / f_x, y_n = (v - c_y) / f_y, for a pinhole without distortion.

    With distortion coefficients (OpenCV's order) the undistorted point is found by iteration and checked by projecting
    it back. None where no point within 1e-3 px is found: so far out that the distortion model has no inverse there.
    """
    if not lens.distortion:
        return (u_px - lens.cx) / lens.fx, (v_px - lens.cy) / lens.fy
    matrix = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]], np.float64)
    distortion = np.array(lens.distortion, np.float64)
    pixel = np.array([[[u_px, v_px]]], np.float64)
    point = cv2.undistortPoints(pixel, matrix, distortion, criteria=_ITERATIONS)
    x_n, y_n = (float(value) for value in point.ravel())
    still = np.zeros(3)
    back, _ = cv2.projectPoints(np.array([[[x_n, y_n, 1.0]]]), still, still, matrix, distortion)
    residual_px = float(np.abs(back.ravel() - pixel.ravel()).max())
    return (x_n, y_n) if residual_px <= _LARGEST_RESIDUAL_PX else None  # a NaN fails this too
