"""The gate between the rings of the Ansible collection: what it makes of what a gateway says of itself."""

import json
import runpy
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace as changed

from gateway.status_file import BayNow, Status

pytest.importorskip("ansible", reason="only the main interpreter carries it")
pytestmark = pytest.mark.one_interpreter
ROOT = Path(__file__).parents[2]
gate = SimpleNamespace(**runpy.run_path(str(ROOT / "packaging/ansible/plugins/modules/gate.py")))

DIGEST = "ab" * 32
GOOD_BAY = BayNow(vision="good", range="good", phase="empty", function_check="off")
PARAMS: dict[str, Any] = {
    "status_file": None, "status_command": None, "digest": None, "as_reviewed": False, "version": None,
    "restarted": False, "accept_function_check": False, "free": False, "before": None, "accepted_alarms": [],
    "max_age_s": 30.0,
}  # fmt: skip


def status(bay: BayNow = GOOD_BAY, **more: Any) -> Status:
    given: dict[str, Any] = {
        "version": "1.0",
        "pid": 1,
        "t_ns": 0,
        "bays": {"a": bay},
        "boot": "b1",
        "in_force": DIGEST,
    }
    return Status(**given | {"reviewed": DIGEST} | more)


def said(of: Status) -> dict[str, Any]:
    found: dict[str, Any] = gate.of_file(json.loads(msgspec.json.encode(of)))
    return found


def faults(of: Status, **params: Any) -> list[str]:
    found: list[str] = gate.faults(said(of), "", PARAMS | params)
    return found


def test_a_good_gateway_is_as_wanted() -> None:
    wanted = {"digest": DIGEST, "as_reviewed": True, "version": "1.0", "free": True}
    assert faults(status(), **wanted) == []
    assert faults(status(boot="b2"), restarted=True, before=said(status()), **wanted) == []


@pytest.mark.parametrize(
    ("now", "params", "fault"),
    [
        (status(), {"digest": "cd" * 32}, "the configuration in force is abababababab, wanted cdcdcdcdcdcd"),
        (status(reviewed=""), {"as_reviewed": True}, "the reviewed configuration is not stated"),
        (status(), {"version": "1.1"}, "version 1.0, wanted 1.1"),
        (status(), {"restarted": True, "before": said(status())}, "it was not started again"),
        (status(changed(GOOD_BAY, phase="in_place")), {"free": True}, "a: not empty (in_place)"),
        (status(changed(GOOD_BAY, ne107=("failure",))), {}, "a: NE 107 failure"),
        (status(changed(GOOD_BAY, vision="waiting", ne107=("function_check",))), {}, "a: no vision yet"),
        (status(changed(GOOD_BAY, function_check="may_move_off")), {"before": said(status())},
         f"a: {gate.CHECK}"),
        (status(high=("a.camera_down",)), {}, "a.camera_down: new alarm of high priority"),
    ],
)  # fmt: skip
def test_what_is_not_as_wanted_is_named(now: Status, params: dict[str, Any], fault: str) -> None:
    assert faults(now, **params) == [fault]


def test_what_was_so_before_or_is_accepted_holds_nothing_up() -> None:
    bad = status(changed(GOOD_BAY, ne107=("failure",), function_check="may_move_off"), high=("x",))
    assert faults(bad, before=said(bad)) == []
    checked = status(changed(GOOD_BAY, function_check="may_move_off"), high=("x",))
    assert faults(checked, before=said(status()), accept_function_check=True, accepted_alarms=["x"]) == []
    assert faults(changed(checked, high=())) == [], "a bay begins its first start with a function check"


def test_the_file_counts_for_five_seconds(tmp_path: Path) -> None:
    path = tmp_path / "status.json"
    assert gate.read(PARAMS | {"status_file": str(path)}) == (None, f"the gateway does not run: no {path}")
    now_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME)
    path.write_bytes(msgspec.json.encode(status(t_ns=now_ns)))
    assert gate.read(PARAMS | {"status_file": str(path)})[0]["phases"] == {"a": "empty"}
    path.write_bytes(msgspec.json.encode(status(t_ns=now_ns - 6 * 10**9)))
    assert gate.read(PARAMS | {"status_file": str(path)})[1].startswith("the gateway does not run: its status is")
    path.write_text('{"t_ns": "x"}')
    assert gate.read(PARAMS | {"status_file": str(path)})[1].startswith("not a status of this version")


def example() -> dict[str, Any]:
    """The status of docs/mqtt.md, which is generated."""
    text = (ROOT / "docs/mqtt.md").read_text().split("<!-- generated: example status -->")[1]
    found: dict[str, Any] = json.loads(text.split("```json")[1].split("```")[0])
    return found


def by_mqtt(document: dict[str, Any], **params: Any) -> tuple[dict[str, Any] | None, str]:
    found: tuple[dict[str, Any] | None, str] = gate.read(
        PARAMS | {"status_command": ["echo", json.dumps(document)]} | params
    )
    return found


def test_the_status_over_mqtt_says_the_same() -> None:
    found, _ = by_mqtt(example() | {"timestamp_ms": time.time() * 1000})
    assert found is not None
    assert (found["version"], found["boot"]) == ("0.1.0", "9f86d081884c7d65")
    assert found["in_force"] == found["reviewed"] == "3f5a" * 16
    assert (found["faults"], found["checks"], found["high"]) == ({"bay1": []}, [], {"bay1": 1})


@pytest.mark.parametrize(
    ("other", "why"),
    [
        ({"status": "offline", "cause": "connection lost"}, "the gateway is offline: connection lost"),
        ({"timestamp_ms": 0}, "the gateway is silent"),
        ({"health": [{"bay": "a"}]}, "not a status of this version"),
    ],
)
def test_a_status_over_mqtt_that_does_not_count(other: dict[str, Any], why: str) -> None:
    found, reason = by_mqtt(example() | {"timestamp_ms": time.time() * 1000} | other)
    assert found is None
    assert reason.startswith(why)


def test_a_sensor_that_waits_is_no_function_check() -> None:
    document = example() | {"timestamp_ms": time.time() * 1000}
    document["health"][0]["ne107"]["active"] = ["FUNCTION_CHECK"]
    found, _ = by_mqtt(document)
    assert found is not None
    assert (found["faults"], found["checks"]) == ({"bay1": ["a sensor has not begun yet"]}, [])
    document["health"][0]["function_check"] = "MAY_MOVE_OFF"
    found, _ = by_mqtt(document)
    assert found is not None
    assert (found["faults"], found["checks"]) == ({"bay1": []}, ["bay1"])
