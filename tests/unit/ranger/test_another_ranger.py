"""A ranger from outside the package: a laser that sends `D 250.0` lines. docs/extending.md walks through it."""

import asyncio
import threading
from dataclasses import replace
from importlib.metadata import EntryPoint

import pytest

from gateway import config_check, registry
from gateway.alarms.bay_alarms import BAY_ALARMS
from gateway.alarms.definition import BayInputs
from gateway.bay import BayControl
from gateway.clock import SystemClock
from gateway.config import BayConfig, BayRangerConfig, GatewayConfig, RangerConfig, parse
from gateway.config.sections.ranger import RANGERS
from gateway.core import interlock
from gateway.core.detection import Circle
from gateway.core.readings import Quality, RangeReading, RangeStats, VisionReading
from gateway.core.state import Tick
from gateway.errors import ConfigError, LinkError
from gateway.hub import Hub
from gateway.ranger.conditioning import Conditioner
from gateway.ranger.contract import RangerType
from gateway.ranger.ranger_service import RangerService, check_port
from gateway.supervisor import Supervisor, Task

MS = 1_000_000
CYCLE_NS = 10 * MS


class LaserSession:
    """One distance a line. Gate, median, counters and repeated faults come from the shared Conditioner."""

    def __init__(self, config: RangerConfig) -> None:
        self._conditioner = Conditioner(config, CYCLE_NS)
        self._seq = 0
        self.identity = ""

    @property
    def stats(self) -> RangeStats:
        return self._conditioner.stats

    def opened(self, now_ns: int) -> list[RangeReading]:
        self._conditioner.opened()
        return self._conditioner.fault(Quality.WAITING, now_ns, self._seq, "waiting for the laser")

    def request(self, now_ns: int) -> bytes:
        return b"" if self.identity else b"*IDN?\n"

    def feed(self, data: bytes, arrived_ns: int) -> list[RangeReading]:
        readings: list[RangeReading] = []
        for line in data.splitlines():
            kind, _, value = line.decode().partition(" ")
            if kind == "I":
                self.identity = value
            elif kind == "D":
                self._seq += 1
                self._conditioner.arrived(arrived_ns)
                self._conditioner.count(lines=1)
                quality = Quality.NO_ECHO if value == "-" else Quality.GOOD
                readings += self._conditioner.measured(
                    0.0 if value == "-" else float(value), quality, arrived_ns, self._seq
                )
            else:
                self._conditioner.count(damaged=1)
        return readings

    def tick(self, now_ns: int) -> list[RangeReading]:
        self._conditioner.update_rate(now_ns)
        return []

    def lost(self, now_ns: int, detail: str) -> RangeReading:
        return self._conditioner.lost(now_ns, detail)


class LaserPort:
    """In memory. What it was sent is in `requests`; while `text` is None the cable is pulled."""

    text: bytes | None = b"D 250.0\n"
    requests: list[bytes]

    def __init__(self, config: RangerConfig) -> None:
        if LaserPort.text is None:
            raise LinkError(f"{config.port}: no such laser")
        LaserPort.requests = []
        self._answer = b"I acme-7\n?\n"

    def read(self) -> bytes:
        threading.Event().wait(0.005)
        if LaserPort.text is None:
            raise LinkError("laser lost")
        answer, self._answer = self._answer, b""
        return answer + LaserPort.text

    def write(self, data: bytes) -> None:
        LaserPort.requests.append(data)

    def close(self) -> None:
        pass


def check_laser(url: str) -> None:
    if not url.startswith("laser:"):
        raise ConfigError(f"{url}: not a laser")


LASER = RangerType(LaserSession, LaserPort, check_laser, max_range_mm=lambda _: 10_000.0)


@pytest.fixture(autouse=True)
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if a distribution with this entry point were installed."""
    point = EntryPoint("laser", f"{__name__}:LASER", RANGERS.group)
    monkeypatch.setattr(registry, "entry_points", lambda group: (point,) if group == RANGERS.group else ())
    LaserPort.text = b"D 250.0\n"


def test_its_readings_arrive_in_the_fused_state_and_its_loss_withdraws_them() -> None:
    laser = {"type": "laser", "port": "laser:1", "reconnect": {"min_s": 0.01, "max_s": 0.05}}
    config = parse({"ranger": laser, "fusion": {"recovery_s": 0}})

    async def main(bay_config: GatewayConfig) -> None:
        clock, (bay,) = SystemClock(), bay_config.bays
        hub = Hub([bay.name])
        control = BayControl(bay, hub, clock)
        service = RangerService(bay.ranger, clock, control.on_reading)
        tasks = [Task("control", control.run), Task("ranger", service.run, bay.ranger.reconnect)]

        async def until(quality: Quality) -> RangeReading:
            seq = 0
            async with asyncio.timeout(20):
                while (reading := hub.shown(bay.name, clock.now_ns()).range).quality is not quality:
                    seq = await hub.newer(bay.name, seq)
            return reading

        async with asyncio.TaskGroup() as group:
            running = group.create_task(Supervisor(tasks, clock).run())
            good = await until(Quality.GOOD)
            assert good.distance_mm == 250.0
            assert (good.stats.damaged, good.stats.reopens) == (1, 0)  # the line with `?`
            assert LaserPort.requests == [b"*IDN?\n"]
            assert service.session.identity == "acme-7"
            LaserPort.text = b"D -\n"
            assert (await until(Quality.NO_ECHO)).distance_mm is None
            LaserPort.text = None
            down = await until(Quality.LINK_DOWN)
            assert (down.distance_mm, down.detail) == (None, "laser lost")
            LaserPort.text = b"D 300.0\n"
            assert (await until(Quality.GOOD)).stats.reopens == 1
            running.cancel()

    asyncio.run(main(config))


@pytest.mark.parametrize(("radius_px", "moves"), [(6.0, True), (6.01, False)])
def test_a_truck_arrives_by_the_camera_beyond_its_own_range(radius_px: float, moves: bool) -> None:
    """At 9 m by R Z = 54,000; an HC-SR04's range would let a truck move from 3.6 m on."""
    rules = interlock.Rules.of(BayConfig(ranger=BayRangerConfig(type="laser", port="laser:1")))
    state = interlock.initial("bay1", 0, rules)
    for now_ns in range(20 * MS, 2000 * MS, 20 * MS):
        seen = VisionReading(now_ns, Quality.GOOD, Circle(320, 240, radius_px))
        for observation in (seen, RangeReading(now_ns, Quality.NO_ECHO), Tick()):
            state = interlock.step(state, observation, now_ns, rules)
    assert state.may_move is moves


def test_where_its_range_is_not_known_an_echo_is_due_as_with_an_hcsr04(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(RANGERS._loaded, "laser", RangerType(LaserSession, LaserPort, check_laser))
    bay = BayConfig(ranger=BayRangerConfig(type="laser", port="laser:1"))
    rules = interlock.Rules.of(bay)
    state = interlock.initial("bay1", 0, rules)
    for reading in (VisionReading(1, Quality.GOOD, Circle(320, 240, 22.0)), RangeReading(1, Quality.NO_ECHO)):
        state = interlock.step(state, reading, 1, rules)
    (alarm,) = (alarm for alarm in BAY_ALARMS if alarm.id == "ranger_no_echo")
    assert alarm.condition(BayInputs(state, bay))  # 54,000 / 22 = 2455 mm
    assert not alarm.condition(BayInputs(replace(state, z_vision_mm=2600.0), bay))


def test_a_distance_that_it_cannot_measure_is_a_fault() -> None:
    laser = {"type": "laser", "port": "laser:1"}
    near = parse({"ranger": laser, "fusion": {"distance_threshold_mm": 10_000}})
    config_check.check(near, source="bay.toml", text="")
    far = parse({"ranger": laser, "recipes": [{"id": 1, "name": "far", "fusion": {"distance_threshold_mm": 10_001}}]})
    with pytest.raises(ConfigError, match="of bay 'bay1' \\(laser\\) measures up to 10000 mm"):
        config_check.check(far, source="bay.toml", text="")


def test_the_registry_lists_it_and_refuses_what_it_does_not_know() -> None:
    assert RANGERS.names() == ("hcsr04", "modbus", "ascii", "laser")
    with pytest.raises(ConfigError, match=r"ranger\.type = \"sonar\": .*'hcsr04', 'modbus', 'ascii' or 'laser'"):
        parse({"bays": [{"ranger": {"type": "sonar"}}]})
    with pytest.raises(ConfigError, match="no ranger is called 'sonar'; there is: hcsr04, modbus, ascii, laser"):
        RANGERS.load("sonar")


def test_its_port_is_checked_by_its_own_function() -> None:
    with pytest.raises(ConfigError, match="/dev/ttyACM0: not a laser"):
        check_port(RangerConfig(type="laser"))
    check_port(RangerConfig(type="laser", port="laser:1"))
