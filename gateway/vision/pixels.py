"""A picture in this package: its layout, the one conversion to it, and the names and order of picture files. Pure."""

import re
from pathlib import Path
from typing import Any, TypeGuard, cast

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]  # (H, W, 3), BGR, 255 is white, unless noted otherwise
DeepImage = NDArray[np.uint16]  # the same with more than 8 bits: 65535 is white, whatever the camera's own is
GreyLevels = NDArray[np.float32]  # the same in grey levels and parts of them, 0 to 255
AnyImage = Image | DeepImage  # of a camera or a file
Colours = Image | GreyLevels
Pixels = Colours | DeepImage  # what the data type says: white is never guessed from the contents

_PER_LEVEL = np.float32(65535 / 255)

# fmt: off
PICTURE_SUFFIXES = frozenset((
    ".avif", ".bmp", ".dib", ".gif", ".hdr", ".jp2", ".jpe", ".jpeg", ".jpg", ".pam", ".pbm", ".pgm", ".pic", ".png",
    ".pnm", ".ppm", ".ras", ".sr", ".tif", ".tiff", ".webp",
))
# fmt: on
_UINT8 = np.dtype(np.uint8)


def bgr8(picture: NDArray[Any]) -> Image:
    """Grey, BGR or BGR with alpha, 8 or 16 bits, as (H, W, 3) uint8.

    Grey is repeated into three channels; alpha is dropped, the stored colours count; 16 bits become round(v / 257), so
    that 65535 is 255. Returns the array itself where nothing is to be done. Raises ValueError for anything else.
    """
    if picture.size == 0 or picture.ndim not in (2, 3):
        raise ValueError(f"an array of shape {picture.shape} is no picture")
    channels = picture.shape[2] if picture.ndim == 3 else 1
    if channels not in (1, 3, 4):
        raise ValueError(f"{channels} channels: only grey, BGR and BGR with alpha are understood")
    if picture.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{picture.dtype} samples: there is no agreed white; store 8 or 16 bit per channel")
    if picture.dtype == np.uint8 and channels == 3:
        return picture
    import cv2  # noqa: PLC0415 - only for what is not a picture of ours yet

    if picture.dtype == np.uint16:
        picture = cv2.convertScaleAbs(picture, alpha=1 / 257)  # 257 is odd: there are no ties
    if channels != 3:
        picture = cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR if channels == 1 else cv2.COLOR_BGRA2BGR)
    return np.asarray(picture, np.uint8)


def bgr(picture: NDArray[Any]) -> AnyImage:
    """As `bgr8`, but colours of 16 bits keep them: (H, W, 3) uint16. Grey becomes 8 bits: it has no red in it."""
    if picture.dtype == np.uint16 and picture.ndim == 3 and picture.shape[2] in (3, 4) and picture.size:
        return np.ascontiguousarray(picture[:, :, :3])
    return bgr8(picture)


def grey_levels(picture: Pixels) -> Colours:
    """In grey levels: 8 bits are the array itself, more of them (H, W, 3) float32 from 0 to 255."""
    if picture.dtype == np.uint16:
        return np.asarray(picture / _PER_LEVEL, np.float32)
    return cast("Colours", picture)


def natural_key(path: Path) -> list[tuple[int, str]]:
    """Sort key in which frame9 is before frame10, regardless of case."""
    parts = re.split(r"([0-9]+)", str(path).casefold())
    return [(int(part), "") if i % 2 else (-1, part) for i, part in enumerate(parts)] + [(-1, str(path))]


def check_bgr8(image: Pixels) -> None:
    """Raises ValueError for anything but a (H, W, 3) uint8 picture with at least one pixel."""
    if image.dtype != np.uint8 or not _is_bgr(image):
        raise ValueError(f"not a (H, W, 3) uint8 picture: {image.shape} {image.dtype}")


def check_picture(picture: Pixels) -> None:
    """The same for uint8, uint16 or float32; also raised where a float32 one leaves 0 to 255 or is not finite."""
    if picture.dtype not in (np.uint8, np.uint16, np.float32) or not _is_bgr(picture):
        raise ValueError(f"not a (H, W, 3) picture of uint8, uint16 or float32: {picture.shape} {picture.dtype}")
    if picture.dtype == np.float32 and not (picture.min() >= 0 and picture.max() <= 255):  # false for NaN
        raise ValueError("float32 pictures are grey levels from 0 to 255")


def _is_bgr(picture: NDArray[Any]) -> bool:
    return picture.ndim == 3 and picture.shape[2] == 3 and picture.size > 0


def adjacent(image: NDArray[Any]) -> TypeGuard[Image]:
    """Whether it is 8-bit BGR and the pixels of each row lie side by side: what the compiled loops read in place."""
    return image.dtype == _UINT8 and image.ndim == 3 and image.strides[1:] == (3, 1)
