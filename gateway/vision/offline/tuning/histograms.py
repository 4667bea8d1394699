"""What marker and background look like: histograms of hue, S and V, as SVG and as characters. Pure."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gateway.vision.offline.reports.chart import Chart, ChartAxis
from gateway.vision.offline.tuning.samples import Example, HsvColours
from gateway.vision.offline.tuning.thresholds import Red

HUE_BANDS = (("violet", -60, -25), ("red", -24, 3), ("orange, brown", 4, 10), ("brown, yellow", 11, 25))
S_BANDS = ((20, 42), (43, 79), (80, 119), (120, 159), (160, 255))
_BLOCKS = " ▁▂▃▄▅▆▇█"
_AXES = (("hue, 0: red (H above 90 less 180)", 0, -90, 90), ("S", 1, 0, 256), ("V", 2, 0, 256))


def pooled(examples: Sequence[Example]) -> tuple[HsvColours, HsvColours, HsvColours]:
    """Marker, surroundings and background of all examples, each example alike."""
    empty = np.empty((0, 3), np.int16)
    return (
        np.concatenate([empty, *(e.marker for e in examples)]),
        np.concatenate([empty, *(e.ring for e in examples)]),
        np.concatenate([empty, *(e.far for e in examples)]),
    )


def charts(examples: Sequence[Example], now: Red, proposed: Red) -> list[str]:
    """Three SVGs: hue, S and V of the three classes, in percent of each; shaded: what the proposal lets in."""
    classes = pooled(examples)
    drawn = []
    for title, column, low, high in _AXES:
        edges = np.linspace(low, high, 61)
        shares = [_share(colours[:, column], edges) for colours in classes]
        middles = [float(x) for x in (edges[:-1] + edges[1:]) / 2]
        top = max(1.0, float(max(share.max() for share in shares)))
        chart = Chart(ChartAxis(title, low, high), ChartAxis("% of the pixels", 0, 1.06 * top), title=title)
        for style, (name, share) in enumerate(zip(("marker", "surroundings", "background"), shares, strict=True)):
            if share.any():
                chart.line(list(zip(middles, map(float, share), strict=True)), (1, 0, 4)[style], name)
        chart.band(*_allowed(proposed, column), "#009e73", "the proposal")
        for bound in _allowed(now, column):
            if low < bound < high - 1:
                chart.rule(x=bound)
        drawn.append(chart.svg())
    return drawn


def lines(examples: Sequence[Example], proposed: Red, width: int = 64) -> list[str]:
    """The same for a terminal: a row of blocks for each class, and under it what the proposal lets in."""
    lines = []
    for (_, column, low, high), name in zip(_AXES, ("hue", "S", "V"), strict=True):
        edges = np.linspace(low, high, width + 1)
        for title, colours in zip(("marker", "surroundings", "background"), pooled(examples), strict=True):
            share = _share(colours[:, column], edges)
            level = np.ceil(8 * share / share.max()).astype(int) if share.any() else np.zeros(width, int)
            lines.append(f"{name if title == 'marker' else '':4}{title:13}|{''.join(_BLOCKS[n] for n in level)}|")
        allowed = _allowed(proposed, column)
        passes = ((edges[1:] > allowed[0]) & (edges[:-1] <= allowed[1])).tolist()
        lines.append(f"{'':4}{'passes':13}|{''.join('=' if one else ' ' for one in passes)}|")
        lines.append(f"{'':17} {low:<{width - 4}}{high - (1 if column else 0):>4}")
    return lines


def background_by_colour(examples: Sequence[Example]) -> NDArray[np.float64]:
    """(hue bands, S bands): share of all background and surroundings, in percent."""
    colours = np.concatenate([c for e in examples for c in (e.ring, e.far)])
    if not len(colours):
        return np.zeros((len(HUE_BANDS), len(S_BANDS)))
    hue, s = colours[:, 0], colours[:, 1]
    return np.array(
        [
            [100 * float(((hue >= h0) & (hue <= h1) & (s >= s0) & (s <= s1)).mean()) for s0, s1 in S_BANDS]
            for _, h0, h1 in HUE_BANDS
        ]
    )


def _allowed(red: Red, column: int) -> tuple[float, float]:
    return ((-red.hue_low, red.hue_high), (red.s_min, 255), (red.v_min, 255))[column]


def _share(values: NDArray[np.int16], edges: NDArray[np.float64]) -> NDArray[np.float64]:
    counts, _ = np.histogram(values, edges)
    return np.asarray(100 * counts / max(1, len(values)), np.float64)
