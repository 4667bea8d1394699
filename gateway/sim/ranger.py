"""The simulated ranger on a pty: real bytes at the wire's pace, behind a path that survives unplugging."""

import errno
import math
import os
import select
import shutil
import tempfile
import tty
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from gateway.clock import Clock
from gateway.durations import NS_PER_S
from gateway.sim.hcsr04 import SensorErrors
from gateway.sim.led import LedFile
from gateway.sim.ranger_board import POWER_ON, RESET_LINE, Faults, RangerBoard, RangerFault
from gateway.sim.scenario import FaultKind, Scenario
from gateway.sim.world import World

MAX_SLEEP_NS = 20_000_000
"""The board looks up at least so often: for questions, for faults, for the cable."""

# What a scenario's fault is to the board, with its amount; of an echo, the scenario has it.
OF_SCENARIO: Mapping[FaultKind, tuple[RangerFault, float]] = {
    FaultKind.RANGER_SILENT: (RangerFault.SILENT, 0.0),
    FaultKind.RANGER_NO_ECHO: (RangerFault.NO_ECHO, 0.0),
    FaultKind.RANGER_STUCK: (RangerFault.STUCK, 0.0),
    FaultKind.RANGER_TOO_NEAR: (RangerFault.TOO_NEAR, 0.0),
    FaultKind.RANGER_TOO_FAR: (RangerFault.TOO_FAR, 0.0),
    FaultKind.RANGER_NOISE: (RangerFault.LINE_NOISE, 0.03),
    FaultKind.RANGER_WILD: (RangerFault.WILD, 2500.0),
    FaultKind.RANGER_ECHO: (RangerFault.ECHO, 0.0),
    FaultKind.RANGER_UNPLUGGED: (RangerFault.UNPLUGGED, 0.0),
    FaultKind.RANGER_WRONG_VERSION: (RangerFault.WRONG_VERSION, 99.0),
    FaultKind.RANGER_NO_TEMPERATURE: (RangerFault.NO_TEMPERATURE, 0.0),
}


def faults_of(scenario: Scenario, t_s: float, ranger: int = 1) -> Faults:
    """What is wrong with the board of this ranger at world time `t_s`. Of several echoes the nearest is received."""
    found: dict[RangerFault, float] = {}
    for fault in scenario.faults:
        if fault.kind not in OF_SCENARIO or fault.ranger != ranger or not fault.active(t_s):
            continue
        kind, amount = OF_SCENARIO[fault.kind]
        if kind is RangerFault.ECHO:
            amount = min(10.0 * fault.distance_cm, found.get(kind, math.inf))
        found[kind] = amount
    return found


def options_of(scenario: Scenario, world: World, origin_ns: int, ranger: int = 1) -> dict[str, Any]:
    """Of one ranger of a simulated bay, simulated or emulated; world time 0 is `origin_ns` of the clock."""
    sensor = scenario.ranger

    def distance_mm(t_ns: int) -> float:
        t_s = (t_ns - origin_ns) / NS_PER_S
        offsets = (one for one in scenario.faults if one.kind is FaultKind.RANGER_OFFSET and one.ranger == ranger)
        return world.distance_mm(t_s) + sum(10 * one.offset_cm for one in offsets if one.active(t_s))

    return {
        "distance_mm": distance_mm,
        "faults": lambda t_ns: faults_of(scenario, (t_ns - origin_ns) / NS_PER_S, ranger),
        "seed": scenario.seed + ranger - 1,
        "errors": SensorErrors(sensor.jitter_mm, sensor.step_mm, sensor.dropout),
        "air_c": sensor.temperature_c,
        "temperature_sensor": sensor.temperature_sensor,
    }


class SimulatedRanger:
    """`async with` makes the port, `run` keeps the board running until cancelled.

    `distance_mm(t_ns)`: the truth at a time of `clock`, mm; None where nothing is in the beam.
    `faults(t_ns)`: what is scheduled; `forced` adds to it by hand.
    `boot_s`: the boot loader's wait after power on. `resets_on_open`: opening the port resets the board, as DTR does.
    """

    def __init__(
        self,
        distance_mm: Callable[[int], float | None],
        clock: Clock,
        *,
        seed: int = 0,
        errors: SensorErrors | None = None,
        air_c: float = 20.0,
        temperature_sensor: bool = False,
        faults: Callable[[int], Faults] = lambda _: {},
        boot_s: float = 0.0,
        resets_on_open: bool = False,
    ) -> None:
        self._clock = clock
        self._faults = faults
        self._resets_on_open = resets_on_open
        self._board = RangerBoard(
            distance_mm,
            seed=seed,
            errors=errors,
            air_c=air_c,
            temperature_sensor=temperature_sensor,
            boot_ns=round(boot_s * NS_PER_S),
        )
        self._master: int | None = None
        self._opened = False
        self.forced: dict[RangerFault, float] = {}
        self.dropped_bytes = 0
        """Sent while no program had the port open, or into a full one."""

    async def __aenter__(self) -> Self:
        self._directory = Path(tempfile.mkdtemp(prefix="ranger-"))
        self._led = LedFile(self.led)
        self._board.show = self._led.show
        self._plug()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._unplug()
        self._led.close()
        shutil.rmtree(self._directory)

    @property
    def led(self) -> str:
        """The path of what the beacon's LED shows, for `Led`."""
        return str(self._directory / "led")

    @property
    def port(self) -> str:
        """The path to open. It stays the same when the cable is pulled and put back; unplugged, it does not exist."""
        return str(self._directory / "ranger")

    @property
    def opened(self) -> bool:
        """A program has the port open."""
        return self._opened

    async def run(self) -> None:
        """Pace the board in the clock's time; never returns."""
        while True:
            now_ns = self._clock.now_ns()
            self.step(now_ns)
            wake_ns = min(self._board.wake_ns(), now_ns + MAX_SLEEP_NS)
            await self._clock.sleep(max(0, wake_ns - self._clock.now_ns()) / NS_PER_S)

    def step(self, now_ns: int) -> None:
        """Do everything that is due. Never blocks."""
        faults = {**self._faults(now_ns), **self.forced}
        self._board.faults = faults
        if RangerFault.UNPLUGGED in faults:
            self._unplug()
            return
        if self._master is None:
            self._plug()
        self._watch_host(now_ns)
        self._write(self._board.advance(now_ns))

    def _plug(self) -> None:
        master, slave = os.openpty()
        tty.setraw(slave)  # a pty echoes what it is sent unless set to raw
        os.set_blocking(master, False)
        new = self._directory / "new"
        new.symlink_to(os.ttyname(slave))
        new.replace(self._directory / "ranger")
        os.close(slave)  # held open here, the pty would look as if a host were there
        self._master, self._opened = master, False
        self._board.boot(self._clock.now_ns(), POWER_ON)

    def _unplug(self) -> None:
        if self._master is not None:
            (self._directory / "ranger").unlink()
            os.close(self._master)
        self._master, self._opened = None, False

    def _watch_host(self, now_ns: int) -> None:
        """Notice that the port was opened or closed, and read what the host sent."""
        if self._master is None:
            return
        poll = select.poll()
        poll.register(self._master, select.POLLIN)
        state = dict(poll.poll(0)).get(self._master, 0)
        opened = not state & select.POLLHUP
        if opened and not self._opened and self._resets_on_open:
            self._board.boot(now_ns, RESET_LINE)
        self._opened = opened
        if opened and state & select.POLLIN:
            try:
                self._board.hear(os.read(self._master, 4096), now_ns)
            except OSError as error:
                if error.errno != errno.EIO:  # closed in this very moment
                    raise

    def _write(self, data: bytes) -> None:
        if self._master is None or not data:
            return
        written = 0
        if self._opened:
            try:
                written = os.write(self._master, data)
            except BlockingIOError:
                written = 0
            except OSError as error:
                if error.errno != errno.EIO:
                    raise
        self.dropped_bytes += len(data) - written
