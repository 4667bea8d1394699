"""How worn the markers of a bay's trucks are: the rim's visible share and contrast from visit to visit. Pure.

Each truck has a marker of its own, and trucks are not told apart: what counts are medians over visits and days, so that
one truck with a dirty marker is no trend. The slope is Theil and Sen's of the days' medians, and counts only where
Mann and Kendall's test finds it. Nothing that decides reads this.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from statistics import median

from gateway.config import PictureConfig

DAY_S = 86_400
KEPT_DAYS = 30
OF_A_DAY = 12  # visits kept, the newest
MAX_RIMS = KEPT_DAYS * OF_A_DAY
NEWEST = 10  # visits whose median is the value of now; fewer: not known
CLEANED = 1.15  # these better by so much than as many before them: cleaned or repainted, and the trend begins anew
CERTAIN = 2.33  # standard deviations: by chance 1 time in 100; 6 days that fall one after the other pass
FARTHEST_DAYS = 90.0  # a forecast beyond is none
BETTER, LATER = 1.1, 1.5  # by so much, of the limit and of the forecast, it must be better to be in order again


@dataclass(frozen=True, slots=True)
class RimSeen:
    """Of one visit: medians of its first pictures in place. `visible`: share of the rim; `contrast`: fall of redness
    across it, log units."""

    unix_s: int
    visible: float
    contrast: float


@dataclass(frozen=True, slots=True)
class WearTrend:
    """`per_day`: its change; None: none that is certain. `days_left`: until it is below its limit, 0: it is; None: not
    within FARTHEST_DAYS, or not known."""

    value: float
    per_day: float | None = None
    days_left: float | None = None


@dataclass(frozen=True, slots=True)
class MarkerWear:
    """What is known after a visit. `worn`: clean or repaint the markers."""

    visits: int
    visible: WearTrend
    contrast: WearTrend
    worn: bool = False

    @property
    def days_left(self) -> float | None:
        """Of the one that is below its limit first."""
        return min((t.days_left for t in (self.visible, self.contrast) if t.days_left is not None), default=None)


def with_visit(rims: Sequence[RimSeen], rim: RimSeen) -> tuple[RimSeen, ...]:
    """Oldest first, bounded. What is later than `rim` is of a clock that was wrong."""
    kept = [*(r for r in rims if 0 <= rim.unix_s - r.unix_s < KEPT_DAYS * DAY_S), rim]
    of_day = [r for r in kept if r.unix_s // DAY_S == rim.unix_s // DAY_S]
    if len(of_day) > OF_A_DAY:
        kept.remove(of_day[0])
    newest, before = kept[-NEWEST:], kept[-2 * NEWEST : -NEWEST]
    cleaned = len(before) == NEWEST and any(
        median(map(of, newest)) > CLEANED * median(map(of, before)) for of in (_visible, _contrast)
    )
    return tuple(newest if cleaned else kept)


def wear(rims: Sequence[RimSeen], limits: PictureConfig, *, worn: bool) -> MarkerWear | None:
    """`worn`: it was, before the newest visit. None: too few visits yet."""
    if len(rims) < NEWEST:
        return None
    visible = _trend(rims, _visible, limits.rim_visible_min)
    contrast = _trend(rims, _contrast, limits.rim_contrast_min)
    better, later = (BETTER, LATER) if worn else (1.0, 1.0)
    low = visible.value < better * limits.rim_visible_min or contrast.value < better * limits.rim_contrast_min
    found = MarkerWear(len(rims), visible, contrast)
    soon = found.days_left is not None and found.days_left < later * limits.rim_forecast_days
    return MarkerWear(len(rims), visible, contrast, worn=low or soon)


def _visible(rim: RimSeen) -> float:
    return rim.visible


def _contrast(rim: RimSeen) -> float:
    return rim.contrast


def _trend(rims: Sequence[RimSeen], of: Callable[[RimSeen], float], least: float) -> WearTrend:
    value, per_day = median(map(of, rims[-NEWEST:])), _per_day(rims, of)
    if value < least:
        return WearTrend(value, per_day, 0.0)
    days_left = (value - least) / -per_day if per_day and per_day < 0 and least > 0 else math.inf
    return WearTrend(value, per_day, days_left if days_left <= FARTHEST_DAYS else None)


def _per_day(rims: Sequence[RimSeen], of: Callable[[RimSeen], float]) -> float | None:
    """Median slope of all pairs of days; None: it may be chance."""
    days: dict[int, list[float]] = defaultdict(list)
    for rim in rims:
        days[rim.unix_s // DAY_S].append(of(rim))
    pairs = list(combinations([(day, median(values)) for day, values in sorted(days.items())], 2))
    rising = sum((b[1] > a[1]) - (b[1] < a[1]) for a, b in pairs)
    n = len(days)
    if abs(rising) - 1 < CERTAIN * math.sqrt(n * (n - 1) * (2 * n + 5) / 18):
        return None
    return median((b[1] - a[1]) / (b[0] - a[0]) for a, b in pairs)
