"""A Modbus write to the handshake block, as the bay takes it. Pure."""

from collections.abc import Callable, Sequence

from gateway.core.plc import CONTROL_BITS, PlcWrite, Writer, WriteVerdict
from gateway.modbus.protocol.answers import Peer, Write
from gateway.modbus.protocol.exceptions import ModbusException
from gateway.modbus.registers.handshake import BLOCK

_FIELD = {"plc_heartbeat": "heartbeat", "plc_control": "control", "recipe_select": "recipe"}
WRITABLE: dict[int, str] = {row.address: _FIELD[row.name] for row in BLOCK if row.writable}
_EXCEPTION = {
    WriteVerdict.TAKEN: None,
    WriteVerdict.CONFLICT: ModbusException.SERVER_BUSY,
    WriteVerdict.UNDECIDED: ModbusException.DEVICE_FAILURE,
}


def writer(take: Callable[[PlcWrite], WriteVerdict], refused: Callable[[Writer, str], None]) -> Write:
    """What a Modbus server calls to write: all of the words or none.

    An address that is not the PLC's to write is exception 02, a control bit without a meaning 03; both are told to
    `refused`. What `take` does not take is exception 06 (another PLC's block) or 04 (nobody decides any more).
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
