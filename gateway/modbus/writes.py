"""A Modbus write to the handshake block, as the bay takes it. Pure."""

from collections.abc import Callable, Sequence

from gateway.modbus.answers import Peer, Write
from gateway.modbus.block import BLOCK
from gateway.modbus.exceptions import ModbusException
from gateway.plc import PlcWrite, Writer

_FIELD = {"plc_heartbeat": "heartbeat", "plc_control": "control", "recipe_select": "recipe"}
WRITABLE: dict[int, str] = {row.address: _FIELD[row.name] for row in BLOCK if row.writable}


def writer(take: Callable[[PlcWrite], bool], refused: Callable[[Writer, str], None]) -> Write:
    """What a Modbus server calls to write: all of the words or none.

    `take` gives False where nobody decides any more: exception 04. An address that is not the PLC's to write is
    exception 02, and told to `refused`.
    """

    def write(address: int, words: Sequence[int], peer: Peer) -> ModbusException | None:
        who = writer_of(peer)
        fields: dict[str, int] = {}
        for at, word in enumerate(words, start=address):
            if at not in WRITABLE:
                refused(who, f"register {at} is read only")
                return ModbusException.ILLEGAL_ADDRESS
            fields[WRITABLE[at]] = word
        return None if take(PlcWrite(who, **fields)) else ModbusException.DEVICE_FAILURE

    return write


def writer_of(peer: Peer) -> Writer:
    return Writer(peer.address, peer.subject, peer.role or "")
