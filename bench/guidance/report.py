"""Tables and plots of bench/reports/guidance.md, from the result file that `python -m bench.guidance.campaign` writes.

.dev/uv/bin/uv sync --frozen --group bench       once: matplotlib
python -m bench.guidance.report                  the plots; `./dev docs` writes the tables
"""

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from bench.guidance.campaign import BIN_MM, BIN_S, GRID, RESULTS, best
from bench.guidance.driver import Aid
from gateway.vision.offline.evaluation.scoring import wilson

TOLD_APART_P = 0.05
IMAGES = RESULTS.parents[1] / "images"
# Of Okabe and Ito, told apart by people with any colour vision; the bell's line is dashed as well.
STYLES: Mapping[str, dict[str, Any]] = {
    Aid.DISPLAY.value: {"color": "#0072B2", "lw": 2, "label": "display"},
    Aid.BELL.value: {"color": "#D55E00", "lw": 2, "ls": "--", "label": "bell only"},
}
SIGNS = {
    "FORWARD": "#009E73",
    "SLOW": "#F0E442",
    "STOP": "#CC79A7",  # not the bell's colour
    "TOO_FAR": "#CC79A7",
    "BACK": "#E69F00",
    "OK": "#56B4E9",
}
GRID_COLOURS = dict(zip(GRID["slow_mm"], ("#0072B2", "#D55E00", "#000000"), strict=True))


def results() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8"))
    return found


def comparison() -> str:
    lines = [
        "| driver | shown | in place | past the tolerance | end of the way | error, cm: 5 %, median, 95 % "
        "| time, s: median, 95 % | corrections | overshoots |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    found = results()["comparison"]
    for row in found["rows"]:
        error = ", ".join(f"{mm / 10:+.1f}" for mm in row["error_mm"])
        times = ", ".join(f"{s:.0f}" for s in row["time_s"] or ())
        lines.append(
            f"| {row['profile']} | {row['aid']} | {row['in_place']:.0%} | {row['overshot']:.0%} "
            f"| {row['collided']:.0%} | {error} | {times} | {row['corrections']:.2f} | {row['overshoots']:.2f} |"
        )
    count, first = found["rows"][0]["approaches"], found["first_seed"]
    ends = f"{count:,} approaches a row, seeds {first} to {first + count - 1}, which chose no threshold"
    return "\n".join([*lines, "", f"{ends}; {found['simulated_h']:.0f} hours of driving."])


def grid() -> str:
    """A row for each slow_mm and slow_s, a column for each stop_lead_s."""
    rows = results()["grid"]["rows"]
    chosen = best(rows)
    leads = sorted({row["stop_lead_s"] for row in rows})
    cells = {
        (row["slow_mm"], row["slow_s"], row["stop_lead_s"]): _cell(row, row is chosen, len(rows) - 1) for row in rows
    }
    head = " | ".join(f"stop_lead_s {lead:g}" for lead in leads)
    lines = [f"| slow_mm | slow_s | {head} |", "|---" * (2 + len(leads)) + "|"]
    for slow_mm, slow_s in sorted({(row["slow_mm"], row["slow_s"]) for row in rows}):
        values = " | ".join(cells[slow_mm, slow_s, lead] for lead in leads)
        lines.append(f"| {slow_mm:g} | {slow_s:g} | {values} |")
    return "\n".join([*lines, "", f"{rows[0]['approaches']} approaches a cell, of all four drivers together."])


def against() -> str:
    found = results()["against"]
    settings = ", ".join(f"`{key}` {value:g}" for key, value in found["settings"].items())
    here, there, first = found["past_only_here"], found["past_only_there"], found["first_seed"]
    return (
        f"Of {found['approaches']:,} drivers whose seeds chose no threshold (from {first} on), {here} came past the "
        f"tolerance only with {settings}, and {there} only with the defaults (p {mcnemar(here, there):.2g})."
    )


def _cell(row: Mapping[str, Any], chosen: bool, compared: int) -> str:
    """`compared`: so many are compared with the chosen one (Bonferroni)."""
    text = f"{row['overshot']:.0%}, {row['time_s'][0]:.0f} s"
    if chosen:
        return f"**{text}**"
    return text if mcnemar(row["past_only_here"], row["past_only_there"]) * compared < TOLD_APART_P else f"*{text}*"


def mcnemar(only_one: int, only_other: int) -> float:
    """p-value, exact, two-sided: of a split so uneven of the pairs that differ, if both ways are as likely."""
    pairs = only_one + only_other
    tail: float = sum(math.comb(pairs, n) for n in range(min(only_one, only_other) + 1)) / 2**pairs
    return min(1.0, 2 * tail)


def plots(folder: Path) -> None:
    """The pictures of bench/reports/guidance.md. Needs matplotlib."""
    import matplotlib as mpl  # noqa: PLC0415 - only for the plots: `./dev docs` does without

    mpl.use("Agg")
    mpl.rcParams |= {"svg.hashsalt": "guidance", "font.size": 10, "axes.spines.top": False, "axes.spines.right": False}
    from matplotlib import pyplot as plt  # noqa: PLC0415

    found = results()
    for name, draw in (("error", _errors), ("time", _times), ("example", _example), ("thresholds", _thresholds)):
        figure = draw(plt, found)
        figure.savefig(folder / f"guidance-{name}.svg", metadata={"Date": None}, facecolor="white")
        plt.close(figure)


def _panels(plt: Any, found: Mapping[str, Any], draw: Callable[[Any, Mapping[str, Any], dict[str, Any]], None]) -> Any:
    """One for each driver, the display and the bell in each."""
    rows = found["comparison"]["rows"]
    profiles = list(dict.fromkeys(row["profile"] for row in rows))
    figure, grid = plt.subplots(2, 2, figsize=(9, 5.6), sharex=True, sharey=True, layout="constrained")
    for axis, profile in zip(grid.flat, profiles, strict=True):
        for row in rows:
            if row["profile"] == profile:
                draw(axis, row, STYLES[row["aid"]])
        axis.set_title(f"{profile} driver", fontsize=10, loc="left")
        axis.set_ylim(0, 1.02)
        axis.yaxis.set_major_formatter(lambda share, _: f"{share:.0%}")
        axis.grid(alpha=0.3)
    grid[0, 0].legend(fontsize=9, loc="upper left")
    return figure


def _shares(bins: Mapping[str, int], width: int, of: int) -> tuple[list[float], list[float]]:
    """Upper edge of each bin, and the share up to there."""
    edges: list[float] = []
    shares: list[float] = []
    sum_ = 0
    for edge, count in sorted((int(edge), count) for edge, count in bins.items()):
        edges += [edge, edge + width]
        shares += [sum_ / of, (sum_ + count) / of]
        sum_ += count
    return edges, shares


def _errors(plt: Any, found: Mapping[str, Any]) -> Any:
    tolerance_cm = found["comparison"]["settings"]["overshoot_mm"] / 10

    def draw(axis: Any, row: Mapping[str, Any], style: dict[str, Any]) -> None:
        mm, shares = _shares(row["errors"], BIN_MM, row["approaches"])
        axis.plot([-30, *(at / 10 for at in mm), 30], [0, *shares, shares[-1]], **style)
        axis.set_xlim(-27, 10)

    figure = _panels(plt, found, draw)
    for axis in figure.axes:
        axis.axvspan(-tolerance_cm, 0, color="#009E73", alpha=0.15, lw=0, zorder=0)
    figure.axes[0].text(-tolerance_cm / 2, 0.04, "tolerance", ha="center", fontsize=9)
    figure.supxlabel(
        "final error: true Z - Z_th, cm (left of 0: past the mark; -25.5: at the end of the way)", fontsize=10
    )
    figure.supylabel("approaches that end so far in, or farther", fontsize=10)
    return figure


def _times(plt: Any, found: Mapping[str, Any]) -> Any:
    def draw(axis: Any, row: Mapping[str, Any], style: dict[str, Any]) -> None:
        times, shares = _shares(row["times"], BIN_S, row["approaches"])
        axis.plot([0, *times, 120], [0, *shares, shares[-1]], **style)
        axis.set_xlim(0, 70)

    figure = _panels(plt, found, draw)
    figure.supxlabel("time from the first motion, s", fontsize=10)
    figure.supylabel("approaches that stand in place, to stay", fontsize=10)
    return figure


def _example(plt: Any, found: Mapping[str, Any]) -> Any:
    example = found["comparison"]["example"]
    tolerance_cm = found["comparison"]["settings"]["overshoot_mm"] / 10
    figure, (way, near, signs) = plt.subplots(
        3, 1, figsize=(9, 6), sharex=True, height_ratios=(2, 2, 0.7), layout="constrained"
    )
    for aid, style in STYLES.items():
        t_s, cm = [row[0] for row in example[aid]], [row[1] / 10 for row in example[aid]]
        for axis in (way, near):
            axis.plot(t_s, cm, **style)
    end_s = max(example[aid][-1][0] for aid in STYLES)
    for axis in (way, near):
        axis.axhspan(-tolerance_cm, 0, color="#009E73", alpha=0.15, lw=0)
        axis.grid(alpha=0.3)
    way.set_ylabel("to the mark, cm")
    way.legend(fontsize=9)
    near.set_ylabel("the last of it, cm")
    near.set_ylim(-27, 30)
    near.text(0.2, -tolerance_cm / 2, "tolerance", va="center", fontsize=9)
    shown = example[Aid.DISPLAY.value]
    begins = [n for n, row in enumerate(shown) if n == 0 or row[2] != shown[n - 1][2]]
    for first, after in zip(begins, [*begins[1:], len(shown) - 1], strict=True):
        sign, from_s, to_s = shown[first][2], shown[first][0], shown[after][0]
        signs.axvspan(from_s, to_s, color=SIGNS.get(sign, "#999999"), alpha=0.55, lw=0)
        word, share = "IN PLACE" if sign == "OK" else sign, (to_s - from_s) / end_s
        if share > 0.03:
            signs.text((from_s + to_s) / 2, 0.5, word, ha="center", va="center", fontsize=9 if share > 0.07 else 7)
        else:  # no room in it
            signs.text(from_s, 1.04, word, va="bottom", fontsize=7)
    signs.set_yticks([])
    signs.set_ylabel("display")
    signs.set_xlabel("time, s")
    signs.set_xlim(0, end_s)
    return figure


def _thresholds(plt: Any, found: Mapping[str, Any]) -> Any:
    rows = found["grid"]["rows"]
    leads = sorted({row["stop_lead_s"] for row in rows})
    pairs = sorted({(row["slow_mm"], row["slow_s"]) for row in rows})
    markers = dict(zip(GRID["slow_s"], "os^", strict=True))
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    for n, (slow_mm, slow_s) in enumerate(pairs):
        those = sorted(
            (row for row in rows if (row["slow_mm"], row["slow_s"]) == (slow_mm, slow_s)),
            key=lambda row: row["stop_lead_s"],
        )
        at = [leads.index(row["stop_lead_s"]) + 0.08 * (n - (len(pairs) - 1) / 2) for row in those]  # beside each other
        shares = [row["overshot"] for row in those]
        ends = [wilson(round(row["overshot"] * row["approaches"]), row["approaches"]) for row in those]
        bars = [[share - low for share, (low, _) in zip(shares, ends, strict=True)],
                [high - share for share, (_, high) in zip(shares, ends, strict=True)]]  # fmt: skip
        style = {
            "fmt": markers[slow_s],
            "ms": 4,
            "lw": 0.8,
            "color": GRID_COLOURS[slow_mm],
        }
        axes[0].errorbar(at, shares, yerr=bars, label=f"slow_mm {slow_mm:g}, slow_s {slow_s:g}", **style)
        axes[1].errorbar(at, [row["time_s"][0] for row in those], **style)
    axes[0].set_ylabel("past the tolerance, and 95 % interval")
    axes[0].yaxis.set_major_formatter(lambda share, _: f"{share:.0%}")
    axes[0].set_ylim(0, 1)
    axes[1].set_ylabel("time to the place, median, s")
    axes[1].set_ylim(bottom=0)
    for axis in axes:
        axis.set_xticks(range(len(leads)), [f"{lead:g}" for lead in leads])
        axis.set_xlabel("stop_lead_s, s")
        axis.grid(axis="y", alpha=0.3)
    figure.legend(fontsize=8, loc="outside lower center", ncols=3)
    return figure


if __name__ == "__main__":
    plots(IMAGES)
