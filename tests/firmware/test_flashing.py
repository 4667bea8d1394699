"""The gateway's firmware goes through the Uno's own boot loader into an emulated ATmega328P, and says hello."""

import contextlib
import json
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from gateway.cli.main import main
from gateway.clock import SystemClock
from gateway.errors import ConfigError, LinkError
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
    with board(other_program, tmp_path, "--bootloader", str(BOOTLOADER)) as uno:
        assert uno.hello(2.5) is None

        def pulled(done: float) -> None:
            if done > 0.25:
                uno.do("unplug")

        with pytest.raises(LinkError, match="may have only a part of the firmware now"):
            flashing.flash(uno.port, flashing.image((HEX,)), CLOCK, pulled)
        uno.do("plug")
        uno.wait_for("cable")
        assert main(["firmware", "flash", uno.port]) == 0
        hello = uno.hello(20)
        assert hello is not None
        assert hello.version == 1


def test_a_board_without_a_boot_loader_and_a_port_that_is_taken(
    other_program: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(flashing, "SYNCS", 3)
    monkeypatch.setattr(flashing, "OPEN_S", 0.1)
    with board(other_program, tmp_path) as silent:
        with pytest.raises(LinkError, match=r"no boot loader answers: .* nothing was written"):
            flashing.flash(silent.port, b"x", CLOCK, lambda _: None)
        taken = Port(silent.port, 9600)
        with pytest.raises(LinkError, match="another program uses it"):
            flashing.flash(silent.port, b"x", CLOCK, lambda _: None)
        taken.close()
        with pytest.raises(ConfigError, match="this machine's own USB"):
            flashing.flash("socket://10.0.0.9:1", b"x", CLOCK, lambda _: None)
