"""Bad neighbours on real sockets. The PLC connects from 127.0.0.2, everybody else from 127.0.0.1."""

import asyncio
import logging
import random
import socket
from collections.abc import Callable, Coroutine, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import pytest

from gateway import event_loop
from gateway.config import ModbusConfig
from gateway.modbus.protocol.adu import MAX_FRAME_BYTES, frame_bytes
from gateway.modbus.protocol.answers import Unit
from gateway.modbus.server.connection import TURN_FRAMES, WRITE_HIGH_BYTES
from gateway.modbus.server.limits import Refusal
from gateway.modbus.server.server import RECEIVE_BYTES, SEND_BYTES, ModbusServer

PLC = "127.0.0.2"
IMAGE = tuple(range(1000, 1100))
ASK = bytes([3, 0, 0, 0, 100])
TOLD = bytes([3, 200]) + b"".join(word.to_bytes(2, "big") for word in IMAGE)
PATIENCE_S = 30.0


def serve(loop: str, test: Callable[[ModbusServer], Coroutine[Any, Any, None]], **keys: Any) -> None:
    """Runs `test(server)` against a server with these keys of [modbus]."""

    async def main() -> None:
        async with ModbusServer(ModbusConfig(port=0, **keys), {1: Unit(lambda: IMAGE)}) as server:
            await test(server)
        assert server.stats.open == 0

    with asyncio.Runner(loop_factory=event_loop.factory() if loop == "uvloop" else asyncio.new_event_loop) as runner:
        runner.run(main())


on_both_loops = pytest.mark.parametrize("loop", ["uvloop", "asyncio"])


def served(**keys: Any) -> Callable[[Callable[[ModbusServer], Coroutine[Any, Any, None]]], Callable[[str], None]]:
    """A test that is called with a server with these keys, on either event loop."""

    def decorated(test: Callable[[ModbusServer], Coroutine[Any, Any, None]]) -> Callable[[str], None]:
        @on_both_loops
        def called(loop: str) -> None:
            serve(loop, test, **keys)

        called.__name__, called.__doc__ = test.__name__, test.__doc__
        return called

    return decorated


@contextmanager
def connected(server: ModbusServer, source: str = "127.0.0.1") -> Iterator[socket.socket]:
    with socket.create_connection(("127.0.0.1", server.port), PATIENCE_S, (source, 0)) as raw:
        yield raw


async def until(true: Callable[[], bool]) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while not true():  # noqa: ASYNC110 - counters, not events
            await asyncio.sleep(0.02)


def poll(raw: socket.socket, transaction: int = 1) -> bool:
    """One answered poll; False: the connection has been closed."""
    try:
        raw.sendall(frame_bytes(transaction, 1, ASK))
        came = b""
        while len(came) < 7 + len(TOLD):
            chunk = raw.recv(1000)
            if not chunk:
                return False
            came += chunk
    except ConnectionError:
        return False
    assert came == frame_bytes(transaction, 1, TOLD)
    return True


@served(allow=["127.0.0.3"], plc_addresses=[PLC])
async def test_who_is_not_on_the_list_is_not_answered(server: ModbusServer) -> None:
    with connected(server) as stranger, connected(server, PLC) as plc, connected(server, "127.0.0.3") as known:
        assert not await asyncio.to_thread(poll, stranger)
        assert await asyncio.to_thread(poll, plc)
        assert await asyncio.to_thread(poll, known)
    assert server.stats.refused == {Refusal.NOT_ALLOWED: 1}
    assert server.stats.connections == 2


@on_both_loops
def test_the_log_has_one_line_of_a_kind_and_now_and_then_all_the_counters(
    loop: str, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gateway.modbus.server.server.SUMMARY_S", 0.3)

    async def use(server: ModbusServer) -> None:
        for _ in range(30):
            with connected(server) as stranger:
                assert not await asyncio.to_thread(poll, stranger)
        await until(lambda: any("not_allowed 30" in record.message for record in caplog.records))
        assert [record.message for record in caplog.records if record.levelno == logging.WARNING] == [
            f"modbus: 127.0.0.1: {Refusal.NOT_ALLOWED.value}"
        ]

    with caplog.at_level(logging.INFO, "gateway.modbus.server.server"):
        serve(loop, use, allow=["127.0.0.3"])


@served(max_connections=10, plc_connections=4, plc_addresses=[PLC])
@pytest.mark.failure_mode("P7")
async def test_the_cap_keeps_room_for_the_plc(server: ModbusServer) -> None:
    with ExitStack() as crowd:
        there = [crowd.enter_context(connected(server)) for _ in range(20)]
        await until(lambda: server.stats.refused[Refusal.FULL] == 14)
        assert server.stats.open == 6
        plcs = [crowd.enter_context(connected(server, PLC)) for _ in range(4)]
        assert all([await asyncio.to_thread(poll, plc) for plc in plcs])
        assert server.stats.open == 10
        # A fifth of the PLC's takes a place from the others, a sixth too.
        more = [crowd.enter_context(connected(server, PLC)) for _ in range(2)]
        assert all([await asyncio.to_thread(poll, plc) for plc in [*plcs, *more]])
        assert server.stats.refused == {Refusal.FULL: 14, Refusal.MADE_ROOM: 2}
        assert [await asyncio.to_thread(poll, raw) for raw in there].count(True) == 4


@served(idle_timeout_s=1.5, frame_timeout_s=0.3, plc_addresses=[PLC])
@pytest.mark.failure_mode("P8")
async def test_idle_and_half_frames_end_and_a_quiet_plc_does_not(server: ModbusServer) -> None:
    with connected(server) as idle, connected(server) as half, connected(server, PLC) as plc:
        half.sendall(frame_bytes(1, 1, ASK)[:5])
        assert await asyncio.to_thread(half.recv, 10) == b""
        assert await asyncio.to_thread(idle.recv, 10) == b""
        assert server.stats.refused == {Refusal.HALF_FRAME: 1, Refusal.IDLE: 1}
        assert await asyncio.to_thread(poll, plc)
        assert server.stats.open == 1


@served(keepalive_s=8)
async def test_a_connection_has_small_buffers_and_notices_a_peer_that_vanished(server: ModbusServer) -> None:
    with connected(server) as client:
        assert await asyncio.to_thread(poll, client)
        (end,) = server._transports
        option = end.get_extra_info("socket").getsockopt
        assert option(socket.SOL_SOCKET, socket.SO_RCVBUF) == 2 * RECEIVE_BYTES  # Linux doubles both
        assert option(socket.SOL_SOCKET, socket.SO_SNDBUF) == 2 * SEND_BYTES
        assert option(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
        quiet_s, every_s, probes = (
            option(socket.IPPROTO_TCP, which)
            for which in (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL, socket.TCP_KEEPCNT)
        )
        assert (quiet_s, every_s * probes) == (8, 8)
        assert option(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == 16_000


@served()
async def test_who_asks_is_not_idle_however_long_it_has_been_connected(server: ModbusServer) -> None:
    with connected(server) as busy:
        assert await asyncio.to_thread(poll, busy)
        (client,) = server._connections
        while server._connections[client] == client.answered:  # the sweep has seen it already
            assert await asyncio.to_thread(poll, busy)
        client.active_s -= 1000
        long_ago_s = client.active_s
        await until(lambda: client.active_s > long_ago_s)
        assert await asyncio.to_thread(poll, busy)
    assert not server.stats.refused


@served(send_timeout_s=0.5)
async def test_a_client_that_does_not_read_costs_little_and_is_cut(server: ModbusServer) -> None:
    with connected(server) as greedy, connected(server) as fair:
        greedy.setblocking(False)
        most = 0
        asked = frame_bytes(1, 1, ASK) * 50
        async with asyncio.timeout(PATIENCE_S):
            while not server.stats.refused[Refusal.NOT_READING]:
                try:
                    greedy.send(asked)
                except BlockingIOError:
                    await asyncio.sleep(0.01)
                except ConnectionError:
                    break
                assert await asyncio.to_thread(poll, fair)
                waiting = [end.get_write_buffer_size() for end in server._transports]
                held = [client._framer.held for client in server._connections]
                most = max(most, *waiting)
                assert max(waiting) <= WRITE_HIGH_BYTES + TURN_FRAMES * MAX_FRAME_BYTES
                assert max(held) <= 4 * RECEIVE_BYTES
        await until(lambda: server.stats.refused[Refusal.NOT_READING] == 1)
        assert most > WRITE_HIGH_BYTES  # it did come to back-pressure
        assert await asyncio.to_thread(poll, fair)


def misbehave(port: int, kind: str, seed: int, over: Callable[[], bool]) -> None:
    """One bad neighbour, who comes back whenever it is thrown out."""
    rng = random.Random(f"{kind} {seed}")
    while not over():
        try:
            with socket.socket() as raw:
                raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                raw.settimeout(1)
                raw.connect(("127.0.0.1", port))
                while not over():
                    if kind == "random":
                        raw.sendall(rng.randbytes(rng.randrange(1, 300)))
                    elif kind == "half":
                        raw.sendall(frame_bytes(1, 1, ASK)[: rng.randrange(1, 11)])
                        raw.recv(10)
                    else:
                        raw.sendall(frame_bytes(1, 1, ASK) * 20)
                        if kind == "flood":
                            raw.recv(65536)
        except OSError:
            continue


KEYS = {"max_connections": 24, "connections_per_address": 24, "plc_connections": 2, "plc_addresses": [PLC]}


@served(frame_timeout_s=0.2, send_timeout_s=0.2, **KEYS)
async def test_a_plc_polls_on_among_all_of_them(server: ModbusServer) -> None:
    """Idle ones up to the cap and beyond, random bytes, half frames, floods and clients that never read."""
    ended = False
    kinds = ["random", "half", "flood", "deaf"]

    def plc_polls() -> int:
        with connected(server, PLC) as plc:
            return sum(poll(plc, n) for n in range(300))

    with ExitStack() as crowd:
        for _ in range(60):
            crowd.enter_context(connected(server))
        async with asyncio.TaskGroup() as group:
            for seed, kind in enumerate(kinds):
                group.create_task(asyncio.to_thread(misbehave, server.port, kind, seed, lambda: ended))
            try:
                assert await asyncio.to_thread(plc_polls) == 300
                wanted = {Refusal.FULL, Refusal.BAD_PROTOCOL, Refusal.HALF_FRAME, Refusal.NOT_READING}
                # Those that had no place while the idle ones were there get theirs when these have gone.
                crowd.close()
                await until(lambda: wanted <= set(server.stats.refused))
                assert await asyncio.to_thread(plc_polls) == 300
            finally:
                ended = True
