"""The register image of a bay's current state, kept from poll to poll and from state to state. Pure."""

from gateway.core.model import Reason, StateVector
from gateway.modbus.registers.register_map import BLOCK_WORDS, PLANS, STATUS_ADDRESS, Image, StatusBit, fill
from gateway.modbus.registers.row import Of
from gateway.modbus.registers.words import WordOrder


class CurrentImage:
    """The image of a bay's current state, encoded once: as long as the sequence number stands, so does the image.

    Of the next state only those parts are encoded that are other records than before: a PLC may wait for it.
    """

    def __init__(self, word_order: WordOrder) -> None:
        self._word_order: WordOrder = word_order
        self._key: tuple[int, Reason] | None = None
        self._image: Image = ()
        self._words = [0] * BLOCK_WORDS
        self._parts: dict[Of, object] = {}  # what the words were encoded from
        self._clamped: dict[Of, bool] = {}

    def of(self, state: StateVector, now_ns: int, wall_ns: int) -> Image:
        """`now_ns` and `wall_ns`: the clock's two times now, from which the image's own wall time follows.

        A dead bay hands in a fresh state at every call, differing only in its time; the first one stands.
        """
        key = (state.seq, state.reason)
        if key != self._key:
            self._image = self._encoded(state, wall_ns - (now_ns - state.t_ns))
            self._key = key
        return self._image

    def _encoded(self, state: StateVector, unix_ns: int) -> Image:
        """As `encode`."""
        parts: dict[Of, object] = {Of.RANGE: state.range, Of.PLC: state.plc, Of.NOTHING: Of.NOTHING}
        for of, plan in PLANS[self._word_order].items():
            part = parts.get(of)
            if part is None or part is not self._parts.get(of):
                self._clamped[of] = fill(self._words, plan, state, unix_ns)
                self._parts[of] = part
        self._words[STATUS_ADDRESS] |= any(self._clamped.values()) << StatusBit.CLAMPED
        return tuple(self._words)
