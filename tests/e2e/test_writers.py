"""Who may write, on plain TCP over real sockets: plc_addresses, one of them at a time."""

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any

import pytest
from pymodbus.client import AsyncModbusTcpClient

from gateway.core.plc import Control
from gateway.modbus.registers.bits import coil_of
from gateway.modbus.registers.register_map import BLOCK_WORDS, MAP_VERSION, decode
from tests.e2e.served_bay import ServedBay
from tests.virtual_time import on_gateway_loop

PLC, SECOND, STRANGER = "127.0.0.1", "127.0.0.2", "127.0.0.99"
CONTROL = coil_of("plc_control", 0)
BUSY, ILLEGAL_FUNCTION = 6, 1


def bay_with(**handshake: Any) -> ServedBay:
    modbus = {"port": 0, "writes": True, "plc_addresses": [PLC, SECOND], "handshake": handshake}
    # Long periods: on a machine that stands still for a moment the bay is not dead, and answers 06 rather than 04.
    fusion = {"vision_deadline_s": 10.0, "range_deadline_s": 10.0, "period_s": 1.0}
    return ServedBay({"modbus": modbus, "fusion": fusion})


@asynccontextmanager
async def client(port: int, source: str) -> AsyncIterator[AsyncModbusTcpClient]:
    made = AsyncModbusTcpClient("127.0.0.1", port=port, source_address=(source, 0), retries=0)
    assert await made.connect()
    yield made
    made.close()


async def image(asked: AsyncModbusTcpClient) -> dict[str, Any]:
    return decode((await asked.read_holding_registers(0, count=BLOCK_WORDS)).registers)


async def until(wanted: Callable[[], Coroutine[Any, Any, bool]]) -> None:
    for _ in range(1000):
        if await wanted():
            return
        await asyncio.sleep(0.02)
    raise TimeoutError


@on_gateway_loop
@pytest.mark.failure_mode("P6")
async def test_whoever_is_none_of_plc_addresses_reads_and_does_not_write() -> None:
    bay = bay_with()

    async with bay.open() as listening, client(listening.first, STRANGER) as stranger:
        assert (await image(stranger))["map_version"] == MAP_VERSION
        tries = [
            await stranger.write_register(80, 1),
            await stranger.write_registers(80, [1, 2, 3]),
            await stranger.write_coil(CONTROL + Control.RESET, True),
            await stranger.write_coils(CONTROL, [True] * 3),
            await stranger.mask_write_register(address=81, and_mask=0, or_mask=4),
            await stranger.readwrite_registers(read_address=0, read_count=1, write_address=80, values=[1]),
        ]
        assert [told.exception_code for told in tries] == [ILLEGAL_FUNCTION] * 6
        seen = await image(stranger)
        assert (seen["plc_heartbeat"], seen["plc_control"], seen["plc_writes"]) == (0, 0, 0)
    why = "it may not write (modbus.plc_addresses or, over TLS, modbus.tls.write_roles define who may)"
    assert bay.refused() == [f"{STRANGER}: {why}"] * 6


@on_gateway_loop
@pytest.mark.failure_mode("P13")
async def test_of_two_programs_of_one_plc_the_second_is_refused_until_the_first_has_disconnected() -> None:
    bay = bay_with(heartbeat_deadline_s=20.0)

    async with bay.open() as listening, client(listening.first, PLC) as first:
        async with client(listening.first, PLC) as earlier:
            assert not (await earlier.write_registers(80, [1, 2])).isError()
            assert (await first.write_registers(80, [500, 0])).exception_code == BUSY
            assert not (await first.write_coil(CONTROL + Control.ENABLE, True)).isError(), "without a heartbeat"
            seen = await image(first)
            assert (seen["write_conflicts"], seen["plc_control"], seen["plc_heartbeat"]) == (1, 3, 1)

        async def accepted() -> bool:
            return not (await first.write_registers(80, [501, 0])).isError()

        await until(accepted)
        assert (await image(first))["plc_heartbeat"] == 501
    why = "its heartbeat arrives on connection 2 already; two of its programs write to this bay"
    assert f"{PLC}, connection 1: {why}" in bay.refused()
