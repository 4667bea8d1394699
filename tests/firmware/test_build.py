"""The sketch builds, is small, says the protocol's constants, and the tests reach every line and branch of its core."""

import gzip
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.firmware.builds import make
from tests.firmware.core import BUILD, COVERED, FIRMWARE, LIBRARY_VARIABLE
from tools.hcsr04 import header

ROOT = FIRMWARE.parent
SOURCES = FIRMWARE / "ranger" / "src"
CORE = ("ds18b20.c", "ranger.c", "ranger_wire.c", "relay.c")


def test_the_constants_are_the_gateways() -> None:
    assert (SOURCES / "protocol_constants.h").read_text(encoding="utf-8") == header(), "run ./dev docs"


def test_one_make_builds_a_small_elf_and_hex() -> None:
    make()
    sizes = subprocess.run(
        ["avr-size", "-C", "--mcu=atmega328p", BUILD / "ranger.elf"], capture_output=True, text=True, check=True
    ).stdout
    found = re.findall(r"(Program|Data): +(\d+) bytes", sizes)
    used = {kind: int(count) for kind, count in found}
    assert 2000 < used["Program"] < 8 * 1024  # of 32 KB
    assert used["Data"] < 512  # of 2 KB; the rest is the stack's
    assert (BUILD / "ranger.hex").read_text().startswith(":")


def test_the_thermometer_builds_too(tmp_path: Path) -> None:
    make("THERMOMETER=1", f"BUILD={tmp_path}")
    assert b"board_sample_a0" in (tmp_path / "ranger.elf").read_bytes()


@pytest.mark.parametrize("name", [*CORE, *(name.replace(".c", ".h") for name in CORE)])
def test_the_core_knows_no_board(name: str) -> None:
    includes = set(re.findall(r'#include [<"](.*?)[>"]', (SOURCES / name).read_text(encoding="utf-8")))
    assert includes <= {"stdbool.h", "stdint.h", "protocol_constants.h"} | {name.replace(".c", ".h") for name in CORE}


def test_the_arduino_ide_finds_what_it_needs() -> None:
    """A folder named like its sketch, further sources below src/, and no absolute paths."""
    sketch = FIRMWARE / "ranger" / "ranger.ino"
    for include in re.findall(r'#include "(.*?)"', sketch.read_text(encoding="utf-8")):
        assert (sketch.parent / include).is_file()


@pytest.mark.long
@pytest.mark.timeout(300)  # it builds, and plays all of the core
def test_the_core_tests_reach_every_line_and_branch(tmp_path: Path) -> None:
    make("host")
    for notes in COVERED.glob("*.gcno"):
        shutil.copy(notes, tmp_path)
    environment = os.environ | {
        LIBRARY_VARIABLE: str(COVERED / "libranger.so"),
        "GCOV_PREFIX": str(tmp_path),
        "GCOV_PREFIX_STRIP": str(len(COVERED.parts) - 1),
    }
    tests = [str(Path(__file__).with_name(name)) for name in ("test_core.py", "test_codec.py", "test_relay.py")]
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *tests],
        cwd=ROOT, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stdout
    missed = [where for source in CORE for where in missed_in(tmp_path, source)]
    assert missed == []


def missed_in(folder: Path, source: str) -> list[str]:
    """Lines never run and branches never taken, as gcov counts them."""
    notes = f"libranger.so-{Path(source).stem}.gcno"
    subprocess.run(
        ["gcov", "--json-format", "--branch-probabilities", notes], cwd=folder, capture_output=True, check=True
    )
    report = json.loads(gzip.decompress((folder / f"{notes.removesuffix('.gcno')}.gcov.json.gz").read_bytes()))
    lines = next(file["lines"] for file in report["files"] if file["file"].endswith(f"/{source}"))
    assert len(lines) > 40
    assert sum(len(line["branches"]) for line in lines) > 10
    return [
        f"{source}:{line['line_number']}"
        for line in lines
        if line["count"] == 0 or any(branch["count"] == 0 for branch in line["branches"])
    ]
