"""Minutes of an empty bay: a replay by other rules passes over them, and says the same to the last line."""

import random
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest

from gateway import __version__
from gateway.config import GatewayConfig
from gateway.core import interlock
from gateway.core.detection import Circle
from gateway.core.interlock import Rules
from gateway.core.marker_wear import NOT_KNOWN
from gateway.core.plc import Control, PlcWrite
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import FunctionCheck, Moved, StateVector, Tick, Visit
from gateway.core.visit_summary import VisitSummary
from gateway.records import empty_bay
from gateway.records.empty_bay import EmptyBay, RecordedMinute
from gateway.records.record import (
    AnyRecord,
    Checkpoint,
    Decision,
    EventRecord,
    FrameRecord,
    Gap,
    VisitRecord,
    of_observation,
)
from gateway.records.recorder_service import decides
from gateway.records.recording import Item, MissingItem, Place
from gateway.records.replay_portions import Portion, ReplayRules
from gateway.records.segment import Head
from tests.batch_runs import replayed_by
from tests.recorded_bay import T0_NS, Recorded, S, with_visits
from tests.visit_bench import PLC, Bench, Levels, gateway, truck

LATCH = {"latch_stop": True, "latch_leave_s": 2.0}
QUICK = {"start_grace_s": 2.0, "latch_leave_s": 2.0}
NOT_LOADED = {"distance_threshold_mm": 340.0, "radius_threshold_px": 150.0}
NEVER = {"radius_threshold_px": 280.0}


class Yard(Bench):
    """The marker of a truck that has left is out of sight."""

    def _picture(self, t_ns: int) -> VisionReading | None:
        gone = self.world.truth(max(0.0, self._t_s(t_ns)), image_speed=False).distance_mm > 3800
        return VisionReading(t_ns, Quality.NO_TARGET) if gone and self.vision_fault is None else super()._picture(t_ns)


def played(
    folder: Path, seed: int, trucks: int, *, faults: bool, empty_s: float = 30.0, segment_s: int = 40
) -> tuple[str, ...]:
    """So many trucks, some 20 s each, and an empty bay of some `empty_s` behind each: the segments. With
    `faults`: the PLC releases late or never, sensors die, a technician comes, the gateway restarts or stands still."""
    chance = random.Random(f"empty bay {seed}")
    legs: list[dict[str, Any]] = []
    for _ in range(trucks):
        legs.append({"distance_cm": chance.uniform(23, 29), "speed_cm_s": 60, "hold_s": chance.uniform(4, 12)})
        legs.append({"distance_cm": 390, "speed_cm_s": 60, "hold_s": chance.uniform(empty_s - 5, empty_s + 5)})
    config = gateway(fusion=QUICK | {"latch_stop": bool(seed % 2)})
    kept = Recorded(folder, config=config)
    bench = Yard(truck(*legs, start={"distance_cm": 390}, seed=seed), config, seed=seed)
    kept.now_ns = lambda: bench.now_ns
    told, plc = with_visits(kept, bench), Levels(bench)
    begin_ns, fault_s, release_s = bench.now_ns, chance.uniform(8, 20) if faults else 1e9, 0.0
    longest_s = trucks * (empty_s + 45)  # a fault may let a truck go unnoticed
    while bench.t_s < longest_s and (
        len(told) < trucks or not bench.world.truth(bench.t_s - 20, image_speed=False).distance_mm > 3800
    ):
        bench.run(bench.t_s + 0.5)
        bench.moments.clear()
        if bench.state.in_place and not plc.bits:
            release_s = release_s or bench.t_s + (chance.uniform(1, 14) if faults else 2)
        if release_s and bench.t_s > release_s:
            plc.bits = 1 << (Control.RESET if bench.t_s > release_s + 14 else Control.RELEASE)
            if bench.t_s > release_s + 16:
                plc.bits, release_s = 0, 0.0
        if bench.t_s > fault_s:
            fault_s = bench.t_s + chance.uniform(5, 40)
            _fault(bench, plc, chance)
        if bench.now_ns - begin_ns > segment_s * S:
            kept.write(begin_ns)
            kept.collector.begin()
            begin_ns = bench.now_ns
    kept.write(begin_ns)
    return tuple(map(str, sorted(kept.path.iterdir())))


def _fault(bench: Bench, plc: Levels, chance: random.Random) -> None:
    match chance.randrange(7):
        case 0:
            bench.vision_fault = chance.choice((Quality.LINK_DOWN, Quality.STALE, Quality.PROCESS_FAULT))
        case 1:
            bench.range_fault = chance.choice((Quality.STUCK, Quality.LINK_DOWN, Quality.NO_ECHO))
        case 2:
            bench.check_function(FunctionCheck.MAY_MOVE_OFF)
        case 3:
            bench.power_on()
        case 4:
            bench.ticking = False
        case 5:
            plc.alive = False
        case _:
            pass
    bench.run(bench.t_s + chance.uniform(0.1, 6))
    if bench.state.function_check is not FunctionCheck.OFF:
        bench.check_function(FunctionCheck.OFF)
    bench.vision_fault = bench.range_fault = None
    bench.ticking = plc.alive = True


@pytest.fixture(scope="module", autouse=True)
def short() -> Iterator[None]:
    """Complete states every 5 s instead of 60."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gateway.records.collector.CHECKPOINT_NS", 5 * S)
        patch.setattr(empty_bay, "LONGEST_S", 2.5)
        yield


@pytest.fixture(scope="module")
def quiet(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, ...]:
    return played(tmp_path_factory.mktemp("quiet"), 12, 2, faults=False)


def found(paths: tuple[str, ...], other: GatewayConfig, *, complete: bool = False, jobs: int = 1) -> Portion:
    return replayed_by(jobs, ReplayRules(decides(other), None, complete=complete), paths)


def with_rules(**sections: Any) -> GatewayConfig:
    return gateway(**{"fusion": QUICK, **sections})


def assert_same(paths: tuple[str, ...], other: GatewayConfig) -> Portion:
    """The report without the minutes of an empty bay is that of the complete replay."""
    short, whole = found(paths, other), found(paths, other, complete=True)
    assert (short.trucks, short.intervals, short.missing) == (whole.trucks, whole.intervals, whole.missing)
    assert (short.first_ns, short.last_ns) == (whole.first_ns, whole.last_ns)
    assert (short.steps + short.empty, whole.empty) == (whole.steps, 0)
    return short


@pytest.mark.one_interpreter
def test_an_empty_bay_is_passed_over_and_each_truck_is_told_the_same(quiet: tuple[str, ...]) -> None:
    short = assert_same(quiet, with_rules(fusion=QUICK | NOT_LOADED))
    assert len(short.trucks) == 2
    assert short.intervals
    assert all(isinstance(cells["earlier_mm"], float) for _, cells in short.trucks)
    assert short.empty > 2000


@pytest.mark.one_interpreter
def test_a_drive_recorded_or_not_changes_nothing_of_it(tmp_path: Path) -> None:
    """What a drive remembers of its trucks is never as recorded where other thresholds are judged."""
    lens = {"focal_px": 600.0, "marker_radius_mm": 100.0, "tolerance_share": 0.0}  # a drive needs it
    driven = QUICK | {"cross_check": lens}
    begin_ns, config = T0_NS, with_rules(drive={}, fusion=driven)
    kept = Recorded(tmp_path, config=config)
    state = interlock.initial("bay1", begin_ns, rules(config))
    kept.collector(None, state, [])
    for n in range(1, 500):  # 50 s; a truck is seen from 3 to 13 s on its way to 1 m
        t_ns, seen = begin_ns + n * S // 10, 30 < n < 130
        way_mm = 3900.0 - 29.0 * (n - 30) if seen else 3900.0
        circle = Circle(320.0, 240.0, 60_000 / way_mm)
        vision = VisionReading(t_ns, Quality.GOOD, circle) if seen else VisionReading(t_ns, Quality.NO_TARGET)
        for observation in (vision, RangeReading(t_ns, Quality.GOOD, way_mm), Tick()):
            state = interlock.step(state, observation, t_ns, rules(config))
            kept.collector(observation, state, [])
    paths = (str(kept.write(begin_ns)),)
    assert state.memory.drive.history.ways
    short = assert_same(paths, with_rules(drive={}, fusion=driven | {"distance_threshold_mm": 1500.0}))
    assert short.empty > 700
    assert assert_same(paths, with_rules(fusion=driven)).empty > 700


def rules(config: GatewayConfig) -> Rules:
    return Rules.of(config.bays[0], config)


@pytest.mark.parametrize(
    "sections",
    [
        {"modbus": {"writes": True, "plc_addresses": [PLC.address]}},
        {"fusion": QUICK | {"fail_safe": False}},
        {"fusion": QUICK | {"period_s": 0.2}},
        {"fusion": QUICK | {"recovery_s": 3.0}},
        {"fusion": QUICK | {"vision_deadline_s": 3.0}},
        {"fusion": QUICK | {"range_deadline_s": 3.0}},
        {"fusion": {"start_grace_s": 3.0, "latch_leave_s": 2.0}},
        {"fusion": {"start_grace_s": 2.0, "latch_leave_s": 3.0}},
        {"visit": {"leave_s": 3.0}},
        {"camera": {"beacon": {"u_px": 5, "v_px": 5}}, "ranger": {"type": "hcsr04", "hcsr04": {"beacon": True}}},
    ],
)
def test_rules_by_which_an_empty_bay_may_matter(sections: dict[str, Any]) -> None:
    then, now = rules(with_rules()), rules(with_rules(**sections))
    assert not empty_bay.comparable(then, now)
    assert not empty_bay.comparable(now, then)


@pytest.mark.parametrize("fusion", [{}, NOT_LOADED, NEVER, LATCH, {"vision_deadline_s": 1.0}])
def test_thresholds_and_short_times_do_not_matter_there(fusion: dict[str, Any]) -> None:
    assert empty_bay.comparable(rules(with_rules()), rules(with_rules(fusion=QUICK | fusion)))


@pytest.mark.long
@pytest.mark.one_interpreter
@pytest.mark.parametrize("seed", range(20, 32))
def test_with_faults_between_the_trucks_and_stops_that_stay(seed: int, tmp_path: Path) -> None:
    paths = played(tmp_path, seed, 2, faults=True)
    others = (NOT_LOADED, NEVER, LATCH, {"distance_threshold_mm": 260.0}, {"vision_deadline_s": 1.0})
    assert_same(paths, with_rules(fusion=QUICK | others[seed % 5], visit={"leave_distance_mm": 2000.0 - 50 * seed}))


@pytest.mark.long
@pytest.mark.one_interpreter
def test_several_processes_say_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(empty_bay, "LONGEST_S", 30.0)  # as in the other processes
    monkeypatch.setattr("gateway.records.collector.CHECKPOINT_NS", 31 * S)
    paths = played(tmp_path, 12, 4, faults=False, empty_s=110.0, segment_s=130)
    assert len(paths) >= 4
    for fusion in ({}, NEVER):
        other = with_rules(fusion=QUICK | fusion)
        one = found(paths, other)
        assert one.empty > 1000
        assert found(paths, other, jobs=2) == one


PLACE = Place(Path("x.seg"), Head(
    bay="bay1", number=1, boot="a", site="s", instance="g", gateway_version="1", python_version="3", t_ns=0, unix_ns=0,
    config="",
), 0)  # fmt: skip
BAY = StateVector("bay1", t_ns=10 * S, valid_until_ns=10 * S + S // 4)
CIRCLE = Circle(1.0, 2.0, 3.0)
NEXT_NS = 10 * S + S // 50


def minute(*records: AnyRecord, state: StateVector = BAY) -> RecordedMinute:
    items: list[Item | MissingItem] = [(PLACE, record) for record in records]
    return RecordedMinute((PLACE, Checkpoint(t_ns=state.t_ns, state=state, follows=True)), items)


def entered(observation: Any, t_ns: int = NEXT_NS) -> AnyRecord:
    record = of_observation(observation, t_ns)
    assert isinstance(record, AnyRecord)
    return record


DECIDED = Decision.of(replace(BAY, t_ns=NEXT_NS))


@pytest.mark.parametrize(
    "record",
    [
        entered(Tick()),
        entered(NOT_KNOWN),
        entered(VisionReading(NEXT_NS, Quality.NO_TARGET)),
        entered(VisionReading(NEXT_NS, Quality.LINK_DOWN)),
        entered(RangeReading(NEXT_NS, Quality.GOOD, 900.0)),
        entered(PlcWrite(PLC, heartbeat=1, control=1, recipe=0)),
        DECIDED,
        EventRecord(t_ns=NEXT_NS, kind="start"),
    ],
)
def test_what_an_empty_bay_may_record(record: AnyRecord) -> None:
    assert minute(record).empty()
    assert not RecordedMinute(None, minute(record).items).empty()


@pytest.mark.parametrize(
    "record",
    [
        FrameRecord(t_ns=NEXT_NS, reading=VisionReading(NEXT_NS, Quality.GOOD, CIRCLE)),
        FrameRecord(t_ns=NEXT_NS, reading=VisionReading(NEXT_NS, Quality.NO_TARGET, wrong_size=CIRCLE)),
        entered(PlcWrite(PLC, recipe=2)),
        entered(FunctionCheck.OFF),
        entered(Tick(), 9 * S),
        entered(Tick(), 11 * S),
        msgspec.structs.replace(DECIDED, stop=False),
        msgspec.structs.replace(DECIDED, may_move=True),
        msgspec.structs.replace(DECIDED, in_place=True),
        msgspec.structs.replace(DECIDED, moved=Moved.MARKER),
        Checkpoint(t_ns=NEXT_NS, state=BAY),
        Gap(t_ns=NEXT_NS, lost=1, why="x"),
        VisitRecord(t_ns=NEXT_NS, visit=VisitSummary(0, 1.0)),
    ],
)
def test_what_an_empty_bay_does_not_record(record: AnyRecord) -> None:
    assert not minute(record).empty()


@pytest.mark.parametrize(
    "state",
    [
        replace(BAY, stop=False),
        replace(BAY, vision=VisionReading(0, Quality.GOOD, CIRCLE)),
        replace(BAY, visit=Visit(restored=True)),
        replace(BAY, visit=Visit(released=True)),
        replace(BAY, visit=Visit(moved=Moved.DISTANCE)),
        replace(BAY, memory=replace(BAY.memory, d=True)),
        replace(BAY, memory=replace(BAY.memory, latched=True)),
        replace(BAY, memory=replace(BAY.memory, disagree=True)),
        # These end when the bay is clear, for which another distance may count.
        replace(BAY, visit=Visit(checked=True)),
        replace(BAY, memory=replace(BAY.memory, pairs=((20.0, 2000.0),))),
        replace(BAY, memory=replace(BAY.memory, marker_confirmed=True)),
    ],
)
def test_a_bay_in_which_a_truck_still_counts_is_not_empty(state: StateVector) -> None:
    assert not minute(entered(Tick()), state=state).empty()


@pytest.mark.parametrize(("ticks", "passed"), [(12, 0), (14, 1)])
def test_all_times_pass_before_the_next_truck_also_where_the_recorder_began_anew(ticks: int, passed: int) -> None:
    """2.4 or 2.8 s between two complete states, of which the second one is followed by a circle."""
    place = replace(PLACE, head=msgspec.structs.replace(PLACE.head, gateway_version=__version__))
    begin_ns = BAY.t_ns + S // 5
    records: list[AnyRecord] = [Checkpoint(t_ns=BAY.t_ns, state=BAY, follows=True), entered(Tick(), begin_ns)]
    records.append(Checkpoint(t_ns=begin_ns, state=replace(BAY, valid_until_ns=begin_ns + S // 4), follows=True))
    records += [entered(Tick(), begin_ns + n * S // 5) for n in range(1, ticks + 1)]
    end_ns = begin_ns + ticks * S // 5
    records.append(Checkpoint(t_ns=end_ns, state=BAY, follows=True))
    records.append(FrameRecord(t_ns=end_ns, reading=VisionReading(end_ns, Quality.GOOD, CIRCLE)))
    same = rules(with_rules())
    bay = EmptyBay(lambda: BAY, lambda _: same, lambda _: same)
    assert len(list(bay.left_out((place, record) for record in records))) == len(records)
    assert bay.steps == passed


def test_missing_records_and_another_segment_are_no_empty_bay() -> None:
    other = replace(PLACE, head=msgspec.structs.replace(PLACE.head, boot="b"))
    for item in (MissingItem("x"), (other, entered(Tick()))):
        assert not RecordedMinute(minute().begin, [item]).empty()


def test_a_tick_makes_the_decision_valid_for_a_quarter_of_a_second() -> None:
    frame = entered(VisionReading(0, Quality.NO_TARGET), NEXT_NS + S // 4)
    assert minute(entered(Tick()), frame).empty()
    assert not minute(entered(NOT_KNOWN), frame).empty()
