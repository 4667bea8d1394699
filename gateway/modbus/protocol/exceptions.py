"""The exception codes of the Modbus Application Protocol V1.1b3, chapter 7, as far as this gateway uses them. Pure."""

from enum import IntEnum


class ModbusException(IntEnum):
    """The second byte of an exception answer."""

    ILLEGAL_FUNCTION = 0x01
    ILLEGAL_ADDRESS = 0x02
    ILLEGAL_VALUE = 0x03
    DEVICE_FAILURE = 0x04
    SERVER_BUSY = 0x06
    TARGET_FAILED_TO_RESPOND = 0x0B


EXCEPTION_MEANING: dict[ModbusException, str] = {
    ModbusException.ILLEGAL_FUNCTION: "a function code (or MEI type of FC 43) that this server does not have, writes "
    "where they are off, and whatever the peer's address or role does not allow",
    ModbusException.ILLEGAL_ADDRESS: "part of what is asked for lies beyond the last register or bit, is written "
    "although it is read only, or is an object id that does not exist",
    ModbusException.ILLEGAL_VALUE: "a count of 0 or more than fits, a request that is shorter or longer than its own "
    "numbers say, a value out of its range, a control bit that has no meaning, or an unknown kind of identification",
    ModbusException.DEVICE_FAILURE: "the gateway could not make an image; its log says why",
    ModbusException.SERVER_BUSY: "a write to the handshake block while another PLC owns it; nothing was written",
    ModbusException.TARGET_FAILED_TO_RESPOND: "no bay has this unit id, or something is written under unit id 0",
}
