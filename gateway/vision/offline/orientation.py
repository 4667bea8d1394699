"""EXIF orientation of WebP and PNG, which OpenCV applies to no animation, nor where `Exif` stands before it. Pure.

Of JPEG and TIFF it applies it to every picture.
"""

import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

TAG = 0x0112


def orientation(data: bytes) -> int:
    """1 to 8, as in EXIF 2.3; 1 (upright): no other is stated in this WebP or PNG file, or it is damaged."""
    for name, content in _chunks(data):
        if name in (b"EXIF", b"eXIf"):
            found = _stated(content.removeprefix(b"Exif\0\0"))
            return found if 1 <= found <= 8 else 1
    return 1


def upright(picture: NDArray[Any], stated: int) -> NDArray[Any]:
    """The (H, W) or (H, W, channels) picture as it is to be seen."""
    if stated >= 5:
        picture = picture.swapaxes(0, 1)
    if stated in (2, 3, 6, 7):
        picture = picture[:, ::-1]
    if stated in (3, 4, 7, 8):
        picture = picture[::-1]
    return np.ascontiguousarray(picture)


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    if data.startswith(b"\x89PNG"):
        at, length, after = 8, ">I", 4  # a checksum
    elif data[8:12] == b"WEBP":
        at, length, after = 12, "<I", 0
    else:
        return
    while at + 8 <= len(data):
        first, second = data[at : at + 4], data[at + 4 : at + 8]
        name, size = (second, first) if after else (first, second)
        (count,) = struct.unpack(length, size)
        yield name, data[at + 8 : at + 8 + count]
        at += 8 + count + (after or count % 2)


def _stated(tiff: bytes) -> int:
    """Of the first directory; 0: none."""
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(tiff[:4])
    try:
        if order is not None:
            (at,) = struct.unpack_from(f"{order}I", tiff, 4)
            (count,) = struct.unpack_from(f"{order}H", tiff, at)
            for n in range(count):
                tag, _, _, value = struct.unpack_from(f"{order}HHIH", tiff, at + 2 + 12 * n)
                if tag == TAG:
                    return int(value)
    except struct.error:
        pass
    return 0
