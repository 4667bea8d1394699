"""Identification: FC 43/14, read device identification, and FC 17, report server ID. Pure.

Modbus Application Protocol V1.1b3, 6.21 and 6.13. Objects 0 to 2 are basic, 3 to 0x7F regular, 0x80 to 0xFF the
product's own. An answer that is too short for the list sets "more follows" and names the next object.
"""

from collections.abc import Mapping
from enum import IntEnum

from gateway import __version__
from gateway.modbus.protocol.adu import ModbusException

ROOM = 253 - 7  # of a PDU, after function code, MEI type and the five bytes of the head
MORE_FOLLOWS = 0xFF
LAST_OF_LEVEL = {1: 0x02, 2: 0x7F, 3: 0xFF}  # read device id code -> its highest object id
INDIVIDUAL = 4
INDIVIDUAL_TOO = 0x80  # flag in the conformity level: single objects can be read, too

SERVER_ID = 1
RUNNING, NOT_RUNNING = 0xFF, 0x00  # the run indicator
MAX_REPORT_BYTES = 253 - 2 - 2  # of a PDU, after function code and byte count, server id and run indicator


class ObjectId(IntEnum):
    VENDOR_NAME = 0
    PRODUCT_CODE = 1
    MAJOR_MINOR_REVISION = 2
    VENDOR_URL = 3
    PRODUCT_NAME = 4
    MODEL_NAME = 5
    USER_APPLICATION_NAME = 6


def objects(bay: str = "") -> dict[int, bytes]:
    """The identification of this product; `bay` distinguishes its units (object 6), "" leaves that out."""
    texts = {
        ObjectId.VENDOR_NAME: "plc-loading-gateway",
        ObjectId.PRODUCT_CODE: "plc-loading-gateway",
        ObjectId.MAJOR_MINOR_REVISION: __version__,
        ObjectId.PRODUCT_NAME: "PLC integration gateway for bulk loading",
        ObjectId.USER_APPLICATION_NAME: bay,
    }
    return {int(key): text.encode("ascii") for key, text in texts.items() if text}


def answer(known: Mapping[int, bytes], code: int, first: int) -> bytes | ModbusException:
    """What follows `2B 0E` in the answer to read device id code `code` from object `first` on, or why there is none.

    `known`: object id (0..255) -> at most ROOM - 2 bytes; must hold the three basic objects.
    """
    level = 3 if max(known) > 0x7F else 2 if max(known) > 0x02 else 1
    if code == INDIVIDUAL:
        if first not in known:
            return ModbusException.ILLEGAL_ADDRESS
        return _part(code, level, {first: known[first]}, 0)
    if code not in LAST_OF_LEVEL:
        return ModbusException.ILLEGAL_VALUE
    wanted = {key: known[key] for key in sorted(known) if key <= LAST_OF_LEVEL[code]}
    start = first if first in wanted else 0  # an unknown object: from the beginning, by the specification
    part: dict[int, bytes] = {}
    used = 0
    for key, text in wanted.items():
        if key < start:
            continue
        used += 2 + len(text)
        if used > ROOM:
            return _part(code, level, part, key)
        part[key] = text
    return _part(code, level, part, 0)


def report(known: Mapping[int, bytes], *, running: bool) -> bytes:
    """What follows the function code in the answer to FC 17: byte count, server id, run indicator, then in words the
    product, its version and its bay."""
    names = (ObjectId.PRODUCT_CODE, ObjectId.MAJOR_MINOR_REVISION, ObjectId.USER_APPLICATION_NAME)
    text = b" ".join(known[name] for name in names if name in known)[:MAX_REPORT_BYTES]
    return bytes((2 + len(text), SERVER_ID, RUNNING if running else NOT_RUNNING)) + text


def _part(code: int, level: int, part: Mapping[int, bytes], follows: int) -> bytes:
    head = bytes((code, INDIVIDUAL_TOO | level, MORE_FOLLOWS if follows else 0, follows, len(part)))
    return head + b"".join(bytes((key, len(text))) + text for key, text in part.items())
