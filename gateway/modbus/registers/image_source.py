"""What a bay shows of itself: its state now, as the image that a Modbus server reads."""

from collections.abc import Sequence

from gateway.bay import BayControl
from gateway.clock import Clock
from gateway.core.model import StateVector
from gateway.modbus.protocol.answers import ReadImage
from gateway.modbus.registers.current_image import CurrentImage
from gateway.modbus.registers.words import WordOrder


def image_of(bay: BayControl, word_order: WordOrder, clock: Clock) -> ReadImage:
    """Asks `bay` at every call, so that a dead one shows as dead; encodes when there is another state."""
    image, ask = CurrentImage(word_order), bay.state
    last: StateVector | None = None
    shown: Sequence[int] = ()

    def read() -> Sequence[int]:
        nonlocal last, shown
        state = ask()
        if state is not last:  # nearly every poll finds the state of the one before
            last, shown = state, image.of(state, clock.now_ns(), clock.wall_ns())
        return shown

    return read
