"""The HTML report of a study. Pure."""

from collections.abc import Sequence

import numpy as np

from gateway.vision.offline.reports.page import figure, page, plain, table, tile
from gateway.vision.offline.reports.tables import ReportTable, Row, number, share
from gateway.vision.offline.tuning import exposure, histograms, thresholds
from gateway.vision.offline.tuning.study import Study


def html(study: Study, snippet: str, facts: Sequence[str], notes: Sequence[str]) -> str:
    """`notes`: the origin of the examples, where that matters."""
    marked = sum(e.marked for e in study.examples)
    now, then = study.effect["now"], study.effect["proposed thresholds and gates"]
    tiles = [
        tile(f"{share(now.detected_share)} → {share(then.detected_share)}", "of the markers found, now → proposed"),
        tile(f"{now.wrong + now.false} → {then.wrong + then.false}", "wrong or false answers"),
        tile(f"{100 * study.admits_proposed.marker:.0f} %", "of the markers' pixels pass"),
        tile(f"{100 * study.admits_proposed.ring:.1f} %", "of the surroundings pass"),
    ]
    body = ["<h1>Thresholds and exposure</h1>", *(f'<p class="soft">{plain(fact)}</p>' for fact in facts)]
    body += [f'<p><strong class="warn">{plain(note)}</strong></p>' for note in notes]
    body.append(f'<h2>In short, of {marked} markers</h2><div class="tiles">{"".join(tiles)}</div>')
    body.append(f"<h2>For the configuration</h2><pre>{plain(snippet)}</pre>")
    for title, admits, red in (
        ("The present setting", study.admits_now, study.now),
        ("The proposal", study.admits_proposed, study.proposed),
    ):
        words = thresholds.remarks(admits, red) or ["fits the examples"]
        body.append(f"<h3>{title}</h3><ul class='notes'>{''.join(f'<li>{plain(w)}</li>' for w in words)}</ul>")
    body.append(
        "<h2>Colours</h2><p>Shares of each class; shaded: what the proposal lets in; dotted: the present bounds</p>"
    )
    drawn = histograms.charts(study.examples, study.now, study.proposed)
    body.append(f'<div class="charts">{"".join(figure(svg, "") for svg in drawn)}</div>')
    body += [table(background(study)), table(effect(study))]
    body.append(
        "<p class='soft'>Counted on the pictures it was chosen from, which flatters; “the other half” does not.</p>"
    )
    items = "".join(f"<li>{plain(line)}</li>" for line in exposure.advice(study.lights))
    body.append(f'<h2>Camera</h2><ul class="notes">{items}</ul>{_lights(study)}')
    return page("Thresholds and exposure", body, "Made by gateway tune.")


def background(study: Study) -> ReportTable:
    heads = ("hue", *(f"S {low} to {high}" for low, high in histograms.S_BANDS))
    found = histograms.background_by_colour(study.examples)
    rows: list[Row] = [
        ("", [f"{name} ({low} to {high})", *((f"{value:.2f}", "bad" if value > 1 else "") for value in values)])
        for (name, low, high), values in zip(histograms.HUE_BANDS, found, strict=True)
    ]
    return ReportTable("Background and surroundings by colour, % of their pixels", heads, rows)


def effect(study: Study) -> ReportTable:
    heads = ("setting", "found", "within 5 %", "wrong", "missed", "false", "centre, px", "radius, %")
    rows: list[Row] = [
        ("", [name, share(f.detected_share), share(f.close_share), str(f.wrong), str(f.missed),
              f"{f.false} of {f.without}", number(f.centre_median_px), number(f.radius_median_pct)])
        for name, f in study.effect.items()
    ]  # fmt: skip
    return ReportTable("What the paper's method finds in these examples", heads, rows)


def _lights(study: Study) -> str:
    heads = ("picture", "marker V", "marker S", "red at stop", "white", "noise", "rim, px", "smear, px", "red / blue")
    rows: list[Row] = []
    for e, light in zip(study.examples, study.lights, strict=True):
        values = [number(x) for x in (light.noise, light.edge_px, light.smear_px, light.warmth)]
        shares = [share(light.marker_clipped), share(light.clipped)]
        rows.append(("", [e.name, number(light.marker_v), number(light.marker_s), *shares, *values]))
    middle = number(float(np.median([light.noise for light in study.lights])))
    pictures = table(ReportTable("", heads, rows), titled=False)
    return f"<details><summary>Every picture (median noise {middle})</summary>{pictures}</details>"
