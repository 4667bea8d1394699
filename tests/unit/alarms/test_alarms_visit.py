"""Which alarms a visit raises, played as the interlock sees it: a truck comes, is loaded, and leaves or moves."""

from dataclasses import dataclass, field
from typing import Self

import pytest

from gateway.alarms.engine import AlarmEngine
from gateway.alarms.records import AlarmChange
from gateway.alarms.states import AlarmState
from gateway.config import BayConfig, FusionConfig, GatewayConfig, ModbusConfig, VisitConfig
from gateway.core import interlock
from gateway.core.detection import Circle
from gateway.core.fusion import Observation
from gateway.core.plc import Control, PlcWrite, Writer
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.retained import RetainedState
from gateway.core.scale import ScaleSample
from gateway.core.state import FunctionCheck, GuidanceCode, Moved, StateVector, Tick

MS = 1_000_000
STEP_MS = 50
PLC = Writer("10.0.0.1", "", "")


@dataclass
class Bay:
    """One bay and its alarms. Distances in mm; R is that of a marker with R Z = 56 000."""

    writes: bool = False
    visit: VisitConfig = field(default_factory=VisitConfig)
    retained: RetainedState = field(default_factory=RetainedState)
    px_mm: float = 56_000.0

    def __post_init__(self) -> None:
        bay = BayConfig(fusion=FusionConfig(recovery_s=0.2, clear_hold_s=0.2), visit=self.visit)
        modbus = ModbusConfig(writes=self.writes, plc_addresses=("10.0.0.1",))
        gateway = GatewayConfig(bays=(bay,), modbus=modbus)
        self.rules = interlock.Rules.of(bay, gateway)
        self.now_ns = 1_000_000 * MS
        self.state: StateVector = interlock.initial("bay1", self.now_ns, self.rules, self.retained)
        self.engine = AlarmEngine({"bay1": bay})
        self.changes: list[AlarmChange] = []
        self.beat = 0

    def see(self, seconds: float, start_mm: float | None, end_mm: float | None = None, *, marker: bool = True) -> None:
        """The truck goes from one distance to the other. None: no echo. `marker` False: it is covered."""
        end_mm = start_mm if end_mm is None else end_mm
        steps = round(1000 * seconds / STEP_MS)
        for n in range(1, steps + 1):
            self.now_ns += STEP_MS * MS
            z = None if start_mm is None or end_mm is None else start_mm + (end_mm - start_mm) * n / steps
            seen = marker and z is not None
            circle = Circle(320, 240, self.px_mm / z) if seen and z is not None else None
            quality = Quality.GOOD if seen else Quality.NO_TARGET
            self.step(VisionReading(self.now_ns, quality, circle))
            self.step(RangeReading(self.now_ns, Quality.GOOD if z is not None else Quality.NO_ECHO, z))
            self.step(Tick())
            if self.writes:
                self.beat = (self.beat + 1) % 65536
                self.step(PlcWrite(PLC, heartbeat=self.beat, control=0 if self.beat == 1 else None))
            self.changes += self.engine.update_bay(self.state, self.now_ns)

    def step(self, observation: Observation) -> None:
        self.state = interlock.step(self.state, observation, self.now_ns, self.rules)

    def comes_to_stand(self) -> None:
        self.see(4, 1200, 280)
        self.see(3, 280)
        assert self.state.in_place

    def loads(self, seconds: float = 20) -> None:
        self.see(seconds, 280, marker=False)
        assert self.state.visit.held

    def leaves(self) -> None:
        self.see(3, 280, 1500)
        self.see(5, None)
        assert self.state.visit.place is None

    def loaded(self) -> Self:
        """A truck has come, stands in place, and is being loaded under the spout."""
        self.comes_to_stand()
        self.loads()
        return self

    @property
    def newest(self) -> AlarmChange:
        return [change for change in self.changes if change.after is AlarmState.UNACKNOWLEDGED][-1]

    @property
    def announced(self) -> list[str]:
        return [change.id for change in self.changes if change.after is AlarmState.UNACKNOWLEDGED]


@pytest.mark.long
@pytest.mark.one_interpreter
def test_a_visit_without_writes_raises_no_alarm() -> None:
    """Nobody can release a truck there: every departure is a move."""
    bay = Bay()
    for _ in range(2):
        bay.comes_to_stand()
        bay.loads()
        bay.see(2, 280)  # spout up
        bay.see(3, 280, 1500)
        assert (bay.state.visit.moved, bay.state.visit.moved_covered) == (Moved.DISTANCE, False)
        bay.see(5, None)
    assert bay.announced == []


@pytest.mark.one_interpreter
def test_a_visit_that_the_plc_releases_raises_no_alarm() -> None:
    bay = Bay(writes=True).loaded()
    bay.see(2, 280)
    bay.step(PlcWrite(PLC, control=1 << Control.RELEASE))
    assert bay.state.visit.released
    bay.leaves()
    assert bay.announced == []


@pytest.mark.one_interpreter
def test_with_writes_a_truck_that_leaves_unreleased_has_moved() -> None:
    bay = Bay(writes=True).loaded()
    bay.see(2, 280)
    bay.leaves()
    assert bay.announced == ["bay1.truck_rolling", "bay1.truck_moved"]
    assert bay.newest.detail.startswith("the distance left its band; in place at 280 mm, now 3")
    bay.see(5, None)
    assert {alarm.state for alarm in bay.engine.summary().alarms} == {
        AlarmState.RETURNED
    }  # gone, but somebody must have a look


@pytest.mark.one_interpreter
@pytest.mark.parametrize("way_mm", [-60.0, 60.0])
def test_a_truck_that_rolls_under_the_spout_is_reported_at_once(way_mm: float) -> None:
    bay = Bay().loaded()
    begun_ns = bay.now_ns
    bay.see(0.8, 280, 280 + way_mm * 0.8 / 3, marker=False)
    assert bay.announced == ["bay1.truck_rolling"]
    assert bay.newest.detail.startswith("by range; it stood at 2")
    assert bay.state.guidance.code is GuidanceCode.BRAKE
    bay.see(2.2, 280 + way_mm * 0.8 / 3, 280 + way_mm, marker=False)
    assert bay.announced == ["bay1.truck_rolling", "bay1.truck_moved"]
    assert (bay.newest.t_ns - begun_ns) / 1e9 == pytest.approx(2.05, abs=0.06)  # 40 mm at 20 mm/s
    assert bay.state.stop


@pytest.mark.one_interpreter
def test_a_truck_seen_elsewhere_when_the_spout_goes_up_has_moved_under_it() -> None:
    bay = Bay().loaded()
    bay.now_ns += STEP_MS * MS
    bay.step(VisionReading(bay.now_ns, Quality.GOOD, Circle(420, 240, 200)))
    bay.step(RangeReading(bay.now_ns, Quality.GOOD, 280.0))
    bay.changes += bay.engine.update_bay(bay.state, bay.now_ns)
    assert bay.announced == ["bay1.truck_moved"]
    assert bay.state.visit.moved is Moved.MARKER


def test_one_frame_without_the_marker_does_not_make_a_departure_an_alarm() -> None:
    bay = Bay()
    bay.comes_to_stand()
    bay.see(0.3, 280, 310, marker=False)
    bay.see(0.1, 310, 325, marker=False)
    assert bay.state.visit.moved is Moved.DISTANCE
    bay.see(3, 325, 1500)
    bay.see(5, None)
    assert bay.announced == []


@pytest.mark.one_interpreter
def test_a_truck_that_moves_after_the_hold_has_ended_is_reported_too() -> None:
    bay = Bay(visit=VisitConfig(hold_limit_s=10))
    bay.comes_to_stand()
    bay.loads(5)
    bay.see(20, 280, marker=False)
    assert bay.announced == ["bay1.in_place_lost"]
    bay.see(3, 280, 340, marker=False)
    assert bay.announced == ["bay1.in_place_lost", "bay1.truck_rolling", "bay1.truck_moved"]


@pytest.mark.one_interpreter
def test_in_place_lost_is_reported_until_it_is_confirmed_again() -> None:
    bay = Bay().loaded()
    bay.see(8, None, marker=False)  # the spout is in the ranger's way; an alive ranger that hears nothing
    assert bay.announced == []  # both say that no truck is there: the visit is over
    bay = Bay(visit=VisitConfig(hold_limit_s=10))
    bay.comes_to_stand()
    bay.loads(5)
    bay.see(20, 280, marker=False)
    assert (bay.newest.id, bay.newest.detail) == ("bay1.in_place_lost", "held for too long")
    bay.see(8, 280)
    assert bay.state.in_place
    assert {alarm.state for alarm in bay.engine.summary().alarms} == {AlarmState.RETURNED}


def test_another_marker_is_reported_until_the_next_one_fits() -> None:
    bay = Bay(retained=RetainedState(FunctionCheck.OFF, tuple(ScaleSample(0, 200.0, 280.0) for _ in range(5))))
    bay.px_mm = 63_000.0  # an eighth larger
    bay.comes_to_stand()
    bay.see(1, 280)
    assert bay.announced == ["bay1.scale_changed"]
    assert bay.newest.detail == "R x Z 63000 px mm, +12 %; learned from 6 visits"
    bay.leaves()
    bay.px_mm = 56_000.0
    bay.comes_to_stand()
    bay.see(7, 280)
    assert bay.announced == ["bay1.scale_changed"]
    assert {alarm.state for alarm in bay.engine.summary().alarms} == {AlarmState.RETURNED}


def test_a_technician_who_moves_the_truck_raises_no_alarm() -> None:
    bay = Bay().loaded()
    bay.step(FunctionCheck.MAY_MOVE_OFF)
    bay.see(5, 280, 400, marker=False)
    assert bay.announced == []
