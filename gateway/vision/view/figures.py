"""The paper's Figures 3 and 4, drawn from a Trace: single panels to measure in, and captioned sheets for display.

Panels have the picture's own size and no caption (a small picture's annotated panels are enlarged by an integer factor,
so that the text fits); sheets show them scaled. Pure.
"""

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.config import VisionConfig
from gateway.core.detection import Detection
from gateway.vision.detect.paper import pipeline
from gateway.vision.detect.paper.pipeline import Trace
from gateway.vision.pixels import Image
from gateway.vision.view.drawing import GREY, INK, WHITE, panel_scale, scaled, to_scale, write
from gateway.vision.view.overlay import annotated, counted

CANNY_LOW, CANNY_HIGH = 50, 150  # the paper gives none; these are the usual ones

_TILE_W, _TILE_H = 640, 480  # the picture's box in a sheet
_MARGIN = 20
_CAPTION_H = 58
_FONT_PX = 19


def of_picture(image: Image, params: VisionConfig, _found: Detection) -> dict[str, NDArray[np.uint8]]:
    """Both figures of a picture."""
    trace = pipeline.trace(image, params)
    return figure3(trace) | figure4(trace)


def figure3(trace: Trace) -> dict[str, NDArray[np.uint8]]:
    """Panels `fig3a-hsv`, `fig3b-mask`, `fig3c-clean`, `fig3d-circle`, and `fig3`, the four as one sheet."""
    tile = _tile_scale(trace.image)
    red, left = (np.count_nonzero(mask) for mask in (trace.initial, trace.cleaned))
    return {
        "fig3a-hsv": trace.hsv,
        "fig3b-mask": trace.initial,
        "fig3c-clean": trace.cleaned,
        "fig3d-circle": _circle_panel(trace, panel_scale(trace.image)),
        "fig3": _sheet(
            (
                (scaled(trace.hsv, tile), "(a) HSV colour space", "H, S, V (0-179, 0-255, 0-255) shown as B, G, R"),
                (scaled(trace.initial, tile), "(b) Initial mask", f"dual red threshold: {red} px"),
                (scaled(trace.cleaned, tile), "(c) Cleaned mask", f"opening, then closing: {left} px"),
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
        "fig4b-contour": _contour_panel(trace, panel_scale(trace.image)),
        "fig4": _sheet(
            (
                (
                    scaled(edges, tile),
                    f"(a) Canny, thresholds {CANNY_LOW} and {CANNY_HIGH}",
                    counted(fragments, "connected edge"),
                ),
                (
                    _contour_panel(trace, tile),
                    "(b) HSV and morphology",
                    f"{counted(len(trace.contours), 'contour')}; {_choice(trace.detection)}",
                ),
            )
        ),
    }


def _circle_panel(trace: Trace, scale: float) -> Image:
    """Panel (d): the picture with circle, centre cross, radius line and the values."""
    panel = scaled(trace.image, scale)
    return annotated(panel, trace.detection, scale)


def _contour_panel(trace: Trace, scale: float) -> Image:
    """Figure 4 (b): the borders of the cleaned mask, in the manner of Canny's, with the fitted circle over them."""
    black = np.zeros((*scaled(trace.cleaned, scale).shape[:2], 3), np.uint8)
    panel = annotated(black, trace.detection, scale)
    borders = [np.rint(to_scale(contour, scale)).astype(np.int32) for contour in trace.contours]
    cv2.drawContours(panel, borders, -1, WHITE, 1)
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
        cv2.rectangle(sheet, (x - 1, y - 1), (x + width, y + height), GREY, 1)
        write(sheet, title, (x, y + cell_h + 25), INK, _FONT_PX, weight=700)
        write(sheet, detail, (x, y + cell_h + 48), GREY, _FONT_PX - 4)
    return sheet


def _choice(found: Detection) -> str:
    number = counted(found.candidates, "contour")
    return f"no marker; {number} larger than S_min" if found.circle is None else f"largest of {number} above S_min"


def _tile_scale(picture: Image) -> float:
    """Fit into a sheet's tile; small pictures grow by an integer factor, so that a pixel stays a square."""
    height, width = picture.shape[:2]
    scale = min(_TILE_W / width, _TILE_H / height)
    return float(math.floor(scale)) if scale >= 1 else float(scale)
