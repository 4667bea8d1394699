"""What the pages find and try for a new bay, through a running gateway: real pictures, a real pty, a real broker."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from uuid import uuid4

import cv2
import numpy as np
import psutil
import pytest

from tests.e2e.brokers import Mosquitto, free_port
from tests.e2e.page_client import PageClient
from tests.e2e.processes import Gateway
from tests.e2e.sim_ranger import Ranger
from tests.e2e.test_doctor import pictures  # noqa: F401 - the fixture
from tests.e2e.test_run import started
from tests.firmware.bench_runs import BOOTLOADER
from tests.firmware.test_flashing import board, other_program  # noqa: F401 - the fixture

pytestmark = pytest.mark.xdist_group("devices")  # of one gateway

NOT_HEARD = ("LINK_DOWN", "WAITING", "STALE")
LOOKS = 60  # answers of a look, at most; each comes within seconds


@dataclass
class Plant:
    gateway: Gateway
    page: PageClient
    folder: Path
    taken: Ranger
    modbus_port: int
    newest: int | None = None  # look; of a test that failed it goes on, and is replaced

    def look(self, body: dict[str, Any]) -> Iterator[dict[str, Any]]:
        """What the page gets of a look, until it ends."""
        seen = self.page.post("/api/setup/look", {"replaces": self.newest, **body})
        self.newest = seen["look"]
        for _ in range(LOOKS):
            yield seen
            if seen["end"] is not None:
                return
            seen = self.page.get(f"/api/setup/look/{seen['look']}?after={seen['piece']}")

    def process(self, name: str) -> psutil.Process:
        (found,) = (each for each in self.gateway.family() if each.name() == name and each.ppid() == self.pid)
        return found

    @property
    def pid(self) -> int:
        return self.gateway.process.pid


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory, pictures: Path) -> Iterator[Plant]:  # noqa: F811
    folder = tmp_path_factory.mktemp("plant")
    port = free_port()
    with Ranger() as taken:
        file = folder / "bay.toml"
        file.write_text(f"""
site = "test"
instance = "devices-{uuid4().hex[:8]}"
state_dir = "{folder}/state"
[modbus]
port = {port}
writes = true
plc_addresses = ["127.0.0.1"]
[hmi]
enabled = true
port = 0
without_login = "technician"
[camera]
url = "{pictures}"
loop = true
fps = 10
[ranger]
port = "{taken.port}"
""")
        with Gateway("run", str(file)) as gateway:
            url = started(gateway).split("pages on ")[1].split(",")[0]
            with PageClient(url) as page:
                yield Plant(gateway, page, folder, taken, port)


@pytest.mark.long
def test_a_camera_is_shown_until_its_page_is_gone(plant: Plant, pictures: Path, tmp_path: Path) -> None:  # noqa: F811
    other = tmp_path / "other"
    other.mkdir()
    for n, path in enumerate(sorted(pictures.iterdir())):
        (other / f"{n}.png").write_bytes(path.read_bytes())
    look = plant.look({"camera": {"url": str(other), "loop": True, "fps": 20}})
    seen = next(each for each in look if each["piece"] >= 2 or each["end"])
    assert seen["end"] is None
    figures = seen["figures"]
    assert (seen["line"]["tried"], figures["width_px"], figures["height_px"]) == (f"open {other}, read it", 640, 480)
    assert 0 < figures["rate_hz"] < 21
    assert figures["frames"] == figures["fresh"] > 1
    assert figures["marker"][2] == pytest.approx(200, abs=3)
    image = cv2.imdecode(np.frombuffer(plant.page.data(f"/api/setup/look/{seen['look']}/picture"), np.uint8), 1)
    assert image is not None
    assert image.shape == (480, 640, 3)
    devices = plant.process("gw-devices")
    assert len(devices.children()) == 1
    plant.page.post("/api/setup/look", {"camera": {"url": "/dev/video77"}}, status=409)  # one at a time
    plant.page.post(f"/api/setup/look/{seen['look']}/end")
    deadline = time.monotonic() + 20
    while devices.children() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert devices.children() == []


@pytest.mark.long
def test_a_camera_that_is_not_there_or_taken_is_reported(plant: Plant, pictures: Path) -> None:  # noqa: F811
    *_, absent = plant.look({"camera": {"url": "/dev/video77"}})
    assert absent["end"]["verdict"] == "fault"
    assert "cannot be opened" in absent["end"]["result"]
    *_, taken = plant.look({"camera": {"url": str(pictures)}})
    assert taken["end"]["result"] == "bay bay1 uses it"
    wrong = plant.page.post("/api/setup/look", {"camera": {"url": "x", "fps": 0}}, status=422)
    assert "camera.fps" in wrong["detail"]
    plant.page.post("/api/setup/look", {}, status=400)


def test_the_distance_of_a_board_is_shown(plant: Plant) -> None:
    *_, taken = plant.look({"ranger": {"port": plant.taken.port}})
    assert taken["end"]["result"] == "bay bay1 uses it"
    with Ranger() as board:
        board.distance_mm = 730.0
        look = plant.look({"ranger": {"port": board.port}})
        seen = next(each for each in look if (each["figures"] or {}).get("identity") and each["figures"]["distance_mm"])
        assert "hcsr04" in seen["figures"]["identity"].lower()
        assert seen["figures"]["distance_mm"] == pytest.approx(730, abs=15)
        assert seen["line"]["verdict"] in ("ok", "warning")
        plant.page.post(f"/api/setup/look/{seen['look']}/end")


def test_devices_are_listed(plant: Plant) -> None:
    found = plant.page.get("/api/setup/devices")
    assert {"cameras", "ports"} == set(found)
    assert all(port["url"].startswith("/dev/") for port in found["ports"])


def test_the_modbus_port_is_tried_as_a_plc_would(plant: Plant) -> None:
    tried = plant.page.post("/api/setup/plc")
    reached, answers, route = tried["lines"]
    assert (reached["verdict"], reached["result"]) == (
        "warning",
        "127.0.0.1: only programs of this machine reach it, no PLC",
    )
    assert (answers["verdict"], f"port {plant.modbus_port}" in answers["tried"]) == ("ok", True)
    assert answers["result"].startswith("it answers; the heartbeat runs; stop is 1")
    assert route["part"] == "plc"
    assert tried["servers"][0]["requests"] >= 2
    assert tried["writes"] == [
        {
            "bay": "bay1",
            "values": {
                "plc_heartbeat": 0, "plc_control": 0, "recipe_select": 0, "plc_age": None, "plc_writes": 0,
                "write_conflicts": 0,
            },
            "control_bits": [],
        }
    ]  # fmt: skip


def test_a_broker_is_tried(plant: Plant, tmp_path: Path) -> None:
    (tmp_path / "mq").mkdir()
    with Mosquitto(tmp_path / "mq") as broker:
        (line,) = plant.page.post("/api/setup/broker", {"mqtt": {"url": broker.url}})["lines"]
        assert (line["verdict"], "came back, and is deleted" in line["result"]) == ("ok", True)
    (line,) = plant.page.post("/api/setup/broker", {"mqtt": {"url": f"mqtt://u:geheim@127.0.0.1:{free_port()}"}})[
        "lines"
    ]
    assert (line["verdict"], "geheim" in str(line)) == ("fault", False)
    assert plant.page.post("/api/setup/broker")["lines"] == []  # none is configured


@pytest.mark.long
def test_a_bays_board_is_given_its_firmware_under_function_check_alone(
    tmp_path: Path,
    other_program: Path,  # noqa: F811
) -> None:
    """A bay that runs has the port of an emulated Uno with somebody else's sketch."""
    with board(other_program, tmp_path, "--bootloader", str(BOOTLOADER)) as uno:
        file = tmp_path / "bay.toml"
        file.write_text(f"""
instance = "devices-{uuid4().hex[:8]}"
state_dir = "{tmp_path}/state"
[modbus]
port = {free_port()}
[hmi]
enabled = true
port = 0
without_login = "technician"
[ranger]
port = "{uno.port}"
""")
        with Gateway("run", str(file)) as gateway:
            url = started(gateway).split("pages on ")[1].split(",")[0]
            with PageClient(url) as page:
                flash = {"port": uno.port, "bay": "bay1", "replaces": None}
                assert "begin a function check first" in page.post("/api/setup/flash", flash, 409)["detail"]
                page.post("/api/bays/bay1/function-check", {"mode": "may_move_off"})
                seen = page.post("/api/setup/flash", flash)
                while seen["end"] is None:  # it has a time limit of its own
                    seen = page.get(f"/api/setup/look/{seen['look']}?after={seen['piece']}")
                assert (seen["end"]["verdict"], seen["end"]["result"]) == ("ok", "written, and read back equal")
            until_s = time.monotonic() + 60  # the bay has its port back after 15 s
            while heard(url) in NOT_HEARD:
                assert time.monotonic() < until_s
                time.sleep(0.5)


def heard(url: str) -> str:
    with PageClient(url) as page:
        quality: str = page.get("/api/bays/bay1/state")["state"]["range"]["quality"]["name"]
    return quality
