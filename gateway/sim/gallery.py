"""Pictures of the simulated bay for the documentation. Pure: the same pixels every time."""

from collections.abc import Iterable
from typing import Any

import cv2
import numpy as np

from gateway.config import VisionConfig
from gateway.core.detection import Circle
from gateway.sim.canvas import u8
from gateway.sim.render import render
from gateway.sim.scenario import Scenario, parse
from gateway.sim.world import Truth, World
from gateway.vision.detect.paper.pipeline import detect
from gateway.vision.pixels import Image

THUMB = (240, 180)
TRUE, FOUND = (90, 220, 60), (0, 215, 255)  # green, yellow

# What is shown: caption, distance in cm, and what differs from the default scenario.
SCENES: tuple[tuple[str, float, dict[str, Any]], ...] = (
    ("2 m", 200, {}),
    ("60 cm", 60, {}),
    ("28 cm: stop", 28, {}),
    ("shadow", 70, {"light": {"level": 1.25, "gradient": 0.35, "shadow": 0.5}}),
    ("dusk", 70, {"light": {"level": 0.42, "warmth": 0.6, "gradient": 0.4}}),
    ("dust", 90, {"dust": {"density": 1.1, "unevenness": 0.5}}),
)


def pictures() -> dict[str, Image]:
    """By file name without suffix: a sheet of the scenes, and the paper's method before a clean and a rusty port."""
    return {"simulator": _sheet(_thumb(*scene) for scene in SCENES), "simulator-rust": _comparison()}


def _frame(distance_cm: float, over: dict[str, Any]) -> tuple[Scenario, Truth, Image]:
    # Without sensor noise a PNG is half as large.
    scenario = parse({"camera": {"noise": 0.0}, "start": {"distance_cm": distance_cm}, **over})
    truth = World(scenario).truth(0.3)
    return scenario, truth, render(scenario, truth, 0)


def _thumb(caption: str, distance_cm: float, over: dict[str, Any]) -> Image:
    small = u8(cv2.resize(_frame(distance_cm, over)[2], THUMB, interpolation=cv2.INTER_AREA))
    return _captioned(small, caption)


def _comparison() -> Image:
    """Truth in green, the paper's circle in yellow."""
    panels = []
    for caption, over in (("clean", {}), ("rusty", {"seed": 50, "surface": {"rust": 0.8, "stains": 0.9}})):
        _, truth, image = _frame(60, over)
        circle = detect(image, VisionConfig()).circle
        if circle is not None:
            _ring(image, circle, FOUND, 3)
        _ring(image, Circle(truth.u_px, truth.v_px, truth.radius_px), TRUE, 1)
        radius = "none" if circle is None else f"{circle.radius_px:.0f}"
        small = u8(cv2.resize(image, (360, 270), interpolation=cv2.INTER_AREA))
        panels.append(_captioned(small, f"{caption}: R {truth.radius_px:.0f}, found {radius} px"))
    return np.hstack(panels)


def _ring(image: Image, circle: Circle, colour: tuple[int, int, int], width: int) -> None:
    centre = (round(circle.u_px * 16), round(circle.v_px * 16))
    cv2.circle(image, centre, round(circle.radius_px * 16), colour, width, cv2.LINE_AA, 4)


def _captioned(image: Image, caption: str) -> Image:
    """White on a darkened strip: OpenCV's outlined text is not the same width as its plain one."""
    image[-22:] //= 3
    where = (8, image.shape[0] - 6)
    cv2.putText(image, caption, where, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)
    return image


def _sheet(thumbs: Iterable[Image], across: int = 3) -> Image:
    images = list(thumbs)
    return np.vstack([np.hstack(images[i : i + across]) for i in range(0, len(images), across)])
