"""Modbus sensors that are not ours: libmodbus (RTU and TCP) and pymodbus's server, over ports and a serial server."""

import asyncio
import shlex
import shutil
import subprocess
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any

import pytest
from pymodbus import FramerType
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from gateway.clock import SystemClock
from gateway.config.sections.ranger_profiles import PROFILES
from gateway.core.readings import Quality, RangeReading
from tests.e2e.brokers import SEARCH, free_port
from tests.e2e.test_ranger_port import Host, eventually, together
from tests.e2e.test_ser2net import Ser2net
from tests.virtual_time import in_real_time

SOURCE = Path(__file__).parents[1] / "modbus_servers" / "libmodbus_sensor.c"
HOLDING = {"address": 257}
FAST = {"baud": 2_000_000}
"""A pty carries its bytes at once: at 9600 baud an answer would be too soon."""
FLOAT = {"table": "input_register", "address": 300, "data_type": "float32"}


@pytest.fixture(scope="module")
def sensor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program."""
    program = tmp_path_factory.mktemp("libmodbus") / "sensor"
    flags = subprocess.run(
        ["pkg-config", "--cflags", "--libs", "libmodbus"], check=True, capture_output=True, text=True
    )
    command = ["gcc", "-O1", "-Wall", "-Wextra", "-Werror", "-o", str(program), str(SOURCE), *shlex.split(flags.stdout)]
    subprocess.run(command, check=True)
    return program


@contextmanager
def running(*command: str) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(command)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


@asynccontextmanager
async def two_ends(folder: Path) -> AsyncIterator[tuple[str, str]]:
    """A serial line: what is written to one end is read at the other."""
    ends = [folder / "gateway-end", folder / "sensor-end"]
    program = shutil.which("socat", path=SEARCH)
    assert program is not None, "socat is missing: apt-get install socat"
    with running(program, *(f"pty,rawer,link={end}" for end in ends)):
        await eventually(lambda: all(end.exists() for end in ends))
        yield str(ends[0]), str(ends[1])


def host(port: str, modbus: dict[str, Any], mm_per_unit: float = 0.1, **keys: Any) -> Host:
    """A gateway's ranger, which is not running yet."""
    return Host(port, SystemClock(), type="modbus", modbus=modbus, number={"mm_per_unit": mm_per_unit}, **keys)


async def watched(made: Host, readings: int = 10) -> RangeReading:
    """So many distances of 250 mm, each later than the one before."""
    await made.until_measured(readings)
    times = [reading.t_ns for _, reading in made.measured]
    assert {reading.distance_mm for _, reading in made.measured} == {250.0}
    assert times == sorted(set(times))
    return made.measured[-1][1]


@in_real_time
async def test_rtu_on_a_serial_line_its_loss_and_its_return(sensor: Path, tmp_path: Path) -> None:
    async with two_ends(tmp_path) as (near, far):
        made = host(near, HOLDING, **FAST)
        async with together(made.supervisor.run):
            await made.until(lambda r: r.quality is Quality.STALE)
            for _ in range(2):
                with running(str(sensor), "rtu", far):
                    await made.until_good()
                    await watched(made, len(made.measured) + 10)
                silent = await made.until(lambda r: r.quality is Quality.STALE)
                assert silent.detail == "no answer for 1 s"
        assert made.service.session.identity == "Modbus RTU unit 1, holding register 257"


@in_real_time
async def test_an_answer_faster_than_the_configured_line_is_not_used(sensor: Path, tmp_path: Path) -> None:
    """Here the line is as fast as a pty: the answer could as well be one that a serial server had kept."""
    async with two_ends(tmp_path) as (near, far):
        made = host(near, HOLDING, baud=1200)
        with running(str(sensor), "rtu", far):
            async with together(made.supervisor.run):
                stale = await made.until(lambda r: r.quality is Quality.STALE)
    assert "ranger.baud" in stale.detail
    assert made.measured == []


@in_real_time
async def test_rtu_behind_a_serial_server(sensor: Path, tmp_path: Path) -> None:
    async with two_ends(tmp_path) as (near, far):
        with Ser2net(tmp_path, near, "socket") as server, running(str(sensor), "rtu", far):
            made = host(server.url, HOLDING, **FAST)
            async with together(made.supervisor.run):
                await watched(made)


@in_real_time
async def test_modbus_tcp_of_libmodbus(sensor: Path) -> None:
    port = free_port()
    with running(str(sensor), "tcp", str(port)):
        made = host(f"socket://127.0.0.1:{port}", {**FLOAT, "framing": "tcp"}, 1000)
        async with together(made.supervisor.run):
            await watched(made)


@in_real_time
async def test_modbus_tcp_of_pymodbus_that_answers_an_exception_and_goes() -> None:
    port = free_port()
    unit = SimDevice(1, simdata=[SimData(257, values=2500, datatype=DataType.REGISTERS)])
    server = ModbusTcpServer(unit, address=("127.0.0.1", port))
    serving = asyncio.create_task(server.serve_forever())
    wrong = host(f"socket://127.0.0.1:{port}", {**HOLDING, "address": 5000, "framing": "tcp"})
    made = host(f"socket://127.0.0.1:{port}", {**HOLDING, "framing": "tcp"})
    async with together(made.supervisor.run, wrong.supervisor.run):
        await watched(made)
        stale = await wrong.until(lambda r: r.quality is Quality.STALE)
        assert stale.detail == "exception 02 for 1 s"
        await server.shutdown()  # type: ignore[no-untyped-call]
        await made.until(lambda r: r.quality in (Quality.LINK_DOWN, Quality.STALE))
        said = len(made.measured)
        await asyncio.sleep(0.3)
        assert len(made.measured) == said
    await asyncio.gather(serving, return_exceptions=True)


SPAN = {
    "mm_per_unit": 4800 / 16000,
    "offset_mm": 200 - 4800 / 4,
    "nearest_mm": 200,
    "farthest_mm": 5000,
    "delay_ms": 50,
}
"""4 to 20 mA are 200 to 5000 mm."""
IO_LINK = {"mm_per_unit": 1, "nearest_mm": 20, "farthest_mm": 5000, "delay_ms": 50}
RANGE = {"nearest_mm": 200, "farthest_mm": 5000}
MAKERS: list[tuple[str, dict[str, Any], int, str, int, list[int], Quality, float | None]] = [
    # profile, what it leaves to the plant, and as documented: unit, table, first register, what they hold
    ("benewake-tf02-i", {}, 1, "holding", 0, [25, 800], Quality.GOOD, 250.0),
    ("benewake-tf02-i", {}, 1, "holding", 0, [4500, 30], Quality.TOO_FAR, None),
    ("dfrobot-sen0492", {}, 0x50, "holding", 0x34, [0x070B], Quality.GOOD, 1803.0),
    ("dfrobot-sen0519", {"number": {**RANGE, "delay_ms": 50}}, 15, "holding", 5, [2500], Quality.GOOD, 2500.0),
    ("dfrobot-sen0519", {"number": {**RANGE, "delay_ms": 50}}, 15, "holding", 5, [65535], Quality.NO_ECHO, None),
    ("geolux-lx80-o", {}, 1, "holding", 1, [1250, 1300], Quality.GOOD, 1250.0),
    ("ifm-al1940", {"number": IO_LINK}, 1, "holding", 1001, [0x0003, 250], Quality.GOOD, 250.0),
    ("ifm-al1940", {"number": IO_LINK}, 1, "holding", 1001, [0x0001, 250], Quality.LINK_DOWN, None),
    ("seeed-101991042", {"number": RANGE}, 1, "holding", 0x0100, [999, 250], Quality.GOOD, 250.0),
    ("waveshare-ai-8ch", {"number": SPAN}, 1, "input", 0, [12_000, 0], Quality.GOOD, 2600.0),
    ("waveshare-ai-8ch", {"number": SPAN}, 1, "input", 0, [3_590, 12_000], Quality.LINK_DOWN, None),
    ("waveshare-ai-8ch", {"number": SPAN}, 1, "input", 0, [20_000, 12_000], Quality.LINK_DOWN, None),
]


@in_real_time
@pytest.mark.parametrize(("profile", "keys", "unit", "table", "first", "values", "quality", "mm"), MAKERS)
async def test_a_profile_reads_the_registers_of_its_maker(
    profile: str,
    keys: dict[str, Any],
    unit: int,
    table: str,
    first: int,
    values: list[int],
    quality: Quality,
    mm: float | None,
) -> None:
    none = SimData(9999, values=0, datatype=DataType.REGISTERS)
    bits = SimData(0, values=False, datatype=DataType.BITS)
    held = [SimData(first, values=values, datatype=DataType.REGISTERS)]
    holding, inputs = (held, [none]) if table == "holding" else ([none], held)
    framer = FramerType.SOCKET if PROFILES[profile].keys["modbus"].get("framing") == "tcp" else FramerType.RTU
    port = free_port()
    device = SimDevice(unit, simdata=([bits], [bits], holding, inputs))
    server = ModbusTcpServer(device, framer=framer, address=("127.0.0.1", port))
    serving = asyncio.create_task(server.serve_forever())
    made = Host(f"socket://127.0.0.1:{port}", SystemClock(), profile=profile, **FAST, **keys)
    async with together(made.supervisor.run):
        reading = await made.until(lambda r: r.quality is quality)
        assert reading.distance_mm == (None if mm is None else pytest.approx(mm))
        await server.shutdown()  # type: ignore[no-untyped-call]
        await asyncio.sleep(0.1)  # its sockets are closed by the loop
    await asyncio.gather(serving, return_exceptions=True)


def test_every_profile_is_tried_so() -> None:
    assert {one[0] for one in MAKERS} == set(PROFILES)
