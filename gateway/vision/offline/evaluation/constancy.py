"""R times Z over pictures of one marker from one camera at known distances: a pinhole keeps it constant. Pure.

R = f r / Z, so R Z = f r in the same unit: the deviation of single pictures from it shows how good R is as a distance.
The labels' own radius is put beside it, because a distance measured by tape has an error, too. A tape often starts at
the lens or at a bumper and not at the centre of projection: `offset_cm` is the shift of Z, by at most half the shortest
distance, that makes the largest deviation of R (Z + offset) smallest.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

FEWEST = 3  # different distances, for an offset
_REACH, _STEPS = 0.5, 2001


@dataclass(frozen=True, slots=True)
class Constancy:
    """One series. Deviations are from the series' median of R Z, in percent of it."""

    series: str
    pictures: int
    median_px_cm: float
    typical_pct: float  # median of the absolute deviations
    largest_pct: float
    label_largest_pct: float  # what the labels' own radius gives
    offset_cm: float | None  # None: fewer than three distances, or no such shift
    largest_with_offset_pct: float | None


def constancy(series: str, radius_px: Sequence[float], z_cm: Sequence[float], label_px: Sequence[float]) -> Constancy:
    """At least one picture; radius, distance and labelled radius of each."""
    radius, z, label = (np.asarray(values, float) for values in (radius_px, z_cm, label_px))
    strays = _deviations_pct(radius * z)
    offset_cm = largest_with_offset_pct = None
    if len(set(z_cm)) >= FEWEST:
        shifts = np.linspace(-_REACH * z.min(), _REACH * z.min(), _STEPS)
        largest = [_deviations_pct(radius * (z + shift)).max() for shift in shifts]
        best = int(np.argmin(largest))
        if 0 < best < _STEPS - 1:  # at an end: no shift within reach explains the strays
            offset_cm, largest_with_offset_pct = float(shifts[best]), float(largest[best])
    return Constancy(
        series=series,
        pictures=len(radius),
        median_px_cm=float(np.median(radius * z)),
        typical_pct=float(np.median(strays)),
        largest_pct=float(strays.max()),
        label_largest_pct=float(_deviations_pct(label * z).max()),
        offset_cm=offset_cm,
        largest_with_offset_pct=largest_with_offset_pct,
    )


def _deviations_pct(products: np.ndarray) -> np.ndarray:
    middle = np.median(products)
    return np.asarray(100 * np.abs(products - middle) / abs(middle))
