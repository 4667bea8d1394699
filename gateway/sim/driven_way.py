"""Where a driven vehicle is, between the process that moves it and the camera's, which sees it.

A file has the newest places, each in a slot of its own: it never grows. As `led.py`, with motion instead of light.
"""

import os
import struct
from dataclasses import dataclass
from pathlib import Path

PLACES = 512  # 10 s: so far back the late and repeated pictures of a scenario may reach
PLACE = struct.Struct("=ddd")  # world time s, way mm, speed mm/s
AHEAD_S = 0.1  # so far beyond the newest place it is taken to go on at its speed


class WayFile:
    """The writer's end."""

    def __init__(self, path: str) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        self._count = 0

    def drove(self, t_s: float, way_mm: float, speed_mm_s: float) -> None:
        """Times ascend."""
        os.pwrite(self._file, PLACE.pack(t_s, way_mm, speed_mm_s), self._count % PLACES * PLACE.size)
        self._count += 1

    def close(self) -> None:
        os.close(self._file)


@dataclass(frozen=True, slots=True)
class DrivenWay:
    """The reader's end."""

    path: str

    def at(self, t_s: float) -> tuple[float, float]:
        """Way in mm and speed in mm/s at a world time; before the first place it has not moved."""
        try:
            data = Path(self.path).read_bytes()
        except FileNotFoundError:
            return 0.0, 0.0
        places = sorted(PLACE.iter_unpack(data[: len(data) // PLACE.size * PLACE.size]))
        before = [place for place in places if place[0] <= t_s]
        if not before:
            return 0.0, 0.0
        then_s, way_mm, speed_mm_s = before[-1]
        return way_mm + speed_mm_s * min(t_s - then_s, AHEAD_S), speed_mm_s
