"""`gateway replay --frames`: what is found in the kept pictures now, beside what was recorded of them."""

import argparse
import json
from collections.abc import Sequence
from typing import Any

from gateway.cli import tables, vision_args
from gateway.cli.recording_args import folders_of
from gateway.config import GatewayConfig, VisionConfig
from gateway.core.detection import Circle
from gateway.errors import ConfigError
from gateway.records import frames_again, recording
from gateway.records.excerpt import Excerpt
from gateway.records.frames_again import TOLERANCE, FrameAgain
from gateway.records.moment import shown
from gateway.records.recording import MissingItem
from gateway.records.segment import Head
from gateway.vision.offline.reports.tables import ReportTable

MOST_SHOWN = 20
WHY_NOT_EXACT = "a full search of one picture is not the tracked one of the recording"


def run(args: argparse.Namespace, other: GatewayConfig | None) -> int:
    """0: all the same; 1: any differs, is missing, or there is none. Raises ConfigError."""

    found: list[FrameAgain] = []
    missing: list[str] = []
    settings: dict[str, VisionConfig] = {}

    def params(head: Head) -> VisionConfig:
        if other is not None and head.bay not in settings:
            settings[head.bay] = frames_again.vision_of(other, args.bay or head.bay)
        return settings[head.bay]

    for folder in folders_of(args.recording):
        readings = Excerpt.of(folder, None, None).readings()
        with vision_args.progress("frames", len(recording.pictures_in(folder))) as advance:
            for frame in frames_again.again(folder, readings, None if other is None else params, advance):
                if isinstance(frame, MissingItem):
                    missing.append(frame.why)
                else:
                    found.append(frame)
    if not found and not missing:
        raise ConfigError(f"{', '.join(map(str, args.recording))}: no pictures are kept there")
    known = [frame for frame in found if frame.was is not None]
    same = sum(frame.same for frame in known)
    largest = sorted((frame for frame in known), key=_importance, reverse=True)
    if args.json:
        print(json.dumps({**_document(found, known, same, largest), "missing": missing}, allow_nan=False))
    else:
        for why in missing:
            print(f"missing: {why}")
        _print(found, known, same, [frame for frame in largest if not frame.same])
    return int(same < len(found) or bool(missing))


def _importance(frame: FrameAgain) -> tuple[bool, float]:
    """Seen only once before the largest difference."""
    off_px = frame.off_px
    return (not frame.same and off_px is None, off_px or 0.0)


def _document(
    found: Sequence[FrameAgain], known: Sequence[FrameAgain], same: int, rows: Sequence[FrameAgain]
) -> dict[str, Any]:

    return {
        "pictures": len(found),
        "recorded": len(known),
        "same": same,
        "tolerance": f"{TOLERANCE}: {WHY_NOT_EXACT}",
        "frames": [_row(frame) for frame in rows],
    }


def _print(
    found: Sequence[FrameAgain], known: Sequence[FrameAgain], same: int, differing: Sequence[FrameAgain]
) -> None:

    print(f"{len(found)} pictures, {len(known)} with a recorded result: {same} the same ({TOLERANCE})")
    if not differing:
        return
    heads = ("time", "frame", "then", "now", "off px", "picture")
    rows = [("", tuple(_cells(frame))) for frame in differing[:MOST_SHOWN]]
    tables.show(tables.console(150), ReportTable("", heads, rows))
    if len(differing) > MOST_SHOWN:
        print(f"and {len(differing) - MOST_SHOWN} more")
    print(f"{WHY_NOT_EXACT}: it follows no marker, coasts over nothing, and has no limits of R by the ranger")


def _cells(frame: FrameAgain) -> list[str]:
    row = _row(frame)
    off = "-" if row["off_px"] is None else f"{row['off_px']:.1f}"
    return [row["time"], str(row["frame_id"]), row["was"], row["now"], off, row["file"]]


def _row(frame: FrameAgain) -> dict[str, Any]:

    was = frame.was
    then = "not recorded" if was is None else was.quality.name.lower()
    if was is not None and was.circle is not None:
        then += f" {_place(was.circle)}"
    return {
        "time": shown(frame.picture.head.unix_ns),
        "frame_id": frame.picture.head.frame_id,
        "was": then,
        "tracking": None if was is None else was.tracking.name.lower(),
        "now": "no marker" if frame.now is None else _place(frame.now),
        "off_px": None if frame.off_px is None else round(frame.off_px, 2),
        "same": frame.same,
        "file": frame.path.name,
    }


def _place(circle: Circle) -> str:
    return f"R {circle.radius_px:.1f} at ({circle.u_px:.1f}, {circle.v_px:.1f})"
