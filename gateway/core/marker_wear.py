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
from operator import attrgetter
from statistics import median
from typing import Annotated

from msgspec import Meta

from gateway.config import PictureConfig

DAY_S = 86_400
KEPT_DAYS = 30
OF_A_DAY = 12  # visits kept, the newest
MAX_RIMS = KEPT_DAYS * OF_A_DAY
NEWEST = 10  # visits whose median is the value of now; fewer: not known
CLEANED = 1.15  # these better by so much than the best tenth of those before: cleaned or repainted, a new trend begins
WORN_DAYS, IN_ORDER_DAYS = 3, 1  # whose visits make it worn, and in order again; by day and by night
SURE = 0.75  # share of them that must be so: where half of the trucks are dirty, nothing changes
CERTAIN = 2.33  # standard deviations: by chance 1 time in 100; 6 days that fall one after the other pass
FARTHEST_DAYS = 90.0  # a forecast beyond is none
BETTER, LATER = 1.1, 1.5  # by so much, of the limit and of the forecast, it must be better to be in order again


@dataclass(frozen=True, slots=True)
class RimSeen:
    """Of one visit: medians of its first pictures in place. `visible`: share of the rim; `contrast`: fall of redness
    across it, log units."""

    unix_s: Annotated[int, Meta(ge=0, lt=2**40)]
    visible: Annotated[float, Meta(ge=0, le=1)]
    contrast: Annotated[float, Meta(ge=0, le=10)]


@dataclass(frozen=True, slots=True)
class WearTrend:
    """`per_day`: its change; None: none that is certain. `days_left`: until it is below its limit, 0: it is; None: not
    within FARTHEST_DAYS, or not known."""

    value: float
    per_day: float | None = None
    days_left: float | None = None


@dataclass(frozen=True, slots=True)
class MarkerWear:
    """What is known after a visit. `worn`: clean or repaint the markers. No visits: nothing any more."""

    visits: int
    visible: WearTrend
    contrast: WearTrend
    worn: bool = False

    @property
    def days_left(self) -> float | None:
        """Of the one that is below its limit first."""
        return min((t.days_left for t in (self.visible, self.contrast) if t.days_left is not None), default=None)


NOT_KNOWN = MarkerWear(0, WearTrend(0.0), WearTrend(0.0))
_visible, _contrast = attrgetter("visible"), attrgetter("contrast")


def follows(rims: Sequence[RimSeen], unix_s: int) -> bool:
    """May a visit of that time be the next? Else a clock was wrong, or they are of long ago."""
    return not rims or -DAY_S <= unix_s - rims[-1].unix_s < KEPT_DAYS * DAY_S


def with_visit(rims: Sequence[RimSeen], rim: RimSeen) -> tuple[RimSeen, ...]:
    """Oldest first, bounded. What is later than `rim` is of a clock that was wrong."""
    kept = [*(r for r in rims if 0 <= rim.unix_s - r.unix_s < KEPT_DAYS * DAY_S), rim]
    of_day = [r for r in kept if r.unix_s // DAY_S == rim.unix_s // DAY_S]
    if len(of_day) > OF_A_DAY:
        kept.remove(of_day[0])
    newest, before = kept[-NEWEST:], _of_days(kept[:-NEWEST], WORN_DAYS)
    cleaned = len(before) >= NEWEST and any(
        median(map(of, newest)) > CLEANED * _quantile(before, of, 0.9) for of in (_visible, _contrast)
    )
    return tuple(newest if cleaned else kept)


def wear(rims: Sequence[RimSeen], limits: PictureConfig, *, worn: bool) -> MarkerWear | None:
    """`worn`: it was, before the newest visit. None: too few visits yet."""
    if len(rims) < NEWEST:
        return None
    seen, faded = limits.rim_visible_min, limits.rim_contrast_min
    visible, contrast = _trend(rims, _visible, seen), _trend(rims, _contrast, faded)
    # More than the whole rim can't be seen.
    better = (min(BETTER * seen, (1 + seen) / 2), BETTER * faded) if worn else (seen, faded)
    recent, share = (_of_days(rims, IN_ORDER_DAYS), 1 - SURE) if worn else (_of_days(rims, WORN_DAYS), SURE)
    days = (LATER if worn else 1.0) * limits.rim_forecast_days
    now = any(
        (value := _quantile(recent, of, share)) < enough or _days_left(value, trend.per_day, least) < days
        for of, trend, least, enough in ((_visible, visible, seen, better[0]), (_contrast, contrast, faded, better[1]))
    )
    return MarkerWear(len(rims), visible, contrast, worn=now)


def _of_days(rims: Sequence[RimSeen], days: int) -> Sequence[RimSeen]:
    """Those of so many days up to the newest; NEWEST at least."""
    recent = sum(rims[-1].unix_s - rim.unix_s < days * DAY_S for rim in rims)
    return rims[-max(recent, NEWEST) :]


def _quantile(rims: Sequence[RimSeen], of: Callable[[RimSeen], float], share: float) -> float:
    return sorted(map(of, rims))[math.ceil(share * len(rims)) - 1]


def _trend(rims: Sequence[RimSeen], of: Callable[[RimSeen], float], least: float) -> WearTrend:
    value, per_day = median(map(of, rims[-NEWEST:])), _per_day(rims, of)
    if value < least:
        return WearTrend(value, per_day, 0.0)
    days_left = _days_left(value, per_day, least)
    return WearTrend(value, per_day, days_left if days_left <= FARTHEST_DAYS else None)


def _days_left(value: float, per_day: float | None, least: float) -> float:
    return (value - least) / -per_day if per_day and per_day < 0 and least > 0 else math.inf


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
