"""The stages composed: a picture and the settings in, a Detection out. Pure: the clock, if any, is handed in."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from gateway.config import VisionConfig
from gateway.core.detection import Detection
from gateway.vision.detect.lens import normalise
from gateway.vision.detect.method import Detector, NowNs
from gateway.vision.detect.paper import stages
from gateway.vision.detect.paper.stages import Contour, Mask
from gateway.vision.detect.stage_timer import StageTimer
from gateway.vision.pixels import Image, check_bgr8

Seen = Callable[[str, Any], None]  # called with the name and the result of a stage that has just ended


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
    timer = StageTimer(now_ns)
    found = _run(image, params, timer.ended)
    return replace(found, stage_ns=timer.stage_ns)


def detector(params: VisionConfig, now_ns: NowNs) -> Detector:
    """The plain pipeline as a Detector."""
    return lambda image, t_ns=0: detect(image, params, now_ns)


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
    check_bgr8(image)
    blurred = stages.gaussian(image, params.gaussian_kernel_px, params.gaussian_sigma_px)
    seen("gaussian", blurred)
    hsv = stages.bgr_to_hsv(blurred)
    del blurred  # of a 100-megapixel picture each one takes 300 MB
    seen("hsv", hsv)
    initial = stages.red_mask(hsv, *stages.ranges(params))
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


def conclude(borders: Sequence[Contour], params: VisionConfig, seen: Seen) -> tuple[Contour | None, Detection]:
    """What follows from the contours, equations 8 to 11: the chosen one and its figures."""
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
