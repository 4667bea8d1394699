"""The commissioning page's mbpoll lines are run as they stand there, against the simulated bay that the page names."""

import re
import shlex
import subprocess
from pathlib import Path
from typing import Any

import pytest

from gateway.core.state import Reason, VisitPhase
from gateway.modbus.registers.register_map import REGISTERS
from tests.e2e.plc import Plc
from tests.e2e.processes import Gateway

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "plc-integration.md"
NAMES = {register.address: register.name for register in REGISTERS}
# What reads otherwise in every run; the rest must read as the page says.
LIVE = {"seq_begin", "heartbeat"}
NEAR = {"u", "v", "radius", "distance", "radius_f32", "distance_f32"}
LINE = re.compile(r"^\[(\d+)\]: \t(.+)$")


def in_place(image: dict[str, Any]) -> bool:
    return (image["reason"], image["visit_phase"]) == (Reason.TARGET_REACHED, VisitPhase.IN_PLACE)


def polls() -> list[tuple[str, list[str]]]:
    """(command, expected lines) of every mbpoll line on the page."""
    found = []
    for block in re.findall(r"^```console\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL):
        for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
            command, *lines = part.strip().splitlines()
            found.append((command, lines))
    return found


def run(command: str, port: int) -> list[str]:
    argv = shlex.split(command)
    assert argv[0] == "mbpoll"
    assert argv[argv.index("-p") + 1] == "5020"
    argv[argv.index("-p") + 1] = str(port)
    done = subprocess.run(argv, capture_output=True, text=True, timeout=20, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return [line for line in done.stdout.splitlines() if line.startswith("[")]


def test_the_page_has_its_lines() -> None:
    assert len(polls()) >= 10
    named = re.findall(r"gateway simulate --scenario (\S+) --modbus-port 5020", PAGE.read_text(encoding="utf-8"))
    assert named == ["docs/plc/on-mark.toml"]


@pytest.mark.long
def test_every_mbpoll_line_of_the_page_reads_what_the_page_says() -> None:
    scenario = str(ROOT / "docs" / "plc" / "on-mark.toml")
    with Gateway("simulate", "--scenario", scenario, "--modbus-port", "0", "--json") as gateway:
        port = gateway.started()["modbus_port"]
        for command, expected in polls():
            # A busy machine may lose a sensor for a moment: poll when the truck is known to stand in place, and seen.
            complaint: str | None = "not polled"
            for _ in range(5):
                with Plc(port) as plc:
                    plc.wait_for(in_place, timeout_s=30)
                    shown = run(command, port)
                if (complaint := differs(command, shown, expected)) is None:
                    break
            assert complaint is None


def differs(command: str, shown: list[str], expected: list[str]) -> str | None:
    """Why `shown` is not what the page says; None: it is."""
    bits = "-t 1 " in command or "-t 0 " in command
    matched = [(LINE.match(mine), LINE.match(theirs)) for mine, theirs in zip(shown, expected, strict=False)]
    if len(shown) != len(expected):
        return f"{command}\n{shown}\n{expected}"
    for mine, theirs in matched:
        if mine is None or theirs is None or mine[1] != theirs[1]:
            return f"{command}\n{shown}\n{expected}"
        name = "" if bits else NAMES[int(mine[1])]
        if name in LIVE:
            same = mine[2].isdigit() and theirs[2].isdigit()
        elif name in NEAR:
            same = float(mine[2]) == pytest.approx(float(theirs[2]), rel=0.1)
        else:
            same = mine[2] == theirs[2]
        if not same:
            return f"{command}: {name or 'bit'} {mine[1]} reads {mine[2]}, the page says {theirs[2]}"
    return None
