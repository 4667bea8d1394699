"""An examination as a whole: its order, and a part that can't be examined."""

import pytest

from gateway.config import parse
from gateway.doctor import examine, machine
from gateway.web.ipc.devices import Finding, Verdict


def refused() -> Finding:
    raise PermissionError(13, "Permission denied")


def test_a_part_that_cannot_be_examined_hides_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "clock", refused)
    found = list(examine.findings(parse({}), 0.0, beside=True))
    (clock,) = (f for f in found if f.part == "clock")
    assert (clock.verdict, clock.result) == (Verdict.FAULT, "Permission denied")
    parts = [f.part for f in found]
    assert parts.index("clock") < parts.index("disk") < parts.index("processor") < parts.index("priority")


def test_what_may_keep_one_waiting_is_last(monkeypatch: pytest.MonkeyPatch) -> None:
    late = Finding("broker", "", Verdict.FAULT, "", "", "")
    monkeypatch.setattr(examine, "brokers", lambda _: iter([late]))
    found = list(examine.findings(parse({}), 0.0, beside=True))
    assert found[-1] is late
    assert {"versions", "bay", "permission", "port", "plc", "clock", "disk"} <= {f.part for f in found}
