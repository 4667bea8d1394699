"""The bench as a program: its words, its errors, and what the gateway tells it."""

import re
import subprocess
from pathlib import Path

import pytest

from gateway.errors import ConfigError
from gateway.sim.emulator import ELF, FIRMWARE, check_built, commands_of
from gateway.sim.hcsr04 import SensorErrors
from gateway.sim.ranger_board import RangerFault
from tests.firmware.bench_runs import built, run

ERRORS = SensorErrors(1.5, 4.0, 0.0)


def bench(*arguments: str, commands: str | None = None) -> tuple[int, str]:
    done = subprocess.run(
        [str(built()), *arguments], input=commands, capture_output=True, text=True, timeout=20, check=False
    )
    return done.returncode, done.stdout + done.stderr


def test_help_names_every_option_and_every_command() -> None:
    code, told = bench("--help")
    assert code == 0
    source = (FIRMWARE / "bench" / "main.c").read_text() + (FIRMWARE / "bench" / "commands.c").read_text()
    options = set(re.findall(r'\{"([a-z-]+)", [01], NULL', source))
    verbs = set(re.findall(r'strcmp\(verb, "([a-z_]+)"\)', source)) | set(re.findall(r'\{"([a-z_]+)", -?\d', source))
    assert len(options) >= 15
    assert len(verbs) >= 25
    assert [option for option in options if f"--{option}" not in told] == []
    assert [verb for verb in verbs if not re.search(rf"\b{verb}\b", told)] == []


@pytest.mark.parametrize(
    "line", ["nonsense", "distance", "distance -1", "distance 5 6", "sensor", "at x reset", "mute maybe", "air nan"]
)
def test_what_is_not_understood_is_said(line: str, tmp_path: Path) -> None:
    scenario = tmp_path / "scenario"
    scenario.write_text(f"distance 500\n# a comment\n\n{line}\n")
    code, told = bench("--elf", str(ELF), "--fast", "--until", "10", "--scenario", str(scenario))
    assert (code, told) == (2, f"bench: not understood: {line}\n")


def test_a_wrong_command_line_or_firmware_is_an_error(tmp_path: Path) -> None:
    assert bench()[0] == 2
    assert bench("--elf", str(ELF), "--fast")[0] == 2
    assert bench("--elf", str(ELF), "--speed", "fast")[0] == 2
    (tmp_path / "text").write_text("not an ELF")
    code, told = bench("--elf", str(tmp_path / "text"), "--fast", "--until", "1")
    assert code == 1
    assert "cannot read firmware" in told


def test_the_same_seed_plays_the_same() -> None:
    scenario = "distance 600\njitter 3\nstep 4\ndropout 0.1\nnoise 0.02\n"
    first, again = (run(scenario, 2000, "--seed", "3") for _ in range(2))
    assert first.heard == again.heard
    assert run(scenario, 2000, "--seed", "4").heard != first.heard


def test_it_ends_with_its_input_and_takes_its_port_away(tmp_path: Path) -> None:
    folder = tmp_path / "own"
    folder.mkdir()
    code, told = bench(
        *("--elf", str(ELF), "--port", str(folder / "port"), "--own-folder", "--stdin"), commands="distance 500\n"
    )
    assert (code, told) == (0, f"ready {folder / 'port'}\n")
    assert not folder.exists()


def test_a_missing_build_says_how_to_build(tmp_path: Path) -> None:
    built()
    check_built()
    with pytest.raises(ConfigError, match=r"ranger\.elf.*make -C firmware.*gcc-avr.*libsimavr-dev"):
        check_built(elf=tmp_path / "ranger.elf")


def test_every_fault_of_the_simulated_ranger_changes_what_the_bench_is_told() -> None:
    healthy = commands_of({}, ERRORS, 21.5)
    for fault in RangerFault:
        changed = {text for key, text in commands_of({fault: 7.0}, ERRORS, 21.5).items() if healthy[key] != text}
        assert len(changed) == 1, fault
    both = commands_of({RangerFault.STUCK: 0.0, RangerFault.TOO_FAR: 0.0}, ERRORS)
    assert both["sensor"] == "sensor stuck"
    assert healthy["jitter"] == "jitter 1.5"
    assert (healthy["ds18b20"], commands_of({}, ERRORS)["ds18b20"]) == ("ds18b20 21.5", "ds18b20 none")
