"""Tables and figure of docs/closed-loop.md and its report, from the file that `python -m bench.closed_loop.campaign`
writes. `./dev docs` calls them."""

import json
from collections.abc import Mapping, Sequence
from functools import cache
from html import escape
from typing import Any

from bench.closed_loop.approach import Aid
from bench.closed_loop.campaign import EXAMPLE, RESULTS
from gateway.core.setpoint import DriveState

WIDTH, LEFT, TOP, PANEL, GAP = 860, 70, 52, 130, 30
STYLE = (
    "text{font:12px sans-serif;fill:#222}.t{font-size:11px;fill:#666}.g{stroke:#ddd;stroke-width:1}"
    "path{fill:none;stroke-width:2}"
)
COLOURS = {Aid.SETPOINT.value: "#0072B2", Aid.PLAIN.value: "#D55E00"}  # of Okabe and Ito
STATES = {
    DriveState.APPROACH: "#009E73",
    DriveState.CREEP: "#F0E442",
    DriveState.SETTLE: "#CC79A7",
    DriveState.AT_PLACE: "#56B4E9",
    DriveState.INHIBITED: "#999999",
}
T_S, TO_GO, SPEED, SETPOINT, STATE = 0, 1, 2, 4, 5  # of a row of the example


@cache
def results() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8"))
    return found


def comparison() -> str:
    found = results()["comparison"]
    heads = (
        "vehicle",
        "driven by",
        "approaches",
        "error, mm: median, 95 % of its amount",
        "later ones: 95 %",
        "past the dead band",
        "past the tolerance",
        "in place",
        "time, s: median, 95 %",
        "by the shortest: median, 95 %",
    )
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for row in found["rows"]:
        middle, most = row["error_mm"]
        cells = (
            row["kind"],
            row["aid"],
            f"{row['approaches']:,}",
            f"{middle:+.0f}, {most:.0f}",
            f"{row['later_p95_mm']:.0f}",
            f"{row['past_band']:.0%}",
            row["past_tolerance"],
            f"{row['in_place']:.0%}",
            ", ".join(f"{s:.0f}" for s in row["time_s"]),
            ", ".join(f"{ratio:.1f}" for ratio in row["ratio"]),
        )
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join([*lines, "", f"Seeds from {found['first_seed']}, which built nothing."])


def faults() -> str:
    found = results()["faults"]
    lines = [
        "| what | driven by | approaches | collisions | in place in the end | farthest past the mark, mm |",
        "|---" * 6 + "|",
    ]
    for row in found["rows"]:
        lines.append(
            f"| {row['kind']} | {row['aid']} | {row['approaches']:,} | {row['collisions']} | {row['in_place']:.0%} "
            f"| {row['deepest_mm']:.0f} |"
        )
    return "\n".join([*lines, "", f"One to three faults in each, seeds from {found['first_seed']}."])


def figures() -> dict[str, str]:
    return {"closed-loop-approach": _approach(results()["comparison"]["example"])}


def _approach(example: Mapping[str, Sequence[Sequence[float]]]) -> str:
    """Distance, speed and setpoint over time, of one vehicle by both programs; below, the states of the drive."""
    end_s = max(rows[-1][T_S] for rows in example.values())
    far_mm = max(row[TO_GO] for rows in example.values() for row in rows)
    fast = max(row[column] for rows in example.values() for row in rows for column in (SPEED, SETPOINT))
    panels = (("to the place, mm", TO_GO, 0.0, far_mm), ("the last of it, mm", TO_GO, -50.0, 100.0),
              ("speed, mm/s", SPEED, 0.0, fast))  # fmt: skip
    height = TOP + len(panels) * (PANEL + GAP) + 60
    scale = (WIDTH - LEFT - 20) / end_s
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" role="img">',
        f"<title>One approach of a {EXAMPLE[0].value}, by the setpoint and by a plain program</title>"
        f"<style>{STYLE}</style>",
        f'<rect width="{WIDTH}" height="{height}" fill="#fff"/>',
    ]
    for n, (name, colour) in enumerate(COLOURS.items()):
        at = LEFT + 240 * n
        out.append(f'<path d="M{at} 14h26" stroke="{colour}"/><text x="{at + 32}" y="18">{escape(name)}</text>')
    for n, (name, column, low, high) in enumerate(panels):
        top = TOP + n * (PANEL + GAP)
        out += _axis(name, top, low, high)
        for aid, rows in example.items():
            points = [(row[T_S], row[column]) for row in rows]
            out.append(_line(points, COLOURS[aid], scale, top, low, high, ""))
        if column == SPEED:
            rows = example[Aid.SETPOINT.value]
            points = [(row[T_S], row[SETPOINT]) for row in rows]
            out.append(_line(points, "#000", scale, top, low, high, ' stroke-dasharray="4 3" style="stroke-width:1"'))
            out.append(
                f'<text class="t" x="{WIDTH - 20}" y="{top + 14}" text-anchor="end">dashed: speed_setpoint</text>'
            )
    foot = TOP + len(panels) * (PANEL + GAP)
    out += _states(example[Aid.SETPOINT.value], scale, foot)
    step = 10 if end_s > 40 else 5
    for t_s in range(0, int(end_s) + 1, step):
        x = LEFT + t_s * scale
        out.append(f'<text class="t" x="{x:.1f}" y="{foot + 42}" text-anchor="middle">{t_s} s</text>')
    return "\n".join([*out, "</svg>"]) + "\n"


def _axis(name: str, top: int, low: float, high: float) -> list[str]:
    out = [f'<text x="{LEFT}" y="{top - 6}">{escape(name)}</text>']
    for value in (low, 0.0, high) if low else (low, high):
        y = top + PANEL * (high - value) / (high - low)
        out.append(f'<path class="g" d="M{LEFT} {y:.1f}H{WIDTH - 20}"/>')
        out.append(f'<text class="t" x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{value:.0f}</text>')
    return out


def _line(
    points: Sequence[tuple[float, float]], colour: str, scale: float, top: int, low: float, high: float, more: str
) -> str:
    at = [
        f"{LEFT + t_s * scale:.1f} {top + PANEL * (high - min(high, max(low, value))) / (high - low):.1f}"
        for t_s, value in points
    ]
    return f'<path stroke="{colour}"{more} d="M{"L".join(at)}"/>'


def _states(rows: Sequence[Sequence[float]], scale: float, top: int) -> list[str]:
    """A bar for each state of the drive."""
    out = [f'<text class="t" x="{LEFT - 6}" y="{top + 14}" text-anchor="end">state</text>']
    begin = 0
    for n in range(1, len(rows) + 1):
        if n < len(rows) and rows[n][STATE] == rows[begin][STATE]:
            continue
        state = DriveState(int(rows[begin][STATE]))
        x, width = LEFT + rows[begin][T_S] * scale, (rows[n - 1][T_S] - rows[begin][T_S]) * scale
        out.append(f'<rect x="{x:.1f}" y="{top}" width="{width:.1f}" height="20" fill="{STATES.get(state, "#ddd")}"/>')
        if width > 9 * len(state.name):
            out.append(f'<text x="{x + 4:.1f}" y="{top + 14}">{state.name}</text>')
        begin = n
    return out
