"""The handshake as a PLC drives it: a real gateway over a simulated bay, TLS with a role, events at a real broker."""

import os
import struct
from pathlib import Path

import pytest

from gateway.modbus.block import HandshakeBit
from gateway.model import GuidanceCode, Reason
from gateway.plc import Control, Outcome, RecipeVerdict, ResetVerdict
from tests.e2e.brokers import Mosquitto, Subscriber
from tests.e2e.plc import Plc
from tests.e2e.processes import Gateway
from tests.e2e.test_modbus_tls import context_of
from tests.e2e.tls_plc import Image, RefusedError, TlsPlc
from tests.plant_certs import Plant

SCENARIO = """
seed = 7
duration_s = 600
start = { distance_cm = 60 }
legs = [
  { distance_cm = 60, hold_s = 9 },
  { distance_cm = 24, speed_cm_s = 20, hold_s = 6 },
  { distance_cm = 60, speed_cm_s = 30, hold_s = 500 },
]
"""
SETTINGS = """
instance = "{instance}"
[modbus]
port = 0
writes = true
[modbus.handshake]
heartbeat_deadline_s = 2.0
trigger_timeout_s = 10.0
[modbus.tls]
port = 0
cert = "{certs}/gateway.pem"
key = "{certs}/gateway.key"
ca = "{certs}/ca.pem"
[fusion]
latch_stop = true
vision_deadline_s = 2.0
range_deadline_s = 2.0
[fusion.cross_check]
focal_px = 600.0
marker_radius_mm = 90.0
[guidance]
aim_u_px = 319.5
tolerance_px = 60.0
[[recipes]]
id = 7
name = "half way"
fusion = {{ distance_threshold_mm = 150.0 }}
"""


def bit(image: Image, which: HandshakeBit) -> bool:
    return bool(image["handshake_status"] >> which & 1)


def test_a_shift_of_the_plc(tmp_path: Path) -> None:
    plant = Plant(tmp_path / "certs")
    plant.client("plc1", "operator")
    (tmp_path / "scenario.toml").write_text(SCENARIO)
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
            onlooker.wait_for(lambda image: image["reason"] == Reason.PLC_LOST and image["permit"] == 0)

            with TlsPlc(started["modbus_tls_port"], context_of(plant, "plc1")) as plc:
                # It lives; the latch of the start stands until it is reset.
                latched = plc.wait_for(lambda image: image["reason"] == Reason.STOP_LATCHED)
                assert bit(latched, HandshakeBit.PLC_ALIVE)
                assert bit(latched, HandshakeBit.STOP_LATCHED)
                plc.control = 1 << Control.RESET
                plc.wait_for(lambda image: image["reset_verdict"] == ResetVerdict.DONE and image["permit"] == 1)
                plc.control = 0
                on_its_way = plc.wait_for(lambda image: image["guidance"] in (GuidanceCode.FORWARD, GuidanceCode.SLOW))
                assert on_its_way["distance_to_go"] > 0

                # One triggered measurement.
                plc.control = 1 << Control.TRIGGER
                held = plc.wait_for(lambda image: bit(image, HandshakeBit.RESULTS_VALID))
                assert (held["acquisition_id"], held["result_id"]) == (1, 1)
                assert held["result_outcome"] == Outcome.NOT_IN_PLACE
                assert 550 < held["result_distance"] < 650
                plc.control = 1 << Control.RESULTS_ACK
                plc.wait_for(lambda image: not bit(image, HandshakeBit.RESULTS_VALID))
                plc.control = 0
                plc.wait_for(lambda image: bit(image, HandshakeBit.TRIGGER_READY))

                # What is not the PLC's to write.
                for pdu in (struct.pack(">BHH", 6, 4, 0), struct.pack(">BHHB2H", 16, 82, 2, 4, 0, 0)):
                    with pytest.raises(RefusedError) as refused:
                        plc.ask(pdu)
                    assert refused.value.args == (2,)

                # In place: neither reset nor recipe ends the stop.
                plc.wait_for(lambda image: image["reason"] == Reason.TARGET_REACHED)
                plc.control, plc.recipe = 1 << Control.RESET, 7
                plc.wait_for(lambda image: image["reset_verdict"] == ResetVerdict.CAUSE_STANDS)
                still = plc.wait_for(lambda image: image["recipe_verdict"] == RecipeVerdict.STOP_STANDS)
                assert (still["stop"], still["recipe_active"]) == (1, 0)
                plc.control = 0

                # It backs off: latched until reset; then the recipe is taken.
                plc.wait_for(lambda image: image["reason"] == Reason.STOP_LATCHED, timeout_s=60)
                plc.control = 1 << Control.RESET
                plc.wait_for(lambda image: image["permit"] == 1 and image["recipe_active"] == 7)

                # Its program stops, its communication does not.
                plc.stand_still()
                plc.wait_for(lambda image: image["reason"] == Reason.PLC_LOST and image["permit"] == 0)
        gateway.end()
        scada.wait_for(lambda message: message.topic.endswith("/status") and message.json["status"] == "offline")

        told = [message.json for message in scada.on("/event")]
        writes = [event["write"] for event in told if event["kind"] == "plc_write"]
        who = {"address": "127.0.0.1", "subject": "plc1", "role": "operator"}
        assert writes[0] == who | {"name": "plc_control", "old": 0, "new": 1 << Control.RESET}
        assert who | {"name": "recipe_select", "old": 0, "new": 7} in writes
        kinds = [event["kind"] for event in told]
        for kind in ("plc_returned", "latch_released", "recipe_changed", "write_refused", "plc_lost"):
            assert kind in kinds, kind
        assert len(kinds) < 60, "a heartbeat of 20 a second is no flood"
