"""The paper's method on the tuning page: the panels of Figure 3, and remarks on tried settings. Pure."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.config import VisionConfig
from gateway.core.detection import Circle, Detection
from gateway.vision.detect.method import Panel, Remark
from gateway.vision.detect.paper import pipeline, stages
from gateway.vision.detect.paper.exact.geometry import Opening
from gateway.vision.detect.paper.pipeline import Trace
from gateway.vision.detect.paper.stages import Corner
from gateway.vision.offline.tuning import thresholds
from gateway.vision.offline.tuning.samples import HsvColours, disc, example
from gateway.vision.offline.tuning.thresholds import Red
from gateway.vision.pixels import Image
from gateway.vision.view.drawing import scaled
from gateway.vision.view.overlay import annotated

MASK_SHARE = 0.25  # of the picture
LOST_SHARE, LEFT_SHARE = 0.2, 0.05  # of the marker's red, by the opening


def panels(image: Image, params: VisionConfig, found: Detection, scale: float) -> tuple[Panel, ...]:
    trace = pipeline.trace(image, params)
    red, left = (int(np.count_nonzero(mask)) for mask in (trace.initial, trace.cleaned))
    percent = 100 * red / (image.shape[0] * image.shape[1])
    ranges = f"the two red ranges: {red} px, {percent:.1f} %"
    cleaned = f"opening, then closing: {left} px"
    fit = annotated(scaled(image, scale), trace.detection, scale)
    return (
        Panel("hsv", "HSV", "hue, saturation, value shown as blue, green, red", scaled(trace.hsv, scale)),
        Panel("mask", "Mask", ranges, scaled(trace.initial, scale), lossless=True),
        Panel("clean", "Cleaned mask", cleaned, scaled(trace.cleaned, scale), lossless=True),
        Panel("fit", "Fit", _chosen(trace.detection), fit),
    )


def _chosen(found: Detection) -> str:
    if found.circle is None:
        return f"no marker; contours above S_min: {found.candidates}"
    return f"the largest valid contour; contours above S_min: {found.candidates}"


def remarks(image: Image, tried: VisionConfig, found: Detection, reference: Detection) -> Iterator[Remark]:
    trace = pipeline.trace(image, tried)
    circle = reference.circle
    if reference.circle is not None and reference.ellipse is not None:  # pixels inside the smaller axis are its own
        circle = Circle(reference.ellipse.u_px, reference.ellipse.v_px, reference.ellipse.semi_minor_px)
    share = np.count_nonzero(trace.initial) / trace.initial.size
    if share > MASK_SHARE:
        yield Remark(f"too broad: the red ranges let in {100 * share:.0f} % of the picture", "red_low_1")
    if circle is not None:
        seen = example("this picture", image, circle, tried)
        if seen.marked:
            red = exact_ranges(tried)
            yield from (
                Remark(text, "red_low_1") for text in thresholds.remarks(thresholds.admission(red, [seen]), red)
            )
        yield from _eaten(trace, circle, tried)
    if found.circle is None:
        yield from _gated(trace, tried)


def _eaten(trace: Trace, circle: Circle, tried: VisionConfig) -> Iterator[Remark]:
    inside = disc(trace.initial, circle)
    before = np.count_nonzero(trace.initial[inside])
    left = np.count_nonzero(trace.opened[inside])
    if not before:
        return
    side = Opening.of(tried).side_px
    if left < LEFT_SHARE * before:
        yield Remark(f"the opening eats the marker: nothing thinner than {side} px is left of it", "morph_kernel_px")
    elif left < (1 - LOST_SHARE) * before:
        yield Remark(
            f"the opening takes {100 * (1 - left / before):.0f} % of the marker's red: all that is thinner than "
            f"{side} px",
            "morph_kernel_px",
        )


def _gated(trace: Trace, tried: VisionConfig) -> Iterator[Remark]:
    """Which gate kept the largest contour out."""
    if not trace.contours:
        return
    largest = max(trace.contours, key=stages.contour_area)
    area = stages.contour_area(largest)
    if area <= tried.min_area_px2:
        yield Remark(f"the largest red area, {area:.0f} px², is not above {tried.min_area_px2:g}", "min_area_px2")
        return
    round_, full = stages.circularity(largest), stages.fill(largest, stages.enclosing_circle(largest))
    if round_ < tried.min_circularity:
        yield Remark(f"the largest red area has a circularity of {round_:.2f}: too little", "min_circularity")
    if full < tried.min_fill:
        yield Remark(f"the largest red area fills {full:.2f} of its circle: too little", "min_fill")


@dataclass(frozen=True, slots=True)
class ExactRanges(Red):
    """Both ranges as they are set; `Red` has one S and one V for both."""

    boxes: tuple[tuple[Corner, Corner], ...] = ()

    def admits(self, colours: HsvColours) -> NDArray[np.bool_]:
        hsv = colours.copy()
        hsv[:, 0] %= 180
        passes = [((hsv >= low) & (hsv <= high)).all(axis=1) for low, high in self.boxes]
        return np.asarray(np.any(passes, axis=0), np.bool_)


def exact_ranges(params: VisionConfig) -> ExactRanges:
    near = thresholds.current(params)
    return ExactRanges(near.hue_low, near.hue_high, near.s_min, near.v_min, stages.ranges(params))
