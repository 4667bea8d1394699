"""The firmware bench in virtual time: the compiled ELF, a scenario, what reached the host and what was played."""

import json
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from gateway.ranger.hcsr04.protocol import Decoder, Event, Flags, Hello, Measurement
from gateway.sim.emulator import BENCH, ELF, FIRMWARE
from tests.firmware.builds import PACKAGES, make

Row = dict[str, Any]
PERIOD_MS = 60
BOOTLOADER = FIRMWARE / "bench" / "build" / "bootloader.hex"


@cache
def built() -> Path:
    """Firmware and bench, up to date. Returns the bench. Fails saying what to install."""
    missing = [tool for tool in ("make", "gcc", "avr-gcc") if shutil.which(tool) is None]
    assert not missing, f"{missing} not found: apt-get install {PACKAGES}"
    for folder in (FIRMWARE, FIRMWARE / "bench"):
        make(folder=folder)
    return BENCH


@cache
def with_thermometer() -> Path:
    """The firmware built with the optional TMP36."""
    built()
    folder = FIRMWARE / "build" / "thermometer"
    make("THERMOMETER=1", f"BUILD={folder}")
    return folder / "ranger.elf"


@dataclass(frozen=True)
class Run:
    """`rows`: the truth, in its order; `heard`: the bytes that reached the host."""

    rows: list[Row]
    heard: bytes

    def of(self, kind: str) -> list[Row]:
        return [row for row in self.rows if row["type"] == kind]

    @property
    def lines(self) -> list[tuple[int, Event]]:
        """What left the UART, undamaged: the time of the last stop bit, and the message."""
        return [(row["t_ns"], decoded(row["text"].encode())[0]) for row in self.of("line")]

    @property
    def hellos(self) -> list[tuple[int, Hello]]:
        return [(t, m) for t, m in self.lines if isinstance(m, Hello)]

    @property
    def measurements(self) -> list[tuple[int, Measurement]]:
        return [(t, m) for t, m in self.lines if isinstance(m, Measurement)]

    @property
    def events(self) -> list[Event]:
        """What the host's decoder makes of what reached it."""
        return decoded(self.heard)

    def flags_between(self, from_ms: float, to_ms: float) -> set[Flags]:
        return {m.flags for t, m in self.measurements if from_ms * 1e6 <= t < to_ms * 1e6}


def decoded(data: bytes) -> list[Event]:
    return Decoder().feed(data)


def run(scenario: str, until_ms: float, *options: str, elf: Path = ELF) -> Run:
    """The bench, as fast as it can, in virtual time."""
    bench = built()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "scenario").write_text(scenario)
        done = subprocess.run(
            [
                *(str(bench), "--elf", str(elf), "--fast", "--until", str(until_ms), *options),
                *("--scenario", str(folder / "scenario")),
                *("--truth", str(folder / "truth"), "--uart", str(folder / "uart")),
            ],
            capture_output=True,
            text=True,
            check=False,
            timeout=100,
        )
        assert (done.returncode, done.stderr) == (0, "")
        rows = [json.loads(line) for line in (folder / "truth").read_text().splitlines()]
        return Run(rows, (folder / "uart").read_bytes())
