"""The simulated drive: a Modbus server as a frequency converter is one, which moves a vehicle by what a PLC writes.

    address  register       access      value
    0        control        read/write  1: run; else the drive stops the vehicle
    1        speed          read/write  speed reference, mm/s, int16, positive towards the spout
    2        status         read        bit 0: running; bit 1: communication timeout
    3        actual_speed   read        mm/s, int16

Without a write for TIMEOUT_S it stops and shows the timeout, until `control` is written as 0. It knows nothing of the
gateway: nothing but these registers moves the vehicle.
"""

from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Self

from gateway.clock import Clock
from gateway.config import ModbusConfig
from gateway.modbus.protocol.adu import ModbusException
from gateway.modbus.protocol.answers import Peer, Unit
from gateway.modbus.server.server import ModbusServer
from gateway.sim.driven_way import DrivenWay, WayFile
from gateway.sim.vehicles import STEP_S, Vehicle

CONTROL, SPEED, STATUS, ACTUAL, WORDS = 0, 1, 2, 3, 4
RUN = 1
RUNNING, TIMED_OUT = 1, 2
TIMEOUT_S = 1.0
PERIOD_S = 0.02
MAX_STEP_S = 0.5  # what a process that was held makes up for at once
END_MM = 45.0  # of the ranger: nothing comes nearer
FAR_MM = 5000.0  # nor goes farther away


class DriveRegisters:
    """What is written and read, and the vehicle that follows. Pure: `t_s` is world time, and ascends."""

    def __init__(self, vehicle: Vehicle, start_mm: float) -> None:
        self._vehicle = vehicle
        self._shortest_mm, self._longest_mm = start_mm - FAR_MM, start_mm - END_MM
        self._control = self._speed = 0
        self._written_s = self._t_s = 0.0
        self._timed_out = False

    def read(self) -> tuple[int, ...]:
        status = RUNNING * bool(self._reference_mm_s) + TIMED_OUT * self._timed_out
        return self._control, self._speed, status, round(self._vehicle.speed_mm_s) & 0xFFFF

    def write(self, address: int, words: Sequence[int], peer: Peer, mask: int = 0xFFFF) -> ModbusException | None:
        if address + len(words) > STATUS:
            return ModbusException.ILLEGAL_ADDRESS
        values = [self._control, self._speed]
        for at, word in enumerate(words, address):
            values[at] = values[at] & ~mask | word & mask
        self._control, self._speed = values
        self._written_s = self._t_s
        self._timed_out &= self._control != 0
        return None

    @property
    def _reference_mm_s(self) -> float:
        runs = self._control == RUN and not self._timed_out
        return float(self._speed - (self._speed >> 15 << 16)) if runs else 0.0

    def advance(self, t_s: float) -> tuple[float, float]:
        """To this time. Returns way and speed."""
        vehicle = self._vehicle
        steps = int((min(t_s - self._t_s, MAX_STEP_S) + 1e-9) / STEP_S)
        self._timed_out |= self._control != 0 and t_s - self._written_s > TIMEOUT_S
        if steps > 0:
            self._t_s = t_s if t_s - self._t_s > MAX_STEP_S else self._t_s + steps * STEP_S
            vehicle.drive(self._reference_mm_s, steps * STEP_S)
        ends_mm = max(self._shortest_mm, min(self._longest_mm, vehicle.way_mm))
        if ends_mm != vehicle.way_mm:
            vehicle.way_mm, vehicle.speed_mm_s = ends_mm, 0.0
        return vehicle.way_mm, vehicle.speed_mm_s


class SimulatedDrive:
    """`async with` listens on a free port of loopback, `run` moves the vehicle until cancelled.

    `start_mm`: the vehicle's distance from the ranger at the start. `world_s`: world time now.
    """

    def __init__(
        self, vehicle: Vehicle, start_mm: float, path: str, clock: Clock, world_s: Callable[[], float]
    ) -> None:
        self.track = DrivenWay(path)
        self._registers = DriveRegisters(vehicle, start_mm)
        self._clock = clock
        self._world_s = world_s
        unit = Unit(self._registers.read, self._registers.write, words=WORDS)
        self._server = ModbusServer(ModbusConfig(port=0, connections_per_address=64), {1: unit})

    async def __aenter__(self) -> Self:
        await self._server.__aenter__()
        self._file = WayFile(self.track.path)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._server.__aexit__(kind, error, trace)
        self._file.close()

    @property
    def port(self) -> int:
        return self._server.port

    async def run(self) -> None:
        while True:
            t_s = self._world_s()
            self._file.drove(t_s, *self._registers.advance(t_s))
            await self._clock.sleep(PERIOD_S)
