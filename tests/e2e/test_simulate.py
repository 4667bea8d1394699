"""The whole product as a user sees it: `gateway simulate`, a Modbus client and a broker that we did not write."""

import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest

from gateway.core.beacon import BeaconStatus
from gateway.core.readings import Quality
from gateway.core.state import Reason
from gateway.modbus.registers.register_map import REGISTERS
from gateway.shared_state import folder
from tests.e2e.brokers import Mosquitto, Subscriber
from tests.e2e.conftest import Cli
from tests.e2e.plc import Plc, Poll, mbpoll
from tests.e2e.processes import Gateway, Row, command, survivors
from tests.long import mostly_long

# On a busy machine vision begins late: the truck waits for it.
APPROACH = """
seed = 7
duration_s = 35
start = { distance_cm = 60 }
legs = [
  { distance_cm = 60, hold_s = 20 },
  { distance_cm = 27, speed_cm_s = 15, hold_s = 8 },
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
# A D that is known rests on a frame at most 0.3 s old and a distance at most 0.4 + 0.15 s old, however busy the machine
# is; stop goes off 0.3 s after D. The sensor is within 17 mm.
LATEST_S = 0.9
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
            code = gateway.end()
        gateway.finish()
        scada.wait_for(lambda message: message.topic.endswith("/status") and message.json["status"] == "offline")

        assert code == 0
        states = [row for row in gateway.rows if row["type"] == "state"]
        judged = [verdict for state in states if (verdict := expected_stop(state, states)) is not None]
        assert {True, False} == set(judged)
        wrong = [s for s in states if (want := expected_stop(s, states)) is not None and s["stop"] != want]
        assert wrong == []
        assert [s for s in states if s["d"] is None and not s["stop"]] == []
        known = [s["d"] for s in states if s["d"] is not None]
        assert [d for d, _ in groupby(known)] == [False, True, False]
        check_polls(plc, states)

        told = [message.json["kind"] for message in scada.on("/event")]
        assert told == events_of(gateway.rows)
        assert (told[0], told[-2:]) == ("start", ["stop_raised", "shutdown"])
        turns = [kind for kind in told if kind in ("stop_raised", "stop_cleared")]
        assert turns == ["stop_cleared", "stop_raised"] * (len(turns) // 2)
        # Twice each, unless the machine stood still for so long that a sensor fell silent: then there are more.
        assert len(turns) == 4 or "sensor_fault" in told
        ids = [message.json["id"] for message in scada.on("/event")]
        assert len(set(ids)) == len(ids)
        final = scada.on("/state")[-1].json
        assert (final["stop"], final["may_move"], final["radius_px"], final["distance_mm"]) == (True, False, None, None)


def expected_stop(state: Row, states: list[Row]) -> bool | None:
    """What stop must be while D is known; None where the truth is or was just now near a threshold, or D not known."""
    t_s = state["t_s"]
    rows = [s for s in states if t_s - LATEST_S <= s["t_s"] <= t_s]
    recent = [s["truth"] for s in rows]
    if state["reason"] == "shutdown" or any(s["d"] is None for s in rows) or t_s - LATEST_S < 0:
        return None
    if all(truth["z_mm"] > 300 + 15 + SENSOR_MM for truth in recent):
        return False
    if all(truth["z_mm"] <= 300 - SENSOR_MM and truth["r"] >= 183 for truth in recent):
        return True
    return None


def check_polls(plc: Plc, states: list[Row]) -> None:
    """Every polled image is whole, agrees with the state line of its moment, and the heartbeat never goes back."""
    assert len(plc.polls) > 100
    # Even numbers are of living states.
    by_seq = {2 * state["seq"] % 65536: state for state in states if state["reason"] != "gateway_fault"}
    agreed = 0
    for poll in plc.polls:
        state = by_seq.get(poll.image["seq_begin"])
        if state is None:
            continue
        assert poll.image["stop"] == state["stop"]
        # Each comes from two clocks read one after the other; a busy machine does other work between them.
        assert abs(poll.image["timestamp"] - state["unix_ms"]) <= 100
        if state["r"] is not None and poll.image["radius"] is not None:
            assert poll.image["radius"] == pytest.approx(state["r"], abs=0.06)
        if state["z_mm"] is not None and poll.image["distance"] is not None:
            assert poll.image["distance"] == pytest.approx(state["z_mm"], abs=0.51)
        agreed += 1
    assert agreed > 10
    beats = [poll.image["heartbeat"] for poll in plc.polls]
    assert beats == sorted(beats)
    assert beats[-1] > beats[0]


@pytest.mark.parametrize("number", mostly_long([signal.SIGTERM, signal.SIGINT]))
@pytest.mark.failure_mode("G3")
def test_a_signal_ends_it_and_the_last_word_is_stop(tmp_path: Path, number: int) -> None:
    args = ("simulate", "--scenario", scenario(tmp_path, STANDING), "--modbus-port", "0", "--json")
    with Gateway(*args) as gateway:
        port = gateway.started()["modbus_port"]
        with Plc(port) as plc:
            plc.wait_for(lambda image: image["may_move"] == 1)
            code = gateway.end(number)
            last = plc.last
        assert code == 0
        assert (last["stop"], last["may_move"], last["reason"]) == (1, 0, Reason.SHUTDOWN)
        assert (last["radius"], last["distance"]) == (None, None)
        assert "Traceback" not in gateway.stderr


def shared_files() -> set[tuple[Path, int]]:
    """What lies in shared memory of `settings`, by name and inode: a new file may take the name of a removed one."""
    return {(path, path.stat().st_ino) for path in folder().glob(f"loading-gateway.test-{os.getpid()}.*")}


@pytest.mark.long
@pytest.mark.failure_mode("G2")
def test_nothing_survives_a_sigkill_and_the_next_start_is_clean(tmp_path: Path) -> None:
    bay = ("--scenario", scenario(tmp_path, STANDING), "--config", settings(tmp_path))
    args = ("simulate", *bay, "--modbus-port", "0", "--json")
    with Gateway(*args) as gateway:
        gateway.wait_for(lambda row: row["type"] == "state" and row["may_move"])
        family = gateway.family()
        assert {process.name() for process in family} == {"gw-template", "gw-worker-bay1"}
        left = shared_files()  # read before the kill: any gateway that starts removes what dead ones left
        assert len(left) == 1
        os.kill(gateway.process.pid, signal.SIGKILL)
        gateway.process.wait(10)
        assert survivors(family) == []
    with Gateway(*args) as gateway:
        gateway.started()
        assert not left & shared_files()
        gateway.wait_for(lambda row: row["type"] == "state" and row["may_move"])
    assert shared_files() == set()


@pytest.mark.failure_mode("V1", "V2")
def test_a_killed_vision_process_is_replaced_and_meanwhile_stop_is_on(tmp_path: Path) -> None:
    args = ("simulate", "--scenario", scenario(tmp_path, STANDING), "--modbus-port", "0", "--json")
    with Gateway(*args) as gateway:
        port = gateway.started()["modbus_port"]
        with Plc(port, period_s=0.005) as plc:
            plc.wait_for(lambda image: image["may_move"] == 1)
            victim = next(p for p in gateway.family() if p.name().startswith("gw-worker"))
            victim.send_signal(signal.SIGSTOP)  # hangs; the deadline must notice
            hung = plc.wait_for(lambda image: image["stop"] == 1)
            assert hung.image["reason"] in (Reason.VISION_STALE, Reason.VISION_FAULT)
            assert hung.image["radius"] is None
            plc.wait_for(lambda image: image["may_move"] == 1)
            again = next(p for p in gateway.family() if p.name().startswith("gw-worker"))
            assert again.pid != victim.pid
            again.kill()
            plc.wait_for(lambda image: image["stop"] == 1)
            healed = plc.wait_for(lambda image: image["may_move"] == 1)
        assert healed.image["worker_restarts"] == 2
        assert healed.image["frames_lost"] <= 2  # no more than those that were being worked on


# A machine that stands still for a moment makes readings old; being touched by another's fault would say another thing.
UNTOUCHED = {Reason.NONE, Reason.VISION_STALE, Reason.RANGE_STALE}


def untouched(polls: list[Poll]) -> bool:
    return {poll.image["reason"] for poll in polls} <= UNTOUCHED


@pytest.mark.long
@pytest.mark.failure_mode("G7")
def test_one_bays_dead_camera_never_touches_the_others(tmp_path: Path) -> None:
    text = STANDING + 'bay = "bay2"\nfaults = [{ kind = "camera_lost", at_s = 6, for_s = 600 }]\n[camera]\nfps = 15.0\n'
    bays = ("--bays", "4", "--scenario", scenario(tmp_path, text), *LIGHT)
    args = ("simulate", *bays, "--modbus-port", "0", "--json")
    with Gateway(*args) as gateway:
        started = gateway.started()
        assert [bay["unit_id"] for bay in started["bays"]] == [1, 2, 3, 4]
        port = started["modbus_port"]
        with Plc(port, 1) as one, Plc(port, 2) as two, Plc(port, 3) as three, Plc(port, 4) as four:
            others = (one, three, four)
            two.wait_for(lambda image: image["vision_quality"] == Quality.LINK_DOWN, timeout_s=60)
            for plc in others:
                plc.wait_for(lambda image: image["may_move"] == 1, timeout_s=60)
            marks = [len(plc.polls) for plc in others]
            dead = two.wait_for_beats(100)
            assert {(p.image["stop"], p.image["may_move"], p.image["radius"]) for p in dead} == {(1, 0, None)}
            two.wait_for(lambda image: image["reason"] == Reason.CAMERA_DOWN)
            two.wait_for(lambda image: image["distance"] is not None)  # its ranger is alive
            for plc, mark in zip(others, marks, strict=True):
                plc.wait_for(lambda image: image["may_move"] == 1, timeout_s=60)
                assert untouched(plc.polls[mark:])


@pytest.mark.long
@pytest.mark.failure_mode("C3")
def test_a_stuck_picture_of_a_truck_far_away_gives_no_leave_to_move(tmp_path: Path) -> None:
    """Frames go on coming with new times: first they are one picture that ages, then a lost camera.

    Again and again: on a machine so busy that the gateway starts after the first fault, the next one is as good.
    """
    text = STANDING + "".join(
        f'[[faults]]\nkind = "camera_stuck"\nat_s = {at_s}\nfor_s = 20\n' for at_s in range(8, 150, 30)
    )
    with (
        Gateway("simulate", "--scenario", scenario(tmp_path, text), "--modbus-port", "0", "--json", *LIGHT) as gateway,
        Plc(gateway.started()["modbus_port"]) as plc,
    ):
        plc.wait_for(lambda image: image["may_move"] == 1, timeout_s=60)
        stale = plc.wait_for(lambda image: image["reason"] == Reason.VISION_STALE, timeout_s=60)
        assert (stale.image["stop"], stale.image["may_move"], stale.image["radius"]) == (1, 0, None)
        plc.wait_for(lambda image: image["reason"] == Reason.CAMERA_DOWN, timeout_s=60)
        stuck = plc.wait_for_beats(100)
        assert {(p.image["stop"], p.image["may_move"], p.image["radius"]) for p in stuck} == {(1, 0, None)}


@pytest.mark.parametrize("ranger", mostly_long(["simulated", "firmware"]))
def test_a_beacon_is_seen_in_rendered_pictures_and_late_ones_stop_the_truck(ranger: str, tmp_path: Path) -> None:
    """The pictures are 0.9 s late, again and again."""
    text = STANDING + "".join(
        f'[[faults]]\nkind = "camera_late"\nat_s = {at_s}\nfor_s = 10\ndelay_s = 0.9\n' for at_s in range(10, 300, 20)
    )
    path = tmp_path / "beacon.toml"
    path.write_text(
        f'instance = "test-{os.getpid()}"\n[ranger.hcsr04]\nbeacon = true\n'
        "[camera.beacon]\nu_px = 600\nv_px = 40\nradius_px = 8\n"
    )
    with (
        Gateway(
            *("simulate", "--config", str(path), "--scenario", scenario(tmp_path, text), "--ranger", ranger),
            *("--modbus-port", "0", "--json", *LIGHT),
        ) as gateway,
        Plc(gateway.started()["modbus_port"]) as plc,
    ):
        proven = plc.wait_for(lambda image: image["beacon_status"] == BeaconStatus.PROVEN, timeout_s=60)
        assert proven.image["beacon_latency"] < 250
        plc.wait_for(lambda image: image["may_move"] == 1, timeout_s=60)
        lost = plc.wait_for(lambda image: image["reason"] == Reason.BEACON_LOST, timeout_s=60)
        assert (lost.image["stop"], lost.image["may_move"], lost.image["radius"]) == (1, 0, None)


@pytest.mark.failure_mode("Q1")
def test_the_registers_go_on_while_the_broker_hangs_and_dies(tmp_path: Path) -> None:
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
        plc.wait_for_beats(75)  # a control path that waits for the broker would stand still here
        plc.wait_for(lambda image: image["may_move"] == 1)
        broker.resume()
        broker.kill()
        plc.wait_for_beats(75)
        plc.wait_for(lambda image: image["may_move"] == 1)
        assert untouched(plc.polls[mark:])
        assert gateway.end() == 0


@pytest.mark.long
def test_the_shared_state_vector_can_be_read_by_another_process(tmp_path: Path) -> None:
    args = ("simulate", "--scenario", scenario(tmp_path, STANDING), "--modbus-port", "0", "--json")
    with Gateway(*args) as gateway:
        instance = gateway.started()["instance"]
        gateway.wait_for(lambda row: row["type"] == "state" and row["may_move"])
        for _ in range(30):  # a stale moment of a busy machine passes
            row = state_verb("--instance", instance, "--once", "--json")
            if row["may_move"]:
                break
        assert row["bay"] == "bay1"
        assert row["pid"] == gateway.process.pid
        assert row["r"] == pytest.approx(5400 / 45, abs=3.0)
        assert row["z_mm"] == pytest.approx(450, abs=17)
        assert row["may_move"] is True
        assert row["age_ms"] >= 0
    ended = command("state", "--instance", instance, "--once", "--json")  # another simulation may have its name by now
    assert ended.code == 1 or json.loads(ended.out)["pid"] != gateway.process.pid


@pytest.mark.long
@pytest.mark.timeout(300)
@pytest.mark.parametrize("method", ["robust", "paper"])
def test_trials_reproduce_table_ii(method: str) -> None:
    """Ten trials take a minute at true speed; three at twice the speed show that the machinery is right.

    The truck stands until the gateway has decided, so that a busy machine makes this longer and nothing else.
    """
    args = ("simulate", "--trials", "3", "--method", method, "--speed", "2", "--modbus-port", "0", "--json")
    with Gateway(*args) as gateway:
        code = gateway.finish(280)
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
def test_a_wrong_argument_is_one_clear_line_and_exit_code_2(args: tuple[str, ...], said: str, cli: Cli) -> None:
    done = cli(*args)
    assert done.code == 2
    assert said in done.err


def state_verb(*args: str) -> dict[str, Any]:
    done = command("state", *args)
    assert done.code == 0, done.err
    found: dict[str, Any] = json.loads(done.out)
    return found


@pytest.mark.long
def test_simulations_that_start_at_the_same_moment_do_not_meet() -> None:
    with ExitStack() as stack:
        gateways = [stack.enter_context(Gateway("simulate", "--modbus-port", "0", "--json")) for _ in range(3)]
        rows = [gateway.started() for gateway in gateways]
        instances = [str(row["instance"]) for row in rows]
        assert len(set(instances)) == 3
        assert instances.count("simulate") <= 1  # none, where one of another test runs beside
        assert len({row["hmi"] for row in rows} - {None}) == 3
        assert [gateway.end() for gateway in gateways] == [0, 0, 0]
        assert [gateway.stderr for gateway in gateways] == ["", "", ""]


@pytest.mark.mostly_long
@pytest.mark.parametrize("library", ["pydantic_core", "uvloop"])
def test_ctrl_c_while_it_starts_ends_it_without_a_traceback(library: str) -> None:
    """While libraries are imported, and soon after; a terminal sends the signal to all processes of its group."""
    line = [sys.executable, "-m", "gateway", "simulate", "--modbus-port", "0", "--hmi-port", "0"]
    with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True) as process:
        while library not in Path(f"/proc/{process.pid}/maps").read_text():
            time.sleep(0.005)
        os.killpg(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert b"Traceback" not in out + err, err.decode()
    assert process.returncode in (0, 130, -signal.SIGINT)


# Pressed while a module is imported, in a callback that swallows every exception, as the import system has them.
PRESSED = """
import signal, sys, weakref
class Pressed:
    def find_spec(self, name, path=None, target=None):
        if name == module:
            sys.meta_path.remove(self)
            self.finder = weakref.ref(Pressed(), lambda _: signal.raise_signal(signal.SIGINT))
module = sys.argv.pop(1)
sys.meta_path.insert(0, Pressed())
from gateway.__main__ import main
sys.exit(main())
"""


@pytest.mark.parametrize("module", mostly_long(["uvloop", "gateway.cli.main", "gateway.cli.simulation", "asyncio"]))
def test_ctrl_c_that_an_import_has_swallowed_ends_it(module: str) -> None:
    arguments = [module, "simulate", "--modbus-port", "0", "--hmi-port", "0"]
    done = subprocess.run([sys.executable, "-c", PRESSED, *arguments], capture_output=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, b"")


def _resident_mb(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


@pytest.mark.parametrize("seed", mostly_long(range(60), short=2))
def test_ctrl_c_at_any_moment_of_the_start_ends_it(seed: int) -> None:
    line = [sys.executable, "-m", "gateway", "simulate", "--modbus-port", "0", "--hmi-port", "0", "--json"]
    size_mb = random.Random(seed).uniform(16, 60)  # from the first imports until it serves, on any machine
    with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True) as process:
        while _resident_mb(process.pid) < size_mb:
            time.sleep(0.001)
        os.killpg(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert b"Traceback" not in out + err, err.decode()
    assert process.returncode in (0, 130, -signal.SIGINT)


def test_what_is_printed_for_people_begins_with_the_addresses() -> None:
    done = command("simulate", "--duration", "1", "--modbus-port", "0", "--hmi-port", "0")
    first, second, third = done.out.splitlines()[:3]
    assert re.fullmatch(r"the pages: http://\S+:\d+/", first)
    assert second.startswith("simulated bay: approach, seed ")
    assert re.match(r"Modbus TCP on \S+:\d+, unit id 1; ", third)
