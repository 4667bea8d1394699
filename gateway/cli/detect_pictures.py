"""The work of `gateway detect`: process one picture after the other, make a row of each, write the requested
outputs."""

import argparse
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2

from gateway.clock import SystemClock
from gateway.config import VisionConfig
from gateway.core.detection import Circle, Detection
from gateway.vision.detect import registry
from gateway.vision.detect.stage_timer import total_ns
from gateway.vision.offline import inputs
from gateway.vision.offline.inputs import InputPicture
from gateway.vision.view import drawing, overlay

Row = dict[str, Any]


class Names:
    """Names in a folder, one for each picture, that no two pictures share."""

    def __init__(self, folder: Path) -> None:
        self.folder = drawing.made(folder)
        self._taken: set[str] = set()

    def of(self, path: Path, picture: InputPicture) -> str:
        stem = os.fsdecode(os.fsencode(path.stem)[:180])  # a file name has at most 255 bytes
        base = stem if picture.frame is None else f"{stem}-frame{picture.frame:06d}"
        name, number = base, 1
        while name.casefold() in self._taken:
            number += 1
            name = f"{base}-{number}"
        self._taken.add(name.casefold())
        return name


class DetectionRun:
    """Processes one picture after the other, and writes the requested outputs."""

    def __init__(self, params: VisionConfig, args: argparse.Namespace) -> None:
        self._params = params
        self._fps: float | None = args.track
        # Without --track the pictures are not a sequence: each is processed by itself.
        self._find = registry.detector(
            params.model_copy(update={"tracking": self._fps is not None}), SystemClock().now_ns
        )
        self._looked = 0
        self._stages = None if args.stages is None else Names(args.stages)
        self._drawn = None if args.draw is None else Names(args.draw)

    def rows(self, path: Path) -> Iterator[Row]:
        """One row for each picture of the input, and one for what stopped it, if anything did."""
        wrong = ""
        try:
            for picture in inputs.read(path):
                self._check_size(picture)
                found = self._find(registry.given(self._params, picture.pixels), self._next_ns())
                row = _row(path, picture, found, known_lens=self._params.intrinsics is not None)
                if self._fps is not None:
                    row["tracking"] = found.tracking.name.lower()
                    row["predicted"] = found.predicted and _circle(found.predicted)
                if self._stages is not None:
                    row["stages"] = str(self._write_stages(self._stages, path, picture, found))
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

    def _check_size(self, picture: InputPicture) -> None:
        """Raises InputError for a picture that the intrinsics do not hold for."""
        lens, (height, width) = self._params.intrinsics, picture.pixels.shape[:2]
        if lens is not None and (lens.width_px, lens.height_px) not in ((None, None), (width, height)):
            raise inputs.InputError(
                f"{width} x {height} px; vision.intrinsics hold for {lens.width_px} x {lens.height_px} px"
            )

    def _next_ns(self) -> int:
        self._looked += 1
        return round(self._looked * 1e9 / (self._fps or 1.0))

    def _write_stages(self, names: Names, path: Path, picture: InputPicture, found: Detection) -> Path:
        """Returns the beginning of the names of what was written."""
        name = names.of(path, picture)
        drawing.save(names.folder, name, registry.stage_pictures(self._params, picture.image, found))
        return names.folder / name

    def _write_drawn(self, names: Names, path: Path, picture: InputPicture, found: Detection) -> Path:
        (path,) = drawing.save(names.folder, names.of(path, picture), {"found": overlay.overlay(picture.image, found)})
        return path


def _row(path: Path, picture: InputPicture, found: Detection, *, known_lens: bool) -> Row:
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
    row["width"], row["height"] = picture.pixels.shape[1], picture.pixels.shape[0]
    row["ms"] = {stage: round(ns / 1e6, 3) for stage, ns in found.stage_ns}
    row["ms"]["total"] = round(total_ns(found.stage_ns) / 1e6, 3)
    return row


def _circle(circle: Circle) -> Row:
    return {"u": circle.u_px, "v": circle.v_px, "r": circle.radius_px}
