"""Videos, pictures and folders of pictures, at their own pace or as fast as vision can. In the vision process only."""

import logging
from pathlib import Path
from typing import TYPE_CHECKING

import cv2

from gateway.clock import Clock
from gateway.core.readings import AgeProof
from gateway.durations import NS_PER_S
from gateway.errors import LinkError
from gateway.vision.offline import inputs
from gateway.vision.pixels import PICTURE_SUFFIXES, bgr8, natural_key
from gateway.vision.source import ffmpeg
from gateway.vision.source.contract import Frame, Source

if TYPE_CHECKING:
    from gateway.vision.source.specs import FileSpec

log = logging.getLogger(__name__)

VIDEO_FPS = 25.0  # for a file without a rate, or with an impossible one


def open_file(spec: "FileSpec", clock: Clock) -> Source:
    """What the path is at this moment decides. Raises LinkError when there is nothing there that can be read.

    `fps` is the pace of pictures; a video has its own. `fast` leaves every pace out.
    """
    path, label = Path(spec.path), spec.label
    try:
        path.stat()  # is_dir and exists hide what the system says, from Python 3.14 on
        if path.is_dir():
            pictures = sorted((p for p in path.iterdir() if _is_picture(p)), key=natural_key)
            if not pictures:
                raise LinkError(f"{label}: no pictures in this folder")
            return FolderSource(pictures, spec, clock)
    except (FileNotFoundError, NotADirectoryError, ValueError) as error:  # ValueError: a zero byte
        raise LinkError(f"{label}: no such file or folder") from error
    except OSError as error:
        raise LinkError(f"{label}: cannot be read: {error.strerror}") from error
    if _is_picture(path) and path.suffix.lower() != ".gif":  # FFmpeg plays an animated GIF at its own rate
        return FolderSource([path], spec, clock)
    return VideoSource(path, spec, clock)


def _is_picture(path: Path) -> bool:
    return path.suffix.lower() in PICTURE_SUFFIXES


class Pace:
    """Spaces frames `period_s` apart without drift; after a delay it continues from now instead of catching up."""

    def __init__(self, period_s: float, clock: Clock) -> None:
        self._period_ns = int(period_s * NS_PER_S)
        self._clock = clock
        self._due_ns: int | None = None

    def wait(self) -> None:
        now_ns = self._clock.now_ns()
        due_ns = now_ns if self._due_ns is None else self._due_ns
        if due_ns > now_ns:
            self._clock.block((due_ns - now_ns) / NS_PER_S)
        self._due_ns = max(due_ns + self._period_ns, now_ns)


class FolderSource(Source):
    """Pictures in the order given, of a file that holds several the first.

    One that cannot be read is skipped with a warning; none at all is a lost source.
    """

    may_repeat = True

    def __init__(self, pictures: list[Path], spec: "FileSpec", clock: Clock) -> None:
        self.lossless = spec.fast
        self.finite = not spec.loop
        self._pictures = pictures
        self._label = spec.label
        self._clock = clock
        self._pace = None if spec.fast else Pace(1 / spec.fps, clock)
        self._next = 0
        self._given = 0  # in this round

    def read(self) -> Frame:
        while True:
            if self._next == len(self._pictures):
                self._begin_again()
            path = self._pictures[self._next]
            self._next += 1
            try:
                picture = next(inputs.read(path))
            except inputs.InputError as error:
                log.warning("%s: %s; skipped", path, error)
                continue
            self._given += 1
            if self._pace:
                self._pace.wait()
            return Frame(picture.pixels, self._clock.now_ns(), age_proof=AgeProof.OWN_CLOCK)

    def _begin_again(self) -> None:
        if self._given == 0:
            raise LinkError(f"{self._label}: no picture here can be read")
        if self.finite:
            if self._pace:
                self._pace.wait()  # the last picture has its full time, too
            raise LinkError(f"{self._label}: ended")
        self._next = self._given = 0

    def close(self) -> None:
        pass


class VideoSource(Source):
    """A video file through FFmpeg, at its own rate."""

    may_repeat = True

    def __init__(self, path: Path, spec: "FileSpec", clock: Clock) -> None:
        self.lossless = spec.fast
        self.finite = not spec.loop
        self._path = path
        self._label = spec.label
        self._clock = clock
        self._capture = self._open()
        fps = self._capture.get(cv2.CAP_PROP_FPS)
        self._pace = None if spec.fast else Pace(1 / (fps if 0.1 <= fps <= 1000 else VIDEO_FPS), clock)

    def _open(self) -> cv2.VideoCapture:
        try:
            capture = inputs.open_video(self._path)
        except inputs.InputError as error:
            raise LinkError(f"{self._label}: {error}") from error
        if not capture.isOpened():
            raise LinkError(f"{self._label}: neither a video nor a picture that can be read")
        return capture

    def read(self) -> Frame:
        image, damaged = ffmpeg.read(self._capture)
        if image is None and not self.finite:
            self.close()
            self._capture = self._open()  # seeking to 0 is not exact in every container; opening is
            image, damaged = ffmpeg.read(self._capture)
        if self._pace:
            self._pace.wait()  # at the end, too: the last frame has its full time
        if image is None:
            raise LinkError(f"{self._label}: ended")
        return Frame(bgr8(image), self._clock.now_ns(), damaged=damaged, age_proof=AgeProof.OWN_CLOCK)

    def close(self) -> None:
        self._capture.release()
