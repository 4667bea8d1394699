"""A bay is set up on the page: camera and board tried, the file saved, the gateway started again with it."""

import json
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest
from playwright.sync_api import Page, Route, expect

from gateway import config
from tests.browser import judgements
from tests.browser.chromium import PATIENCE_MS, SERVER_GONE, Watch, until
from tests.browser.conftest import Visit
from tests.browser.plant import first_visit
from tests.e2e.brokers import free_port
from tests.e2e.processes import Gateway
from tests.e2e.sim_ranger import Ranger
from tests.e2e.test_doctor import draw_truck, pictures  # noqa: F401 - the fixture
from tests.e2e.test_run import started
from tests.firmware.bench_runs import BOOTLOADER
from tests.firmware.test_flashing import board, other_program  # noqa: F401 - the fixture
from tests.onvif_camera import OnvifCamera

TRIED = {"part": "camera", "name": "", "verdict": "ok", "tried": "open it", "remedy": ""}

FILE = """\
# The one bay's camera is not there: as shipped.
instance = "{instance}"
state_dir = "{folder}/state"

[modbus]
port = {modbus}

[hmi]
enabled = true
port = {hmi}                     # the same after a restart
without_login = "technician"

[camera]
url = "/dev/video77"             # none
width_px = 1280
fps = 30

[ranger]
port = "/dev/ttyACM77"
"""


def own_name() -> str:
    """Of a gateway, on a machine where others may run the same test."""
    return f"new-bay-{uuid4().hex[:12]}"


def kept_of(file: Path, bay: str) -> Any:
    """The bay file."""
    (path,) = (file.parent / "state").glob(f"bay.site1.*.{bay}.json")
    return json.loads(path.read_text())


@pytest.fixture
def plant(tmp_path: Path) -> Iterator[tuple[str, Path]]:
    """The pages' address, and the file."""
    file = tmp_path / "plant.toml"
    hmi = free_port()
    file.write_text(FILE.format(instance=own_name(), folder=tmp_path, modbus=free_port(), hmi=hmi))
    with Gateway("run", str(file)) as gateway:
        started(gateway)
        url = f"http://127.0.0.1:{hmi}"
        first_visit(url)
        yield url, file


SHIPPED = """\
# As shipped: camera and board by the numbers that they have now.
instance = "{instance}"
state_dir = "{folder}/state"
initial_function_check = true

[modbus]
port = {modbus}

[hmi]
enabled = true
port = {hmi}
without_login = "technician"

[camera]
url = "{camera}"
loop = true
width_px = 640
height_px = 480
fps = 10

[ranger]
port = "{port}"
"""


@dataclass
class Running:
    """One bay at work, with the devices of this machine as a list: none is here."""

    url: str
    file: Path
    camera: str
    camera_link: str  # its lasting name
    port: str
    port_link: str

    def found(self) -> dict[str, Any]:
        modes = [{"pixel_format": "MJPG", "width_px": 640, "height_px": 480, "rates_hz": [30]}]
        camera = {"url": self.camera_link, "node": self.camera, "name": "Plant Cam", "modes": modes}
        port = {"url": self.port_link, "node": self.port, "name": "Arduino Uno"}
        return {
            "cameras": [{**camera, "used_by": "bay1", "fault": ""}],
            "ports": [{**port, "used_by": "bay1"}],
        }

    @property
    def kept(self) -> Any:
        return kept_of(self.file, "bay1")


@pytest.fixture
def shipped(tmp_path: Path, pictures: Path) -> Iterator[Running]:  # noqa: F811
    file, names, hmi = tmp_path / "plant.toml", tmp_path / "names", free_port()
    names.mkdir()
    with Ranger() as board:
        board.distance_mm = 620.0
        bay = Running(
            f"http://127.0.0.1:{hmi}",
            *(file, str(pictures), str(names / "camera-X1"), board.port, str(names / "board-B7")),
        )
        Path(bay.camera_link).symlink_to(bay.camera)
        Path(bay.port_link).symlink_to(bay.port)
        file.write_text(
            SHIPPED.format(
                **{"instance": own_name(), "folder": tmp_path, "camera": bay.camera, "port": bay.port},
                **{"modbus": free_port(), "hmi": hmi},
            )
        )
        with Gateway("run", str(file)) as gateway:
            started(gateway)
            first_visit(bay.url)
            yield bay


def found(page: Page, devices: dict[str, Any]) -> None:
    """What the page is told of the machine."""
    page.route("**/api/setup/devices", lambda route: route.fulfill(json=devices))


def to_step(page: Page, name: str) -> None:
    page.get_by_role("button", name=f"Next: {name}").click()
    expect(page.get_by_role("heading", name=name)).to_be_focused()


def next_step(page: Page, name: str) -> None:
    """And it is as every page must be."""
    to_step(page, name)
    judgements.accessible(page)
    for width_px in (360, 3840, 1366):
        page.set_viewport_size({"width": width_px, "height": 900})
        judgements.no_sideways_scroll(page)


@pytest.mark.long
def test_a_second_bay_from_nothing_to_its_function_check(
    plant: tuple[str, Path],
    visit: Visit,
    watches: list[Watch],
    pictures: Path,  # noqa: F811
) -> None:
    url, file = plant
    begun_s = time.monotonic()
    page = visit(f"{url}/setup/new-bay")
    watches[-1].excused = SERVER_GONE  # while it starts again nobody answers
    expect(page.get_by_label("bay1")).to_be_checked()  # its devices are not there
    judgements.usable_by_keyboard(page)
    page.get_by_label("A new bay").check()
    expect(page.get_by_label("Name")).to_have_value("bay2")
    expect(page.get_by_label("Modbus unit id")).to_have_value("2")
    page.get_by_label("Name").fill("bay1")
    expect(page.get_by_text("another bay has this name")).to_be_visible()
    expect(page.get_by_role("button", name="Next: Camera")).to_be_disabled()
    page.get_by_label("Name").fill("north")
    next_step(page, "Camera")

    expect(page.get_by_text("No camera found.")).to_be_visible()
    page.get_by_label("Another one").fill("/dev/video78")
    page.keyboard.press("Enter")
    expect(page.get_by_text("cannot be opened")).to_be_visible()
    expect(page.get_by_role("button", name="Next: Ranger")).to_be_disabled()
    page.get_by_label("Another one").fill(str(pictures))
    page.keyboard.press("Enter")
    expect(page.locator(".shot img")).to_be_visible()
    expect(page.get_by_text("640 x 480 px")).to_be_visible()
    next_step(page, "Ranger")

    with Ranger() as board:
        board.distance_mm = 620.0
        page.get_by_label("Another one").fill(board.port)
        page.keyboard.press("Enter")
        expect(page.locator(".distance")).to_contain_text("62.")
        expect(page.get_by_text("hcsr04-sim").first).to_be_visible()
        next_step(page, "PLC and broker")

        expect(page.get_by_text("it answers; the heartbeat runs")).to_be_visible()
        expect(page.get_by_text("only programs of this machine reach it")).to_be_visible()
        page.get_by_label("Address", exact=True).fill(f"127.0.0.1:{free_port()}")
        page.get_by_role("button", name="Try this broker").click()
        expect(page.get_by_text("does the broker run")).to_be_visible()
        page.get_by_label("Address", exact=True).fill("")
        next_step(page, "The file")

        expect(page.locator(".diff .added").filter(has_text='name = "north"')).to_be_visible()
        page.get_by_role("button", name="Save the file").click()
        expect(page.locator("[data-saved]")).to_be_visible()
        other = visit(f"{url}/setup/new-bay")  # who comes back before the restart finds it there
        expect(other.get_by_label("a restart is due")).to_contain_text("north")
        judgements.accessible(other)
        other.close()
        # The gateway takes no restart within 10 s of its start.
        page.wait_for_timeout(max(0.0, 1000 * (begun_s + 11 - time.monotonic())))
        page.get_by_role("button", name="Restart the gateway").click()
        expect(page.locator("[data-started]")).to_contain_text("function check is on", timeout=2 * PATIENCE_MS)
        expect(page.locator("[data-started]")).to_contain_text("STOP")
        judgements.accessible(page)
        expect(page.locator("[data-started]")).to_contain_text("ranger: good")

    text = file.read_text()
    assert text.startswith("# The one bay's camera is not there: as shipped.\n")
    assert "# the same after a restart" in text
    bays = {bay.name: bay for bay in config.load(file).bays}
    assert set(bays) == {"bay1", "north"}
    assert bays["bay1"].camera.url == "/dev/video77"
    north = bays["north"]
    assert (north.unit_id, north.ranger.port) == (2, board.port)
    assert (north.camera.url, north.camera.width_px, north.camera.height_px) == (str(pictures), 640, 480)
    assert kept_of(file, "north")["function_check"] == "MAY_MOVE_OFF"


@pytest.mark.long
def test_the_bay_that_runs_is_set_up_with_the_devices_that_it_has(
    shipped: Running, visit: Visit, watches: list[Watch]
) -> None:
    begun_s = time.monotonic()
    assert shipped.kept["function_check"] == "MAY_MOVE_OFF"  # from its first start on
    page = visit(f"{shipped.url}/setup/new-bay")
    watches[-1].excused = re.compile(f"{SERVER_GONE.pattern}|status of (409|422)")  # what is refused here on purpose
    found(page, shipped.found())
    expect(page.get_by_label("bay1")).to_be_checked()  # nobody has ended its function check
    judgements.usable_by_keyboard(page)
    next_step(page, "Camera")

    expect(page.get_by_label(shipped.camera_link)).to_be_checked()
    expect(page.get_by_label("As in the file")).to_be_visible()
    live = page.get_by_role("region", name="live picture")
    expect(live.get_by_role("img")).to_be_visible()
    expect(live).to_contain_text("640 x 480 px")
    expect(live).to_contain_text(re.compile("R 2[0-9][0-9]"))
    next_step(page, "Ranger")

    expect(page.get_by_label(shipped.port_link)).to_be_checked()
    expect(page.locator(".distance")).to_contain_text("62.")
    to_step(page, "PLC and broker")
    next_step(page, "The file")

    expect(page.locator(".diff .added")).to_contain_text([shipped.camera_link, shipped.port_link])
    expect(page.locator(".diff .added")).to_have_count(2)

    def refused(route: Route) -> None:
        route.fulfill(status=422, json={"detail": "the disk is full"})

    page.route("**/api/setup/save", refused)
    page.get_by_role("button", name="Save the file").click()
    expect(page.get_by_role("alert")).to_contain_text("the disk is full")
    expect(page.get_by_role("alert")).to_contain_text("The function check of bay1 was begun before the save, and is on")
    page.unroute("**/api/setup/save", refused)
    page.get_by_role("button", name="Save the file").click()
    expect(page.locator("[data-saved]")).to_be_visible()
    page.wait_for_timeout(max(0.0, 1000 * (begun_s + 11 - time.monotonic())))
    page.get_by_role("button", name="Restart the gateway").click()
    despite = page.get_by_role("button", name="Restart all the same")
    expect(despite.or_(page.locator("[data-started]"))).to_be_visible(timeout=2 * PATIENCE_MS)
    if despite.is_visible():  # the marker is in sight, unless the machine is too busy to see it
        despite.click()
    expect(page.locator("[data-started]")).to_contain_text("function check is on", timeout=2 * PATIENCE_MS)
    expect(page.locator("[data-started]")).to_contain_text("ranger: good")
    page.get_by_role("link", name="Set up another bay").click()
    expect(page.get_by_label("A new bay")).to_be_checked()

    (bay,) = config.load(shipped.file).bays
    assert (bay.camera.url, bay.ranger.port) == (shipped.camera_link, shipped.port_link)
    assert (bay.camera.fps, bay.camera.loop) == (10, True)  # all else is as it was
    assert shipped.kept["function_check"] == "MAY_MOVE_OFF"


def end_function_check(page: Page, bay: str) -> None:
    page.evaluate(
        """async (bay) => {
          const { csrf } = await (await fetch('/api/session')).json();
          const headers = { 'Content-Type': 'application/json', 'X-CSRF-Token': csrf };
          const body = JSON.stringify({ mode: 'off' });
          const answer = await fetch(`/api/bays/${bay}/function-check`, { method: 'POST', headers, body });
          if (!answer.ok) throw new Error(await answer.text());
        }""",
        bay,
    )


def at_work(page: Page, bay: str) -> bool:
    """As the pages know it, which may be a second old."""
    now = page.request.get(f"{page.url.rsplit('/', 1)[0]}/api/bays/{bay}/state").json()
    good = now["state"] and {now["state"][sensor]["quality"]["name"] for sensor in ("vision", "range")} == {"GOOD"}
    return bool(good) and now["function_check"] == "OFF"


@pytest.mark.long
def test_a_found_device_is_picked_for_a_new_bay_then_the_ranger_of_one_that_runs_is_replaced_alone(
    shipped: Running, visit: Visit, watches: list[Watch], tmp_path: Path
) -> None:
    camera = tmp_path / "other-camera"
    camera.mkdir()
    draw_truck(camera, 45)
    steps = ("PLC and broker", "The file")
    with Ranger() as other:
        other.distance_mm = 910.0
        devices = shipped.found()
        free = {"used_by": "", "fault": "", "url": str(camera), "node": "/dev/video4", "name": "other camera"}
        devices["cameras"].append({**devices["cameras"][0], **free})
        devices["ports"].append({"url": other.port, "node": other.port, "name": "other board", "used_by": ""})
        page = visit(f"{shipped.url}/driver")
        end_function_check(page, "bay1")
        until(page, lambda: at_work(page, "bay1"))
        page.goto(f"{shipped.url}/setup/new-bay")
        found(page, devices)
        expect(page.get_by_label("A new bay")).to_be_checked()  # the other one is at work
        to_step(page, "Camera")
        expect(page.get_by_label(shipped.camera_link)).to_be_disabled()
        expect(page.get_by_text("bay bay1 uses it")).to_be_visible()
        expect(page.get_by_role("button", name="Next: Ranger")).to_be_disabled()
        page.get_by_label("other camera").check()
        expect(page.get_by_label("Picture size")).to_have_value("640x480")
        expect(page.get_by_text("640 x 480 px", exact=True)).to_be_visible()
        to_step(page, "Ranger")
        expect(page.get_by_label(shipped.port_link)).to_be_disabled()
        page.get_by_label("other board").check()
        expect(page.locator(".distance")).to_contain_text("91.")
        sensor = page.get_by_label("Sensor", exact=True)
        sensor.select_option("waveshare-ai-8ch")
        expect(page.get_by_text("number.mm_per_unit: is missing: profile 'waveshare-ai-8ch' leaves")).to_be_visible()
        page.get_by_label("mm_per_unit").fill("0.3")
        page.get_by_label("mm_per_unit").press("Tab")
        expect(page.get_by_text("number.offset_mm: is missing")).to_be_visible()
        sensor.select_option("none")  # which takes nothing with it
        expect(page.locator(".distance")).to_contain_text("91.")
        (watch,) = watches
        watch.complaints = [one for one in watch.complaints if "/api/setup/look" not in one]  # those that were refused
        for step in steps:
            to_step(page, step)
        expect(page.locator(".diff .added").filter(has_text="mm_per_unit")).to_have_count(0)
        for line in ('name = "bay2"', f'url = "{camera}"', "fps = 30", f'port = "{other.port}"'):
            expect(page.locator(".diff .added").filter(has_text=line)).to_be_visible()

        page.get_by_role("navigation", name="steps").get_by_role("button", name="Bay").click()
        page.get_by_label("bay1").check()
        expect(page.get_by_role("navigation", name="steps")).not_to_contain_text(
            "other-camera"
        )  # nothing is left of it
        to_step(page, "Camera")
        expect(page.get_by_label(shipped.camera_link)).to_be_checked()
        page.get_by_label("As in the file").check()
        to_step(page, "Ranger")
        expect(page.get_by_label(shipped.port_link)).to_be_checked()
        page.get_by_label("As in the file").check()
        to_step(page, steps[0])
        page.get_by_label("(modbus.host)").fill("0.0.0.0")
        to_step(page, steps[1])
        expect(page.locator(".diff .added")).to_contain_text(['host = "0.0.0.0"'])
        expect(page.get_by_text("the function check of bay1 begins")).to_have_count(0)  # its sensors are as they were

        page.get_by_role("navigation", name="steps").get_by_role("button", name="Ranger").click()
        page.get_by_label("other board").check()
        expect(page.locator(".distance")).to_contain_text("91.")
        to_step(page, steps[0])
        page.get_by_label("(modbus.host)").fill("127.0.0.1")
        to_step(page, steps[1])
        expect(page.locator(".diff .added")).to_have_text(re.compile(re.escape(other.port)))  # the one line
        expect(page.get_by_text("the function check of bay1 begins")).to_be_visible()
        page.get_by_role("button", name="Save the file").click()
        expect(page.locator("[data-saved]")).to_be_visible()
        until(page, lambda: shipped.kept["function_check"] == "MAY_MOVE_OFF")
    (bay,) = config.load(shipped.file).bays
    assert (bay.camera.url, bay.ranger.port) == (shipped.camera, other.port)


@pytest.mark.long
def test_a_network_camera_is_found_and_a_board_is_given_its_firmware(
    plant: tuple[str, Path],
    visit: Visit,
    pictures: Path,  # noqa: F811
    other_program: Path,  # noqa: F811
    tmp_path: Path,
) -> None:
    """The camera speaks ONVIF, but no RTSP: its pictures are stand-ins. The board is an emulated Uno with Optiboot."""
    url, file = plant
    page = visit(f"{url}/setup/new-bay")
    page.get_by_label("A new bay").check()
    to_step(page, "Camera")
    with OnvifCamera() as camera:
        listed = {"address": "127.0.0.1", "service": camera.service, "name": "Plant Cam", "model": "X1"}
        page.route("**/api/setup/network-cameras", lambda route: route.fulfill(json={"cameras": [listed]}))
        page.get_by_role("button", name="Search the network").click()
        page.get_by_label("Plant Cam").check()
        page.get_by_label("User of the camera").fill("admin")
        page.get_by_label("Password").fill("wrong")
        page.keyboard.press("Enter")
        expect(page.get_by_role("alert")).to_contain_text("user or password is wrong")
        page.get_by_label("User of the camera").fill("admin")
        page.get_by_label("Password").fill("p&<1")
        page.keyboard.press("Enter")
        expect(page.get_by_label("MainStream, 1920 x 1080 px, H264, 25 /s")).to_be_visible()
        asked: list[Any] = []
        seen: dict[str, Any] = {"look": 7, "piece": 1, "end": None, "line": {**TRIED, "result": "it gives pictures"}}
        seen["figures"] = {"width_px": 640, "height_px": 480, "rate_hz": 15, "late_ms": 40, "frames": 9, "fresh": 9}

        def look(route: Route) -> None:
            if route.request.method == "POST" and route.request.url.endswith("/look"):
                asked.append(route.request.post_data_json)
            route.fulfill(json={**seen, "figures": {**seen["figures"], "marker": None}})

        picture = next(pictures.iterdir())
        page.route(re.compile("/api/setup/look(/7.*)?$"), look)
        page.route("**/api/setup/look/7/picture*", lambda route: route.fulfill(path=picture))
        page.get_by_label("SubStream, 640 x 480 px, JPEG, 15 /s").check()
        expect(page.locator(".shot img")).to_be_visible()
        judgements.accessible(page)
        for width_px in (390, 1366):
            page.set_viewport_size({"width": width_px, "height": 900})
            judgements.no_sideways_scroll(page)
        to_step(page, "Ranger")
    assert asked[0]["camera"] == {"url": "rtsp://admin:p%26%3C1@127.0.0.1:8554/sub"}
    page.unroute(re.compile("/api/setup/look(/7.*)?$"))

    with board(other_program, tmp_path, "--bootloader", str(BOOTLOADER)) as uno:
        page.get_by_label("Another one").fill(uno.port)
        page.keyboard.press("Enter")
        put = page.get_by_role("button", name="Put the gateway's firmware on this board")
        expect(put).to_be_visible(timeout=2 * PATIENCE_MS)
        put.click()
        expect(page.get_by_text("written, and read back equal")).to_be_visible(timeout=2 * PATIENCE_MS)
        judgements.accessible(page)
        for width_px in (390, 1366):
            page.set_viewport_size({"width": width_px, "height": 900})
            judgements.no_sideways_scroll(page)
        page.get_by_role("button", name="Look at the board").click()
        expect(page.get_by_text("hcsr04, protocol version 1").first).to_be_visible(timeout=2 * PATIENCE_MS)
        to_step(page, "PLC and broker")
    to_step(page, "The file")
    expect(page.locator(".diff .added").filter(has_text='username = "admin"')).to_be_visible()
    page.get_by_role("button", name="Save the file").click()
    expect(page.locator("[data-saved]")).to_be_visible()

    (_, new) = config.load(file).bays
    assert (new.camera.url, new.camera.username) == ("rtsp://127.0.0.1:8554/sub", "admin")
    assert "p&<1" not in file.read_text()
    kept = Path(new.camera.password_file or "")
    assert (kept.read_text(), kept.stat().st_mode & 0o777) == ("p&<1\n", 0o600)
