"""Find the camera's intrinsics from pictures of a checkerboard or a grid of circles: [vision.intrinsics].

  gateway calibrate board/*.jpg --board checkerboard:9x6:25mm
  gateway calibrate board/ --board checkerboard:9x6:25mm --out lens.toml --report lens.html --picture lens.svg
  gateway calibrate board/ --board asymmetric-circles:4x11:20mm --marker-radius-mm 150

--board KIND:COLUMNSxROWS:SIZE
  checkerboard         counts inner corners (a chessboard of 8 x 8 squares has 7x7); SIZE is the side of a square
  circles              SIZE is the distance of neighbours, centre to centre
  asymmetric-circles   every other row shifted; counts circles in a row and rows; SIZE is the distance from row to row

How to take the pictures: 10 to 30 of them, with the camera, lens, focus, zoom and picture size of the plant. A flat,
stiff board, wholly in the picture, sharp and still. Near and far, in the middle and in every corner, tilted by 20 to
45 degrees left, right, up and down: a board seen only from the front does not distinguish a long lens from a
great distance.

What you get: fx, fy, cx, cy and distortion as TOML, each with its standard deviation; the reprojection error over all
and of each picture; how much of the frame was covered; and the doubts about the result. A picture that fits far
worse than the others is left out and named. Pictures of another size than most are left out, too.

Z_vision: with the intrinsics and the marker's true radius the radius in the picture becomes a distance, Z = focal_px
* marker_radius_mm / R. --marker-radius-mm prints [fusion.cross_check] as well: the gateway then compares it with the
ranger's Z, and stops where they disagree.

exit codes: 0 done (check the warnings), 2 an argument, or the pictures, must be changed
"""

import argparse
import json
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from gateway.cli import vision_args
from gateway.cli.tables import console, show
from gateway.errors import ConfigError
from gateway.vision.offline import inputs
from gateway.vision.offline.calibration import boards, plots, report, solve
from gateway.vision.offline.calibration.boards import Board, find, other_size
from gateway.vision.offline.calibration.plots import coverage_text
from gateway.vision.offline.calibration.report import views
from gateway.vision.offline.calibration.solve import BoardView, Calibration
from gateway.vision.offline.reports.page import write
from gateway.vision.pixels import Image

_HINTS = 3  # pictures checked for a board of another size


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("inputs", nargs="+", metavar="IMAGE", help="file, folder or pattern")
    parser.add_argument("--board", required=True, metavar="SPEC", help="checkerboard:9x6:25mm; see above")
    parser.add_argument(
        "--distortion",
        choices=("auto", "0", "4", "5", "8"),
        default="auto",
        help="coefficients; auto: 5, or 4 where k3 cannot be distinguished from 0",
    )
    parser.add_argument("--marker-radius-mm", type=float, metavar="MM", help="print [fusion.cross_check], too")
    parser.add_argument("--out", type=Path, metavar="FILE.toml", help="write the TOML to this file")
    parser.add_argument("--picture", type=Path, metavar="FILE.svg", help="points, residuals and coverage as a picture")
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="everything as one HTML file")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of the tables")


def main(args: argparse.Namespace) -> int:
    """Raises ConfigError for arguments and pictures that must be changed."""
    board = boards.parse(args.board)
    radius_mm = args.marker_radius_mm
    if radius_mm is not None and not 0 < radius_mm <= 10_000:
        raise ConfigError(f"--marker-radius-mm {radius_mm:g}: must be more than 0 and at most 10000")
    views, size_px, without = _views(board, args.inputs)
    try:
        found = solve.calibrate(board, views, size_px, None if args.distortion == "auto" else int(args.distortion))
    except ConfigError as error:
        left = f"\nwithout the board: {_names(without)}" if without else ""
        raise ConfigError(f"gateway calibrate: {error}{left}") from error
    text = report.toml(board, found, radius_mm)
    if args.out is not None:
        write(args.out, text)
    if args.picture is not None:
        write(args.picture, plots.frame_map(found))
    if args.report is not None:
        facts = (f"{_names(args.inputs)}; {vision_args.made_now()}",)
        write(args.report, report.html(board, found, text, facts, without))
    if args.json:
        print(json.dumps(_document(found, without), allow_nan=False))
    else:
        _show(found, without)
        print(f"\n{text}", end="")
        if radius_mm is not None:
            _explain(report.focal_px(found), radius_mm)
    for warning in found.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    for path in (args.out, args.picture, args.report):
        if path is not None:
            print(f"written: {path}", file=sys.stderr)
    return 0


def _views(board: Board, names: Sequence[str]) -> tuple[list[BoardView], tuple[int, int], list[str]]:
    """The board's points in every picture of the most frequent size, that size, and where there was no board."""

    paths = inputs.expand(names)
    seen: list[tuple[BoardView | None, str, tuple[int, int]]] = []
    kept: list[Image] = []  # the first few without a board, for a hint
    with vision_args.progress("search for the board", len(paths)) as advance:
        for path in paths:
            try:
                for shot in inputs.read(path):
                    name = path.name if shot.frame is None else f"{path.name} #{shot.frame}"
                    points = find(board, shot.image)
                    size_px = (shot.image.shape[1], shot.image.shape[0])
                    seen.append((None if points is None else BoardView(name, points), name, size_px))
                    if points is None and len(kept) < _HINTS:
                        kept.append(shot.image)
            except inputs.InputError as error:
                print(f"warning: {path}: {error}", file=sys.stderr)
            advance()
    with_board = [(view, name, size) for view, name, size in seen if view is not None]
    if not with_board:
        raise ConfigError(_no_board(board, len(seen), kept))
    sizes = Counter(size for _, _, size in with_board)
    size_px, most = sizes.most_common(1)[0]
    if len(sizes) > 1:
        if list(sizes.values()).count(most) > 1:
            every = ", ".join(f"{w} x {h} px ({n})" for (w, h), n in sizes.items())
            raise ConfigError(f"gateway calibrate: pictures of different sizes: {every}; intrinsics hold for one size")
        others = [f"{name} ({size[0]} x {size[1]})" for _, name, size in with_board if size != size_px]
        print(f"warning: left out, not {size_px[0]} x {size_px[1]} px: {_names(others)}", file=sys.stderr)
    views = [view for view, _, size in with_board if size == size_px]
    return views, size_px, [name for view, name, _ in seen if view is None]


def _no_board(board: Board, checked: int, kept: Sequence[Image]) -> str:

    text = f"gateway calibrate: no {board} in any of {checked} pictures; the whole board must be seen, with a light rim"
    if not checked:
        return "gateway calibrate: no picture could be read"
    for image in kept:
        if size := other_size(board, image):
            return (
                f"{text}\na checkerboard of {size[0]} x {size[1]} inner corners was found: is that the board? "
                "The size counts inner corners, one less than squares each way."
            )
    return text


def _names(names: Sequence[str], most: int = 5) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _show(found: Calibration, without: Sequence[str]) -> None:

    show(console(), views(found, without))
    print(f"reprojection error: rms {found.rms_px:.3f} px over {len(found.views)} views")
    print(f"covered {100 * (found.coverage > 0).mean():.0f} % of the frame (· never seen):")
    for line in coverage_text(found):
        print("  " + line)


def _explain(focal_px: float, radius_mm: float) -> None:
    print(
        f"\nA marker of {radius_mm:g} mm radius has R = {focal_px * radius_mm / 1000:.1f} px at 1 m;"
        f" R = 180 px means Z_vision = {focal_px * radius_mm / 180 / 10:.1f} cm."
    )


def _document(found: Calibration, without: Sequence[str]) -> dict[str, object]:
    return {
        "width": found.size_px[0],
        "height": found.size_px[1],
        "intrinsics": found.lens.model_dump(),
        "sigma": dict(found.sigma),
        "rms_px": found.rms_px,
        "views": [
            {
                "file": view.name,
                "rms_px": view.rms_px,
                "largest_px": view.largest_px,
                "tilt_deg": view.tilt_deg,
                "distance_mm": view.distance_mm,
            }
            for view in found.views
        ],
        "rejected": [{"file": name, "rms_px": rms} for name, rms in found.rejected],
        "without_board": list(without),
        "coverage": found.coverage.tolist(),
        "warnings": list(found.warnings),
    }
