"""What a certificate allows."""

from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID

from gateway.certs import issue
from gateway.certs.client_certificate import role_extension
from gateway.clock import SystemClock
from gateway.config import OpcuaConfig, parse
from gateway.errors import ConfigError
from gateway.opcua.access import ClientAccess, OpcuaCaller
from tests.plant_certs import DAYS, NOW, LaterClock, Plant


@pytest.fixture
def plant(tmp_path: Path) -> Plant:
    return Plant(tmp_path)


def config(plant: Plant, **more: object) -> OpcuaConfig:
    files = plant.folder
    return OpcuaConfig.model_validate(
        {
            "cert": str(files.certificate_path("gateway")),
            "key": str(files.key_path("gateway")),
            "ca": str(files.certificate_path("ca")),
            "crl": str(files.crl_path),
        }
        | more
    )


def der(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(Encoding.DER)


def test_the_role_in_the_certificate_decides(plant: Plant) -> None:
    viewer, operator, cleaner, nobody = (
        der(plant.client(name, role))
        for name, role in (("v", "viewer"), ("o", "operator"), ("c", "cleaner"), ("n", None))
    )
    reads = ClientAccess(config(plant), SystemClock())
    writes = ClientAccess(config(plant, writes=True), SystemClock())

    assert reads.of(viewer) == OpcuaCaller("v", "viewer")
    assert reads.of(operator) == OpcuaCaller("o", "operator")
    assert writes.of(operator) == OpcuaCaller("o", "operator", writes=True)
    assert writes.of(viewer) == OpcuaCaller("v", "viewer")
    assert writes.of(cleaner) is writes.of(nobody) is None


def test_what_is_not_of_the_plant_now_may_do_nothing(plant: Plant, tmp_path: Path) -> None:
    good, gone = plant.client("good"), plant.client("gone")
    plant.revoke(gone)
    (tmp_path / "other").mkdir()
    stranger = Plant(tmp_path / "other" / "certs").client("good")
    key = issue.new_key()
    builder = issue._end_entity(plant.by, "mes", key, NOW, DAYS, ExtendedKeyUsageOID.SERVER_AUTH, "")
    signed = builder.add_extension(role_extension("operator"), critical=False)
    as_server = signed.sign(plant.by.key, hashes.SHA256())
    clock = LaterClock()
    access = ClientAccess(config(plant), clock)

    assert access.of(der(good)) is not None
    for refused in (der(gone), der(stranger), der(as_server), der(good)[:-1], b"\x30\x03", b"no certificate"):
        assert access.of(refused) is None
    clock.days.append(DAYS + 1)
    assert access.of(der(good)) is None
    clock.days.append(-DAYS - 1 - 1)
    assert access.of(der(good)) is None  # not valid yet


def test_a_clients_certificate_signs_no_other(plant: Plant) -> None:
    key = issue.new_key()
    client = issue.client(plant.by, "mallory", "viewer", key, NOW, DAYS)
    forged = issue.client(replace(plant.by, certificate=client, key=key), "mes", "operator", key, NOW, DAYS)
    path = plant.folder.certificate_path("ca")
    path.write_bytes(path.read_bytes() + client.public_bytes(Encoding.PEM))  # even where it is listed by mistake

    assert ClientAccess(config(plant), SystemClock()).of(der(forged)) is None


def test_without_a_certificate_one_may_read_at_most_and_only_where_that_is_configured(plant: Plant) -> None:
    for empty in (None, b""):
        assert ClientAccess(config(plant, writes=True), SystemClock()).of(empty) is None
        open_to_all = ClientAccess(config(plant, writes=True, without_security=True), SystemClock())
        assert open_to_all.of(empty) == OpcuaCaller()
    assert ClientAccess(OpcuaConfig(without_security=True), SystemClock()).of(None) == OpcuaCaller()


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        ({}, "opcua.cert"),
        ({"cert": "a.pem", "key": "a.key"}, "opcua.cert"),
        ({"without_security": True, "writes": True}, "opcua.writes"),
        ({"without_security": True, "max_connections": 0}, "opcua.max_connections"),
    ],
)
def test_settings_that_can_not_work_are_refused(settings: dict[str, object], key: str) -> None:
    with pytest.raises(ConfigError, match=key):
        parse({"opcua": settings})
    assert parse({}).opcua is None


def test_an_authority_is_needed_for_as_long_as_it_is_valid(plant: Plant) -> None:
    key = issue.new_key()
    short = issue.authority("Plant", key, NOW, 1)
    made = issue.client(issue.Authority(short, key), "mes", "operator", key, NOW, 1)
    plant.folder.certificate_path("ca").write_bytes(short.public_bytes(Encoding.PEM))
    clock = LaterClock()
    access = ClientAccess(config(plant, crl=None), clock)
    assert access.of(der(made)) is not None
    clock.days.append(timedelta(days=2) / timedelta(days=1))
    assert access.of(der(made)) is None
