"""The documentation's pictures, which `./dev docs` writes to docs/images. The same pixels every time."""

from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np

from gateway.config import VisionConfig
from gateway.core.detection import Circle
from gateway.sim.canvas import u8
from gateway.sim.render import render
from gateway.sim.scenario import Scenario, parse
from gateway.sim.world import Truth, World
from gateway.vision.detect.paper import pipeline
from gateway.vision.detect.robust.detect import detect
from gateway.vision.pixels import Image
from gateway.vision.view.figures import figure3, figure4
from tests import decoys, example_scene
from tests.decoys import Drawing

THUMB = (240, 180)
GREEN, BRIGHT_GREEN, YELLOW, WHITE = (90, 220, 60), (90, 230, 60), (0, 215, 255), (255, 255, 255)
RUSTY: dict[str, Any] = {"seed": 50, "surface": {"rust": 0.8, "stains": 0.9}}

# Caption, distance in cm, and what differs from the default scenario.
BAY_SCENES: tuple[tuple[str, float, dict[str, Any]], ...] = (
    ("2 m", 200, {}),
    ("60 cm", 60, {}),
    ("28 cm: stop", 28, {}),
    ("shadow", 70, {"light": {"level": 1.25, "gradient": 0.35, "shadow": 0.5}}),
    ("dusk", 70, {"light": {"level": 0.42, "warmth": 0.6, "gradient": 0.4}}),
    ("dust", 90, {"dust": {"density": 1.1, "unevenness": 0.5}}),
)


def _disc(s: Drawing) -> None:
    s.disc(95.3, 92.8, 38.4)


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


DRAWN_SCENES: tuple[tuple[str, str, Callable[[Drawing], None]], ...] = (
    ("larger square", "concrete", _with(lambda s: s.box(190, 90, 46, 60), _disc)),
    ("in front of red", "wood", _with(lambda s: s.box(150, 92, 70, 28, (40, 30, 150)), _disc)),
    ("30 % hidden", "rust", _with(_disc, lambda s: s.box(146, 92, 30, 90, (95, 100, 98)))),
    ("cut off by the frame", "leaves", lambda s: s.disc(18, 95, 48)),
    ("ring and text: no marker", "concrete", _ring_and_text),
    ("tube and half disc: no marker", "wood", _tube_and_half),
)
"""Caption, ground, painting."""


def pictures() -> dict[str, Image]:
    """By file name without suffix."""
    trace = pipeline.trace(example_scene.scene(), VisionConfig())
    return {
        "simulator": _sheet([_thumb(*scene) for scene in BAY_SCENES]),
        "simulator-rust": np.hstack([_beside_truth("clean", {}), _beside_truth("rusty", RUSTY)]),
        "vision-fig3": _reduced(figure3(trace)["fig3"]),
        "vision-fig4": _reduced(figure4(trace)["fig4"]),
        "vision-robust": _sheet([_found(*scene) for scene in DRAWN_SCENES]),
    }


def _sheet(tiles: Sequence[Image], across: int = 3) -> Image:
    return np.vstack([np.hstack(tiles[i : i + across]) for i in range(0, len(tiles), across)])


def _reduced(sheet: Image) -> Image:
    """In size and to 64 levels."""
    small = u8(cv2.resize(sheet, None, fx=0.65, fy=0.65, interpolation=cv2.INTER_AREA))
    return small // 4 * 4 + small // 64  # black stays 0, white 255


def _frame(distance_cm: float, over: dict[str, Any]) -> tuple[Scenario, Truth, Image]:
    # Without sensor noise a PNG is half as large.
    scenario = parse({"camera": {"noise": 0.0}, "start": {"distance_cm": distance_cm}, **over})
    truth = World(scenario).truth(0.3)
    return scenario, truth, render(scenario, truth, 0)


def _thumb(caption: str, distance_cm: float, over: dict[str, Any]) -> Image:
    small = u8(cv2.resize(_frame(distance_cm, over)[2], THUMB, interpolation=cv2.INTER_AREA))
    return _captioned(small, caption, 22, (8, 6), 0.5)


def _beside_truth(caption: str, over: dict[str, Any]) -> Image:
    """Truth in green, the paper's circle in yellow."""
    _, truth, image = _frame(60, over)
    circle = pipeline.detect(image, VisionConfig()).circle
    if circle is not None:
        _ring(image, circle, YELLOW, 3)
    _ring(image, Circle(truth.u_px, truth.v_px, truth.radius_px), GREEN, 1)
    radius = "none" if circle is None else f"{circle.radius_px:.0f}"
    small = u8(cv2.resize(image, (360, 270), interpolation=cv2.INTER_AREA))
    return _captioned(small, f"{caption}: R {truth.radius_px:.0f}, found {radius} px", 22, (8, 6), 0.5)


def _found(caption: str, ground: str, paint: Callable[[Drawing], None]) -> Image:
    """What the robust method has found in green, what it has refused, and why, in yellow."""
    sheet = decoys.sheet(*THUMB, ground, 7)
    paint(sheet)
    image = sheet.finished(noise=0.0)
    found = detect(image, VisionConfig())
    large = u8(cv2.resize(image, None, fx=1.5, fy=1.5, interpolation=cv2.INTER_LINEAR))
    for rejection in [r for r in found.rejected if r.why != "rim"][:2]:
        _labelled(large, rejection.circle, rejection.why, YELLOW)
    if found.circle is not None:
        _labelled(large, found.circle, f"R {found.circle.radius_px:.1f}", BRIGHT_GREEN)
    return _captioned(large, caption, 20, (6, 6), 0.45) // 8 * 8


def _labelled(large: Image, circle: Circle, words: str, colour: tuple[int, int, int]) -> None:
    u, v = ((at + 0.5) * 1.5 - 0.5 for at in (circle.u_px, circle.v_px))
    _ring(large, Circle(u, v, 1.5 * circle.radius_px), colour, 1)
    where = (round(circle.u_px * 1.5) - 18, round(circle.v_px * 1.5) + 4)
    for ink, width in (((0, 0, 0), 3), (colour, 1)):
        cv2.putText(large, words, where, cv2.FONT_HERSHEY_SIMPLEX, 0.4, ink, width, cv2.LINE_AA)


def _ring(image: Image, circle: Circle, colour: tuple[int, int, int], width: int) -> None:
    centre = (round(circle.u_px * 16), round(circle.v_px * 16))
    cv2.circle(image, centre, round(circle.radius_px * 16), colour, width, cv2.LINE_AA, 4)


def _captioned(image: Image, caption: str, strip_px: int, corner_px: tuple[int, int], size: float) -> Image:
    """White on a darkened strip: OpenCV's outlined text is not the same width as its plain one."""
    image[-strip_px:] //= 3
    where = (corner_px[0], image.shape[0] - corner_px[1])
    cv2.putText(image, caption, where, cv2.FONT_HERSHEY_SIMPLEX, size, WHITE, 1, cv2.LINE_AA)
    return image
