"""Red thresholds: what a setting lets in of marker and background, and the setting that separates them best. Pure.

A setting is Table I's shape with one S and one V for both ranges. It is scored on every example alike: the share of the
marker that passes, less the share of its surroundings (what it would merge with), less half of the red area elsewhere,
counted in markers and at most one (a larger red thing wins). The best value of each bound is the middle of the values
that do as well: the light changes, and a value at the edge would be the first to fail.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.config import VisionConfig
from gateway.vision.offline.tuning.samples import Example, HsvColours

AS_GOOD = 0.004  # of score: values that lose no more do as well
ROUNDS = 8
LEAST_S, LEAST_V = 20, 20  # below, hue is noise
MOST_HUE = 40  # from red, either way: beyond is yellow or blue
BROWN = ((4, 25), (43, 150))  # signed hue and S of wood, rust, leather, warm light on concrete


@dataclass(frozen=True, slots=True)
class Red:
    """Hue from -`hue_low` to +`hue_high` about red; S and V at least."""

    hue_low: int
    hue_high: int
    s_min: int
    v_min: int

    def admits(self, colours: HsvColours) -> NDArray[np.bool_]:
        hue, s, v = colours.T
        found = (hue >= -self.hue_low) & (hue <= self.hue_high) & (s >= self.s_min) & (v >= self.v_min)
        return np.asarray(found, np.bool_)

    def apply(self, params: VisionConfig) -> VisionConfig:
        return params.model_copy(update=self.keys())

    def keys(self) -> dict[str, tuple[int, int, int]]:
        return {
            "red_low_1": (0, self.s_min, self.v_min),
            "red_high_1": (self.hue_high, 255, 255),
            "red_low_2": (180 - self.hue_low, self.s_min, self.v_min),
            "red_high_2": (180, 255, 255),
        }


@dataclass(frozen=True, slots=True)
class Margin:
    """A bound of a proposal, and the range in which it does as well."""

    name: str
    value: int
    low: int
    high: int


@dataclass(frozen=True, slots=True)
class Admission:
    """What a setting lets in, over the examples."""

    marker: float  # mean share of the marker
    marker_worst: float
    worst_name: str
    ring: float  # mean share of the surroundings
    far_markers: float  # median of the red area elsewhere, in markers
    brown_of_background: float  # share of what it admits of the background that is brown or orange
    score: float


def current(params: VisionConfig) -> Red:
    """The configuration's setting in this shape: the looser of the two ranges where they differ."""
    return Red(
        hue_low=180 - params.red_low_2[0],
        hue_high=params.red_high_1[0],
        s_min=min(params.red_low_1[1], params.red_low_2[1]),
        v_min=min(params.red_low_1[2], params.red_low_2[2]),
    )


def propose(examples: Sequence[Example]) -> tuple[Red, tuple[Margin, ...]]:
    """At least one example must be marked. Returns the setting and how far each bound may move."""
    best = max((_climb(start, examples) for start in _starts(examples)), key=lambda red: score(red, examples))
    margins = []
    for name in ("hue_low", "hue_high", "s_min", "v_min"):
        value, low, high = _plateau(best, name, examples)
        best = replace(best, **{name: value})
        margins.append(Margin(name, value, low, high))
    return best, tuple(margins)


def admission(red: Red, examples: Sequence[Example]) -> Admission:
    marked = [e for e in examples if e.marked]
    shares = [float(red.admits(e.marker).mean()) for e in marked]
    background = [c[red.admits(c)] for e in examples for c in (e.ring, e.far)]
    admitted = np.concatenate(background)
    (h0, h1), (s0, s1) = BROWN
    brown = (admitted[:, 0] >= h0) & (admitted[:, 0] <= h1) & (admitted[:, 1] >= s0) & (admitted[:, 1] <= s1)
    worst = int(np.argmin(shares))
    return Admission(
        marker=float(np.mean(shares)),
        marker_worst=shares[worst],
        worst_name=marked[worst].name,
        ring=float(np.mean([red.admits(e.ring).mean() if len(e.ring) else 0.0 for e in marked])),
        far_markers=float(np.median(_elsewhere(red, examples))),
        brown_of_background=float(brown.mean()) if len(admitted) else 0.0,
        score=score(red, examples),
    )


def score(red: Red, examples: Sequence[Example]) -> float:
    """1: all of every marker passes and nothing else."""
    marked = [e for e in examples if e.marked]
    inside = np.mean([red.admits(e.marker).mean() for e in marked])
    ring = np.mean([red.admits(e.ring).mean() if len(e.ring) else 0.0 for e in marked])
    return float(inside - ring - 0.5 * np.minimum(1.0, _elsewhere(red, examples)).mean())


def remarks(found: Admission, red: Red) -> list[str]:
    """What is wrong with a setting, in words; nothing: it fits the examples."""
    words = []
    if found.ring > 0.05:
        words.append(
            f"too broad: {100 * found.ring:.0f} % of the surroundings of the marker pass, so that it merges with them"
        )
    if found.far_markers > 0.25:
        words.append(
            f"too broad: red elsewhere in the picture adds up to {found.far_markers:.1f} times the marker's area"
        )
    if (found.ring > 0.02 or found.far_markers > 0.1) and found.brown_of_background > 0.3:
        words.append(
            f"S >= {red.s_min} admits wood, rust and warm light: {100 * found.brown_of_background:.0f} % of the "
            f"background that passes is brown or orange (H {BROWN[0][0]} to {BROWN[0][1]}, "
            f"S {BROWN[1][0]} to {BROWN[1][1]})"
        )
    if found.marker_worst < 0.8:
        words.append(f"too narrow: only {100 * found.marker_worst:.0f} % of the marker passes in {found.worst_name}")
    return words


def bound_that_cuts(red: Red, example: Example) -> str:
    """Which bound keeps most of an example's marker out."""
    hue, s, v = example.marker.T
    lost = {
        f"H <= {red.hue_high}": (hue > red.hue_high).mean(),
        f"H >= {180 - red.hue_low}": (hue < -red.hue_low).mean(),
        f"S >= {red.s_min}": (s < red.s_min).mean(),
        f"V >= {red.v_min}": (v < red.v_min).mean(),
    }
    return max(lost, key=lambda name: float(lost[name]))


def _elsewhere(red: Red, examples: Sequence[Example]) -> NDArray[np.float64]:
    """Red area outside the surroundings of each example, in markers (of pictures without one: in typical markers)."""
    typical = float(np.median([e.marker_px for e in examples if e.marked]))
    return np.array(
        [
            red.admits(e.far).mean() * e.far_px / (e.marker_px if e.marked else typical) if len(e.far) else 0.0
            for e in examples
        ]
    )


def _starts(examples: Sequence[Example]) -> list[Red]:
    """Table I, and what holds nearly all of the markers' pixels."""
    pixels = np.concatenate([e.marker for e in examples if e.marked])
    low, high = np.percentile(pixels, 2, axis=0), np.percentile(pixels, 98, axis=0)
    tight = Red(
        hue_low=int(np.clip(-low[0], 1, MOST_HUE)),
        hue_high=int(np.clip(high[0], 0, MOST_HUE)),
        s_min=int(np.clip(low[1], LEAST_S, 255)),
        v_min=int(np.clip(low[2], LEAST_V, 255)),
    )
    return [Red(24, 10, 43, 46), tight]


def _climb(red: Red, examples: Sequence[Example]) -> Red:
    """One bound after the other to its best value, until none moves."""
    for _ in range(ROUNDS):
        before = red
        for name in ("s_min", "hue_high", "hue_low", "v_min"):
            values, scores = _scores(red, name, examples)
            red = replace(red, **{name: int(values[np.argmax(scores)])})
        if red == before:
            break
    return red


def _plateau(red: Red, name: str, examples: Sequence[Example]) -> tuple[int, int, int]:
    """The middle, the lowest and the highest of the neighbouring values that do as well as the best."""
    values, scores = _scores(red, name, examples)
    good = scores >= scores.max() - AS_GOOD
    low = high = int(np.argmax(scores))
    while low > 0 and good[low - 1]:
        low -= 1
    while high < len(values) - 1 and good[high + 1]:
        high += 1
    return int(values[(low + high) // 2]), int(values[low]), int(values[high])


def _scores(red: Red, name: str, examples: Sequence[Example]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The score for every value of one bound, the others as they are: one histogram a class instead of many tries."""
    column = {"hue_low": 0, "hue_high": 0, "s_min": 1, "v_min": 2}[name]
    upper = name == "hue_high"  # an upper bound lets in what is not larger, the others what is not smaller
    values = {
        "hue_low": np.arange(1, MOST_HUE + 1),
        "hue_high": np.arange(0, MOST_HUE + 1),
        "s_min": np.arange(LEAST_S, 256),
        "v_min": np.arange(LEAST_V, 256),
    }[name]
    open_ = replace(red, **{name: {"hue_low": 90, "hue_high": 90}.get(name, 0)})
    limits = -values if name == "hue_low" else values

    def passing(colours: HsvColours) -> NDArray[np.float64]:
        """Share of the colours that pass, for every value."""
        if not len(colours):
            return np.zeros(len(values))
        level = np.sort(colours[open_.admits(colours), column])
        below = np.searchsorted(level, limits, side="right" if upper else "left")
        return np.asarray((below if upper else len(level) - below) / len(colours), np.float64)

    marked = [e for e in examples if e.marked]
    typical = float(np.median([e.marker_px for e in marked]))
    total = sum((passing(e.marker) - passing(e.ring) for e in marked), np.zeros(len(values))) / len(marked)
    far = sum(
        (np.minimum(1.0, passing(e.far) * e.far_px / (e.marker_px if e.marked else typical)) for e in examples),
        np.zeros(len(values)),
    )
    return values, np.asarray(total - 0.5 * far / len(examples), np.float64)
