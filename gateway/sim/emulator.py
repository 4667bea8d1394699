"""The real firmware in place of the simulated ranger: the compiled ELF in an emulated Uno, an HC-SR04 on its pins.

The emulator is a separate program (firmware/bench, built with `./dev firmware`). This module starts it, sends
it ahead of time where the world's target will be and which faults follow, and ends it. The bench ends with the pipe to
it, so it never outlives this process, however that ends.
"""

import asyncio
import contextlib
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Self

from gateway.clock import SystemClock
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.errors import ConfigError, LinkError
from gateway.ranger.hcsr04.session import FARTHEST_MM, NEAREST_MM
from gateway.sim.hcsr04 import SensorErrors
from gateway.sim.ranger_board import Faults, RangerFault

FIRMWARE = Path(__file__).parents[2] / "firmware"
ELF = FIRMWARE / "build" / "ranger.elf"
BENCH = FIRMWARE / "bench" / "build" / "bench"

AHEAD_S = 0.25
"""Of real time: so far ahead the bench has the world's course. A stall of this process shorter than that changes
nothing."""
FEED_S = 0.05
"""Of real time, between two deliveries."""
POINT_NS = 10_000_000
"""Of the world's time, between two points of its distance; the bench draws a straight line from one to the next."""
START_S = 10.0
END_S = 2.0


def commands_of(faults: Faults, errors: SensorErrors, measured_c: float | None = None) -> dict[str, str]:
    """What the bench must be sent for these faults to be in force, by what it changes. The worst of the sensor's
    wins. `measured_c`: what the board's thermometer measures; None: it has none."""
    sensor = "sensor ok"
    for fault, command in (
        (RangerFault.ECHO, f"sensor at {faults.get(RangerFault.ECHO, 0.0):g}"),
        (RangerFault.TOO_FAR, f"sensor at {FARTHEST_MM + 200:g}"),
        (RangerFault.TOO_NEAR, f"sensor at {NEAREST_MM / 2:g}"),
        (RangerFault.NO_ECHO, "sensor no_echo"),
        (RangerFault.STUCK, "sensor stuck"),
    ):
        sensor = command if fault in faults else sensor
    version = faults.get(RangerFault.WRONG_VERSION)
    thermometer = measured_c is not None and RangerFault.NO_TEMPERATURE not in faults
    return {
        "cable": "unplug" if RangerFault.UNPLUGGED in faults else "plug",
        "version": "version off" if version is None else f"version {version:.0f}",
        "sensor": sensor,
        "ds18b20": f"ds18b20 {measured_c:g}" if thermometer else "ds18b20 none",
        "jitter": f"jitter {faults.get(RangerFault.SCATTER, errors.jitter_mm):g}",
        "wild": f"wild {faults.get(RangerFault.WILD, 0.0):g}",
        "noise": f"noise {faults.get(RangerFault.LINE_NOISE, 0.0):g}",
        "mute": f"mute {'on' if RangerFault.SILENT in faults else 'off'}",
    }


def check_built(elf: Path = ELF, bench: Path = BENCH) -> None:
    """Raise ConfigError, with how to build them, where firmware or bench is missing."""
    missing = [str(path) for path in (elf, bench) if not path.is_file()]
    if missing:
        raise ConfigError(
            f"the emulated ranger needs {' and '.join(missing)}: ./dev firmware, or make -C firmware all and "
            "make -C firmware/bench (Debian: make gcc gcc-avr avr-libc arduino-core-avr libsimavr-dev libelf-dev)"
        )


class EmulatedRanger:
    """`async with` starts the board and makes the port, `run` keeps it in step with the world until cancelled.

    `distance_mm(t_ns)`: the truth at a time of `clock`, mm; None where nothing is in the beam. It is called with times
    a little ahead of the present. `faults(t_ns)`: what is scheduled; `forced` adds to it by hand. `log`: the bench
    writes there what it played, JSON lines; their t_ns counts from the `origin_ns` of the first one, in seconds of the
    board. `resets_on_open`: opening the port resets the board, as DTR does. Raises ConfigError where firmware or bench
    is not built.
    """

    def __init__(
        self,
        distance_mm: Callable[[int], float | None],
        clock: SystemClock,
        *,
        seed: int = 0,
        errors: SensorErrors | None = None,
        air_c: float = 20.0,
        temperature_sensor: bool = False,
        faults: Callable[[int], Faults] = lambda _: {},
        boot_s: float = 0.0,
        resets_on_open: bool = False,
        log: Path | None = None,
        elf: Path = ELF,
        bench: Path = BENCH,
    ) -> None:
        check_built(elf, bench)
        self._distance_mm = distance_mm
        self._clock = clock
        self._errors = errors or SensorErrors()
        self._air_c = air_c
        self._measured_c = air_c if temperature_sensor else None
        self._faults = faults
        self._log = log
        self._arguments = [str(bench), "--elf", str(elf), "--stdin", "--own-folder"]
        self._arguments += ["--seed", str(seed), "--speed", repr(clock.speed), "--boot", f"{1000 * boot_s:.3f}"]
        self._arguments += ["--dtr"] if resets_on_open else []
        self._process: asyncio.subprocess.Process | None = None
        self.forced: dict[RangerFault, float] = {}

    async def __aenter__(self) -> Self:
        self._directory = Path(tempfile.mkdtemp(prefix="ranger-"))
        try:
            await self._start()
        except BaseException:
            await self._end()
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._end()

    @property
    def port(self) -> str:
        """The path to open. It stays the same when the cable is pulled and put back; unplugged, it does not exist."""
        return str(self._directory / "ranger")

    @property
    def led(self) -> str:
        """The path of what the LED on D6 shows, for `Led`."""
        return str(self._directory / "led")

    async def run(self) -> None:
        """Feed the bench; never returns. Raises LinkError when it has ended; called again, it starts a new one."""
        if self._process is None or self._process.returncode is not None:
            await self._start()
        assert self._process is not None
        while self._process.returncode is None:
            until_ns = self._clock.now_ns() + round(AHEAD_S * self._clock.speed * NS_PER_S)
            await self._send(self._program(until_ns))
            await self._clock.sleep(FEED_S * self._clock.speed)
        raise LinkError(f"the firmware's emulator ended with code {self._process.returncode}")

    async def _start(self) -> None:
        """A new board, and the first stretch of its world. Raises LinkError."""
        self._directory.mkdir(exist_ok=True)
        clock = self._clock
        self._board_0_ns = self._fed_ns = clock.now_ns()
        origin_ns = clock.origin_ns + round((self._board_0_ns - clock.origin_ns) / clock.speed)
        arguments = [*self._arguments, "--port", self.port, "--origin", str(origin_ns)]
        arguments += ["--led", self.led, "--clock", str(self._board_0_ns)]
        arguments += ["--truth", str(self._log)] if self._log else []
        self._sent: dict[str, str] = commands_of({}, SensorErrors(-1.0))
        self._process = await asyncio.create_subprocess_exec(
            *arguments, stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE
        )
        errors = self._errors
        await self._send([f"air {self._air_c:g}", f"step {errors.step_mm:g}", f"dropout {errors.dropout:g}"])
        await self._send(self._program(self._board_0_ns + round(2 * AHEAD_S * clock.speed * NS_PER_S)))
        assert self._process.stdout is not None
        try:
            async with asyncio.timeout(START_S):
                answer = await self._process.stdout.readline()
        except TimeoutError:
            answer = b""
        if not answer.startswith(b"ready"):
            raise LinkError("the firmware's emulator did not start")

    async def _send(self, lines: Iterator[str] | list[str]) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # it ended: `run` checks the return code
            self._process.stdin.write("".join(f"{line}\n" for line in lines).encode())
            await self._process.stdin.drain()

    def _program(self, until_ns: int) -> Iterator[str]:
        """Distance and faults from where the last delivery ended, to `until_ns`."""
        while self._fed_ns <= until_ns:
            at_ms = (self._fed_ns - self._board_0_ns) / NS_PER_MS
            mm = self._distance_mm(self._fed_ns)
            yield f"track {at_ms + 0.001:.3f} {'none' if mm is None else format(max(0.0, mm), '.3f')}"
            wanted = commands_of({**self._faults(self._fed_ns), **self.forced}, self._errors, self._measured_c)
            yield from (f"at {at_ms:.3f} {text}" for text in self._changes(wanted))
            self._fed_ns += POINT_NS

    def _changes(self, wanted: Mapping[str, str]) -> Iterator[str]:
        for key, text in wanted.items():
            if self._sent[key] != text:
                self._sent[key] = text
                yield text

    async def _end(self) -> None:
        """The pipe closes, the bench ends; it is killed if it does not."""
        process, self._process = self._process, None
        if process is not None:
            assert process.stdin is not None
            process.stdin.close()
            try:
                async with asyncio.timeout(END_S):
                    await process.wait()
            except TimeoutError:
                process.kill()
                await process.wait()
        shutil.rmtree(self._directory, ignore_errors=True)
