"""A bay as a unit of a Modbus server: the image of its current state, and the writes that it takes."""

from collections.abc import Callable, Sequence

from gateway.bay import BayControl
from gateway.clock import Clock
from gateway.config import GatewayConfig
from gateway.core.plc import CONTROL_BITS, PlcConnection, PlcWrite, Writer, WriteVerdict
from gateway.core.state import Reason, StateVector
from gateway.modbus.protocol import identity
from gateway.modbus.protocol.adu import ModbusException
from gateway.modbus.protocol.answers import Peer, ReadImage, Unit, Write
from gateway.modbus.registers.bay_identity import NO_BAY, BayIdentity, identities
from gateway.modbus.registers.handshake import HANDSHAKE
from gateway.modbus.registers.register import WordOrder
from gateway.modbus.registers.register_map import BLOCK_WORDS, Image, encode

_FIELD = {"plc_heartbeat": "heartbeat", "plc_control": "control", "recipe_select": "recipe"}
WRITABLE: dict[int, str] = {row.address: _FIELD[row.name] for row in HANDSHAKE if row.writable}
_EXCEPTION = {
    WriteVerdict.TAKEN: None,
    WriteVerdict.CONFLICT: ModbusException.SERVER_BUSY,
    WriteVerdict.OTHER_CONNECTION: ModbusException.SERVER_BUSY,
    WriteVerdict.UNDECIDED: ModbusException.DEVICE_FAILURE,
}


def unit_of(bay: BayControl, config: GatewayConfig, clock: Clock) -> Unit:
    modbus = config.modbus
    return Unit(
        image_of(bay.state, modbus.word_order, clock, identities(config)[bay.name]),
        writer(bay.on_write, bay.on_refused) if modbus.writes else None,
        identity.objects(f"{config.site}/{bay.name}"),
        lambda peer, why: bay.on_refused(writer_of(peer), why),
        lambda peer, here, ended: bay.on_connection(PlcConnection(writer_of(peer), here, ended)),
        BLOCK_WORDS,
    )


def image_of(
    state_now: Callable[[], StateVector], word_order: WordOrder, clock: Clock, bay: BayIdentity = NO_BAY
) -> ReadImage:
    """Reads a bay's state at every call, so that a dead one shows as dead; encodes when there is another state.

    The state of a dead bay is a new one at every call, which differs only in its time: the first one's image is kept.
    """
    last: StateVector | None = None
    key: tuple[int, Reason] | None = None
    image: Image = ()

    def read() -> Image:
        nonlocal last, key, image
        state = state_now()
        if state is not last:  # nearly every poll finds the state of the one before
            last = state
            if key != (state.seq, state.reason):
                key = state.seq, state.reason
                image = encode(state, clock.wall_ns() - (clock.now_ns() - state.t_ns), word_order, bay)
        return image

    return read


def writer(take: Callable[[PlcWrite], WriteVerdict], refused: Callable[[Writer, str], None]) -> Write:
    """What a Modbus server calls to write: all of the words or none.

    An address that the PLC may not write is exception 02, a control bit without a meaning 03; both are reported to
    `refused`. What `take` does not take is exception 06 (another owns the block) or 04 (the control task does not run).
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
        return _EXCEPTION[take(PlcWrite(who, **fields, mask=mask, connection=peer.connection))]

    return write


def writer_of(peer: Peer) -> Writer:
    return Writer(peer.address, peer.subject, peer.role or "")
