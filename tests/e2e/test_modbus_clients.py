"""Clients that we did not write: libmodbus (a C program built here), mbpoll, pymodbus. And bytes cut anywhere."""

import asyncio
import shlex
import subprocess
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest
from pymodbus.client import AsyncModbusTcpClient

from gateway import __version__, event_loop
from gateway.config import ModbusConfig
from gateway.modbus.protocol import identity
from gateway.modbus.protocol.answers import Unit
from gateway.modbus.registers.bits import coil_of
from gateway.modbus.server.server import ModbusServer
from tests import modbus_oracle as oracle
from tests.modbus_fuzzing import fuzz, writing

SOURCE = Path(__file__).parents[1] / "modbus_clients" / "libmodbus_client.c"
WRITABLE = frozenset(range(80, 83))
CONTROL = coil_of("plc_control", 0)
OBJECTS = identity.objects("site1/bay1")


@pytest.fixture(scope="module")
def libmodbus_client(tmp_path_factory: pytest.TempPathFactory) -> Path:
    program = tmp_path_factory.mktemp("libmodbus") / "client"
    flags = subprocess.run(
        ["pkg-config", "--cflags", "--libs", "libmodbus"], check=True, capture_output=True, text=True
    )
    command = ["gcc", "-O1", "-Wall", "-Wextra", "-Werror", "-o", str(program), str(SOURCE), *shlex.split(flags.stdout)]
    subprocess.run(command, check=True)
    return program


class Bay:
    """A unit whose registers can be written, and its twin for the oracle."""

    def __init__(self, writes_on: bool) -> None:
        self.words = [1000 + n for n in range(123)]
        self.unit = Unit(lambda: tuple(self.words), writing(self.words, WRITABLE) if writes_on else None, OBJECTS)
        self.server = oracle.Server({1: oracle.Bay(list(self.words), WRITABLE, writes_on, dict(OBJECTS))})


def serve(bay: Bay, use: Callable[[ModbusServer], Coroutine[Any, Any, None]], **keys: Any) -> None:
    async def main() -> None:
        async with ModbusServer(ModbusConfig(port=0, **keys), {1: bay.unit}) as server:
            await use(server)

    event_loop.run(main())


EVERY_WORD = " ".join(str(1000 + n) for n in range(123))
READS = f"""\
holding 0 123: {EVERY_WORD}
input 0 123: {EVERY_WORD}
holding 0 1: 1000
holding 33 1: 1033
holding 66 1: 1066
holding 99 1: 1099
holding 99 1: 1099
holding 122 2: error Illegal data address
input 123 1: error Illegal data address
holding 65535 125: error Illegal data address
discrete 0 16: 1101011111000000
coils 1 9: 101011111
coils {CONTROL + 47} 2: error Illegal data address
"""
WRITES_ON = """\
write 80 3: done
write 81: done
write 4: Illegal data address
read-write 82 79: 1079 1 77 1
coil 0: Illegal data address
coil +1: done
coils +0 5: done
coils -1 5: Illegal data address
holding 81 1: 69
mask 81: done
holding 81 1: 72
"""
WRITES_OFF = """\
write 80 3: Illegal function
write 81: Illegal function
write 4: Illegal function
read-write 82 79: error Illegal function
coil 0: Illegal function
coil +1: Illegal function
coils +0 5: Illegal function
coils -1 5: Illegal function
holding 81 1: 1081
mask 81: Illegal function
holding 81 1: 1081
"""
BROADCAST = WRITES_OFF.replace("Illegal function", "Target device failed to respond")
REST = f"""\
server id: 1 FF plc-loading-gateway {__version__} site1/bay1
status: 87 01
count 0: 83 03
holding 3 2: 1003 1004
"""


@pytest.mark.parametrize("writes_on", [False, True])
def test_libmodbus(libmodbus_client: Path, writes_on: bool) -> None:
    bay = Bay(writes_on)

    async def use(server: ModbusServer) -> None:
        for unit in (1, 255, 0):
            process = await asyncio.create_subprocess_exec(
                *(str(libmodbus_client), "127.0.0.1", str(server.port), str(unit), str(CONTROL)),
                stdout=asyncio.subprocess.PIPE,
            )
            out, _ = await process.communicate()
            bay.words[80:83] = [1080, 1081, 1082]
            writes = BROADCAST if unit == 0 else WRITES_ON if writes_on else WRITES_OFF
            assert out.decode() == READS + writes + REST
            assert process.returncode == 0

    serve(bay, use)


def test_pymodbus_pipelines_bits_and_writes() -> None:
    bay = Bay(writes_on=True)

    async def use(server: ModbusServer) -> None:
        client = AsyncModbusTcpClient("127.0.0.1", port=server.port)
        assert await client.connect()
        bits = await client.read_discrete_inputs(0, count=16)
        assert "".join(str(int(bit)) for bit in bits.bits) == "1101011111000000"
        assert not (await client.write_registers(80, [5, 6])).isError()
        both = await client.readwrite_registers(read_address=79, read_count=4, write_address=82, values=[7])
        assert both.registers == [1079, 5, 6, 7]
        assert (await client.write_register(83, 1)).exception_code == 2
        bay.words[81] = 0
        assert not (await client.write_coil(CONTROL + 4, True)).isError()
        assert not (await client.write_coils(CONTROL, [True, True, False])).isError()
        assert (await client.read_coils(CONTROL, count=5)).bits[:5] == [True, True, False, False, True]
        assert not (await client.mask_write_register(address=81, and_mask=0xFFFD, or_mask=0x0004)).isError()
        assert bay.words[81] == 0b10001
        told: Any = (
            await client.report_device_id()
        )  # it takes the last byte for the run indicator, wherever that stands
        assert told.identifier == f"\x01\xffplc-loading-gateway {__version__} site1/bay".encode("latin1")
        client.close()

    serve(bay, use)


def test_thirty_thousand_frames_right_and_wrong() -> None:
    """A million, with seed 1, took some minutes and found nothing (docs/modbus-server.md)."""
    seen = event_loop.run(fuzz(30_000, seed=20261121))
    assert seen["frames"] == 30_000
    answered = [f"function {code} answered" for code in (1, 2, 3, 4, 5, 6, 15, 16, 17, 22, 23, 43)]
    for what in [*answered, "another protocol"]:
        assert seen[what] >= 5, what
    for code in ("01", "02", "03", "0B"):
        assert seen[f"exception {code}"] > 1000
    assert seen["exception 04"] == 0
