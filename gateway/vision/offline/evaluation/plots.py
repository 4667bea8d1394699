"""The charts of an evaluation's report. Pure; each returns SVG, or "" where there is nothing to draw."""

from collections.abc import Sequence

import numpy as np

from gateway.vision.offline.evaluation.scoring import CLOSE, ScoredPicture
from gateway.vision.offline.evaluation.stress import DUST, FOUND, Stressed
from gateway.vision.offline.evaluation.summary import SeriesOf, Summary
from gateway.vision.offline.reports.chart import Chart, ChartAxis, Point

Named = tuple[Point, str]  # a point and its title
_FLOOR_PX, _CEILING_PX = 0.01, 1000.0


def centre_errors(results: Sequence[Summary]) -> str:
    """Cumulative share of the pictures with a marker against the centre's error; a miss never arrives."""
    chart = Chart(
        ChartAxis("centre error, px", _FLOOR_PX, _CEILING_PX, log=True),
        ChartAxis("pictures with a marker, %", 0, 100),
        title="centre error, cumulative",
    )
    drawn = False
    for style, result in enumerate(results):
        errors = sorted(o.centre_px for o in result.outcomes if o.centre_px is not None)
        if not errors or not result.total.with_marker:
            continue
        drawn = True
        share = 100 / result.total.with_marker
        points = [(_FLOOR_PX, 0.0), *((error, share * (n + 1)) for n, error in enumerate(errors))]
        chart.line([*points, (_CEILING_PX, points[-1][1])], style, result.method, step=True)
    return chart.svg() if drawn else ""


def radius_errors(results: Sequence[Summary]) -> str:
    """Histogram of the signed radius error of answers on the target."""
    shares = [[100 * o.radius_share for o in r.outcomes if o.on_target and o.radius_share is not None] for r in results]
    every = [value for values in shares for value in values]
    if not every:
        return ""
    reach = min(25.0, max(1.0, float(np.ceil(np.percentile(np.abs(every), 98)))))
    edges = np.linspace(-reach, reach, 41)
    counts = [np.histogram(np.clip(values, -reach, reach), edges)[0] for values in shares]
    top = max(1, int(max(count.max() for count in counts)))
    chart = Chart(
        ChartAxis("radius error, %", -reach, reach), ChartAxis("pictures", 0, top * 1.08), title="radius error"
    )
    chart.rule(x=0)
    for style, (result, count) in enumerate(zip(results, counts, strict=True)):
        chart.bars(list(map(float, edges)), list(map(float, count)), style, result.method)
    return chart.svg()


def radius_against_truth(results: Sequence[Summary]) -> str:
    """Signed radius error of answers on the target against the true radius."""
    points = [[_radius_point(o) for o in r.outcomes if o.on_target] for r in results]
    flat = [point for found in points for point, _ in found]
    if not flat:
        return ""
    low, high = min(x for x, _ in flat), max(x for x, _ in flat)
    reach = min(25.0, max(1.0, max(abs(y) for _, y in flat) * 1.1))
    x, y = ChartAxis("true radius, px", low / 1.15, high * 1.15, log=True), ChartAxis("radius error, %", -reach, reach)
    return _scatter(results, points, Chart(x, y, title="radius error against radius"), 100 * CLOSE)


def r_times_z(results: Sequence[Summary], series: SeriesOf) -> str:
    """R Z over its series' median, against Z."""
    found: list[list[Named]] = []
    for result in results:
        medians = {part.series: part.median_px_cm for part in result.constancy}
        rows = []
        for o in result.outcomes:
            middle, z_cm = medians.get(series(o.label)), o.label.z_cm
            if middle and z_cm and o.on_target and o.detection.circle is not None:
                stray = 100 * (o.detection.circle.radius_px * z_cm / middle - 1)
                rows.append(((z_cm, stray), f"{o.label.file}: {stray:+.2f} %"))
        found.append(rows)
    flat = [point for rows in found for point, _ in rows]
    if len({x for x, _ in flat}) < 2:
        return ""
    reach = min(30.0, max(1.5, max(abs(y) for _, y in flat) * 1.1))
    high = max(x for x, _ in flat) * 1.05
    x, y = ChartAxis("distance Z, cm", 0, high), ChartAxis("R Z against its median, %", -reach, reach)
    return _scatter(results, found, Chart(x, y, title="R times Z"), 1)


def sequence(result: Summary, name: str, series: SeriesOf) -> str:
    """Centre error against the frame number of one sequence; what is missed leaves a gap and a mark at the top."""
    frames = [(o.label.frame, o.centre_px) for o in result.outcomes if series(o.label) == name and o.label.found]
    rows = sorted(
        ((frame, error) for frame, error in frames if frame is not None), key=lambda row: row[0]
    )  # not by the error, which may be None
    if len({frame for frame, _ in rows}) < 2:
        return ""
    top = max([1.0, *(error for _, error in rows if error is not None)])
    y = ChartAxis("centre error, px", 0, top * 1.1)
    chart = Chart(ChartAxis("frame", rows[0][0], rows[-1][0]), y, width=940, height=230, title=name)
    piece: list[tuple[float, float]] = []
    for frame, error in [*rows, (0, None)]:
        if error is not None:
            piece.append((frame, error))
        elif piece:
            chart.line(piece, 0)
            piece = []
    missed = [(float(frame), top * 1.05) for frame, error in rows if error is None]
    chart.points(missed, 1, "", [f"frame {frame:.0f}: no answer" for frame, _ in missed])
    return chart.svg()


def found_in_dust(results: Sequence[Stressed]) -> str:
    """Share of the markers found against the share of airlight."""
    chart = Chart(
        ChartAxis("share of airlight", min(DUST.strengths), max(DUST.strengths)),
        ChartAxis("pictures with a marker, %", 0, 100),
        title="found in dust",
    )
    chart.rule(y=100 * FOUND)
    drawn = False
    for style, result in enumerate(results):
        levels = [level for level in result.levels if level.kind == DUST.name]
        points = [(x.strength, 100 * x.scores.detected_share) for x in levels if x.scores.detected_share is not None]
        if points:
            drawn = True
            chart.line(points, style, result.method)
    return chart.svg() if drawn else ""


def _scatter(results: Sequence[Summary], found: Sequence[Sequence[Named]], chart: Chart, level: float) -> str:
    """With lines at 0 and at `level` to either side, where the chart reaches so far."""
    for y in (-level, 0, level):
        if abs(y) <= chart.y.high:
            chart.rule(y=y)
    for style, (result, rows) in enumerate(zip(results, found, strict=True)):
        chart.points([point for point, _ in rows], style, result.method, [name for _, name in rows])
    return chart.svg()


def _radius_point(outcome: ScoredPicture) -> Named:
    share = 100 * (outcome.radius_share or 0)
    return (outcome.label.major_px or 1.0, share), f"{outcome.label.file}: {share:+.2f} %"
