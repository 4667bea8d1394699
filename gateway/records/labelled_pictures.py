"""The kept pictures as files with labels.jsonl, as `gateway evaluate` and `gateway tune` read them. IO.

A label is what was detected when the picture was taken, marked as such: a person looks at it before it is the truth.
Where the frame was only predicted, stale or not recorded there is no label.
"""

import json
import math
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from gateway.core.readings import Quality, VisionReading
from gateway.records.excerpt import Excerpt
from gateway.records.segment import RecordedPicture
from gateway.vision.offline.evaluation.labels import FILE_NAME

SOURCE = "recorded detection, not checked"


def write(folder: Path, excerpt: Excerpt) -> tuple[int, int]:
    """How many pictures were written, and how many labels. An older labels.jsonl there is never overwritten.

    Raises OSError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    readings = excerpt.readings()
    pictures = labels = 0
    with (folder / FILE_NAME).open("x", encoding="utf-8") as file:
        for picture in excerpt.pictures():
            name = _name(picture)
            (folder / name).write_bytes(picture.data)
            pictures += 1
            reading = readings.get((picture.head.frame_id, picture.head.t_ns))
            if reading is not None and (label := label_of(name, reading)) is not None:
                file.write(json.dumps(label) + "\n")
                labels += 1
    return pictures, labels


def label_of(name: str, reading: VisionReading) -> dict[str, Any] | None:
    """The line of labels.jsonl; None: the picture itself was not judged."""
    about = {"source": SOURCE}
    if reading.quality is Quality.NO_TARGET:
        return {"file": name, "found": False, **about}
    if reading.circle is None:
        return None
    circle, rim = reading.circle, reading.ellipse
    label = {"file": name, "found": True, "u": _px(circle.u_px), "v": _px(circle.v_px), "r": _px(circle.radius_px)}
    if rim is not None and 0 < rim.semi_minor_px <= rim.semi_major_px:
        a, b = _px(rim.semi_major_px), _px(rim.semi_minor_px)
        label |= {"r": _px(math.sqrt(a * b)), "a": a, "b": b}
    return label | about


def _name(picture: RecordedPicture) -> str:
    at = datetime.fromtimestamp(picture.head.unix_ns // 1_000_000_000, UTC)
    ms = picture.head.unix_ns // 1_000_000 % 1000
    return f"{at:%Y%m%dT%H%M%S}{ms:03d}Z-{picture.head.frame_id:06d}.{picture.head.encoding}"


def _px(value: float) -> float:
    return round(value, 2)
