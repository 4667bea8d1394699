"""What a row of detections says in sum: how many, how still, how far from another setting's, how long. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.clock import NS_PER_MS
from gateway.model import Circle, Detection

FEWEST = 5  # frames that can be judged, for a spread
_SIGMA = 1.4826  # from the median of absolute values to sigma, for a Gaussian


@dataclass(frozen=True, slots=True)
class Jitter:
    """Robust sigma of what is not smooth motion, px; frame to frame."""

    u_px: float
    v_px: float
    radius_px: float


@dataclass(frozen=True, slots=True)
class Apart:
    """Of the frames in which both found something: median and largest distance of the centres, median of R less R."""

    frames: int
    centre_px: float
    centre_largest_px: float
    radius_px: float  # signed
    radius_largest_px: float  # of the absolute values


@dataclass(frozen=True, slots=True)
class Times:
    """Medians, ms. `stages` in the order in which they ran."""

    total_ms: float
    stages: tuple[tuple[str, float], ...]


def found_share(found: Sequence[Detection]) -> float:
    return sum(one.circle is not None for one in found) / len(found) if found else 0.0


def jitter(times_ns: Sequence[int], found: Sequence[Detection]) -> Jitter | None:
    """Each of three frames in a row against the straight line through its neighbours. None: too few to say.

    A truck's motion is nearly straight over three frames; what is left is the method's own noise, sqrt(1 + a^2 + b^2)
    times, where a and b are the shares of the neighbours.
    """
    left: list[NDArray[np.float64]] = []
    rows = [(t, one.circle) for t, one in zip(times_ns, found, strict=True)]
    for (t0, before), (t1, at), (t2, after) in zip(rows, rows[1:], rows[2:], strict=False):
        if before is None or at is None or after is None or not t0 < t1 < t2:
            continue
        share = (t1 - t0) / (t2 - t0)
        off = _numbers(at) - (1 - share) * _numbers(before) - share * _numbers(after)
        left.append(off / np.sqrt(1 + share**2 + (1 - share) ** 2))
    if len(left) < FEWEST:
        return None
    u, v, radius = (float(value) for value in _SIGMA * np.median(np.abs(np.array(left)), axis=0))
    return Jitter(u, v, radius)


def apart(found: Sequence[Detection], other: Sequence[Detection]) -> Apart | None:
    """How far `found` lies from `other`, frame by frame. None: never both."""
    pairs = [(a.circle, b.circle) for a, b in zip(found, other, strict=True)]
    both = np.array([_numbers(a) - _numbers(b) for a, b in pairs if a is not None and b is not None])
    if not len(both):
        return None
    centres = np.hypot(both[:, 0], both[:, 1])
    return Apart(
        frames=len(both),
        centre_px=float(np.median(centres)),
        centre_largest_px=float(centres.max()),
        radius_px=float(np.median(both[:, 2])),
        radius_largest_px=float(np.abs(both[:, 2]).max()),
    )


def times(found: Sequence[Detection]) -> Times:
    """At least one detection with times."""
    by_stage: dict[str, list[int]] = {}
    for one in found:
        for stage, ns in one.stage_ns:
            by_stage.setdefault(stage, []).append(ns)
    stages = tuple((stage, float(np.median(spent)) / NS_PER_MS) for stage, spent in by_stage.items())
    return Times(float(np.median([_total_ns(one) for one in found])) / NS_PER_MS, stages)


def time_ratio(found: Sequence[Detection], other: Sequence[Detection]) -> float:
    """Median over pairs that ran one after the other: a busy machine slows both."""
    ratios = [_total_ns(a) / max(_total_ns(b), 1) for a, b in zip(found, other, strict=True)]
    return float(np.median(ratios))


def _total_ns(one: Detection) -> int:
    return sum(ns for _, ns in one.stage_ns)


def _numbers(circle: Circle) -> NDArray[np.float64]:
    return np.array((circle.u_px, circle.v_px, circle.radius_px))
