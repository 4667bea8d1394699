"""Ports, routes and certificates: what comes back for each state of the machine."""

import socket
import struct
import threading
from contextlib import closing
from pathlib import Path

import pytest

from gateway.config import GatewayConfig
from gateway.doctor import network
from gateway.web.ipc.devices import Verdict
from tests.plant_certs import DAYS, LaterClock, Plant

OK, WARNING, FAULT = Verdict.OK, Verdict.WARNING, Verdict.FAULT


def config(**modbus: object) -> GatewayConfig:
    return GatewayConfig.model_validate({"modbus": {"host": "127.0.0.1", "port": 0} | modbus})


def test_a_free_port_is_taken_and_given_back() -> None:
    with closing(socket.socket()) as sock:
        sock.bind(("127.0.0.1", 0))
        port = sock.getsockname()[1]
    for _ in range(2):
        assert [f.verdict for f in network.ports(config(port=port), running=False)] == [OK]


def test_a_port_that_another_program_has() -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        port = server.getsockname()[1]
        found = next(network.ports(config(port=port), running=False))
        assert found.verdict is FAULT
        assert "another program listens there" in found.result
        assert "end that program" in found.remedy
        assert [f.verdict for f in network.ports(config(port=port), running=True)] == [OK]
    gone = next(network.ports(config(port=port), running=True))
    assert (gone.verdict, "refused" in gone.result.lower()) == (FAULT, True)


@pytest.mark.parametrize(("answer", "verdict"), [(b"ACKF\x1c\0\0\0", OK), (b"ERRF\x10\0\0\0", FAULT), (b"", FAULT)])
def test_the_opc_ua_server_must_answer_to_hello(answer: bytes, verdict: Verdict) -> None:
    heard: list[bytes] = []
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        port = server.getsockname()[1]

        def serve() -> None:
            with closing(server.accept()[0]) as sock:
                heard.append(sock.recv(100))
                sock.sendall(answer)

        made = GatewayConfig.model_validate(
            {"modbus": {"port": 0}, "hmi": {"enabled": False}, "opcua": {"port": port, "without_security": True}}
        )
        thread = threading.Thread(target=serve)
        thread.start()
        (found,) = [one for one in network.ports(made, running=True) if one.name == "opcua"]
        thread.join()
    url = f"opc.tcp://127.0.0.1:{port}/".encode()
    assert found.verdict is verdict
    assert bool(found.remedy) is (verdict is FAULT)
    assert heard == [b"HELF" + struct.pack("<7I", 32 + len(url), 0, 65536, 65536, 0, 0, len(url)) + url]


@pytest.mark.parametrize(("days", "verdict"), [(0, OK), (21, WARNING), (31, FAULT)])
def test_the_certificate_of_the_opc_ua_server(tmp_path: Path, days: int, verdict: Verdict) -> None:
    plant = Plant(tmp_path)
    plant.opcua("opcua")
    files = plant.folder
    keys = {"cert": files.certificate_path("opcua"), "key": files.key_path("opcua"), "ca": files.certificate_path("ca")}
    made = GatewayConfig.model_validate({"opcua": {name: str(path) for name, path in keys.items()}})
    found = [one for one in network.certificates(made, LaterClock(days=[days])) if one.name == "opcua"]
    assert [one.verdict for one in found] == [verdict]


def test_an_address_that_this_machine_does_not_have() -> None:
    found = next(network.ports(config(host="192.0.2.77"), running=False))
    assert (found.verdict, found.remedy) == (FAULT, "correct modbus.host or modbus.port")
    assert "does not have that address" in found.result


def routed(*addresses: str, host: str = "127.0.0.1") -> list[tuple[Verdict, str]]:
    found = network.routes(config(plc_addresses=addresses, host=host))
    return [(f.verdict, f.remedy) for f in found]


def test_a_plc_that_reaches_where_the_gateway_listens() -> None:
    assert routed("127.0.0.2", host="127.0.0.1") == [(OK, "")]
    assert routed("127.0.0.0/8", host="0.0.0.0") == [(OK, "")]


def test_a_plc_that_would_connect_to_an_address_where_nothing_listens(monkeypatch: pytest.MonkeyPatch) -> None:
    assert routed("127.0.0.2", host="127.0.0.9") == [(WARNING, 'set modbus.host to "127.0.0.1", or to "0.0.0.0"')]

    def no_route(*_: object) -> None:
        raise OSError(101, "Network is unreachable")

    monkeypatch.setattr(socket.socket, "connect", no_route)
    assert routed("10.0.0.7")[0][0] is FAULT


@pytest.mark.parametrize(("days", "verdict"), [(-1, OK), (19, OK), (21, WARNING), (31, FAULT)])
def test_certificates_that_will_end(tmp_path: Path, days: int, verdict: Verdict) -> None:
    certs = Plant(tmp_path)
    made = config().model_copy(update={"modbus": config().modbus.model_copy(update={"tls": certs.config()})})
    found = list(network.certificates(made, LaterClock(days=[days])))
    assert {f.verdict for f in found} == {verdict}
    if verdict is OK:
        assert found[0].result == f"valid for {DAYS - 1 - days} days"


@pytest.mark.parametrize(("days", "verdict"), [(3600, OK), (3630, WARNING), (3651, FAULT)])
def test_the_authority_of_a_broker(tmp_path: Path, days: int, verdict: Verdict) -> None:
    ca_file = str(Plant(tmp_path).folder.certificate_path("ca"))  # for 3650 days
    made = GatewayConfig.model_validate({"mqtt": {"url": "mqtts://broker", "tls": {"ca_file": ca_file}}})
    assert [f.verdict for f in network.certificates(made, LaterClock(days=[days]))] == [verdict]


def test_the_certificate_of_pages_that_are_off_is_no_finding(tmp_path: Path) -> None:
    certs = Plant(tmp_path).folder
    files = {"tls_cert": str(certs.certificate_path("ca")), "tls_key": str(tmp_path / "none")}
    made = GatewayConfig.model_validate({"hmi": {"enabled": False, **files}})
    assert list(network.certificates(made, LaterClock())) == []


@pytest.mark.parametrize(
    ("host", "verdict", "result"),
    [
        ("127.0.0.1", WARNING, "127.0.0.1: only programs of this machine reach it, no PLC"),
        ("localhost", WARNING, "localhost: only programs of this machine reach it, no PLC"),
        ("0.0.0.0", OK, "a PLC reaches it at 192.0.2.4 or 198.51.100.9"),
        ("192.0.2.4", OK, "a PLC reaches it at 192.0.2.4"),
    ],
)
def test_from_where_a_plc_could_connect(
    monkeypatch: pytest.MonkeyPatch, host: str, verdict: Verdict, result: str
) -> None:
    monkeypatch.setattr(network, "own_addresses", lambda: ["192.0.2.4", "198.51.100.9", "127.0.0.1"])
    found = network.reached(host)
    assert (found.verdict, found.result) == (verdict, result)
    assert ("192.0.2.4 or 198.51.100.9" in found.remedy) == (verdict is WARNING)
