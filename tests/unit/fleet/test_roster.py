"""What the fleet page knows of a gateway from its statuses."""

import json
from typing import Any

import msgspec
import pytest
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import Metric

from gateway.fleet import rows
from gateway.fleet.config import ExpectedGateway
from gateway.fleet.roster import MAX_GATEWAYS, MAX_PAYLOAD_BYTES, GatewayLife, Roster, decoded
from gateway.sinks.mqtt.payloads import encode
from tools import mqtt

KEY = "north", "bay-1"
TOPIC = "loading/north/bay-1/status"


def status(t_ms: int | None = 1000, **changes: Any) -> bytes:
    """Of a gateway whose bay is good and whose configuration is the reviewed one."""
    bay = {
        "bay": "bay-1", "title": "Loading 1", "function_check": "OFF", "ne107": {"name": "GOOD"},
        "reason": {"name": "NONE"}, "veil": 0.1, "marker": {"days_left": 12.0, "worn": False},
        "alarms": {"high": 0, "medium": 1, "low": 2}, "last_visit": {"begun_ms": 60_000, "length_s": 5.0},
    }  # fmt: skip
    own = {"configuration": {"in_force": "a" * 64, "reviewed": "a" * 64, "as_reviewed": True}, "update": None,
           "certificate_days": {"hmi": 80, "mqtt": 20}, "pages": "https://bay-1/"}  # fmt: skip
    given = {"site": "north", "instance": "bay-1", "status": "online", "version": "0.2.0", "timestamp_ms": t_ms,
             "gateway": own, "health": [bay]}  # fmt: skip
    return json.dumps(given | changes).encode()


def last_will() -> bytes:
    return status(None, status="offline", gateway=None, health=[])


def alive(**changes: Any) -> Roster:
    roster = Roster()
    roster.heard(TOPIC, status(1000), 5_000)
    roster.heard(TOPIC, status(2000, **changes), 6_000)
    return roster


def test_a_retained_status_proves_nothing_before_another_one_follows() -> None:
    roster = Roster()
    roster.heard(TOPIC, status(1000), 5_000)
    assert roster.life(KEY, 5_000) is GatewayLife.SILENT
    roster.heard(TOPIC, status(1000), 6_000)  # the retained one again, after a new connection
    assert roster.life(KEY, 6_000) is GatewayLife.SILENT
    roster.heard(TOPIC, status(2000), 7_000)
    assert roster.life(KEY, 7_000) is GatewayLife.ONLINE
    assert roster.life(KEY, 37_000) is GatewayLife.ONLINE
    assert roster.life(KEY, 37_001) is GatewayLife.SILENT


def test_what_the_broker_had_kept_proves_nothing_of_now() -> None:
    """This program had no connection for an hour, and the gateway's last will did not reach the broker."""
    roster = alive()
    roster.heard(TOPIC, status(3000), 3_606_000, retained=True)
    assert roster.life(KEY, 3_606_000) is GatewayLife.SILENT
    assert roster.known[KEY].heard_ms == 6_000
    roster.heard(TOPIC, status(4000), 3_607_000)
    assert roster.life(KEY, 3_607_000) is GatewayLife.ONLINE


def test_an_older_version_again_shows_nothing_of_the_newer_one() -> None:
    roster = alive()
    roster.heard(TOPIC, status(3000, version="0.1.0", gateway=None, health=[]), 7_000)
    (row,) = rows.rows(roster, 7_000)
    assert (row["life"], row["version"], row["bay"], row["ne107"], row["veil"]) == ("online", "0.1.0", "", "", None)


@pytest.mark.parametrize(
    ("topic", "taken"),
    [("loading/north/bay-1/status", True), ("loading/north/area/line/bay-1/status", True),
     ("loading/south/bay-1/status", False), ("loading/south/north/bay-1/status", False),
     ("loading/north/bay-2/status", False), ("loading/north/bay-1/other/status", False)],
)  # fmt: skip
def test_a_gateway_speaks_for_itself_only(topic: str, taken: bool) -> None:
    roster = Roster()
    assert roster.heard(topic, status(), 5_000) == (KEY if taken else None, [])
    assert roster.damaged == (not taken)


def test_the_root_may_have_levels() -> None:
    assert Roster(root="plants/loading").heard("plants/loading/north/bay-1/status", status(), 5_000) == (KEY, [])


def test_a_clock_that_is_wrong_does_not_matter() -> None:
    roster = Roster()
    for n, t_ms in enumerate((9_000_000_000_000, 5)):
        roster.heard(TOPIC, status(t_ms), 5_000 + n)
    assert roster.life(KEY, 5_001) is GatewayLife.ONLINE


def test_a_last_will_is_offline_and_what_was_known_is_kept() -> None:
    roster = alive()
    _, changes = roster.heard(TOPIC, last_will(), 7_000)
    assert [(change.what, change.was, change.now) for change in changes] == [("status", "online", "offline")]
    assert roster.life(KEY, 7_000) is GatewayLife.OFFLINE
    (row,) = rows.rows(roster, 7_000)
    assert (row["version"], row["certificate_days"], row["attention"]) == ("0.2.0", 20, ["offline"])
    assert (row["ne107"], row["alarms"], row["veil"]) == ("", None, None), "nothing of before looks like now"


def test_a_silent_bay_shows_no_health() -> None:
    (row,) = rows.rows(alive(), 40_000)
    assert (row["life"], row["ne107"], row["reason"], row["alarms"], row["veil"]) == ("silent", "", "", None, None)


def test_a_row_of_a_good_bay() -> None:
    (row,) = rows.rows(alive(), 6_000)
    assert row == {
        "site": "north", "instance": "bay-1", "life": "online", "version": "0.2.0",
        "pages": "https://bay-1/", "certificate_days": 20, "deviates": False, "bay": "bay-1", "title": "Loading 1",
        "attention": [], "ne107": "GOOD", "reason": "NONE", "function_check": "OFF", "veil": 0.1, "marker_days": 12.0,
        "alarms": [0, 1, 2], "last_visit_ms": 65_000,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("expected", "deviations"),
    [
        ({KEY: ExpectedGateway(site="north", instance="bay-1", digest="a" * 64, version="0.2.0")}, []),
        ({KEY: ExpectedGateway(site="north", instance="bay-1")}, []),
        ({}, ["not in the inventory"]),
        ({KEY: ExpectedGateway(site="north", instance="bay-1", digest="b" * 64)},
         ["configuration is not that of the inventory"]),
        ({KEY: ExpectedGateway(site="north", instance="bay-1", version="0.3.0")}, ["version 0.2.0 instead of 0.3.0"]),
    ],
)  # fmt: skip
def test_deviations_from_the_inventory(expected: dict[tuple[str, str], ExpectedGateway], deviations: list[str]) -> None:
    roster = alive()
    roster.expected = expected
    assert roster.deviations(KEY) == deviations


def test_what_needs_attention() -> None:
    bay = json.loads(status())["health"][0]
    own = json.loads(status())["gateway"] | {
        "configuration": {"in_force": "b" * 64, "reviewed": "a" * 64, "as_reviewed": False},
        "certificate_days": {"hmi": 80, "mqtt": 13},
        "update": {"stage": "ended", "outcome": "returned"},
    }
    worse = {"ne107": {"name": "FAILURE"}, "alarms": {"high": 2}, "marker": {"days_left": 0, "worn": True}}
    (row,) = rows.rows(alive(gateway=own, health=[bay | worse]), 6_000)
    assert row["attention"] == [
        "configuration is not the reviewed one", "certificate: 13 days left", "an update was not proven",
        "failure", "2 alarms of high priority", "marker worn",
    ]  # fmt: skip


@pytest.mark.parametrize("pages", [None, "javascript:alert(1)", "//elsewhere", "ftp://bay-1/"])
def test_no_link_leads_to_what_is_no_web_address(pages: str | None) -> None:
    own = json.loads(status())["gateway"] | {"pages": pages}
    (row,) = rows.rows(alive(gateway=own), 6_000)
    assert row["pages"] is None


def test_one_that_is_expected_and_never_heard_has_a_row() -> None:
    roster = Roster(expected={KEY: ExpectedGateway(site="north", instance="bay-1")})
    (row,) = rows.rows(roster, 5_000)
    assert (row["site"], row["instance"], row["bay"], row["life"]) == ("north", "bay-1", "", "never heard")
    assert row["attention"] == ["never heard"]


def test_a_status_of_an_older_version_is_a_row_of_its_gateway() -> None:
    roster = Roster()
    for t_ms in (1, 2):
        old = {"site": "north", "instance": "bay-1", "status": "online", "version": "0.1.0", "timestamp_ms": t_ms}
        roster.heard(TOPIC, json.dumps(old).encode(), 5_000)
    (row,) = rows.rows(roster, 5_000)
    assert (row["life"], row["bay"], row["attention"], row["alarms"]) == ("online", "", [], None)


@pytest.mark.parametrize(
    "payload",
    [b"{", b"[]", b'{"site": 1}', b"\xff", b'{"site":"north","instance":"other","status":"online"}',
     b"[" * 100_000, b" " * (MAX_PAYLOAD_BYTES + 1)],
)  # fmt: skip
def test_what_is_no_status_is_counted(payload: bytes) -> None:
    roster = Roster()
    assert roster.heard(TOPIC, payload, 5_000) == (None, [])
    assert (roster.damaged, roster.known) == (1, {})


@pytest.mark.parametrize(
    "bay",
    [{"last_visit": {"begun_ms": 10**400}}, {"last_visit": {"begun_ms": 0, "length_s": 1e308}},
     {"alarms": {"high": 10**400}}, {"alarms": {"low": -1}}, {"title": "x" * 65}, {"bay": ""}],
)  # fmt: skip
def test_a_status_that_can_t_be_shown_is_none(bay: dict[str, Any]) -> None:
    """One of them would be the end of the page and of /metrics, for all gateways."""
    roster = Roster()
    assert roster.heard(TOPIC, status(health=[{"bay": "bay-1"} | bay]), 5_000) == (None, [])
    assert roster.heard(TOPIC, status(health=[{"bay": "bay-1"}] * 65), 5_000) == (None, [])
    assert roster.heard(TOPIC, status(gateway={"certificate_days": {"hmi": 10**400}}), 5_000) == (None, [])
    assert roster.heard(TOPIC, status(version="x" * 65), 5_000) == (None, [])
    assert (roster.damaged, roster.known) == (4, {})


@pytest.mark.parametrize("t_ms", [0, 2**53])
def test_the_greatest_numbers_of_a_status_are_shown(t_ms: int) -> None:
    bay = {"bay": "b" * 64, "alarms": {"high": t_ms}, "last_visit": {"begun_ms": t_ms, "length_s": 1e9}}
    roster = alive(health=[bay], gateway={"certificate_days": {"hmi": -1_000_000}})
    (row,) = json.loads(msgspec.json.encode(rows.rows(roster, 6_000)))
    assert row["last_visit_ms"] == t_ms + 10**12
    text = generate_latest(_Collected(list(rows.metrics(rows.rows(roster, 6_000), {"connected": 1})))).decode()
    assert "loading_fleet_gateway_certificate_days{" in text


class _Collected(CollectorRegistry):
    def __init__(self, found: list[Metric]) -> None:
        super().__init__()
        self._found = found

    def collect(self) -> list[Metric]:
        return self._found


def test_a_gateway_whose_status_is_cleared_at_the_broker_is_gone() -> None:
    roster = alive()
    key, (change,) = roster.heard(TOPIC, b"", 7_000)
    assert (key, change.was, change.now) == (KEY, "online", "cleared at the broker")
    assert roster.gateways() == []
    assert roster.heard(TOPIC, b"", 8_000) == (None, [])
    assert roster.damaged == 0


def test_too_many_gateways_are_counted() -> None:
    roster = alive()
    roster.known |= {("north", str(n)): roster.known[KEY] for n in range(MAX_GATEWAYS - 1)}
    other = status(site="south")
    assert roster.heard("loading/south/bay-1/status", other, 5_000) == (None, [])
    assert (roster.left_out, len(roster.known)) == (1, MAX_GATEWAYS)


def test_a_gateway_s_own_message_is_read_whole() -> None:
    """The contract: what the gateway publishes is what is read here."""
    message = mqtt.examples()["status"]
    found = decoded(encode(message))
    assert found is not None
    assert found.gateway is not None
    (bay,) = found.health
    assert found.gateway.configuration.as_reviewed is True
    assert found.gateway.certificate_days == {"hmi": 83, "mqtt": 61}
    assert (bay.bay, bay.ne107.name, bay.reason.name) == ("bay1", "GOOD", "TARGET_REACHED")
    assert bay.last_visit is not None
    assert bay.last_visit.length_s == 612.4


def samples(found: dict[str, Metric], name: str) -> dict[tuple[str, ...], float]:
    return {tuple(sample.labels.values()): sample.value for sample in found[f"loading_fleet_{name}"].samples}


def test_metrics_have_no_sample_of_what_is_not_known() -> None:
    roster = alive()
    roster.expected = {("north", "gone"): ExpectedGateway(site="north", instance="gone")}
    found = {metric.name: metric for metric in rows.metrics(rows.rows(roster, 6_000), {"connected": 1})}
    assert samples(found, "gateway_up") == {("north", "bay-1"): 1, ("north", "gone"): 0}
    assert samples(found, "gateway_deviates") == {("north", "bay-1"): 1, ("north", "gone"): 0}
    assert samples(found, "gateway_certificate_days") == {("north", "bay-1"): 20}
    assert samples(found, "bay_ne107") == {("north", "bay-1", "bay-1", "good"): 1}
    assert samples(found, "bay_last_visit_timestamp_seconds") == {("north", "bay-1", "bay-1"): 65}
    assert samples(found, "bay_alarms_active") == {
        ("north", "bay-1", "bay-1", priority): n for priority, n in (("high", 0), ("medium", 1), ("low", 2))
    }
    assert samples(found, "connected") == {(): 1}
