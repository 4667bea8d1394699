"""A gateway that is restarted while a truck is in place: the truck does not leave unnoticed, and nothing looks good."""

from dataclasses import replace

import pytest

from gateway.core.detection import Circle
from gateway.core.events import EventKind
from gateway.core.plc import Control, ResetVerdict
from gateway.core.readings import Quality
from gateway.core.retained import RetainedState, RetainedTruck
from gateway.core.state import FunctionCheck, Moved, Reason, StateVector, TruckPosition, Visit, VisitPhase
from tests.unit.core.test_visit import events, held, in_place, leaving, levels, release_at, released, spout, stands
from tests.visit_bench import Bench, Levels, gateway

pytestmark = pytest.mark.one_interpreter

AT = TruckPosition(280.0, Circle(320.0, 240.0, 193.0))


def restarted(bench: Bench, off_s: float = 0.0, kept: RetainedState | None = None) -> float:
    """The world time at which the gateway begins anew, after it was off for this time."""
    kept = kept or RetainedState.of(bench.state)
    bench.run(bench.t_s + off_s)
    bench.events.clear()
    bench.moments.clear()
    bench.power_on(kept)
    assert (bench.state.stop, bench.state.may_move, bench.state.in_place) == (True, False, False)
    return bench.t_s


def ever_may_move(bench: Bench) -> bool:
    return any(moment.state.may_move or not moment.state.stop for moment in bench.moments)


def reset(bench: Bench) -> StateVector:
    bench.write()
    return bench.write(Control.RESET)


@pytest.mark.failure_mode("G4")
def test_a_truck_that_left_while_the_gateway_was_off_is_stopped_and_reported_until_a_reset() -> None:
    bench = in_place(stands({"distance_cm": 60, "speed_cm_s": 30, "hold_s": 60}, for_s=1.0))
    bench.run(0.5)
    restarted(bench, off_s=5.0)
    bench.run(bench.t_s + 3)
    state = bench.state
    assert not ever_may_move(bench)
    assert (state.d, state.stop, state.reason, state.visit.moved) == (False, True, Reason.MOVED, Moved.DISTANCE)
    assert state.visit.phase is VisitPhase.LEAVING
    ((kind, detail),) = events(bench, EventKind.MOVED)
    assert (kind, detail.startswith("the distance left its band: Z 2")) == (EventKind.MOVED, True)

    assert reset(bench).plc.reset_verdict is ResetVerdict.DONE
    bench.run(bench.t_s + 1)
    assert (bench.state.stop, bench.state.may_move, bench.state.visit.moved) == (False, True, Moved.NO)
    assert RetainedState.of(bench.state).truck is None


def test_it_is_reported_by_the_ranger_alone_while_the_camera_is_still_starting() -> None:
    bench = in_place(stands({"distance_cm": 60, "speed_cm_s": 30, "hold_s": 60}, for_s=1.0))
    bench.vision_fault = Quality.WAITING
    restarted(bench, off_s=5.0)
    bench.run(bench.t_s + 1)
    assert (bench.state.visit.moved, bench.state.stop) == (Moved.DISTANCE, True)


def test_a_truck_that_leaves_after_the_restart_is_stopped_and_reported() -> None:
    bench = held(stands({"distance_cm": 60, "speed_cm_s": 30, "hold_s": 60}, for_s=4.0, faults=(spout(1, 3),)))
    assert bench.t_s < 3
    restarted(bench)
    bench.run(3.9)
    assert (bench.state.visit.moved, bench.state.visit.restored) == (Moved.NO, True)
    bench.run(9)
    assert not ever_may_move(bench)
    assert (bench.state.d, bench.state.reason, bench.state.visit.moved) == (False, Reason.MOVED, Moved.DISTANCE)


def test_a_truck_that_stands_where_it_was_is_in_place_again_only_by_both_sensors() -> None:
    """Until then nothing is permitted by what was before: no release either."""
    bench = held(stands(faults=(spout(1, 12),)))
    begun_s = restarted(bench)
    plc = Levels(bench)
    bench.run(begun_s + 2)
    plc.release()
    bench.run(begun_s + 4)
    assert bench.state.range.distance_mm is not None, "what a release of a truck in place needs is there"
    assert not bench.state.visit.released
    assert not ever_may_move(bench)
    plc.release(on=False)
    bench.run_until(lambda state: state.in_place, 15)
    assert bench.t_s > 13, "the spout is up"
    assert not bench.state.visit.restored
    bench.run(bench.t_s + 0.5)
    plc.release()
    bench.run(bench.t_s + 0.5)
    assert (bench.state.visit.released, bench.state.may_move) == (True, True)


def test_a_bay_that_is_empty_after_a_long_outage_forgets_the_truck_when_it_has_been_clear_for_leave_s() -> None:
    bench = in_place(stands({"distance_cm": 300, "speed_cm_s": 100, "hold_s": 600}, for_s=1.0))
    begun_s = restarted(bench, off_s=60.0)
    bench.run_until(lambda state: not state.visit.restored, 5)
    assert bench.t_s - begun_s == pytest.approx(2.1, abs=0.2)
    assert events(bench, EventKind.VISIT_ENDED) == [(EventKind.VISIT_ENDED, "the bay is clear")]
    bench.moments.pop()
    assert not ever_may_move(bench)
    bench.run(bench.t_s + 0.5)
    assert bench.state.may_move
    assert RetainedState.of(bench.state).truck is None


def test_a_truck_still_within_its_band_is_stopped_though_d_is_0() -> None:
    """D = 1 was held before; equation 14 alone would let it go now, and nobody has released it."""
    bench = in_place(stands({"distance_cm": 31.3, "speed_cm_s": 5, "hold_s": 60}, at_cm=29.5, for_s=1.0))
    restarted(bench, off_s=5.0)
    bench.run(bench.t_s + 3)
    state = bench.state
    assert (state.d, state.stop, state.reason, state.visit.moved) == (False, True, Reason.STOP_LATCHED, Moved.NO)
    assert not ever_may_move(bench)
    assert reset(bench).plc.reset_verdict is ResetVerdict.DONE
    assert bench.run(bench.t_s + 1).may_move


def test_a_reset_before_d_is_0_is_refused() -> None:
    bench = in_place()
    restarted(bench)
    bench.run(bench.t_s + 0.8)
    assert bench.state.d is True
    assert reset(bench).plc.reset_verdict is ResetVerdict.CAUSE_STANDS
    assert bench.state.visit.restored


def test_a_move_of_before_is_still_one_after_the_restart() -> None:
    bench = in_place(stands({"distance_cm": 36, "speed_cm_s": 20, "hold_s": 60}, for_s=1.0))
    bench.run(3)
    assert bench.state.visit.moved is Moved.DISTANCE
    restarted(bench)
    assert bench.state.visit.moved is Moved.DISTANCE
    bench.run(bench.t_s + 2)
    assert (bench.state.reason, ever_may_move(bench)) == (Reason.MOVED, False)
    assert events(bench, EventKind.MOVED) == [], "it was reported before"


def test_another_truck_at_the_mark_is_in_place_by_both_sensors_at_its_own_place() -> None:
    comes = stands({"distance_cm": 23.5, "speed_cm_s": 20, "hold_s": 60}, at_cm=29, for_s=1.0)
    bench = in_place(comes, gateway(guidance={"overshoot_mm": 100}))
    restarted(bench, off_s=5.0)
    bench.run_until(lambda state: state.visit.moved is Moved.DISTANCE, 1)
    bench.run_until(lambda state: state.in_place, 4)
    place = bench.state.visit.place
    assert place is not None
    assert place.distance_mm == pytest.approx(235, abs=17)
    assert (bench.state.visit.moved, bench.state.visit.restored) == (Moved.NO, False)


def test_a_released_truck_is_not_kept_until_its_release_has_ended_at_the_mark() -> None:
    bench = released()
    assert RetainedState.of(bench.state).truck is None
    assert RetainedState.of(leaving().state).truck is None
    levels(bench).release(on=False)
    bench.run(bench.t_s + 0.5)
    assert RetainedState.of(bench.state).truck == RetainedTruck(bench.state.visit.place)


def test_a_truck_that_was_kept_outlives_a_second_restart() -> None:
    bench = held(stands(faults=(spout(1, 60),)))
    kept = RetainedState.of(bench.state)
    restarted(bench)
    bench.run(bench.t_s + 1)
    assert RetainedState.of(bench.state) == kept
    restarted(bench)
    assert bench.state.visit.restored


def test_where_no_plc_writes_it_is_reported_and_d_decides() -> None:
    off = gateway(writes=False)
    bench = in_place(stands({"distance_cm": 60, "speed_cm_s": 30, "hold_s": 60}, for_s=1.0), off)
    restarted(bench, off_s=5.0)
    bench.run(bench.t_s + 3)
    assert (bench.state.visit.moved, bench.state.may_move) == (Moved.DISTANCE, True)


def test_a_place_that_can_t_be_compared_any_more_holds_stop_all_the_same() -> None:
    bench = in_place(stands({"distance_cm": 60, "speed_cm_s": 30, "hold_s": 60}, for_s=1.0))
    restarted(bench, 5.0, RetainedState(truck=RetainedTruck(None)))
    bench.run(bench.t_s + 3)
    assert (bench.state.d, bench.state.reason, bench.state.visit.moved) == (False, Reason.STOP_LATCHED, Moved.NO)
    assert bench.state.visit.phase is VisitPhase.LEAVING
    assert RetainedState.of(bench.state).truck == RetainedTruck(None)
    reset(bench)
    assert bench.run(bench.t_s + 1).may_move


def test_a_release_of_a_place_that_can_t_be_compared_is_refused() -> None:
    bench = in_place(stands(faults=(spout(1, 60),)))
    restarted(bench, 3.0, RetainedState(truck=RetainedTruck(None)))
    release_at(bench, bench.t_s + 2)
    bench.run(bench.t_s + 1)
    assert not ever_may_move(bench)


def test_what_is_kept_is_that_of_the_state() -> None:
    state = replace(in_place().state, function_check=FunctionCheck.MAY_MOVE_KEPT)
    kept = RetainedState.of(state)
    assert (kept.function_check, kept.scale_samples) == (FunctionCheck.MAY_MOVE_KEPT, state.memory.scale_samples)
    for truck in (RetainedTruck(AT), RetainedTruck(AT, Moved.MARKER, moved_covered=True), RetainedTruck(None)):
        begins = replace(kept, truck=truck).visit
        assert RetainedState.of(replace(state, visit=begins)).truck == truck
        assert (begins.in_place, begins.released, begins.restored) == (False, False, True)
    assert RetainedState().visit == Visit()
