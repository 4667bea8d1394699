"""Cameras (V4L2) and streams (FFmpeg) through OpenCV. Imported in the camera process only."""

import os
from typing import Any

import cv2
from numpy.typing import NDArray

from gateway.clock import Clock
from gateway.errors import LinkError
from gateway.vision.freshness import Look, Stillness
from gateway.vision.pixels import bgr8
from gateway.vision.sources import Frame

# Read by OpenCV when a stream is opened. Setting it replaces OpenCV's own default, so TCP must be said again. Without
# `nobuffer` and `low_delay` FFmpeg holds back several frames. An operator's own setting wins (RTSP over UDP, say).
FFMPEG_OPTIONS = "rtsp_transport;tcp|fflags;nobuffer|flags;low_delay"


class CaptureSource:
    """A live source: frames come when they come, and the newest is the one that counts."""

    lossless = False

    def __init__(self, capture: cv2.VideoCapture, label: str, clock: Clock, frozen_s: float) -> None:
        self._capture = capture
        self._label = label
        self._clock = clock
        self._frozen_s = frozen_s
        self._stillness = Stillness(frozen_s)

    def read(self) -> Frame:
        while True:
            frame = self._next()
            match self._stillness.look(frame.image, frame.t_capture_ns):
                case Look.LIVE:
                    return frame
                case Look.FROZEN:
                    raise LinkError(f"{self._label}: frozen: the picture has not changed for {self._frozen_s:g} s")

    def _next(self) -> Frame:
        if not self._capture.grab():
            raise LinkError(f"{self._label}: lost: it gave no further frame")
        t_capture_ns = self._clock.now_ns()  # before the conversion to BGR, which takes its time
        ok, image = self._capture.retrieve()
        if not ok or image is None:
            raise LinkError(f"{self._label}: lost: a frame could not be decoded")
        return frame_of(image, t_capture_ns, self._label)

    def close(self) -> None:
        self._capture.release()


def frame_of(image: NDArray[Any], t_capture_ns: int, label: str) -> Frame:
    """What a driver handed over, as a frame. Raises LinkError for what is no picture."""
    try:
        return Frame(bgr8(image), t_capture_ns)
    except ValueError as error:
        raise LinkError(f"{label}: {error}") from error


def open_camera(
    device: int | str,
    clock: Clock,
    *,
    label: str,
    width_px: int | None,
    height_px: int | None,
    fps: float | None,
    frozen_s: float,
) -> CaptureSource:
    """A V4L2 camera. Raises LinkError when there is no such camera, or another program has it."""
    capture = cv2.VideoCapture(device, cv2.CAP_V4L2)
    if not capture.isOpened():
        raise LinkError(f"{label}: cannot be opened: missing, busy, or no permission (group video)")
    wishes = (
        (cv2.CAP_PROP_FRAME_WIDTH, width_px),
        (cv2.CAP_PROP_FRAME_HEIGHT, height_px),
        (cv2.CAP_PROP_FPS, fps),
    )
    for key, wish in wishes:
        if wish is not None:
            capture.set(key, wish)  # a driver that offers something else gives something else: no error
    return CaptureSource(capture, label, clock, frozen_s)


def open_stream(
    url: str, clock: Clock, *, label: str, open_timeout_s: float, read_timeout_s: float, frozen_s: float
) -> CaptureSource:
    """A stream. Raises LinkError when the server cannot be reached, refuses, or sends nothing that FFmpeg understands.

    The dispatcher's deadlines hold whatever FFmpeg does with its own time limits. `url` may hold a password; `label`
    stands in the messages.
    """
    os.environ.setdefault("OPENCV_FFMPEG_CAPTURE_OPTIONS", FFMPEG_OPTIONS)
    parameters = [
        *(cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, round(open_timeout_s * 1000)),
        *(cv2.CAP_PROP_READ_TIMEOUT_MSEC, round(read_timeout_s * 1000)),
        *(cv2.CAP_PROP_N_THREADS, 1),  # FFmpeg's frame threads each hold a frame back
    ]
    capture = cv2.VideoCapture(url, cv2.CAP_FFMPEG, parameters)
    if not capture.isOpened():
        raise LinkError(f"{label}: cannot be opened: no answer, refused, or not a video stream")
    return CaptureSource(capture, label, clock, frozen_s)
