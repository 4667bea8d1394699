"""Whether the air of a small picture is clear, in C: what `veil.estimate` says of nearly all frames. Pure."""

import ctypes
import struct

from gateway.vision.pixels import Image

_PICTURE = struct.Struct("=5q")


class AirKernel:
    """The compiled decision. May be called from any thread."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._call = library.gateway_air_is_clear
        self._call.argtypes = [ctypes.c_char_p]
        self._call.restype = ctypes.c_int

    def is_clear(self, picture: Image, every: int = 1) -> bool:
        """Whether `veil.estimate` finds no veil in every so many pixels of a picture whose pixels lie side by side.

        These make a picture of `sizes.MOST_VEIL_SIDE` at most.
        """
        height, width = picture.shape[:2]
        stride = picture.strides[0]
        at = picture.__array_interface__["data"][0]
        described = _PICTURE.pack(at, every * stride, 3 * every, -(-height // every), -(-width // every))
        return bool(self._call(described))
