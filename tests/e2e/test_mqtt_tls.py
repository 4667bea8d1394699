"""TLS towards a broker: renewed certificates are used without a restart, and what is wrong is named."""

import asyncio
import logging
import os
import signal
import subprocess
import time
from datetime import timedelta
from pathlib import Path

import pytest

from gateway import event_loop
from gateway.certs import issue
from gateway.config import MqttTls
from gateway.sinks.mqtt import session
from tests.e2e.brokers import Mosquitto, free_port, program
from tests.e2e.mqtt_plant import Plant
from tests.plant_certs import NOW
from tests.plant_certs import Plant as Certificates

pytestmark = pytest.mark.timeout(120)


@pytest.fixture
def made(tmp_path: Path) -> Certificates:
    made = Certificates(tmp_path / "certs")
    for name in ("first", "second"):
        made.client(name)
    return made


def strict(folder: Path, made: Certificates) -> Mosquitto:
    """It requires a client certificate, and takes its common name for the user's."""
    files = made.folder
    lines = ("require_certificate true", "use_identity_as_username true", f"cafile {files.certificate_path('ca')}")
    return Mosquitto(folder, tls=(files.certificate_path("gateway"), files.key_path("gateway")), lines=lines)


def test_a_renewed_certificate_is_used_at_the_next_connection(tmp_path: Path, made: Certificates) -> None:
    files = made.folder
    tls = MqttTls(
        ca_file=str(files.certificate_path("ca")),
        cert_file=str(tmp_path / "gateway.pem"),
        key_file=str(tmp_path / "gateway.key"),
    )

    def install(name: str) -> None:
        for source, target in ((files.certificate_path(name), "gateway.pem"), (files.key_path(name), "gateway.key")):
            (tmp_path / "new").write_bytes(source.read_bytes())
            os.replace(tmp_path / "new", tmp_path / target)

    async def scenario(broker: Mosquitto) -> None:
        install("first")
        plant = Plant(broker.url, tls=tls)
        async with plant.running():
            await plant.until(lambda: plant.publisher.link.connected, 30)
            assert plant.publisher.link.figures["certificate_days"] in (29, 30)
            assert plant.publisher.link.alarms == {}
            install("second")
            broker.stop()
            await asyncio.to_thread(broker.start)
            await plant.until(lambda: plant.publisher.stats.reconnects == 1, 30)
        broker.stop()  # which writes its log
        assert "u'first'" in broker.log
        assert "u'second'" in broker.log.rpartition("u'first'")[2]

    with strict(tmp_path, made) as broker:
        asyncio.run(scenario(broker))


def test_the_end_of_the_broker_s_own_certificate_is_known_from_the_handshake(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Issued 25 days ago, for 30. Renewed while the connection stands: another handshake shows it."""
    monkeypatch.setattr(session, "CERTIFICATES_S", 0.1)
    monkeypatch.setattr(session, "HANDSHAKE_EVERY", 1)
    files = Certificates(tmp_path / "certs", NOW - timedelta(days=25)).folder
    renewed = issue.server(files.authority(), "gateway", ["127.0.0.1"], files.key("gateway"), NOW, 30)

    async def scenario(broker: Mosquitto) -> None:
        plant = Plant(broker.url, tls=MqttTls(ca_file=str(files.certificate_path("ca"))))
        async with plant.running():
            await plant.until(lambda: plant.publisher.link.connected, 30)
            told = f"the certificate of {broker.url} expires on {NOW + timedelta(days=5):%Y-%m-%d}"
            assert plant.publisher.link.alarms == {"certificate_expiring": told}
            files.replace_certificate("gateway", renewed)
            os.kill(broker.pid, signal.SIGHUP)
            await plant.until(lambda: plant.publisher.link.alarms == {}, 30)
        assert (plant.link_errors, plant.publisher.stats.reconnects) == (0, 0)

    with Mosquitto(tmp_path, tls=(files.certificate_path("gateway"), files.key_path("gateway"))) as broker:
        asyncio.run(scenario(broker))


async def _refused(url: str, tls: MqttTls) -> str:
    plant = Plant(url, tls=tls)
    async with plant.running():
        await plant.until(lambda: plant.link_errors >= 2, 30)
        assert plant.publisher.link.fault == plant.supervisor.records["deliver"].last_error
    return plant.publisher.link.fault


def test_a_broker_that_requires_a_client_certificate_is_named_so(
    tmp_path: Path, made: Certificates, caplog: pytest.LogCaptureFixture
) -> None:
    tls = MqttTls(ca_file=str(made.folder.certificate_path("ca")))
    with strict(tmp_path, made) as broker, caplog.at_level(logging.INFO):
        fault = event_loop.run(_refused(broker.url, tls))
    assert "requires a client certificate" in fault
    assert "mqtt.tls.cert_file and mqtt.tls.key_file" in fault
    assert [record.message for record in caplog.records if record.levelno >= logging.ERROR] == []


@pytest.mark.parametrize("version", ["-tls1_2", "-tls1_3"])
def test_a_tls_alert_is_told_in_words(
    tmp_path: Path, made: Certificates, version: str, caplog: pytest.LogCaptureFixture
) -> None:
    files, port = made.folder, free_port()
    server = subprocess.Popen(
        [
            *(program("openssl"), "s_server", "-accept", str(port), version, "-quiet", "-Verify", "1"),
            *("-cert", str(files.certificate_path("gateway")), "-key", str(files.key_path("gateway"))),
            *("-CAfile", str(files.certificate_path("ca")), "-verify_return_error"),
        ],
        stderr=subprocess.DEVNULL,
    )
    try:
        time.sleep(0.5)
        tls = MqttTls(ca_file=str(files.certificate_path("ca")))
        fault = event_loop.run(_refused(f"mqtts://127.0.0.1:{port}", tls))
    finally:
        server.kill()
        server.wait(10)
    assert "require" in fault
    assert "a client certificate" in fault
    assert "mqtt.tls.cert_file and mqtt.tls.key_file" in fault
    assert [record.message for record in caplog.records if record.levelno >= logging.ERROR] == []


@pytest.mark.parametrize("protocol", ["5", "3.1.1"])
def test_two_gateways_with_one_client_id_are_recognised(tmp_path: Path, protocol: str) -> None:
    """mosquitto 2.0.11 closes the older connection without its reason, with MQTT 5, too."""

    async def scenario(broker: Mosquitto) -> None:
        plants = [Plant(broker.url, bay, instance=bay, client_id="same", protocol=protocol) for bay in ("bay1", "bay2")]
        first, second = plants
        async with first.running(), second.running():
            await first.until(lambda: all("client_id_shared" in p.publisher.link.alarms for p in plants), 60)
            assert all("client id same" in p.publisher.link.alarms["client_id_shared"] for p in plants)

    with Mosquitto(tmp_path) as broker:
        asyncio.run(scenario(broker))


def test_a_session_that_the_broker_reports_as_taken_over_is_recognised_at_once() -> None:
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(4096)  # CONNECT
        writer.write(b"\x20\x03\x00\x00\x00" + b"\xe0\x02\x8e\x00")  # CONNACK, DISCONNECT: session taken over
        await reader.read()
        writer.close()

    async def scenario() -> None:
        async with await asyncio.start_server(serve, "127.0.0.1", 0) as server:
            plant = Plant(f"mqtt://127.0.0.1:{server.sockets[0].getsockname()[1]}", client_id="same")
            async with plant.running():
                await plant.until(lambda: plant.link_errors >= 1, 30)
            link = plant.publisher.link
            assert link.alarms["client_id_shared"] == "another client is connected with our client id same"
            assert link.fault.endswith("ended by the broker: Session taken over by another client")

    asyncio.run(scenario())


def test_a_killed_broker_is_told_without_a_code(tmp_path: Path) -> None:
    async def scenario(broker: Mosquitto) -> str:
        plant = Plant(broker.url)
        async with plant.running():
            await plant.until(lambda: plant.publisher.link.connected, 30)
            broker.kill()
            await plant.until(lambda: plant.link_errors >= 1, 30)
            return plant.publisher.link.fault

    with Mosquitto(tmp_path) as broker:
        fault = asyncio.run(scenario(broker))
    assert "code:128" not in fault
    assert "without a reason" in fault or "refused" in fault
