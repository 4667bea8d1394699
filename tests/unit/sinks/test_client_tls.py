"""Certificates of a client: renewed ones are used, damaged ones are not, and their ends are known."""

import logging
import os
import ssl
from datetime import timedelta
from pathlib import Path

import pytest

from gateway.config import MqttTls
from gateway.sinks.client_tls import ClientCertificates
from tests.plant_certs import DAYS, NOW, Plant

WALL_NS = (int(NOW.timestamp()) + 1) * 1_000_000_000  # after NOW: certificates know whole seconds
DAY_NS = 24 * 3600 * 1_000_000_000


@pytest.fixture
def plant(tmp_path: Path) -> Plant:
    plant = Plant(tmp_path / "certs")
    plant.client("scada")
    return plant


def tls_of(plant: Plant) -> MqttTls:
    folder = plant.folder
    return MqttTls(
        ca_file=str(folder.certificate_path("ca")),
        cert_file=str(folder.certificate_path("scada")),
        key_file=str(folder.key_path("scada")),
    )


def replaced(path: Path, data: bytes) -> None:
    """As a renewal would: a new file of the same name."""
    new = path.with_suffix(".new")
    new.write_bytes(data)
    os.replace(new, path)


def test_files_that_have_changed_are_read_anew_and_others_are_not(plant: Plant, tmp_path: Path) -> None:
    certificates = ClientCertificates("mqtt.tls", tls_of(plant))
    first = certificates.current()
    assert certificates.current() is first is certificates.newest
    other = Plant(tmp_path / "other", now=NOW + timedelta(days=3))
    other.client("scada", now=NOW + timedelta(days=3))
    for name in ("scada", "ca"):
        replaced(plant.folder.certificate_path(name), other.folder.certificate_path(name).read_bytes())
    replaced(plant.folder.key_path("scada"), other.folder.key_path("scada").read_bytes())
    second = certificates.current()
    assert second is not first
    assert certificates.days_left(WALL_NS) == DAYS + 3 - 1  # less the seconds since NOW, rounded down
    assert second.get_ca_certs() != first.get_ca_certs()


def test_a_file_that_is_damaged_leaves_what_was_read_before(plant: Plant, caplog: pytest.LogCaptureFixture) -> None:
    certificates = ClientCertificates("mqtt.tls", tls_of(plant))
    first = certificates.current()
    good = plant.folder.certificate_path("scada").read_bytes()
    replaced(plant.folder.certificate_path("scada"), b"half a ")
    with caplog.at_level(logging.ERROR):
        assert certificates.current() is first
        assert certificates.current() is first
    assert len(caplog.messages) == 1  # not with each connection
    assert caplog.messages[0].startswith("mqtt.tls.cert_file")
    assert caplog.messages[0].endswith("the files read before stay in force")
    replaced(plant.folder.certificate_path("scada"), good)
    assert certificates.current() is not first


@pytest.mark.parametrize(
    ("later_days", "left", "text"),
    [(0, DAYS - 1, ""), (19, 10, ""), (20, 9, "expires on"), (DAYS - 2, 1, "expires on"), (DAYS + 1, -2, "expired on")],
)
def test_the_days_left_and_the_warning(plant: Plant, later_days: int, left: int, text: str) -> None:
    """A third of 30 days is left, or less. The authority's own end is ten years away."""
    certificates = ClientCertificates("mqtt.tls", tls_of(plant))
    now_ns = WALL_NS + later_days * DAY_NS + 1_000_000_000
    assert certificates.days_left(now_ns) == left
    warning = certificates.warning(now_ns)
    assert (text in warning) if text else (warning == "")
    assert warning == "" or warning.startswith(f"mqtt.tls.cert_file: {plant.folder.certificate_path('scada')} ")


def test_without_files_there_is_no_end() -> None:
    certificates = ClientCertificates("mqtt.tls", None)
    assert (certificates.days_left(WALL_NS), certificates.warning(WALL_NS)) == (None, "")
    assert isinstance(certificates.current(), ssl.SSLContext)
