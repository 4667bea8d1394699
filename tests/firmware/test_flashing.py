"""The gateway's firmware goes through the Uno's own boot loader into an emulated ATmega328P, and says hello."""

import contextlib
import json
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from gateway.clock import SystemClock
from gateway.errors import LinkError
from gateway.ranger import flashing
from gateway.ranger.hcsr04.protocol import Hello
from gateway.ranger.port import Port
from gateway.sim.emulator import FIRMWARE
from tests.firmware.bench_runs import BOOTLOADER, built, decoded

HEX = FIRMWARE / "build" / "ranger.hex"
CLOCK = SystemClock()
pytestmark = pytest.mark.xdist_group("flashing")


@pytest.fixture(scope="module")
def other_program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A board that says nothing, as one that carries somebody else's sketch."""
    built()
    elf = tmp_path_factory.mktemp("other") / "other.elf"
    source = ".global main\nmain: rjmp main\n"
    command = ["avr-gcc", "-mmcu=atmega328p", "-nostartfiles", "-x", "assembler", "-", "-o", str(elf)]
    subprocess.run(command, input=source, text=True, check=True)
    return elf


@dataclass
class Board:
    process: subprocess.Popen[str]
    port: str
    truth: Path

    def do(self, command: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{command}\n")
        self.process.stdin.flush()

    def hello(self, within_s: float) -> Hello | None:
        port, until, heard = Port(self.port, 9600), time.monotonic() + within_s, b""
        try:
            while time.monotonic() < until:
                heard += port.read()
                for event in decoded(heard):
                    if isinstance(event, Hello):
                        return event
        finally:
            port.close()
            self.wait_for("closed")  # what opens it next resets the board
        return None

    def wait_for(self, kind: str) -> None:
        """Until this is the newest thing that happened to the port."""
        until = time.monotonic() + 20
        while time.monotonic() < until:
            rows = map(json.loads, self.truth.read_text().splitlines())
            if [row["type"] for row in rows if row["type"] in ("opened", "closed", "cable")][-1:] == [kind]:
                return
            time.sleep(0.01)
        raise AssertionError(kind)


@contextlib.contextmanager
def board(elf: Path, folder: Path, *options: str) -> Iterator[Board]:
    port, truth = folder / "board", folder / "truth"
    command = [str(built()), "--elf", str(elf), "--port", str(port), "--dtr", "--stdin"]
    command += ["--truth", str(truth), *options]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("ready")
        yield Board(process, str(port), truth)
        process.kill()


def test_a_board_with_another_sketch_says_hello_after_it(other_program: Path, tmp_path: Path) -> None:
    """Cut off in the middle it says what to do, and can be repeated."""
    seen: list[float] = []
    with board(other_program, tmp_path, "--bootloader", str(BOOTLOADER)) as uno:
        assert uno.hello(2.5) is None

        def pulled(done: float) -> None:
            if done > 0.25:
                uno.do("unplug")

        with pytest.raises(LinkError, match=r"has a part of the firmware now; put it on again"):
            flashing.flash(uno.port, flashing.image((HEX,)), CLOCK, pulled)
        uno.do("plug")
        uno.wait_for("cable")
        flashing.flash(uno.port, flashing.image((HEX,)), CLOCK, seen.append)
        assert (seen[0], seen[-1], seen) == (0.0, 1.0, sorted(seen))
        hello = uno.hello(20)
        assert hello is not None
        assert hello.version == 1
