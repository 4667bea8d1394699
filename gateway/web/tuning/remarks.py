"""What a technician should know about tried settings, in words, with the key that the words are about. Pure."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.clock import NS_PER_MS
from gateway.config import VisionConfig
from gateway.core.model import Circle, Detection
from gateway.vision.detect.paper import pipeline, stages
from gateway.vision.detect.paper.pipeline import Trace
from gateway.vision.detect.paper.stages import Corner, Mask
from gateway.vision.detect.robust.rejections import REJECTION_MEANING
from gateway.vision.offline.tuning import thresholds
from gateway.vision.offline.tuning.samples import Colours, Example, example
from gateway.vision.offline.tuning.thresholds import Red
from gateway.vision.transport.ring import Snapshot
from gateway.web.profile.parameter_schema import changes
from gateway.web.tuning.trial import TrialResult

LOOKED_AT = 3  # frames of a recording, spread over it
MASK_SHARE = 0.25  # of the picture
LOST_SHARE, LEFT_SHARE = 0.2, 0.05  # of the marker's red, by the opening
SURE = 0.3  # of a confidence gate: below, even odds pass
NEAR = 0.5  # of the radius: the same place
SLOWER = 1.25  # times the time in force is worth a word


@dataclass(frozen=True, slots=True)
class Remark:
    """`key`: the control it belongs to; empty: to the whole."""

    text: str
    key: str = ""
    warning: bool = True


def remarks(
    frames: Sequence[Snapshot], tried: VisionConfig, in_force: VisionConfig, result: TrialResult
) -> list[Remark]:
    """The most telling first; at least one frame, those that `result` is about."""
    found = [*_against_others(result), *_idle(tried, in_force), *_speed(frames, result)]
    count = min(result.frames, len(frames))
    chosen = sorted({round(n * (count - 1) / max(1, LOOKED_AT - 1)) for n in range(LOOKED_AT)})
    for n in chosen:
        detection, reference = result.tried.found[n], result.reference[n].circle
        found += _paper(frames[n], tried, detection, result.reference[n]) if tried.method == "paper" else ()
        found += _robust(frames[n], tried, detection, reference) if tried.method == "robust" else ()
    first = {(remark.key, remark.text.partition(":")[0]): remark for remark in reversed(found)}
    return sorted(first.values(), key=lambda remark: not remark.warning)


def _against_others(result: TrialResult) -> Iterator[Remark]:
    ours, theirs = result.tried.found_share, result.in_force.found_share
    if ours < theirs:
        yield Remark(f"finds the marker less often: in {100 * ours:.0f} % of the frames, in force {100 * theirs:.0f} %")
    wrong = missed = 0
    for found, reference in zip(result.tried.found, result.reference, strict=True):
        if reference.circle is None:
            continue
        missed += found.circle is None
        wrong += found.circle is not None and not _same(found.circle, reference.circle)
    sure = sum(reference.circle is not None for reference in result.reference)
    if wrong:
        yield Remark(f"finds something else than the robust method: in {wrong} of {sure} frames in which that is sure")
    if missed and ours >= theirs:
        yield Remark(f"misses a marker that the robust method sees: in {missed} of {sure} frames")
    if result.cut_short:
        yield Remark(f"the time ran out: only {result.frames} frames were looked at", warning=False)


def _idle(tried: VisionConfig, in_force: VisionConfig) -> Iterator[Remark]:
    """Changed keys that change nothing."""
    changed = changes(in_force, tried)
    for key in tried.idle():
        if key in changed:
            yield Remark(f"{key}: has no effect with method {tried.method}", key, warning=False)


def _speed(frames: Sequence[Snapshot], result: TrialResult) -> Iterator[Remark]:
    if result.timed and result.time_ratio > SLOWER:
        yield Remark(f"slower: {result.time_ratio:.1f} times the time a frame of the settings in force", warning=False)
    if len(frames) < 2:
        return
    gaps = np.diff([frame.t_capture_ns for frame in frames]) / NS_PER_MS
    seqs = np.diff([frame.seq for frame in frames])
    every_ms = float(np.median(gaps / np.maximum(seqs, 1)))
    # Where those in force are too slow here, too, this process has too little of the machine to tell.
    if result.in_force.times.total_ms <= every_ms < result.tried.times.total_ms:
        yield Remark(
            f"slower than the camera: {result.tried.times.total_ms:.0f} ms a frame here, a frame every {every_ms:.0f} "
            "ms; frames will be skipped"
        )


# --- the paper's method


def _paper(frame: Snapshot, tried: VisionConfig, found: Detection, reference: Detection) -> Iterator[Remark]:
    trace = pipeline.trace(frame.image, tried)
    circle = reference.circle
    if reference.circle is not None and reference.ellipse is not None:  # pixels inside the smaller axis are its own
        circle = Circle(reference.ellipse.u_px, reference.ellipse.v_px, reference.ellipse.semi_minor_px)
    share = np.count_nonzero(trace.initial) / trace.initial.size
    if share > MASK_SHARE:
        yield Remark(f"too broad: the red ranges let in {100 * share:.0f} % of the picture", "red_low_1")
    if circle is not None:
        seen = example("this picture", frame.image, circle, tried)
        if seen.marked:
            red = exact_ranges(tried)
            yield from (Remark(said, "red_low_1") for said in thresholds.said(_admission(red, seen), red))
        yield from _eaten(trace, circle, tried)
    if found.circle is None:
        yield from _gated(trace, tried)


def _eaten(trace: Trace, circle: Circle, tried: VisionConfig) -> Iterator[Remark]:
    inside = _disc(circle, trace.initial)
    before = np.count_nonzero(trace.initial[inside])
    left = np.count_nonzero(trace.opened[inside])
    if not before:
        return
    side = tried.morph_iterations * (tried.morph_kernel_px - 1) + 1
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
    """Both ranges just as they are set, where `Red` alone has one S and one V for both."""

    boxes: tuple[tuple[Corner, Corner], ...] = ()

    def admits(self, colours: Colours) -> NDArray[np.bool_]:
        hsv = colours.copy()
        hsv[:, 0] %= 180
        passes = [((hsv >= low) & (hsv <= high)).all(axis=1) for low, high in self.boxes]
        return np.asarray(np.any(passes, axis=0), np.bool_)


def exact_ranges(params: VisionConfig) -> ExactRanges:
    near = thresholds.current(params)
    boxes = ((params.red_low_1, params.red_high_1), (params.red_low_2, params.red_high_2))
    return ExactRanges(near.hue_low, near.hue_high, near.s_min, near.v_min, boxes)


def _admission(red: Red, seen: Example) -> thresholds.Admission:
    return thresholds.admission(red, [seen])


def _disc(circle: Circle, mask: Mask) -> NDArray[np.bool_]:
    v, u = np.ogrid[0 : mask.shape[0], 0 : mask.shape[1]]
    return np.asarray((u - circle.u_px) ** 2 + (v - circle.v_px) ** 2 <= circle.radius_px**2, np.bool_)


# --- the robust method


def _robust(frame: Snapshot, tried: VisionConfig, found: Detection, reference: Circle | None) -> Iterator[Remark]:
    if tried.min_confidence < SURE:
        yield Remark(
            f"min_confidence: {tried.min_confidence:g} takes what is more likely no marker than one", "min_confidence"
        )
    if reference is None or (found.circle is not None and _same(found.circle, reference)):
        return
    diagonal_px = math.hypot(*frame.image.shape[:2])
    if reference.radius_px > tried.max_radius_share * diagonal_px:
        yield Remark(f"the marker is refused: R = {reference.radius_px:.0f} px is above the limit", "max_radius_share")
    elif reference.radius_px < tried.min_radius_share * diagonal_px:
        yield Remark(f"the marker is refused: R = {reference.radius_px:.0f} px is below the limit", "min_radius_share")
    else:
        refused = [rejection.why for rejection in found.rejected if _same(rejection.circle, reference)]
        why = REJECTION_MEANING[refused[0]] if refused else "it was not among the best few candidates"
        key = "min_confidence" if refused[:1] == ["confidence"] else ""
        yield Remark(f"the marker is refused: {why}", key)


def _same(one: Circle, other: Circle) -> bool:
    apart = math.hypot(one.u_px - other.u_px, one.v_px - other.v_px)
    return apart <= NEAR * max(one.radius_px, other.radius_px)
