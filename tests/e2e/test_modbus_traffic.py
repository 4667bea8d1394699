"""A server tells what it has had to do, over real sockets."""

import asyncio
import socket
import struct
from collections.abc import Callable
from contextlib import closing

import pytest

from gateway.clock import SystemClock
from gateway.config import ModbusConfig
from gateway.modbus.protocol.answers import Unit
from gateway.modbus.server.limits import Refusal
from gateway.modbus.server.modbus_service import serving
from gateway.modbus.server.server import ModbusServer
from gateway.modbus.server.traffic import ServerNow
from tests.virtual_time import on_gateway_loop

READ = struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, 0, 2)
NO_UNIT = struct.pack(">HHHBBHH", 2, 0, 6, 99, 3, 0, 2)
UNITS = {1: Unit(lambda: (7, 8))}


def ask(port: int, *requests: bytes) -> socket.socket:
    raw = socket.create_connection(("127.0.0.1", port), timeout=10)
    for request in requests:
        raw.sendall(request)
        assert raw.recv(300)
    return raw


async def until(server: ModbusServer, seen: Callable[[ServerNow], bool]) -> ServerNow:
    """What it tells once it tells that."""
    async with asyncio.timeout(30):
        while not seen(now := server.now()):  # noqa: ASYNC110 - a counter, not an event
            await asyncio.sleep(0.02)
    return now


@on_gateway_loop
async def test_a_server_tells_who_asks_and_what_it_answered() -> None:
    config = ModbusConfig(port=0, plc_addresses=("127.0.0.1",))
    async with serving(config, UNITS, SystemClock()) as bound:
        (server,) = bound.servers
        (before,) = bound.now()
        assert (before.plc_quiet_s, before.peers, before.requests, before.tls) == (None, (), 0, False)
        with closing(await asyncio.to_thread(ask, server.port, READ, READ, NO_UNIT)):
            now = await until(server, lambda now: now.requests == 3 and now.plc_quiet_s is not None)
        assert (now.port, now.open, now.connections) == (bound.first, 1, 1)
        assert (now.requests, now.exceptions, now.image_faults) == (3, 1, 0)
        (peer,) = now.peers
        assert (peer.address, peer.is_plc, peer.connections, peer.requests) == ("127.0.0.1", True, 1, 3)
        assert [why for why, _ in now.refused] == list(Refusal)


@on_gateway_loop
async def test_a_stranger_s_requests_are_no_sign_of_the_plc() -> None:
    config = ModbusConfig(port=0, plc_addresses=("10.9.9.9",), max_connections=9)
    async with ModbusServer(config, UNITS) as server:
        with closing(await asyncio.to_thread(ask, server.port, READ)):
            now = await until(server, lambda now: now.requests == 1)
            await asyncio.sleep(0.3)  # a sweep at least
            assert server.now().plc_quiet_s is None
            assert now.peers[0].is_plc is False
    with pytest.raises(RuntimeError, match="not running"):
        server.now()
