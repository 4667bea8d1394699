"""Where a driven vehicle is, between the process that moves it and the camera's, which sees it."""

import struct
from dataclasses import dataclass

from gateway.sim.ring_file import RingFile, records

PLACES = 512  # 10 s: so far back the late and repeated pictures of a scenario may reach
PLACE = struct.Struct("=ddd")  # world time s, way mm, speed mm/s
AHEAD_S = 0.1  # so far beyond the newest place it is taken to go on at its speed


class WayFile(RingFile):
    """The writer's end."""

    def __init__(self, path: str) -> None:
        super().__init__(path, PLACE, PLACES)

    def drove(self, t_s: float, way_mm: float, speed_mm_s: float) -> None:
        """Times ascend."""
        self.put(t_s, way_mm, speed_mm_s)


@dataclass(frozen=True, slots=True)
class DrivenWay:
    """The reader's end."""

    path: str

    def at(self, t_s: float) -> tuple[float, float]:
        """Way in mm and speed in mm/s at a world time; before the first place it has not moved."""
        before = [place for place in records(self.path, PLACE) if place[0] <= t_s]
        if not before:
            return 0.0, 0.0
        then_s, way_mm, speed_mm_s = before[-1]
        return way_mm + speed_mm_s * min(t_s - then_s, AHEAD_S), speed_mm_s
