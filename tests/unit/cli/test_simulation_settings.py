"""What a simulation makes of its settings and scenario can be sent to other processes, where it is checked again."""

import argparse
import socket

import pytest

from gateway.cli import simulate
from gateway.cli.simulation import _at_speed, _scenario, _settings, _variant
from gateway.cli.simulation import simulate as run
from gateway.config import BayConfig, CameraConfig, GatewayConfig
from gateway.errors import ConfigError, LinkError
from gateway.processes.codec import Codec, record_of, record_packed
from gateway.sim.scenario import Scenario


@pytest.mark.parametrize("speed", [2.0, 20.0])
def test_a_fast_world_keeps_every_limit_within_its_range(speed: float) -> None:
    slow = GatewayConfig(bays=(BayConfig(camera=CameraConfig(deadline_s=10.0)),))
    fast = _at_speed(slow, speed)
    camera, vision = fast.bays[0].camera, fast.bays[0].vision
    assert (camera.deadline_s, camera.open_deadline_s, vision.deadline_s) == (
        (20.0, 20.0, 4.0) if speed == 2.0 else (60.0, 120.0, 40.0)
    )
    assert Codec(GatewayConfig).unpacked(Codec.packed(fast)) == fast


def test_the_trucks_of_many_bays_are_scenarios_too() -> None:
    last = Scenario(seed=2**31, bay="bay1")
    other = _variant(last, "bay7", 6, 64)
    assert other.seed == 6
    assert record_of(Scenario, record_packed(other)) == other


@pytest.mark.parametrize(
    ("options", "ports"), [([], (0, 0)), (["--modbus-port", "5021"], (5021, 0)), (["--hmi-port", "8081"], (0, 8081))]
)
def test_where_the_usual_ports_are_taken_free_ones_are_used(
    options: list[str], ports: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Unless somebody has said which: that one is waited for."""

    def taken(*_: object) -> socket.socket:
        raise LinkError("another program listens there already")

    monkeypatch.setattr("gateway.cli.simulation.listening", taken)
    parser = argparse.ArgumentParser()
    simulate.configure(parser)
    found = _settings(parser.parse_args(options), first=True)
    assert (found.modbus.port, found.hmi.port) == ports


@pytest.mark.parametrize(("options", "why"), [(["--trials", "2"], "leave out --trials"), (["--bays", "2"], "2 bays")])
def test_one_drive_moves_one_vehicle(options: list[str], why: str) -> None:
    parser = argparse.ArgumentParser()
    simulate.configure(parser)
    with pytest.raises(ConfigError, match=why):
        run(parser.parse_args(["--vehicle", "winch", "--modbus-port", "0", "--no-hmi", *options]))


@pytest.mark.parametrize(("options", "lateral_mm"), [([], 0.0), (["--scenario", "approach"], -40.0)])
def test_a_vehicle_drives_straight_on_to_where_it_is_in_place(options: list[str], lateral_mm: float) -> None:
    parser = argparse.ArgumentParser()
    simulate.configure(parser)
    start = _scenario(parser.parse_args(["--vehicle", "winch", *options])).start
    assert (start.distance_cm, start.lateral_mm) == (150.0, lateral_mm)
