"""A small share of the proof programs (bench/reports), with real processes. Nothing here is about how late."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from bench.chaos import planned
from bench.plant.faults import FAULTS
from bench.plant.simulated import ROOT

pytestmark = pytest.mark.timeout(300)
PATIENCE_S = 240.0  # on a machine that is busy with other tests; some 15 s otherwise


def told(folder: Path, program: str, *args: str) -> dict[str, Any]:
    """What `python -m bench.PROGRAM` reports; its own verdict is this test's."""
    command = [sys.executable, "-m", f"bench.{program}", *args, "--out", str(folder)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, start_new_session=True) as process:
        try:
            out, _ = process.communicate(timeout=PATIENCE_S)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 0, out
    report: dict[str, Any] = json.loads((folder / f"{program}.json").read_text())
    assert report["passed"]
    assert report["table"]["forbidden by the simulator's truth"] == "0"
    return report


def test_a_seed_and_a_number_give_the_same_fault_always_and_each_fault_is_drawn() -> None:
    drawn = [planned(7, number) for number in range(300)]
    assert drawn == [planned(7, number) for number in range(300)]
    assert {fault for plan in drawn for fault in plan.faults} == set(FAULTS)
    assert all(plan.faults[0].least_s <= plan.lasts_s <= plan.faults[0].most_s for plan in drawn)


def number_of(name: str, seed: int) -> int:
    """The first of a seed that is this fault alone, and short."""
    plans = (planned(seed, number) for number in range(10_000))
    return next(
        plan.number for plan in plans if plan.name == name and plan.moment == "any" and plan.wait_s + plan.lasts_s < 3
    )


@pytest.mark.long
def test_a_gateway_that_is_harmed_shows_nothing_that_is_not_so_and_recovers(tmp_path: Path) -> None:
    name = "no descriptors, and the vision process killed"
    report = told(tmp_path, "chaos", "--seed", "5", "--fault", str(number_of(name, 5)), "--recovery-s", "90")
    assert report["played"] == {name: 1}
    assert list(report["recovered_s"]) == [name]


@pytest.mark.long
def test_hostile_clients_at_every_door_get_right_answers_and_leave_nothing_behind(tmp_path: Path) -> None:
    short = ("--minutes", "0.06", "--calm-s", "1", "--clients", "12", "--later-ms", "10000", "--again-s", "90")
    report = told(tmp_path, "neighbours", *short)
    seen = {door: told["seen"] for door, told in report["hostile"].items()}
    assert set(seen) == {"modbus", "tls", "pages", "mqtt"}
    assert seen["modbus"]["answers judged"] > 100
    assert seen["tls"]["answers judged"] > 0
    assert seen["mqtt"]["connections"] > 0
    assert sum(seen["pages"].values()) > 10
