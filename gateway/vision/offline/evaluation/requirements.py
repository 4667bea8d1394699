"""`--require`: the figures a plant requires, as a table; each is checked, and those not met are reported. Pure."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from gateway.errors import ConfigError
from gateway.vision.offline.evaluation.summary import Summary


@dataclass(frozen=True, slots=True)
class RequiredMetric:
    name: str
    at_least: bool  # else: at most
    unit: str
    meaning: str
    read: Callable[[Summary], float | None]  # None: not measured in this set, which does not meet any requirement


def _wrong(result: Summary) -> float | None:
    return result.total.wrong if result.total.with_marker else None


def _false(result: Summary) -> float | None:
    return result.total.false if result.total.without else None


def _acquired(result: Summary) -> float | None:
    shares = [
        0.0 if found.after is None or found.after.detected_share is None else found.after.detected_share
        for found in result.sequences
    ]
    return min(shares, default=None)


def _rz(result: Summary) -> float | None:
    return max((series.largest_pct for series in result.constancy), default=None)


METRICS = (
    RequiredMetric("detected", True, "share", "answers on the target", lambda r: r.total.detected_share),
    RequiredMetric("within", True, "share", "centre and radius within 5 %", lambda r: r.total.close_share),
    RequiredMetric("wrong", False, "count", "answers elsewhere, in pictures with a marker", _wrong),
    RequiredMetric("false", False, "count", "answers in pictures without", _false),
    RequiredMetric("centre_median", False, "px", "centre error, median", lambda r: r.total.centre_median_px),
    RequiredMetric("centre_p95", False, "px", "centre error, 95 % are below", lambda r: r.total.centre_p95_px),
    RequiredMetric("radius_median", False, "%", "radius error, median", lambda r: r.total.radius_median_pct),
    RequiredMetric("radius_p95", False, "%", "radius error, 95 % are below", lambda r: r.total.radius_p95_pct),
    RequiredMetric("acquired", True, "share", "on the target after acquisition (worst sequence)", _acquired),
    RequiredMetric("rz", False, "%", "R times Z: largest deviation of any series", _rz),
    RequiredMetric("ms", False, "ms", "time a picture, median", lambda r: r.total.ms_median),
)
_BY_NAME = {metric.name: metric for metric in METRICS}


@dataclass(frozen=True, slots=True)
class Requirement:
    metric: RequiredMetric
    limit: float

    def unmet(self, result: Summary) -> str:
        """What is wrong, in words; empty: met."""
        value = self.metric.read(result)
        sign = ">=" if self.metric.at_least else "<="
        wanted = f"{self.metric.name} {sign} {self.limit:g} {self.metric.unit} required"
        if value is None:
            return f"{wanted}, but it can't be measured in this set"
        met = value >= self.limit if self.metric.at_least else value <= self.limit
        return "" if met else f"{wanted}, measured {value:.4g}"


def parse(texts: Sequence[str]) -> tuple[Requirement, ...]:
    """`detected=0.97,false=0`; several texts are one list. Raises ConfigError."""
    found = []
    for part in (part.strip() for text in texts for part in text.split(",")):
        name, sign, number = (piece.strip() for piece in part.partition("="))
        if name not in _BY_NAME or not sign:
            raise ConfigError(f"--require {part}: expected NAME=LIMIT with NAME one of {', '.join(_BY_NAME)}")
        try:
            limit = float(number)
        except ValueError:
            limit = -1.0
        if not 0 <= limit < float("inf"):
            raise ConfigError(f"--require {part}: the limit must be a number, 0 or more")
        if _BY_NAME[name].unit == "share" and limit > 1:
            raise ConfigError(f"--require {part}: a share is at most 1; 97 % is 0.97")
        found.append(Requirement(_BY_NAME[name], limit))
    return tuple(found)
