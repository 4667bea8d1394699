"""The Ansible collection in packaging/ansible: real runs against gateways on this machine."""

import re
import shutil
import socket
import ssl
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.e2e.ansible_boxes import Boxes
from tests.e2e.brokers import free_port
from tests.e2e.processes import command
from tests.e2e.sim_ranger import Ranger
from tests.e2e.test_doctor import draw_truck

pytestmark = [pytest.mark.long, pytest.mark.timeout(600), pytest.mark.xdist_group("ansible")]

NAMES = ["bay-1", "bay-2"]
SETTINGS = """\
site = "north"
instance = "{name}"
log_level = "{level}"
[modbus]
port = {port}
[camera]
url = "{camera}"
loop = {loop}
fps = 4
[fusion]
vision_deadline_s = 10
range_deadline_s = 10
start_grace_s = 300
distance_threshold_mm = 300
[ranger]
port = "{ranger}"
"""
TLS = """\
[modbus.tls]
port = {port}
cert = "{folder}/gateway.pem"
key = "{folder}/gateway.key"
ca = "{folder}/ca.pem"
crl = "{folder}/crl.pem"
"""


class Plant(Boxes):
    """Each with a folder of pictures as its camera."""

    camera: Path
    ranger = "/dev/ttyACM0"

    def review(self, name: str, more: str = "", **changed: object) -> None:
        values = {"camera": self.camera, "level": "info", "ranger": self.ranger, "port": 502} | changed
        values["loop"] = str(values["camera"] == self.camera).lower()
        (self.folder / f"gateways/{name}.toml").write_text(SETTINGS.format(name=name, **values) + more)

    def certify(self, days: int, **extra: object) -> "subprocess.CompletedProcess[str]":
        program = [sys.executable, "-m", "gateway", "certs"]
        return self.play("certificates", certificate_days=days, certs_command=program, **extra)

    def digests(self) -> dict[str, tuple[str, str]]:
        return {name: box.digests() for name, box in self.boxes.items()}

    def starts(self) -> dict[str, int]:
        return {name: box.starts for name, box in self.boxes.items()}


def recap(done: "subprocess.CompletedProcess[str]") -> dict[str, dict[str, int]]:
    lines = re.findall(r"^(\S+)\s+: (ok=.*)$", done.stdout, re.MULTILINE)
    return {name: {key: int(n) for key, n in re.findall(r"(\w+)=(\d+)", counts)} for name, counts in lines}


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    """Configured."""
    folder = tmp_path_factory.mktemp("ansible")
    (folder / "truck").mkdir()
    with Plant(folder, NAMES) as made:
        made.camera = folder / "truck"
        for name in NAMES:
            made.review(name)
        done = made.play("configure", rings=["100%"])
        assert done.returncode == 0, done.stdout + done.stderr
        digests = made.digests()
        assert all(there == reviewed for there, reviewed in digests.values())
        assert list(recap(done)) == NAMES
        yield made


def test_a_setting_that_check_accepts_and_the_camera_does_not_goes_back_in_the_first_ring(plant: Plant) -> None:
    digests, starts = plant.digests(), plant.starts()
    for name in NAMES:
        plant.review(name, camera="/dev/video77")
    done = plant.play("configure", within_s=2)
    assert done.returncode == 2, done.stdout
    assert "bay-1: back at what it was. Not proven: bay-1: bay1: NE 107 failure" in done.stdout
    assert list(recap(done)) == ["bay-1"]
    assert plant.digests() == digests
    assert plant.starts() == starts | {"bay-1": starts["bay-1"] + 2}, "no gateway of a later ring was started again"
    assert not list((plant.folder / "boxes").rglob("*.former*"))


def test_the_same_again_changes_nothing(plant: Plant) -> None:
    for name in NAMES:
        plant.review(name)
    digests, starts = plant.digests(), plant.starts()
    done = plant.play("configure", rings=["100%"])
    assert done.returncode == 0, done.stdout
    assert {(row["changed"], row["failed"]) for row in recap(done).values()} == {(0, 0)}
    assert (list(recap(done)), plant.digests(), plant.starts()) == (NAMES, digests, starts)


def test_all_of_a_ring_go_back_where_one_is_not_proven(plant: Plant) -> None:
    digests = plant.digests()
    plant.review("bay-1", level="warning")
    plant.review("bay-2", camera="/dev/video77")
    done = plant.play("configure", within_s=2, rings=["100%"])
    assert done.returncode == 2, done.stdout
    assert "bay-1: back at what it was. Not proven: bay-2: bay1: NE 107 failure" in done.stdout
    assert plant.digests() == digests


def test_what_was_changed_on_the_gateway_is_not_lost(plant: Plant) -> None:
    for name in NAMES:
        plant.review(name, level="error")
    config = plant.boxes["bay-1"].config
    taught = config.read_text().replace('log_level = "info"', 'log_level = "debug"')
    config.write_text(taught)
    done = plant.play("configure")
    assert done.returncode == 2
    assert "gateway.toml was changed on the gateway since it was reviewed" in done.stdout
    assert config.read_text() == taught
    done = plant.play("configure", "--limit", "bay-1", overwrite=True)
    assert done.returncode == 0, done.stdout
    assert len(set(plant.boxes["bay-1"].digests())) == 1
    assert 'log_level = "error"' in config.read_text()


def test_certificates_are_made_renewed_and_returned_to(plant: Plant) -> None:
    authority = plant.folder / "authority"
    assert command("certs", "init", str(authority)).code == 0
    done = plant.certify(30, rings=["100%"])
    assert done.returncode == 0, done.stdout
    files = [box.config.parent / "certs/gateway.pem" for box in plant.boxes.values()]
    first = [file.read_bytes() for file in files]
    assert first == [(authority / f"{name}.pem").read_bytes() for name in NAMES]
    for name in NAMES:
        plant.review(name, TLS.format(port=802, folder=plant.boxes[name].config.parent / "certs"))
    done = plant.play("configure", rings=["100%"], overwrite=True)
    assert done.returncode == 0, done.stdout
    starts = plant.starts()
    done = plant.certify(30, rings=["100%"])
    assert done.returncode == 0, done.stdout
    assert {row["changed"] for row in recap(done).values()} == {0}, "30 of 30 days are left"

    revoked = authority / "crl.pem"
    good = revoked.read_bytes()
    revoked.write_text("damaged")
    done = plant.certify(90)
    assert done.returncode == 2, done.stdout
    assert "bay-1: back at what it was. Not proven: bay-1: non-zero return code: " in done.stdout
    assert list(recap(done)) == ["bay-1"]
    assert [file.read_bytes() for file in files] == first
    assert files[0].with_name("crl.pem").read_bytes() == good

    revoked.write_bytes(good)
    done = plant.certify(90)
    assert done.returncode == 0, done.stdout
    assert [file.read_bytes() for file in files] == [(authority / f"{name}.pem").read_bytes() for name in NAMES]
    assert all(file.read_bytes() != old for file, old in zip(files, first, strict=True)), "30 of 90 days were left"
    assert plant.starts() == starts, "no gateway was started again"
    assert {path.name for file in files for path in file.parent.iterdir()} == {
        "ca.pem", "crl.pem", "gateway.key", "gateway.pem"
    }  # fmt: skip


def read_stop(sock: socket.socket) -> None:
    """One Modbus request, answered."""
    sock.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, 4, 1))
    answer = b""
    while len(answer) < 11:
        some = sock.recv(11 - len(answer))
        assert some, "the connection was closed"
        answer += some
    assert answer[7] == 3


def test_a_renewed_certificate_interrupts_no_client_and_is_shown_to_the_next(tmp_path: Path) -> None:
    (tmp_path / "truck").mkdir()
    authority, ports = tmp_path / "authority", {"port": free_port(), "tls": free_port()}
    for words in (
        ("init", str(authority)),
        ("server", "--dir", str(authority), "--name", "bay-1", "--host", "127.0.0.1", "--days", "30"),
        ("client", "plc", "--dir", str(authority)),
    ):
        assert command("certs", *words).code == 0
    context = ssl.create_default_context(cafile=str(authority / "ca.pem"))
    context.load_cert_chain(authority / "plc.pem", authority / "plc.key")

    def dial() -> ssl.SSLSocket:
        plain = socket.create_connection(("127.0.0.1", ports["tls"]), timeout=30)
        return context.wrap_socket(plain, server_hostname="127.0.0.1")

    def shown(sock: ssl.SSLSocket) -> str:
        return ssl.DER_cert_to_PEM_cert(sock.getpeercert(binary_form=True) or b"")

    with Ranger() as ranger, Plant(tmp_path, ["bay-1"], real=True) as plant, ExitStack() as stack:
        ranger.distance_mm = 270.0
        plant.camera, plant.ranger = draw_truck(tmp_path / "truck", 27), ranger.port
        certs = plant.boxes["bay-1"].config.parent / "certs"
        shutil.copytree(authority, certs)
        for end in ("pem", "key"):
            (certs / f"bay-1.{end}").rename(certs / f"gateway.{end}")
        plant.review("bay-1", TLS.format(port=ports["tls"], folder=certs), port=ports["port"])
        done = plant.play("configure")
        assert done.returncode == 0, done.stdout

        former = (certs / "gateway.pem").read_text()
        plain = stack.enter_context(socket.create_connection(("127.0.0.1", ports["port"]), timeout=30))
        secure = stack.enter_context(dial())
        assert shown(secure) == former
        with ThreadPoolExecutor() as threads:
            renewing = threads.submit(plant.certify, 90)
            asked = 0
            while not renewing.done():
                read_stop(plain)
                read_stop(secure)
                asked += 1
                wait([renewing], 0.05)
        assert renewing.result().returncode == 0, renewing.result().stdout
        assert asked > 1
        assert (certs / "gateway.pem").read_text() != former
        for _ in range(600):
            with dial() as fresh:
                if (now := shown(fresh)) != former:
                    break
            time.sleep(0.1)
        assert now == (certs / "gateway.pem").read_text()
        read_stop(secure)
        assert plant.starts() == {"bay-1": 1}


def test_with_real_gateways(tmp_path: Path) -> None:
    (tmp_path / "truck").mkdir()
    with Ranger() as ranger, Plant(tmp_path, ["bay-1"], real=True) as plant:
        ranger.distance_mm = 270.0
        plant.camera, plant.ranger = draw_truck(tmp_path / "truck", 27), ranger.port
        plant.review("bay-1", port=0)
        done = plant.play("configure")
        assert done.returncode == 0, done.stdout
        digests = plant.digests()
        assert len(set(digests["bay-1"])) == 1
        plant.review("bay-1", port=0, camera="/dev/video77")
        done = plant.play("configure", within_s=30)
        assert done.returncode == 2, done.stdout
        assert "Not proven: bay-1: " in done.stdout
        assert plant.digests() == digests
