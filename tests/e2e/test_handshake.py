"""The handshake as a PLC drives it over TLS: once with a real gateway and a broker, once with sensors in our hands."""

import asyncio
import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gateway.core.events import EventKind
from gateway.core.plc import Control, RecipeVerdict, ResetVerdict, TriggerOutcome
from gateway.core.state import GuidanceCode, Reason
from gateway.modbus.registers.handshake import HANDSHAKE_STATUS
from tests.e2e.brokers import Mosquitto, Subscriber
from tests.e2e.plc import Image, Plc
from tests.e2e.processes import Gateway
from tests.e2e.served_bay import ServedBay
from tests.e2e.test_modbus_tls import context_of
from tests.e2e.tls_plc import RefusedError, TlsPlc
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


def bay_of(plant: Plant) -> ServedBay:
    return ServedBay(
        {
            "modbus": {
                "writes": True,
                "port": 0,
                "tls": plant.config().model_dump(),
                "handshake": {"heartbeat_deadline_s": 20.0, "trigger_timeout_s": 20.0},
            },
            "fusion": {
                "decision": "plain",
                "latch_stop": True,
                "latch_leave_s": 0.0,
                "vision_deadline_s": 5.0,
                "range_deadline_s": 5.0,
            },
            "recipes": [{"id": 7, "name": "half way", "fusion": {"distance_threshold_mm": 150.0}}],
        }
    )


def test_neither_reset_nor_recipe_ends_a_stop(plant: Plant) -> None:
    bay = bay_of(plant)

    def shift(port: int) -> None:
        with TlsPlc(port, context_of(plant, "plc1")) as plc:

            def pulse(which: Control, wanted: Callable[[Image], bool]) -> Image:
                plc.control = 0
                plc.wait_for(lambda image: image["plc_control"] == 0)
                plc.control = 1 << which
                return plc.wait_for(wanted)

            pulse(Control.RESET, lambda image: image["may_move"] == 1)
            assert plc.wait_for(lambda image: image["closing_speed"] == 0)["guidance"] == GuidanceCode.SLOW

            bay.distance_mm = 250.0
            plc.wait_for(lambda image: image["reason"] == Reason.TARGET_REACHED)
            plc.recipe = 7
            still = plc.wait_for(lambda image: image["recipe_verdict"] == RecipeVerdict.STOP_STANDS)
            assert (still["stop"], still["recipe_active"]) == (1, 0)
            still = pulse(Control.RESET, lambda image: image["reset_verdict"] == ResetVerdict.CAUSE_STANDS)
            assert (still["stop"], still["may_move"]) == (1, 0)
            plc.wait_for(lambda image: image["guidance"] == GuidanceCode.OK)

            # One triggered measurement, acknowledged, and the next.
            for number in (1, 2):
                held = pulse(Control.TRIGGER, lambda image: bit(image, "results_valid"))
                assert (held["acquisition_id"], held["result_id"]) == (number, number)
                assert (held["result_outcome"], held["result_distance"]) == (TriggerOutcome.IN_PLACE, 250)
                pulse(Control.RESULTS_ACK, lambda image: not bit(image, "results_valid"))
            plc.control = 0
            plc.wait_for(lambda image: bit(image, "trigger_ready"))

            for pdu in (struct.pack(">BHH", 6, 4, 0), struct.pack(">BHHB2H", 16, 82, 2, 4, 0, 0)):
                with pytest.raises(RefusedError) as refused:
                    plc.ask(pdu)
                assert refused.value.args == (2,)

            bay.distance_mm = 900.0
            plc.wait_for(lambda image: image["reason"] == Reason.STOP_LATCHED)
            plc.wait_for(lambda image: image["d"] == 0)
            pulse(Control.RESET, lambda image: image["may_move"] == 1)
            plc.wait_for(lambda image: image["recipe_active"] == 7)
            bay.distance_mm = 250.0
            plc.wait_for(lambda image: image["distance"] == 250)
            assert plc.wait_for(lambda image: image["d"] == 0)["stop"] == 0, "this recipe stops at 150 mm"
            plc.control = 0

    async def scene() -> None:
        async with bay.open() as listening:
            assert listening.tls is not None
            await asyncio.get_running_loop().run_in_executor(None, shift, listening.tls)

    asyncio.run(scene())
    told: list[Any] = [(event.kind, event.detail) for event in bay.events.drain()]
    who = "127.0.0.1 (plc1, role operator)"
    assert (EventKind.WRITE_REFUSED, f"{who}: register 4 is read only") in told
    assert (EventKind.WRITE_REFUSED, f"{who}: register 83 is read only") in told
    assert (EventKind.PLC_WRITE, f"{who}: recipe_select 0 -> 7") in told
    assert (EventKind.RECIPE_CHANGED, "recipe 0 -> 7") in told
