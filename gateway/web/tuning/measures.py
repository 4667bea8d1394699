"""Figures of a sequence of detections: share found, jitter, deviation from other settings' detections, times. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.core.detection import Circle, Detection
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.vision.detect.stage_timer import total_ns
from gateway.web.tuning.response_models import DeviationView

FEWEST = 5  # frames that can be judged, for a spread
_SIGMA = 1.4826  # from the median of absolute values to sigma, for a Gaussian


@dataclass(frozen=True, slots=True)
class Jitter:
    """Robust sigma of the motion that is not smooth, px; frame to frame."""

    u_px: float
    v_px: float
    radius_px: float


@dataclass(frozen=True, slots=True)
class StageTimes:
    """Medians, ms. `stages` in the order in which they ran."""

    total_ms: float
    stages: tuple[tuple[str, float], ...]


def found_share(found: Sequence[Detection]) -> float:
    return sum(one.circle is not None for one in found) / len(found) if found else 0.0


def jitter(times_ns: Sequence[int], found: Sequence[Detection]) -> Jitter | None:
    """Each of five frames in a row against the cubic through its four neighbours. None: too few to compute.

    A truck's motion in five frames is nearly a cubic, sway and brakes included; the rest is the method's own
    noise, sqrt(1 + the sum of the squared weights of the neighbours) times.
    """
    left: list[NDArray[np.float64]] = []
    rows = [(t, one.circle) for t, one in zip(times_ns, found, strict=True)]
    for five in zip(rows, rows[1:], rows[2:], rows[3:], rows[4:], strict=False):
        circles = [circle for _, circle in five if circle is not None]
        t_s = np.array([(t - five[2][0]) / NS_PER_S for t, _ in five])
        if len(circles) < 5 or not (np.diff(t_s) > 0).all():
            continue
        seen = np.array([_numbers(circle) for circle in circles])
        weights = _cubic_at_0(t_s[[0, 1, 3, 4]])
        left.append((seen[2] - weights @ seen[[0, 1, 3, 4]]) / np.sqrt(1 + weights @ weights))
    if len(left) < FEWEST:
        return None
    u, v, radius = (float(value) for value in _SIGMA * np.median(np.abs(np.array(left)), axis=0))
    return Jitter(u, v, radius)


def _cubic_at_0(t_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4,): weights of values at four times by which the cubic through them is at time 0 (Lagrange)."""
    return np.array([np.prod(np.delete(t_s, n) / (np.delete(t_s, n) - t_s[n])) for n in range(4)])


def deviation(found: Sequence[Detection], other: Sequence[Detection]) -> DeviationView | None:
    """How far `found` lies from `other`, frame by frame. None: never both."""
    pairs = [(a.circle, b.circle) for a, b in zip(found, other, strict=True)]
    both = np.array([_numbers(a) - _numbers(b) for a, b in pairs if a is not None and b is not None])
    if not len(both):
        return None
    centres = np.hypot(both[:, 0], both[:, 1])
    return DeviationView(
        frames=len(both),
        centre_px=float(np.median(centres)),
        centre_largest_px=float(centres.max()),
        radius_px=float(np.median(both[:, 2])),
        radius_largest_px=float(np.abs(both[:, 2]).max()),
    )


def times(found: Sequence[Detection]) -> StageTimes:
    """At least one detection. A stage that a frame did without took no time in it: the stages add up to the total."""
    names = dict.fromkeys(stage for one in found for stage, _ in one.stage_ns)
    rows = [dict(one.stage_ns) for one in found]
    medians = ((name, float(np.median([row.get(name, 0) for row in rows])) / NS_PER_MS) for name in names)
    total = float(np.median([total_ns(one.stage_ns) for one in found])) / NS_PER_MS
    return StageTimes(total, tuple((name, ms) for name, ms in medians if ms > 0))


def time_ratio(found: Sequence[Detection], other: Sequence[Detection]) -> float:
    """Median over pairs that ran one after the other: a busy machine slows both."""
    ratios = [total_ns(a.stage_ns) / max(total_ns(b.stage_ns), 1) for a, b in zip(found, other, strict=True)]
    return float(np.median(ratios))


def _numbers(circle: Circle) -> NDArray[np.float64]:
    return np.array((circle.u_px, circle.v_px, circle.radius_px))
