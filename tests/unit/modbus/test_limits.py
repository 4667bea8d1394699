"""The connection policy: which clients may connect, and which connections are closed. Time is an argument."""

import resource
from dataclasses import replace

import pytest

from gateway.config import ModbusConfig, parse
from gateway.errors import ConfigError
from gateway.modbus.protocol.answers import Access, Peer, Unit
from gateway.modbus.server.limits import (
    QUIET_S,
    ConnectedWriters,
    ConnectionInfo,
    ConnectionLimits,
    ConnectionVerdict,
    Refusal,
)
from gateway.modbus.server.server import ports_of
from gateway.net.listener import allow_open_files
from gateway.net.rate_limit import plain_address

PLC, OTHER_PLC, SCADA, STRANGER = "10.0.0.7", "10.0.0.8", "10.0.1.5", "192.168.7.7"


def limits(**keys: object) -> ConnectionLimits:
    return ConnectionLimits(ModbusConfig.model_validate(keys))


def connections(address: str, count: int, *, is_plc: bool = False, active_s: float = 0.0) -> list[ConnectionInfo]:
    return [ConnectionInfo(address, is_plc, active_s + n) for n in range(count)]


@pytest.mark.parametrize(
    ("allow", "plcs", "address", "allowed"),
    [
        ((), (), STRANGER, True),
        (("10.0.0.0/16",), (), SCADA, True),
        (("10.0.0.0/16",), (), STRANGER, False),
        (("10.0.1.5",), (PLC,), PLC, True),  # a PLC need not be listed twice
        (("10.0.1.5",), (PLC,), OTHER_PLC, False),
        (("fe80::/10",), (), "fe80::1", True),
        (("fe80::/10",), (), SCADA, False),  # IPv4 is in no IPv6 network
    ],
)
def test_the_allow_list(allow: tuple[str, ...], plcs: tuple[str, ...], address: str, allowed: bool) -> None:
    verdict = limits(allow=allow, plc_addresses=plcs).judge(address, [], 0.0)
    assert verdict == ConnectionVerdict(None if allowed else Refusal.NOT_ALLOWED)


def test_without_plc_addresses_no_connection_is_reserved() -> None:
    rules = limits(max_connections=10, plc_connections=4)
    assert rules.judge(SCADA, connections(STRANGER, 9), 1.0) == ConnectionVerdict()
    assert rules.judge(SCADA, connections(STRANGER, 10, active_s=1.0), 1.0) == ConnectionVerdict(Refusal.FULL)


def test_connections_are_reserved_for_the_plc() -> None:
    rules = limits(max_connections=10, plc_connections=4, plc_addresses=(PLC,))
    assert rules.judge(STRANGER, connections(STRANGER, 5), 1.0) == ConnectionVerdict()
    assert rules.judge(STRANGER, connections(STRANGER, 6, active_s=1.0), 1.0) == ConnectionVerdict(Refusal.FULL)
    for there in range(4):
        crowd = [*connections(STRANGER, 6), *connections(PLC, there, is_plc=True)]
        assert rules.judge(PLC, crowd, 1.0) == ConnectionVerdict()


def test_the_longest_idle_connection_is_replaced_when_it_is_idle_long_enough() -> None:
    rules = limits(max_connections=3)
    crowd = [
        ConnectionInfo(STRANGER, active_s=50.0),
        ConnectionInfo(SCADA, active_s=40.0),
        ConnectionInfo(SCADA, active_s=60.0),
    ]
    assert rules.judge(SCADA, crowd, 40.0 + QUIET_S - 0.01) == ConnectionVerdict(Refusal.FULL)
    assert rules.judge(SCADA, crowd, 40.0 + QUIET_S).instead_of is crowd[1]


def test_one_address_has_its_share_and_no_more() -> None:
    rules = limits()  # the defaults: 64 connections, 16 of them for one address
    there: list[ConnectionInfo] = []
    while rules.judge(STRANGER, there, 1.0) == ConnectionVerdict():
        there.append(ConnectionInfo(STRANGER, active_s=1.0))
    assert len(there) == 16
    assert rules.judge(STRANGER, there, 1.0) == ConnectionVerdict(Refusal.SHARE)
    assert rules.judge(SCADA, there, 1.0) == ConnectionVerdict(), "there is room for others"


def test_an_address_beyond_its_share_replaces_only_its_own_longest_idle_connection() -> None:
    rules = limits(max_connections=8, connections_per_address=2)
    crowd = [
        ConnectionInfo(SCADA, active_s=1.0),
        ConnectionInfo(STRANGER, active_s=9.0),
        ConnectionInfo(STRANGER, active_s=8.0),
    ]
    assert rules.judge(STRANGER, crowd, 8.0 + QUIET_S - 0.01) == ConnectionVerdict(Refusal.SHARE)
    assert rules.judge(STRANGER, crowd, 8.0 + QUIET_S).instead_of is crowd[2]


def test_a_plc_needs_no_share() -> None:
    rules = limits(max_connections=8, connections_per_address=2, plc_addresses=(PLC,))
    for there in range(7):
        assert rules.judge(PLC, connections(PLC, there, is_plc=True), 1.0) == ConnectionVerdict()


def test_no_other_address_can_replace_a_plc() -> None:
    rules = limits(max_connections=4, plc_connections=2, plc_addresses=("10.0.0.0/24",))
    crowd = [*connections(PLC, 4, is_plc=True)]
    assert rules.judge(STRANGER, crowd, 1e6) == ConnectionVerdict(Refusal.FULL)


def test_a_plc_replaces_another_client_even_a_busy_one() -> None:
    rules = limits(max_connections=4, plc_connections=1, plc_addresses=("10.0.0.0/24",))
    crowd = [ConnectionInfo(PLC, True, 1.0), *connections(STRANGER, 3, active_s=100.0)]
    assert rules.judge(OTHER_PLC, crowd, 100.0).instead_of is crowd[1]


def test_a_plc_that_reconnects_replaces_its_own_old_connection_and_no_other_plcs() -> None:
    rules = limits(max_connections=4, plc_connections=4, plc_addresses=("10.0.0.0/24",))
    crowd = [ConnectionInfo(OTHER_PLC, True, 1.0), *connections(PLC, 3, is_plc=True, active_s=2.0)]
    assert rules.judge(PLC, crowd, 9.0).instead_of is crowd[1]
    assert rules.judge("10.0.0.99", crowd, 9.0) == ConnectionVerdict(Refusal.FULL)


@pytest.mark.parametrize(
    ("someone", "now_s", "why"),
    [
        (ConnectionInfo(SCADA), 59.99, None),
        (ConnectionInfo(SCADA), 60.0, Refusal.IDLE),
        (ConnectionInfo(PLC, True), 1e6, None),  # a PLC may be quiet
        (ConnectionInfo(SCADA, active_s=10.0, half_since_s=10.0), 11.99, None),
        (ConnectionInfo(SCADA, active_s=10.0, half_since_s=10.0), 12.0, Refusal.HALF_FRAME),
        (ConnectionInfo(PLC, True, half_since_s=10.0), 12.0, Refusal.HALF_FRAME),
        (ConnectionInfo(SCADA, active_s=10.0, blocked_since_s=10.0), 13.99, None),
        (ConnectionInfo(PLC, True, blocked_since_s=10.0), 14.0, Refusal.NOT_READING),
    ],
)
def test_deadlines(someone: ConnectionInfo, now_s: float, why: Refusal | None) -> None:
    rules = limits(plc_addresses=(PLC,), idle_timeout_s=60, frame_timeout_s=2, send_timeout_s=4)
    assert rules.overdue(someone, now_s) is why


@pytest.mark.parametrize(
    ("given", "plain"),
    [("10.0.0.7", "10.0.0.7"), ("::ffff:10.0.0.7", "10.0.0.7"), ("fe80::1%eth0", "fe80::1"), ("::1", "::1")],
)
def test_addresses_as_the_kernel_gives_them(given: str, plain: str) -> None:
    assert plain_address(given) == plain


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"allow": ["10.0.0.5/24"]}, 'modbus.allow.0 = "10.0.0.5/24": should be an address or a network'),
        ({"plc_addresses": ["plc1"]}, 'modbus.plc_addresses.0 = "plc1": should be an address or a network'),
        ({"connections_per_address": 0}, "modbus.connections_per_address = 0: .*allowed: >= 1, <= 4096"),
        ({"max_connections": 0}, "modbus.max_connections = 0: .*allowed: >= 1, <= 4096"),
        (
            {"max_connections": 4, "plc_connections": 5, "plc_addresses": ["::1"]},
            "modbus.plc_connections = 5: must not be more than max_connections = 4",
        ),
        ({"idle_timeout_s": 0.5}, "modbus.idle_timeout_s = 0.5: .*allowed: >= 1"),
    ],
)
def test_errors_of_the_file(keys: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        parse({"modbus": keys})


def test_open_files(monkeypatch: pytest.MonkeyPatch) -> None:
    now: tuple[int, int] = (1024, 4096)
    monkeypatch.setattr(resource, "getrlimit", lambda _: now)
    asked: list[tuple[int, int]] = []
    monkeypatch.setattr(resource, "setrlimit", lambda _, wanted: asked.append(wanted))

    def allow(connections: int, **ports: object) -> None:
        config = ModbusConfig.model_validate({"max_connections": connections, **ports})
        allow_open_files("modbus.max_connections", config.max_connections, ports_of(config))

    allow(64)
    assert asked == []
    allow(1000)
    assert asked == [(1256, 4096)]
    with pytest.raises(ConfigError, match=r"modbus.max_connections = 4000: needs 4256 open files.*at most 3840"):
        allow(4000)

    asked.clear()
    both = {"cert": "gateway.pem", "key": "gateway.key", "ca": "ca.pem"}
    allow(1000, tls=both)
    assert asked == [(2256, 4096)]
    allow(1000, tls=both, plain=False)
    assert asked[1:] == [(1256, 4096)]
    with pytest.raises(ConfigError, match=r"needs 4256 open files.*at most 1920"):
        allow(2000, tls=both)


WRITER = Peer("10.0.0.9")


def connected_writers() -> tuple[ConnectedWriters, list[tuple[str, str, bool, int]]]:
    reported: list[tuple[str, str, bool, int]] = []
    unit = Unit(list, connection=lambda peer, here, ended: reported.append((peer.address, peer.subject, here, ended)))
    return ConnectedWriters([unit, Unit(list)]), reported


def test_each_connection_of_a_writer_is_reported_and_whether_it_has_one_still() -> None:
    watched, reported = connected_writers()
    for number in (1, 2):
        watched.opened(replace(WRITER, connection=number))
    assert [now for *_, now in reported] == [0, 0]
    for number in (1, 2):
        watched.closed(replace(WRITER, connection=number))
    assert reported[2:] == [("10.0.0.9", "", True, 1), ("10.0.0.9", "", False, 2)]
    assert not watched._open


def test_each_address_and_subject_is_another_writer() -> None:
    watched, reported = connected_writers()
    watched.opened(Peer("10.0.0.9", subject="plc1"))
    watched.opened(Peer("10.0.0.9", subject="plc2"))
    watched.closed(Peer("10.0.0.9", subject="plc1"))
    assert reported[-1] == ("10.0.0.9", "plc1", False, 0)
    assert len(reported) == 3


@pytest.mark.parametrize("access", [Access.NONE, Access.READ])
def test_a_client_that_may_not_write_is_not_reported(access: Access) -> None:
    watched, reported = connected_writers()
    watched.opened(Peer("10.0.0.9", access))
    watched.closed(Peer("10.0.0.9", access))
    assert reported == []
