"""The tables of an evaluation. Pure."""

from collections.abc import Callable, Sequence

from gateway.vision.offline.evaluation.scoring import Scores
from gateway.vision.offline.evaluation.stress import FOUND, Stressed
from gateway.vision.offline.evaluation.summary import Summary
from gateway.vision.offline.reports.tables import Cell, ReportTable, Row, faults, number, percent

ALL_FRAMES = "(all frames)"  # a sequence without a name
RATES = 6  # columns after the first; the errors follow
_COLUMNS: tuple[tuple[str, Callable[[Scores], Cell]], ...] = (
    ("pictures", lambda f: str(f.pictures)),
    ("found %", lambda f: percent(f.detected_share)),
    ("in 5 %", lambda f: percent(f.close_share)),
    ("wrong", lambda f: faults(f.wrong if f.with_marker else None)),
    ("missed", lambda f: str(f.missed) if f.with_marker else "–"),
    ("false", lambda f: faults(f.false if f.without else None)),
    ("centre px", lambda f: number(f.centre_median_px)),
    ("p95", lambda f: number(f.centre_p95_px)),
    ("radius %", lambda f: number(f.radius_median_pct)),
    ("p95", lambda f: number(f.radius_p95_pct)),
    ("bias", lambda f: number(f.radius_bias_pct)),
    ("ms", lambda f: number(f.ms_median)),
)


def parts(result: Summary) -> ReportTable:
    """The set, its halves and its groups. Centre and radius: median, p95 and bias."""
    named = [("whole", "whole set", result.total)]
    named += [("half", name, part) for name, part in result.halves.items()]
    named += [("", name, part) for name, part in result.groups.items()]
    rows: list[Row] = [(style, [name, *(cell(part) for _, cell in _COLUMNS)]) for style, name, part in named]
    return ReportTable(f"Method {result.method}", ("part", *(head for head, _ in _COLUMNS)), rows)


def side_by_side(results: Sequence[Summary]) -> ReportTable:
    """A row a group and method, and the whole set at the end. Centre and radius: median and p95."""
    heads = ("condition", "method", "found", "wrong", "false", "centre px", "p95", "radius %", "p95", "ms")
    names = [*results[0].groups, "all"]
    rows: list[Row] = []
    for name in names:
        for n, result in enumerate(results):
            f = result.groups.get(name, result.total)
            found = f"{f.on_target} of {f.with_marker}" if f.with_marker else "–"
            wrong = faults(f.wrong if f.with_marker else None)
            false: Cell = (f"{f.false} of {f.without}", "bad" if f.false else "good") if f.without else "–"
            errors = (f.centre_median_px, f.centre_p95_px, f.radius_median_pct, f.radius_p95_pct, f.ms_median)
            start = (name if n == 0 else "", (result.method, "left"), found, wrong, false)
            rows.append(("whole" if name == names[-1] else "", [*start, *map(number, errors)]))
    return ReportTable("Benchmark", heads, rows)


def sequences(result: Summary) -> ReportTable:
    heads = ("sequence", "frames", "after", "found %", "in 5 %", "wrong", "coasted", "p95 px")
    rows: list[Row] = []
    for found in result.sequences:
        start = (found.series or ALL_FRAMES, str(found.frames))
        if (f := found.after) is None:
            rows.append(("", [*start, ("never", "bad"), *["–"] * 5]))
            continue
        rates = (percent(f.detected_share), percent(f.close_share), faults(f.wrong), str(f.coasted))
        rows.append(("", [*start, str(found.acquired_after), *rates, number(f.centre_p95_px)]))
    return ReportTable(f"Followed from frame to frame, method {result.method}: since the first on target", heads, rows)


def constancy(result: Summary) -> ReportTable:
    heads = ("series", "pictures", "px cm", "typical", "largest", "labels", "offset cm", "with it")
    rows: list[Row] = []
    for part in result.constancy:
        deviations = [f"{x:.2f}" for x in (part.typical_pct, part.largest_pct, part.label_largest_pct)]
        offset = ["–" if part.offset_cm is None else f"{part.offset_cm:+.1f}", number(part.largest_with_offset_pct)]
        start = (part.series or "(all)", str(part.pictures), f"{part.median_px_cm:.0f}")
        rows.append(("", [*start, *deviations, *offset]))
    return ReportTable(f"R times Z, method {result.method}: deviation from the median, %", heads, rows)


def stressed(result: Stressed) -> ReportTable:
    """A row a strength; those that can't be relied on are marked."""
    heads = ("stress", "strength", "veil %", "found %", "wrong", "false", "centre px", "p95", "radius %", "p95")
    rows: list[Row] = []
    for level in result.levels:
        f = level.scores
        found: Cell = percent(f.detected_share)
        if f.detected_share is not None and f.detected_share < FOUND:
            found = (percent(f.detected_share), "bad")
        counts = (faults(f.wrong if f.with_marker else None), faults(f.false if f.without else None))
        errors = (f.centre_median_px, f.centre_p95_px, f.radius_median_pct, f.radius_p95_pct)
        style = "" if level.reliable else "faint"
        rows.append(
            (style, [level.kind, f"{level.strength:g}", percent(level.veil), found, *counts, *map(number, errors)])
        )
    return ReportTable(f"Through dust and in other light, method {result.method}", heads, rows)
