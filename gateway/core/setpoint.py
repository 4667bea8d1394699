"""What a drive is told that moves the vehicle to its place: the record, and what its states mean. Pure."""

from dataclasses import dataclass

from gateway.explained import ExplainedInt


class DriveState(ExplainedInt):
    """How far the approach is. The numbers are on the wire: never renumber, only add."""

    OFF = 0, "no drive is configured"
    INHIBITED = 1, "stop is on, may_move is off, or something is at fault or in doubt: setpoint 0"
    NO_DISTANCE = 2, "the vehicle may move, but there is no measured distance to drive by: setpoint 0"
    APPROACH = 3, "on the way to the place"
    CREEP = 4, "at creep speed, just before the place"
    SETTLE = 5, "setpoint 0: the vehicle runs out, or is waited for until it stands"
    AT_PLACE = 6, "the vehicle stands at its place"


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
