"""The speed setpoint: a vehicle in virtual time that follows it, and when it must be 0."""

import random
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import pytest

from gateway.config import GatewayConfig, parse
from gateway.core import interlock
from gateway.core.detection import Circle
from gateway.core.interlock import Rules
from gateway.core.motion import DriveMemory
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.setpoint import DriveState, Setpoint
from gateway.core.state import StateVector, Tick

MS = 1_000_000
T0 = 1_000_000_000_000
PX_MM = 54_000.0
PLACE_MM = 290.0  # Z_th 300, R_th 178 px at 303 mm, place_mm 10


def config(drive: Mapping[str, Any] | None = None, **sections: Any) -> GatewayConfig:
    return parse({"fusion": {"radius_threshold_px": 178.0}, "drive": drive or {}} | sections)


def rules(drive: Mapping[str, Any] | None = None) -> Rules:
    made = config(drive)
    return Rules.of(made.bays[0], made)


@dataclass
class Vehicle:
    """Follows the setpoint `lag_s` late and within its brake; a ranger with steps, noise and a median sees it, and a
    camera."""

    rules: Rules
    at_mm: float
    lag_s: float = 0.5
    brake_mm_s2: float = 150.0
    seed: int = 1
    poll_ms: int = 100
    follows: bool = True
    drops: float = 0.02
    now_ms: int = 0
    speed_mm_s: float = 0.0
    nearest_mm: float = field(init=False)
    states: list[StateVector] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.chance = random.Random(self.seed)
        self.state = interlock.initial("bay1", T0, self.rules)
        self.polled: deque[tuple[int, float]] = deque([(0, 0.0)])
        self.echoes: deque[tuple[int, float]] = deque(maxlen=3)
        self.coming: list[tuple[int, RangeReading | VisionReading]] = []
        self.nearest_mm = self.at_mm

    @property
    def now_ns(self) -> int:
        return T0 + self.now_ms * MS

    def runs(self, seconds: float) -> None:
        for _ in range(round(seconds * 50)):
            self._step()

    def _step(self) -> None:
        while len(self.polled) > 1 and self.polled[1][0] <= self.now_ms - self.lag_s * 1000:
            self.polled.popleft()
        told = self.polled[0][1] if self.polled[0][0] <= self.now_ms - self.lag_s * 1000 else 0.0
        if self.follows:
            rise = (told - self.speed_mm_s) / 0.15
            self.speed_mm_s += max(-self.brake_mm_s2, min(120.0, rise)) * 0.02
            if told == 0 and self.speed_mm_s < 0.5:
                self.speed_mm_s = 0.0
        self.at_mm -= self.speed_mm_s * 0.02
        self.nearest_mm = min(self.nearest_mm, self.at_mm)
        if self.now_ms % 60 == 0 and self.chance.random() >= self.drops:
            self.echoes.append((self.now_ns, round((self.at_mm + self.chance.gauss(0, 1.5)) / 4) * 4.0))
            if len(self.echoes) == 3:
                middle_mm = sorted(mm for _, mm in self.echoes)[1]
                self.coming.append((40, RangeReading(self.echoes[1][0], Quality.GOOD, middle_mm)))
        if self.now_ms % 80 == 0:
            circle = Circle(320.0, 240.0, PX_MM / self.at_mm + self.chance.gauss(0, 0.3))
            self.coming.append((60, VisionReading(self.now_ns, Quality.GOOD, circle)))
        due = [seen for left, seen in self.coming if left <= 0]
        self.coming = [(left - 20, seen) for left, seen in self.coming if left > 0]
        for seen in [*due, Tick()]:
            self.state = interlock.step(self.state, seen, self.now_ns, self.rules)
            self.states.append(self.state)
        if self.now_ms % self.poll_ms == 0:
            self.polled.append((self.now_ms, self.state.setpoint.speed_mm_s))
        self.now_ms += 20


@pytest.mark.one_interpreter
@pytest.mark.parametrize(("lag_s", "at_mm"), [(0.5, 1500.0), (0.15, 900.0), (1.0, 700.0)])
def test_a_vehicle_comes_to_its_place_without_passing_it(lag_s: float, at_mm: float) -> None:
    vehicle = Vehicle(rules({"lag_s": max(0.5, lag_s)}), at_mm, lag_s)
    vehicle.runs(20 if lag_s < 1 else 30)
    assert vehicle.state.setpoint.state is DriveState.AT_PLACE
    assert vehicle.state.in_place
    assert abs(vehicle.at_mm - PLACE_MM) <= 10.0
    assert vehicle.nearest_mm >= PLACE_MM - 10.0
    assert max(state.setpoint.speed_mm_s for state in vehicle.states) > 100.0


def test_without_a_drive_there_is_no_setpoint() -> None:
    made = parse({"fusion": {"radius_threshold_px": 178.0}})
    vehicle = Vehicle(Rules.of(made.bays[0], made), 900.0)
    vehicle.runs(2)
    assert vehicle.state.may_move
    assert {state.setpoint for state in vehicle.states} == {Setpoint()}
    assert {state.memory.drive for state in vehicle.states} == {DriveMemory()}
