"""`gateway run` on a configuration file: a video file for a camera, a pty with real bytes for a ranger."""

import json
import threading
from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest

from gateway.core.ne107 import Ne107
from gateway.core.readings import Quality
from gateway.core.state import Reason
from gateway.sim import scenario as scenarios
from gateway.sim.ranger_board import RangerFault
from gateway.sim.render import Painter
from gateway.sim.world import World
from tests.e2e.conftest import Cli
from tests.e2e.page_client import PageClient
from tests.e2e.plc import Plc
from tests.e2e.processes import Gateway
from tests.e2e.sim_ranger import Ranger

FPS = 25


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seconds of a truck that stands at 27 cm: R = 200 px."""
    scenario = scenarios.parse({"start": {"distance_cm": 27}})
    world, painter = World(scenario), Painter(scenario)
    path = tmp_path_factory.mktemp("video") / "standing.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), FPS, (640, 480))
    assert writer.isOpened()
    for index in range(2 * FPS):
        writer.write(painter.frame(world.truth(index / FPS), index))
    writer.release()
    return path


@pytest.fixture
def ranger() -> Iterator[Ranger]:
    with Ranger() as board:
        yield board


def config_file(folder: Path, video: Path, port: str) -> Path:
    path = folder / "bay.toml"
    path.write_text(f"""
site = "test"
instance = "{folder.name}"
state_dir = "{folder}/state"
[modbus]
port = 0
[camera]
url = "{video}"
loop = true
[ranger]
port = "{port}"
[vision]
min_area_px2 = 200.0
[fusion]  # the film shows a marker that stands, whatever the ranger says
decision = "plain"
""")
    return path


def test_a_video_and_a_serial_port_become_registers(tmp_path: Path, video: Path, ranger: Ranger) -> None:
    """The AND of equation 14, then a pulled and replugged cable; the heartbeat never stops."""
    with Gateway("run", str(config_file(tmp_path, video, ranger.port))) as gateway:
        port = port_of(gateway)
        with Plc(port) as plc:
            far = plc.wait_for(lambda image: image["may_move"] == 1).image
            assert far["radius"] == pytest.approx(200, abs=3.0)
            assert far["u"] == pytest.approx(319.5, abs=1.5)
            assert far["v"] == pytest.approx(239.5, abs=1.5)
            assert far["distance"] == pytest.approx(500, abs=17)
            assert (far["d"], far["stop"]) == (0, 0)  # R alone is not enough

            ranger.distance_mm = 280.0
            near = plc.wait_for(lambda image: image["stop"] == 1).image
            assert (near["d"], near["reason"]) == (1, Reason.TARGET_REACHED)
            assert near["distance"] == pytest.approx(280, abs=17)

            ranger.distance_mm = 500.0
            plc.wait_for(lambda image: image["may_move"] == 1)
            ranger.forced[RangerFault.UNPLUGGED] = 0.0
            pulled = plc.wait_for(lambda image: image["range_quality"] == Quality.LINK_DOWN).image
            assert (pulled["stop"], pulled["may_move"], pulled["distance"]) == (1, 0, None)
            assert pulled["reason"] == Reason.RANGER_DOWN
            assert pulled["radius"] is not None  # the camera is well
            del ranger.forced[RangerFault.UNPLUGGED]
            healed = plc.wait_for(lambda image: image["may_move"] == 1).image
            assert healed["ranger_reopens"] >= 1

            ranger.forced[RangerFault.NO_ECHO] = 0.0
            deaf = plc.wait_for(lambda image: image["stop"] == 1).image
            assert (deaf["range_quality"], deaf["reason"]) == (Quality.NO_ECHO, Reason.NO_ECHO)
            assert deaf["distance"] is None
        assert gateway.end() == 0


def test_registers_speak_of_the_picture_after_crop_and_rotation(tmp_path: Path, video: Path, ranger: Ranger) -> None:
    """The marker at (319.5, 239.5) is at (259.5, 209.5) of the part, which is 440 px high before it is turned."""
    config = config_file(tmp_path, video, ranger.port)
    crop = "crop = { x_px = 60, y_px = 30, width_px = 520, height_px = 440 }"
    config.write_text(config.read_text().replace("loop = true", f"loop = true\nrotation_deg = 90\n{crop}"))
    with Gateway("run", str(config)) as gateway, Plc(port_of(gateway)) as plc:
        turned = plc.wait_for(lambda image: image["may_move"] == 1).image
        assert turned["u"] == pytest.approx(439 - 209.5, abs=1.5)
        assert turned["v"] == pytest.approx(259.5, abs=1.5)
        assert turned["radius"] == pytest.approx(200, abs=3.0)
        assert gateway.end() == 0


def started(gateway: Gateway) -> str:
    """The line that says where it serves."""
    for _ in range(200):
        for line in gateway.other:
            if "Modbus TCP on" in line:
                return line
        threading.Event().wait(0.05)
    raise AssertionError(gateway.stderr)


def port_of(gateway: Gateway) -> int:
    return int(started(gateway).split("127.0.0.1:")[1].split(",")[0])


def pages_of(gateway: Gateway) -> PageClient:
    return PageClient(started(gateway).split("pages on ")[1].split(",")[0])


def check_function(gateway: Gateway, mode: str) -> None:
    """As the technician's page does it."""
    with pages_of(gateway) as pages:
        pages.post("/api/bays/bay1/function-check", {"mode": mode})


def kept_in(path: Path) -> str:
    return str(json.loads(path.read_bytes())["function_check"]) if path.exists() else ""


@pytest.mark.long
def test_a_function_check_survives_a_gateway_that_is_killed(tmp_path: Path, video: Path, ranger: Ranger) -> None:
    """Somebody works at the spout: a crash must not let the truck move."""
    config = config_file(tmp_path, video, ranger.port)
    config.write_text(config.read_text() + '[hmi]\nenabled = true\nport = 0\nwithout_login = "technician"\n')
    kept = tmp_path / "state" / f"bay.test.{tmp_path.name}.bay1.json"
    with Gateway("run", str(config)) as gateway, Plc(port_of(gateway)) as plc:
        plc.wait_for(lambda image: image["may_move"] == 1)
        check_function(gateway, "may_move_off")
        plc.wait_for(lambda image: image["may_move"] == 0)
        for _ in range(200):  # it is written at once, which is not before the answer
            if kept_in(kept) == "MAY_MOVE_OFF":
                break
            threading.Event().wait(0.02)
        gateway.process.kill()
        gateway.process.wait(10)
    assert kept_in(kept) == "MAY_MOVE_OFF"
    with Gateway("run", str(config)) as gateway, Plc(port_of(gateway)) as plc:
        plc.wait_for(lambda image: image["stop"] == 0)  # both sensors are well
        threading.Event().wait(1.0)
        assert {poll.image["may_move"] for poll in plc.polls} == {0}
        last = plc.polls[-1].image
        assert (last["stop"], last["ne107"]) == (0, Ne107.FUNCTION_CHECK)
        check_function(gateway, "off")
        plc.wait_for(lambda image: image["may_move"] == 1)
        assert gateway.end() == 0
    assert kept_in(kept) == "OFF"


@pytest.mark.failure_mode("G9")
def test_a_wrong_configuration_names_file_line_key_value_and_range(tmp_path: Path, cli: Cli) -> None:
    path = tmp_path / "bay.toml"
    path.write_text('site = "a"\n[vision]\nmin_circularity = 1.5\nmorf_kernel_px = 3\n[camera]\nurl = "gopher://x"\n')
    done = cli("check", str(path))
    assert done.code == 2
    lines = done.err.splitlines()
    assert any(line.startswith(f"{path}:3: vision.min_circularity = 1.5: ") and "<= 1" in line for line in lines)
    assert any(line.startswith(f"{path}:4: vision.morf_kernel_px = 3: unknown key") for line in lines)


def test_every_bad_address_is_told_with_its_line(tmp_path: Path, cli: Cli) -> None:
    path = tmp_path / "bay.toml"
    path.write_text("""[camera]
url = "gopher://x"
[[bays]]
name = "a"
[[bays]]
name = "b"
unit_id = 2
ranger.port = "sockett://host:1"
[mqtt]
url = "mqtt://host:0"
""")
    done = cli("check", str(path))
    assert done.code == 2
    assert [line.split(": ")[:2] for line in done.err.splitlines()] == [
        [f"{path}:2", "camera.url"],
        [f"{path}:8", "bays.1.ranger.port"],
        [f"{path}:10", "mqtt.url"],
    ]
    assert "scheme gopher:// is unknown" in done.err
    assert "sockett:// is not supported" in done.err
    with Gateway("run", str(path)) as gateway:
        assert gateway.finish() == 2
        assert gateway.stderr.splitlines() == done.err.splitlines()
