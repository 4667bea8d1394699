"""What the gateway says of itself."""

from pathlib import Path

import psutil
import pytest

from gateway import gateway_facts
from gateway.config import GatewayConfig, parse
from gateway.config.digest import digest
from gateway.core.events import Event, EventKind
from gateway.core.state import StateVector
from gateway.core.visit_summary import VisitSummary
from gateway.gateway_facts import LOOK_NS, FactsCollector, pages_address, reviewed_digest, reviewed_path
from gateway.net import own_host
from gateway.net.certificate_ends import CertificateEnds
from tests.virtual_time import HandClock

CONFIG = parse({"site": "north"})


def test_the_reviewed_digest_stands_beside_the_configuration(tmp_path: Path) -> None:
    source = tmp_path / "gateway.toml"
    found = reviewed_path(str(source))
    assert found == tmp_path / "gateway.toml.reviewed"
    assert reviewed_digest(found) == ""
    found.write_text(f"{'a' * 64}  gateway.toml\n")
    assert reviewed_digest(found) == "a" * 64


@pytest.mark.parametrize("data", [b"", b"a" * 63, b"a" * 65, b"A" * 64, b"\xff" * 64, b"a" * 2000])
def test_what_is_no_digest_is_none(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "x.reviewed"
    path.write_bytes(data)
    assert reviewed_digest(path) == ""


def test_it_follows_the_configuration_in_force_the_file_and_the_visits(tmp_path: Path) -> None:
    now, clock = [CONFIG], HandClock()
    collector = FactsCollector(lambda: now[0], str(tmp_path / "g.toml"), clock, CertificateEnds(CONFIG, clock))
    first = collector.now()
    assert (first.in_force, first.reviewed, first.last_visits) == (digest(CONFIG), "", {})
    now[0] = parse({"site": "south"})
    (tmp_path / "g.toml.reviewed").write_text(digest(CONFIG))
    assert collector.now() is first
    clock.t_ns += LOOK_NS
    later = collector.now()
    assert (later.in_force, later.reviewed) == (digest(now[0]), digest(CONFIG))
    visit = VisitSummary(1_700_000_000_000, 60.0)
    collector.note(Event(EventKind.VISIT, "bay1", 0, StateVector(bay="bay1"), summary=visit))
    assert collector.now().last_visits == {"bay1": visit}


def test_the_digest_is_made_once_of_each_configuration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes a millisecond for each bay, in the loop that decides."""
    made: list[GatewayConfig] = []

    def counted(config: GatewayConfig) -> str:
        made.append(config)
        return digest(config)

    monkeypatch.setattr(gateway_facts, "digest", counted)
    now, clock = [CONFIG], HandClock()
    collector = FactsCollector(lambda: now[0], "", clock, CertificateEnds(CONFIG, clock))
    for config in (CONFIG, CONFIG, parse({"site": "south"})):
        now[0] = config
        clock.t_ns += LOOK_NS
        assert collector.now().in_force == digest(config)
    assert made == [CONFIG, now[0]]


@pytest.mark.parametrize(
    ("hmi", "address"),
    [
        ({}, ""),
        ({"enabled": True, "port": 0}, ""),
        ({"enabled": True}, "http://127.0.0.1:8080/"),
        ({"enabled": True, "base_path": "/bay-1"}, "http://127.0.0.1:8080/bay-1/"),
        ({"enabled": True, "host": "192.0.2.7", "allowed_hosts": ["bay-1.example"], "tls_cert": "c", "tls_key": "k"},
         "https://bay-1.example:8080/"),
    ],
)  # fmt: skip
def test_where_the_pages_are_opened(hmi: dict[str, object], address: str) -> None:
    assert pages_address(parse({"hmi": hmi})) == address


def test_a_system_that_does_not_tell_its_addresses_ends_no_output(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused() -> None:
        raise OSError("no netlink")

    monkeypatch.setattr(psutil, "net_if_addrs", refused)
    monkeypatch.setattr(own_host, "MDNS_SOCKET", Path("/nowhere"))
    config = parse({"hmi": {"enabled": True, "host": "0.0.0.0", "tls_cert": "auto"}})
    assert pages_address(config) == "https://localhost:8080/"
