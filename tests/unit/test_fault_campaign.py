"""A short share of bench/fault_campaign.py: a thousand schedules, judged by the simulator's truth."""

from dataclasses import replace

import pytest

from tests import fault_bay
from tests.fault_judge import play, shrunk
from tests.fault_schedules import Failure, Fault, schedule
from tests.long import mostly_long
from tests.planted_faults import PLANTED

pytestmark = pytest.mark.one_interpreter

SCHEDULES, BLOCK = 1000, 50


@pytest.mark.parametrize("first", mostly_long(range(0, SCHEDULES, BLOCK), short=2))
def test_no_schedule_of_faults_brings_an_unsafe_permit_and_each_recovers(first: int) -> None:
    """Replay one: python -m bench.fault_campaign --seed N."""
    drawn = [schedule(seed) for seed in range(first, first + BLOCK)]
    with_drive = [replace(made, settings="driven") for made in drawn if made.settings == "quick"][::3]
    outcomes = [play(made) for made in (*drawn, *with_drive)]
    assert [(o.schedule.seed, o.schedule.settings, o.unsafe, o.stuck) for o in outcomes if o.failed] == []


@pytest.mark.parametrize("seed", [15, 41, 103])
def test_a_drive_has_a_setpoint_in_schedules_like_those_above(seed: int) -> None:
    """Many a schedule has a fault from its beginning on, and then none: the test above would say nothing of a drive."""
    assert play(replace(schedule(seed), settings="driven")).driven > 0


@pytest.mark.parametrize("seed", [2988, 5469, 8263])
def test_a_truck_recovers_after_something_before_the_ranger_was_taken_for_it(seed: int) -> None:
    outcome = play(schedule(seed))
    assert (outcome.unsafe, outcome.stuck, outcome.cleared) == ([], "", False)


@pytest.mark.parametrize("seed", [13201, 14058])
def test_where_r_has_not_followed_z_the_sensors_agree_again_once_the_bay_was_clear(seed: int) -> None:
    """docs/visit.md, "Limits": the truck was heard itself between 54 and 28 cm only."""
    outcome = play(schedule(seed))
    assert (outcome.unsafe, outcome.stuck, outcome.cleared) == ([], "", True)


def test_another_truck_at_the_same_place_within_no_time_is_the_same_one() -> None:
    assert not play(schedule(13838)).failed


def test_a_number_that_the_gateway_could_not_accept_before_is_a_heartbeat_though_the_plc_stopped_meanwhile() -> None:
    """docs/handshake.md, "Heartbeat": the next change ends the loss. The control task was dead, writes were refused."""
    assert not play(schedule(26580)).failed


def test_the_heartbeat_of_the_next_owner_counts_while_the_first_one_stands_still() -> None:
    """docs/handshake.md, "One writer at a time"."""
    failures = (Failure(Fault.PLC_STOPPED, 0.1, 1.8), Failure(Fault.OTHER_MASTER, 0.1, 1.8))
    made = replace(schedule(204), truck="stays", legs=(), failures=failures)
    told: list[str] = []
    assert not play(made, told.append).failed
    assert any("plc_lost" in line for line in told)


def test_a_seed_gives_the_same_schedule_and_the_same_run() -> None:
    told: list[list[str]] = [[], []]
    for lines in told:
        outcome = play(schedule(7), lines.append)
        assert not outcome.failed
    assert told[0] == told[1]
    assert len(told[0]) > 5


def test_every_fault_occurs() -> None:
    assert {failure.fault for seed in range(SCHEDULES) for failure in schedule(seed).failures} == set(Fault)


@pytest.mark.mostly_long
@pytest.mark.parametrize(
    ("what", "seed", "faults"),
    [
        ("an old distance counts", 7, [Fault.RANGER_BACKLOG]),
        ("an old picture counts", 5, [Fault.CAMERA_STUCK]),
        ("a dead camera does not end in_place", 5, [Fault.CAMERA_STUCK]),
        ("a state is valid for ever", 56, [Fault.CONTROL_DEAD]),
        ("a function check is forgotten", 10, [Fault.FUNCTION_CHECK]),
        ("a PLC is never lost", 204, [Fault.PLC_STOPPED, Fault.PLC_RELEASES]),
        ("a heartbeat that stands still counts", 204, [Fault.PLC_STOPPED, Fault.PLC_RELEASES]),
        ("a restart forgets the truck in place", 11087, [Fault.RESTARTED, Fault.PLC_SLOW]),
        ("a restart forgets the truck in place", 11224, [Fault.RESTARTED, Fault.OTHER_MASTER]),
    ],
)
def test_the_campaign_reports_a_planted_fault_and_what_of_the_schedule_it_needs(
    what: str, seed: int, faults: list[Fault], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = schedule(seed)
    assert not play(made).failed
    PLANTED[what].plant(monkeypatch.setattr)
    fault_bay.warm.cache_clear()
    try:
        assert play(made).unsafe
        assert [failure.fault for failure in shrunk(made).failures] == faults
    finally:
        fault_bay.warm.cache_clear()
