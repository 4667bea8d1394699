"""Whether the air of a small picture is clear, in C: what `veil.estimate` says of nearly all frames. Pure."""

import ctypes
import struct

from gateway.vision.pixels import Image

_PICTURE = struct.Struct("=4q")


class AirKernel:
    """The compiled decision. May be called from any thread."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._call = library.gateway_air_is_clear
        self._call.argtypes = [ctypes.c_char_p]
        self._call.restype = ctypes.c_int

    def is_clear(self, picture: Image) -> bool:
        """Whether `veil.estimate` finds no veil in a picture whose pixels lie side by side."""
        at = picture.__array_interface__["data"][0]
        return bool(self._call(_PICTURE.pack(at, picture.strides[0], *picture.shape[:2])))
