"""A bay as a unit of a Modbus server: the image of its current state, and the writes that it takes."""

from collections.abc import Callable, Sequence

from gateway.bay import BayControl
from gateway.clock import Clock
from gateway.config import ModbusConfig
from gateway.core.plc import CONTROL_BITS, PlcConnection, PlcWrite, Writer, WriteVerdict
from gateway.core.state import Reason, StateVector
from gateway.modbus.protocol import identity
from gateway.modbus.protocol.adu import ModbusException
from gateway.modbus.protocol.answers import Peer, ReadImage, Unit, Write
from gateway.modbus.registers.handshake import HANDSHAKE
from gateway.modbus.registers.register import WordOrder
from gateway.modbus.registers.register_map import Image, encode

_FIELD = {"plc_heartbeat": "heartbeat", "plc_control": "control", "recipe_select": "recipe"}
WRITABLE: dict[int, str] = {row.address: _FIELD[row.name] for row in HANDSHAKE if row.writable}
_EXCEPTION = {
    WriteVerdict.TAKEN: None,
    WriteVerdict.CONFLICT: ModbusException.SERVER_BUSY,
    WriteVerdict.UNDECIDED: ModbusException.DEVICE_FAILURE,
}


def unit_of(bay: BayControl, config: ModbusConfig, site: str, clock: Clock) -> Unit:
    return Unit(
        image_of(bay, config.word_order, clock),
        writer(bay.on_write, bay.on_refused) if config.writes else None,
        identity.objects(f"{site}/{bay.name}"),
        lambda peer, why: bay.on_refused(writer_of(peer), why),
        lambda peer, here: bay.on_connection(PlcConnection(writer_of(peer), here)),
    )


class CurrentImage:
    """The image of a bay's current state, encoded once: while the sequence number is the same, so is the image."""

    def __init__(self, word_order: WordOrder) -> None:
        self._word_order: WordOrder = word_order
        self._key: tuple[int, Reason] | None = None
        self._image: Image = ()

    def of(self, state: StateVector, now_ns: int, wall_ns: int) -> Image:
        """`now_ns` and `wall_ns`: the clock's two times now, from which the image's own wall time follows.

        The state of a dead bay is a new one at every call, which differs only in its time: the first one is kept.
        """
        key = (state.seq, state.reason)
        if key != self._key:
            self._image = encode(state, wall_ns - (now_ns - state.t_ns), self._word_order)
            self._key = key
        return self._image


def image_of(bay: BayControl, word_order: WordOrder, clock: Clock) -> ReadImage:
    """Reads `bay` at every call, so that a dead one shows as dead; encodes when there is another state."""
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


def writer(take: Callable[[PlcWrite], WriteVerdict], refused: Callable[[Writer, str], None]) -> Write:
    """What a Modbus server calls to write: all of the words or none.

    An address that is not the PLC's to write is exception 02, a control bit without a meaning 03; both are reported to
    `refused`. What `take` does not take is exception 06 (another PLC's block) or 04 (the control task does not run).
    """

    def write(address: int, words: Sequence[int], peer: Peer, mask: int = 0xFFFF) -> ModbusException | None:
        who = writer_of(peer)
        fields: dict[str, int] = {}
        for at, word in enumerate(words, start=address):
            field = WRITABLE.get(at)
            if field is None:
                refused(who, f"register {at} is read only")
                return ModbusException.ILLEGAL_ADDRESS
            if field == "control" and (unknown := word & mask & ~CONTROL_BITS):
                refused(who, f"plc_control has no bit {unknown.bit_length() - 1}")
                return ModbusException.ILLEGAL_VALUE
            fields[field] = word
        return _EXCEPTION[take(PlcWrite(who, **fields, mask=mask))]

    return write


def writer_of(peer: Peer) -> Writer:
    return Writer(peer.address, peer.subject, peer.role or "")
