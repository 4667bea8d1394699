"""Find the red marker in pictures and videos: centre (u, v) and radius r in px, pixel centres at integers.

  gateway detect bay.png                          one line for each picture
  gateway detect photos/ 'night/*.jpg' run.mp4    folders, patterns and videos, frame by frame
  gateway detect --json photos/ | jq .r           one JSON object a line, for programs
  gateway detect photos/ --draw out/              what was found, drawn into a copy of every picture
  gateway detect run.mp4 --track 30               follow the marker through 30 frames a second, as the gateway does
  gateway detect bay.png --stages out/            the method's stages as pictures; the paper's: its Figures 3 and 4
  gateway detect bay.png --config gateway.toml --bay north     with a plant's own settings
  gateway detect bay.png --method paper           by the paper's own pipeline
  gateway detect bay.png --method paper --min-circularity 0.7      reject what is not round (a perfect disc has 0.90)
  find . -name '*.png' | gateway detect -         names from standard input, one a line

An input that cannot be read gives a line with its error, and the rest is processed.
JSON keys: file, frame (videos, animations), found, u, v, r (null where nothing was found), area, circularity, fill,
ellipse (u, v, semi_major, semi_minor, angle_deg), confidence and visible (0 to 1; null where the method gives none),
candidates, rejected (u, v, r and why, of the best few that were refused), x_n and y_n (where the configuration has
intrinsics), tracking and predicted (with --track; never a measurement), width, height, ms (by stage, and total), stages
(the beginning of the pictures' names), drawn (the picture's name). An input that failed has found = false,
u = v = r = null, and error.
exit codes: 0 all inputs were read, 1 an input failed, 2 nothing to read, or an argument is wrong
"""

import argparse
import json
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from pydantic import ValidationError

from gateway.cli import vision_args
from gateway.cli.detect_pictures import DetectionRun, Row
from gateway.config import VisionConfig
from gateway.config.strict.errors import explain
from gateway.errors import ConfigError
from gateway.vision.offline import inputs

_LONG_BATCH = 8  # inputs; a progress bar for fewer is only flicker


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("inputs", nargs="+", metavar="IMAGE", help="file, folder or pattern; - reads names from stdin")
    parser.add_argument("--json", action="store_true", help="print one JSON object a line")
    parser.add_argument("--method", metavar="NAME", help="robust or paper (default: the configuration's, else robust)")
    parser.add_argument("--draw", metavar="DIR", type=Path, help="write every picture with what was found into DIR")
    parser.add_argument(
        "--stages", metavar="DIR", type=Path, help="write the method's stages of every picture into DIR"
    )
    parser.add_argument(
        "--track", metavar="FPS", type=_frame_rate, help="take the pictures for one sequence of so many frames a second"
    )
    parser.add_argument("--config", metavar="FILE", type=Path, help="take the settings from this configuration")
    parser.add_argument("--bay", metavar="NAME", help="which bay of it (default: the first)")
    parser.add_argument("--min-area", metavar="PX2", type=float, help="paper: S_min, px^2")
    parser.add_argument("--min-circularity", metavar="C", type=float, help="paper: 0 to 1; 0: off")
    parser.add_argument("--min-fill", metavar="F", type=float, help="paper: 0 to 1; 0: off")


def _frame_rate(text: str) -> float:
    try:
        fps = float(text)
    except ValueError:
        fps = 0.0
    if not 0.01 <= fps <= 10_000:
        raise argparse.ArgumentTypeError(f"{text}: must be a number of frames a second, 0.01 to 10000")
    return fps


def main(args: argparse.Namespace) -> int:
    """Prints a line for each picture as soon as it is known. Raises ConfigError for wrong arguments."""
    params = _params(args)
    paths = inputs.expand(_names(args.inputs))
    run = DetectionRun(params, args)
    show = _show_json if args.json else _table(paths)
    pictures = found = failed = 0
    # On a terminal the lines themselves show how far it is.
    bar = len(paths) >= _LONG_BATCH and not sys.stdout.isatty()
    with vision_args.progress("detect", len(paths) if bar else 0) as advance:
        for path in paths:
            for row in run.rows(path):
                show(row)
                failed += "error" in row
                pictures += "error" not in row
                found += row["found"]
            advance()
    if pictures + failed > 1:
        print(f"pictures: {pictures}, marker found: {found}, inputs failed: {failed}", file=sys.stderr)
    return 1 if failed else 0


def _params(args: argparse.Namespace) -> VisionConfig:
    """The bay's settings, or the defaults, with the command line's over them."""

    params = vision_args.bay_vision(args.config, args.bay)
    gates = {"min_area_px2": args.min_area, "min_circularity": args.min_circularity, "min_fill": args.min_fill}
    asked = {key: value for key, value in ({"method": args.method} | gates).items() if value is not None}
    try:
        params = VisionConfig.model_validate(params.model_dump() | asked)
    except ValidationError as error:
        lines = explain(error, source="command line", text="", model=VisionConfig)
        raise ConfigError("\n".join(lines)) from error
    if params.method != "paper" and asked.keys() & gates.keys():
        raise ConfigError("--min-area, --min-circularity and --min-fill are the paper's method's: add --method paper")
    return params


def _names(arguments: Sequence[str]) -> list[str]:
    """The inputs named, with `-` replaced by the lines of standard input."""
    names: list[str] = []
    for argument in arguments:
        if argument == "-":
            lines = sys.stdin.buffer.read().split(b"\n")
            names += [os.fsdecode(line) for line in lines if line]
        else:
            names.append(argument)
    return names


def _show_json(row: Row) -> None:
    print(json.dumps(row, allow_nan=False), flush=True)


def _table(paths: Sequence[Path]) -> Callable[[Row], None]:
    """Prints the header, and returns what prints a row under it."""
    wide = min(60, max(len(_printable(str(path))) for path in paths) + 7)
    heads = f"{'area px2':>11} {'circ.':>6} {'fill':>6} {'conf.':>6} {'seen':>6} {'ms':>8}"
    print(f"{'file':{wide}} {'u px':>9} {'v px':>9} {'r px':>9} {heads}")

    def show(row: Row) -> None:
        name = _printable(row["file"]) + (f" #{row['frame']}" if "frame" in row else "")
        if "error" in row:
            print(f"{name:{wide}} error: {row['error']}", flush=True)
            return
        values = "  coasted" if row.get("tracking") == "coasted" else "no marker"
        if row["found"]:
            place = f"{row['u']:9.2f} {row['v']:9.2f} {row['r']:9.2f}"
            shape = f"{row['area']:11.1f} {row['circularity']:6.3f} {row['fill']:6.3f}"
            values = f"{place} {shape} {_share(row['confidence'])} {_share(row['visible'])}"
        print(f"{name:{wide}} {values:69} {row['ms']['total']:8.2f}", flush=True)

    return show


def _share(value: float | None) -> str:
    return "–".rjust(6) if value is None else f"{value:6.3f}"


def _printable(name: str) -> str:
    """Names may hold line feeds, escape sequences and bytes that are not text."""
    return name if name.isprintable() else name.encode("unicode_escape").decode("ascii")
