"""The status signals of NAMUR NE 107."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.config import FusionConfig
from gateway.core import fusion
from gateway.core.detection import Circle
from gateway.core.ne107 import MAINTENANCE_NS, ORDER, Ne107, active, restarts, status
from gateway.core.plc import Handshake
from gateway.core.readings import (
    AgeProof,
    PictureFault,
    PictureHealth,
    Quality,
    RangeReading,
    RangeStats,
    VisionReading,
    VisionStats,
)
from gateway.core.state import FunctionCheck, FusionMemory, Reason, StateVector

T0 = 1_000_000_000_000
GOOD = StateVector(
    "bay1",
    t_ns=T0,
    vision=VisionReading(T0, Quality.GOOD, Circle(1, 2, 3)),
    range=RangeReading(T0, Quality.GOOD, 500.0),
    stop=False,
    may_move=True,
    reason=Reason.NONE,
)
F, C, S, M = Ne107.FAILURE, Ne107.FUNCTION_CHECK, Ne107.OUT_OF_SPECIFICATION, Ne107.MAINTENANCE_REQUIRED


def with_(vision: Quality = Quality.GOOD, rng: Quality = Quality.GOOD) -> StateVector:
    return replace(GOOD, vision=VisionReading(T0, vision), range=RangeReading(T0, rng))


@pytest.mark.parametrize(
    ("vision", "rng", "expected"),
    [
        (Quality.GOOD, Quality.GOOD, Ne107.GOOD),
        (Quality.NO_TARGET, Quality.GOOD, Ne107.GOOD),
        (Quality.NO_TARGET, Quality.NO_ECHO, Ne107.GOOD),  # an empty bay
        (Quality.NO_TARGET, Quality.TOO_FAR, Ne107.GOOD),
        (Quality.GOOD, Quality.NO_ECHO, S),
        (Quality.GOOD, Quality.TOO_FAR, S),
        (Quality.GOOD, Quality.TOO_NEAR, S),
        (Quality.GOOD, Quality.UNSTABLE, S),
        (Quality.COASTED, Quality.GOOD, S),
        (Quality.WAITING, Quality.GOOD, C),
        (Quality.GOOD, Quality.WAITING, C),
        (Quality.STALE, Quality.WAITING, F),
        (Quality.LINK_DOWN, Quality.GOOD, F),
        (Quality.PROCESS_FAULT, Quality.GOOD, F),
        (Quality.GOOD, Quality.STUCK, F),
        (Quality.TOO_NEAR, Quality.WRONG_VERSION, F),
    ],
)
def test_sensors(vision: Quality, rng: Quality, expected: Ne107) -> None:
    assert status(replace(with_(vision, rng), may_move=False)) is expected


def test_a_truck_that_arrives_from_beyond_the_rangers_range_is_as_specified() -> None:
    arrives = replace(with_(Quality.GOOD, Quality.TOO_FAR), may_move=True)
    assert status(arrives) is Ne107.GOOD


def test_what_is_no_sensor() -> None:
    assert status(replace(GOOD, plc=Handshake(missed=True))) is F
    assert status(replace(GOOD, memory=FusionMemory(disagree=True))) is S
    assert status(replace(GOOD, vision=replace(GOOD.vision, age_proof=AgeProof.UNPROVEN))) is S
    assert status(fusion.forced_stop(GOOD, Reason.GATEWAY_FAULT, T0)) is F
    assert status(fusion.forced_stop(GOOD, Reason.SHUTDOWN, T0)) is C


@pytest.mark.parametrize("mode", [FunctionCheck.MAY_MOVE_OFF, FunctionCheck.MAY_MOVE_KEPT])
def test_a_technician_at_work_explains_everything_but_a_dead_gateway(mode: FunctionCheck) -> None:
    working = replace(with_(Quality.LINK_DOWN, Quality.TOO_NEAR), function_check=mode)
    assert status(working) is C
    assert active(working) == {F, C, S}
    assert status(fusion.forced_stop(working, Reason.GATEWAY_FAULT, T0)) is F


@pytest.mark.parametrize("fault", PictureFault)
def test_maintenance_for_a_picture_that_needs_somebody_while_vision_still_works(fault: PictureFault) -> None:
    fine = PictureHealth(0.5, 0.0, 0.4, 0.6, 0.2, 0.0)
    assert active(replace(GOOD, vision=replace(GOOD.vision, picture=fine))) == frozenset()
    poor = replace(GOOD, vision=replace(GOOD.vision, picture=replace(fine, status=1 << fault)))
    assert (status(poor), active(poor)) == (M, frozenset({M}))
    assert poor.may_move
    stale = replace(poor, vision=replace(poor.vision, quality=Quality.STALE))
    assert (status(stale), active(stale)) == (F, frozenset({F}))


def test_maintenance_for_a_lost_temperature_while_distances_are_measured() -> None:
    lost = replace(GOOD, range=replace(GOOD.range, temperature_lost=True))
    assert (status(lost), lost.may_move) == (M, True)
    aged = fusion.aged_range(lost.range, T0 + 10**10, FusionConfig())
    assert (aged.quality, aged.temperature_lost) == (Quality.STALE, False)


def test_maintenance_after_a_repair_by_itself() -> None:
    noted = replace(GOOD, memory=FusionMemory(restarts=1, restarted_ns=T0 - MAINTENANCE_NS + 1))
    assert status(noted) is M
    assert status(replace(noted, t_ns=T0 + 1)) is Ne107.GOOD
    stats = VisionStats(restarts=1, reopens=2, lost=4, skipped=100)
    busy = replace(
        GOOD, vision=replace(GOOD.vision, stats=stats), range=replace(GOOD.range, stats=RangeStats(reopens=8))
    )
    assert restarts(busy) == 15


@pytest.mark.parametrize(("lines", "damaged", "expected"), [(99, 1, Ne107.GOOD), (98, 2, M), (50, 20, Ne107.GOOD)])
def test_maintenance_for_a_noisy_cable(lines: int, damaged: int, expected: Ne107) -> None:
    stats = RangeStats(lines=lines, damaged=damaged)
    assert status(replace(GOOD, range=replace(GOOD.range, stats=stats))) is expected


@given(st.sampled_from(Quality), st.sampled_from(Quality), st.sampled_from(FunctionCheck), st.booleans())
def test_the_status_is_one_of_the_signals_that_hold(
    vision: Quality, rng: Quality, check: FunctionCheck, missed: bool
) -> None:
    state = replace(with_(vision, rng), function_check=check, plc=Handshake(missed=missed))
    assert (status(state) is Ne107.GOOD) == (not active(state))
    assert status(state) in active(state) | {Ne107.GOOD}


def test_every_signal_has_a_rank() -> None:
    assert {*ORDER, Ne107.GOOD} == set(Ne107)
