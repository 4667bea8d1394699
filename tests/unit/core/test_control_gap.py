"""A control task that did not run for a moment: what a PLC saw withdrawn must be earned again, and is reported."""

from dataclasses import replace

import pytest

from gateway.core import interlock
from gateway.core.detection import Circle
from gateway.core.events import EventKind
from gateway.core.interlock import Rules
from gateway.core.plc import Control, PlcWrite, TriggerOutcome, TriggerPhase
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.shown import shown
from gateway.core.state import FunctionCheck, Moved, Reason, StateVector, Tick
from tests.visit_bench import PLC, Bench, Levels, gateway, truck
from tests.visit_judge import Row, complaints

MS = 1_000_000
S = 1000 * MS
IN = {"distance_cm": 28, "speed_cm_s": 30, "hold_s": 600}
COVERED = {"kind": "spout_down", "at_s": 6, "for_s": 600}
GAP = [EventKind.OUTPUTS_WITHDRAWN, EventKind.IN_PLACE_ENDED, EventKind.OUTPUTS_RETURNED]


def placed(*faults: dict[str, object]) -> Bench:
    bench = Bench(truck(IN, faults=faults))
    bench.run_until(lambda state: state.in_place)
    bench.run(9.0)
    assert bench.state.in_place
    return bench


def without_ticks(bench: Bench, for_s: float) -> StateVector:
    bench.ticking = False
    bench.run(bench.t_s + for_s)
    bench.ticking = True
    bench.run(bench.t_s + 0.02)
    return bench.state


@pytest.mark.mostly_long
@pytest.mark.one_interpreter
@pytest.mark.failure_mode("G1")
@pytest.mark.parametrize("for_s", [0.26, 0.4, 3.0])
def test_in_place_does_not_come_back_by_itself(for_s: float) -> None:
    """The sensors report all the while, and the truck stands where it stood."""
    bench = placed(COVERED)
    known = len(bench.events)
    state = without_ticks(bench, for_s)
    assert (state.in_place, state.stop, state.visit.restored, state.visit.moved) == (False, True, True, Moved.NO)
    bench.run(bench.t_s + 30)
    assert not bench.state.in_place, "its marker is covered"
    assert [event.kind for event in bench.events[known:]] == GAP
    rows = [Row.of(moment.state, moment.truth, moment.heard_mm) for moment in bench.moments]
    assert any(row.silent for row in rows)
    assert complaints(rows, bench.config) == []


def test_it_is_in_place_again_by_both_sensors() -> None:
    bench = placed()
    without_ticks(bench, 0.3)
    since_s = bench.t_s
    bench.run_until(lambda state: state.in_place)
    assert bench.config.bays[0].visit.settle_s - 0.05 <= bench.t_s - since_s <= 1.5
    assert not bench.state.visit.restored


@pytest.mark.one_interpreter
def test_a_truck_that_stood_there_during_a_function_check_is_not_in_place_after_it_either() -> None:
    bench = placed()
    bench.check_function(FunctionCheck.MAY_MOVE_OFF)
    bench.run(bench.t_s + 1)
    bench.check_function(FunctionCheck.OFF)
    without_ticks(bench, 0.3)
    bench.run(bench.t_s + 10)
    assert not bench.state.in_place


def test_a_short_delay_withdraws_nothing() -> None:
    bench = placed(COVERED)
    known = len(bench.events)
    assert without_ticks(bench, 0.2).in_place
    assert bench.events[known:] == []


def test_a_process_that_was_stopped_altogether() -> None:
    """SIGSTOP, a blocked event loop: no observation, either, and the first thing that happens may be a reading."""
    bench = placed(COVERED)
    known, last = len(bench.events), bench.state
    bench._ticks += 26
    bench._range()
    assert shown(bench.state, bench.now_ns).reason is Reason.GATEWAY_FAULT
    bench.run(bench.t_s + 2)
    assert not bench.state.in_place
    gone, ended, returned = [event for event in bench.events[known:] if not event.sensor]
    assert [gone.kind, ended.kind, returned.kind] == GAP
    assert gone.t_ns == ended.t_ns == last.valid_until_ns + 1
    assert returned.t_ns == last.t_ns + 280 * MS
    assert (gone.state.in_place, gone.state.stop, gone.state.reason) == (False, True, Reason.GATEWAY_FAULT)
    assert returned.detail == "the control task runs again; no decision was valid for 0.03 s"


@pytest.mark.one_interpreter
def test_a_release_is_over_and_its_bit_must_rise_again() -> None:
    bench = placed(COVERED)
    levels = Levels(bench)
    bench.run(bench.t_s + 0.2)
    levels.release()
    bench.run_until(lambda state: state.may_move)
    state = without_ticks(bench, 0.3)
    assert (state.stop, state.may_move, state.visit.released) == (True, False, False)
    bench.run(bench.t_s + 5)
    assert (bench.state.stop, bench.state.may_move) == (True, False)


@pytest.mark.one_interpreter
def test_a_truck_that_drives_off_meanwhile_has_moved() -> None:
    bench = Bench(truck({**IN, "hold_s": 8}, {"distance_cm": 60, "speed_cm_s": 20, "hold_s": 60}))
    bench.run_until(lambda state: state.in_place)
    Levels(bench)
    leaves_s = 92 / 30 + 8
    bench.run(leaves_s - 0.2)
    assert bench.state.in_place
    without_ticks(bench, 2.5)
    assert (bench.state.visit.moved, bench.state.stop, bench.state.in_place) == (Moved.DISTANCE, True, False)


# The step alone.

RULES = Rules.of(gateway().bays[0], gateway())


def stepped(state: StateVector, t_ns: int, *observations: object, rules: Rules = RULES) -> StateVector:
    for observation in observations:
        state = interlock.step(state, observation, t_ns, rules)  # type: ignore[arg-type]
    return state


def driven(seconds: float, rules: Rules = RULES, mm: float = 900.0, px: float = 60.0) -> StateVector:
    """A truck that stands on its way in, seen by both."""
    state = interlock.initial("bay1", 0, rules)
    for n in range(round(seconds * 50)):
        t_ns = n * 20 * MS
        seen, heard = VisionReading(t_ns, Quality.GOOD, Circle(320, 240, px)), RangeReading(t_ns, Quality.GOOD, mm)
        state = stepped(state, t_ns, seen, heard, Tick(), rules=rules)
    return state


def test_the_truck_may_move_again_after_clear_hold() -> None:
    state = driven(2)
    assert state.may_move
    t_ns = state.valid_until_ns + 1
    for ms in range(0, 301, 20):  # clear_hold_s is 0.3
        at_ns = t_ns + ms * MS
        seen = VisionReading(at_ns, Quality.GOOD, Circle(320, 240, 60)), RangeReading(at_ns, Quality.GOOD, 900.0)
        state = stepped(state, at_ns, *seen, Tick())
        assert (state.d, state.stop, state.may_move) == (False, ms < 300, ms >= 300), ms


@pytest.mark.parametrize("decision", ["held", "plain"])
def test_an_observation_before_the_first_tick_shows_nothing(decision: str) -> None:
    rules = Rules.of((config := gateway(fusion={"decision": decision})).bays[0], config)
    state = driven(2, rules)
    t_ns = state.valid_until_ns + 1
    for observation in (
        RangeReading(t_ns, Quality.GOOD, 900.0),
        VisionReading(t_ns, Quality.GOOD, Circle(320, 240, 60)),
        FunctionCheck.OFF,
        PlcWrite(PLC, heartbeat=7),
    ):
        state = stepped(state, t_ns, observation, rules=rules)
        assert (state.stop, state.may_move, state.reason) == (True, False, Reason.GATEWAY_FAULT)
        assert state.valid_until_ns < t_ns


def test_a_triggered_measurement_and_a_held_result_are_gone() -> None:
    waiting = stepped(driven(2), 2 * S, PlcWrite(PLC, control=0), PlcWrite(PLC, control=1 << Control.TRIGGER))
    assert waiting.plc.phase is TriggerPhase.ACQUIRING
    after = stepped(waiting, 3 * S, Tick())
    assert (after.plc.phase, after.plc.timed_out, after.plc.result) == (TriggerPhase.READY, True, None)

    t_ns = 2 * S + 20 * MS
    seen, heard = VisionReading(t_ns, Quality.GOOD, Circle(320, 240, 60)), RangeReading(t_ns, Quality.GOOD, 900.0)
    valid = stepped(waiting, t_ns, seen, heard, Tick(), Tick())
    assert (valid.plc.phase, valid.plc.result and valid.plc.result.outcome) == (
        TriggerPhase.VALID,
        TriggerOutcome.NOT_IN_PLACE,
    )
    assert stepped(valid, 3 * S, Tick()).plc.result is None


def test_a_stop_that_may_have_been_latched_meanwhile_is() -> None:
    config = gateway(fusion={"latch_stop": True})
    rules = Rules.of(config.bays[0], config)
    state = driven(1, rules)
    state = replace(state, memory=replace(state.memory, latched=False))
    after = stepped(state, state.valid_until_ns + 1, Tick(), rules=rules)
    assert (after.memory.latched, after.stop) == (True, True)
