"""The whole product as a user sees it: `gateway simulate`, a Modbus client and a broker that we did not write."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from gateway.modbus.registers import BLOCK_WORDS, REGISTERS
from gateway.model import Quality, Reason
from gateway.shared_state import folder
from tests.e2e.brokers import Mosquitto, Subscriber
from tests.e2e.plc import Plc, mbpoll
from tests.e2e.processes import Gateway, Row, survivors

APPROACH = """
seed = 7
duration_s = 20
start = { distance_cm = 60 }
legs = [
  { distance_cm = 60, hold_s = 5 },
  { distance_cm = 27, speed_cm_s = 15, hold_s = 4 },
  { distance_cm = 60, speed_cm_s = 30, hold_s = 60 },
]
"""
# A truck that backs off slowly passes 30 cm in the sensor's 4 mm steps: without hysteresis stop may flicker there.
STEADY = """
instance = "{instance}"
[fusion]
distance_hysteresis_mm = 15.0
radius_hysteresis_px = 8.0
"""
STANDING = """
seed = 3
start = { distance_cm = 45 }
"""
# Where every moment of not knowing would spoil the story, a busy machine gets the method that costs least. The default
# method has its trials below, and test_tracking.py.
LIGHT = ("--method", "paper")
ADDRESS = {register.name: register.address for register in REGISTERS}
# The gateway may be later than the truth by: exposure and rendering, a 60 ms ranger cycle, the median's further cycle,
# 40 ms on the wire, a poll; and by what a busy machine adds. 15 cm/s make 45 mm of 0.3 s. The sensor is within 17 mm.
LATEST_S = 0.3
SENSOR_MM = 17.0


def scenario(folder_: Path, text: str) -> str:
    path = folder_ / "scenario.toml"
    path.write_text(text)
    return str(path)


def settings(folder_: Path) -> str:
    path = folder_ / "steady.toml"
    path.write_text(STEADY.format(instance=f"test-{os.getpid()}"))
    return str(path)


def events_of(rows: list[Row]) -> list[str]:
    return [row["kind"] for row in rows if row["type"] == "event"]


def test_an_approach_is_seen_by_mbpoll_by_pymodbus_and_by_mosquitto_sub(tmp_path: Path) -> None:
    """stop is 1 exactly while the truth says so, to within the sensors' error and delay; the events tell the story."""
    with (
        Mosquitto(tmp_path) as broker,
        Subscriber(broker, "#") as scada,
        Gateway(
            *("simulate", "--scenario", scenario(tmp_path, APPROACH), "--modbus-port", "0", "--json"),
            *("--mqtt-url", broker.url, "--config", settings(tmp_path), *LIGHT),
        ) as gateway,
    ):
        port = gateway.started()["modbus_port"]
        with Plc(port) as plc:
            plc.wait_for(lambda image: image["may_move"] == 1)
            far = mbpoll(port, ADDRESS["stop"], 3)
            assert far == [0, 1, Reason.NONE]
            assert mbpoll(port, ADDRESS["stop"], 3, function="3") == far  # input registers: the same image
            plc.wait_for(lambda image: image["reason"] == Reason.TARGET_REACHED)
            assert mbpoll(port, ADDRESS["stop"], 3) == [1, 0, Reason.TARGET_REACHED]
            plc.wait_for(lambda image: image["stop"] == 0)
            plc.wait_for(lambda image: image["distance"] is not None and image["distance"] > 550)
            code, took_s = gateway.end()
        gateway.finish()
        scada.wait_for(lambda message: message.topic.endswith("/status") and message.json["status"] == "offline")

        assert code == 0
        assert took_s < 4.0  # 2 on a machine of its own
        states = [row for row in gateway.rows if row["type"] == "state"]
        judged = [verdict for state in states if (verdict := expected_stop(state, states)) is not None]
        assert {True, False} == set(judged)
        wrong = [s for s in states if (want := expected_stop(s, states)) is not None and s["stop"] != want]
        assert wrong == []
        check_polls(plc, states)

        told = [message.json["kind"] for message in scada.on("/event")]
        story = ["start", "target_found", "stop_cleared", "stop_raised", "stop_cleared", "stop_raised", "shutdown"]
        assert told == story
        assert events_of(gateway.rows) == story
        ids = [message.json["id"] for message in scada.on("/event")]
        assert len(set(ids)) == len(ids)
        final = scada.on("/state")[-1].json
        assert (final["stop"], final["may_move"], final["radius_px"], final["distance_mm"]) == (True, False, None, None)


def expected_stop(state: Row, states: list[Row]) -> bool | None:
    """What stop must be, once both sensors were up; None where the truth is or was just now near a threshold."""
    t_s = state["t_s"]
    recent = [s["truth"] for s in states if t_s - LATEST_S <= s["t_s"] <= t_s]
    if state["reason"] in ("starting", "shutdown") or t_s - LATEST_S < 0:
        return None
    if all(truth["z_mm"] > 300 + 15 + SENSOR_MM for truth in recent):
        return False
    if all(truth["z_mm"] <= 300 - SENSOR_MM and truth["r"] >= 183 for truth in recent):
        return True
    return None


def check_polls(plc: Plc, states: list[Row]) -> None:
    """Every polled image is whole, agrees with the state line of its moment, and the heartbeat never goes back."""
    assert len(plc.polls) > 100
    by_seq = {2 * state["seq"] % 65536: state for state in states}  # even numbers are of living states
    agreed = 0
    for poll in plc.polls:
        state = by_seq.get(poll.image["seq_begin"])
        if state is None:
            continue
        assert poll.image["stop"] == state["stop"]
        assert abs(poll.image["timestamp"] - state["unix_ms"]) <= 5
        if state["r"] is not None and poll.image["radius"] is not None:
            assert poll.image["radius"] == pytest.approx(state["r"], abs=0.06)
        if state["z_mm"] is not None and poll.image["distance"] is not None:
            assert poll.image["distance"] == pytest.approx(state["z_mm"], abs=0.51)
        agreed += 1
    assert agreed > 10
    beats = [poll.image["heartbeat"] for poll in plc.polls]
    assert beats == sorted(beats)
    assert beats[-1] > beats[0]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_within_two_seconds_and_the_last_word_is_stop(tmp_path: Path, number: int) -> None:
    args = ("simulate", "--scenario", scenario(tmp_path, STANDING), "--modbus-port", "0", "--json")
    with Gateway(*args) as gateway:
        port = gateway.started()["modbus_port"]
        with Plc(port) as plc:
            plc.wait_for(lambda image: image["may_move"] == 1)
            code, took_s = gateway.end(number)
            last = plc.last
        assert code == 0
        assert took_s < 4.0  # 2 on a machine of its own
        assert (last["stop"], last["may_move"], last["reason"]) == (1, 0, Reason.SHUTDOWN)
        assert (last["radius"], last["distance"]) == (None, None)
        assert "Traceback" not in gateway.stderr


def shared_files() -> set[tuple[Path, int]]:
    """What lies in shared memory of `settings`, by name and inode: a new file may take the name of a swept one."""
    return {(path, path.stat().st_ino) for path in folder().glob(f"loading-gateway.test-{os.getpid()}.*")}


def test_nothing_survives_a_sigkill_and_the_next_start_is_clean(tmp_path: Path) -> None:
    bay = ("--scenario", scenario(tmp_path, STANDING), "--config", settings(tmp_path))
    args = ("simulate", *bay, "--modbus-port", "0", "--json")
    with Gateway(*args) as gateway:
        gateway.wait_for(lambda row: row["type"] == "state" and row["may_move"])
        family = gateway.family()
        assert len(family) == 2  # camera and vision process
        os.kill(gateway.process.pid, signal.SIGKILL)
        gateway.process.wait(10)
        assert survivors(family) == []
    corpses = shared_files()
    assert len(corpses) == 1
    with Gateway(*args) as gateway:
        gateway.started()
        assert not corpses & shared_files()
        gateway.wait_for(lambda row: row["type"] == "state" and row["may_move"])
    assert shared_files() == set()


def test_a_killed_vision_process_is_replaced_and_meanwhile_stop_is_on(tmp_path: Path) -> None:
    args = ("simulate", "--scenario", scenario(tmp_path, STANDING), "--modbus-port", "0", "--json")
    with Gateway(*args) as gateway:
        port = gateway.started()["modbus_port"]
        with Plc(port, period_s=0.005) as plc:
            plc.wait_for(lambda image: image["may_move"] == 1)
            victim = next(p for p in gateway.family() if "worker" in " ".join(p.cmdline()))
            victim.send_signal(signal.SIGSTOP)  # hangs; the deadline must notice
            hung = plc.wait_for(lambda image: image["stop"] == 1)
            assert hung.image["reason"] in (Reason.VISION_STALE, Reason.VISION_FAULT)
            assert hung.image["radius"] is None
            plc.wait_for(lambda image: image["may_move"] == 1)
            again = next(p for p in gateway.family() if "worker" in " ".join(p.cmdline()))
            assert again.pid != victim.pid
            again.kill()
            plc.wait_for(lambda image: image["stop"] == 1)
            healed = plc.wait_for(lambda image: image["may_move"] == 1)
        assert healed.image["worker_restarts"] == 2
        assert healed.image["frames_lost"] >= 1


def permitted(plc: Plc, mark: int) -> float:
    """Share of the polls since `mark` that read permit. A machine that stands still for a moment makes frames stale;
    being touched by another's fault would last."""
    polls = plc.polls[mark:]
    assert len(polls) > 20
    return len([poll for poll in polls if poll.image["may_move"] == 1]) / len(polls)


def test_one_bays_dead_camera_never_touches_the_others(tmp_path: Path) -> None:
    text = STANDING + 'bay = "bay2"\nfaults = [{ kind = "camera_lost", at_s = 12, for_s = 600 }]\n'
    bays = ("--bays", "4", "--scenario", scenario(tmp_path, text), *LIGHT)
    args = ("simulate", *bays, "--modbus-port", "0", "--json")
    with Gateway(*args) as gateway:
        started = gateway.started()
        assert [bay["unit_id"] for bay in started["bays"]] == [1, 2, 3, 4]
        port = started["modbus_port"]
        with Plc(port, 1) as one, Plc(port, 2) as two, Plc(port, 3) as three, Plc(port, 4) as four:
            others = (one, three, four)
            for plc in (*others, two):
                plc.wait_for(lambda image: image["may_move"] == 1, timeout_s=30)
            two.wait_for(lambda image: image["vision_quality"] == Quality.LINK_DOWN, timeout_s=30)
            marks = [len(plc.polls) for plc in others]
            time.sleep(2.0)
            assert (two.last["stop"], two.last["may_move"], two.last["reason"]) == (1, 0, Reason.CAMERA_DOWN)
            assert two.last["radius"] is None
            assert two.last["distance"] is not None  # its ranger is alive
            for plc, mark in zip(others, marks, strict=True):
                assert permitted(plc, mark) > 0.8
                plc.wait_for(lambda image: image["may_move"] == 1, timeout_s=30)


def test_the_registers_keep_their_pace_while_the_broker_hangs_and_dies(tmp_path: Path) -> None:
    with (
        Mosquitto(tmp_path) as broker,
        Gateway(
            *("simulate", "--scenario", scenario(tmp_path, STANDING), "--modbus-port", "0", "--json"),
            *("--mqtt-url", broker.url, *LIGHT),
        ) as gateway,
        Plc(gateway.started()["modbus_port"]) as plc,
    ):
        plc.wait_for(lambda image: image["may_move"] == 1)
        mark = len(plc.polls)
        broker.pause()
        time.sleep(1.5)
        broker.resume()
        broker.kill()
        time.sleep(1.5)
        polls = plc.polls[mark:]
        assert permitted(plc, mark) > 0.8
        beats = [poll.image["heartbeat"] for poll in polls]
        pace = (beats[-1] - beats[0]) / (polls[-1].read_s - polls[0].read_s)
        assert pace > 25  # of 50 ticks a second; a waiting control path would have stood still for seconds
        code, took_s = gateway.end()
        assert code == 0
        assert took_s < 4.0  # 2 on a machine of its own


def test_the_shared_state_vector_can_be_read_by_another_process(tmp_path: Path) -> None:
    args = ("simulate", "--scenario", scenario(tmp_path, STANDING), "--modbus-port", "0", "--json")
    with Gateway(*args) as gateway:
        instance = gateway.started()["instance"]
        gateway.wait_for(lambda row: row["type"] == "state" and row["may_move"])
        row = state_verb("--instance", instance, "--once", "--json")
        assert row["bay"] == "bay1"
        assert row["pid"] == gateway.process.pid
        assert row["r"] == pytest.approx(5400 / 45, abs=3.0)
        assert row["z_mm"] == pytest.approx(450, abs=17)
        assert row["may_move"] is True
        assert 0 <= row["age_ms"] < 1000
    done = run_gateway("state", "--instance", instance, "--once")
    assert done.returncode == 1
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("method", ["robust", "paper"])
def test_trials_reproduce_table_ii(method: str) -> None:
    """Ten trials take a minute at true speed; three at twice the speed show that the machinery is right.

    The truck stands until the gateway has decided, so that a busy machine makes this longer and nothing else.
    """
    args = ("simulate", "--trials", "3", "--method", method, "--speed", "2", "--modbus-port", "0", "--json")
    with Gateway(*args) as gateway:
        code = gateway.finish(100)
        table = next(row for row in gateway.rows if row["type"] == "trials")
        assert (table["number"], table["false_stops"], table["missed_stops"], table["undecided"]) == (3, 0, 0, 0)
        assert (code, table["accuracy"]) == (0, 1.0)
        assert table["nearest_mm"] == pytest.approx(250, abs=1)
        assert table["farthest_mm"] == pytest.approx(520, abs=1)
        assert 0 < table["worst_error_mm"] <= 17
        for trial in table["trials"]:
            assert trial["decision"] == trial["expected"], trial
            if method == "robust":
                assert trial["radius_px"] == pytest.approx(trial["true_radius_px"], abs=0.5)
        assert [trial["expected"] for trial in sorted(table["trials"], key=lambda trial: trial["actual_mm"])] == [
            True, False, False,
        ]  # fmt: skip


def test_the_block_fits_one_request() -> None:
    assert BLOCK_WORDS <= 125


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (("simulate", "--scenario", "nowhere"), "neither a file nor one of: approach"),
        (("simulate", "--speed", "0"), "--speed 0: must lie in 0.05 to 20"),
        (("simulate", "--trials", "10", "--scenario", "day"), "--trials brings its own scenario"),
        (("simulate", "--modbus-port", "70000"), "modbus.port = 70000"),
        (("simulate", "--mqtt-url", "http://x"), "mqtt.url"),
        (("simulate", "--method", "magic"), "vision.method = \"magic\": Input should be 'robust' or 'paper'"),
        (("run", "no-such-file.toml"), "no-such-file.toml: cannot read the configuration"),
    ],
)
def test_a_wrong_argument_is_one_clear_line_and_exit_code_2(args: tuple[str, ...], said: str) -> None:
    done = run_gateway(*args)
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr


def run_gateway(*args: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", "gateway", *args], capture_output=True, text=True, timeout=30, check=False
    )


def state_verb(*args: str) -> dict[str, Any]:
    done = run_gateway("state", *args)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_simulations_that_start_at_the_same_moment_do_not_meet() -> None:
    with ExitStack() as stack:
        gateways = [stack.enter_context(Gateway("simulate", "--modbus-port", "0", "--json")) for _ in range(3)]
        rows = [gateway.started() for gateway in gateways]
        instances = [str(row["instance"]) for row in rows]
        assert len(set(instances)) == 3
        assert instances.count("simulate") <= 1  # none, where one of another test runs beside
        assert len({row["hmi"] for row in rows} - {None}) == 3
        assert [gateway.end()[0] for gateway in gateways] == [0, 0, 0]
        assert [gateway.stderr for gateway in gateways] == ["", "", ""]
