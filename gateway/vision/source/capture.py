"""What gives frames at its own pace: all that is live, and cameras (V4L2). Imported in the vision process only."""

import os
from dataclasses import replace
from glob import glob
from typing import TYPE_CHECKING, Any, Protocol

import cv2
from numpy.typing import NDArray

from gateway.clock import Clock, suspended_ns
from gateway.durations import NS_PER_S
from gateway.errors import LinkError
from gateway.vision.exposure.settings import ExposureRules
from gateway.vision.pixels import bgr
from gateway.vision.source import ffmpeg, raw, v4l2_controls, v4l2_exposure
from gateway.vision.source.contract import Frame, Source
from gateway.vision.source.frame_time import ArrivalTime, BufferTime, FrameTime
from gateway.vision.source.v4l2_controls import CameraControls
from gateway.vision.source.v4l2_device import V4l2Device, device_path
from gateway.vision.source.v4l2_exposure import V4l2Exposure

if TYPE_CHECKING:
    from gateway.vision.source.specs import CameraSpec, StreamSpec


class LiveSpec(Protocol):
    """What `LiveSource` reads of a spec."""

    @property
    def label(self) -> str: ...

    @property
    def by_arrival(self) -> bool: ...

    @property
    def late_s(self) -> float: ...


class LiveSource(Source):
    """Frames arrive at their own pace, and the newest is the one that counts.

    A frame that can't be decoded is skipped and counted: no frame takes its place, so that the age grows.

    `stamps`: of its frames, unless the spec has the time of arrival instead. A source whose frames have been later than
    `late_s` of the spec for as long is lost. Opened again, it begins without a backlog.
    """

    def __init__(self, spec: "LiveSpec", clock: Clock, stamps: FrameTime) -> None:
        self._label = spec.label
        self._clock = clock
        self._frame_time = ArrivalTime() if spec.by_arrival else stamps
        self._late_ns = round(spec.late_s * NS_PER_S)
        self._late_since_ns: int | None = None

    def read(self) -> Frame:
        why = ""
        for damaged in range(ffmpeg.MOST_DAMAGED):
            try:
                frame = self._next()
                return replace(frame, damaged=frame.damaged + damaged)
            except ValueError as error:
                why = str(error)
        raise LinkError(f"{self._label}: lost: {why}")

    def _next(self) -> Frame:
        """Raises LinkError, and ValueError for a frame that can't be used."""
        raise NotImplementedError

    def _taken_ns(self, arrival_ns: int, stamp_ms: float) -> int:
        """When the frame was taken. Raises LinkError where frames stay late."""
        taken_ns = self._frame_time.taken_ns(arrival_ns, stamp_ms)
        late_ns = arrival_ns - taken_ns
        if late_ns <= self._late_ns:
            self._late_since_ns = None
        elif self._late_since_ns is None:
            self._late_since_ns = arrival_ns
        elif arrival_ns - self._late_since_ns > self._late_ns:
            raise LinkError(f"{self._label}: its frames arrive {late_ns / NS_PER_S:.1f} s late")
        return taken_ns


class CaptureSource(LiveSource):
    """Through OpenCV."""

    def __init__(
        self, capture: cv2.VideoCapture, spec: "CameraSpec | StreamSpec", clock: Clock, stamps: FrameTime
    ) -> None:
        super().__init__(spec, clock, stamps)
        self._capture = capture

    def _next(self) -> Frame:
        if not self._capture.grab():  # FFmpeg decodes here, and goes on with the next frame
            raise ValueError("it gave no further frame")
        arrival_ns = self._clock.now_ns()  # before the conversion to BGR, which takes its time
        t_capture_ns = self._taken_ns(arrival_ns, self._capture.get(cv2.CAP_PROP_POS_MSEC))
        ok, image = self._capture.retrieve()
        if not ok or image is None:
            raise ValueError("its frames could not be decoded")
        return Frame(bgr(self._decoded(image)), t_capture_ns, age_proof=self._frame_time.proof)

    def _decoded(self, image: NDArray[Any]) -> NDArray[Any]:
        """What the driver handed over, as colours or grey. Raises ValueError where it can't be that."""
        return image

    def close(self) -> None:
        self._capture.release()


class CameraSource(CaptureSource):
    """A V4L2 camera, whose exposure may be controlled. `controls`: None: it is left as it is. `handle`: of its device,
    for a process that may open none any more (`Needs.DEVICE`)."""

    def __init__(
        self,
        capture: cv2.VideoCapture,
        spec: "CameraSpec",
        clock: Clock,
        controls: CameraControls | None = None,
        handle: V4l2Device | None = None,
    ) -> None:
        super().__init__(capture, spec, clock, BufferTime(suspended_ns))
        self._handle = handle
        self._spec = spec
        self._raw = spec.raw
        self._exposure: V4l2Exposure | None = None
        self._controls = controls
        self._begun = False

    def read(self) -> Frame:
        frame = super().read()
        if self._controls is not None:
            now_ns = self._clock.now_ns()
            if self._begun:
                self._controls.look(now_ns)
            else:
                self._controls.apply(now_ns)  # again: some cameras begin each stream with their own
                self._begun = True
        return frame

    def _decoded(self, image: NDArray[Any]) -> NDArray[Any]:
        if self._raw is None:
            return image
        height, width = (int(self._capture.get(key)) for key in (cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FRAME_WIDTH))
        return raw.picture(image, (height, width), self._raw)

    def exposure_controls(self, rules: ExposureRules) -> V4l2Exposure | None:
        fps = self._capture.get(cv2.CAP_PROP_FPS)
        self._exposure = v4l2_exposure.exposure_controls(self._spec.device, self._label, rules, fps, self._handle)
        return self._exposure

    def controls(self) -> CameraControls:
        """Raises LinkError where the device can't be opened once more."""
        if self._controls is None:
            self._controls = v4l2_controls.opened(self._spec.device, self._label, (), self._handle)
        return self._controls

    def close(self) -> None:
        """With the exposure that it was found with."""
        if self._exposure is not None:
            self._exposure.close()
        if self._controls is not None:
            self._controls.close()
        if self._handle is not None:
            self._handle.close()
        super().close()


def open_camera(spec: "CameraSpec", clock: Clock) -> CameraSource:
    """A V4L2 camera. Raises LinkError when there is no such camera, or another program has it."""
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)  # it warns of what is raised here
    capture = cv2.VideoCapture(spec.device, cv2.CAP_V4L2)
    if not capture.isOpened():
        raise LinkError(f"{spec.label}: cannot be opened: {_why_not(device_path(spec.device))}")
    if spec.raw is not None:
        # Without the conversion OpenCV hands over the buffer as it is: bytes, or 16-bit samples of what it knows.
        capture.set(cv2.CAP_PROP_FOURCC, spec.raw.fourcc)
        capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
    wishes = (
        (cv2.CAP_PROP_FRAME_WIDTH, spec.width_px),
        (cv2.CAP_PROP_FRAME_HEIGHT, spec.height_px),
        (cv2.CAP_PROP_FPS, spec.fps),
    )
    for key, wish in wishes:
        if wish is not None:
            capture.set(key, wish)  # a driver may give something else without an error: the first frame is checked
    if spec.raw is not None and int(capture.get(cv2.CAP_PROP_FOURCC)) != spec.raw.fourcc:
        capture.release()
        raise LinkError(f"{spec.label}: camera.raw.format: it does not give {spec.raw.name}")
    try:
        handle = V4l2Device(device_path(spec.device))
    except OSError:  # what needs it tries again, and says why it can't
        handle = None
    if not spec.controls:
        return CameraSource(capture, spec, clock, None, handle)
    try:
        controls = v4l2_controls.opened(spec.device, spec.label, spec.controls, handle)
        controls.apply(clock.now_ns())
    except LinkError:
        capture.release()
        if handle is not None:
            handle.close()
        raise
    return CameraSource(capture, spec, clock, controls, handle)


def _why_not(path: str) -> str:
    """OpenCV does not say."""
    try:
        os.close(os.open(path, os.O_RDWR | os.O_NONBLOCK))
    except FileNotFoundError:
        return f"no such device; there is {', '.join(sorted(glob('/dev/video*'))) or 'no /dev/video*'}"
    except OSError as error:
        return f"{path}: {error.strerror}".lower()
    return "another program has it, or it is no camera"
