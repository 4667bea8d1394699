"""Recorded incidents are decided again by this version: a change of any decision is a diff that somebody must want."""

import pytest

from gateway.records import recording
from gateway.records.record import Decision
from gateway.records.recorded_rules import RecordedRules
from gateway.records.recording import MissingItem
from gateway.records.replay import Difference, Replay
from tests.recorded_incidents import FOLDER, INCIDENTS, path_of

pytestmark = pytest.mark.one_interpreter


@pytest.mark.mostly_long(short=3)
@pytest.mark.parametrize("name", INCIDENTS)
def test_the_same_is_decided_as_when_it_was_recorded(name: str) -> None:
    replay = Replay(RecordedRules())
    found = list(replay.run(recording.records([path_of(name)])))
    decided = [f"{step.place}: {step.what}" for step in found if isinstance(step, Difference)]
    assert decided == [], "if this is what was wanted: python -m tests.recorded_incidents"
    assert replay.missing == []
    assert replay.steps > 1000
    assert replay.images > 10


def test_nothing_else_is_kept_there() -> None:
    assert sorted(FOLDER.iterdir()) == sorted(path_of(name) for name in INCIDENTS)


def test_together_they_show_all_that_a_visit_can() -> None:
    decisions = [
        item[1]
        for name in INCIDENTS
        for item in recording.records([path_of(name)])
        if not isinstance(item, MissingItem) and isinstance(item[1], Decision)
    ]
    reasons = {decision.reason.name for decision in decisions}
    assert reasons >= {
        "NONE", "TARGET_REACHED", "STOP_LATCHED", "MOVED", "STARTING", "NO_TARGET", "CAMERA_DOWN",
        "RANGER_STUCK", "NO_ECHO", "SENSORS_DISAGREE", "PLC_LOST",
    }  # fmt: skip
    assert {decision.phase.name for decision in decisions} >= {
        "UNKNOWN", "EMPTY", "APPROACHING", "AT_MARK", "IN_PLACE", "HELD", "RELEASED", "LEAVING",
    }  # fmt: skip
