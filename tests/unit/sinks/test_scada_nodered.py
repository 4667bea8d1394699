"""The Node-RED flow: its topics and fields are those of the contract, and its two functions keep its rules.

The functions run in Node.js with a clock of their own. Node-RED itself is not needed here; docs/scada.md describes
what was seen with it.
"""

import json
import random
import re
from pathlib import Path
from typing import Any

import pytest

from gateway.sinks.mqtt import topic_plan
from tests.node_function import run_function
from tools import mqtt

DOCS = Path(__file__).parents[3] / "docs"
FLOW = json.loads((DOCS / "scada" / "node-red-loading-bays.json").read_text(encoding="utf-8"))
NODES = {node["id"]: node for node in FLOW}
JUDGE, ONCE = NODES["lgb-judge"]["func"], NODES["lgb-once"]["func"]

STATE_TOPIC = "loading/site1/bay1/state"
STATUS_TOPIC = "loading/site1/gateway/status"
EVENT_TOPIC = "loading/site1/bay1/event"
EXAMPLES = {name: json.loads(model.model_dump_json()) for name, model in mqtt.examples().items()}
ONLINE = {"topic": STATUS_TOPIC, "payload": json.dumps(EXAMPLES["status"]), "retain": True}
OFFLINE = {"topic": STATUS_TOPIC, "payload": json.dumps(EXAMPLES["will"]), "retain": False}
TICK = {"topic": "tick", "payload": 0}


def state(topic: str = STATE_TOPIC, *, retain: bool = False, **fields: Any) -> dict[str, Any]:
    return {"topic": topic, "payload": json.dumps(EXAMPLES["state"] | fields), "retain": retain}


def free(**more: Any) -> dict[str, Any]:
    fields: dict[str, Any] = {"stop": False, "may_move": True, "reason": {"name": "NONE", "code": 0, "text": ""}}
    return state(**(fields | more))


def judged(*messages: tuple[int, dict[str, Any]]) -> list[tuple[list[Any], list[Any]]]:
    """Views and alarms (payloads) after each message."""
    return [
        ([m["payload"] for m in views], [m["payload"] for m in alarms])
        for (views, alarms), _ in run_function(JUDGE, list(messages))
    ]


def alarm(view: dict[str, Any]) -> tuple[bool, bool, str]:
    return view["alarm"], view["dead"], view["reason"]


# The flow.


def test_what_it_subscribes_to_is_the_topic_plan() -> None:
    filters = {node["topic"]: node for node in FLOW if node["type"] == "mqtt in"}
    plan = {re.sub(r"\{(site|bay|instance)\}", "+", k.pattern).format(root="loading"): k for k in topic_plan.PLAN}
    assert set(filters) == {"loading/+/+/status", "loading/+/+/state", "loading/+/+/event"} <= set(plan)
    assert {node["qos"] for node in filters.values()} == {"1"}


def test_a_retained_message_differs_from_a_live_one() -> None:
    """`Retain as published` would show every state as retained, and every bay as dead."""
    assert [node["rap"] for node in FLOW if node["type"] == "mqtt in"] == [False] * 3


def test_events_have_a_session_that_the_broker_keeps() -> None:
    broker = NODES[NODES["lgb-event"]["broker"]]
    assert broker["cleansession"] is False
    assert broker["clientid"]
    assert NODES[NODES["lgb-state"]["broker"]]["cleansession"] is True


def test_nodes_are_wired_to_each_other() -> None:
    assert len(NODES) == len(FLOW)
    for node in FLOW:
        assert {to for wire in node.get("wires", []) for to in wire} <= set(NODES)
        assert node.get("z", "lgb-tab") == "lgb-tab"
        assert len(node["wires"]) == node["outputs"] if node["type"] == "function" else True


@pytest.mark.parametrize("code", [JUDGE, ONCE], ids=["judge", "once"])
def test_every_field_that_is_read_exists(code: str) -> None:
    known: set[str] = set()

    def collect(value: Any) -> None:
        if isinstance(value, dict):
            known.update(value)
            for inner in value.values():
                collect(inner)

    collect(EXAMPLES)
    read = set(re.findall(r"\b(?:s|event|value)(?:\.[a-z]+)*\.([a-z_0-9]+)\b", code)) - {"slice", "last"}
    assert read, "nothing found"
    assert {name for name in read if name not in known} <= {"lastIndexOf", "slice", "length"}


# When may a bay be trusted?


def test_online_and_a_live_state_are_trusted() -> None:
    *_, (views, alarms) = judged((0, ONLINE), (10, free()))
    (view,) = views
    assert (view["alive"], view["stop"], view["may_move"], view["reason"]) == (True, False, True, "NONE")
    assert (view["radius_px"], view["distance_mm"]) == (180.4, 296.5)
    assert (view["vision"], view["range"], view["vision_hz"], view["range_hz"]) == ("GOOD", "GOOD", 30.0, 20.0)
    assert [alarm(found) for found in alarms] == [(False, False, "NONE")]


def placed(**more: Any) -> dict[str, Any]:
    fields: dict[str, Any] = {"stop": True, "may_move": False, "in_place": True, "held": False, "moved": "NO"}
    return state(**(fields | more))


def test_in_place_is_shown_of_a_live_bay_alone_and_never_beside_may_move() -> None:
    shown = judged(
        (0, ONLINE),
        (10, placed()),
        (10, placed(held=True)),
        (10, placed(may_move=True)),
        (10, placed(stop=False)),
        (10, free(in_place=True)),
        (10, placed(in_place=False, moved="DISTANCE")),
        (10, placed()),
        (9999, TICK),
    )
    views = [view for (views, _) in shown for view in views]
    assert [(view["in_place"], view["may_move"], view["held"], view["moved"]) for view in views] == [
        (True, False, False, "NO"),
        (True, False, True, "NO"),
        (False, False, False, "NO"),
        (False, False, False, "NO"),
        (False, False, False, EXAMPLES["state"]["moved"]),
        (False, False, False, "DISTANCE"),
        (True, False, False, "NO"),
        (False, False, None, None),
    ]
    *_, (_, (gone,)) = shown
    assert (gone["dead"], gone["in_place"], gone["moved"]) == (True, False, None)


def test_a_retained_state_is_not_trusted_however_good_it_looks() -> None:
    (_, (views, alarms)) = judged((0, ONLINE), (0, free() | {"retain": True}))
    (view,) = views
    assert (view["alive"], view["stop"], view["may_move"], view["reason"]) == (False, True, False, "STATE_TOO_OLD")
    assert view["radius_px"] is None
    assert [alarm(found) for found in alarms] == [(True, True, "STATE_TOO_OLD")]


def test_a_state_without_an_online_status_is_not_trusted() -> None:
    ((views, _),) = judged((0, free()))
    assert (views[0]["alive"], views[0]["stop"], views[0]["reason"]) == (False, True, "GATEWAY_OFFLINE")


def test_a_bay_dies_when_its_state_grows_too_old_and_comes_back_with_the_next() -> None:
    limit = EXAMPLES["state"]["stale_after_ms"]
    found = judged((0, ONLINE), (0, free()), (limit - 1, TICK), (1, TICK), (500, TICK), (10, free()))
    assert found[2] == ([], [])
    assert [alarm(a) for a in found[3][1]] == [(True, True, "STATE_TOO_OLD")]
    assert found[4] == ([], [])  # reported once
    assert [alarm(a) for a in found[5][1]] == [(False, False, "NONE")]


def test_a_retained_state_that_comes_again_keeps_nothing_alive() -> None:
    limit = EXAMPLES["state"]["stale_after_ms"]
    found = judged((0, ONLINE), (0, free()), (limit - 10, free() | {"retain": True}), (10, TICK))
    assert [alarm(a) for a in found[3][1]] == [(True, True, "STATE_TOO_OLD")]


def test_the_last_will_counts_at_once_for_all_bays_of_that_gateway_alone() -> None:
    other = free(status_topic="loading/site1/other/status") | {"topic": "loading/site1/bay9/state"}
    online = ONLINE | {"topic": "loading/site1/other/status"}
    found = judged((0, ONLINE), (0, online), (0, free()), (0, other), (1, OFFLINE))
    assert [alarm(a) for a in found[4][1]] == [(True, True, "GATEWAY_OFFLINE")]
    assert [view["bay"] for view in found[4][0]] == ["bay1"]


def test_stop_is_an_alarm_with_its_reason() -> None:
    found = judged((0, ONLINE), (0, free()), (100, state()), (100, free()))
    assert [alarm(a) for _, alarms in found[2:] for a in alarms] == [
        (True, False, "TARGET_REACHED"),
        (False, False, "NONE"),
    ]


def test_a_clock_that_is_set_back_trusts_no_bay() -> None:
    found = judged((0, ONLINE), (0, free()), (-60_000, TICK))
    assert [alarm(a) for a in found[2][1]] == [(True, True, "STATE_TOO_OLD")]


@pytest.mark.parametrize("payload", ["no JSON", "5", "null", "[", '{"status": "online'])
def test_damaged_messages_are_counted_and_change_nothing(payload: str) -> None:
    messages = [(0, ONLINE), (0, free()), (1, {"topic": STATE_TOPIC, "payload": payload, "retain": False})]
    (*_, ((_, alarms), _), ((views, later), status)) = run_function(JUDGE, [*messages, (1, TICK)])
    assert (alarms, views, later, status) == ([], [], [], "1 of 1 bays alive, 1 damaged")


@pytest.mark.parametrize("fields", [{"stop": None}, {"stop": "false"}, {"may_move": "yes"}, {"stale_after_ms": None}])
def test_values_of_another_type_permit_nothing(fields: dict[str, Any]) -> None:
    (_, (views, _)) = judged((0, ONLINE), (0, free(**fields)))
    assert views[0]["may_move"] is False


def test_a_bay_that_was_removed_is_forgotten() -> None:
    removed = {"topic": STATE_TOPIC, "payload": "", "retain": False}
    (*_, ((gone, ended), _), ((views, alarms), status)) = run_function(
        JUDGE, [(0, ONLINE), (0, free()), (1, removed), (9999, TICK)]
    )
    assert (gone, [alarm["payload"]["alarm"] for alarm in ended]) == ([], [False])
    assert (views, alarms, status) == ([], [], "0 of 0 bays alive")


@pytest.mark.parametrize("retained_first", [True, False])
def test_a_bay_that_the_status_of_its_gateway_does_not_list_is_not_shown(retained_first: bool) -> None:
    """Renamed: its last state stays at the broker, where nothing clears it."""
    ghost = (0, free(bay="old") | {"topic": "loading/site1/old/state", "retain": True})
    messages = [ghost, (0, ONLINE)] if retained_first else [(0, ONLINE), ghost]
    *rest, ((views, alarms), status) = run_function(JUDGE, [*messages, (0, free()), (1, TICK)])
    assert (views, alarms, status) == ([], [], "1 of 1 bays alive")
    told = [alarm["payload"] for (_, found), _ in rest for alarm in found if alarm["payload"]["bay"] == "old"]
    assert [(alarm["alarm"], alarm["reason"]) for alarm in told] == (
        [(True, "GATEWAY_OFFLINE"), (False, "REMOVED")] if retained_first else []
    )


def test_the_number_of_bays_is_limited() -> None:
    few = JUDGE.replace("MAX_BAYS = 2000", "MAX_BAYS = 3")
    assert few != JUDGE
    many = [(0, state(f"loading/site1/bay{n}/state", retain=True)) for n in range(5)]
    *_, (_, status) = run_function(few, [*many, (0, many[0][1]), (0, TICK)])
    assert status == "0 of 3 bays alive"


# Each event once.


def event(number: int, boot: str = "9f86d081884c7d65") -> dict[str, Any]:
    return {"topic": EVENT_TOPIC, "payload": json.dumps(EXAMPLES["event"] | {"id": f"{boot}-{number}"})}


def fed(*messages: tuple[int, dict[str, Any]]) -> tuple[list[str], list[dict[str, Any]], str]:
    """Each message comes so many ms later: ids that came through, notices, and the last status."""
    found = run_function(ONCE, list(messages))
    events = [out[0]["payload"]["id"] for out, _ in found if out[0] is not None]
    return events, [notice["payload"] for out, _ in found for notice in out[1] or []], found[-1][1]


def passed(*messages: dict[str, Any]) -> tuple[list[str], list[dict[str, Any]], str]:
    return fed(*((0, message) for message in messages))


def counts(ids: list[str]) -> list[int]:
    return [int(name.rsplit("-", 1)[1]) for name in ids]


MINUTE_MS = 60_000


def test_repetitions_are_dropped_and_order_is_kept() -> None:
    ids, missing, status = passed(event(1), event(2), event(1), event(2), event(3), event(3))
    assert counts(ids) == [1, 2, 3]
    assert (missing, status) == ([], "3 repeated, 0 late, 0 damaged")


def test_what_a_cluster_delivers_late_is_passed_once() -> None:
    """As three nats-servers did when a node was killed: 47 to 51 after 54, and what was on its way a second time."""
    arrived = [*range(1, 47), 52, 53, 54, *range(47, 52), *range(52, 57), 60, 57, 58, 59, *range(57, 110)]
    ids, missing, status = fed(*((1, event(n)) for n in arrived), (2 * MINUTE_MS, TICK))
    assert counts(ids) == list(dict.fromkeys(arrived))
    assert len(ids) == 109
    assert (missing, status) == ([], "7 repeated, 8 late, 0 damaged")


@pytest.mark.long
@pytest.mark.one_interpreter
def test_each_of_any_sequence_is_passed_at_its_first_arrival() -> None:
    randomly = random.Random(6)
    for _ in range(20):
        arrived = [min(max(1, n + randomly.randint(-9, 9)), 90) for n in range(100)]
        ids, missing, _ = fed(*((0, event(n)) for n in arrived), (MINUTE_MS, TICK), (0, TICK))
        assert counts(ids) == list(dict.fromkeys(arrived))
        gone = {n for n in range(arrived[0] + 1, max(arrived)) if n not in arrived}
        ends = [counts([gap["first"], gap["last"]]) for gap in missing]
        assert sorted(n for first, last in ends for n in range(first, last + 1)) == sorted(gone)
        assert [gap["missing"] for gap in missing] == [last - first + 1 for first, last in ends]


def test_a_new_start_of_the_gateway_counts_from_the_beginning() -> None:
    ids, missing, _ = fed((0, event(7, "a1")), (0, event(1, "b2")), (0, event(8, "a1")), (MINUTE_MS, TICK))
    assert ids == ["a1-7", "b2-1", "a1-8"]
    assert missing == []


def test_events_from_before_the_flow_was_started_are_passed_and_are_not_missing() -> None:
    ids, missing, _ = fed((0, event(7)), (0, event(5)), (0, event(5)), (MINUTE_MS, TICK))
    assert (counts(ids), missing) == ([7, 5], [])


def test_a_gap_is_reported_once_when_it_is_still_there_after_a_minute() -> None:
    messages = [(0, event(4, "a1")), (0, event(9, "a1")), (0, event(6, "a1"))]
    assert fed(*messages, (MINUTE_MS - 1, TICK))[1] == []
    ids, missing, _ = fed(*messages, (MINUTE_MS, TICK), (MINUTE_MS, TICK), (0, event(7, "a1")))
    assert missing == [
        {"first": "a1-5", "last": "a1-5", "missing": 1},
        {"first": "a1-7", "last": "a1-8", "missing": 2},
    ]
    assert ids[-1] == "a1-7"  # it was reported, and is not lost when it comes all the same


def test_a_clock_that_is_set_back_does_not_hide_a_gap() -> None:
    assert fed((0, event(1, "a1")), (0, event(3, "a1")), (-1000, TICK))[1] == [
        {"first": "a1-2", "last": "a1-2", "missing": 1}
    ]


@pytest.mark.parametrize(
    "payload",
    ["", "no JSON", "{}", '{"id": 5}', '{"id": "a1-x"}', '{"id": "a1-"}', '{"id": "a1-0"}', '{"id": "5"}', "null"],
)
def test_what_is_no_event_is_counted(payload: str) -> None:
    assert passed({"topic": EVENT_TOPIC, "payload": payload}) == ([], [], "0 repeated, 0 late, 1 damaged")


def test_boots_do_not_fill_the_memory() -> None:
    few = ONCE.replace("MAX_BOOTS = 1000", "MAX_BOOTS = 3")
    assert few != ONCE
    boots = ["first", "b1", "b2", "first", "b3", "b1"]  # b1 was forgotten: the least recently received of four
    messages = [(0, event(n + 1, boot)) for n, boot in enumerate(boots)]
    found = run_function(few, [*messages, (MINUTE_MS, TICK)])
    assert [out[1] for out, _ in found[:-1]] == [None] * 6
    assert found[-1][0][1] == [
        {"topic": "missing/site1/gateway", "payload": {"first": "first-2", "last": "first-3", "missing": 2}}
    ]


def test_gaps_do_not_fill_the_memory_and_lose_nothing() -> None:
    few = ONCE.replace("MAX_GAPS = 200", "MAX_GAPS = 3")
    assert few != ONCE
    arrived = [1, 3, 5, 7, 9, 11, *range(1, 12)]
    found = run_function(few, [(0, event(n)) for n in arrived])
    ids = [int(out[0]["payload"]["id"].rsplit("-", 1)[1]) for out, _ in found if out[0] is not None]
    assert set(ids) == set(range(1, 12))
    assert ids[:6] == [1, 3, 5, 7, 9, 11]
    assert sorted(n for n in ids if ids.count(n) > 1) == [3, 3, 5, 5]  # between gaps that became one
    missing = [notice["payload"]["missing"] for out, _ in found for notice in out[1] or []]
    assert missing == [1, 1, 1]
