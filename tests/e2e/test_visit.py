"""A truck's visit as a plant sees it: rendered frames, a real ranger's bytes, a Modbus client that we did not write."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from gateway.config import GatewayConfig, load
from gateway.core.plc import Control
from gateway.core.state import Moved, Reason, VisitPhase
from gateway.modbus.registers.position import POSITION_STATUS
from gateway.modbus.registers.register_map import REGISTERS
from tests.e2e.plc import Image, Plc, Poll
from tests.e2e.processes import Gateway, Row
from tests.visit_judge import Row as Judged
from tests.visit_judge import complaints

# The truck stands long enough at each place for a busy machine to see it; nothing of the lens is configured.
SETTINGS = """
instance = "visit-{process}"
[modbus]
port = 0
writes = true
plc_addresses = ["127.0.0.1"]
[modbus.handshake]
heartbeat_required = false
heartbeat_deadline_s = 10.0
[camera]
deadline_s = 5.0
[fusion]
vision_deadline_s = 3.0
range_deadline_s = 3.0
recovery_s = 0.2
"""
LOADING = """
seed = 81
duration_s = 600
start = {{ distance_cm = 80 }}
legs = [
  {{ distance_cm = 28, speed_cm_s = 20, hold_s = {stands_s} }},
  {{ distance_cm = 120, speed_cm_s = 30, hold_s = 500 }},
]
faults = [
  {{ kind = "spout_down", at_s = 14, for_s = {covered_s} }},
  {fault}
]
"""
LATE_S = 2.0
"""A busy machine's frames are late; nothing here is about how late."""
SERVER_BUSY = 6
ADDRESS = {register.name: register.address for register in REGISTERS}


class WritingPlc(Plc):
    """Its heartbeat counts, its control word is as it is set. What a gateway refuses in a stall is written again."""

    control = 0
    beat = 0

    def cycle(self) -> None:
        self.beat = (self.beat + 1) & 0xFFFF
        answer = self.client.write_registers(ADDRESS["plc_heartbeat"], [self.beat, self.control], device_id=1)
        assert not answer.isError() or answer.exception_code == SERVER_BUSY, answer


@contextmanager
def bay(folder: Path, *, stands_s: float, covered_s: float, fault: str) -> Iterator[tuple[Gateway, int]]:
    (folder / "settings.toml").write_text(SETTINGS.format(process=os.getpid()))
    (folder / "scenario.toml").write_text(LOADING.format(stands_s=stands_s, covered_s=covered_s, fault=fault))
    with Gateway(
        *("simulate", "--scenario", str(folder / "scenario.toml"), "--config", str(folder / "settings.toml")),
        *("--modbus-port", "0", "--json"),
    ) as gateway:
        yield gateway, gateway.started()["modbus_port"]


def bits(image: Image) -> set[str]:
    return POSITION_STATUS.on(int(image["position_status"]))


def judged(gateway: Gateway, config: GatewayConfig) -> list[str]:
    states: list[Row] = [row for row in gateway.rows if row["type"] == "state"]
    assert len(states) > 100
    return complaints([Judged.of_json(row) for row in states], config, late_s=LATE_S)


def never_together(polls: list[Poll]) -> None:
    for poll in polls:
        image = poll.image
        assert not (image["stop"] and image["may_move"]), image
        assert not (image["in_place"] and not image["stop"]), image
        assert bits(image) >= {"in_place"} or not image["in_place"]


def ended(gateway: Gateway, folder: Path) -> list[str]:
    """The events of a visit, in their order; what the gateway said must have been so."""
    gateway.end()
    gateway.finish()
    assert judged(gateway, load(folder / "settings.toml")) == []
    kinds = [row["kind"] for row in gateway.rows if row["type"] == "event"]
    return [kind for kind in kinds if kind in ("in_place", "in_place_ended", "moved", "released", "visit_ended")]


@pytest.mark.long
def test_a_truck_is_loaded_with_its_marker_covered_and_leaves_when_the_plc_lets_it(tmp_path: Path) -> None:
    # The dust has settled before the spout lifts at 37 s: through dust a part of the marker may pass for a smaller one.
    dust = '{ kind = "dust_cloud", at_s = 16, for_s = 16 },'
    with bay(tmp_path, stands_s=40, covered_s=24, fault=dust) as (gateway, port):
        with Plc(port) as plc, WritingPlc(port, period_s=0.1) as master:
            plc.wait_for(lambda image: image["visit_phase"] == VisitPhase.IN_PLACE, 60)
            held = plc.wait_for(lambda image: image["visit_phase"] == VisitPhase.HELD, 60)
            loading = plc.wait_for(lambda image: (image["held_time"] or 0) >= 8, 60)
            during = [poll.image for poll in plc.polls if held.asked_s <= poll.asked_s <= loading.asked_s]
            assert all(image["in_place"] and image["stop"] and not image["may_move"] for image in during)
            assert bits(loading.image) == {"in_place", "held"}
            assert loading.image["radius"] is None
            assert loading.image["distance"] is not None

            master.control = 1 << Control.RELEASE
            released = plc.wait_for(lambda image: image["may_move"] == 1, 30).image
            assert (released["in_place"], released["stop"], released["reason"]) == (0, 0, Reason.NONE)
            assert "released" in bits(released)
            left = plc.wait_for(lambda image: (image["distance"] or 0) > 1050, 90)
            plc.wait_for(lambda image: "released" not in bits(image), 60)
        on_its_way = [poll.image for poll in plc.polls if poll.asked_s <= left.asked_s]
        assert {image["moved"] for image in on_its_way} == {Moved.NO}
        never_together(plc.polls)
        assert ended(gateway, tmp_path) == ["in_place", "in_place_ended", "released", "visit_ended"]


@pytest.mark.long
def test_a_red_lamp_before_the_covered_marker_is_polled_as_a_stop_every_time(tmp_path: Path) -> None:
    """Z says 28 cm all along. By equation 14 alone, 175 of 281 polls said that the truck may move."""
    lamp = '{ kind = "red_lamp", at_s = 17, for_s = 500 },'
    with bay(tmp_path, stands_s=500, covered_s=500, fault=lamp) as (gateway, port):
        with Plc(port) as plc:
            plc.wait_for(lambda image: image["in_place"] == 1, 60)
            begun = len(plc.polls)
            lit = plc.wait_for(lambda image: image["radius"] is not None and image["radius"] < 30, 60)
            assert lit.image["distance"] is not None
            plc.wait_for(lambda image: image["reason"] == Reason.SENSORS_DISAGREE, 30)
            plc.wait_for(lambda image: image["in_place"] == 0, 30)
            enough = len(plc.polls) + 300
            plc.wait_for(lambda _: len(plc.polls) > enough, 60)
        polls = plc.polls[begun:]
        assert [poll.image for poll in polls if not poll.image["stop"] or poll.image["may_move"]] == []
        assert sum(poll.image["radius"] is not None and poll.image["radius"] < 30 for poll in polls) > 250
        assert ended(gateway, tmp_path) == ["in_place", "in_place_ended"]
