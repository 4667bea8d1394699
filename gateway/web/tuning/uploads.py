"""Pictures that technicians upload, to try settings on. Pure.

Only JPEG and PNG, and only of a size that the file's header shows to be small enough, before anything is decoded.
"""

import base64
import binascii
import struct
from typing import TYPE_CHECKING

from gateway.errors import GatewayError

if TYPE_CHECKING:
    from gateway.vision.pixels import Image

MAX_FILE_BYTES = 8 << 20
MAX_PIXELS = 16_000_000
MAX_TEXT = 4 * -(-MAX_FILE_BYTES // 3)  # characters of base64
MIN_SIDE_PX = 16
_PNG = b"\x89PNG\r\n\x1a\n"
_FRAME_HEADERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # ITU-T T.81, table B.1: SOF markers
_ALONE = frozenset({0x01, *range(0xD0, 0xD8)})  # markers without a length


class UploadError(GatewayError):
    """Not a picture that is taken."""


def decoded(text: str) -> "Image":
    """(H, W, 3) uint8, BGR, of a file in base64. Raises UploadError."""
    return image_of(contents(text))


def contents(text: str) -> bytes:
    """Of a file in base64. Raises UploadError."""
    try:
        return base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        raise UploadError("not base64") from None


def check(data: bytes) -> None:
    """By the file's header only: nothing is decoded. Raises UploadError."""
    if len(data) > MAX_FILE_BYTES:
        raise UploadError(f"a file of {len(data)} bytes: at most {MAX_FILE_BYTES}")
    size = size_of(data)
    if size is None:
        raise UploadError("not a JPEG or PNG picture")
    width, height = size
    if min(width, height) < MIN_SIDE_PX or width * height > MAX_PIXELS:
        raise UploadError(
            f"a picture of {width} x {height} px: at least {MIN_SIDE_PX} px each way, at most {MAX_PIXELS} px in all"
        )


def image_of(data: bytes) -> "Image":
    """(H, W, 3) uint8, BGR, of a picture's file. Raises UploadError."""
    from gateway.vision.offline import inputs  # noqa: PLC0415 - OpenCV: the process that keeps test sets does without

    check(data)
    try:
        return inputs.decode(data)
    except inputs.InputError as error:
        raise UploadError(str(error)) from None


def size_of(data: bytes) -> tuple[int, int] | None:
    """Width and height as a PNG's or JPEG's header shows them, px. None: it is neither."""
    if data.startswith(_PNG):
        if data[12:16] != b"IHDR" or len(data) < 24:
            return None
        width, height = struct.unpack(">II", data[16:24])
        return width, height
    if not data.startswith(b"\xff\xd8\xff"):
        return None
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF or marker in _ALONE:  # fill bytes
            at += 1 if marker == 0xFF else 2
            continue
        if marker in _FRAME_HEADERS:
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            return width, height
        at += 2 + int.from_bytes(data[at + 2 : at + 4])
    return None
