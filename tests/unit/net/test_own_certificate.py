"""The machine's own names and addresses, and the certificate that the gateway makes for them."""

import ssl
import time
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from gateway.config import parse
from gateway.errors import ConfigError
from gateway.net import own_certificate, own_host, tls
from gateway.net.tls import TlsFiles
from tests.plant_certs import LaterClock

PAGES = {"hmi": {"enabled": True, "host": "0.0.0.0", "tls_cert": "auto"}}


@pytest.fixture(autouse=True)
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Its name file says `Bay-Pc`, the kernel still another one; its addresses may be changed."""
    addresses = ["192.168.1.50", "127.0.0.1"]
    (tmp_path / "hostname").write_text("Bay-Pc\n")
    monkeypatch.setattr(own_host, "HOSTNAME_FILE", tmp_path / "hostname")
    monkeypatch.setattr(own_host, "MDNS_SOCKET", tmp_path / "avahi")
    monkeypatch.setattr("socket.gethostname", lambda: "raspberrypi.plant.example")
    monkeypatch.setattr(own_host, "own_addresses", lambda: addresses)
    monkeypatch.setattr(own_certificate, "own_addresses", lambda: addresses)
    return addresses


def files(folder: Path) -> TlsFiles:
    found = TlsFiles.of_pages(parse({**PAGES, "state_dir": str(folder / "state")}))
    assert found is not None
    return found


def made(of: TlsFiles) -> x509.Certificate:
    return x509.load_pem_x509_certificate(Path(of.cert).read_bytes())


def test_the_names_of_the_machine_are_those_of_its_file_and_of_the_kernel_and_of_mdns(tmp_path: Path) -> None:
    names = ("bay-pc.local", "bay-pc", "raspberrypi.local", "raspberrypi.plant.example")
    assert own_host.own_names() == names
    found = own_host.request_hosts("::ffff:192.168.1.50")
    assert {*names, "192.168.1.50", "bay-pc-2.local"} <= found
    assert not {"192.168.1.51", "bay-pc-2", "bay-pc.example"} & found
    assert own_host.page_urls(8080) == ["https://192.168.1.50:8080/"]
    (tmp_path / "avahi").touch()
    assert own_host.page_urls(8080) == ["https://bay-pc.local:8080/", "https://192.168.1.50:8080/"]
    (tmp_path / "hostname").write_text("no host's name\n")
    assert own_host.own_names() == ("raspberrypi.local", "raspberrypi.plant.example")


def test_a_certificate_for_names_and_addresses_with_a_key_of_the_gateways_alone(tmp_path: Path) -> None:
    of, clock = files(tmp_path), LaterClock(days=[0.0])
    own_certificate.keep(of, clock)
    certificate = made(of)
    named = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert {"bay-pc.local", "bay-pc", "localhost"} <= set(named.get_values_for_type(x509.DNSName))
    assert {"192.168.1.50", "127.0.0.1", "::1"} == set(map(str, named.get_values_for_type(x509.IPAddress)))
    assert certificate.issuer == certificate.subject
    lasts = certificate.not_valid_after_utc - certificate.not_valid_before_utc
    assert lasts == timedelta(days=825, hours=1)
    assert [Path(path).stat().st_mode & 0o777 for path in (of.key, of.cert)] == [0o600, 0o644]
    tls.check(of)
    Path(of.key).chmod(0o644)  # as a copy was restored
    own_certificate.keep(of, clock)
    assert Path(of.key).stat().st_mode & 0o777 == 0o600
    assert tls.warnings(of, clock.wall_ns()) == []
    trusting = ssl.create_default_context(cadata=certificate.public_bytes(Encoding.PEM).decode())
    assert trusting.cert_store_stats()["x509"] == 1


def test_it_follows_the_machine_and_is_renewed_with_the_same_key(tmp_path: Path, machine: list[str]) -> None:
    of, clock = files(tmp_path), LaterClock(days=[0.0])
    seen = []

    def again() -> bool:
        """Is it another one?"""
        own_certificate.keep(of, clock)
        seen.append(made(of))
        return len(seen) < 2 or seen[-1] != seen[-2]

    assert again()
    assert not again()
    machine[0] = "10.20.0.5"
    assert again()
    machine[0] = "127.0.0.1"  # the cable is out, and in again
    assert not again()
    (tmp_path / "hostname").write_text("bay7\n")
    assert again()
    assert all(one.public_key() == seen[0].public_key() for one in seen)
    clock.days.append(794.0)
    assert not again()
    clock.days.append(2.0)  # 30 days before its end
    assert again()
    clock.days.append(-300.0)  # the clock was wrong
    assert again()
    Path(of.cert).write_text("half a cert")
    assert again()
    Path(of.key).write_text("")
    assert again()
    tls.check(of)


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ({"hmi": {"tls_cert": "auto"}, "state_dir": ""}, '"auto" needs state_dir'),
        ({"hmi": {"tls_cert": "auto", "tls_key": "a.key"}}, "must be absent"),
        ({"hmi": {"tls_cert": "auto", "run_as": "nobody"}}, "run_as must be absent"),
    ],
)
def test_where_it_can_not_be(more: dict[str, object], expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        parse(more)


def test_two_that_make_it_at_the_same_time_make_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    of, clock, inside, most = files(tmp_path), LaterClock(days=[0.0]), [0], [0]

    def names() -> tuple[str, ...]:
        inside[0] += 1
        most[0] = max(most[0], inside[0])
        time.sleep(0.05)
        inside[0] -= 1
        return ("bay-pc",)

    monkeypatch.setattr(own_certificate, "own_names", names)
    with ThreadPoolExecutor(2) as threads:
        for done in [threads.submit(own_certificate.keep, of, clock) for _ in range(2)]:
            done.result()
    tls.check(of)
    assert most == [1]
