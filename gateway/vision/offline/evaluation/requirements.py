"""`--require`: the figures a plant requires, as a table; each is checked, and those not met are reported. Pure."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from gateway.errors import ConfigError
from gateway.vision.offline.evaluation.result import Result


@dataclass(frozen=True, slots=True)
class Figure:
    name: str
    at_least: bool  # else: at most
    unit: str
    meaning: str
    read: Callable[[Result], float | None]  # None: not measured in this set, which does not meet any requirement


def _wrong(result: Result) -> float | None:
    return result.whole.wrong if result.whole.with_marker else None


def _false(result: Result) -> float | None:
    return result.whole.false if result.whole.without else None


def _acquired(result: Result) -> float | None:
    shares = [
        0.0 if found.after is None or found.after.detected_share is None else found.after.detected_share
        for found in result.sequences
    ]
    return min(shares, default=None)


def _rz(result: Result) -> float | None:
    return max((series.largest_pct for series in result.constancy), default=None)


GATES = (
    Figure("detected", True, "share", "answers on the target", lambda r: r.whole.detected_share),
    Figure("within", True, "share", "centre and radius within 5 %", lambda r: r.whole.close_share),
    Figure("wrong", False, "count", "answers elsewhere, in pictures with a marker", _wrong),
    Figure("false", False, "count", "answers in pictures without", _false),
    Figure("centre_median", False, "px", "centre error, median", lambda r: r.whole.centre_median_px),
    Figure("centre_p95", False, "px", "centre error, 95 % are below", lambda r: r.whole.centre_p95_px),
    Figure("radius_median", False, "%", "radius error, median", lambda r: r.whole.radius_median_pct),
    Figure("radius_p95", False, "%", "radius error, 95 % are below", lambda r: r.whole.radius_p95_pct),
    Figure("acquired", True, "share", "on the target after acquisition (worst sequence)", _acquired),
    Figure("rz", False, "%", "R times Z: largest deviation of any series", _rz),
    Figure("ms", False, "ms", "time a picture, median", lambda r: r.whole.ms_median),
)
_BY_NAME = {figure.name: figure for figure in GATES}


@dataclass(frozen=True, slots=True)
class Requirement:
    figure: Figure
    limit: float

    def unmet(self, result: Result) -> str:
        """What is wrong, in words; empty: met."""
        value = self.figure.read(result)
        sign = ">=" if self.figure.at_least else "<="
        wanted = f"{self.figure.name} {sign} {self.limit:g} {self.figure.unit} required"
        if value is None:
            return f"{wanted}, but it can't be measured in this set"
        met = value >= self.limit if self.figure.at_least else value <= self.limit
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


def markdown() -> str:
    """The table for docs/commissioning-vision.md."""
    rows = [f"| `{g.name}` | {'at least' if g.at_least else 'at most'} | {g.unit} | {g.meaning} |" for g in GATES]
    return "\n".join(["| name | limit is | unit | meaning |", "|---|---|---|---|", *rows]) + "\n"
