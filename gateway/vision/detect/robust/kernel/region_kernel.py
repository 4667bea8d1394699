"""The red spots of a sparse picture, in C: `red_change.red_regions_plain` in clear air. Pure."""

import ctypes

import numpy as np
from numpy.typing import NDArray

from gateway.vision.detect.robust.redness import LOG
from gateway.vision.pixels import Image

_Pointer, _Int = ctypes.c_void_p, ctypes.c_int64


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
