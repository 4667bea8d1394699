"""Compare detection methods on rendered bays with exact truth: worn markers, bad light and weather, tired cameras,
and red things that are not the marker.

  gateway benchmark                                     the paper's method and the robust one, all conditions
  gateway benchmark --list                              the conditions, and what each does
  gateway benchmark --conditions 'veil-*' crust         some of them
  gateway benchmark --count 24 --seed 7                 more frames of each, of other bays
  gateway benchmark --out bench/                        a picture of each condition with truth and answers drawn in it
  gateway benchmark --frames frames/                    only write the frames, with labels.jsonl for gateway evaluate
  gateway benchmark --markdown                          the table as Markdown

Your own detector against them, in one command:
  gateway benchmark --method paper robust hough-circles my_module:find

my_module.py lies in the current folder, or is installed; find(image) is given (H, W, 3) uint8 BGR and returns
(u, v, R) in px, or None: no marker. Pixel centres lie at integers. A method of another distribution (docs/extending.md)
has its own name. hough-circles is OpenCV's HoughCircles on redness.

The same seed gives the same frames (as far as OpenCV and NumPy calculate alike). Tune on one seed, report another.

Found: centre and radius within 25 % of the true radius. wrong: an answer elsewhere. false: an answer where there is no
marker. Centre and radius: median and p95 of the found. Each frame is searched by itself, without tracking, on one core.

exit codes: 0 done, 2 an argument is wrong
"""

import argparse
import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2

from gateway.cli import vision_args
from gateway.cli.tables import console, show
from gateway.clock import SystemClock
from gateway.errors import ConfigError
from gateway.modbus.exports.tables import markdown_table
from gateway.sim.benchmark import plain
from gateway.sim.benchmark.compare import compare
from gateway.sim.benchmark.conditions import Condition, chosen, frame
from gateway.sim.benchmark.sheets import Sheets
from gateway.vision.detect.method import Detector
from gateway.vision.offline.evaluation import summary, tables
from gateway.vision.offline.evaluation.labels import FILE_NAME
from gateway.vision.offline.evaluation.scoring import ScoredPicture
from gateway.vision.offline.evaluation.summary import Summary
from gateway.vision.offline.reports.page import write
from gateway.vision.pixels import Image
from gateway.vision.view import drawing

HOUGH = "hough-circles"
_LEAST_PX, _MOST_PX = (160, 120), (1920, 1440)


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--method", nargs="+", default=["paper", "robust"], metavar="NAME", help="see above (default: paper robust)"
    )
    parser.add_argument("--conditions", nargs="+", default=["*"], metavar="NAME", help="names or patterns; default all")
    parser.add_argument("--count", type=int, default=6, metavar="N", help="frames of each condition (6)")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of the bays and of all that happens (1)")
    parser.add_argument("--size", type=_size, default=(640, 480), metavar="WxH", help="of the frames, px (640x480)")
    parser.add_argument(
        "--config", metavar="FILE", type=Path, help="take the methods' settings from this configuration"
    )
    parser.add_argument("--bay", metavar="NAME", help="which bay of it (default: the first)")
    parser.add_argument("--out", metavar="DIR", type=Path, help="write a picture of each condition: truth and answers")
    parser.add_argument("--frames", metavar="DIR", type=Path, help="write the frames and labels.jsonl, compare nothing")
    parser.add_argument("--list", action="store_true", help="list the conditions")
    parser.add_argument("--markdown", action="store_true", help="print the table as Markdown")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of the table")


def main(args: argparse.Namespace) -> int:
    """Raises ConfigError for arguments that must be edited."""
    if not 1 <= args.count <= 10_000:
        raise ConfigError(f"--count {args.count}: must be 1 to 10000")
    if not 0 <= args.seed < 1 << 31:
        raise ConfigError(f"--seed {args.seed}: must be 0 to {(1 << 31) - 1}")
    conditions = chosen(args.conditions)
    if args.list:
        for condition in conditions:
            print(f"{condition.name:15}{'' if condition.marker else 'no marker: '}{condition.meaning}")
        return 0
    cv2.setNumThreads(1)
    if args.frames is not None:
        _write_frames(args, conditions)
        return 0
    results = _compare(args, conditions)
    if args.json:
        _print_json(args, results)
    else:
        _show(results, markdown=args.markdown)
    return 0


def _compare(args: argparse.Namespace, conditions: Sequence[Condition]) -> list[Summary]:

    detectors = _detectors(args)
    sheets = None if args.out is None else Sheets(args.out)
    with vision_args.progress("benchmark", args.count * len(conditions)) as advance:

        def see(condition: Condition, image: Image, given: Mapping[str, ScoredPicture]) -> None:
            if sheets is not None:
                sheets.add(condition.name, image, given)
            advance()

        how = {"seed": args.seed, "count": args.count, "size": args.size, "clock": SystemClock(), "see": see}
        results = compare(detectors, conditions, **how)
    if sheets is not None:
        sheets.write()
        print(f"pictures: {args.out}", file=sys.stderr)
    return results


def _detectors(args: argparse.Namespace) -> dict[str, Detector]:
    """Of methods of the gateway and other distributions, and of functions, by the names given."""

    params = vision_args.bay_vision(args.config, args.bay)
    found: dict[str, Detector] = {}
    for name in args.method:
        if name == HOUGH:
            found[name] = plain.detector(plain.hough_circles, name)
        elif ":" in name:
            sys.path.insert(0, "")
            found[name] = plain.detector(plain.named(name), name)
        else:
            found |= {known: make(False) for known, make in vision_args.methods(params, name).items()}
    return found


def _write_frames(args: argparse.Namespace, conditions: Sequence[Condition]) -> None:

    lines = []
    labels = drawing.made(args.frames) / FILE_NAME
    if os.path.lexists(labels):  # pictures of somebody's, perhaps, and labels made by hand
        raise ConfigError(f"{labels}: is there already; choose another folder")
    with vision_args.progress("frames", args.count * len(conditions)) as advance:
        for number in range(args.count):
            for condition in conditions:
                image, label = frame(args.seed, condition, number, args.size)
                drawing.save_as(args.frames / label.file, image)
                lines.append(label.model_dump_json(exclude_none=True) + "\n")
                advance()
    write(labels, "".join(lines))
    print(f"{len(lines)} frames: gateway evaluate {args.frames} --method all")


def _show(results: Sequence[Summary], *, markdown: bool) -> None:

    out, table = console(), tables.side_by_side(results)
    if markdown:
        cells = ([cell if isinstance(cell, str) else cell[0] for cell in row] for _, row in table.rows)
        print(markdown_table(table.heads, cells))
        return
    show(out, table, widest=22)
    for result in results:
        f = result.total
        found = f"{f.on_target} of {f.with_marker} markers found, {f.wrong} wrong; " if f.with_marker else ""
        out.print(f"{result.method}: {found}{f.false} false in {f.without} frames without a marker")


def _print_json(args: argparse.Namespace, results: Sequence[Summary]) -> None:

    document = {"seed": args.seed, "count": args.count, "size": args.size}
    methods = [summary.as_json(result, summary.series_by(None)) for result in results]
    print(json.dumps(document | {"methods": methods}, allow_nan=False))


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    try:
        size = int(width), int(height)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text}: expected as 640x480") from None
    if not all(least <= side <= most for least, side, most in zip(_LEAST_PX, size, _MOST_PX, strict=True)):
        raise argparse.ArgumentTypeError(f"{text}: must be 160x120 to 1920x1440")
    return size
