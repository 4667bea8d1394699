"""Frames for the speed benchmarks: rendered by the simulator, and the worst that could be thought of. Seeded."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from gateway.sim.render import Painter
from gateway.sim.scenario import parse
from gateway.sim.world import World
from gateway.vision.pixels import Image

SIZES: dict[str, tuple[int, int]] = {
    "VGA": (640, 480),
    "720p": (1280, 720),
    "1080p": (1920, 1080),
    "5 MP": (2592, 1944),
}
LARGEST_RENDERED = (
    1920,
    1440,
)  # the simulator's camera; larger frames are its frames, enlarged, with noise of their own
FPS = 30.0


def approach(width: int, height: int, count: int, **over: Any) -> list[Image]:
    """`count` neighbouring frames of a truck at 1.5 m coming nearer: port, clutter, vibration, noise."""
    scale = min(1.0, LARGEST_RENDERED[0] / width, LARGEST_RENDERED[1] / height)
    size = (round(width * scale), round(height * scale))
    scenario = parse(
        {
            "seed": 3,
            "camera": {"width_px": size[0], "height_px": size[1], "focal_px": 600.0 * size[0] / 640, "fps": FPS},
            "start": {"distance_cm": 150.0, "lateral_mm": -40.0, "vertical_mm": 20.0},
            "legs": [{"distance_cm": 28.0, "speed_cm_s": 15.0}],
            **over,
        }
    )
    painter, world = Painter(scenario), World(scenario)
    frames = [painter.frame(world.truth(1.0 + n / FPS), n) for n in range(count)]
    return frames if scale == 1.0 else [_enlarged(frame, width, height, n) for n, frame in enumerate(frames)]


def one_disc(width: int, height: int, count: int) -> list[Image]:
    """A red disc, R = 80 px at 1080p, that moves on grey with noise."""
    chance, scale = np.random.default_rng(12), height / 1080
    frames = []
    for n in range(count):
        frame = np.full((height, width, 3), (120, 125, 122), np.uint8)
        centre = (round((800 + 4 * n) * scale), round((500 + 2 * n) * scale))
        cv2.circle(frame, centre, round(80 * scale), (40, 35, 190), -1, cv2.LINE_AA)
        frames.append(np.clip(frame + chance.normal(0, 4, frame.shape), 0, 255).astype(np.uint8))
    return frames


def dark_red(width: int, height: int, count: int) -> list[Image]:
    """All of it red."""
    return [np.full((height, width, 3), (40, 35, 170 + n % 16), np.uint8) for n in range(count)]


def colour_noise(width: int, height: int, count: int) -> list[Image]:
    """Every pixel a colour of its own."""
    return [
        np.random.default_rng([9, n]).integers(0, 256, (height, width, 3), dtype=np.uint8) for n in range(min(count, 4))
    ] * -(-count // 4)


def red_blotches(width: int, height: int, count: int) -> list[Image]:
    """Hundreds of red blobs, each on its own, that come and go."""
    frames = []
    for n in range(count):
        chance = np.random.default_rng([10, n])
        frame = np.full((height, width, 3), 120, np.uint8)
        for u, v, radius in chance.uniform((0, 0, 4), (width, height, 12), (300, 3)):
            cv2.circle(frame, (round(u), round(v)), round(radius), (40, 35, 190), -1)
        frames.append(frame)
    return frames


SCENES: dict[str, Any] = {
    "approach": approach,
    "approach, rust": lambda w, h, n: approach(w, h, n, surface={"rust": 0.8, "stains": 0.9}),
    "one disc": one_disc,
    "all red": dark_red,
    "colour noise": colour_noise,
    "300 red blobs": red_blotches,
}


def back_and_forth(frames: Sequence[Image]) -> list[Image]:
    """So that a sequence can be run round and round without a jump."""
    return [*frames, *frames[-2:0:-1]]


def _enlarged(frame: Image, width: int, height: int, seed: int) -> Image:
    large = np.asarray(cv2.resize(frame, (width, height), interpolation=cv2.INTER_CUBIC), np.int16)
    noise = np.random.default_rng([11, seed]).normal(0, 1.5, large.shape)
    return np.asarray(np.clip(large + np.rint(noise), 0, 255), np.uint8)
