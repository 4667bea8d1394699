"""The bits of FC 1 and 2: some registers of the image, seen bit by bit. Pure.

Coils and discrete inputs show the same bits, as holding and input registers show the same words. Bit 16 n + b is bit b
of the n-th register in BIT_REGISTERS (b = 0 the least significant), so that no bit can contradict its register. A coil
is written (FC 5 and 15) as the bit of its register, where the PLC may write it. Never reorder, only append.

The bits of the heartbeat are the sign of life for programs that read bits only. Bit b of it changes every 2^b ticks.
At 50 ticks a second bit 3 changes every 160 ms: longer than a poll of 100 ms, so that none of its changes can be missed
in a poll's rhythm, and with that poll well within the 500 ms after which a program must take the gateway for dead.
"""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from gateway.modbus.registers.register_map import REGISTERS

BIT_REGISTERS = ("status", "position_status", "plc_control", "signal_lamps", "heartbeat")
_HEARTBEAT_BITS = {3: ("alive", "changes every 8 ticks, 160 ms as shipped; the gateway is dead while it does not")}
_BY_NAME = {register.name: register for register in REGISTERS}
_ADDRESSES = tuple(_BY_NAME[name].address for name in BIT_REGISTERS)
BLOCK_BITS = 16 * len(_ADDRESSES)


@dataclass(frozen=True, slots=True)
class Bit:
    """One row of the table."""

    address: int
    name: str
    register: str
    bit: int
    meaning: str


def table() -> Iterator[Bit]:
    """Every bit that has a name, by address; the others read 0."""
    for n, name in enumerate(BIT_REGISTERS):
        named = _HEARTBEAT_BITS if name == "heartbeat" else _BY_NAME[name].bits or {}
        for bit, (bit_name, meaning) in named.items():
            yield Bit(16 * n + bit, bit_name, name, bit, meaning)


def coil_of(name: str, bit: int) -> int:
    """The address of one bit of one register. Raises ValueError for a register that has no bits here."""
    return 16 * BIT_REGISTERS.index(name) + bit


def masked(address: int, count: int, bits: int) -> tuple[int, int, int] | None:
    """`count` coils from `address` on, `bits` their values (the first one the least significant), as a masked write:
    register, word and mask. None: they are not in one register."""
    register, bit = divmod(address, 16)
    if address + count > BLOCK_BITS or bit + count > 16:
        return None
    mask = (1 << count) - 1
    return _ADDRESSES[register], (bits & mask) << bit, mask << bit


def bits_of(image: Sequence[int]) -> tuple[int, int]:
    """(how many bits there are, all of them in one number, bit 0 the least significant).

    An image too short to have these registers has no bits. Raises struct.error for anything but words.
    """
    if len(image) <= max(_ADDRESSES):
        return 0, 0
    words = struct.pack(f"<{len(_ADDRESSES)}H", *(image[address] for address in _ADDRESSES))
    return BLOCK_BITS, int.from_bytes(words, "little")
