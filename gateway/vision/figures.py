"""The paper's Figures 3 and 4, drawn from a Trace: single panels to measure in, and captioned sheets to look at.

Panels have the picture's own size and no caption (a small picture's annotated panels are enlarged by a whole factor, so
that the text fits); sheets show them scaled. Only `save` touches a disk.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.errors import ConfigError
from gateway.model import Detection
from gateway.vision.pipeline import Trace
from gateway.vision.pixels import Image

CANNY_LOW, CANNY_HIGH = 50, 150  # the paper gives none; these are the usual ones

Colour = tuple[int, int, int]
_WHITE: Colour = (255, 255, 255)
_INK: Colour = (40, 36, 32)
_GREY: Colour = (120, 114, 108)
_RIM: Colour = (90, 255, 60)
_CENTRE: Colour = (60, 240, 255)

_TILE_W, _TILE_H = 640, 480  # the picture's box in a sheet
_MARGIN = 20
_CAPTION_H = 58
_FONT_PX = 19
_READABLE_PX = 480  # smaller pictures are enlarged before anything is written into them


def figure3(trace: Trace) -> dict[str, NDArray[np.uint8]]:
    """Panels `fig3a-hsv`, `fig3b-mask`, `fig3c-clean`, `fig3d-circle`, and `fig3`, the four as one sheet."""
    tile = _tile_scale(trace.image)
    red, left = (np.count_nonzero(mask) for mask in (trace.initial, trace.cleaned))
    return {
        "fig3a-hsv": trace.hsv,
        "fig3b-mask": trace.initial,
        "fig3c-clean": trace.cleaned,
        "fig3d-circle": _circle_panel(trace, _panel_scale(trace.image)),
        "fig3": _sheet(
            (
                (_scaled(trace.hsv, tile), "(a) HSV colour space", "H, S, V (0-179, 0-255, 0-255) shown as B, G, R"),
                (_scaled(trace.initial, tile), "(b) Initial mask", f"dual red threshold: {red} px"),
                (_scaled(trace.cleaned, tile), "(c) Cleaned mask", f"opening, then closing: {left} px"),
                (_circle_panel(trace, tile), "(d) Circle fit", _choice(trace.detection)),
            )
        ),
    }


def figure4(trace: Trace) -> dict[str, NDArray[np.uint8]]:
    """Panels `fig4a-canny`, `fig4b-contour`, and `fig4`, the two side by side. Both start from the blurred picture."""
    tile = _tile_scale(trace.image)
    edges = cv2.Canny(cv2.cvtColor(trace.blurred, cv2.COLOR_BGR2GRAY), CANNY_LOW, CANNY_HIGH)
    fragments = len(cv2.findContours(edges, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0])
    return {
        "fig4a-canny": np.asarray(edges, np.uint8),
        "fig4b-contour": _contour_panel(trace, _panel_scale(trace.image)),
        "fig4": _sheet(
            (
                (
                    _scaled(edges, tile),
                    f"(a) Canny, thresholds {CANNY_LOW} and {CANNY_HIGH}",
                    _counted(fragments, "connected edge"),
                ),
                (
                    _contour_panel(trace, tile),
                    "(b) HSV and morphology",
                    f"{_counted(len(trace.contours), 'contour')}; {_choice(trace.detection)}",
                ),
            )
        ),
    }


def save(folder: Path, stem: str, pictures: Mapping[str, NDArray[np.uint8]]) -> list[Path]:
    """Write each picture as `folder/stem-<name>.png`, over what is there. Raises ConfigError where that fails."""
    written = []
    for name, picture in pictures.items():
        path = folder / f"{stem}-{name}.png"
        try:
            # Encoded first: OpenCV's own writer says only "false", and crashes on names that are not UTF-8.
            path.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
        except OSError as error:
            raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error
        written.append(path)
    return written


def _circle_panel(trace: Trace, scale: float) -> Image:
    """Panel (d): the picture with circle, centre cross, radius line and the values."""
    panel = _scaled(trace.image, scale)
    return _annotated(panel, trace.detection, scale)


def _contour_panel(trace: Trace, scale: float) -> Image:
    """Figure 4 (b): the borders of the cleaned mask, in the manner of Canny's, with the fitted circle over them."""
    black = np.zeros((*_scaled(trace.cleaned, scale).shape[:2], 3), np.uint8)
    panel = _annotated(black, trace.detection, scale)
    borders = [np.rint(_to_scale(contour, scale)).astype(np.int32) for contour in trace.contours]
    cv2.drawContours(panel, borders, -1, _WHITE, 1)
    return panel


def _annotated(panel: Image, found: Detection, scale: float) -> Image:
    height, width = panel.shape[:2]
    stroke = max(1, round(max(height, width) / 500))
    font_px = max(14, round(max(height, width) / 38))
    circle = found.circle
    if circle is None:
        return _box(panel, (0, 0), (f"no marker ({_counted(found.candidates, 'candidate')})",), font_px)
    centre = _to_scale(np.array([circle.u_px, circle.v_px]), scale)
    radius = circle.radius_px * scale
    arm = max(6.0, 0.12 * radius)
    towards = np.array([math.cos(math.pi / 6), -math.sin(math.pi / 6)])
    for colour, more in ((_INK, 2), (_RIM, 0)):
        _circle(panel, centre, radius, colour, stroke + more)
    for colour, more in ((_INK, 2), (_CENTRE, 0)):
        for step in (np.array([arm, 0]), np.array([0, arm])):
            _line(panel, centre - step, centre + step, colour, stroke + more)
        _line(panel, centre, centre + radius * towards, colour, stroke + more)
    lines = (
        f"u {circle.u_px:.2f}  v {circle.v_px:.2f} px",
        f"R {circle.radius_px:.2f} px",
        f"circularity {found.circularity:.3f}  fill {found.fill:.3f}",
    )
    corner = (int(centre[0] < width / 2), int(centre[1] < height / 2))  # the one farthest from the marker
    return _box(panel, corner, lines, font_px)


def _box(panel: Image, corner: tuple[int, int], lines: Sequence[str], font_px: int) -> Image:
    """Lines of text on a darkened box in a corner: (0, 0) top left, (1, 1) bottom right."""
    height, width = panel.shape[:2]
    pad, step = font_px // 2, round(1.35 * font_px)
    box_w = min(width, max(_text_width(line, font_px) for line in lines) + 2 * pad)
    box_h = min(height, step * len(lines) + pad)
    x, y = corner[0] * (width - box_w), corner[1] * (height - box_h)
    panel[y : y + box_h, x : x + box_w] //= 4
    for n, line in enumerate(lines):
        _text(panel, line, (x + pad, y + pad // 2 + n * step + font_px), _WHITE, font_px)
    return panel


def _sheet(tiles: Sequence[tuple[NDArray[np.uint8], str, str]]) -> Image:
    """Tiles two in a row on white, each with a caption of two lines below."""
    cell_h = max(picture.shape[0] for picture, _, _ in tiles)
    cell_w = max(420, *(picture.shape[1] for picture, _, _ in tiles))
    rows = math.ceil(len(tiles) / 2)
    size = (rows * (cell_h + _CAPTION_H + _MARGIN) + _MARGIN // 2, 2 * (cell_w + _MARGIN) + _MARGIN, 3)
    sheet = np.full(size, 255, np.uint8)
    for n, (picture, title, detail) in enumerate(tiles):
        y = _MARGIN + n // 2 * (cell_h + _CAPTION_H + _MARGIN)
        x = _MARGIN + n % 2 * (cell_w + _MARGIN)
        height, width = picture.shape[:2]
        colour = picture if picture.ndim == 3 else cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
        sheet[y : y + height, x : x + width] = colour
        cv2.rectangle(sheet, (x - 1, y - 1), (x + width, y + height), _GREY, 1)
        _text(sheet, title, (x, y + cell_h + 25), _INK, _FONT_PX, weight=700)
        _text(sheet, detail, (x, y + cell_h + 48), _GREY, _FONT_PX - 4)
    return sheet


def _choice(found: Detection) -> str:
    number = _counted(found.candidates, "contour")
    return f"no marker; {number} larger than S_min" if found.circle is None else f"largest of {number} above S_min"


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _tile_scale(picture: Image) -> float:
    """Fit into a sheet's tile; small pictures grow by a whole factor, so that a pixel stays a square."""
    height, width = picture.shape[:2]
    scale = min(_TILE_W / width, _TILE_H / height)
    return float(math.floor(scale)) if scale >= 1 else float(scale)


def _panel_scale(picture: Image) -> float:
    return float(max(1, math.ceil(_READABLE_PX / max(picture.shape))))


def _scaled(picture: NDArray[Any], scale: float) -> NDArray[np.uint8]:
    """A copy, `scale` times as large."""
    height, width = picture.shape[:2]
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_NEAREST
    return np.array(cv2.resize(picture, size, interpolation=how), np.uint8)


def _to_scale(points: NDArray[Any], scale: float) -> NDArray[np.float64]:
    """Pixel coordinates after scaling: the picture's corner, not the first pixel's centre, stays where it is."""
    return np.asarray((points + 0.5) * scale - 0.5, np.float64)


_SHIFT = 4  # OpenCV draws in sixteenths of a pixel


def _sixteenths(point: NDArray[np.float64]) -> tuple[int, int]:
    return round(float(point[0]) * (1 << _SHIFT)), round(float(point[1]) * (1 << _SHIFT))


def _circle(panel: Image, centre: NDArray[np.float64], radius: float, colour: Colour, stroke: int) -> None:
    size = round(radius * (1 << _SHIFT))
    cv2.circle(panel, _sixteenths(centre), size, colour, stroke, cv2.LINE_AA, _SHIFT)


def _line(panel: Image, start: NDArray[np.float64], end: NDArray[np.float64], colour: Colour, stroke: int) -> None:
    cv2.line(panel, _sixteenths(start), _sixteenths(end), colour, stroke, cv2.LINE_AA, _SHIFT)


def _text(panel: Image, text: str, at: tuple[int, int], colour: Colour, font_px: int, weight: int = 400) -> None:
    cv2.putText(panel, text, at, colour, cv2.FontFace("sans"), font_px, weight)


def _text_width(text: str, font_px: int) -> int:
    return int(cv2.getTextSize((0, 0), text, (0, 0), cv2.FontFace("sans"), font_px, 400)[2])
