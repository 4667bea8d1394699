"""A click on the picture: which colours are there, and the red ranges that would admit them. Pure.

Colours are those that the thresholds see: after the Gaussian, on OpenCV's HSV scale. Hue is signed about red, so that
Table I's two ranges are one: 0 is red, positive towards orange, negative towards violet.
"""

from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.config import VisionConfig
from gateway.vision.detect.paper import stages
from gateway.vision.detect.paper.stages import Corner, Mask
from gateway.vision.offline.tuning.thresholds import MOST_HUE
from gateway.vision.pixels import Image
from gateway.web.tuning.response_models import ColourPickView, PatchView

MARGIN = (4, 30, 30)  # H, S, V: the light changes
MANY = 0.2  # of the picture: more is not a marker
ELSEWHERE = 0.5  # of what hangs together with the click: more red elsewhere is a rival
PALE, DARK = 43, 30  # S and V below which the hue is noise
CLOSED = 180  # a hue that never occurs: a range that begins there admits nothing

Mode = Literal["replace", "widen"]


def pick(
    image: Image, u_px: float, v_px: float, size_px: int, params: VisionConfig, mode: Mode = "replace"
) -> ColourPickView:
    """A square of side `size_px` round (u, v), as far as it is in the picture.

    "replace": ranges for this patch only; "widen": the present ranges, widened as far as needed. Raises ValueError for
    a click beside the picture.
    """
    hsv = stages.bgr_to_hsv(stages.gaussian(image, params.gaussian_kernel_px, params.gaussian_sigma_px))
    near = window(image, u_px, v_px, size_px)
    patch = _patch(hsv[near].reshape(-1, 3))
    keys = _widened(params, patch) if mode == "widen" else _ranges(patch)
    mask = stages.red_mask(hsv, (keys["red_low_1"], keys["red_high_1"]), (keys["red_low_2"], keys["red_high_2"]))
    admitted = int(np.count_nonzero(mask))
    hanging = _hanging(mask, near)
    return ColourPickView(
        patch=patch,
        keys=keys,
        admitted_px=admitted,
        admitted_share=admitted / mask.size,
        hanging_px=hanging,
        warnings=_warnings(patch, admitted, mask.size, hanging),
    )


def window(image: Image, u_px: float, v_px: float, size_px: int) -> tuple[slice, slice]:
    height, width = image.shape[:2]
    u, v = round(u_px), round(v_px)
    if not (0 <= u < width and 0 <= v < height):
        raise ValueError(f"({u}, {v}) lies beside the picture of {width} x {height} px")
    half = (max(1, size_px) - 1) // 2
    return slice(max(0, v - half), v + half + 1), slice(max(0, u - half), u + half + 1)


def _patch(colours: NDArray[np.uint8]) -> PatchView:
    """The hue's middle is that of its direction, so that 179 and 1 meet at 0 and not at 90."""
    h, s, v = colours.astype(np.int16).T
    turn = np.exp(2j * np.pi * h / 180).mean()
    middle = round(float(np.angle(turn)) / np.pi * 90)
    off = (h - middle + 90) % 180 - 90
    low, high = (np.percentile(np.stack([off, s, v]), share, axis=1) for share in (5, 95))
    signed = _signed(middle + round(float(np.median(off))))
    return PatchView(
        h=signed,
        hue=signed % 180,
        s=round(float(np.median(s))),
        v=round(float(np.median(v))),
        low=(middle + int(np.floor(low[0])), int(low[1]), int(low[2])),
        high=(middle + int(np.ceil(high[0])), int(np.ceil(high[1])), int(np.ceil(high[2]))),
        pixels=len(colours),
    )


def _signed(hue: int) -> int:
    return (hue + 90) % 180 - 90


def _ranges(patch: PatchView) -> dict[str, Corner]:
    """Hues below red go into the second range, those from red on into the first; S and V have no upper limit."""
    lo, hi = max(-90, patch.low[0] - MARGIN[0]), min(90, patch.high[0] + MARGIN[0])
    s, v = (max(0, patch.low[n] - MARGIN[n]) for n in (1, 2))
    first = (max(lo, 0), hi) if hi >= 0 else (CLOSED, CLOSED)
    second = (180 + lo, min(180, 180 + hi)) if lo < 0 else (CLOSED, CLOSED)
    return {
        "red_low_1": (first[0], s, v),
        "red_high_1": (first[1], 255, 255),
        "red_low_2": (second[0], s, v),
        "red_high_2": (second[1], 255, 255),
    }


def _widened(params: VisionConfig, patch: PatchView) -> dict[str, Corner]:
    """Each present range and the patch's part of it in one box; a closed one adds nothing."""
    fresh = _ranges(patch)
    present: dict[str, Corner] = {key: getattr(params, key) for key in fresh}
    keys: dict[str, Corner] = {}
    for low, high in (("red_low_1", "red_high_1"), ("red_low_2", "red_high_2")):
        boxes = [(side[low], side[high]) for side in (present, fresh) if side[low][0] != CLOSED]
        lows, highs = zip(*(boxes or [(present[low], present[high])]), strict=True)
        keys[low] = (min(c[0] for c in lows), min(c[1] for c in lows), min(c[2] for c in lows))
        keys[high] = (max(c[0] for c in highs), max(c[1] for c in highs), max(c[2] for c in highs))
    return keys


def _hanging(mask: Mask, near: tuple[slice, slice]) -> int:
    """Pixels of the connected parts of the mask that have a pixel in the patch."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
    touched = np.unique(np.asarray(labels)[near])
    return int(np.asarray(stats)[touched[touched > 0], cv2.CC_STAT_AREA].sum())


def _warnings(patch: PatchView, admitted: int, picture: int, hanging: int) -> list[str]:
    warnings = []
    if patch.s < PALE:
        warnings.append(f"nearly grey (S {patch.s}): its hue is noise; choose a clearer spot")
    elif patch.v < DARK:
        warnings.append(f"nearly black (V {patch.v}): its hue is noise; choose a clearer spot")
    elif abs(patch.h) > MOST_HUE:
        warnings.append(f"not red: H {patch.hue} lies {abs(patch.h)} from red")
    spread = patch.high[0] - patch.low[0]
    if spread > 2 * MOST_HUE:
        warnings.append(f"many colours: hues over {spread} of 180; choose a smaller patch, or one within the marker")
    if admitted > MANY * picture:
        warnings.append(f"too broad: would admit {100 * admitted / picture:.0f} % of the picture")
    elif hanging and admitted - hanging > ELSEWHERE * hanging:
        warnings.append(
            f"would admit as much elsewhere: {admitted - hanging} px, against {hanging} px that are connected here"
        )
    return warnings
