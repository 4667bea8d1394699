"""The paper's detection stages, equations 1 to 10: each one a pure function that can be examined by itself.

Pictures are (H, W, 3) uint8, BGR; masks are (H, W) uint8 with 255 for the paper's 1 and 0 for its 0; contours are
(m, 1, 2) int32, (x, y) px of border pixels, closed (the last point joins the first). Pixel centres lie at integers.
Nothing is changed in place. Equation 11 is in `lens`.
"""

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.config import VisionConfig
from gateway.core.detection import Circle
from gateway.vision.pixels import Image

Mask = NDArray[np.uint8]
Contour = NDArray[np.int32]
Corner = tuple[int, int, int]

OMEGA_1: tuple[Corner, Corner] = ((0, 43, 46), (10, 255, 255))  # Table I, both corners included
OMEGA_2: tuple[Corner, Corner] = ((156, 43, 46), (180, 255, 255))


def gaussian(image: Image, kernel_px: int = 5, sigma_px: float = 0.0) -> Image:
    """Equation 1: I_g = G * I, with a kernel_px x kernel_px kernel, each channel separately. Returns (H, W, 3) uint8.

    The paper gives the kernel's side but no sigma. sigma_px = 0 does what OpenCV does: the binomial kernel
    (1 4 6 4 1)^2 / 256 for side 5, rounded half up. The border is mirrored without repeating the edge pixel.
    """
    # The exact variant by name: the default may be a faster approximation in another build of OpenCV.
    blurred = cv2.GaussianBlur(image, (kernel_px, kernel_px), sigma_px, hint=cv2.ALGO_HINT_ACCURATE)
    return _u8(blurred)


def bgr_to_hsv(image: Image) -> Image:
    """Equations 2 and 3 on OpenCV's 8-bit scale: H = hue / 2 in 0..179, S and V in 0..255. Returns (H, W, 3) uint8.

    A full turn of 360 degrees is 180, which is 0 again: the H = 180 of Table I is an inclusive upper bound of which 180
    itself never occurs. Grey (delta = 0), which equation 3 leaves open, has H = 0. OpenCV computes in fixed point: over
    all 2^24 colours H is within 0.65 and S within 0.53 of the equations before rounding, V is exact.
    """
    return _u8(cv2.cvtColor(image, cv2.COLOR_BGR2HSV))


def ranges(params: VisionConfig) -> tuple[tuple[Corner, Corner], tuple[Corner, Corner]]:
    """The two of the settings, for `red_mask`."""
    return (params.red_low_1, params.red_high_1), (params.red_low_2, params.red_high_2)


def red_mask(hsv: Image, omega_1: tuple[Corner, Corner] = OMEGA_1, omega_2: tuple[Corner, Corner] = OMEGA_2) -> Mask:
    """Equation 4: M_0 = 255 where (H, S, V) lies in omega_1 or omega_2, corners included, else 0; (H, W) uint8."""
    return _u8(cv2.bitwise_or(cv2.inRange(hsv, *omega_1), cv2.inRange(hsv, *omega_2)))


def red(image: Image, params: VisionConfig) -> Mask:
    """Equations 2 to 4 of a blurred picture by its settings."""
    return red_mask(bgr_to_hsv(image), *ranges(params))


# The paper prints equation 5 (erosion) as the formula of closing, and equation 7 (opening) with its erosion sign lost.
# These are the standard definitions that its text describes:
#   erosion   A - B = {z | B_z lies in A}      dilation  A + B = {z | (B reflected)_z meets A}
#   opening   A o B = (A - B) + B              closing   A . B = (A + B) - B
# "Two iterations" (Table I) means erode, erode, dilate, dilate for opening: opening twice would change nothing, it is
# idempotent. Pixels outside the picture take no part: they neither erode nor dilate.


def erode(mask: Mask, kernel_px: int = 3, iterations: int = 2) -> Mask:
    """Equation 5: a pixel stays if the complete square of side kernel_px round it is set; `iterations` times."""
    return _u8(cv2.erode(mask, _square(kernel_px), iterations=iterations)) if iterations else mask


def dilate(mask: Mask, kernel_px: int = 3, iterations: int = 2) -> Mask:
    """Equation 6: a pixel is set if any of the square of side kernel_px round it is set; `iterations` times."""
    return _u8(cv2.dilate(mask, _square(kernel_px), iterations=iterations)) if iterations else mask


def opening(mask: Mask, kernel_px: int = 3, iterations: int = 2) -> Mask:
    """Equation 7: erosion, then dilation. Removes isolated noise and small burrs."""
    return dilate(erode(mask, kernel_px, iterations), kernel_px, iterations)


def closing(mask: Mask, kernel_px: int = 3, iterations: int = 2) -> Mask:
    """Equation 7: dilation, then erosion. Fills small holes and gaps of the edge. After opening it gives M_c."""
    return erode(dilate(mask, kernel_px, iterations), kernel_px, iterations)


def contours(mask: Mask) -> tuple[Contour, ...]:
    """The outer border of every 8-connected component (holes are ignored), each pixel of it, in OpenCV's order.

    That order is by the border's first pixel, the lowest row first and in a row the rightmost first.
    """
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return tuple(contour.astype(np.int32, copy=False) for contour in found)


def contour_area(contour: Contour) -> float:
    """Equation 8: S = |sum of x_k y_k+1 - x_k+1 y_k| / 2, px^2; exact. A point or a line has 0.

    The polygon runs through the centres of the border pixels, so S is less than the number of pixels.
    """
    return float(cv2.contourArea(contour))


def circularity(contour: Contour) -> float:
    """4 pi S / perimeter^2: at most 1, 0 for a point or a line (where the perimeter may be 0 too).

    The border has steps of 1 and sqrt 2, some 5 % longer than the true rim: a perfect disc has about 0.90.
    """
    perimeter_px = cv2.arcLength(contour, closed=True)
    return 4 * math.pi * contour_area(contour) / perimeter_px**2 if perimeter_px else 0.0


def fill(contour: Contour, circle: Circle) -> float:
    """S over the area of its enclosing circle: near 1 for a disc, 0.64 for a square, 0 for a point or a line."""
    area_px2 = contour_area(contour)
    return area_px2 / (math.pi * circle.radius_px**2) if area_px2 else 0.0


def largest_valid(
    found: Sequence[Contour], min_area_px2: float, min_circularity: float = 0.0, min_fill: float = 0.0
) -> tuple[Contour | None, int]:
    """Equation 9: the contour of largest S among those with S > min_area_px2 that are round enough.

    The abstract's geometric constraint is `circularity >= min_circularity` and `fill >= min_fill`; 0 leaves it out,
    which is the plain paper. Of equal areas the first in `found` wins: see `contours` for which that is.
    Returns the contour, None where there is none, and the number of contours with S > S_min.
    """
    sized = [(area, contour) for contour in found if (area := contour_area(contour)) > min_area_px2]
    sized.sort(key=lambda pair: -pair[0])  # stable: equal areas keep their order
    for _, contour in sized:
        if min_circularity and circularity(contour) < min_circularity:
            continue
        if not min_fill or fill(contour, enclosing_circle(contour)) >= min_fill:
            return contour, len(sized)
    return None, len(sized)


def enclosing_circle(contour: Contour) -> Circle:
    """Equation 10: the smallest circle round the centres of all border pixels.

    OpenCV computes in single precision and adds 1e-4 px to R: within 2e-3 px for coordinates up to 10,000.
    """
    (u_px, v_px), radius_px = cv2.minEnclosingCircle(contour)
    return Circle(float(u_px), float(v_px), float(radius_px))


def _square(kernel_px: int) -> NDArray[np.uint8]:
    return np.ones((kernel_px, kernel_px), np.uint8)


def _u8(picture: object) -> NDArray[np.uint8]:
    """OpenCV's stubs promise any number type; these calls return what they are given."""
    return np.asarray(picture, np.uint8)
