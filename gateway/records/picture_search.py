"""The kept pictures of some time, and what was decided on each. IO: reads the files of pictures."""

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Sequence
from operator import itemgetter
from pathlib import Path

import cv2
import numpy as np

from gateway.core.readings import VisionReading
from gateway.durations import NS_PER_S
from gateway.errors import ProtocolError
from gateway.records import names, recording
from gateway.records.recording import MissingItem
from gateway.records.replay import Step
from gateway.records.segment import RecordedPicture
from gateway.vision.pixels import Image

WRITTEN_S = 150  # a file is written this long after its first picture at most


def pictures_near(folder: Path, begin_ns: int, end_ns: int) -> Iterator[RecordedPicture]:
    """Those taken in that time (Unix ns), in their order; each once. Damaged ones are left out. Raises OSError."""
    found: dict[tuple[int, int], RecordedPicture] = {}
    for path in files_of_time(recording.pictures_in(folder), begin_ns, end_ns):
        for picture in _pictures(path, begin_ns, end_ns):
            found[picture.head.t_ns, picture.head.frame_id] = picture
    yield from sorted(found.values(), key=lambda picture: picture.head.unix_ns)


def files_near(folder: Path, begin_ns: int, end_ns: int, margin_s: float = 2.0) -> list[str]:
    """The names of the files with a picture of that time (Unix ns), or within `margin_s` of it. Raises OSError."""
    begin_ns, end_ns = begin_ns - round(margin_s * NS_PER_S), end_ns + round(margin_s * NS_PER_S)
    files = files_of_time(recording.pictures_in(folder), begin_ns, end_ns)
    return [path.name for path in files if any(_pictures(path, begin_ns, end_ns))]


def files_of_time(files: Iterable[Path], begin_ns: int, end_ns: int) -> Iterator[Path]:
    """Those of a bay's `files` that may have a picture of that time (Unix ns)."""
    yield from (path for unix_s, path in dated(files) if _first_s(begin_ns) <= unix_s <= _last_s(end_ns))


def dated(files: Iterable[Path]) -> Iterator[tuple[int, Path]]:
    """A bay's `files` with the times (Unix s) in their names."""
    yield from ((name.unix_s, path) for path in files if (name := names.parsed(path.name)) is not None)


def between(files: Sequence[tuple[int, Path]], begin_ns: int, end_ns: int) -> Sequence[tuple[int, Path]]:
    """As `files_of_time`, of those of `dated` in ascending order."""
    first = bisect_left(files, _first_s(begin_ns), key=itemgetter(0))
    return files[first : bisect_right(files, _last_s(end_ns), first, key=itemgetter(0))]


def _first_s(begin_ns: int) -> float:
    return begin_ns / NS_PER_S - 1


def _last_s(end_ns: int) -> float:
    return end_ns / NS_PER_S + WRITTEN_S


def _pictures(path: Path, begin_ns: int, end_ns: int) -> Iterator[RecordedPicture]:
    for picture in recording.pictures(path):
        if not isinstance(picture, MissingItem) and begin_ns <= picture.head.unix_ns <= end_ns:
            yield picture


def decoded(picture: RecordedPicture) -> Image:
    """(H, W, 3) uint8 BGR. Raises ProtocolError where it cannot be decoded."""
    image = cv2.imdecode(np.frombuffer(picture.data, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise ProtocolError(f"picture of frame {picture.head.frame_id}: not a {picture.head.encoding} file")
    return np.asarray(image, np.uint8)


def readings(steps: Iterable[Step]) -> dict[tuple[int, int], VisionReading]:
    """What vision reported of each frame, by its number and capture time (monotonic ns)."""
    found = {}
    for step in steps:
        if isinstance(step.observation, VisionReading) and step.observation.frame_id:
            found[step.observation.frame_id, step.observation.t_ns] = step.observation
    return found
