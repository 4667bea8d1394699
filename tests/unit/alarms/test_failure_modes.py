"""The table of failure modes: every row is played by a test, and those of sensors, truck and PLC are played here."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from gateway.alarms import table
from gateway.core.readings import Quality
from gateway.core.state import Reason, StateVector
from gateway.sim.scenario import FaultKind
from tests.failure_mode_tests import marked_tests
from tests.visit_bench import PLC, Bench, Levels, gateway, truck
from tools import failure_modes
from tools.failure_modes import FailureMode, Outputs

ROWS = {mode.id: mode for mode in failure_modes.rows()}
FAULT_S = 4.0  # a truck that starts at 60 cm has been standing for long enough
PHASES_S = (0.0, 0.03)  # of a ranger's cycle of 60 ms and of a frame of 33 ms
Play = Callable[[Bench], None]


Faults = tuple[Mapping[str, Any], ...]


def fault(*kinds: str, **more: float) -> Faults:
    return tuple({"kind": kind, "for_s": 60.0} | more for kind in kinds)


def plc_stops(bench: Bench) -> None:
    assert isinstance(bench.plc, Levels)
    bench.plc.alive = False


def vision_process_dies(bench: Bench) -> None:
    bench.vision_fault = Quality.PROCESS_FAULT


# id -> the scenario's faults, or what is done to the bench at that moment
PLAYED: Mapping[str, Faults | Play] = {
    "C1": fault("camera_lost"),
    "C2": fault("camera_freeze"),
    "C4": fault("camera_black"),
    "V1": vision_process_dies,
    "M1": fault("marker_hidden"),
    "M2": fault("marker_hidden", "red_lamp"),
    "M4": fault("marker_hidden", for_s=0.12),
    "R1": fault("ranger_unplugged"),
    "R2": fault("ranger_silent"),
    "R3": fault("ranger_no_echo"),
    "R4": fault("ranger_stuck"),
    "R5": fault("ranger_too_near"),
    "R6": fault("ranger_too_far"),
    "R8": fault("ranger_wild"),
    "R9": fault("ranger_echo", distance_cm=12.0),
    "R10": fault("ranger_wrong_version"),
    "G4": lambda bench: bench.power_on(),
    "P2": plc_stops,
}
TESTS = Path(__file__).parents[2]
CONFIG = gateway(modbus={"writes": True, "plc_addresses": [PLC.address]})
ON_ITS_WAY, PLACED = 80.0, 28.0  # cm


def played(mode: FailureMode, distance_cm: float, phase_s: float) -> tuple[int, Outputs]:
    """ms from the failure until may_move and in_place are as the row has them for good, and all outputs after that
    time."""
    at_s = FAULT_S + phase_s
    play = PLAYED[mode.id]
    faults = () if callable(play) else tuple({**one, "at_s": at_s} for one in play)
    scenario = truck({"distance_cm": distance_cm, "hold_s": 120}, start={"distance_cm": 60}, faults=faults)
    bench = Bench(scenario, CONFIG)
    Levels(bench)
    bench.run(at_s - 0.01)
    before = failure_modes.UNCHANGED_IN_PLACE if distance_cm == PLACED else failure_modes.UNCHANGED_APPROACHING
    assert outputs(bench.state) == before
    if callable(play):
        play(bench)
    wanted = mode.in_place if distance_cm == PLACED else mode.approaching
    assert isinstance(wanted, Outputs)
    late_ms = now_ms = 0
    while now_ms < (mode.within_ms or 0):
        bench.run(bench.t_s + 0.01)
        now_ms += 10
        if (bench.state.may_move, bench.state.in_place) != (wanted.may_move, wanted.in_place):
            late_ms = now_ms + 10
    return late_ms, outputs(bench.state)


def outputs(state: StateVector) -> Outputs:
    return Outputs(state.stop, state.may_move, state.in_place, state.reason)


CASES = [
    pytest.param(mode, distance_cm, id=f"{mode.id}-{name}")
    for mode in ROWS.values()
    for name, distance_cm, wanted in (
        ("approaching", ON_ITS_WAY, mode.approaching),
        ("in_place", PLACED, mode.in_place),
    )
    if mode.id in PLAYED and wanted is not None
]


@pytest.mark.one_interpreter
@pytest.mark.one_interpreter
@pytest.mark.failure_mode(
    "C1", "C2", "C4", "V1", "M1", "M2", "M4", "R1", "R2", "R3", "R4", "R5", "R6", "R8", "R9", "R10", "G4", "P2"
)  # fmt: skip
@pytest.mark.parametrize(("mode", "distance_cm"), CASES)
def test_a_failure_shows_on_the_outputs_what_its_row_states(mode: FailureMode, distance_cm: float) -> None:
    wanted = mode.in_place if distance_cm == PLACED else mode.approaching
    for phase_s in PHASES_S:
        late_ms, shown = played(mode, distance_cm, phase_s)
        assert shown == wanted
        assert late_ms <= (mode.within_ms or 0)


@pytest.mark.long
@pytest.mark.one_interpreter
def test_every_row_has_a_test_and_every_mark_a_row() -> None:
    assert set(marked_tests(TESTS)) == set(ROWS)
    here = Path(__file__).name
    assert {id for id, tests in marked_tests(TESTS).items() if any(here in test for test in tests)} == set(PLAYED)


def test_each_row_has_an_id_of_its_own_and_alarms_that_exist() -> None:
    assert len(list(failure_modes.rows())) == len(ROWS)
    assert {mode.alarm for mode in ROWS.values()} - {""} <= set(table.ALARM_DEFINITIONS)


def test_no_failure_lets_a_truck_move_that_may_not_or_loads_one_that_is_not_in_place() -> None:
    for mode in ROWS.values():
        for before, after in (
            (failure_modes.UNCHANGED_APPROACHING, mode.approaching),
            (failure_modes.UNCHANGED_IN_PLACE, mode.in_place),
        ):
            if isinstance(after, Outputs):
                assert after.stop >= before.stop
                assert after.may_move <= before.may_move
                assert after.in_place <= before.in_place
                assert after.may_move + after.stop == 1


def test_every_reason_for_a_stop_and_every_fault_of_the_simulator_is_in_a_row() -> None:
    shown = {
        out.reason for mode in ROWS.values() for out in (mode.approaching, mode.in_place) if isinstance(out, Outputs)
    }
    no_failure = {Reason.STOP_LATCHED, Reason.MOVED, Reason.CLEARING}  # MOVED is words in T1 and T2
    assert shown | no_failure == set(Reason)
    kinds = {one["kind"] for play in PLAYED.values() if not callable(play) for one in play}
    # C3, C12, M2, M1, M5, R7, R15 and R16: by their own tests
    elsewhere = {"camera_stuck", "camera_late", "camera_looped", "spout_down", "dust_cloud", "ranger_noise"}
    elsewhere |= {"marker_crusted", "ranger_offset", "ranger_no_temperature"}
    assert kinds | elsewhere == {kind.value for kind in FaultKind}
