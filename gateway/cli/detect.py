"""Find the red marker in pictures and videos: centre (u, v) and radius r in px, pixel centres at integers.

  gateway detect bay.png                          one line for each picture
  gateway detect photos/ 'night/*.jpg' run.mp4    folders, patterns and videos, frame by frame
  gateway detect --json photos/ | jq .r           one JSON object a line, for programs
  gateway detect photos/ --draw out/              what was found, drawn into a copy of every picture
  gateway detect run.mp4 --track 30               follow the marker through 30 frames a second, as the gateway does
  gateway detect bay.png --stages out/            the paper's stages as pictures: its Figures 3 and 4
  gateway detect bay.png --config gateway.toml --bay north     with a plant's own settings
  gateway detect bay.png --min-circularity 0.7    refuse what is not round (a perfect disc has 0.90)
  find . -name '*.png' | gateway detect -         names from standard input, one a line

An input that cannot be read gives a line with its error, and the rest goes on.
JSON keys: file, frame (videos, animations), found, u, v, r (null where nothing was found), area, circularity, fill,
ellipse (u, v, semi_major, semi_minor, angle_deg), confidence and visible (0 to 1; null where the method gives none),
candidates, rejected (u, v, r and why, of the best few that were refused), x_n and y_n (where the configuration has
intrinsics), tracking and predicted (with --track; never a measurement), width, height, ms (by stage, and total), stages
(the beginning of the figures' names), drawn (the picture's name). An input that failed has found = false,
u = v = r = null, and error.
exit codes: 0 all inputs were read, 1 an input failed, 2 nothing to read, or an argument is wrong
"""

import argparse
import json
import math
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gateway.errors import ConfigError

if TYPE_CHECKING:
    from gateway.config import VisionConfig
    from gateway.model import Circle, Detection
    from gateway.vision.inputs import Picture

NAME = "detect"
HELP = "find the marker in pictures and videos"

Row = dict[str, Any]

# Read by OpenCV when it is loaded, so set before; what the user has set stands. The pixel limit keeps a few bytes of
# hostile or broken file from asking for gigabytes; the decoders' own words would stand between our lines.
_OPENCV = {
    "OPENCV_IO_MAX_IMAGE_PIXELS": str(1 << 28),
    "OPENCV_LOG_LEVEL": "SILENT",
    "OPENCV_FFMPEG_LOGLEVEL": "-8",
}
_LONG_BATCH = 8  # inputs; a progress bar for fewer is only flicker


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("inputs", nargs="+", metavar="IMAGE", help="file, folder or pattern; - reads names from stdin")
    parser.add_argument("--json", action="store_true", help="print one JSON object a line")
    parser.add_argument("--method", metavar="NAME", help="detection method (default: the configuration's, else paper)")
    parser.add_argument("--draw", metavar="DIR", type=Path, help="write every picture with what was found into DIR")
    parser.add_argument(
        "--stages", metavar="DIR", type=Path, help="write the paper's figures of every picture into DIR"
    )
    parser.add_argument(
        "--track", metavar="FPS", type=_pace, help="take the pictures for one sequence of so many frames a second"
    )
    parser.add_argument("--config", metavar="FILE", type=Path, help="take the settings from this configuration")
    parser.add_argument("--bay", metavar="NAME", help="which bay of it (default: the first)")
    parser.add_argument("--min-area", metavar="PX2", type=float, help="S_min, px^2")
    parser.add_argument("--min-circularity", metavar="C", type=float, help="0 to 1; 0: off")
    parser.add_argument("--min-fill", metavar="F", type=float, help="0 to 1; 0: off")


def _pace(text: str) -> float:
    try:
        fps = float(text)
    except ValueError:
        fps = 0.0
    if not 0.01 <= fps <= 10_000:
        raise argparse.ArgumentTypeError(f"{text}: must be a number of frames a second, 0.01 to 10000")
    return fps


def main(args: argparse.Namespace) -> int:
    """Prints a line for each picture as soon as it is known. Raises ConfigError for wrong arguments."""
    for name, value in _OPENCV.items():
        os.environ.setdefault(name, value)
    from gateway.vision import inputs

    params = _params(args)
    paths = inputs.expand(_names(args.inputs))
    look = _Look(params, args)
    show = _show_json if args.json else _table(paths)
    pictures = found = failed = 0
    with _progress(len(paths)) as advance:
        for path in paths:
            for row in look.rows(path):
                show(row)
                failed += "error" in row
                pictures += "error" not in row
                found += row["found"]
            advance()
    if pictures + failed > 1:
        print(f"pictures: {pictures}, marker found: {found}, inputs failed: {failed}", file=sys.stderr)
    return 1 if failed else 0


def _params(args: argparse.Namespace) -> "VisionConfig":
    """The bay's settings, or the paper's, with the command line's over them."""
    from pydantic import ValidationError

    from gateway.config import VisionConfig, load
    from gateway.strict.faults import explain

    params = VisionConfig()
    if args.config is not None:
        bays = {bay.name: bay for bay in load(args.config).bays}
        name = next(iter(bays)) if args.bay is None else args.bay
        if name not in bays:
            raise ConfigError(f"{args.config}: no bay {name}; there is: {', '.join(bays)}")
        params = bays[name].vision
    elif args.bay is not None:
        raise ConfigError("--bay needs --config")
    asked = {
        "method": args.method,
        "min_area_px2": args.min_area,
        "min_circularity": args.min_circularity,
        "min_fill": args.min_fill,
    }
    try:
        return VisionConfig.model_validate(
            params.model_dump() | {key: value for key, value in asked.items() if value is not None}
        )
    except ValidationError as error:
        lines = explain(error, source="command line", text="", model=VisionConfig)
        raise ConfigError("\n".join(lines)) from error


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


class _Names:
    """Names in a folder, one for each picture, that no two pictures share."""

    def __init__(self, folder: Path) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(f"{folder}: cannot be made: {error.strerror}") from error
        self.folder = folder
        self._taken: set[str] = set()

    def of(self, path: Path, picture: "Picture") -> str:
        stem = os.fsdecode(os.fsencode(path.stem)[:180])  # a file name has at most 255 bytes
        base = stem if picture.frame is None else f"{stem}-frame{picture.frame:06d}"
        name, number = base, 1
        while name.casefold() in self._taken:
            number += 1
            name = f"{base}-{number}"
        self._taken.add(name.casefold())
        return name


class _Look:
    """Looks at one picture after the other, and writes what was asked for."""

    def __init__(self, params: "VisionConfig", args: argparse.Namespace) -> None:
        from gateway.clock import SystemClock
        from gateway.vision import methods

        self._params = params
        self._fps: float | None = args.track
        # Without --track the pictures are no sequence: each is looked at by itself.
        self._find = methods.detector(
            params.model_copy(update={"tracking": self._fps is not None}), SystemClock().now_ns
        )
        self._looked = 0
        self._stages = None if args.stages is None else _Names(args.stages)
        self._drawn = None if args.draw is None else _Names(args.draw)

    def rows(self, path: Path) -> Iterator[Row]:
        """One row for each picture of the input, and one for what stopped it, if anything did."""
        import cv2

        from gateway.vision import inputs

        wrong = ""
        try:
            for picture in inputs.read(path):
                found = self._find(picture.image, self._next_ns())
                row = _row(path, picture, found, known_lens=self._params.intrinsics is not None)
                if self._fps is not None:
                    row["tracking"] = found.tracking.name.lower()
                    row["predicted"] = found.predicted and _circle(found.predicted)
                if self._stages is not None:
                    row["stages"] = str(self._write_stages(self._stages, path, picture))
                if self._drawn is not None:
                    row["drawn"] = str(self._write_drawn(self._drawn, path, picture, found))
                yield row
        except inputs.InputError as error:
            wrong = str(error)
        except MemoryError:
            wrong = "not enough memory for a picture of this size"
        except cv2.error as error:
            wrong = f"cannot be worked on: {' '.join(str(error).split())}"
        if wrong:
            yield {"file": str(path), "found": False, "u": None, "v": None, "r": None, "error": wrong}

    def _next_ns(self) -> int:
        self._looked += 1
        return round(self._looked * 1e9 / (self._fps or 1.0))

    def _write_stages(self, names: _Names, path: Path, picture: "Picture") -> Path:
        """Returns the beginning of the names of what was written."""
        from gateway.vision import drawing, figures, pipeline

        name = names.of(path, picture)
        trace = pipeline.trace(picture.image, self._params)
        drawing.save(names.folder, name, figures.figure3(trace) | figures.figure4(trace))
        return names.folder / name

    def _write_drawn(self, names: _Names, path: Path, picture: "Picture", found: "Detection") -> Path:
        from gateway.vision import drawing, overlay

        (path,) = drawing.save(names.folder, names.of(path, picture), {"found": overlay.overlay(picture.image, found)})
        return path


def _row(path: Path, picture: "Picture", found: "Detection", *, known_lens: bool) -> Row:
    circle, ellipse = found.circle, found.ellipse
    row: Row = {"file": str(path)}
    if picture.frame is not None:
        row["frame"] = picture.frame
    row["found"] = circle is not None
    row |= _circle(circle) if circle else {"u": None, "v": None, "r": None}
    row["area"] = found.area_px2 if circle else None
    row["circularity"] = found.circularity if circle else None
    row["fill"] = found.fill if circle else None
    row["ellipse"] = ellipse and {
        "u": ellipse.u_px,
        "v": ellipse.v_px,
        "semi_major": ellipse.semi_major_px,
        "semi_minor": ellipse.semi_minor_px,
        "angle_deg": math.degrees(ellipse.angle_rad),
    }
    row["confidence"] = found.confidence
    row["visible"] = found.visible
    row["candidates"] = found.candidates
    row["rejected"] = [_circle(rejection.circle) | {"why": rejection.why} for rejection in found.rejected]
    if known_lens:
        row["x_n"], row["y_n"] = found.x_n, found.y_n
    row["width"], row["height"] = picture.image.shape[1], picture.image.shape[0]
    row["ms"] = {stage: round(ns / 1e6, 3) for stage, ns in found.stage_ns}
    row["ms"]["total"] = round(sum(ns for _, ns in found.stage_ns) / 1e6, 3)
    return row


def _circle(circle: "Circle") -> Row:
    return {"u": circle.u_px, "v": circle.v_px, "r": circle.radius_px}


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
    """Names may hold line feeds, escape sequences and bytes that are no text."""
    return name if name.isprintable() else name.encode("unicode_escape").decode("ascii")


@contextmanager
def _progress(total: int) -> Iterator[Callable[[], None]]:
    """A bar on stderr while a long batch writes to a file; on a terminal the lines themselves show how far it is."""
    if total < _LONG_BATCH or sys.stdout.isatty() or not sys.stderr.isatty():
        yield lambda: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True, redirect_stdout=False) as progress:
        task = progress.add_task("detect", total=total)
        yield lambda: progress.advance(task)
