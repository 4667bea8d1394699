"""The stages composed: a picture and the settings in, a Detection out. Pure: the clock, if any, is handed in."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Protocol, runtime_checkable

import numpy as np

from gateway.config import VisionConfig
from gateway.core.model import Detection
from gateway.vision.detect.lens import normalise
from gateway.vision.detect.paper import stages
from gateway.vision.detect.paper.stages import Contour, Mask
from gateway.vision.detect.radii import MarkerRadii
from gateway.vision.pixels import Image

NowNs = Callable[[], int]


class Detector(Protocol):
    """A method, ready to be called picture by picture, in order: it may keep state between them."""

    def __call__(self, image: Image, t_ns: int = 0) -> Detection:
        """`t_ns`: when the picture was taken, monotonic; a method that follows the marker's motion needs it."""
        ...


@runtime_checkable
class Sized(Protocol):
    """A Detector that may be told how large the marker can be."""

    def expect(self, radii: MarkerRadii) -> None:
        """From the next picture on."""
        ...


Seen = Callable[[str, Any], None]  # called with the name and the result of a stage that has just ended

STAGES = (
    ("gaussian", "1", "Gaussian blur"),
    ("hsv", "2, 3", "BGR to HSV"),
    ("threshold", "4", "the two red ranges"),
    ("opening", "5-7", "erosion, then dilation"),
    ("closing", "5-7", "dilation, then erosion"),
    ("contours", "", "outer borders of the connected components"),
    ("select", "8, 9", "the largest that is valid"),
    ("circle", "10", "minimum enclosing circle"),
    ("normalise", "11", "from the centre to a direction, where intrinsics are given"),
)
"""Name in `stage_ns`, equations of the paper, meaning; in order."""


@dataclass(frozen=True, slots=True)
class Trace:
    """Everything on the way from a picture to its detection; the figures of the paper are drawn from it."""

    image: Image
    blurred: Image  # after equation 1
    hsv: Image  # H 0-179, S and V 0-255
    initial: Mask  # M_0
    opened: Mask
    cleaned: Mask  # M_c
    contours: tuple[Contour, ...]
    chosen: Contour | None  # C*
    detection: Detection


def detect(image: Image, params: VisionConfig, now_ns: NowNs = lambda: 0) -> Detection:
    """The paper's method on one (H, W, 3) uint8 BGR picture. `now_ns` gives the times of `stage_ns`; without it, 0.

    Raises ValueError for anything but such a picture with at least one pixel.
    """
    stamps = [("", now_ns())]
    found = _run(image, params, lambda stage, _: stamps.append((stage, now_ns())))
    stage_ns = tuple((stage, end_ns - start_ns) for (_, start_ns), (stage, end_ns) in pairwise(stamps))
    return replace(found, stage_ns=stage_ns)


def trace(image: Image, params: VisionConfig) -> Trace:
    """The same as `detect`, and everything in between. Takes some 12 bytes of memory a pixel, `detect` at most 9."""
    seen: dict[str, Any] = {}
    found = _run(image, params, seen.__setitem__)
    return Trace(
        image=image,
        blurred=seen["gaussian"],
        hsv=seen["hsv"],
        initial=seen["threshold"],
        opened=seen["opening"],
        cleaned=seen["closing"],
        contours=seen["contours"],
        chosen=seen["select"],
        detection=found,
    )


def _run(image: Image, params: VisionConfig, seen: Seen) -> Detection:
    """The one composition of the stages; `seen` is called after each, whether or not there was anything to do."""
    check(image)
    blurred = stages.gaussian(image, params.gaussian_kernel_px, params.gaussian_sigma_px)
    seen("gaussian", blurred)
    hsv = stages.bgr_to_hsv(blurred)
    del blurred  # of a 100-megapixel picture each one takes 300 MB
    seen("hsv", hsv)
    initial = stages.red_mask(hsv, (params.red_low_1, params.red_high_1), (params.red_low_2, params.red_high_2))
    del hsv
    seen("threshold", initial)
    opened = stages.opening(initial, params.morph_kernel_px, params.morph_iterations)
    seen("opening", opened)
    cleaned = stages.closing(opened, params.morph_kernel_px, params.morph_iterations)
    seen("closing", cleaned)
    borders = stages.contours(cleaned)
    seen("contours", borders)
    _, detection = conclude(borders, params, seen)
    return detection


def check(image: Image) -> None:
    """Raises ValueError for anything but a (H, W, 3) uint8 picture with at least one pixel."""
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise ValueError(f"not a (H, W, 3) uint8 picture: {image.shape} {image.dtype}")


def conclude(borders: Sequence[Contour], params: VisionConfig, seen: Seen) -> tuple[Contour | None, Detection]:
    """What follows from the contours, equations 8 to 11: the chosen one, and what is told of it."""
    chosen, candidates = stages.largest_valid(borders, params.min_area_px2, params.min_circularity, params.min_fill)
    seen("select", chosen)
    circle = None if chosen is None else stages.enclosing_circle(chosen)
    seen("circle", circle)
    point = normalise(circle.u_px, circle.v_px, params.intrinsics) if circle and params.intrinsics else None
    seen("normalise", point)
    if chosen is None or circle is None:
        return None, Detection(circle=None, candidates=candidates)
    x_n, y_n = point or (None, None)
    return chosen, Detection(
        circle=circle,
        area_px2=stages.contour_area(chosen),
        circularity=stages.circularity(chosen),
        fill=stages.fill(chosen, circle),
        candidates=candidates,
        x_n=x_n,
        y_n=y_n,
    )
