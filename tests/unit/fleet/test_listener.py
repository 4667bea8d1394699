"""What the fleet page's process makes of messages and of time."""

import asyncio
from dataclasses import dataclass
from typing import Any, cast

import pytest

from gateway.fleet.config import FleetConfig
from gateway.fleet.listener import Listener
from gateway.fleet.roster import GatewayLife, Roster
from gateway.sinks.mqtt.topics import MqttMessage
from tests.unit.fleet.stores import MemoryStore
from tests.unit.fleet.test_roster import KEY, TOPIC, status
from tests.virtual_time import HandClock

CONFIG = FleetConfig.model_validate({"mqtt": {"url": "mqtt://broker"}, "hmi": {"without_login": "viewer"}})


@dataclass
class SetClock(HandClock):
    """Its Unix time can be set."""

    ahead_ns: int = 1_700_000_000_000_000_000

    def wall_ns(self) -> int:
        return self.t_ns + self.ahead_ns


def listening() -> tuple[Listener, SetClock]:
    clock = SetClock()
    return Listener(CONFIG, Roster(), MemoryStore(), clock), clock


def hear(listener: Listener, payload: bytes, *, retained: bool = False) -> None:
    asyncio.run(listener._received(cast("Any", None), MqttMessage(TOPIC, payload, retained)))


@pytest.mark.parametrize("step_s", [-3600, -20, 20, 3600])
def test_a_clock_that_is_set_makes_nothing_fresh_and_nothing_silent(step_s: int) -> None:
    listener, clock = listening()
    hear(listener, status(1))
    hear(listener, status(2))
    heard_ms = listener.roster.known[KEY].heard_ms
    assert heard_ms == 1_700_000_010_000
    clock.ahead_ns += step_s * 1_000_000_000
    assert listener.roster.life(KEY, listener.now_ms()) is GatewayLife.ONLINE
    assert listener.roster.known[KEY].heard_ms == heard_ms + 1000 * step_s
    clock.t_ns += 30_001_000_000
    assert listener.roster.life(KEY, listener.now_ms()) is GatewayLife.SILENT
    assert listener.now_ms() == clock.wall_ns() // 1_000_000


@pytest.mark.parametrize("retained", [True, False])
def test_whether_the_broker_had_kept_it_counts(retained: bool) -> None:
    listener, _ = listening()
    hear(listener, status(1))
    hear(listener, status(2), retained=retained)
    life = listener.roster.life(KEY, listener.now_ms())
    assert life is (GatewayLife.SILENT if retained else GatewayLife.ONLINE)
