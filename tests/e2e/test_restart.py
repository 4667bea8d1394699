"""A gateway that is killed while a truck is in place, and started again when the truck has left without a release."""

import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from pymodbus.client import ModbusTcpClient

from gateway.core.state import Reason, VisitPhase
from gateway.modbus.registers.register_map import REGISTERS
from tests.e2e.brokers import Mosquitto, Subscriber
from tests.e2e.plc import Plc
from tests.e2e.processes import Gateway

ADDRESS = {register.name: register.address for register in REGISTERS}
RESET = 1 << 2
AT_MARK, LEFT = "seed = 5\nstart = { distance_cm = 28 }\n", "seed = 5\nstart = { distance_cm = 50 }\n"
SETTINGS = """
instance = "{instance}"
[modbus]
port = 0
writes = true
plc_addresses = ["127.0.0.1"]
[modbus.handshake]
heartbeat_required = false
[fusion]  # a busy machine shall not make a sensor fall silent
vision_deadline_s = 5.0
range_deadline_s = 5.0
"""


@pytest.mark.long
@pytest.mark.failure_mode("G4")
def test_a_truck_that_left_while_the_gateway_was_dead_is_stopped_and_reported(tmp_path: Path) -> None:
    settings, scenario, state = tmp_path / "settings.toml", tmp_path / "scenario.toml", tmp_path / "state"
    settings.write_text(SETTINGS.format(instance=f"restart-{os.getpid()}"))
    bay = ("--scenario", str(scenario), "--config", str(settings), "--state-dir", str(state), "--method", "paper")
    with Mosquitto(tmp_path) as broker, Subscriber(broker, "#") as scada:
        args = ("simulate", *bay, "--modbus-port", "0", "--json", "--mqtt-url", broker.url)
        scenario.write_text(AT_MARK)
        with Gateway(*args) as gateway:
            gateway.wait_for(lambda row: row["type"] == "state" and row["in_place"])
            gateway.wait_for(lambda row: row["type"] == "state" and kept_in(state))
            os.kill(gateway.process.pid, signal.SIGKILL)
            gateway.process.wait(10)
        scada.wait_for(lambda message: message.topic.endswith("/status") and message.json["status"] == "offline")

        scenario.write_text(LEFT)
        with Gateway(*args) as gateway:
            port = gateway.started()["modbus_port"]
            with Plc(port) as plc:
                plc.wait_for(lambda image: image["reason"] == Reason.MOVED)
                polls = plc.wait_for_beats(100)
                assert {poll.image["d"] for poll in polls} == {0}, "both sensors see it at 50 cm"
                last = plc.last
                assert (last["stop"], last["moved"], last["reason"]) == (1, 1, Reason.MOVED)
                assert last["visit_phase"] == VisitPhase.LEAVING
                shown = [poll.image for poll in plc.polls]
                assert {(image["stop"], image["may_move"], image["in_place"]) for image in shown} == {(1, 0, 0)}
                scada.wait_for(lambda message: message.topic.endswith("/state") and reported(message.json))
                write(port, 0)
                write(port, RESET)
                plc.wait_for(lambda image: (image["stop"], image["may_move"], image["moved"]) == (0, 1, 0))
            assert gateway.end() == 0
            told = [row for row in gateway.rows if row["type"] == "event"]
        assert [row["kind"] for row in told].count("moved") == 1
        assert "start: with a truck that was in place" in gateway.stderr
    assert not kept_in(state), "reset: it is not monitored any more"


def reported(state: dict[str, Any]) -> bool:
    return (state["stop"], state["moved"], state["reason"]["name"]) == (True, "DISTANCE", "MOVED")


def kept_in(folder: Path) -> bool:
    """Is a truck in the bay's file?"""
    return any("truck" in json.loads(path.read_bytes()) for path in folder.glob("bay.*.json"))


def write(port: int, bits: int) -> None:
    with ModbusTcpClient("127.0.0.1", port=port, timeout=5, retries=0) as client:
        assert not client.write_register(ADDRESS["plc_control"], bits, device_id=1).isError()
