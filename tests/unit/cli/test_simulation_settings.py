"""What a simulation makes of its settings and scenario can be sent to other processes, where it is checked again."""

import pytest

from gateway.cli.simulation import _at_speed, _variant
from gateway.config import BayConfig, CameraConfig, GatewayConfig
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
