"""In C: whether the air of a sparse picture is clear, and what is red in it; and pictures less a veil. Pure.

References: `veil.estimate`, `red_change.red_regions_plain` in clear air, `veil.unveiled_plain`.
"""

import ctypes
import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.vision.detect.robust.redness import LOG, Plane
from gateway.vision.pixels import Image

_PICTURE = struct.Struct("=5q")
_Pointer, _Int = ctypes.c_void_p, ctypes.c_int64


class VeilLight(NamedTuple):
    """A veil's light over a picture of (height, width), as `veil.light_over` makes it."""

    rows: Plane  # (n, width, 3)
    above: NDArray[np.int32]  # (height,): rows of that which each row of the picture lies between
    below: NDArray[np.int32]
    share: Plane  # (height,): of the lower one


class _Unveiling(ctypes.Structure):
    _fields_ = (
        *((name, _Int) for name in ("pixels", "stride", "height", "width")),
        *((name, _Pointer) for name in VeilLight._fields),
        ("gain", ctypes.c_double),
        ("out", _Pointer),
    )


class AirKernel:
    """The compiled decision, and what follows from it. May be called from any thread."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._call, self._unveiled = library.gateway_air_is_clear, library.gateway_unveiled
        self._call.argtypes = [ctypes.c_char_p]
        self._call.restype = ctypes.c_int
        self._unveiled.argtypes = [_Pointer]
        self._unveiled.restype = None

    def is_clear(self, picture: Image, every: int = 1) -> bool:
        """Whether `veil.estimate` finds no veil in every so many pixels of a picture whose pixels lie side by side.

        These make a picture of `sizes.MOST_VEIL_SIDE` at most.
        """
        height, width = picture.shape[:2]
        stride = picture.strides[0]
        at = picture.__array_interface__["data"][0]
        described = _PICTURE.pack(at, every * stride, 3 * every, -(-height // every), -(-width // every))
        return bool(self._call(described))

    def unveiled(self, picture: Image, light: VeilLight, gain: float) -> Image:
        """As `veil.unveiled_plain`, for a picture whose pixels lie side by side."""
        out = np.empty(picture.shape, np.uint8)
        at = (plane.ctypes.data for plane in light)
        task = _Unveiling(picture.ctypes.data, picture.strides[0], *picture.shape[:2], *at, gain, out.ctypes.data)
        self._unveiled(ctypes.addressof(task))
        return out


class RegionTask(ctypes.Structure):
    _fields_ = (
        *((name, _Int) for name in ("pixels", "stride", "height", "width")),
        *((name, _Int) for name in ("step", "u", "v", "inner", "outer")),
        ("log", _Pointer),
        ("faint", _Int),
    )


class RegionKernel:
    """The compiled check. May be called from any thread: each call has memory of its own."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._call, self._room_of = library.gateway_red_regions, library.gateway_region_room
        self._call.argtypes = [_Pointer, _Pointer]
        self._room_of.argtypes = [_Pointer]
        self._call.restype = self._room_of.restype = _Int
        self._log = np.ascontiguousarray(LOG)
        self._rooms: list[NDArray[np.int32]] = []

    def regions(
        self, image: Image, step: int, at: tuple[int, int], inner_px: int, outer_px: int
    ) -> tuple[NDArray[np.int32], bool] | None:
        """Boxes and faintness as in `red_change.RedRegions`, for a picture whose pixels lie side by side.

        The centre and the radii are those of what is followed, in the sparse picture. None where there may be a veil.
        """
        place = image.__array_interface__["data"][0]
        task = RegionTask(
            place,
            image.strides[0],
            *image.shape[:2],
            step,
            *at,
            inner_px,
            outer_px,
            self._log.ctypes.data,
        )
        where = ctypes.addressof(task)
        room = self._room(self._room_of(where))
        count = self._call(where, room.ctypes.data)
        boxes = room[: 4 * max(0, count)].reshape(-1, 4).copy()
        self._rooms.append(room)
        return (boxes, bool(task.faint)) if count >= 0 else None

    def _room(self, size: int) -> NDArray[np.int32]:
        room = self._rooms.pop() if self._rooms else np.empty(0, np.int32)
        return room if room.nbytes >= size else np.empty(-(-size // 4), np.int32)
