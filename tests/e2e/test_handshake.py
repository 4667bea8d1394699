"""The handshake as a PLC drives it over TLS: once with a real gateway and a broker, once with sensors in our hands."""

import os
from pathlib import Path

import pytest

from gateway.core.plc import Control, ResetVerdict, TriggerOutcome
from gateway.core.state import Reason
from gateway.modbus.registers.handshake import HANDSHAKE_STATUS
from tests.e2e.brokers import Mosquitto, Subscriber
from tests.e2e.plc import Image, Plc
from tests.e2e.processes import Gateway
from tests.e2e.test_modbus_tls import context_of
from tests.e2e.tls_plc import TlsPlc
from tests.plant_certs import Plant

STANDING = "seed = 7\nduration_s = 600\nstart = { distance_cm = 60 }\n"
SETTINGS = """
instance = "{instance}"
[modbus]
port = 0
writes = true
[modbus.handshake]
heartbeat_deadline_s = 2.0
trigger_timeout_s = 20.0
[modbus.tls]
port = 0
cert = "{certs}/gateway.pem"
key = "{certs}/gateway.key"
ca = "{certs}/ca.pem"
[fusion]
latch_stop = true
vision_deadline_s = 5.0
range_deadline_s = 5.0
[fusion.cross_check]
focal_px = 600.0
marker_radius_mm = 90.0
[[recipes]]
id = 7
name = "half way"
fusion = {{ distance_threshold_mm = 150.0 }}
"""


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Plant:
    made = Plant(tmp_path_factory.mktemp("certs"))
    made.client("plc1", "operator")
    return made


def bit(image: Image, which: str) -> bool:
    return which in HANDSHAKE_STATUS.on(image["handshake_status"])


def test_a_real_gateway(plant: Plant, tmp_path: Path) -> None:
    (tmp_path / "scenario.toml").write_text(STANDING)
    (tmp_path / "settings.toml").write_text(
        SETTINGS.format(instance=f"handshake-{os.getpid()}", certs=plant.folder.path)
    )
    with (
        Mosquitto(tmp_path) as broker,
        Subscriber(broker, "#") as scada,
        Gateway(
            *("simulate", "--scenario", str(tmp_path / "scenario.toml"), "--config", str(tmp_path / "settings.toml")),
            *("--modbus-port", "0", "--json", "--mqtt-url", broker.url),
        ) as gateway,
    ):
        started = gateway.started()
        with Plc(started["modbus_port"]) as onlooker:
            onlooker.wait_for(lambda image: image["reason"] == Reason.PLC_LOST and image["may_move"] == 0, 60)
        with TlsPlc(started["modbus_tls_port"], context_of(plant, "plc1")) as plc:
            # It lives; the latch of the start stands until it is reset.
            latched = plc.wait_for(lambda image: image["reason"] == Reason.STOP_LATCHED, 60)
            assert bit(latched, "plc_alive")
            assert bit(latched, "stop_latched")
            plc.control = 1 << Control.RESET
            plc.wait_for(lambda image: image["reset_verdict"] == ResetVerdict.DONE and image["may_move"] == 1)
            plc.control = 0
            # One triggered measurement.
            plc.wait_for(lambda image: image["plc_control"] == 0)
            plc.control = 1 << Control.TRIGGER
            held = plc.wait_for(lambda image: bit(image, "results_valid"))
            assert (held["acquisition_id"], held["result_id"]) == (1, 1)
            assert held["result_outcome"] == TriggerOutcome.NOT_IN_PLACE
            assert 550 < held["result_distance"] < 650
            # Its program stops, its communication does not.
            plc.stand_still()
            plc.wait_for(lambda image: image["reason"] == Reason.PLC_LOST and image["may_move"] == 0)
            dropped = plc.wait_for(lambda image: bit(image, "plc_lost"))
            assert (dropped["result_id"], bit(dropped, "results_valid")) == (0, False)
        gateway.end()
        scada.wait_for(lambda message: message.topic.endswith("/status") and message.json["status"] == "offline")

        told = [message.json for message in scada.on("/event")]
        who = {"address": "127.0.0.1", "subject": "plc1", "role": "operator"}
        writes = [event["write"] for event in told if event["kind"] == "plc_write"]
        assert writes == [
            who | {"name": "plc_control", "old": old, "new": new} for old, new in ((0, 4), (4, 0), (0, 8))
        ]
        kinds = [event["kind"] for event in told]
        for kind in ("plc_returned", "latch_released", "plc_lost"):
            assert kind in kinds, kind
        assert len(kinds) < 40, "a heartbeat of 20 a second is no flood"
