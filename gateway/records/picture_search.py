"""The kept pictures of some time, and what was decided on each. IO: reads the files of pictures."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import cv2
import numpy as np

from gateway.core.readings import VisionReading
from gateway.errors import ProtocolError
from gateway.records import names, recording
from gateway.records.recording import Missing
from gateway.records.replay import Step
from gateway.records.segment import Picture
from gateway.vision.pixels import Image

NS_PER_S = 1_000_000_000
WRITTEN_S = 150  # a file is written so long after its first picture at most


def pictures_near(folder: Path, begin_ns: int, end_ns: int) -> Iterator[Picture]:
    """Those taken in that time (Unix ns), in their order; each once. Damaged ones are left out. Raises OSError."""
    found: dict[tuple[int, int], Picture] = {}
    for path in recording.pictures_in(folder):
        name = names.parsed(path.name)
        if name is None or not begin_ns / NS_PER_S - 1 <= name.unix_s <= end_ns / NS_PER_S + WRITTEN_S:
            continue
        for picture in recording.pictures(path):
            if not isinstance(picture, Missing) and begin_ns <= picture.head.unix_ns <= end_ns:
                found[picture.head.t_ns, picture.head.frame_id] = picture
    yield from sorted(found.values(), key=lambda picture: picture.head.unix_ns)


def decoded(picture: Picture) -> Image:
    """(H, W, 3) uint8 BGR. Raises ProtocolError where it cannot be decoded."""
    image = cv2.imdecode(np.frombuffer(picture.data, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise ProtocolError(f"picture of frame {picture.head.frame_id}: not a {picture.head.encoding} file")
    return np.asarray(image, np.uint8)


def readings(steps: Iterable[Step]) -> dict[tuple[str, int], VisionReading]:
    """What vision reported of each frame, by the gateway's start (`boot`) and the frame's number."""
    found = {}
    for step in steps:
        if isinstance(step.observation, VisionReading) and step.observation.frame_id:
            found[step.place.head.boot, step.observation.frame_id] = step.observation
    return found
