"""Recorded incidents are decided again by this version: a change of any decision is a diff that somebody must want."""

import shutil
from pathlib import Path

import pytest

from gateway.core.state import Reason
from gateway.records import account, recording
from gateway.records.inquiry import Inquiry
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


@pytest.mark.mostly_long(short=3)
@pytest.mark.parametrize("name", INCIDENTS)
def test_each_text_of_its_account_has_a_code_or_is_in_the_pages_languages(name: str, tmp_path: Path) -> None:
    shutil.copy(path_of(name), tmp_path)
    inquiry = Inquiry(tmp_path)
    begin_ns, end_ns = inquiry.span()
    for at_ns in (begin_ns, (begin_ns + end_ns) // 2, end_ns):
        answer = inquiry.at(at_ns)
        told = account.as_json(answer, [])
        links = [link[of] for link in (*told["chain"], *told["after"]) for of in ("by", "why") if link[of]]
        causes = [cause["text"] for cause in told["causes"]]
        texts = {told["headline"], *told["warnings"], *causes, *links, *(one["what"] for one in told["done"])}
        without = {text for text in texts - set(told["said"]) if not text.startswith("D = 1: R ")}
        assert without <= set(Reason.meanings().values())
