"""GigE Vision and USB3 Vision cameras through Aravis (libaravis-0.8), which is the system's: by ctypes. IO.

Only the functions that a source of frames needs. ctypes releases Python's lock during each call. Every method raises
LinkError with Aravis' own words where the camera refuses or is gone.
"""

import ctypes
from contextlib import suppress
from ctypes import POINTER, byref, c_char_p, c_double, c_int, c_size_t, c_uint, c_uint32, c_uint64, c_void_p
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.durations import NS_PER_S
from gateway.errors import LinkError

LIBRARY = "libaravis-0.8.so.0"
BUFFERS = 4
MOST_HELD_BYTES = 64 << 20
MOST_GAP = 1000  # pictures that may be lost at once
FIXED = 0  # ArvGvStreamSocketBuffer
OFF, CONTINUOUS = 0, 2  # ArvAuto; 0 is also ARV_ACQUISITION_MODE_CONTINUOUS
SUCCESS, MISSING_PACKETS = 0, 3  # ArvBufferStatus
STATUS = MappingProxyType({2: "did not end in time", MISSING_PACKETS: "packets were lost", 5: "of another size"})
CLOCKS = (
    ("TimestampLatch", "TimestampLatchValue", ""),
    ("GevTimestampControlLatch", "GevTimestampValue", "GevTimestampTickFrequency"),
)
"""Command, value and, where that is not ns, ticks a second; GenICam's names, and those of GigE Vision 1."""
_INT, _DOUBLE = POINTER(c_int), POINTER(c_double)
# fmt: off
_PLAIN: dict[str, tuple[Any, ...]] = {  # name: result, arguments
    "g_object_unref": (None, c_void_p), "g_error_free": (None, c_void_p),
    "arv_camera_get_device": (c_void_p, c_void_p), "arv_camera_is_gv_device": (c_int, c_void_p),
    "arv_gv_device_is_controller": (c_int, c_void_p), "arv_buffer_new_allocate": (c_void_p, c_size_t),
    "arv_stream_push_buffer": (None, c_void_p, c_void_p),
    "arv_stream_timeout_pop_buffer": (c_void_p, c_void_p, c_uint64),
    "arv_stream_try_pop_buffer": (c_void_p, c_void_p),
    "arv_gv_stream_get_statistics": (None, c_void_p, POINTER(c_uint64), POINTER(c_uint64)),
    "arv_buffer_get_status": (c_int, c_void_p), "arv_buffer_get_frame_id": (c_uint64, c_void_p),
    "arv_buffer_get_timestamp": (c_uint64, c_void_p),
    "arv_buffer_get_data": (c_void_p, c_void_p, POINTER(c_size_t)),
    "arv_buffer_get_system_timestamp": (c_uint64, c_void_p), "arv_buffer_get_image_pixel_format": (c_uint32, c_void_p),
    "arv_buffer_get_image_padding": (None, c_void_p, _INT, _INT),
    "arv_buffer_get_image_width": (c_int, c_void_p), "arv_buffer_get_image_height": (c_int, c_void_p),
}
_FALLIBLE: dict[str, tuple[Any, ...]] = {  # the same; a GError** follows
    "arv_camera_new": (c_void_p, c_char_p),
    "arv_camera_set_pixel_format_from_string": (None, c_void_p, c_char_p),
    "arv_camera_get_pixel_format_as_string": (c_char_p, c_void_p), "arv_camera_get_pixel_format": (c_uint32, c_void_p),
    "arv_camera_set_region": (None, c_void_p, c_int, c_int, c_int, c_int),
    "arv_camera_get_region": (None, c_void_p, _INT, _INT, _INT, _INT),
    "arv_camera_set_acquisition_mode": (None, c_void_p, c_int),
    "arv_camera_set_frame_rate": (None, c_void_p, c_double), "arv_camera_get_frame_rate": (c_double, c_void_p),
    "arv_camera_is_feature_available": (c_int, c_void_p, c_char_p),
    "arv_camera_get_payload": (c_uint, c_void_p),
    "arv_camera_gv_set_packet_size": (None, c_void_p, c_int), "arv_camera_gv_auto_packet_size": (c_uint, c_void_p),
    "arv_camera_create_stream": (c_void_p, c_void_p, c_void_p, c_void_p),
    "arv_camera_start_acquisition": (None, c_void_p), "arv_camera_stop_acquisition": (None, c_void_p),
    "arv_camera_execute_command": (None, c_void_p, c_char_p),
    "arv_camera_get_integer": (ctypes.c_int64, c_void_p, c_char_p),
    **{f"arv_camera_is_{it}_available": (c_int, c_void_p)
       for it in ("exposure_time", "gain", "exposure_auto", "gain_auto")},
    **{f"arv_camera_get_{it}_bounds": (None, c_void_p, _DOUBLE, _DOUBLE) for it in ("exposure_time", "gain")},
    **{f"arv_camera_get_{it}": (c_double, c_void_p) for it in ("exposure_time", "gain")},
    **{f"arv_camera_set_{it}": (None, c_void_p, c_double) for it in ("exposure_time", "gain")},
    **{f"arv_camera_get_{it}_auto": (c_int, c_void_p) for it in ("exposure_time", "gain")},
    **{f"arv_camera_set_{it}_auto": (None, c_void_p, c_int) for it in ("exposure_time", "gain")},
}
# fmt: on


class _GError(ctypes.Structure):
    _fields_ = (("domain", ctypes.c_uint32), ("code", c_int), ("message", c_char_p))


@cache
def _library() -> ctypes.CDLL:
    """Raises LinkError where the system does not have it, or one that is too old."""
    try:
        library = ctypes.CDLL(LIBRARY)
    except OSError as error:
        raise LinkError(f"needs {LIBRARY} of the system (Debian: apt-get install libaravis-0.8-0): {error}") from error
    for names, last in ((_PLAIN, ()), (_FALLIBLE, (c_void_p,))):
        for name, (result, *arguments) in names.items():
            function = getattr(library, name, None)
            if function is None:
                raise LinkError(f"needs a newer {LIBRARY}: it lacks {name}")
            function.restype, function.argtypes = result, (*arguments, *last)
    return library


def _call(name: str, *arguments: Any) -> Any:
    """Of `_FALLIBLE`. Raises LinkError."""
    error = c_void_p()
    result = getattr(_library(), name)(*arguments, byref(error))
    if error:
        message = ctypes.cast(error, POINTER(_GError)).contents.message
        _library().g_error_free(error)
        raise LinkError((message or b"").decode(errors="replace") or f"{name} failed")
    return result


@dataclass(frozen=True, slots=True)
class Buffer:
    """One picture as it came. `data`: a copy. `stamp_ns`: by the camera's clock; 0: it has none."""

    data: NDArray[np.uint8]
    width_px: int
    height_px: int
    stamp_ns: int
    damaged: int = 0  # beside this one, since the last


class DamagedError(ValueError):
    """So many pictures that did not arrive whole."""

    def __init__(self, why: str, count: int) -> None:
        super().__init__(why)
        self.count = count


class AravisCamera:
    """One camera. `name`: address, serial number, or one of Aravis' identifiers."""

    def __init__(self, name: str) -> None:
        self.pixel_format = ""  # from `start` on
        self._format = 0  # its number, which each picture carries
        self._last_id = 0  # of the picture that came last
        self._stream: int | None = None
        self._camera: int | None = _call("arv_camera_new", name.encode())
        if not self._camera:
            raise LinkError("there is no such camera")
        self.gige = bool(_library().arv_camera_is_gv_device(self._camera))
        self._device = _library().arv_camera_get_device(self._camera)

    def ask(self, what: str, *arguments: Any) -> Any:
        """`arv_camera_<what>`."""
        if self._camera is None:
            raise LinkError("the camera is closed")
        return _call(f"arv_camera_{what}", self._camera, *arguments)

    def bounds(self, what: str) -> tuple[float, float]:
        least, most = c_double(), c_double()
        self.ask(f"get_{what}_bounds", byref(least), byref(most))
        return least.value, most.value

    def has(self, feature: str) -> bool:
        return bool(self.ask("is_feature_available", feature.encode()))

    def clock_ns(self) -> int | None:
        """The camera's clock, now; None: it can't be read."""
        for latch, value, rate in CLOCKS:
            with suppress(LinkError):
                if self.has(latch) and self.has(value):
                    self.ask("execute_command", latch.encode())
                    ticks: int = self.ask("get_integer", value.encode())
                    return ticks * NS_PER_S // self.ask("get_integer", rate.encode()) if rate else ticks
        return None

    def set_region(self, x_px: int, y_px: int, width_px: int | None, height_px: int | None) -> None:
        """Without a size it stays what it is."""
        now = [c_int() for _ in range(4)]
        self.ask("get_region", *map(byref, now))
        self.ask("set_region", x_px, y_px, width_px or now[2].value, height_px or now[3].value)

    def start(self) -> None:
        """After all settings."""
        name: bytes | None = self.ask("get_pixel_format_as_string")
        if name is None:
            raise LinkError("it states no pixel format")
        self.pixel_format = name.decode(errors="replace")
        self._format = self.ask("get_pixel_format")
        payload = self.ask("get_payload")
        self._stream = self.ask("create_stream", None, None)
        if not self._stream:
            raise LinkError("it gives no stream")
        if self.gige:
            # Aravis asks the kernel to hold one picture: too little where the pictures come in bursts. The kernel gives
            # net.core.rmem_max at most.
            size = c_int(min(BUFFERS * payload, MOST_HELD_BYTES))
            properties = (b"socket-buffer", c_int(FIXED), b"socket-buffer-size", size, None)
            _library().g_object_set(c_void_p(self._stream), *properties)
        for _ in range(BUFFERS):
            _library().arv_stream_push_buffer(self._stream, _library().arv_buffer_new_allocate(payload))
        self.ask("start_acquisition")

    @property
    def controlled(self) -> bool:
        """False: another program controls it now, or its heartbeat went unanswered. USB3 Vision: true."""
        return not self.gige or bool(_library().arv_gv_device_is_controller(self._device))

    @property
    def packets(self) -> tuple[int, int]:
        """Since `start`: sent again, and missing for good. USB3 Vision: 0."""
        again, missing = c_uint64(), c_uint64()
        if self.gige and self._stream:
            _library().arv_gv_stream_get_statistics(self._stream, byref(again), byref(missing))
        return again.value, missing.value

    def newest(self, timeout_us: int) -> Buffer | None:
        """The newest whole one that waits, or the next one; None: none in this time.

        Raises DamagedError where all were damaged, and LinkError for a layout that was not agreed on.
        """
        library = _library()
        found, damaged, why = None, 0, ""
        buffer = library.arv_stream_timeout_pop_buffer(self._stream, timeout_us)
        while buffer:
            damaged += self._lost_before(library.arv_buffer_get_frame_id(buffer))
            status = library.arv_buffer_get_status(buffer)
            if status == SUCCESS:
                found, buffer = buffer, found
            else:
                damaged, why = damaged + 1, STATUS.get(status, f"its transfer failed ({status})")
            if buffer:
                library.arv_stream_push_buffer(self._stream, buffer)
            buffer = library.arv_stream_try_pop_buffer(self._stream)
        if not found:
            if damaged:
                raise DamagedError(why, damaged)
            return None
        try:
            return self._copied(found, damaged)
        finally:
            library.arv_stream_push_buffer(self._stream, found)

    def _lost_before(self, frame_id: int) -> int:
        """Pictures of which nothing came. The camera's count of them begins anew at 65535, or when it is set to."""
        before, self._last_id = self._last_id, frame_id
        gap = frame_id - before - 1
        return gap if before and 0 < gap <= MOST_GAP else 0

    def _copied(self, buffer: int, damaged: int) -> Buffer:
        library = _library()
        padding, size = c_int(), c_size_t()
        library.arv_buffer_get_image_padding(buffer, byref(padding), None)
        if padding.value:
            raise LinkError(f"its rows end in {padding.value} bytes of padding, which is not understood: another width")
        if (own := library.arv_buffer_get_image_pixel_format(buffer)) != self._format:
            raise LinkError(
                f"its picture's pixel format is 0x{own:08x}, not {self.pixel_format} (0x{self._format:08x})"
            )
        address = library.arv_buffer_get_data(buffer, byref(size))
        stamp_ns = library.arv_buffer_get_timestamp(buffer)
        if stamp_ns == library.arv_buffer_get_system_timestamp(buffer):
            stamp_ns = 0  # the camera states no tick frequency: Aravis gives the time of arrival instead
        return Buffer(
            np.frombuffer(ctypes.string_at(address, size.value), np.uint8),
            library.arv_buffer_get_image_width(buffer),
            library.arv_buffer_get_image_height(buffer),
            stamp_ns,
            damaged,
        )

    def close(self) -> None:
        if self._stream:
            with suppress(LinkError):  # it is gone
                self.ask("stop_acquisition")
            _library().g_object_unref(self._stream)
        if self._camera:
            _library().g_object_unref(self._camera)
        self._stream = self._camera = None
