"""The recorder beside a real gateway: killed, stopped, refused by its disk. What was recorded is replayed."""

import json
import os
import signal
import time
from pathlib import Path
from typing import Any

import psutil
import pytest

from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.errors import LinkError
from gateway.records.index_reader import IndexReader
from gateway.records.record import VisitRecord
from gateway.records.recording import MissingItem, pictures, pictures_in, records, segments_of
from tests.e2e.plc import Plc
from tests.e2e.processes import Gateway, command

RECORDER = "gw-recorder"


def simulation(folder: Path) -> Gateway:
    return Gateway("simulate", "--no-hmi", "--modbus-port", "0", "--state-dir", str(folder), "--json")


def recorder_of(gateway: Gateway, timeout_s: float = 20.0) -> psutil.Process:
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        for process in gateway.family():
            if process.name() == RECORDER:
                return process
        time.sleep(0.05)
    raise AssertionError("there is no recorder process")


def folder_in(state: Path) -> Path:
    (found,) = (state / "records").glob("*/bay1")
    return found


def replay(state: Path, *more: str) -> tuple[int, dict[str, Any]]:
    done = command("replay", str(folder_in(state)), "--json", *more)
    return done.code, json.loads(done.out)


def test_a_run_is_replayed_bit_for_bit_with_its_pictures(tmp_path: Path) -> None:
    with simulation(tmp_path) as gateway:
        gateway.wait_for(lambda row: row["type"] == "event" and row["kind"] == "in_place", 60)
        deadline = time.monotonic() + 30  # the recorder process gives way to all others
        while not {"stop_raised", "in_place"} <= reasons_of_pictures(tmp_path):
            assert time.monotonic() < deadline, reasons_of_pictures(tmp_path)
            time.sleep(0.2)
        assert gateway.end() == 0
    code, said = replay(tmp_path)
    assert (code, said["same"], said["missing"]) == (0, True, [])
    assert said["steps"] > 300
    found = [p for path in pictures_in(folder_in(tmp_path)) for p in pictures(path)]
    assert not any(isinstance(p, MissingItem) for p in found)
    code, said = replay(tmp_path, "--against", str(other_thresholds(tmp_path)))
    assert code == 1
    assert any("in_place 1 -> 0" in row["outputs"] for row in said["otherwise"])


def reasons_of_pictures(state: Path) -> set[str]:
    """Of those that are on disk so far."""
    found = (p for path in pictures_in(folder_in(state)) for p in pictures(path))
    return {why for p in found if not isinstance(p, MissingItem) for why in p.head.why}


def other_thresholds(folder: Path) -> Path:
    path = folder / "new.toml"
    path.write_text('[fusion]\nradius_threshold_px = 300\n[[bays]]\nname = "bay1"\n')
    return path


@pytest.mark.long
@pytest.mark.failure_mode("G12")
def test_a_killed_recorder_loses_nothing_and_the_plc_notices_nothing(tmp_path: Path) -> None:
    with simulation(tmp_path) as gateway:
        port = gateway.started()["modbus_port"]
        with Plc(port) as plc:
            plc.wait_for(lambda image: True)
            plc.wait_for_beats(50)
            first = recorder_of(gateway)
            first.kill()
            plc.wait_for_beats(100)
            deadline = time.monotonic() + 20
            while (second := recorder_of(gateway)).pid == first.pid:
                assert time.monotonic() < deadline
                time.sleep(0.05)
            plc.wait_for_beats(100)
            second.send_signal(signal.SIGSTOP)
            plc.wait_for_beats(100)
            second.send_signal(signal.SIGCONT)
            plc.wait_for_beats(50)
        assert gateway.end() == 0
    code, said = replay(tmp_path)
    assert (code, said["same"], said["missing"]) == (0, True, [])
    assert said["steps"] > 400  # the ticks alone; frames and distances come as fast as the machine gives them


def test_what_was_recorded_up_to_a_second_before_a_crash_is_there(tmp_path: Path) -> None:
    with simulation(tmp_path) as gateway:
        port = gateway.started()["modbus_port"]
        with Plc(port) as plc:
            plc.wait_for(lambda image: True)
            deadline = time.monotonic() + 30  # the recorder process gives way to all others
            while not any((tmp_path / "records").glob("*/bay1/*")):
                assert time.monotonic() < deadline
                time.sleep(0.05)
            beats = plc.wait_for_beats(200)[-1].image["heartbeat"]
        os.kill(gateway.process.pid, signal.SIGKILL)
        gateway.process.wait(10)
    _, said = replay(tmp_path)
    assert said["same"]
    ticks = said["steps"] * 50 / 90  # 50 ticks, some 25 to 30 frames and 15 distances a second
    assert ticks > beats - 120


@pytest.mark.long
def test_a_disk_that_refuses_is_reported_and_stops_nothing(tmp_path: Path) -> None:
    (tmp_path / "records").write_text("in the way")
    with simulation(tmp_path) as gateway:
        port = gateway.started()["modbus_port"]
        with Plc(port) as plc:
            plc.wait_for(lambda image: True)
            plc.wait_for_beats(150)
            (tmp_path / "records").unlink()  # mended
            plc.wait_for_beats(150)
        assert gateway.end() == 0
    assert "recorder" in gateway.stderr
    assert "Not a directory" in gateway.stderr
    assert "writes again" in gateway.stderr
    code, said = replay(tmp_path)
    assert (code, said["same"], said["missing"]) == (0, True, [])


PATIENT = """
instance = "{instance}"
[fusion]  # a busy machine shall not make a sensor fall silent
vision_deadline_s = 5.0
range_deadline_s = 5.0
"""


@pytest.mark.long
@pytest.mark.failure_mode("G13")
def test_an_index_that_cannot_be_written_is_reported_and_stops_no_recording(tmp_path: Path) -> None:
    settings, instance = tmp_path / "settings.toml", f"index-{os.getpid()}"
    settings.write_text(PATIENT.format(instance=instance))
    (tmp_path / "records" / f"site1.{instance}" / "index.sqlite").mkdir(parents=True)
    args = ("simulate", "--no-hmi", "--modbus-port", "0", "--state-dir", str(tmp_path), "--config", str(settings))
    with Gateway(*args, "--json") as gateway:
        port = gateway.started()["modbus_port"]
        with Plc(port) as plc:
            plc.wait_for(lambda image: True)
            plc.wait_for_beats(150)
        deadline = time.monotonic() + 20
        while "index.sqlite" not in gateway.stderr and time.monotonic() < deadline:
            time.sleep(0.05)
        assert gateway.end() == 0
    assert "recorder: index.sqlite: unable to open database file" in gateway.stderr
    code, said = replay(tmp_path)
    assert (code, said["same"], said["missing"]) == (0, True, [])


STANDS = "seed = 5\nstart = { distance_cm = 28 }\n"
LEAVES = (
    "seed = 5\nstart = { distance_cm = 28 }\nlegs = [\n  { distance_cm = 28, speed_cm_s = 30, hold_s = 5 },\n"
    "  { distance_cm = 150, speed_cm_s = 40, hold_s = 500 },\n]\n"
)


@pytest.mark.long
def test_a_visit_across_a_restart_is_one_visit_and_is_in_the_index_before_its_minute_is_over(tmp_path: Path) -> None:
    settings, scenario, state = tmp_path / "settings.toml", tmp_path / "scenario.toml", tmp_path / "state"
    settings.write_text(PATIENT.format(instance=f"visit-{os.getpid()}"))
    bay = ("--scenario", str(scenario), "--config", str(settings), "--state-dir", str(state), "--method", "paper")
    args = ("simulate", *bay, "--no-hmi", "--modbus-port", "0", "--json")
    scenario.write_text(STANDS)
    with Gateway(*args) as gateway:
        gateway.wait_for(lambda row: row["type"] == "state" and row["in_place"])
        gateway.wait_for(lambda row: row["type"] == "state" and bool(visits_recorded(state)))
        os.kill(gateway.process.pid, signal.SIGKILL)
        gateway.process.wait(10)
    before = visits_recorded(state)[-1].visit
    assert (before.end, before.interruptions) == (VisitEnd.OPEN, 0)

    scenario.write_text(LEAVES)
    with Gateway(*args) as gateway:
        ended = gateway.wait_for(lambda row: row["type"] == "event" and row["kind"] == "visit", 60)
        assert "interrupted by a restart" in ended["detail"]
        deadline = time.monotonic() + 20  # the next minute's reading is later
        while not (found := indexed(state)) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert gateway.end() == 0
    assert [(visit.begun_ms, visit.end, visit.interruptions) for visit in found] == [
        (before.begun_ms, VisitEnd.CLEAR, 1)
    ]
    (visit,) = found
    assert visit.off_s > 0
    assert visit.in_place_s >= before.in_place_s
    assert visit.times_in_place >= before.times_in_place == 1
    told = [row for row in gateway.rows if row["type"] == "event" and row["kind"] == "visit"]
    assert len(told) == 1
    assert [record.visit.end for record in visits_recorded(state)].count(VisitEnd.CLEAR) == 1


def visits_recorded(state: Path) -> list[VisitRecord]:
    found = records(segments_of([folder_in(state)])) if (state / "records").exists() else ()
    return [item[1] for item in found if not isinstance(item, MissingItem) and isinstance(item[1], VisitRecord)]


def indexed(state: Path) -> list[VisitSummary]:
    try:
        return IndexReader(folder_in(state).parent).visits("bay1", 0, 2**60, 10)
    except LinkError:
        return []
