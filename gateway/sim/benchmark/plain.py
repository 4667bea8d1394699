"""Detectors as `gateway benchmark` takes them from anybody: `find(image) -> (u, v, R)` in px, or None.

`hough_circles` is the usual textbook answer to a red disc, for comparison.
"""

import math
from collections.abc import Callable
from importlib import import_module
from typing import Any

import cv2
import numpy as np

from gateway.core.detection import Circle, Detection
from gateway.errors import ConfigError
from gateway.vision.detect.method import Detector
from gateway.vision.pixels import Image

RED = 40.0  # mean redness inside, of 255
Find = Callable[[Image], tuple[float, float, float] | None]


def hough_circles(image: Image) -> tuple[float, float, float] | None:
    """OpenCV's HoughCircles on redness; of the circles found, the largest that is red inside."""
    blue, green, red = (channel.astype(np.int16) for channel in cv2.split(image))
    redness = np.clip(2 * (red - np.maximum(blue, green)), 0, 255).astype(np.uint8)
    soft = cv2.medianBlur(redness, 5)
    height, width = redness.shape
    circles = cv2.HoughCircles(
        soft,
        cv2.HOUGH_GRADIENT_ALT,
        dp=1.5,
        minDist=20,
        param1=300,
        param2=0.8,
        minRadius=max(4, width // 80),
        maxRadius=min(width, height) // 2,
    )
    if circles is None:
        return None
    red_ones = [circle for circle in circles.reshape(-1, circles.shape[-1]) if _inside(redness, circle) > RED]
    if not red_ones:
        return None
    u, v, radius = (float(value) for value in max(red_ones, key=lambda circle: float(circle[2]))[:3])
    return u, v, radius


def _inside(redness: Image, circle: np.ndarray) -> float:
    mask = np.zeros(redness.shape, np.uint8)
    cv2.circle(mask, (round(float(circle[0])), round(float(circle[1]))), round(0.8 * float(circle[2])), 255, -1)
    return cv2.mean(redness, mask)[0]


def detector(find: Find, name: str) -> Detector:
    """Its answers. The detector raises ConfigError for whatever `find` raises, and for an answer that is no circle."""

    def detect(image: Image, t_ns: int = 0) -> Detection:
        try:
            found = find(image)
            return Detection(None if found is None else _circle(found))
        except (Exception, SystemExit) as error:  # it is anybody's code
            raise ConfigError(f"--method {name}: {_one_line(error)}") from error

    return detect


def _circle(found: Any) -> Circle:
    try:
        u, v, radius = (math.nan,) * 3 if isinstance(found, str | bytes) else (float(value) for value in found)
    except (TypeError, ValueError, OverflowError):
        u = v = radius = math.nan
    if not (radius > 0 and math.isfinite(u) and math.isfinite(v) and math.isfinite(radius)):
        raise ValueError(f"answered {found!r:.80}; expected: (u, v, R) in px, or None")
    return Circle(u, v, radius)


def _one_line(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())


def named(place: str) -> Find:
    """The function of `module:function`. Raises ConfigError."""
    module, _, name = place.partition(":")
    try:
        found = getattr(import_module(module), name)
    except (Exception, SystemExit) as error:
        raise ConfigError(f"--method {place}: {_one_line(error)}") from error
    return found  # type: ignore[no-any-return]
