"""The Modbus server over real sockets, asked by clients that we did not write: mbpoll and pymodbus's."""

import asyncio
import logging
import re
import shlex
import socket
import struct
from collections.abc import Awaitable, Callable, Coroutine, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from functools import partial
from typing import Any

import pytest
from pymodbus.client import AsyncModbusTcpClient, ModbusTcpClient
from pymodbus.pdu.mei_message import ReadDeviceInformationRequest

from gateway import __version__, event_loop
from gateway.config import ModbusConfig
from gateway.core.detection import Circle
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import Reason, StateVector
from gateway.errors import ConfigError, LinkError
from gateway.modbus.protocol import identity
from gateway.modbus.protocol.answers import Unit
from gateway.modbus.registers.register import WordOrder
from gateway.modbus.registers.register_map import BLOCK_WORDS, encode
from gateway.modbus.server.server import CLOSE_TIMEOUT_S, ModbusServer
from tests.virtual_time import synchronous

MS = 1_000_000
ANY_PORT = ModbusConfig(port=0)

ON_ITS_MARK = StateVector(
    bay="bay1",
    t_ns=30_000 * MS,
    seq=2123,
    heartbeat=1401,
    vision=VisionReading(29_980 * MS, Quality.GOOD, Circle(640.28, 355.21, 181.26), frame_id=843),
    range=RangeReading(29_955 * MS, Quality.GOOD, 298.6, seq=499),
    d=True,
    stop=True,
    reason=Reason.TARGET_REACHED,
)
COUNTING = tuple(range(1000, 1000 + BLOCK_WORDS))  # every register tells its own address


def run(coroutine: Coroutine[Any, Any, None]) -> None:
    """Run to the end; a task left behind is a leak."""

    async def watched() -> None:
        await coroutine
        for _ in range(3):
            await asyncio.sleep(0)
        left = asyncio.all_tasks() - {asyncio.current_task()}
        assert not left

    event_loop.run(watched())


complete = partial(synchronous, runner=run)


@contextmanager
def connected(server: ModbusServer) -> Iterator[socket.socket]:
    with closing(socket.create_connection(("127.0.0.1", server.port), timeout=5)) as raw:
        yield raw


async def ask(server: ModbusServer, unit: int, pdu: bytes) -> bytes:
    """One raw request; the answer without its header, which is checked."""

    def exchange() -> bytes:
        with connected(server) as raw:
            raw.sendall(struct.pack(">HHHB", 0xBEEF, 0, len(pdu) + 1, unit) + pdu)
            answer = raw.recv(300)
        transaction, protocol, length, answered_by = struct.unpack(">HHHB", answer[:7])
        assert (transaction, protocol, length, answered_by) == (0xBEEF, 0, len(answer) - 6, unit)
        return answer[7:]

    return bytes(await asyncio.to_thread(exchange))


async def mbpoll(line: str) -> tuple[int, list[str]]:
    """Exit code and the lines that show values."""
    process = await asyncio.create_subprocess_exec(
        *shlex.split(line), stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT
    )
    out, _ = await process.communicate()
    text = out.decode()
    shown = [row.rstrip() for row in text.splitlines() if re.match(r"\[\d+\]:", row)]
    return process.returncode or 0, shown or [text.splitlines()[0]]


def value_of(line: str) -> str:
    """`[11]: <tab>65506 (-30)` -> `65506`."""
    return line.split(":", 1)[1].split(maxsplit=1)[0]


async def with_client(
    server: ModbusServer, use: Callable[[AsyncModbusTcpClient], Awaitable[None]], host: str = "127.0.0.1"
) -> None:
    client = AsyncModbusTcpClient(host, port=server.port)
    assert await client.connect()
    try:
        await use(client)
    finally:
        client.close()


@complete
async def test_every_address_with_pymodbus() -> None:
    async def use(client: AsyncModbusTcpClient) -> None:
        whole = await client.read_holding_registers(0, count=BLOCK_WORDS)
        assert tuple(whole.registers) == COUNTING
        for read in (client.read_holding_registers, client.read_input_registers):
            for address in range(BLOCK_WORDS):
                one = await read(address, count=1)
                assert one.registers == [1000 + address]
            some = await read(37, count=41)
            assert some.registers == list(range(1037, 1078))

    async with ModbusServer(ANY_PORT, {1: Unit(lambda: COUNTING)}) as server:
        await with_client(server, use)
        assert server.stats.requests == 1 + 2 * (BLOCK_WORDS + 1)
        assert server.stats.exceptions == 0
        assert server.stats.connections == 1


@pytest.mark.parametrize(("order", "flag"), [("big", "-B"), ("little", "")])
@complete
async def test_float_word_order_with_mbpoll(order: WordOrder, flag: str) -> None:
    image = encode(ON_ITS_MARK, 0, order)
    async with ModbusServer(ANY_PORT, {1: Unit(lambda: image)}) as server:
        poll = f"mbpoll -m tcp -0 -1 -a 1 -p {server.port} 127.0.0.1"
        _, right = await mbpoll(f"{poll} {flag} -t 4:float -r 42 -c 6")
        assert [value_of(line) for line in right] == ["123456", "640.28", "355.21", "181.26", "298.6", "nan"]
        _, right = await mbpoll(f"{poll} {flag} -t 4:int -r 40 -c 1")
        assert [value_of(line) for line in right] == ["305419896"]
        other = "" if flag else "-B"
        _, wrong = await mbpoll(f"{poll} {other} -t 4:float -r 42 -c 1")
        assert [value_of(line) for line in wrong] == ["1.08658e-19"]  # what the page says a swap looks like
        _, wrong = await mbpoll(f"{poll} {other} -t 4:int -r 40 -c 1")
        assert [value_of(line) for line in wrong] == ["1450709556"]


@complete
@pytest.mark.failure_mode("G10")
async def test_an_image_that_is_none_is_a_fault_of_the_gateway(caplog: pytest.LogCaptureFixture) -> None:
    async with ModbusServer(ANY_PORT, {1: Unit(lambda: [1.5])}) as server:  # type: ignore[list-item]
        with caplog.at_level(logging.ERROR):
            for _ in range(3):
                assert await ask(server, 1, b"\x03\x00\x00\x00\x01") == b"\x83\x04"
        assert server.stats.image_faults == 3
        assert [record.message for record in caplog.records] == ["modbus: no image to answer with"]


@complete
async def test_identity() -> None:
    async def use(client: AsyncModbusTcpClient) -> None:
        told = await client.execute(False, ReadDeviceInformationRequest(read_code=2, dev_id=1))
        assert told.information == {
            0: b"plc-loading-gateway",
            1: b"plc-loading-gateway",
            2: __version__.encode(),
            4: b"PLC integration gateway for bulk loading",
            6: b"site1/bay1",
        }

    unit = Unit(lambda: COUNTING, identity=identity.objects("site1/bay1"))
    async with ModbusServer(ANY_PORT, {1: unit}) as server:
        await with_client(server, use)


def states(count: int) -> list[tuple[int, ...]]:
    """Images whose every value follows from their sequence number."""
    made = []
    for seq in range(count):
        state = replace(
            ON_ITS_MARK,
            seq=seq,
            heartbeat=seq,
            vision=replace(ON_ITS_MARK.vision, circle=Circle(seq * 1.1, seq * 1.2, seq * 1.3), frame_id=seq),
            range=replace(ON_ITS_MARK.range, distance_mm=float(seq)),
        )
        made.append(encode(state, seq * MS, "big"))
    return made


@complete
async def test_no_torn_read_while_the_image_changes_as_fast_as_it_can() -> None:
    """Another image at every turn of the event loop, which is where a gateway's images change.

    How many of them a poll sees depends on the machine, so it polls until it has seen enough.
    """
    images = states(2000)
    shown = [images[0]]
    swaps = 0

    async def swap() -> None:
        nonlocal swaps
        while True:
            swaps += 1
            shown[0] = images[swaps % len(images)]
            await asyncio.sleep(0)

    def poll(port: int) -> int:
        torn, refused = 0, 0
        seen: set[int] = set()
        client = ModbusTcpClient("127.0.0.1", port=port)
        assert client.connect()  # type: ignore[no-untyped-call]  # pymodbus
        with closing(client):
            while min(len(seen), refused) < 300:
                words = tuple(client.read_holding_registers(0, count=BLOCK_WORDS).registers)
                seen.add(words[0])
                torn += words[0] != words[99] or words != images[words[0] // 2]
                # The same in two reads: where the two numbers agree, the parts belong together.
                tail = client.read_input_registers(50, count=50).registers
                head = client.read_input_registers(0, count=50).registers
                if head[0] == tail[49]:
                    torn += (*head, *tail) != images[head[0] // 2]
                else:
                    refused += 1
        return torn

    async with ModbusServer(ANY_PORT, {1: Unit(lambda: shown[0])}) as server, asyncio.TaskGroup() as group:
        writer = group.create_task(swap())
        polls = [group.create_task(asyncio.to_thread(poll, server.port)) for _ in range(2)]
        assert [await poll_ended for poll_ended in polls] == [0, 0]
        writer.cancel()


@complete
async def test_ends_fast_whatever_its_clients_do() -> None:
    """An idle client, one in the middle of a frame, and one that asks without end and never reads."""

    now_s = asyncio.get_running_loop().time
    server = ModbusServer(ANY_PORT, {1: Unit(lambda: COUNTING)})
    async with server:
        port = server.port
        idle, half = (socket.create_connection(("127.0.0.1", port)) for _ in range(2))
        half.sendall(b"\x00\x01\x00\x00\x00")
        greedy = socket.socket()
        greedy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)  # before connecting, or the window is wide
        greedy.connect(("127.0.0.1", port))
        request = b"\x00\x01\x00\x00\x00\x06\x01\x03\x00\x00\x00\x64"
        greedy.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        while server.stats.open < 3:  # noqa: ASYNC110 - a counter, not an event
            await asyncio.sleep(0.01)
        ends = server._transports
        for end in ends:
            end.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1024)
        # Until the kernel takes no more and answers pile up in the process.
        while not any(end.get_write_buffer_size() for end in ends):
            greedy.sendall(request)
            await asyncio.sleep(0)
        assert server.stats.open == 3
        started = now_s()
    took = now_s() - started
    assert took < CLOSE_TIMEOUT_S
    assert server.stats.open == 0
    for client in (idle, half):
        client.settimeout(1)
        assert client.recv(10) == b""
    for client in (idle, half, greedy):
        client.close()
    with pytest.raises(RuntimeError, match="not running"):
        _ = server.port
    # The port is free for the next one at once, and the same object may be entered again.
    async with ModbusServer(ModbusConfig(port=port), {1: Unit(lambda: COUNTING)}), server:
        assert await ask(server, 1, b"\x03\x00\x00\x00\x01") == b"\x03\x02\x03\xe8"


@pytest.mark.parametrize("iterations", range(8))
@complete
async def test_a_connection_that_comes_with_the_end_is_cut_too(iterations: int) -> None:
    """Accepting takes a few turns of the event loop; the end may come at any of them."""

    async with ModbusServer(ANY_PORT, {1: Unit(lambda: COUNTING)}) as server:
        late = socket.create_connection(("127.0.0.1", server.port), timeout=1)
        for _ in range(iterations):
            await asyncio.sleep(0)
    for _ in range(8):
        await asyncio.sleep(0)
    with closing(late), suppress(ConnectionResetError):
        assert late.recv(10) == b""
    assert server.stats.open == 0


@complete
async def test_a_port_in_use_may_become_free() -> None:
    async with ModbusServer(ANY_PORT, {}) as server:
        with pytest.raises(LinkError, match=f"127.0.0.1 port {server.port}: another program listens there"):
            await ModbusServer(ModbusConfig(port=server.port), {}).__aenter__()


@complete
async def test_a_name_with_several_addresses_gets_one_port(monkeypatch: pytest.MonkeyPatch) -> None:
    """As `localhost` is where both 127.0.0.1 and ::1 carry that name."""
    resolve = socket.getaddrinfo

    def getaddrinfo(host: str, *args: Any, **kwargs: Any) -> list[Any]:
        hosts = ("127.0.0.1", "127.0.0.2") if host == "two.example" else (host,)
        return [found for name in hosts for found in resolve(name, *args, **kwargs)]

    async def use(client: AsyncModbusTcpClient) -> None:
        assert (await client.read_holding_registers(7, count=1)).registers == [1007]

    monkeypatch.setattr(socket, "getaddrinfo", getaddrinfo)
    async with ModbusServer(ModbusConfig(host="two.example", port=0), {1: Unit(lambda: COUNTING)}) as server:
        await with_client(server, use, host="127.0.0.1")
        await with_client(server, use, host="127.0.0.2")


@complete
async def test_ipv6() -> None:
    """On a machine without IPv6 the operator is told that the address is not there."""

    async def use(client: AsyncModbusTcpClient) -> None:
        assert (await client.read_holding_registers(7, count=1)).registers == [1007]

    try:
        with socket.socket(socket.AF_INET6) as probe:
            probe.bind(("::1", 0))
    except OSError:
        with pytest.raises((LinkError, ConfigError), match="cannot listen on ::1"):
            await ModbusServer(ModbusConfig(host="::1", port=0), {}).__aenter__()
        return
    async with ModbusServer(ModbusConfig(host="::1", port=0), {1: Unit(lambda: COUNTING)}) as server:
        await with_client(server, use, host="::1")


@complete
async def test_the_callers_error_passes_through() -> None:
    server = ModbusServer(ANY_PORT, {1: Unit(lambda: COUNTING)})
    with pytest.raises(ZeroDivisionError):
        async with server:
            raise ZeroDivisionError
    async with server:
        assert await ask(server, 1, b"\x03\x00\x00\x00\x01") == b"\x03\x02\x03\xe8"
