"""The PLC's two programs on virtual time: the exported FB_Approach, and the plain one that it is compared with. Pure.

Each is called once a scan with what the newest poll brought, and returns the speed reference for the drive, mm/s. Where
an approach has ended early, the program begins another one with a new start edge, START_AGAIN_S after the vehicle may
move again.
"""

from dataclasses import dataclass
from typing import Protocol

from gateway.core.state import Reason

SCAN_S = 0.02
POLL_S = 0.2
LIFE_S = 0.5  # the life sign must change within this time
START_AGAIN_S = 1.0
AT_MARK = frozenset({Reason.TARGET_REACHED, Reason.CLEARING})  # a stop by these does not end an approach


@dataclass(frozen=True, slots=True)
class Image:
    """What one poll reads, of the registers that a program uses."""

    heartbeat: int
    may_move: bool
    reason: Reason
    distance_mm: float | None
    drive_enable: bool = False
    speed_mm_s: int = 0


class Program(Protocol):
    def scan(self, now_s: float, image: Image | None) -> float:
        """`image`: None where no poll has been answered since the last scan."""
        ...


class _Sequence:
    """Is an approach on its way? By life sign, stop and start edge, as in FB_Approach."""

    def __init__(self) -> None:
        self.image: Image | None = None
        self.alive = self.busy = False
        self._changed_s = -1e9
        self._allowed_since_s: float | None = None

    def scan(self, now_s: float, image: Image | None) -> None:
        if image is not None:
            if self.image is None or image.heartbeat != self.image.heartbeat:
                self._changed_s = now_s
            self.image = image
        self.alive = now_s - self._changed_s <= LIFE_S
        allowed = self.alive and self.image is not None and self.image.may_move
        if not allowed:
            self._allowed_since_s = None
        elif self._allowed_since_s is None:
            self._allowed_since_s = now_s
        reached = self.image is not None and self.image.reason in AT_MARK
        self.busy &= allowed or (self.alive and reached)
        self.busy |= self._allowed_since_s is not None and now_s - self._allowed_since_s >= START_AGAIN_S


class ApproachBlock:
    """As FB_Approach: never above the setpoint, up along its own ramp, down by itself without a life sign."""

    def __init__(self, acceleration_mm_s2: float, deceleration_mm_s2: float) -> None:
        self._up_mm_s, self._down_mm_s = acceleration_mm_s2 * SCAN_S, deceleration_mm_s2 * SCAN_S
        self._sequence = _Sequence()
        self._reference_mm_s = 0.0

    def scan(self, now_s: float, image: Image | None) -> float:
        sequence = self._sequence
        sequence.scan(now_s, image)
        newest = sequence.image
        self._reference_mm_s += self._up_mm_s if sequence.busy else -self._down_mm_s
        if sequence.alive and newest is not None:
            permitted = newest.may_move and newest.drive_enable
            self._reference_mm_s = min(self._reference_mm_s, newest.speed_mm_s if permitted else 0.0)
        self._reference_mm_s = max(0.0, self._reference_mm_s)
        return self._reference_mm_s


class PlainProgram:
    """Full speed, slow from a distance on, stop at D: what is written without a setpoint."""

    def __init__(self, full_mm_s: float, creep_mm_s: float, slow_mm: float, acceleration_mm_s2: float) -> None:
        self._full_mm_s, self._creep_mm_s, self._slow_mm = full_mm_s, creep_mm_s, slow_mm
        self._up_mm_s = acceleration_mm_s2 * SCAN_S
        self._sequence = _Sequence()
        self._reference_mm_s = 0.0

    def scan(self, now_s: float, image: Image | None) -> float:
        sequence = self._sequence
        sequence.scan(now_s, image)
        newest, allowed_mm_s = sequence.image, 0.0
        if sequence.busy and newest is not None and newest.may_move and newest.distance_mm is not None:
            allowed_mm_s = self._full_mm_s if newest.distance_mm > self._slow_mm else self._creep_mm_s
        self._reference_mm_s = min(allowed_mm_s, self._reference_mm_s + self._up_mm_s)
        return self._reference_mm_s
