"""A small chart as SVG text: axes with round ticks, lines, steps, bars and points. Pure.

Every series differs from the others in dash or marker as well as in colour, so that a grey print can be read.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from itertools import pairwise

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#595959")  # distinguishable by colour-blind eyes, too
DASHES = ("", "6 3", "2 3", "9 3 2 3", "4 2")
MARKS = ("circle", "diamond", "square", "triangle", "cross")
_LEFT, _RIGHT, _TOP, _BOTTOM = 58, 14, 28, 44

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class ChartAxis:
    """One axis; a log axis needs `low` > 0. Values beyond the ends are drawn at the ends."""

    title: str
    low: float
    high: float
    log: bool = False

    def share(self, value: float) -> float:
        """0 at the low end, 1 at the high end."""
        value = min(max(value, self.low), self.high)
        if self.log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def ticks(self) -> list[float]:
        return log_ticks(self.low, self.high) if self.log else round_ticks(self.low, self.high)


@dataclass
class Chart:
    """Draw into it, then take `svg()`. Sizes in CSS px."""

    x: ChartAxis
    y: ChartAxis
    width: int = 460
    height: int = 270
    title: str = ""
    _marks: list[str] = field(default_factory=list)
    _legend: list[tuple[str, int, bool]] = field(default_factory=list)

    def line(self, points: Sequence[Point], style: int, name: str = "", *, step: bool = False) -> None:
        """Joined points; `step`: level until the next point's x, then straight up."""
        places = [self._at(*point) for point in points]
        if step:
            places = [p for a, b in pairwise(places) for p in (a, (b[0], a[1]))] + places[-1:]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
        self._marks.append(
            f'<polyline points="{path}" fill="none" stroke="{_colour(style)}" stroke-width="1.8"'
            f' stroke-dasharray="{DASHES[style % len(DASHES)]}"/>'
        )
        self._named(name, style, dots=False)

    def points(self, points: Sequence[Point], style: int, name: str = "", titles: Sequence[str] = ()) -> None:
        """Markers; a title is shown by the browser when the mouse rests on one."""
        for n, point in enumerate(points):
            title = f"<title>{escape(titles[n])}</title>" if n < len(titles) else ""
            self._marks.append(_mark(*self._at(*point), style, title))
        self._named(name, style, dots=True)

    def bars(self, edges: Sequence[float], heights: Sequence[float], style: int, name: str = "") -> None:
        """A histogram: `edges` has one more than `heights`."""
        floor = self._at(0, self.y.low)[1]
        for low, high, value in zip(edges, edges[1:], heights, strict=False):
            if value <= self.y.low:
                continue
            x0, y = self._at(low, value)
            x1, _ = self._at(high, value)
            self._marks.append(
                f'<rect x="{x0:.1f}" y="{y:.1f}" width="{max(x1 - x0 - 0.6, 0.6):.1f}" height="{floor - y:.1f}"'
                f' fill="{_colour(style)}" fill-opacity=".55" stroke="{_colour(style)}" stroke-width=".6"'
                f' stroke-dasharray="{DASHES[style % len(DASHES)]}"/>'
            )
        self._named(name, style, dots=False)

    def rule(self, *, x: float | None = None, y: float | None = None) -> None:
        """A thin line across the chart at a value that matters."""
        x0, y0 = self._at(self.x.low if x is None else x, self.y.low if y is None else y)
        x1, y1 = self._at(self.x.high if x is None else x, self.y.high if y is None else y)
        self._marks.append(f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" class="rule"/>')

    def band(self, low: float, high: float, colour: str, text: str = "") -> None:
        """A shaded range of x."""
        (x0, y0), (x1, y1) = self._at(low, self.y.low), self._at(high, self.y.high)
        title = f"<title>{escape(text)}</title>" if text else ""
        self._marks.insert(
            0,
            f'<rect x="{x0:.1f}" y="{y1:.1f}" width="{x1 - x0:.1f}" height="{y0 - y1:.1f}" fill="{colour}"'
            f' fill-opacity=".18">{title}</rect>',
        )

    def svg(self) -> str:
        parts = [
            f'<svg class="chart" viewBox="0 0 {self.width} {self.height}" width="{self.width}" role="img"'
            f' aria-label="{escape(self.title or self.y.title)}">'
        ]
        parts += self._grid()
        parts += self._marks
        parts += self._names()
        return "".join([*parts, "</svg>"])

    def _at(self, x: float, y: float) -> Point:
        wide, high = self.width - _LEFT - _RIGHT, self.height - _TOP - _BOTTOM
        return _LEFT + wide * self.x.share(x), _TOP + high * (1 - self.y.share(y))

    def _grid(self) -> list[str]:
        left, right, top, bottom = _LEFT, self.width - _RIGHT, _TOP, self.height - _BOTTOM
        parts = []
        for tick in self.x.ticks():
            x, _ = self._at(tick, self.y.low)
            parts.append(f'<line x1="{x:.1f}" y1="{top}" x2="{x:.1f}" y2="{bottom}" class="grid"/>')
            parts.append(f'<text x="{x:.1f}" y="{bottom + 15}" text-anchor="middle" class="tick">{tick:g}</text>')
        for tick in self.y.ticks():
            _, y = self._at(self.x.low, tick)
            parts.append(f'<line x1="{left}" y1="{y:.1f}" x2="{right}" y2="{y:.1f}" class="grid"/>')
            parts.append(f'<text x="{left - 6}" y="{y + 4:.1f}" text-anchor="end" class="tick">{tick:g}</text>')
        parts.append(f'<path d="M{left} {top}V{bottom}H{right}" class="axis"/>')
        middle_x, middle_y = (left + right) / 2, (top + bottom) / 2
        parts.append(
            f'<text x="{middle_x}" y="{self.height - 8}" text-anchor="middle" class="name">'
            f"{escape(self.x.title)}</text>"
        )
        parts.append(
            f'<text transform="translate(14 {middle_y}) rotate(-90)" text-anchor="middle" class="name">'
            f"{escape(self.y.title)}</text>"
        )
        return parts

    def _names(self) -> list[str]:
        parts = []
        x, y = float(_LEFT), 14
        for name, style, dots in self._legend:  # in a row above the chart, where no point can lie under it
            x += 32
            parts.append(f'<text x="{x:.0f}" y="{y + 4}" class="small legend">{escape(name)}</text>')
            if dots:
                parts.append(_mark(x - 14, y, style, ""))
            else:
                parts.append(
                    f'<line x1="{x - 28:.0f}" y1="{y}" x2="{x - 5:.0f}" y2="{y}" stroke="{_colour(style)}"'
                    f' stroke-width="2.4" stroke-dasharray="{DASHES[style % len(DASHES)]}"/>'
                )
            x += 6.4 * len(name) + 8
        return parts

    def _named(self, name: str, style: int, *, dots: bool) -> None:
        if name:
            self._legend.append((name, style, dots))


def round_ticks(low: float, high: float) -> list[float]:
    """Multiples of 1, 2 or 5 times a power of ten inside [low, high]."""
    rough = (high - low) / 7
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(m * power for m in (1, 2, 5, 10) if m * power >= rough * (1 - 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(n * step, 12) for n in range(first, last + 1)]


def log_ticks(low: float, high: float) -> list[float]:
    """Powers of ten inside [low, high], with 2 and 5 of each where there are few; over less than that, round steps."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    fine = (1, 2, 5) if len(powers) <= 4 else (1,)
    ticks = [round(m * 10.0**p, 12) for p in powers for m in fine]
    inside = [tick for tick in ticks if low * (1 - 1e-9) <= tick <= high * (1 + 1e-9)]
    return inside if len(inside) >= 3 else round_ticks(low, high)


def _colour(style: int) -> str:
    return COLOURS[style % len(COLOURS)]


def _mark(x: float, y: float, style: int, title: str) -> str:
    look = f'fill="{_colour(style)}" fill-opacity=".55" stroke="{_colour(style)}"'
    match MARKS[style % len(MARKS)]:
        case "circle":
            return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.4" {look}>{title}</circle>'
        case "diamond":
            return f'<path d="M{x:.1f} {y - 4.6:.1f}l4.6 4.6-4.6 4.6-4.6-4.6z" {look}>{title}</path>'
        case "square":
            return f'<rect x="{x - 3.2:.1f}" y="{y - 3.2:.1f}" width="6.4" height="6.4" {look}>{title}</rect>'
        case "triangle":
            return f'<path d="M{x:.1f} {y - 4.4:.1f}l4.2 7.6h-8.4z" {look}>{title}</path>'
        case _:
            return f'<path d="M{x - 3.4:.1f} {y - 3.4:.1f}l6.8 6.8m0-6.8l-6.8 6.8" {look}>{title}</path>'
