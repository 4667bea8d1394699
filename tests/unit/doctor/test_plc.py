"""The gateway's own Modbus port as the doctor tries it: what each kind of answer is called."""

import math
import re
import socket
import struct
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing

import pytest

from gateway.clock import SystemClock
from gateway.config import GatewayConfig, parse
from gateway.core.readings import Quality
from gateway.core.state import Moved, Reason
from gateway.doctor import examine, plc
from gateway.modbus.registers.register_map import BLOCK_WORDS, MAP_VERSION, REGISTERS
from gateway.shared_state import SharedVector
from gateway.web.ipc.devices import Finding, Verdict
from tests.virtual_time import BlockingClock

ADDRESS = {register.name: register.address for register in REGISTERS}
Answer = Callable[[int], bytes | None]  # to the request of this number; None: the connection ends


def answered(server: socket.socket, answer: Answer) -> None:
    """Of one connection, each request of 12 bytes."""
    with closing(server), closing(server.accept()[0]) as sock:
        for number in range(10):
            if not sock.recv(12) or (pdu := answer(number)) is None:
                return
            sock.sendall(struct.pack(">HHHB", 1, 0, len(pdu) + 1, 1) + pdu)


def block(heartbeat: int, more: Mapping[str, int] | None = None) -> bytes:
    values = [0] * BLOCK_WORDS
    values[ADDRESS["map_version"]] = MAP_VERSION
    values[ADDRESS["heartbeat"]] = heartbeat
    values[ADDRESS["stop"]] = 1
    for name, value in (more or {}).items():
        values[ADDRESS[name]] = value
    values[40:42] = 0x1234, 0x5678  # the known value that shows the order of words
    return struct.pack(f">BB{BLOCK_WORDS}H", 3, 2 * BLOCK_WORDS, *values)


@pytest.fixture
def served() -> Iterator[Callable[[Answer], int]]:
    threads: list[threading.Thread] = []

    def serve(answer: Answer) -> int:
        server = socket.create_server(("127.0.0.1", 0))
        port: int = server.getsockname()[1]
        threads.append(threading.Thread(target=answered, args=(server, answer)))
        threads[-1].start()
        return port

    yield serve
    for thread in threads:
        thread.join(10)
        assert not thread.is_alive()


def port_line(config: dict[str, object], port: int | None) -> Finding:
    made = GatewayConfig.model_validate({"modbus": {"host": "127.0.0.1", **config}})
    (found,) = (f for f in plc.findings(made, port, BlockingClock(0)) if f.part == "port")
    return found


@pytest.mark.parametrize(
    ("step", "verdict", "result"),
    [
        (1, Verdict.OK, "it answers; the heartbeat runs; stop is 1, reason 0"),
        (0, Verdict.FAULT, "it answers, but its heartbeat stands at 7"),
    ],
)
def test_the_heartbeat(served: Callable[[Answer], int], step: int, verdict: Verdict, result: str) -> None:
    found = port_line({}, served(lambda number: block(7 + step * number)))
    assert (found.verdict, found.result) == (verdict, result)


def test_a_connection_that_is_refused_by_the_list_of_addresses_is_normal(served: Callable[[Answer], int]) -> None:
    refused = port_line({"allow": ["10.0.0.7"]}, served(lambda _: None))
    assert (refused.verdict, refused.remedy) == (
        Verdict.WARNING,
        "modbus.allow lacks this machine: normal; try it with the PLC",
    )
    assert port_line({}, served(lambda _: None)).verdict is Verdict.FAULT


def test_an_exception_is_a_fault(served: Callable[[Answer], int]) -> None:
    found = port_line({}, served(lambda _: bytes([0x83, 0x0B])))
    assert (found.verdict, found.result) == (Verdict.FAULT, "it answers with exception 0B")


def test_no_open_port() -> None:
    found = port_line({}, None)
    assert (found.verdict, found.result) == (Verdict.WARNING, "no port for plain Modbus TCP is open")


@pytest.mark.parametrize(
    ("answer", "verdicts", "results"),
    [
        (
            block(7, {"rangers": 0b0001_0011}),
            [Verdict.OK, Verdict.WARNING, Verdict.FAULT],
            [
                "ranger 1, /dev/ttyUSB0: good; the bay's distance rests on it",
                "ranger 2, /dev/ttyUSB1: good, but too few others agree with it",
                "ranger 3, /dev/ttyUSB2: no fresh, valid distance",
            ],
        ),
        (
            block(7, {"rangers": 0b0111_0000}),
            [Verdict.OK] * 3,
            [f"ranger {n + 1}, /dev/ttyUSB{n}: it has no echo, and the bay rests on that" for n in range(3)],
        ),
        (bytes([0x83, 0x0B]), [Verdict.WARNING], ["it answers with exception 0B"]),
        (None, [Verdict.WARNING], ["it has no port for plain Modbus TCP that is known"]),
    ],
)
def test_the_rangers_of_a_gateway_that_runs_one_by_one(
    served: Callable[[Answer], int], answer: bytes | None, verdicts: list[Verdict], results: list[str]
) -> None:
    port = served(lambda _: answer) if answer else 0
    more = [{"port": "/dev/ttyUSB1"}, {"port": "/dev/ttyUSB2"}]
    config = GatewayConfig.model_validate(
        {
            "modbus": {"host": "127.0.0.1", "port": port},
            "bays": [{"ranger": {"port": "/dev/ttyUSB0", "more": more}}],
        }
    )
    nan = math.nan
    vector = SharedVector("bay1", 1, 7, 0, 0, 0, 0, 33, nan, nan, nan, nan, nan, Quality.NO_TARGET, Quality.UNSTABLE,
                          Reason.RANGERS_DISAGREE, None, True, False, False, Moved.NO)  # fmt: skip
    found = list(examine._bay(config, config.bays[0], vector, SystemClock(), 0, beside=True))
    each = [one for one in found if one.part == "ranger"][1:]
    assert [one.verdict for one in each] == verdicts
    assert [one.result for one in each] == results


@pytest.mark.parametrize(
    ("beacon", "latency", "said", "relay", "wire"),
    [
        (2, 85, "PROVEN: .* 85 ms from the LED", 0b001011, "by its pins in_place is on$"),
        (3, 900, "LATE: .* 900 ms from the LED", 0b111001, "in_place and may_move is on, which is not"),
        (4, 0xFFFF, "LOST: the pictures no longer show the code$", 0, "its outputs are not reported"),
    ],
)
def test_beacon_and_relay_of_a_running_gateway(
    served: Callable[[Answer], int], beacon: int, latency: int, said: str, relay: int, wire: str
) -> None:
    shown = {"beacon_status": beacon, "beacon_latency": latency, "relay_status": relay}
    hcsr04 = {"beacon": True, "relay": True}
    config = parse(
        {"camera": {"beacon": {"u_px": 9, "v_px": 9}}, "ranger": {"hcsr04": hcsr04}, "fusion": {"period_s": 0.02}}
    )
    found = list(plc.of_bay(config, config.bays[0], served(lambda _: block(7, shown))))
    assert [one.part for one in found] == ["beacon", "relay"]
    assert {one.verdict for one in found} == {Verdict.OK if beacon == 2 else Verdict.FAULT}
    assert re.search(said, found[0].result)
    assert re.search(wire, found[1].result)
    assert [bool(one.remedy) for one in found] == [beacon != 2] * 2


@pytest.mark.parametrize(
    ("shown", "more", "said", "remedy"),
    [
        ({"reason": Reason.GATEWAY_FAULT, "range_quality": Quality.STALE}, [], "control task does not run", "log"),
        ({"reason": Reason.SHUTDOWN}, [{"port": "/dev/b"}], "shutting down", "log"),
        ({"range_quality": Quality.LINK_DOWN}, [], "LINK_DOWN, ", "ranger first"),
        ({"range_quality": Quality.STALE, "beacon_status": 4}, [], "STALE, ", "ranger first"),
        (
            {"rangers": 0b0110_0110},
            [{"port": "/dev/b"}, {"port": "/dev/c"}],
            "its ranger: no fresh, valid",
            "ranger first",
        ),
        ({"range_quality": Quality.NO_ECHO}, [], "not reported|no beacon", "firmware on|this beacon"),
    ],
)
def test_what_is_dead_is_said_before_beacon_and_relay_are_blamed(
    served: Callable[[Answer], int], shown: dict[str, int], more: list[dict[str, str]], said: str, remedy: str
) -> None:
    ranger = {"port": "/dev/a", "hcsr04": {"beacon": True, "relay": True}, "more": more}
    config = parse({"camera": {"beacon": {"u_px": 9, "v_px": 9}}, "ranger": ranger, "fusion": {"period_s": 0.02}})
    found = list(plc.of_bay(config, config.bays[0], served(lambda _: block(7, shown))))
    judged = [one for one in found if one.part in ("beacon", "relay") or "log" in remedy]
    assert len(judged) >= 2
    assert {one.verdict for one in judged} == {Verdict.FAULT}
    assert [one.result for one in judged if not re.search(said, one.result)] == []
    assert [one.remedy for one in judged if not re.search(remedy, one.remedy)] == []


def test_without_beacon_and_relay_nothing_is_read_and_without_a_port_nothing_is_known() -> None:
    config = parse({"camera": {"beacon": {"u_px": 9, "v_px": 9}}, "ranger": {"hcsr04": {"beacon": True}}})
    (found,) = plc.of_bay(config, config.bays[0], 0)
    assert (found.part, found.verdict) == ("beacon", Verdict.WARNING)
    plain = parse({})
    assert list(plc.of_bay(plain, plain.bays[0], 0)) == []
