"""When the certificates of the gateway's own servers end, long before a PLC is refused."""

from datetime import timedelta
from pathlib import Path

import pytest

from gateway.config import GatewayConfig, HmiConfig, ModbusConfig
from gateway.hub import Hub
from gateway.net.certificate_ends import CertificateEnds
from gateway.web.host.status import StatusCollector
from tests.plant_certs import DAYS, NOW, LaterClock, Plant


@pytest.fixture
def plant(tmp_path: Path) -> Plant:
    """Its gateway's certificate ends in 30 days, its authority in ten years."""
    return Plant(tmp_path / "certs")


def config(plant: Plant, *, pages: bool) -> GatewayConfig:
    files = {"tls_cert": f"{plant.folder.path}/gateway.pem", "tls_key": f"{plant.folder.path}/gateway.key"}
    return GatewayConfig(modbus=ModbusConfig(tls=plant.config()), hmi=HmiConfig(enabled=pages, **files))


def test_the_first_that_ends_counts_for_each_server(plant: Plant) -> None:
    clock = LaterClock(days=[0.1])
    ends = CertificateEnds(config(plant, pages=True), clock)
    assert ends.days_left() == {"modbus": DAYS - 1, "hmi": DAYS - 1}
    clock.days.append(DAYS + 0.5)
    assert ends.days_left() == {"modbus": -1, "hmi": -1}
    ends.use(config(plant, pages=False))
    assert ends.days_left() == {"modbus": -1}
    ends.use(GatewayConfig())
    assert (ends.days_left(), ends.warning()) == ({}, "")


def test_the_alarm_s_detail_names_key_file_and_day(plant: Plant) -> None:
    clock = LaterClock(days=[19.0])  # two thirds of its lifetime are over after 20
    made = config(plant, pages=False)
    certificates = CertificateEnds(made, clock)
    status = StatusCollector(made, Hub(["bay1"]), certificates=certificates)
    assert status.conditions().sink_alarms == {}
    clock.days.append(1.5)
    end = NOW + timedelta(days=DAYS)
    detail = f"modbus.tls.cert: {plant.folder.path}/gateway.pem expires on {end:%Y-%m-%d}"
    assert certificates.warning() == detail
    assert status.conditions().sink_alarms == {"certificate_expiring": detail[:120]}
    clock.days.append(DAYS)
    assert "expired on" in certificates.warning()


def test_a_renewed_file_is_seen_and_one_that_cannot_be_read_is_left_out(plant: Plant, tmp_path: Path) -> None:
    clock = LaterClock()
    ends = CertificateEnds(config(plant, pages=False), clock)
    before = ends.days_left()["modbus"]
    Plant(tmp_path / "renewed", NOW.replace(year=NOW.year + 1))
    (tmp_path / "renewed" / "gateway.pem").replace(plant.folder.path / "gateway.pem")
    assert ends.days_left()["modbus"] == before  # not looked at yet
    clock.days.append(1 / 1440)
    assert ends.days_left()["modbus"] > 364
    assert ends.warning() == ""
    (plant.folder.path / "gateway.pem").write_text("no certificate")
    clock.days.append(1 / 1440)
    assert ends.days_left()["modbus"] > 3000  # of the authority
