"""What a drive is told that moves the vehicle to its place: the record, and what its states mean. Pure."""

from dataclasses import dataclass
from enum import IntEnum


class DriveState(IntEnum):
    """How far the approach is. The numbers are on the wire: never renumber, only add."""

    OFF = 0
    INHIBITED = 1
    NO_DISTANCE = 2
    APPROACH = 3
    CREEP = 4
    SETTLE = 5
    AT_PLACE = 6


DRIVE_MEANING: dict[DriveState, str] = {
    DriveState.OFF: "no drive is configured",
    DriveState.INHIBITED: "stop is on, may_move is off, or something is at fault or in doubt: setpoint 0",
    DriveState.NO_DISTANCE: "the vehicle may move, but there is no measured distance to drive by: setpoint 0",
    DriveState.APPROACH: "on the way to the place",
    DriveState.CREEP: "at creep speed, just before the place",
    DriveState.SETTLE: "setpoint 0: the vehicle runs out, or is waited for until it stands",
    DriveState.AT_PLACE: "the vehicle stands at its place",
}


@dataclass(frozen=True, slots=True)
class Setpoint:
    """For the drive. It never drives away from the spout: `speed_mm_s` is 0 or more, and 0 wherever `enable` is off."""

    state: DriveState = DriveState.OFF
    enable: bool = False  # the drive may run at speed_mm_s
    speed_mm_s: float = 0.0  # towards the spout
    stopping_mm: float | None = None  # way until standstill at worst; None: not known, or no drive is configured

    def withdrawn(self) -> "Setpoint":
        """For a gateway that can't vouch for it any more."""
        return Setpoint() if self.state is DriveState.OFF else Setpoint(DriveState.INHIBITED)
