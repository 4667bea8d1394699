"""One connection on a stand-in transport: turns, back-pressure, ends. The test is the client."""

import asyncio
from collections import Counter
from collections.abc import Callable
from typing import cast

import pytest

from gateway.modbus.protocol.adu import frame_bytes
from gateway.modbus.protocol.answers import Peer, Unit
from gateway.modbus.protocol.request_handler import RequestHandler, RequestStats
from gateway.modbus.server.connection import TURN_FRAMES, ModbusConnection
from gateway.modbus.server.limits import Refusal
from tests.virtual_time import in_virtual_time

REQUEST = bytes([3, 0, 0, 0, 1])
ANSWER = bytes([3, 2, 0x12, 0x34])


class Wire:
    """What a connection does with its transport."""

    def __init__(self) -> None:
        self.sent = b""
        self.writes = 0
        self.reading = True
        self.ended = ""
        self.blocks = False  # the next write finds a full buffer
        self.protocol: ModbusConnection | None = None

    def write(self, data: bytes) -> None:
        self.sent += data
        self.writes += 1
        if self.blocks and self.protocol is not None:
            self.protocol.pause_writing()

    def pause_reading(self) -> None:
        assert self.reading
        self.reading = False

    def resume_reading(self) -> None:
        assert not self.reading
        self.reading = True

    def close(self) -> None:
        self.ended = "closed"

    def abort(self) -> None:
        self.ended = "cut"

    def is_reading(self) -> bool:
        return self.reading

    def is_closing(self) -> bool:
        return self.ended != ""

    def set_write_buffer_limits(self, high: int) -> None:
        assert high <= 64 * 1024


class Owner:
    def __init__(self) -> None:
        self.stats = RequestStats()
        self.request_handler = RequestHandler({1: Unit(lambda: (0x1234,))}, self.stats, lambda error: None)
        self.peer_of: Callable[[asyncio.Transport], Peer | None] = lambda _: Peer("10.0.0.9")
        self.admits = True
        self.refusals: Counter[Refusal] = Counter()

    def admit(self, connection: ModbusConnection) -> bool:
        return self.admits

    def opened(self, transport: asyncio.Transport) -> None: ...
    def closed(self, transport: asyncio.Transport, connection: ModbusConnection) -> None: ...

    def refused(self, address: str, why: Refusal) -> None:
        self.refusals[why] += 1


def opened(owner: Owner) -> tuple[ModbusConnection, Wire]:
    wire, connection = Wire(), ModbusConnection(owner)
    wire.protocol = connection
    connection.connection_made(cast(asyncio.Transport, wire))
    return connection, wire


def requests(count: int, begin: int = 0) -> bytes:
    return b"".join(frame_bytes(begin + n, 1, REQUEST) for n in range(count))


def answers(count: int, begin: int = 0) -> bytes:
    return b"".join(frame_bytes(begin + n, 1, ANSWER) for n in range(count))


@in_virtual_time
async def test_a_flood_gets_all_its_answers_in_order_and_others_are_answered_in_between() -> None:
    owner = Owner()
    flood, flood_wire = opened(owner)
    other, other_wire = opened(owner)
    flood.data_received(requests(1000))
    assert flood_wire.sent == answers(TURN_FRAMES)
    assert not flood_wire.is_reading()  # the rest waits in the kernel, and then with the client
    turns = 0
    while len(flood_wire.sent) < len(answers(1000)):
        other.data_received(requests(1, turns))
        assert other_wire.sent == answers(turns + 1)  # at once, however much the other has asked for
        await asyncio.sleep(0)
        turns += 1
    assert flood_wire.sent == answers(1000)
    assert turns == -(-1000 // TURN_FRAMES) - 1
    assert flood_wire.writes == turns + 1
    await asyncio.sleep(0)
    assert flood_wire.is_reading()
    flood.data_received(requests(1, 7))
    assert flood_wire.sent == answers(1000) + answers(1, 7)


@in_virtual_time
async def test_a_client_that_does_not_read_is_not_read_from_and_not_answered() -> None:
    owner = Owner()
    connection, wire = opened(owner)
    now_s = asyncio.get_running_loop().time
    await asyncio.sleep(3)
    wire.blocks = True
    connection.data_received(requests(100))
    assert wire.sent == answers(TURN_FRAMES)
    for _ in range(10):
        await asyncio.sleep(1)
    assert wire.sent == answers(TURN_FRAMES)
    assert not wire.is_reading()
    assert connection.blocked_since_s == now_s() - 10
    wire.blocks = False
    connection.resume_writing()
    await asyncio.sleep(1)
    assert wire.sent == answers(100)
    assert wire.is_reading()
    assert connection.blocked_since_s is None


@in_virtual_time
async def test_single_polls_are_held_back_too_while_answers_are_not_read() -> None:
    connection, wire = opened(Owner())
    wire.blocks = True
    connection.data_received(requests(1))
    assert not wire.is_reading()
    connection.data_received(requests(1, 1))  # was on its way
    assert wire.sent == answers(1)
    wire.blocks = False
    connection.resume_writing()
    assert wire.sent == answers(2)
    assert wire.is_reading()
    connection.data_received(requests(1, 2))
    assert wire.sent == answers(3)


@in_virtual_time
async def test_repeated_blocking_does_not_multiply_its_turns() -> None:
    """However often it stops and starts, it gets one turn for each of the event loop's."""

    connection, wire = opened(Owner())
    connection.data_received(requests(2000))
    for _ in range(20):
        connection.pause_writing()
        connection.resume_writing()  # which is a turn of its own
    before = len(wire.sent)
    await asyncio.sleep(0)
    assert len(wire.sent) - before == len(answers(TURN_FRAMES))


@in_virtual_time
async def test_a_half_frame_is_timed_from_its_first_byte_however_slowly_it_goes_on() -> None:
    connection, _ = opened(Owner())
    begun = asyncio.get_running_loop().time()
    for byte in requests(1)[:-1]:
        connection.data_received(bytes([byte]))
        assert connection.half_since_s == begun
        await asyncio.sleep(0.1)
    now_s = asyncio.get_running_loop().time()
    connection.data_received(requests(1)[-1:] + b"\0")  # complete, and the next has begun
    assert connection.half_since_s == now_s
    connection.data_received(requests(1)[1:])
    assert connection.half_since_s is None


@in_virtual_time
async def test_another_protocol_is_discarded_and_the_next_frame_is_answered() -> None:
    owner = Owner()
    connection, wire = opened(owner)
    foreign = requests(1)[:2] + b"\0\1" + requests(1)[4:]
    connection.data_received(foreign)
    connection.data_received(foreign + requests(1, 5) + foreign)
    assert wire.sent == answers(1, 5)
    assert owner.refusals == {Refusal.BAD_PROTOCOL: 3}
    assert (owner.stats.requests, connection.answered, wire.ended) == (1, 1, "")


@in_virtual_time
async def test_an_impossible_length_closes_after_the_answers_before_it() -> None:
    owner = Owner()
    connection, wire = opened(owner)
    connection.data_received(requests(3) + b"\0\1\0\0\xff\xff\1\3" + requests(3))
    assert (wire.sent, wire.ended) == (answers(3), "closed")
    assert owner.refusals == {Refusal.BAD_LENGTH: 1}
    assert connection.blocked_since_s is not None  # the sweep cuts it if the three are not taken
    connection.data_received(requests(1))
    assert wire.sent == answers(3)


@pytest.mark.parametrize("count", [0, 1, TURN_FRAMES, 100])
@in_virtual_time
async def test_a_client_that_has_closed_its_side_still_gets_its_answers(count: int) -> None:
    connection, wire = opened(Owner())
    if count:
        connection.data_received(requests(count) + requests(1)[:5])
    stays = connection.eof_received()
    assert stays == (count > TURN_FRAMES)
    if stays:
        for _ in range(count // TURN_FRAMES + 1):
            await asyncio.sleep(0)
        assert wire.ended == "closed"
    assert wire.sent == answers(count)


@in_virtual_time
async def test_a_refused_connection_is_aborted_and_never_answered() -> None:
    owner = Owner()
    owner.admits = False
    connection, wire = opened(owner)
    assert wire.ended == "cut"
    connection.data_received(requests(1))
    assert wire.sent == b""
    owner.peer_of = lambda _: None
    owner.admits = True
    assert opened(owner)[1].ended == "cut"
