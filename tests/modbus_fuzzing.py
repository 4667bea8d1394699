"""Frames right, nearly right and random against a live server, compared with tests/modbus_oracle.py. Seeded."""

import asyncio
import random
from collections import Counter
from collections.abc import Callable, Sequence

from gateway.config import ModbusConfig
from gateway.modbus.protocol import identity
from gateway.modbus.protocol.adu import ModbusException
from gateway.modbus.protocol.answers import Peer, Unit, Write
from gateway.modbus.server.server import ModbusServer
from tests import modbus_oracle as oracle

WRITABLE = frozenset(range(80, 96))
FUNCTIONS = [1, 2, 3, 3, 3, 3, 4, 4, 5, 6, 7, 8, 11, 12, 15, 16, 16, 17, 20, 21, 22, 23, 23, 24, 43, 43]
EDGES = [0, 1, 2, 3, 15, 16, 17, 79, 80, 95, 96, 98, 99, 100, 108, 109, 110, 111, 121, 122, 123, 124, 125, 126, 127,
         128, 255, 256, 1999, 2000, 2001, 32767, 32768, 65434, 65435, 65436, 65535]  # fmt: skip
SIZE = 123  # registers
COILS = 16 * len(oracle.BIT_REGISTERS) + 1
PATIENCE_S = 60.0


def writing(registers: list[int], writable: frozenset[int]) -> Write:
    """What a unit calls to write `registers`, of which only those at `writable` can be written."""

    def write(address: int, words: Sequence[int], peer: Peer, mask: int = 0xFFFF) -> ModbusException | None:
        if not writable.issuperset(range(address, address + len(words))):
            return ModbusException.ILLEGAL_ADDRESS
        for at, word in enumerate(words, start=address):
            registers[at] = registers[at] & ~mask | word & mask
        return None

    return write


class Bay:
    """A bay with writes on, and its twin for the oracle."""

    def __init__(self, unit: int) -> None:
        self.words = [(unit * 1000 + 37 * n) & 0xFFFF for n in range(SIZE)]
        objects = identity.objects(f"site1/bay{unit}") | {0x80: b"x" * 180}
        self.unit = Unit(lambda: tuple(self.words), writing(self.words, WRITABLE), objects)
        self.twin = oracle.Bay(list(self.words), WRITABLE, True, dict(objects))


def number(rng: random.Random) -> bytes:
    return (rng.choice(EDGES) if rng.random() < 0.8 else rng.randrange(65536)).to_bytes(2, "big")


def a_pdu(rng: random.Random) -> bytes:
    function = rng.choice(FUNCTIONS) if rng.random() < 0.95 else rng.randrange(256)
    if rng.random() < 0.03:
        return bytes([function]) + rng.randbytes(rng.randrange(0, 253))
    if function in (16, 23):
        count = rng.choice([1, 1, 2, 3, 16, 17, 120, 121, 122, 123])
        size = 2 * count if rng.random() < 0.9 else rng.randrange(256)
        told = count if rng.random() < 0.9 else rng.randrange(256)
        where = (rng.randrange(76, SIZE) if rng.random() < 0.9 else rng.choice(EDGES)).to_bytes(2, "big")
        head = bytes([function]) + (
            number(rng) + bytes([0, rng.choice([1, 2, 100, 123, 0, 126])]) if function == 23 else b""
        )
        body = rng.randbytes(min(size, 253 - len(head) - 5))
        pdu = head + where + told.to_bytes(2, "big") + bytes([size]) + body
    elif function == 43:
        pdu = bytes([43, rng.choice([14, 14, 14, 13, 0]), rng.randrange(6), rng.choice([0, 1, 4, 6, 7, 0x80, 0xFF])])
    elif function in (5, 15):
        count = rng.choice([1, 1, 2, 7, 8, 9, 16, 17])
        where = (rng.randrange(COILS) if rng.random() < 0.95 else rng.choice(EDGES)).to_bytes(2, "big")
        pdu = bytes([15]) + where + bytes([0, count, (count + 7) // 8]) + rng.randbytes((count + 7) // 8)
        if function == 5:
            pdu = bytes([5]) + where + rng.choice([b"\x00\x00", b"\xff\x00", b"\x00\x01"])
    elif function == 22:
        pdu = bytes([22, 0, rng.randrange(76, SIZE + 2)]) + number(rng) + number(rng)
    elif function == 17 and rng.random() < 0.9:
        pdu = bytes([17])
    elif function == 6:
        pdu = bytes([6, 0, rng.randrange(76, SIZE + 2)]) + number(rng)
    elif function <= 4 and rng.random() < 0.5:  # most of which lies within the block
        size = COILS if function <= 2 else SIZE
        address = rng.randrange(size)
        count = rng.randrange(1, size - address + 2)
        pdu = bytes([function, 0, address, 0, count])
    else:
        pdu = bytes([function]) + number(rng) + number(rng)
    if rng.random() < 0.05:
        pdu = pdu[: rng.randrange(1, len(pdu) + 1)]
    if rng.random() < 0.03:
        pdu = (pdu + rng.randbytes(rng.randrange(1, 5)))[:253]
    return pdu


def a_frame(rng: random.Random) -> bytes:
    pdu = a_pdu(rng)
    protocol = 0 if rng.random() < 0.98 else rng.randrange(65536)
    unit = rng.choice([1, 2, 247]) if rng.random() < 0.9 else rng.randrange(256)
    return rng.randbytes(2) + protocol.to_bytes(2, "big") + (len(pdu) + 1).to_bytes(2, "big") + bytes([unit]) + pdu


async def one_connection(port: int, server: oracle.Server, rng: random.Random, frames: int, seen: Counter[str]) -> None:
    """Send `frames` frames in one go of ragged pieces, compare everything that comes back."""
    sent: list[bytes] = []
    expected = bytearray()
    for _ in range(frames):
        frame = a_frame(rng)
        told = oracle.answer_frame(server, frame)
        sent.append(frame)
        seen["frames"] += 1
        if isinstance(told, bytes):
            expected += told
            seen[f"exception {told[8]:02X}" if told[7] & 0x80 else f"function {told[7]} answered"] += 1
        else:
            seen["another protocol"] += 1
    end = rng.random()
    if end < 0.1:  # a length that no frame can have: nothing behind it may be answered
        sent += [rng.randbytes(2) + b"\0\0" + rng.choice([0, 1, 255, 65535]).to_bytes(2, "big"), a_frame(rng) * 3]
        seen["impossible length"] += 1
    elif end < 0.2:  # a frame that is never whole
        frame = a_frame(rng)
        sent.append(frame[: rng.randrange(1, len(frame))])
        seen["half a frame"] += 1
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    stream = b"".join(sent)

    async def send() -> None:
        at = 0
        while at < len(stream):
            size = rng.choice([1, 2, 7, 12, 13, 100, 1000, 5000])
            writer.write(stream[at : at + size])
            at += size
            if rng.random() < 0.2:
                await asyncio.sleep(0)
            await writer.drain()
        writer.write_eof()

    came = b""
    async with asyncio.timeout(PATIENCE_S):
        sending = asyncio.gather(send(), return_exceptions=True)  # the server may have hung up on an impossible length
        try:
            while chunk := await reader.read(65536):
                came += chunk
        except OSError:
            seen["reset"] += 1  # only after an impossible length: the server closed on bytes it had not looked at
            if end >= 0.1 or not bytes(expected).startswith(came):
                raise
            came = bytes(expected)
        await sending
    writer.close()
    if came != expected:
        where = next((n for n, (a, b) in enumerate(zip(came, expected, strict=False)) if a != b), None)
        raise AssertionError(f"{len(came)} bytes came, {len(expected)} expected; first difference at {where}")


async def fuzz(frames: int, seed: int, progress: Callable[[int], None] = lambda _: None) -> Counter[str]:
    """Raises AssertionError for a wrong answer, TimeoutError for one that does not come."""
    rng = random.Random(seed)
    bays = {unit: Bay(unit) for unit in (1, 2, 247)}
    server_model = oracle.Server({unit: bay.twin for unit, bay in bays.items()})
    seen: Counter[str] = Counter()
    config = ModbusConfig(port=0, frame_timeout_s=30)
    async with ModbusServer(config, {unit: bay.unit for unit, bay in bays.items()}) as server:
        while seen["frames"] < frames:
            # One after the other: with writes on, the order of two connections' requests would be anybody's guess.
            await one_connection(
                server.port, server_model, rng, min(rng.randrange(1, 400), frames - seen["frames"]), seen
            )
            if any(bay.words != bay.twin.words for bay in bays.values()):
                raise AssertionError("the registers written differ")
            progress(seen["frames"])
        if server.stats.image_faults:
            raise AssertionError(f"{server.stats.image_faults} answers 04")
        if server.stats.open > 1:
            raise AssertionError(f"{server.stats.open} connections left")
    return seen
