"""Row 100: what a signal for the driver shows, one bit a lamp, so that a PLC copies bits to outputs. Pure.

It decides nothing: the instruction is `guidance`, and whatever does not direct the truck to drive is red. Exactly one
of red, amber and green is on in every image; with `stop`, or without `may_move`, red, whatever the instruction.
Blinking is left to the PLC: polls every 50 to 100 ms would make a blinking bit irregular, and a poll that fails would
leave its lamp on or off.
"""

from gateway.core.state import GuidanceCode, StateVector
from gateway.explained import ExplainedInt
from gateway.modbus.registers.register import UINT16, Register, Value, named


class Lamp(ExplainedInt):
    """The bits of `signal_lamps`. Never renumber, only add."""

    RED = 0, "red lamp: stand; on whenever neither amber nor green is, also when nothing is known"
    AMBER = 1, "amber lamp: drive on slowly; never while stop is on or may_move is off"
    GREEN = 2, "green lamp: drive; never while stop is on or may_move is off"
    FORWARD = 3, "arrow: forward"
    BACK = 4, "arrow: back; beside red, for a truck that stands too far in"
    LEFT = 5, "arrow: keep more to the left"
    RIGHT = 6, "arrow: keep more to the right"
    FLASH = 7, "blink the red lamp: the truck moves and must not; the PLC makes the rhythm"


LAMPS: dict[GuidanceCode, tuple[Lamp, ...]] = {
    GuidanceCode.WAIT: (Lamp.RED,),
    GuidanceCode.FORWARD: (Lamp.GREEN, Lamp.FORWARD),
    # Not amber: where the arrow's lamp has failed, amber alone would send the truck on towards the spout.
    GuidanceCode.BACK: (Lamp.RED, Lamp.BACK),
    GuidanceCode.LEFT: (Lamp.GREEN, Lamp.LEFT),
    GuidanceCode.RIGHT: (Lamp.GREEN, Lamp.RIGHT),
    GuidanceCode.SLOW: (Lamp.AMBER, Lamp.FORWARD),
    GuidanceCode.STOP: (Lamp.RED,),
    GuidanceCode.OK: (Lamp.RED,),
    GuidanceCode.TOO_FAR: (Lamp.RED, Lamp.FLASH),
    GuidanceCode.FAULT: (Lamp.RED,),
    GuidanceCode.LEAVE: (Lamp.GREEN,),  # no arrow: whether the way out is forward or back is not known here
    GuidanceCode.DRIVE_UP: (Lamp.GREEN, Lamp.FORWARD),
    GuidanceCode.BRAKE: (Lamp.RED, Lamp.FLASH),
}


def lamps(code: GuidanceCode, *, may_move: bool) -> tuple[Lamp, ...]:
    """The lamps that are on; `may_move`: may_move is on, and stop is off."""
    on = LAMPS[code]
    return on if may_move or Lamp.RED in on else (Lamp.RED,)


def _word(state: StateVector, _: int) -> Value:
    return sum(1 << lamp for lamp in lamps(state.guidance.code, may_move=state.may_move and not state.stop))


SIGNAL_LAMPS = Register(
    100, "signal_lamps", UINT16, 1, "", "lamps of a signal for the driver, one bit each", _word,
    bits=named(Lamp),
)  # fmt: skip
