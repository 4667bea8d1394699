"""Hostile clients of Modbus TCP. Their frames are right, nearly right and random; each answer is judged by its form.

What must be answered is tests/modbus_oracle.py's, which is the specification's table: length, function and exception of
each answer, in order. What the registers hold is not judged here, but by the poller and the simulator's truth.
"""

import random
import struct

from bench.hostile.client import Connection, Script, WrongAnswerError
from gateway.modbus.registers.register_map import BLOCK_WORDS
from tests import modbus_oracle as oracle
from tests.modbus_fuzzing import a_frame

ASK = struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, 0, 100)
ANSWER_BYTES = 9 + 200
NAMES = (17, 43)  # the gateway's names: only the function of the answer is judged
STRANGER = oracle.Server({1: oracle.Bay([0] * BLOCK_WORDS, writes_on=False, objects={0: b"", 1: b"", 2: b""})})


async def read_answers(connection: Connection, sent: list[bytes]) -> None:
    """The answers to `sent`, in their order. Raises WrongAnswerError."""
    for frame in sent:
        expected = oracle.answer_frame(STRANGER, frame)
        if not isinstance(expected, bytes):
            continue
        head = await connection.exactly(7)
        length = int.from_bytes(head[4:6], "big")
        if not 2 <= length <= 254:
            raise WrongAnswerError(f"length {length} in answer to {frame.hex()}")
        pdu = await connection.exactly(length - 1)
        connection.seen["answers judged"] += 1
        wanted = expected[7:]
        right = head[:4] == frame[:2] + b"\0\0" and head[6] == frame[6] and pdu[0] & 0x7F == wanted[0] & 0x7F
        if right and frame[7] not in NAMES:
            judged = len(wanted) if wanted[0] & 0x80 else 2
            right = len(pdu) == len(wanted) and pdu[:judged] == wanted[:judged]
        if not right:
            raise WrongAnswerError(f"{(head + pdu)[:40].hex()} in answer to {frame.hex()}, not {expected[:40].hex()}")


async def polls(connection: Connection, rng: random.Random) -> None:
    for _ in range(rng.randrange(1, 60)):
        await connection.send(ASK)
        await read_answers(connection, [ASK])


async def fuzz(connection: Connection, rng: random.Random) -> None:
    for _ in range(rng.randrange(1, 8)):
        sent = [a_frame(rng) for _ in range(rng.randrange(1, 40))]
        await connection.ragged(b"".join(sent), rng)
        await read_answers(connection, sent)


async def impossible_length(connection: Connection, rng: random.Random) -> None:
    await connection.send(rng.randbytes(2) + b"\0\0" + rng.choice([0, 1, 255, 65535]).to_bytes(2, "big") + ASK * 3)
    if await connection.receive():
        raise WrongAnswerError("an answer behind an impossible length")


async def half_frame(connection: Connection, rng: random.Random) -> None:
    await connection.send(ASK[: rng.randrange(1, 12)])
    await connection.until_closed()


async def byte_by_byte(connection: Connection, rng: random.Random) -> None:
    for _ in range(4):
        await connection.slowly(ASK, rng.choice([0.01, 0.05, 0.3]))
        await read_answers(connection, [ASK])


async def flood(connection: Connection, rng: random.Random) -> None:
    for _ in range(rng.randrange(1, 30)):
        await connection.send(ASK * 50)
        await connection.exactly(50 * ANSWER_BYTES)


async def never_reads(connection: Connection, rng: random.Random) -> None:
    while True:
        await connection.send(ASK * 100)


async def random_bytes(connection: Connection, rng: random.Random) -> None:
    for _ in range(rng.randrange(1, 20)):
        await connection.send(rng.randbytes(rng.randrange(1, 600)))


async def idle(connection: Connection, rng: random.Random) -> None:
    await connection.until_closed(rng.uniform(1, 12))


async def comes_and_goes(connection: Connection, rng: random.Random) -> None:
    if rng.random() < 0.5:
        await connection.send(ASK)
    connection.reset()


async def another_protocol(connection: Connection, rng: random.Random) -> None:
    await connection.send(
        rng.choice([b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03"])
    )
    await connection.until_closed()


SCRIPTS: dict[Script, float] = {
    polls: 3, fuzz: 6, impossible_length: 1, half_frame: 3, byte_by_byte: 2, flood: 2, never_reads: 2,
    random_bytes: 2, idle: 2, comes_and_goes: 6, another_protocol: 1,
}  # fmt: skip
