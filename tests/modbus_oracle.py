"""What the specification says a Modbus server answers, written down a second time, as a table of conditions.

Shares nothing with the gateway. Sources: Modbus Application Protocol V1.1b3, chapters 6 (state diagrams) and 7
(exception codes), and the MODBUS Messaging on TCP/IP Implementation Guide V1.0b, 3.1.3 and 4.4.2.

Used by the unit tests, by the tests over sockets and by bench/neighbours.py.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

CLOSE = "close"  # the connection can't go on
NOTHING = "nothing"  # no answer
BIT_REGISTERS = (3, 35, 81, 100, 2)  # status, position_status, plc_control, signal_lamps, heartbeat
NOT_DECIDING = 0x3000  # in register 3: gateway fault, shutdown
WRITING = (5, 6, 15, 16, 22, 23)


@dataclass
class Bay:
    """One unit as the tests set it up. Registers by address; the bits are those of BIT_REGISTERS, in that order."""

    words: list[int]
    writable: frozenset[int] = frozenset()
    writes_on: bool = False
    objects: dict[int, bytes] = field(default_factory=dict)

    def bit(self, address: int) -> int:
        return self.words[BIT_REGISTERS[address // 16]] >> address % 16 & 1

    @property
    def bits(self) -> int:
        return 16 * len(BIT_REGISTERS)


@dataclass
class Server:
    """`bays` by unit id. A lone bay is also unit 0 and 255; nothing is written to unit 0."""

    bays: dict[int, Bay]

    def bay(self, unit: int) -> Bay | None:
        if unit in (0, 255) and len(self.bays) == 1:
            return next(iter(self.bays.values()))
        return self.bays.get(unit)


def u16(data: bytes, at: int) -> int:
    return data[at] * 256 + data[at + 1]


# Function code -> conditions in the order of the state diagram: (exception code, what must hold for it not to be sent).
Condition = tuple[int, Callable[[Bay, bytes], bool]]


def _reads(most: int, size: Callable[[Bay], int]) -> list[Condition]:
    return [
        (3, lambda bay, p: len(p) == 5),
        (3, lambda bay, p: 1 <= u16(p, 3) <= most),
        (2, lambda bay, p: u16(p, 1) + u16(p, 3) <= size(bay)),
    ]


def _all_writable(bay: Bay, first: int, count: int) -> bool:
    return all(address in bay.writable for address in range(first, first + count))


def _coils_writable(bay: Bay, first: int, count: int) -> bool:
    coils = range(first, first + count)
    return all(coil < bay.bits and BIT_REGISTERS[coil // 16] in bay.writable for coil in coils)


CONDITIONS: dict[int, list[Condition]] = {
    1: _reads(0x7D0, lambda bay: bay.bits),
    2: _reads(0x7D0, lambda bay: bay.bits),
    3: _reads(0x7D, lambda bay: len(bay.words)),
    4: _reads(0x7D, lambda bay: len(bay.words)),
    5: [
        (1, lambda bay, p: bay.writes_on),
        (3, lambda bay, p: len(p) == 5),
        (3, lambda bay, p: p[3:] in (b"\x00\x00", b"\xff\x00")),
        (2, lambda bay, p: _coils_writable(bay, u16(p, 1), 1)),
    ],
    6: [
        (1, lambda bay, p: bay.writes_on),
        (3, lambda bay, p: len(p) == 5),
        (2, lambda bay, p: _all_writable(bay, u16(p, 1), 1)),
    ],
    15: [
        (1, lambda bay, p: bay.writes_on),
        (3, lambda bay, p: len(p) >= 6),
        (3, lambda bay, p: 1 <= u16(p, 3) <= 0x7B0),
        (3, lambda bay, p: p[5] == u16(p, 3) // 8 + (u16(p, 3) % 8 > 0)),
        (3, lambda bay, p: len(p) == 6 + p[5]),
        (2, lambda bay, p: _coils_writable(bay, u16(p, 1), u16(p, 3))),
    ],
    16: [
        (1, lambda bay, p: bay.writes_on),
        (3, lambda bay, p: len(p) >= 6),
        (3, lambda bay, p: 1 <= u16(p, 3) <= 0x7B),
        (3, lambda bay, p: p[5] == 2 * u16(p, 3)),
        (3, lambda bay, p: len(p) == 6 + p[5]),
        (2, lambda bay, p: _all_writable(bay, u16(p, 1), u16(p, 3))),
    ],
    17: [(3, lambda bay, p: len(p) == 1)],
    22: [
        (1, lambda bay, p: bay.writes_on),
        (3, lambda bay, p: len(p) == 7),
        (2, lambda bay, p: _all_writable(bay, u16(p, 1), 1)),
    ],
    23: [
        (1, lambda bay, p: bay.writes_on),
        (3, lambda bay, p: len(p) >= 10),
        (3, lambda bay, p: 1 <= u16(p, 3) <= 0x7D),
        (3, lambda bay, p: 1 <= u16(p, 7) <= 0x79),
        (3, lambda bay, p: p[9] == 2 * u16(p, 7)),
        (3, lambda bay, p: len(p) == 10 + p[9]),
        (2, lambda bay, p: u16(p, 1) + u16(p, 3) <= len(bay.words)),
        (2, lambda bay, p: _all_writable(bay, u16(p, 5), u16(p, 7))),
    ],
    43: [
        (3, lambda bay, p: len(p) >= 2),
        (1, lambda bay, p: p[1] == 14),
        (3, lambda bay, p: len(p) == 4),
        (3, lambda bay, p: p[2] in (1, 2, 3, 4)),
        (2, lambda bay, p: p[2] != 4 or p[3] in bay.objects),
    ],
}


def answer(server: Server, unit: int, pdu: bytes) -> bytes:
    """The PDU that must come back; carries out writes on the model."""
    function = pdu[0]
    bay = server.bay(unit)
    if bay is None or (unit == 0 and function in WRITING):
        return bytes([function | 0x80, 0x0B])
    if function not in CONDITIONS:
        return bytes([function | 0x80, 1])
    for code, holds in CONDITIONS[function]:
        if not holds(bay, pdu):
            return bytes([function | 0x80, code])
    return _carry_out(bay, function, pdu)


def _carry_out(bay: Bay, function: int, pdu: bytes) -> bytes:
    if function in WRITING:
        return _written(bay, function, pdu)
    if function in (1, 2):
        octets = [0] * ((u16(pdu, 3) + 7) // 8)
        for n in range(u16(pdu, 3)):
            octets[n // 8] |= bay.bit(u16(pdu, 1) + n) << n % 8
        return bytes([function, len(octets), *octets])
    if function in (3, 4):
        return bytes([function, 2 * u16(pdu, 3)]) + _octets(bay, u16(pdu, 1), u16(pdu, 3))
    if function == 17:
        names = b" ".join(bay.objects[key] for key in (1, 2, 6) if key in bay.objects)[:249]
        running = 0 if bay.words[3] & NOT_DECIDING else 0xFF
        return bytes([17, 2 + len(names), 1, running]) + names
    return _identify(bay, pdu[2], pdu[3])


def _written(bay: Bay, function: int, pdu: bytes) -> bytes:
    first = u16(pdu, 1)
    if function == 23:
        _store(bay, u16(pdu, 5), pdu[10:])
        return bytes([23, 2 * u16(pdu, 3)]) + _octets(bay, first, u16(pdu, 3))
    if function == 5:
        _store_bit(bay, first, pdu[3] > 0)
    elif function == 15:
        for n in range(u16(pdu, 3)):
            _store_bit(bay, first + n, pdu[6 + n // 8] >> n % 8 & 1 == 1)
    elif function == 6:
        bay.words[first] = u16(pdu, 3)
    elif function == 16:
        _store(bay, first, pdu[6:])
    else:
        bay.words[first] = (bay.words[first] & u16(pdu, 3)) | (u16(pdu, 5) & ~u16(pdu, 3) & 0xFFFF)
    return pdu[:5] if function in (15, 16) else pdu


def _store_bit(bay: Bay, coil: int, on: bool) -> None:
    register, bit = BIT_REGISTERS[coil // 16], coil % 16
    bay.words[register] = bay.words[register] & ~(1 << bit) | on << bit


def _octets(bay: Bay, first: int, count: int) -> bytes:
    return b"".join(bytes([word // 256, word % 256]) for word in bay.words[first : first + count])


def _store(bay: Bay, first: int, octets: bytes) -> None:
    for n in range(len(octets) // 2):
        bay.words[first + n] = u16(octets, 2 * n)


def _identify(bay: Bay, code: int, first: int) -> bytes:
    highest = max(bay.objects)
    conformity = 0x81 if highest <= 2 else 0x82 if highest <= 0x7F else 0x83
    if code == 4:
        return bytes([43, 14, 4, conformity, 0, 0, 1, first, len(bay.objects[first])]) + bay.objects[first]
    level = sorted(key for key in bay.objects if key <= {1: 2, 2: 0x7F, 3: 0xFF}[code])
    wanted = level[level.index(first) :] if first in level else level
    body, number = b"", 0
    for key in wanted:
        entry = bytes([key, len(bay.objects[key])]) + bay.objects[key]
        if 7 + len(body) + len(entry) > 253:
            return bytes([43, 14, code, conformity, 0xFF, key, number]) + body
        body += entry
        number += 1
    return bytes([43, 14, code, conformity, 0, 0, number]) + body


def answer_frame(server: Server, frame: bytes) -> bytes | str:
    """Of one whole frame, or the head of one whose length is impossible: the answer's bytes, NOTHING or CLOSE."""
    length = u16(frame, 4)
    if length < 2 or length > 254:
        return CLOSE
    if u16(frame, 2) != 0:
        return NOTHING
    pdu = answer(server, frame[6], frame[7 : 6 + length])
    return frame[:2] + bytes([0, 0, 0, len(pdu) + 1, frame[6]]) + pdu
