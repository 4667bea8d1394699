"""Frames of a GigE Vision or USB3 Vision camera, and its exposure and gain as those of a V4L2 camera: in the same units
(100 us), so that `[camera.controls]` and `camera.exposure = "marker"` work with both. In the vision process only."""

import errno
import logging
import math
from contextlib import suppress
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.clock import Clock
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.errors import LinkError
from gateway.vision.exposure.settings import ExposureRules
from gateway.vision.pixels import AnyImage, bgr
from gateway.vision.source import raw, v4l2_exposure
from gateway.vision.source import v4l2_device as v4l2
from gateway.vision.source.aravis import CONTINUOUS, OFF, AravisCamera, Buffer, DamagedError
from gateway.vision.source.capture import LiveSource
from gateway.vision.source.contract import Frame
from gateway.vision.source.frame_time import LatchedTime
from gateway.vision.source.gige import COLOURS, GigeSpec, SampleFormat, sample_format
from gateway.vision.source.raw_format import RawFormat
from gateway.vision.source.v4l2_controls import CameraControls
from gateway.vision.source.v4l2_device import Range
from gateway.vision.source.v4l2_exposure import UNIT_US, V4l2Exposure

log = logging.getLogger(__name__)

GAIN_STEPS = 10  # a step is 0.1 dB where the camera states its gain in dB
TELL_NS = 60 * NS_PER_S  # between two warnings of lost packets
_FROM_COLOURS = {"RGB": cv2.COLOR_RGB2BGR, "YUYV": cv2.COLOR_YUV2BGR_YUYV, "UYVY": cv2.COLOR_YUV2BGR_UYVY}


def picture(buffer: Buffer, pixel_format: str, raw_format: RawFormat) -> AnyImage:
    """`raw_format`: black level and gains of the samples of more than 8 bits.

    Raises ValueError for a buffer that is too small, and for a format that is not understood.
    """
    height, width = buffer.height_px, buffer.width_px
    if min(height, width) < 2:
        raise ValueError(f"a picture of {width} x {height} px")
    samples = sample_format(pixel_format)
    if samples is None:
        if pixel_format not in COLOURS:
            raise ValueError(f"the pixel format {pixel_format} is not understood")
        order = COLOURS[pixel_format]
        data = _first(buffer, height * width * (3 if "B" in order else 2)).reshape(height, width, -1)
        return np.asarray(data.copy() if order == "BGR" else cv2.cvtColor(data, _FROM_COLOURS[order]), np.uint8)
    if samples.bits == 8:
        grey = _first(buffer, height * width).reshape(height, width)
        return bgr(grey if not samples.mosaic else cv2.cvtColor(grey, raw.FILLED_IN[samples.mosaic]))
    deep = unpacked(_first(buffer, -(-height * width * _bits_a_sample(samples) // 8)), height * width, samples)
    name = f"S{samples.mosaic}{samples.bits}" if samples.mosaic else f"Y{samples.bits}"
    return bgr(raw.picture(deep, (height, width), replace(raw_format, name=name, mosaic=samples.mosaic)))


def unpacked(data: NDArray[np.uint8], count: int, samples: SampleFormat) -> NDArray[np.uint16]:
    """`count` samples of 10, 12 or 16 bits."""
    if not samples.packing:
        return data.view("<u2").astype(np.uint16)
    group = {("p", 10): (4, 5)}.get((samples.packing, samples.bits), (2, 3))  # samples, bytes
    parts = np.pad(data, (0, -data.size % group[1])).reshape(-1, group[1])
    if samples.packing == "Packed":
        low, mask = samples.bits - 8, (1 << samples.bits - 8) - 1
        wide = parts.astype(np.uint16)
        both = np.stack((wide[:, 0] << low | wide[:, 1] & mask, wide[:, 2] << low | wide[:, 1] >> 4 & mask), axis=1)
    else:
        bits = (parts.astype(np.uint64) << (8 * np.arange(group[1], dtype=np.uint64))).sum(axis=1, dtype=np.uint64)
        shifts = np.arange(group[0], dtype=np.uint64) * samples.bits
        both = (bits[:, None] >> shifts & np.uint64((1 << samples.bits) - 1)).astype(np.uint16)
    return np.ascontiguousarray(both.reshape(-1)[:count])


def _bits_a_sample(samples: SampleFormat) -> int:
    return {"": 16, "Packed": 12, "p": samples.bits}[samples.packing]


def _first(buffer: Buffer, size: int) -> NDArray[np.uint8]:
    if buffer.data.size < size:
        raise ValueError(f"{buffer.data.size} bytes are no {buffer.width_px} x {buffer.height_px} px")
    return buffer.data[:size]


class GigeControls:
    """A `ControlDevice`. Its calls raise OSError."""

    def __init__(self, camera: AravisCamera) -> None:
        self._camera = camera
        self._gain_steps = GAIN_STEPS if camera.has("Gain") else 1  # the older GainRaw is a whole number

    def range_of(self, control: int) -> Range | None:
        try:
            match control:
                case v4l2.EXPOSURE_AUTO | v4l2.AUTOGAIN:
                    name = "exposure" if control == v4l2.EXPOSURE_AUTO else "gain"
                    return Range(0, 1, 1) if self._camera.ask(f"is_{name}_auto_available") else None
                case v4l2.EXPOSURE_ABSOLUTE | v4l2.GAIN:
                    name, unit = self._named(control)
                    if not self._camera.ask(f"is_{name}_available"):
                        return None
                    least, most = (one / unit for one in self._camera.bounds(name))
                    # A camera may state no end at all.
                    found = Range(math.ceil(max(least, -1e9)), math.floor(min(most, 1e9)), 1)
                    return found if found.least <= found.most else None
        except LinkError:
            pass
        return None

    def get(self, control: int) -> int:
        try:
            if control in (v4l2.EXPOSURE_AUTO, v4l2.AUTOGAIN):
                name = "exposure_time" if control == v4l2.EXPOSURE_AUTO else "gain"
                manual = self._camera.ask(f"get_{name}_auto") == OFF
                return int(manual if control == v4l2.EXPOSURE_AUTO else not manual)
            name, unit = self._named(control)
            value: float = self._camera.ask(f"get_{name}")
            return round(value / unit)
        except LinkError as error:
            raise OSError(errno.EIO, str(error)) from error

    def set(self, control: int, value: int) -> int:
        try:
            if control in (v4l2.EXPOSURE_AUTO, v4l2.AUTOGAIN):
                manual = value == v4l2.MANUAL if control == v4l2.EXPOSURE_AUTO else not value
                name = "exposure_time" if control == v4l2.EXPOSURE_AUTO else "gain"
                self._camera.ask(f"set_{name}_auto", OFF if manual else CONTINUOUS)
            else:
                name, unit = self._named(control)
                self._camera.ask(f"set_{name}", value * unit)
        except LinkError as error:
            raise OSError(errno.EIO, str(error)) from error
        return self.get(control)

    def close(self) -> None:
        """The camera is its source's."""

    def _named(self, control: int) -> tuple[str, float]:
        """The feature, and what a step of it amounts to."""
        return ("exposure_time", UNIT_US) if control == v4l2.EXPOSURE_ABSOLUTE else ("gain", 1 / self._gain_steps)


class GigeSource(LiveSource):
    """`camera`: set and started. A picture whose packets were lost is skipped and counted."""

    def __init__(self, camera: AravisCamera, spec: GigeSpec, clock: Clock, controls: CameraControls) -> None:
        super().__init__(spec, clock, LatchedTime(camera.clock_ns, clock.now_ns))
        self._spec = spec
        self._camera = camera
        self._controls = controls
        self._exposure: V4l2Exposure | None = None
        self._damaged = self._tell_ns = 0
        self._uncounted = 0  # damaged ones beside that which is counted for its error

    def read(self) -> Frame:
        frame = super().read()
        now_ns = self._clock.now_ns()
        self._damaged += frame.damaged
        if frame.damaged and now_ns >= self._tell_ns:
            again, missing = self._camera.packets
            log.warning(
                "%s: since its opening %d pictures were damaged or lost; %d packets are missing, %d were sent again",
                *(self._label, self._damaged, missing, again),
            )
            self._tell_ns = now_ns + TELL_NS
        self._controls.look(now_ns)
        return frame

    def _next(self) -> Frame:
        """Raises LinkError, and ValueError for a picture that can't be used."""
        try:
            buffer = self._camera.newest(round(1e6 * self._spec.late_s))
        except LinkError as error:
            raise LinkError(f"{self._label}: {error}") from error
        except DamagedError as error:
            self._uncounted += error.count - 1
            raise
        if not self._camera.controlled:
            raise LinkError(f"{self._label}: the camera is no longer under control: unplugged, or taken by another")
        if buffer is None:
            raise LinkError(f"{self._label}: it has sent no picture for {self._spec.late_s:g} s")
        t_capture_ns = self._taken_ns(self._clock.now_ns(), buffer.stamp_ns / NS_PER_MS)
        pixels = picture(buffer, self._camera.pixel_format, self._spec.raw)
        damaged, self._uncounted = buffer.damaged + self._uncounted, 0
        return Frame(pixels, t_capture_ns, damaged=damaged, age_proof=self._frame_time.proof)

    def exposure_controls(self, rules: ExposureRules) -> V4l2Exposure | None:
        device, fps = GigeControls(self._camera), self._spec.fps
        if fps is None:
            with suppress(LinkError):  # it states none: free-running, or triggered
                fps = self._camera.ask("get_frame_rate")
        self._exposure = v4l2_exposure.taken_over(device, self._label, rules, fps or 0.0)
        return self._exposure

    def controls(self) -> CameraControls:
        return self._controls

    def close(self) -> None:
        """With the exposure that it was found with."""
        if self._exposure is not None:
            self._exposure.close()
        self._camera.close()


def open_gige(spec: GigeSpec, clock: Clock) -> GigeSource:
    """Raises LinkError where there is no such camera, another program has it, or it can't be set so."""
    camera = None
    try:
        try:
            camera = AravisCamera(spec.name)
            controls = _set_up(camera, spec)
        except LinkError as error:
            raise LinkError(f"{spec.label}: cannot be opened: {error}") from error
        controls.apply(clock.now_ns())
        return GigeSource(camera, spec, clock, controls)
    except BaseException:
        if camera is not None:
            camera.close()
        raise


def _set_up(camera: AravisCamera, spec: GigeSpec) -> CameraControls:
    if camera.gige != (spec.scheme == "gige"):
        raise LinkError("it is another kind of camera: gige:// is GigE Vision, usb3:// is USB3 Vision")
    if spec.pixel_format is not None:
        camera.ask("set_pixel_format_from_string", spec.pixel_format.encode())
    camera.set_region(*spec.offset_px, spec.width_px, spec.height_px)
    camera.ask("set_acquisition_mode", 0)
    if spec.fps is not None:
        camera.ask("set_frame_rate", spec.fps)
    if camera.gige and spec.packet_size_bytes is not None:
        camera.ask("gv_set_packet_size", spec.packet_size_bytes)
    elif camera.gige:
        camera.ask("gv_auto_packet_size")
    controls = CameraControls(GigeControls(camera), spec.label, spec.controls)
    camera.start()
    return controls
