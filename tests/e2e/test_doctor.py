"""`gateway doctor` in a plant that is well, in one with nothing in it, and beside a gateway that runs."""

import json
import socket
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import cv2
import pytest

from gateway.sim import scenario as scenarios
from gateway.sim.render import Painter
from gateway.sim.world import World
from tests.e2e.brokers import Mosquitto, free_port
from tests.e2e.processes import Gateway, Row, command
from tests.e2e.sim_ranger import Ranger
from tests.e2e.test_run import started

WELL = ("camera", "marker", "ranger", "port", "plc", "broker", "disk")


def draw_truck(folder: Path, distance_cm: float) -> Path:
    """Ten pictures of a truck that stands."""
    scenario = scenarios.parse({"start": {"distance_cm": distance_cm}})
    world, painter = World(scenario), Painter(scenario)
    for n in range(10):
        assert cv2.imwrite(str(folder / f"{n:02}.png"), painter.frame(world.truth(n / 10), n))
    return folder


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """R = 200 px."""
    return draw_truck(tmp_path_factory.mktemp("pictures"), 27)


@pytest.fixture
def ranger() -> Iterator[Ranger]:
    with Ranger() as board:
        yield board


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    (tmp_path / "mq").mkdir()
    with Mosquitto(tmp_path / "mq") as made:
        yield made


def config_file(folder: Path, camera: Path, port: str, url: str, modbus_port: int) -> Path:
    path = folder / "bay.toml"
    path.write_text(f"""
site = "test"
instance = "{folder.name}"
state_dir = "{folder}/state"
[modbus]
host = "127.0.0.1"
port = {modbus_port}
plc_addresses = ["127.0.0.1"]
[mqtt]
url = "{url}"
[camera]
url = "{camera}"
loop = {str(camera.is_dir()).lower()}
fps = 10
[fusion]
vision_deadline_s = 0.5
[ranger]
port = "{port}"
""")
    return path


def examined(path: Path) -> tuple[int, dict[tuple[str, str], Row]]:
    done = command("doctor", str(path), "--seconds", "1", "--json")
    rows = [json.loads(line) for line in done.out.splitlines()]
    return done.code, {(row["part"], row["name"]): row for row in rows}


def verdicts(rows: dict[tuple[str, str], Row]) -> dict[str, str]:
    return {part: row["verdict"] for (part, _), row in rows.items()}


def test_a_plant_that_is_well(tmp_path: Path, pictures: Path, ranger: Ranger, broker: Mosquitto) -> None:
    code, rows = examined(config_file(tmp_path, pictures, ranger.port, broker.url, free_port()))
    found = verdicts(rows)
    assert code == 0, rows
    assert {part: found[part] for part in WELL} == dict.fromkeys(WELL, "ok"), rows["camera", "bay1"]["result"]
    assert "640 x 480 px" in rows["camera", "bay1"]["result"]
    seen = rows["marker", "bay1"]["result"]
    assert 198 < float(seen.partition("R ")[2].split(" ")[0]) < 202
    assert "hcsr04-sim, protocol version" in rows["ranger", "bay1"]["result"]
    assert "came back, and is deleted" in rows["broker", broker.url]["result"]
    assert not (tmp_path / "state").exists()


def test_a_plant_with_nothing_in_it(tmp_path: Path) -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        port = server.getsockname()[1]
        path = config_file(tmp_path, Path("/dev/video77"), "/dev/ttyNONE", f"mqtt://127.0.0.1:{free_port()}", port)
        code, rows = examined(path)
    assert code == 1
    found = verdicts(rows)
    assert {part for part, verdict in found.items() if verdict == "fault"} == {"camera", "ranger", "port", "broker"}
    assert all(row["remedy"] for row in rows.values() if row["verdict"] == "fault")


@pytest.mark.long
def test_where_the_gateway_runs_it_is_asked(tmp_path: Path, pictures: Path, ranger: Ranger, broker: Mosquitto) -> None:
    path = config_file(tmp_path, pictures, ranger.port, broker.url, free_port())
    with Gateway("run", str(path)) as gateway:
        assert started(gateway)
        _, rows = examined(path)
    assert {rows[part, "bay1"]["tried"] for part in ("camera", "ranger")} == {"ask the running gateway, which has it"}
    assert rows["port", "modbus"]["verdict"] == "ok"
    assert "running gateway" in rows["port", "modbus"]["tried"]
