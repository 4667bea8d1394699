"""An answer as one HTML file: plots, pictures, the chain of causes; it opens without a network. Pure."""

import json
from collections.abc import Sequence

import cv2
import numpy as np

from gateway.core.detection import Circle
from gateway.core.readings import RangeReading, VisionReading
from gateway.core.state import StateVector
from gateway.durations import NS_PER_S
from gateway.errors import ProtocolError
from gateway.records import account, picture_search
from gateway.records.chain import Link
from gateway.records.days import machine_zone_name
from gateway.records.inquiry import Answer
from gateway.records.moment import clock, shown, unix_ns
from gateway.records.segment import RecordedPicture
from gateway.vision.offline.reports.chart import Chart, ChartAxis
from gateway.vision.offline.reports.page import embed, figure, page, plain, table, tile
from gateway.vision.offline.reports.tables import ReportTable, Row

MOST_PICTURES = 16
PICTURE_WIDTH = 640  # px; larger ones are made smaller
CHART_WIDTH = 1100
_STOP, _MAY_MOVE, _IN_PLACE, _NOTHING = "#d55e00", "#009e73", "#0072b2", "#595959"

Point = tuple[float, float]
STYLE = "<style>.text td{white-space:normal;vertical-align:top}.text td:nth-child(-n+2){white-space:pre}</style>"


def html(answer: Answer, pictures: Sequence[RecordedPicture], made: str) -> str:
    """The complete page. `pictures`: of the window, in their order; the nearest to the moment are shown."""
    head = answer.head
    title = f"{head.bay}, {shown(answer.at_ns)}"
    body = [
        STYLE,
        f"<h1>{plain(title)}</h1>",
        f'<p class="soft">{plain(f"{head.site}.{head.instance}, gateway {head.gateway_version}")}, '
        f"<span>times of</span> {plain(machine_zone_name())}</p>",
        f"<p><strong>{plain(account.headline(answer))}</strong></p>",
        *(f'<p><strong class="warn">{plain(text)}</strong></p>' for text in account.warnings(answer)),
    ]
    if answer.state is not None:
        body.append(_tiles(answer, answer.state))
    if len(answer.causes) > 1:
        besides = "".join(f"<li>{plain(cause.text)}</li>" for cause in answer.causes[1:])
        body.append(f'<h3>Besides</h3><ul class="notes">{besides}</ul>')
    body += ["<h2>How it came about</h2>", _chain(answer.chain) or "<p>No change is recorded.</p>"]
    if answer.after:
        body += ["<h2>And then</h2>", _chain(answer.after)]
    body += ["<h2>Measured values and outputs</h2>", *_plots(answer)]
    body += ["<h2>Pictures</h2>", *_pictures(answer, pictures)]
    if answer.state is not None:
        rows = [*account.outputs(answer.state), *account.sensors(answer, answer.state)]
        body += ["<h2>State vector</h2>", _pairs(rows)]
    body += ["<h2>Who did what</h2>", _timed(account.done_by(answer)) or "<p>Nobody wrote or changed anything.</p>"]
    body += ["<h2>Events</h2>", _timed(account.happened(answer)) or "<p>None.</p>"]
    body += ["<h2>Configuration in force</h2>", _pairs(account.settings(answer))]
    body.append(
        f"<details><summary>The bay's complete configuration</summary><pre>{plain(head.config)}</pre></details>"
    )
    return page(title, [*body, _said(answer)], made)


def _said(answer: Answer) -> str:
    """What the history page reads to give the report in its language (history/report.js)."""
    texts = json.dumps(account.said(answer)).replace("<", "\\u003c")
    return f'<script type="application/json" id="said">{texts}</script>'


def _tiles(answer: Answer, state: StateVector) -> str:
    tiles = [
        tile("on" if state.stop else "off", "stop", "bad" if state.stop else "plain"),
        tile("on" if state.may_move else "off", "may_move", "good" if state.may_move else "plain"),
        tile("on" if state.in_place else "off", "in_place", "good" if state.in_place else "plain"),
        tile(str(state.reason.value), f"{state.reason.name.lower()}: <span>{plain(state.reason.meaning)}</span>"),
    ]
    if answer.since_ns is not None:
        lasted_s = (answer.at_ns - answer.since_ns) / NS_PER_S
        tiles.append(tile(f"{lasted_s:.1f} s", f"<span>stop and may_move so since</span> {clock(answer.since_ns)}"))
    return f'<div class="tiles">{"".join(tiles)}</div>'


def _chain(links: Sequence[Link]) -> str:
    if not links:
        return ""
    rows: list[Row] = [
        ("whole" if link.what else "", (clock(link.unix_ns), _left(link.what.replace(", ", "\n")), *_reasons(link)))
        for link in links
    ]
    found = table(ReportTable("", ("time", "", "", ""), rows), titled=False)
    return f'<div class="text">{found}</div>'


def _reasons(link: Link) -> tuple[tuple[str, str], tuple[str, str]]:
    return _left(link.by), _left(link.why)


def _left(text: str) -> tuple[str, str]:
    return text, "left"


def _pairs(rows: Sequence[tuple[str, str]]) -> str:
    return table(ReportTable("", ("", ""), [("", (name, _left(text))) for name, text in rows]), titled=False)


def _timed(rows: Sequence[tuple[int, str]]) -> str:
    found: list[Row] = [("", (clock(at_ns), _left(text))) for at_ns, text in rows]
    return table(ReportTable("", ("time", ""), found), titled=False) if found else ""


# -- plots -------------------------------------------------------------------------------------------------------------


def _plots(answer: Answer) -> list[str]:
    """R and Z with their thresholds and the outputs, seconds before and after the moment."""
    radii: list[Point] = []
    distances: list[Point] = []
    outputs: list[list[tuple[float, StateVector]]] = []  # a list of its own from each new beginning on
    for step in answer.steps:
        t_s = (unix_ns(step.place.head, step.state.t_ns) - answer.at_ns) / NS_PER_S
        match step.observation:
            case VisionReading(circle=Circle() as circle):
                radii.append((t_s, circle.radius_px))
            case RangeReading(distance_mm=float() as distance_mm):
                distances.append((t_s, distance_mm))
        if step.observation is None or not outputs:
            outputs.append([])
        outputs[-1].append((t_s, step.state))
    begin_s, end_s = ((t_ns - answer.at_ns) / NS_PER_S for t_ns in (answer.begin_ns, answer.end_ns))
    time = ChartAxis("seconds from the moment asked for", begin_s, end_s)
    recipe = 0 if answer.state is None else answer.state.plc.recipe
    fusion = answer.rules.recipes.get(recipe, answer.rules.recipes[0]).fusion
    found = [
        _values(time, "R, px", radii, fusion.radius_threshold_px, "R_th"),
        _values(time, "Z, mm", distances, fusion.distance_threshold_mm, "Z_th"),
        _outputs(time, outputs),
    ]
    captions = (
        "R of every frame with a marker. Orange: stop was on; green: may_move was on.",
        "Z of every good distance.",
        "The outputs after each step.",
    )
    for chart in found[:2]:
        for part in outputs:
            _shade(chart, part)
    for chart in found:
        chart.rule(x=0.0)
    return [figure(chart.svg(), caption) for chart, caption in zip(found, captions, strict=True)]


def _values(time: ChartAxis, title: str, points: list[Point], threshold: float, name: str) -> Chart:
    high = max([threshold, *(value for _, value in points)]) * 1.1
    chart = Chart(time, ChartAxis(title, 0.0, high), width=CHART_WIDTH, height=230, title=title)
    for part in _unbroken(points):
        chart.line(part, 0)
    chart.rule(y=threshold)
    chart.line([(time.low, threshold), (time.low, threshold)], 4, f"{name} {threshold:g}")
    return chart


def _unbroken(points: list[Point]) -> list[list[Point]]:
    """Lines between values that follow each other within a second; across a silence there is none."""
    parts: list[list[Point]] = []
    for point in points:
        if not parts or point[0] - parts[-1][-1][0] > 1.0:
            parts.append([])
        parts[-1].append(point)
    return parts


def _outputs(time: ChartAxis, outputs: list[list[tuple[float, StateVector]]]) -> Chart:
    chart = Chart(time, ChartAxis("", 0.0, 3.4), width=CHART_WIDTH, height=150, title="outputs")
    for row, name in enumerate(("stop", "may_move", "in_place")):
        for part in outputs:
            points: list[Point] = []
            for t_s, state in part:
                level = 2.3 - 1.1 * row + 0.8 * bool(getattr(state, name))
                if not points or points[-1][1] != level:
                    points.append((t_s, level))
            points.append((part[-1][0], points[-1][1]))
            chart.line(points, (1, 2, 0)[row], name if part is outputs[0] else "", step=True)
    return chart


def _shade(chart: Chart, outputs: list[tuple[float, StateVector]]) -> None:
    begin: tuple[float, str] | None = None
    for t_s, state in outputs:
        colour = _MAY_MOVE if state.may_move else _STOP if state.stop else _NOTHING
        if begin is None or begin[1] != colour:
            if begin is not None:
                chart.band(begin[0], t_s, begin[1])
            begin = t_s, colour
    if begin is not None:
        chart.band(begin[0], outputs[-1][0], begin[1])


# -- pictures ----------------------------------------------------------------------------------------------------------


def _pictures(answer: Answer, pictures: Sequence[RecordedPicture]) -> list[str]:
    if not pictures:
        return ["<p>No picture was kept of this time.</p>"]
    nearest = sorted(pictures, key=lambda picture: abs(picture.head.unix_ns - answer.at_ns))[:MOST_PICTURES]
    readings = picture_search.readings(answer.steps)
    cards = []
    for picture in sorted(nearest, key=lambda p: p.head.unix_ns):
        reading = readings.get((picture.head.frame_id, picture.head.t_ns))
        cards.append(_card(answer, picture, reading))
    left_out = len(pictures) - len(nearest)
    more = [f"<p>{left_out} more are kept, farther from the moment.</p>"] if left_out else []
    return [f'<div class="cases">{"".join(cards)}</div>', *more]


def _card(answer: Answer, picture: RecordedPicture, reading: VisionReading | None) -> str:
    try:
        image = picture_search.decoded(picture)
    except ProtocolError as error:
        return f'<div class="case"><div class="text">{plain(str(error))}</div></div>'
    height, width = image.shape[:2]
    if width > PICTURE_WIDTH:
        size = (PICTURE_WIDTH, max(1, round(height * PICTURE_WIDTH / width)))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    found = "not recorded what was found in it"
    drawn = ""
    if reading is not None:
        found = reading.quality.name.lower()
        if reading.circle is not None:
            c = reading.circle
            found = f"R {c.radius_px:.1f} px at u {c.u_px:.1f}, v {c.v_px:.1f}"
            at = f'cx="{c.u_px + 0.5:.2f}" cy="{c.v_px + 0.5:.2f}" r="{c.radius_px:.2f}" fill="none"'
            thick = width / 160
            drawn = f'<circle {at} stroke="#000" stroke-opacity=".4" stroke-width="{1.8 * thick:.1f}"/>'
            drawn += f'<circle {at} stroke="#ffe14d" stroke-width="{thick:.1f}" stroke-dasharray="{4 * thick:.0f}"/>'
    away_s = (picture.head.unix_ns - answer.at_ns) / NS_PER_S
    text = f"frame {picture.head.frame_id}, {clock(picture.head.unix_ns)} ({away_s:+.2f} s)"
    why = ", ".join(text.replace("_", " ") for text in picture.head.why)
    changed = f"; {picture.head.changed}" if picture.head.changed else ""
    return (
        f'<div class="case"><svg viewBox="0 0 {width} {height}" role="img" aria-label="{plain(text)}">'
        f'<image href="{embed(image)}" width="{width}" height="{height}" preserveAspectRatio="none"/>{drawn}</svg>'
        f'<div class="text"><span class="file">{plain(text)}</span><div>{plain(found + changed)}</div>'
        f'<div class="soft"><span>kept for:</span> {plain(why)}</div></div></div>'
    )
