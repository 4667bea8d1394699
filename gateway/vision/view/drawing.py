"""Lines, circles and words in a picture, placed to a sixteenth of a pixel; and how pictures get to the disk.

Only `made`, `save` and `save_as` touch a disk.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.errors import ConfigError
from gateway.vision.pixels import Image

Colour = tuple[int, int, int]
WHITE: Colour = (255, 255, 255)
INK: Colour = (40, 36, 32)
GREY: Colour = (120, 114, 108)
RIM: Colour = (90, 255, 60)
CENTRE: Colour = (60, 240, 255)
REFUSED: Colour = (60, 150, 255)

READABLE_PX = 480  # smaller pictures are enlarged before anything is written into them


def save(folder: Path, stem: str, pictures: Mapping[str, NDArray[np.uint8]]) -> list[Path]:
    """Write each picture as `folder/stem-<name>.png`, over what is there. Raises ConfigError where that fails."""
    return [save_as(folder / f"{stem}-{name}.png", picture) for name, picture in pictures.items()]


def save_as(path: Path, picture: NDArray[np.uint8]) -> Path:
    """A PNG, over what is there. Raises ConfigError where that fails."""
    try:
        # Encoded first: OpenCV's own writer returns only "false", and crashes on names that are not UTF-8.
        path.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error
    return path


def made(folder: Path) -> Path:
    """The folder, there from now on. Raises ConfigError where that fails."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be made: {error.strerror}") from error
    return folder


def box(panel: Image, corner: tuple[int, int], lines: Sequence[str], font_px: int) -> Image:
    """Lines of text on a darkened box in a corner: (0, 0) top left, (1, 1) bottom right."""
    height, width = panel.shape[:2]
    pad, step = font_px // 2, round(1.35 * font_px)
    box_w = min(width, max(width_of(line, font_px) for line in lines) + 2 * pad)
    box_h = min(height, step * len(lines) + pad)
    x, y = corner[0] * (width - box_w), corner[1] * (height - box_h)
    panel[y : y + box_h, x : x + box_w] //= 4
    for n, line in enumerate(lines):
        write(panel, line, (x + pad, y + pad // 2 + n * step + font_px), WHITE, font_px)
    return panel


def panel_scale(picture: Image) -> float:
    return float(max(1, math.ceil(READABLE_PX / max(picture.shape))))


def scaled(picture: NDArray[Any], scale: float) -> NDArray[np.uint8]:
    """A copy, `scale` times as large."""
    height, width = picture.shape[:2]
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_NEAREST
    return np.array(cv2.resize(picture, size, interpolation=how), np.uint8)


def to_scale(points: NDArray[Any], scale: float) -> NDArray[np.float64]:
    """Pixel coordinates after scaling: the picture's corner, not the first pixel's centre, stays where it is."""
    return np.asarray((points + 0.5) * scale - 0.5, np.float64)


_SHIFT = 4  # OpenCV draws in sixteenths of a pixel


def _sixteenths(point: NDArray[np.float64]) -> tuple[int, int]:
    return round(float(point[0]) * (1 << _SHIFT)), round(float(point[1]) * (1 << _SHIFT))


def ring(panel: Image, centre: NDArray[np.float64], radius: float, colour: Colour, wide: int) -> None:
    size = round(radius * (1 << _SHIFT))
    cv2.circle(panel, _sixteenths(centre), size, colour, wide, cv2.LINE_AA, _SHIFT)


def stroke(panel: Image, start: NDArray[np.float64], end: NDArray[np.float64], colour: Colour, wide: int) -> None:
    cv2.line(panel, _sixteenths(start), _sixteenths(end), colour, wide, cv2.LINE_AA, _SHIFT)


def curve(panel: Image, points: NDArray[np.float64], colour: Colour, wide: int) -> None:
    """A closed one through (n, 2) points."""
    fixed_point = np.rint(points * (1 << _SHIFT)).astype(np.int32)
    cv2.polylines(panel, [fixed_point.reshape(-1, 1, 2)], True, colour, wide, cv2.LINE_AA, _SHIFT)


def write(panel: Image, words: str, at: tuple[int, int], colour: Colour, font_px: int, weight: int = 400) -> None:
    cv2.putText(panel, words, at, colour, cv2.FontFace("sans"), font_px, weight)


def width_of(words: str, font_px: int) -> int:
    return int(cv2.getTextSize((0, 0), words, (0, 0), cv2.FontFace("sans"), font_px, 400)[2])
