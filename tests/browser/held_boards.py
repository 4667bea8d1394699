"""A bay before whose camera a drawn board is held, in one pose after the other: for the calibration page."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from gateway.vision.offline.calibration.boards import parse
from tests.browser.plant import first_visit
from tests.e2e.brokers import free_port
from tests.e2e.processes import Gateway
from tests.e2e.sim_ranger import Ranger
from tests.unit.vision.board_pictures import Camera, Pose, shot

BOARD = parse("checkerboard:8x6:18mm")
TRUE = Camera(640, 480, 620.0, 616.0, 326.0, 232.0, (-0.22, 0.08, 0.0008, -0.0006))
POSES = tuple(
    Pose(x, y, z, (a, b, c))
    for x, y, z, a, b, c in (
        (0, 0, 380, 0, 0, 0), (-80, -55, 400, 25, 0, 4), (80, 55, 400, -28, 5, -6), (-80, 55, 420, 0, 30, 3),
        (80, -55, 420, 4, -30, 0), (0, 0, 560, 35, 20, 10), (-110, 0, 480, -20, -25, -8), (40, 75, 460, 18, 28, 20),
        (-40, -75, 470, -30, 18, -15), (110, 10, 490, -10, 35, 5), (-10, 40, 330, 12, -15, -3),
    )
)  # fmt: skip
HELD = 7  # pictures of each, 5 a second
FILE = """\
# The lens of this bay is not known yet.
instance = "{instance}"

[modbus]
port = {modbus}

[hmi]
enabled = true
port = {hmi}
without_login = "technician"

[camera]
url = "{boards}"         # a board is held before the camera
fps = 5
loop = true

[ranger]
port = "{ranger}"
"""


@dataclass(frozen=True)
class BoardPlant:
    """`url` ends without a slash."""

    url: str
    config: Path


@contextmanager
def board_plant(folder: Path) -> Iterator[BoardPlant]:
    boards, config, hmi = folder / "boards", folder / "plant.toml", free_port()
    boards.mkdir()
    for n, pose in enumerate(POSES):
        drawn = shot(BOARD, pose, TRUE, seed=n)
        for again in range(HELD):  # no two alike: a camera that repeats a picture is reported
            noise = np.random.default_rng(again).integers(0, 3, drawn.shape[:2], np.uint8)
            assert cv2.imwrite(str(boards / f"{n:02}-{again}.png"), cv2.add(drawn, cv2.merge([noise] * 3)))
    with Ranger() as ranger:
        ranger.distance_mm = 1500.0
        places = {"boards": boards, "modbus": free_port(), "hmi": hmi, "ranger": ranger.port}
        config.write_text(FILE.format(instance=f"{folder.name}-{os.getpid()}", **places))
        with Gateway("run", str(config)) as gateway:
            _until_started(gateway)
            first_visit(f"http://127.0.0.1:{hmi}")
            yield BoardPlant(f"http://127.0.0.1:{hmi}", config)


def _until_started(gateway: Gateway, timeout_s: float = 60.0) -> None:
    """Until it says where it serves."""
    deadline = time.monotonic() + timeout_s
    while not any("Modbus TCP on" in line for line in gateway.other):
        assert time.monotonic() < deadline, gateway.stderr
        time.sleep(0.05)
