"""Measure how well the marker is found in pictures whose truth you know. This is how a plant validates its camera.

DIR holds pictures and labels.jsonl, one JSON object a line:
  {"file": "bay1.jpg", "found": true, "u": 412.5, "v": 300.2, "r": 96.0, "group": "dusk", "z_cm": 120}
  {"file": "empty.jpg", "found": false}
u, v, r: centre and radius in px, pixel centres at integers. Optional: group, series (one camera and marker, or one
sequence), a and b (semi-axes of a tilted rim), tol_px (how far the label may be off), visible (share of the rim), z_cm
(distance), frame (number in a sequence). Other keys are ignored.

  gateway evaluate photos/                              a table: rates, errors, time; total and by group
  gateway evaluate photos/ --report out.html            one file with charts and the worst cases drawn
  gateway evaluate photos/ --method all                 every method, side by side
  gateway evaluate photos/ --config plant.toml          with a plant's own settings
  gateway evaluate photos/ --split                      figures of a tuning half and a reporting half, too
  gateway evaluate photos/ --split tuning               run on the tuning half only
  gateway evaluate plants/ --jobs 2 --results kept/     all sets below, by two processes; a result is kept
  gateway evaluate run7/ --tracking                     follow the frames of a sequence in order
  gateway evaluate photos/ --stress                     through dust and in other light, too: down to what does it hold?
  gateway evaluate photos/ --series '^cam[0-9]+'        R times Z by camera, taken from the file's name
  gateway evaluate photos/ --require detected=0.97,false=0,wrong=0     exit code 1 where it is not met

Detected: centre and radius within 25 % of the true radius. Within 5 %: both within 5 %. An answer elsewhere is wrong,
an answer where no marker is is false; both are worse than none.

--stress looks at each picture 20 times more, behind ever thicker dust, in less and in more light, and reports down to
which strength the method can be relied on: from the mildest up to there at least 95 % found, none wrong, none false.
`camera.picture.veil_proven` in the configuration records it; the registers and pages show it beside the present veil.

--require NAME=LIMIT,... may name (shares are at least, all others at most; what a set can't measure is not met):
  detected       share     answers on the target
  within         share     centre and radius within 5 %
  wrong          count     answers elsewhere, in pictures with a marker
  false          count     answers in pictures without
  centre_median  px        centre error, median
  centre_p95     px        centre error, 95 % are below
  radius_median  %         radius error, median
  radius_p95     %         radius error, 95 % are below
  acquired       share     on the target after acquisition (worst sequence)
  rz             %         R times Z: largest deviation of any series
  ms             ms        time a picture, median

exit codes: 0 done and everything required is met, 1 a requirement is not met, 2 a label, picture or argument is wrong
"""

import argparse
import json
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gateway.cli import batch_args, vision_args
from gateway.cli.tables import console, show
from gateway.clock import SystemClock
from gateway.errors import ConfigError
from gateway.vision.detect.registry import rejection_meanings
from gateway.vision.offline.evaluation import jobs, labels, report, requirements, runner, stress, summary, tables
from gateway.vision.offline.evaluation.labels import Label, Labels
from gateway.vision.offline.evaluation.report import About
from gateway.vision.offline.evaluation.stress import Stressed
from gateway.vision.offline.evaluation.summary import SeriesOf, Summary, series_by
from gateway.vision.offline.reports.page import write

_ONE_TABLE = 122  # characters; a narrower terminal gets two
_WIDEST = 22  # characters of a name


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="DIR", help="pictures with labels.jsonl beside them")
    parser.add_argument("--method", metavar="NAME", help="paper, robust, or all (default: the configuration's)")
    parser.add_argument("--config", metavar="FILE", type=Path, help="take the settings from this configuration")
    parser.add_argument("--bay", metavar="NAME", help="which bay of it (default: the first)")
    parser.add_argument("--tracking", action="store_true", help="follow the frames of each sequence in order")
    parser.add_argument("--fps", type=float, default=25.0, metavar="HZ", help="frames a second of sequences (25)")
    parser.add_argument(
        "--radius",
        choices=("rim", "mean"),
        default="rim",
        help="of a tilted rim compare R with a (the circle round it, as the stop does), or the mean radii with r",
    )
    parser.add_argument("--series", metavar="REGEX", help="part of a file's name that identifies its series")
    parser.add_argument(
        "--split",
        nargs="?",
        const="both",
        choices=("both", "tuning", "reporting"),
        help="halves by a hash of the file's name: show both, or run on one",
    )
    parser.add_argument("--stress", action="store_true", help="also behind dust and in other light; see above")
    parser.add_argument("--report", metavar="FILE.html", type=Path, help="write a report with charts and pictures")
    parser.add_argument("--worst", type=int, default=12, metavar="N", help="worst cases drawn for each method (12)")
    batch_args.configure(parser, default="1, so that times are those of one picture at a time")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of the table")
    parser.add_argument("--require", action="append", default=[], metavar="NAME=LIMIT", help="see above; repeatable")


def main(args: argparse.Namespace) -> int:
    """Raises ConfigError for labels, pictures and arguments that must be edited."""
    if not 0.01 <= args.fps <= 1000:
        raise ConfigError(f"--fps {args.fps:g}: must be 0.01 to 1000")
    if not 0 <= args.worst <= 500:
        raise ConfigError(f"--worst {args.worst}: must be 0 to 500")
    required = requirements.parse(args.require)
    series = _series(args.series)
    batch_args.check(args)
    params = vision_args.bay_vision(args.config, args.bay)
    registry = vision_args.methods(params, args.method)
    found = labels.load(args.folder)
    chosen = _half(found, args.split)
    if args.tracking and all(label.frame is None for label in chosen):
        raise ConfigError(f"{found.source}: --tracking needs labels with a frame number")
    if found.unused_keys:
        print(f"{found.source}: keys not used here: {', '.join(found.unused_keys)}", file=sys.stderr)
    with (
        batch_args.workers(args, jobs.__name__, default=1) as (kept, workers, _),
        vision_args.progress("evaluate", len(chosen)) as advance,
    ):
        follow = series if args.tracking else None
        how = {"follow": follow, "fps": args.fps, "mean_radius": args.radius == "mean", "advance": advance}
        outcomes = jobs.evaluated(found, chosen, tuple(registry), params, kept, workers, **how)
    stressed: tuple[Stressed, ...] = ()
    if args.stress:
        with vision_args.progress("stress", stress.steps() * len(chosen)) as advance:
            stressed = stress.run(
                chosen,
                lambda label: runner.picture(found, label),
                registry,
                SystemClock(),
                mean_radius=args.radius == "mean",
                advance=advance,
            )
    results = [
        summary.summary(name, rows, series, split=args.split == "both", followed=args.tracking)
        for name, rows in outcomes.items()
    ]
    unmet = tuple(
        f"{found.method}: {failed}" for found in results for wanted in required if (failed := wanted.unmet(found))
    )
    if args.report is not None:
        _report(args, results, stressed, found, series, unmet if required else None)
    if args.json:
        document: dict[str, Any] = {"folder": str(args.folder), "split": args.split, "unmet": unmet}
        document["methods"] = [summary.as_json(r, series) for r in results]
        if stressed:
            document["stress"] = [stress.as_json(part) for part in stressed]
        print(json.dumps(document, allow_nan=False))
    else:
        _show(results, stressed)
    for line in unmet:
        print(f"not met: {line}", file=sys.stderr)
    return 1 if unmet else 0


def _show(results: Sequence[Summary], stressed: Sequence[Stressed] = (), width: int | None = None) -> None:
    """Everything that was measured of every method; a narrow terminal gets two tables of the parts."""

    out = console(width)
    rates, errors = slice(1, 1 + tables.RATES), slice(1 + tables.RATES, None)
    for result in results:
        for columns in (slice(1, None),) if out.width >= _ONE_TABLE else (rates, errors):
            show(out, tables.parts(result), columns, widest=_WIDEST)
        if result.sequences:
            show(out, tables.sequences(result), widest=_WIDEST)
        if result.constancy:
            show(out, tables.constancy(result), widest=_WIDEST)
        if count := result.total.vague_labels:
            out.print(f"{count} of the labels may themselves be off by more than 5 % of R (tol_px)")
    for part in stressed:
        show(out, tables.stressed(part), widest=_WIDEST)
        for line in stress.in_words(part):
            out.print(line)
    out.print("centre and radius: median, p95 and bias of the answers on the target", style="dim")


def _series(pattern: str | None) -> SeriesOf:

    try:
        return series_by(pattern)
    except re.error as error:
        raise ConfigError(f"--series {pattern}: not a regular expression: {error}") from error


def _half(found: Labels, split: str | None) -> Sequence[Label]:
    if split in (None, "both"):
        return found.labels
    chosen = [label for label in found.labels if label.tuning_half is (split == "tuning")]
    if not chosen:
        raise ConfigError(f"{found.source}: no picture falls into the {split} half; label more")
    return chosen


def _report(
    args: argparse.Namespace,
    results: list[Summary],
    stressed: Sequence[Stressed],
    found: Labels,
    series: SeriesOf,
    unmet: tuple[str, ...] | None,
) -> None:

    about = _about(args, results, unmet)
    drawn = sum(len(report.worst_of(r.outcomes, args.worst)) for r in results)
    with vision_args.progress("draw", drawn) as advance:
        text = report.html(
            results,
            about,
            series,
            lambda label: runner.picture(found, label),
            rejection_meanings(),
            stressed=stressed,
            worst=args.worst,
            advance=advance,
        )
    write(args.report, text)
    print(f"report: {args.report}", file=sys.stderr)


def _about(args: argparse.Namespace, results: list[Summary], unmet: tuple[str, ...] | None) -> About:

    whole = results[0].total
    settings = f"settings: {args.config or 'defaults'}{f', bay {args.bay}' if args.bay else ''}"
    facts = [
        f"{whole.pictures} pictures: {whole.with_marker} with a marker, {whole.without} without; {settings}",
        vision_args.made_now(),
    ]
    if args.split in ("tuning", "reporting"):
        facts.insert(1, f"Only the {args.split} half of the set, chosen by a hash of the file's name.")
    notes = []
    if args.radius == "mean":
        notes.append("--radius mean: here radii are geometric means of the semi-axes, compared with the label's r.")
    if whole.vague_labels:
        notes.append(f"{whole.vague_labels} labels may themselves be off by more than 5 % of R (tol_px).")
    if args.split == "both":
        notes.append("Halves are chosen by a hash of the file's name. Only the reporting half is free of tuning.")
    return About(f"Detection on {args.folder.resolve().name}", tuple(facts), unmet, tuple(notes))
