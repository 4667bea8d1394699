"""The score of an answer against the truth, and the figures of many. Pure.

An answer is *on the target* where its centre and its radius are within 25 % of the true radius; errors are those of
such answers only, for the error of an answer elsewhere has no meaning. An answer elsewhere is *wrong*, which is
worse than none and counted separately: a wrong circle can release or stop a loading.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from gateway.core.detection import Detection, Tracking
from gateway.explained import ExplainedStr
from gateway.vision.detect.geometry import distance_px
from gateway.vision.offline.evaluation.labels import Label

ON_TARGET = 0.25  # of the true radius, centre and radius each
CLOSE = 0.05


class Closeness(ExplainedStr):
    CLOSE = "close", "on the target; centre and radius within 5 % of the radius"
    LOOSE = "loose", "on the target, but not within 5 %"
    WRONG = "wrong", "an answer that is not on the target: worse than none"
    MISSED = "missed", "the marker is there, and no answer"
    FALSE = "false", "no marker is there, and an answer all the same"
    CLEAR = "clear", "no marker is there, and no answer: right"


ON = frozenset((Closeness.CLOSE, Closeness.LOOSE))


@dataclass(frozen=True, slots=True)
class ScoredPicture:
    """One picture, its truth, and a method's answer. Errors are None where there is nothing to compare."""

    label: Label
    detection: Detection
    verdict: Closeness
    took_ns: int
    size_px: tuple[int, int]  # width, height
    centre_px: float | None = None  # distance of the centres
    # (R - true R) / true R, signed; true R is the semi-major axis where labelled, or mean
    radius_share: float | None = None
    mean_radius_share: float | None = None  # the same for the geometric means of the axes, where both are known

    @property
    def on_target(self) -> bool:
        return self.verdict in ON


def judge(
    label: Label, detection: Detection, took_ns: int = 0, size_px: tuple[int, int] = (0, 0), *, mean: bool = False
) -> ScoredPicture:
    """Compares one answer with the truth. `mean`: the verdict is on the geometric mean radius, not on R."""
    circle, truth = detection.circle, label.circle
    if truth is None or label.r is None:
        verdict = Closeness.CLEAR if circle is None else Closeness.FALSE
        return ScoredPicture(label, detection, verdict, took_ns, size_px)
    if circle is None:
        return ScoredPicture(label, detection, Closeness.MISSED, took_ns, size_px)
    centre_px = distance_px(circle, truth)
    radius_share = (circle.radius_px - truth.radius_px) / truth.radius_px
    rim = detection.ellipse
    mean_px = math.sqrt(rim.semi_major_px * rim.semi_minor_px) if rim else circle.radius_px
    mean_share = mean_px / label.r - 1
    share, true_px = (mean_share, label.r) if mean else (radius_share, truth.radius_px)
    worst = max(centre_px / true_px, abs(share))
    verdict = Closeness.CLOSE if worst <= CLOSE else Closeness.LOOSE if worst <= ON_TARGET else Closeness.WRONG
    return ScoredPicture(label, detection, verdict, took_ns, size_px, centre_px, share, mean_share)


@dataclass(frozen=True, slots=True)
class Scores:
    """The figures of a set of pictures. Shares are of the pictures with a marker; None: nothing to take it from."""

    pictures: int
    with_marker: int
    without: int
    on_target: int
    close: int
    wrong: int
    missed: int
    coasted: int  # of the missed: the place was predicted, and reported so
    false: int  # answers where no marker is
    detected_share: float | None
    detected_low: float | None  # 95 % interval of it: few pictures prove little
    detected_high: float | None
    close_share: float | None
    centre_median_px: float | None
    centre_p95_px: float | None
    radius_median_pct: float | None  # of the absolute error
    radius_p95_pct: float | None
    radius_bias_pct: float | None  # median of the signed error: > 0 is too large, and stops too early
    mean_radius_median_pct: float | None
    vague_labels: int  # labels whose own tolerance is more than 5 % of the radius
    ms_median: float | None
    ms_p95: float | None


def scores(outcomes: Iterable[ScoredPicture]) -> Scores:
    """Counts and error statistics; percentiles are interpolated."""
    all_ = list(outcomes)
    marked = [outcome for outcome in all_ if outcome.label.found]
    on = [outcome for outcome in marked if outcome.on_target]
    count = {verdict: sum(outcome.verdict is verdict for outcome in all_) for verdict in Closeness}
    centre = [outcome.centre_px for outcome in on if outcome.centre_px is not None]
    radius = [100 * outcome.radius_share for outcome in on if outcome.radius_share is not None]
    mean = [100 * outcome.mean_radius_share for outcome in on if outcome.mean_radius_share is not None]
    times = [outcome.took_ns / 1e6 for outcome in all_]
    low, high = wilson(len(on), len(marked)) if marked else (None, None)
    return Scores(
        pictures=len(all_),
        with_marker=len(marked),
        without=len(all_) - len(marked),
        on_target=len(on),
        close=count[Closeness.CLOSE],
        wrong=count[Closeness.WRONG],
        missed=count[Closeness.MISSED],
        coasted=sum(outcome.detection.tracking is Tracking.COASTED for outcome in marked),
        false=count[Closeness.FALSE],
        detected_share=_share(len(on), len(marked)),
        detected_low=low,
        detected_high=high,
        close_share=_share(count[Closeness.CLOSE], len(marked)),
        centre_median_px=percentile(centre, 50),
        centre_p95_px=percentile(centre, 95),
        radius_median_pct=percentile([abs(value) for value in radius], 50),
        radius_p95_pct=percentile([abs(value) for value in radius], 95),
        radius_bias_pct=percentile(radius, 50),
        mean_radius_median_pct=percentile([abs(value) for value in mean], 50),
        vague_labels=sum((o.label.tol_px or 0) > CLOSE * (o.label.r or math.inf) for o in marked),
        ms_median=percentile(times, 50),
        ms_p95=percentile(times, 95),
    )


@dataclass(frozen=True, slots=True)
class Acquisition:
    """A sequence followed in order: how long until the first answer on the target, and what came after it."""

    series: str
    frames: int
    acquired_after: int | None  # frames with a marker before the first answer on it; None: never
    after: Scores | None  # of the frames from that one on


def acquisition(series: str, outcomes: Sequence[ScoredPicture]) -> Acquisition:
    """`outcomes` of one sequence, in order."""
    first = next((n for n, outcome in enumerate(outcomes) if outcome.on_target), None)
    if first is None:
        return Acquisition(series, len(outcomes), None, None)
    before = sum(outcome.label.found for outcome in outcomes[:first])
    return Acquisition(series, len(outcomes), before, scores(outcomes[first:]))


def badness(outcome: ScoredPicture) -> tuple[int, float]:
    """Sort key: the worst first. Answers where nothing is, answers elsewhere, no answer, then by the error's share."""
    order = (Closeness.FALSE, Closeness.WRONG, Closeness.MISSED, Closeness.LOOSE, Closeness.CLOSE, Closeness.CLEAR)
    share = 0.0
    if outcome.centre_px is not None and outcome.radius_share is not None and outcome.label.major_px is not None:
        share = max(outcome.centre_px / outcome.label.major_px, abs(outcome.radius_share))
    return order.index(outcome.verdict), -share


def wilson(hits: int, of: int) -> tuple[float, float]:
    """95 % interval of a share by Wilson's score: right for few pictures, and for 0 and all, too."""
    z = 1.959964
    share = hits / of
    middle = share + z * z / (2 * of)
    half = z * math.sqrt(share * (1 - share) / of + z * z / (4 * of * of))
    scale = 1 + z * z / of
    return max(0.0, (middle - half) / scale), min(1.0, (middle + half) / scale)


def percentile(values: Sequence[float], percent: float) -> float | None:
    """Linear between the values; None of none."""
    return float(np.percentile(values, percent)) if values else None


def _share(part: int, total: int) -> float | None:
    return part / total if total else None
