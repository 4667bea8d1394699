"""The beacon's LED between the simulated board, which switches it, and the simulated camera, which sees it.

They are in two processes, so a file has the newest cycles of the board.
"""

import struct
from dataclasses import dataclass

from gateway.config import CameraConfig
from gateway.sim.ring_file import RingFile, records
from gateway.vision.source.framing import Framing, SizePx

CYCLES = 256  # 15 s: so far back the late and repeated pictures of a scenario may reach
CYCLE = struct.Struct("=qq")  # begin, ns of the clock, and whether the LED is lit; firmware/bench writes it, too


class LedFile(RingFile):
    """The writer's end, made with the first cycle."""

    def __init__(self, path: str) -> None:
        super().__init__(path, CYCLE, CYCLES)

    def show(self, t_ns: int, lit: bool) -> None:
        """From `t_ns` on, which is not earlier than the one before."""
        self.put(t_ns, lit)


@dataclass(frozen=True, slots=True)
class Led:
    """The reader's end, and where in the delivered picture the LED is, px."""

    path: str
    u_px: float
    v_px: float
    radius_px: float

    @staticmethod
    def of(camera: CameraConfig, path: str, delivered_px: SizePx) -> "Led | None":
        """Where `camera.beacon` says; None: it says nothing."""
        place = camera.beacon
        if place is None:
            return None
        u_px, v_px = Framing.of(camera).delivered(place.u_px, place.v_px, delivered_px)
        return Led(path, u_px, v_px, place.radius_px)

    def lit(self, from_ns: int, until_ns: int) -> float:
        """In which share of this time it is lit, 0 to 1. In what no cycle is known of, it is dark."""
        cycles = records(self.path, CYCLE)  # none: the board was not asked for the beacon yet
        until_ns = max(until_ns, from_ns + 1)
        ends = [*(begin_ns for begin_ns, _ in cycles[1:]), until_ns]
        lit_ns: int = sum(
            max(0, min(end_ns, until_ns) - max(begin_ns, from_ns))
            for (begin_ns, lit), end_ns in zip(cycles, ends, strict=False)
            if lit
        )
        return lit_ns / (until_ns - from_ns)
