"""The HTML report of an evaluation: figures, charts, the worst cases drawn, every picture in a table. Pure."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest

from gateway.core.detection import Tracking
from gateway.vision.offline.evaluation import case_cards, plots, tables
from gateway.vision.offline.evaluation.labels import Label
from gateway.vision.offline.evaluation.scoring import Closeness, ScoredPicture, badness
from gateway.vision.offline.evaluation.stress import Stressed, in_words
from gateway.vision.offline.evaluation.summary import SeriesOf, Summary
from gateway.vision.offline.reports.page import figure, page, plain, table, tile
from gateway.vision.offline.reports.tables import ReportTable, Row, number, share
from gateway.vision.pixels import Image

ReadPicture = Callable[[Label], Image]
SHOWN = frozenset((Closeness.FALSE, Closeness.WRONG, Closeness.MISSED, Closeness.LOOSE, Closeness.CLOSE))


@dataclass(frozen=True, slots=True)
class About:
    """The text above and below the figures, as plain text."""

    title: str
    facts: tuple[str, ...]  # settings, date, version
    unmet: tuple[str, ...] | None = None  # of --require; None: nothing was required
    notes: tuple[str, ...] = ()


def html(
    results: Sequence[Summary],
    about: About,
    series: SeriesOf,
    read: ReadPicture,
    reasons: Mapping[str, str],
    *,
    stressed: Sequence[Stressed] = (),
    worst: int = 12,
    advance: Callable[[], None] = lambda: None,
) -> str:
    """The complete page. `read` gives the picture of a label again; `worst` cases of each method are drawn."""
    body = [f"<h1>{plain(about.title)}</h1>", *(f'<p class="soft">{plain(fact)}</p>' for fact in about.facts)]
    body += _verdict_of_gate(about.unmet)
    for result in results:
        body.append(f"<h2>Method {plain(result.method)}</h2>" if len(results) > 1 else "<h2>In short</h2>")
        body.append(_tiles(result))
    body.append("<h2>By part of the set</h2>")
    body += [table(tables.parts(result)) for result in results]
    body += _stressed(stressed)
    body.append(_how_to_read(about.notes))
    body += _charts(results, series)
    for result in results:
        body += _followed(result, series)
    body += _constancy(results)
    for result in results:
        body += _cases(result, worst, read, reasons, advance, named=len(results) > 1)
    for result in results:
        body.append(_all(result, named=len(results) > 1))
    return page(about.title, body, "Made by gateway evaluate. Pixel centres lie at integers; u to the right, v down.")


def _verdict_of_gate(unmet: tuple[str, ...] | None) -> list[str]:
    if unmet is None:
        return []
    if not unmet:
        return ['<p><strong class="good">Every requirement is met.</strong></p>']
    items = "".join(f"<li>{plain(line)}</li>" for line in unmet)
    return [f'<p><strong class="bad">Not everything required is met:</strong></p><ul class="notes">{items}</ul>']


def _tiles(result: Summary) -> str:
    f = result.total
    tiles = []
    if f.with_marker:
        interval = f"95 % interval {share(f.detected_low)} to {share(f.detected_high)}"
        tiles = [
            tile(share(f.detected_share), f"detected, {f.on_target} of {f.with_marker}; {interval}"),
            tile(share(f.close_share), "within 5 % of centre and radius"),
            tile(str(f.wrong), "wrong: an answer elsewhere", "bad" if f.wrong else "good"),
        ]
    if f.without:
        tiles.append(
            tile(f"{f.false} of {f.without}", "false: an answer where no marker is", "bad" if f.false else "good")
        )
    if f.on_target:
        tiles += [
            tile(f"{number(f.centre_median_px)} px", f"centre error, median; 95 % below {number(f.centre_p95_px)} px"),
            tile(
                f"{number(f.radius_median_pct)} %",
                f"radius error, median; 95 % below {number(f.radius_p95_pct)} %; bias {number(f.radius_bias_pct)} %",
            ),
        ]
    tiles.append(tile(f"{number(f.ms_median)} ms", f"time a picture, median; 95 % below {number(f.ms_p95)} ms"))
    return f'<div class="tiles">{"".join(tiles)}</div>'


def _how_to_read(notes: Sequence[str]) -> str:
    words = "".join(f"<li><b>{verdict}</b>: {plain(verdict.meaning)}</li>" for verdict in Closeness)
    more = "".join(f"<li>{plain(note)}</li>" for note in notes)
    return (
        f'<details><summary>How to read the figures</summary><ul class="notes">{words}'
        "<li>“On the target” is within 25 % of the true radius, centre and radius each; “detected” counts these. "
        "Errors are those of answers on the target.</li>"
        "<li>R is the radius of the circle round the rim (equation 10). It is compared with the label's semi-major "
        "axis a where it has one, else with r. Bias above 0: R is too large, and the stop is early.</li>"
        f"<li>The 95 % interval shows how far the rate of other pictures of the same kind may lie off.</li>{more}"
        "</ul></details>"
    )


def _stressed(results: Sequence[Stressed]) -> list[str]:
    if not results:
        return []
    body = ["<h2>Dust and light</h2>", *(f"<p>{plain(line)}</p>" for result in results for line in in_words(result))]
    if svg := plots.found_in_dust(results):
        body.append(figure(svg, "Markers found behind dust; dotted: what a strength must reach to be relied on."))
    return [*body, *(table(tables.stressed(result)) for result in results)]


def _charts(results: Sequence[Summary], series: SeriesOf) -> list[str]:
    drawn = (
        (plots.centre_errors(results), "How many pictures have a centre error below x. A curve that ends below 100 % "
         "has missed the rest."),
        (plots.radius_errors(results), "Radius error of answers on the target; the ends hold what lies beyond."),
        (plots.radius_against_truth(results), "Radius error against size; dotted: ± 5 %. Rest the mouse on a point for "
         "its file."),
        (plots.r_times_z(results, series), "R times Z is constant for a pinhole camera; dotted: ± 1 %."),
    )  # fmt: skip
    figures = [figure(svg, caption) for svg, caption in drawn if svg]
    return ["<h2>Errors</h2>", f'<div class="charts">{"".join(figures)}</div>'] if figures else []


def _followed(result: Summary, series: SeriesOf) -> list[str]:
    if not result.sequences:
        return []
    body = ["<h2>Followed from frame to frame</h2>", table(tables.sequences(result))]
    for found in result.sequences:
        if svg := plots.sequence(result, found.series, series):
            name = plain(found.series or tables.ALL_FRAMES)
            body.append(figure(svg, f"{name}: centre error by frame; marks at the top: no answer."))
    return body


def _constancy(results: Sequence[Summary]) -> list[str]:
    shown = [table(tables.constancy(result)) for result in results if result.constancy]
    if not shown:
        return []
    words = (
        "<p>Deviation of R Z from its series' median. “Labels” is the largest that the labelled radius itself gives: "
        "the part that lies in the tape measure and in the labels. A tape that does not start at the lens's centre of "
        "projection shifts every Z; the best offset is the shift that makes R Z most constant, “with it” the largest "
        "deviation that is left.</p>"
    )
    return ["<h2>R times Z</h2>", words, *shown]


def _cases(
    result: Summary,
    worst: int,
    read: ReadPicture,
    reasons: Mapping[str, str],
    advance: Callable[[], None],
    *,
    named: bool,
) -> list[str]:
    chosen = worst_of(result.outcomes, worst)
    if not chosen:
        return []
    cards = []
    for outcome in chosen:
        cards.append(case_cards.card(outcome, read(outcome.label), reasons))
        advance()
    key = (
        '<p class="soft">Truth: <b style="color:#0077b6">blue, solid</b>. Answer: <b style="color:#9a7b00">yellow, '
        "dashed</b>. Refused candidates: white, dotted.</p>"
    )
    title = f"<h2>The worst {len(cards)} {f'of method {plain(result.method)}' if named else 'cases'}</h2>"
    return [title, key, f'<div class="cases">{"".join(cards)}</div>']


def worst_of(outcomes: Iterable[ScoredPicture], most: int) -> list[ScoredPicture]:
    """The worst first, some of every kind of fault; pictures rightly found empty are not among them."""
    kinds: dict[Closeness, list[ScoredPicture]] = defaultdict(list)
    for outcome in sorted((o for o in outcomes if o.verdict in SHOWN), key=badness):
        kinds[outcome.verdict].append(outcome)
    bad = [kinds.pop(verdict, []) for verdict in (Closeness.FALSE, Closeness.WRONG, Closeness.MISSED)]
    turns = [outcome for turn in zip_longest(*bad) for outcome in turn if outcome is not None]
    rest = [outcome for members in kinds.values() for outcome in members]
    return sorted((turns + rest)[:most], key=badness)


def _all(result: Summary, *, named: bool) -> str:
    heads = ("file", "group", "verdict", "u", "v", "R", "centre error, px", "radius error, %", "confidence", "ms")
    rows: list[Row] = []
    for o in result.outcomes:
        circle = o.detection.circle
        values = (circle.u_px, circle.v_px, circle.radius_px) if circle else ()
        place = [f"{value:.2f}" for value in values] or ["–"] * 3
        radius = "–" if o.radius_share is None else f"{100 * o.radius_share:+.2f}"
        coasted = " (coasted)" if o.detection.tracking is Tracking.COASTED else ""
        bad = o.verdict in (Closeness.FALSE, Closeness.WRONG, Closeness.MISSED)
        verdict = (f"{o.verdict}{coasted}", "left bad" if bad else "left")
        group = (o.label.group or "", "left")
        more = (number(o.centre_px), radius, number(o.detection.confidence), number(o.took_ns / 1e6))
        rows.append(("", [o.label.file, group, verdict, *place, *more]))
    of = f" of method {plain(result.method)}" if named else ""
    return f"<details><summary>Every picture{of}</summary>{table(ReportTable('', heads, rows), titled=False)}</details>"
