"""Contact sheets, one a condition: its frames with the true circle and every method's answer drawn in them. IO."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from gateway.core.detection import Circle
from gateway.sim.canvas import Colour, u8
from gateway.vision.offline.evaluation.scoring import ScoredPicture
from gateway.vision.pixels import Image
from gateway.vision.view import drawing

CELL_PX = 400  # width of a frame
ACROSS = 3
HEAD_PX, GAP_PX = 28, 4
DARK = 64  # a frame whose 99.5th percentile is below this is shown brighter
TRUTH = (90, 220, 60)  # BGR
ANSWERS = ((255, 181, 53), (60, 225, 255), (255, 80, 230), (255, 255, 255))
MOST = 12  # frames of a condition


class Sheets:
    """One PNG a condition in `folder`. Raises ConfigError where it or one of them can't be written."""

    def __init__(self, folder: Path) -> None:
        self._folder = drawing.made(folder)
        self._cells: dict[str, list[Image]] = {}
        self._methods: tuple[str, ...] = ()

    def add(self, condition: str, image: Image, answers: Mapping[str, ScoredPicture]) -> None:
        self._methods = tuple(answers)
        cells = self._cells.setdefault(condition, [])
        if len(cells) < MOST:
            cells.append(_cell(image, answers))

    def write(self) -> None:
        for name, cells in self._cells.items():
            drawing.save_as(self._folder / f"{name}.png", _sheet(name, cells, self._methods))


def _sheet(title: str, cells: Sequence[Image], methods: Sequence[str]) -> Image:
    height = max(cell.shape[0] for cell in cells)
    across = min(ACROSS, len(cells))
    rows = -(-len(cells) // across)
    picture = np.zeros((HEAD_PX + rows * (height + GAP_PX), across * (CELL_PX + GAP_PX), 3), np.uint8)
    for at, cell in enumerate(cells):
        y, x = HEAD_PX + at // across * (height + GAP_PX), at % across * (CELL_PX + GAP_PX)
        picture[y : y + cell.shape[0], x : x + CELL_PX] = cell
    x = _text(picture, title, GAP_PX, (255, 255, 255))
    for name, colour in zip(("truth", *methods), (TRUTH, *_colours(len(methods))), strict=True):
        x = _text(picture, name, x, colour)
    return picture


def _colours(count: int) -> list[Colour]:
    return [ANSWERS[at % len(ANSWERS)] for at in range(count)]


def _text(picture: Image, words: str, x: int, colour: Colour) -> int:
    """Where the next word begins."""
    cv2.putText(picture, words, (x, 19), cv2.FONT_HERSHEY_DUPLEX, 0.5, colour, 1, cv2.LINE_AA)
    return x + cv2.getTextSize(words, cv2.FONT_HERSHEY_DUPLEX, 0.5, 1)[0][0] + 16


def _cell(image: Image, answers: Mapping[str, ScoredPicture]) -> Image:
    scale = CELL_PX / image.shape[1]
    light = float(np.percentile(image, 99.5))
    shown = np.clip(image * (160 / max(light, 1)), 0, 255).astype(np.uint8) if light < DARK else image
    cell = u8(cv2.resize(shown, (CELL_PX, round(scale * image.shape[0])), interpolation=cv2.INTER_AREA))
    truth = next(iter(answers.values())).label.circle
    if truth is not None:
        _ring(cell, truth, scale, TRUTH, 3)
    for answer, colour in zip(answers.values(), _colours(len(answers)), strict=True):
        if answer.detection.circle is not None:
            _ring(cell, answer.detection.circle, scale, colour, 1)
    return cell


def _ring(cell: Image, circle: Circle, scale: float, colour: Colour, wide: int) -> None:
    u, v, radius = (circle.u_px + 0.5) * scale - 0.5, (circle.v_px + 0.5) * scale - 0.5, circle.radius_px * scale
    cv2.circle(cell, (round(u * 16), round(v * 16)), round(radius * 16), colour, wide, cv2.LINE_AA, 4)
    cv2.drawMarker(cell, (round(u), round(v)), colour, cv2.MARKER_CROSS, 8, 1)
