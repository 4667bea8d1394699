"""Pictures of the robust method at work on drawn scenes, for the documentation. Pure: the same pixels every time."""

from collections.abc import Callable

import cv2
import numpy as np

from gateway.config import VisionConfig
from gateway.core.detection import Circle, Detection
from gateway.sim import decoys
from gateway.sim.decoys import Drawing
from gateway.vision.detect.robust.detect import detect
from gateway.vision.pixels import Image

WIDTH, HEIGHT, ACROSS = 240, 180, 3
FOUND, REFUSED = (90, 230, 60), (0, 215, 255)  # green; yellow
PLACE = Circle(95.3, 92.8, 38.4)


def _disc(s: Drawing) -> None:
    s.disc(PLACE.u_px, PLACE.v_px, PLACE.radius_px)


def _with(*steps: Callable[[Drawing], None]) -> Callable[[Drawing], None]:
    def paint(sheet: Drawing) -> None:
        for step in steps:
            step(sheet)

    return paint


def _ring_and_text(s: Drawing) -> None:
    s.ring(66, 96, 44, 30)
    s.text("LPG", 130, 118, 50)


def _tube_and_half(s: Drawing) -> None:
    decoys.DECOYS["tube"](s, 60, 90, 36)
    decoys.DECOYS["half disc"](s, 160, 90, 44)


SCENES: tuple[tuple[str, str, Callable[[Drawing], None]], ...] = (
    ("larger square", "concrete", _with(lambda s: s.box(190, 90, 46, 60), _disc)),
    ("in front of red", "wood", _with(lambda s: s.box(150, 92, 70, 28, (40, 30, 150)), _disc)),
    ("30 % hidden", "rust", _with(_disc, lambda s: s.box(146, 92, 30, 90, (95, 100, 98)))),
    ("cut off by the frame", "leaves", lambda s: s.disc(18, 95, 48)),
    ("ring and text: no marker", "concrete", _ring_and_text),
    ("tube and half disc: no marker", "wood", _tube_and_half),
)
"""What is shown: caption, ground, painting."""


def pictures() -> dict[str, Image]:
    """By file name without suffix: a sheet of the scenes with what was found and what was refused, and why."""
    tiles = [_tile(*scene) for scene in SCENES]
    rows = [np.hstack(tiles[i : i + ACROSS]) for i in range(0, len(tiles), ACROSS)]
    return {"vision-robust": np.vstack(rows)}


def _tile(caption: str, ground: str, paint: Callable[[Drawing], None]) -> Image:
    sheet = decoys.sheet(WIDTH, HEIGHT, ground, 7)
    paint(sheet)
    image = sheet.finished(noise=0.0)
    found = detect(image, VisionConfig())
    large = np.asarray(cv2.resize(image, None, fx=1.5, fy=1.5, interpolation=cv2.INTER_LINEAR), np.uint8)
    _draw(large, found)
    large[-20:] //= 3
    cv2.putText(
        large, caption, (6, large.shape[0] - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1, cv2.LINE_AA
    )
    return large // 8 * 8


def _draw(large: Image, found: Detection) -> None:
    for rejection in [r for r in found.rejected if r.why != "rim"][:2]:
        _ring(large, rejection.circle, REFUSED)
        _label(large, rejection.circle, rejection.why, REFUSED)
    if found.circle is not None:
        _ring(large, found.circle, FOUND)
        _label(large, found.circle, f"R {found.circle.radius_px:.1f}", FOUND)


def _ring(large: Image, circle: Circle, colour: tuple[int, int, int]) -> None:
    u, v = ((at + 0.5) * 1.5 - 0.5 for at in (circle.u_px, circle.v_px))
    cv2.circle(large, (round(u * 16), round(v * 16)), round(circle.radius_px * 24), colour, 1, cv2.LINE_AA, 4)


def _label(large: Image, circle: Circle, words: str, colour: tuple[int, int, int]) -> None:
    where = (round(circle.u_px * 1.5) - 18, round(circle.v_px * 1.5) + 4)
    cv2.putText(large, words, where, cv2.FONT_HERSHEY_SIMPLEX, 0.4, (0, 0, 0), 3, cv2.LINE_AA)
    cv2.putText(large, words, where, cv2.FONT_HERSHEY_SIMPLEX, 0.4, colour, 1, cv2.LINE_AA)
