"""The loops of `candidates` in C: their memory, and what is asked of them. Pure."""

import ctypes
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gateway.vision.compiled.sizes import BLOBS, PEAKS, THRESHOLDS
from gateway.vision.detect.robust.redness import Plane, log_table
from gateway.vision.pixels import Image

_Pointer, _Int, _Real = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double


class VoteTask(ctypes.Structure):
    _fields_ = (
        *((name, _Pointer) for name in ("size", "largest", "gx", "gy")),
        *((name, _Int) for name in ("height", "width")),
        ("radii", _Pointer),
        ("radius_count", _Int),
        *((name, _Real) for name in ("outer", "middle")),
        ("peaks", _Real * (4 * PEAKS)),
    )


class _Blob(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int32) for name in ("left", "top", "width", "height")),
        *((name, ctypes.c_float) for name in ("radius", "fill")),
        ("first", _Int),
    )


class BlobTask(ctypes.Structure):
    _fields_ = (
        ("red", _Pointer),
        *((name, _Int) for name in ("height", "width", "factor")),
        ("shares", _Real * THRESHOLDS),
        *((name, _Real) for name in ("smallest", "largest")),
        ("counts", _Int * THRESHOLDS),
        ("blobs", _Blob * BLOBS * THRESHOLDS),
    )


class CandidateKernel:
    """The compiled loops. May be called from any thread: each call has memory of its own."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._redness = library.gateway_redness
        self._redness.argtypes = [_Pointer, _Pointer, _Pointer]
        self._redness.restype = None
        self._votes, self._blobs = library.gateway_votes, library.gateway_blobs
        self._vote_room, self._blob_room = library.gateway_vote_room, library.gateway_blob_room
        for call in (self._votes, self._blobs):
            call.argtypes = [_Pointer, _Pointer]
        for room in (self._vote_room, self._blob_room):
            room.argtypes = [_Pointer]
            room.restype = _Int
        self._votes.restype, self._blobs.restype = ctypes.c_int, None
        self._rooms: list[NDArray[np.uint8]] = []

    def redness(self, picture: Image, gain: float = 1.0) -> Plane:
        """As `redness.redness`, for a picture whose pixels lie side by side."""
        height, width = picture.shape[:2]
        red = np.empty((height, width), np.float32)
        described = (_Int * 4)(picture.ctypes.data, picture.strides[0], height, width)
        log = log_table(gain)
        self._redness(ctypes.addressof(described), log.ctypes.data, red.ctypes.data)
        return red

    def votes(
        self, planes: tuple[Plane, Plane, Plane, Plane], radii: Plane, blur: tuple[float, float]
    ) -> list[tuple[int, int, int, float]]:
        """Row and column of a cell, number of the radius, and the votes, of the best peaks, the best first.

        `planes`: size of the gradient, the largest size around, and its parts along u and v, side by side; `blur`: of
        the votes, the weights of a cell's neighbours and its own.
        """
        size, largest, gx, gy = planes
        task = VoteTask(
            size.ctypes.data, largest.ctypes.data, gx.ctypes.data, gy.ctypes.data, *size.shape, radii.ctypes.data,
            radii.size, *blur,
        )  # fmt: skip
        at = ctypes.addressof(task)
        room = self._room(self._vote_room(at))
        count = self._votes(at, room.ctypes.data)
        self._rooms.append(room)
        return [
            (int(row), int(column), int(radius), votes)
            for row, column, radius, votes in (task.peaks[4 * n : 4 * n + 4] for n in range(count))
        ]

    def blobs(
        self, red: Plane, shares: Sequence[float], factor: int, radii_px: tuple[float, float]
    ) -> list[tuple[float, float, int, int, float, float]]:
        """Left, top, width, height, radius (px of the full frame) and fill of the largest round ones, by threshold."""
        task = BlobTask(red.ctypes.data, *red.shape, factor, (_Real * THRESHOLDS)(*shares), *radii_px)
        at = ctypes.addressof(task)
        room = self._room(self._blob_room(at))
        self._blobs(at, room.ctypes.data)
        self._rooms.append(room)
        return [
            (blob.left, blob.top, blob.width, blob.height, blob.radius, blob.fill)
            for count, some in zip(task.counts, task.blobs, strict=True)
            for blob in some[:count]
        ]

    def _room(self, size: int) -> NDArray[np.uint8]:
        room = self._rooms.pop() if self._rooms else np.empty(size, np.uint8)
        return room if room.size >= size else np.empty(size, np.uint8)
