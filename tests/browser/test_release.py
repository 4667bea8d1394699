"""A bay is tried and released on the page: both sensors unplugged, the gateway restarted, and a name under it."""

import json
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event, Thread

import pytest
from playwright.sync_api import expect

from gateway.errors import LinkError
from gateway.modbus import client
from gateway.sim.ranger_board import RangerFault
from gateway.web.auth.passwords import hashed
from tests.browser import judgements
from tests.browser.chromium import PATIENCE_MS, SERVER_GONE, Watch
from tests.browser.conftest import Visit
from tests.browser.plant import first_visit
from tests.browser.test_login import log_in
from tests.browser.test_new_bay import SHIPPED, own_name
from tests.e2e.brokers import free_port
from tests.e2e.processes import Gateway
from tests.e2e.sim_ranger import Ranger
from tests.e2e.test_doctor import draw_truck
from tests.e2e.test_run import started

PASSWORD = "lime-kiln-dust-77"
USER = f"""
[[hmi.users]]
name = "theo"
role = "technician"
password_hash = "{hashed(PASSWORD)}"
"""


@contextmanager
def polling(port: int) -> Iterator[None]:
    """A PLC, ten times a second; it connects again."""
    over = Event()

    def poll() -> None:
        while not over.is_set():
            with suppress(OSError, LinkError), client.connect("127.0.0.1", port) as sock:
                while not over.wait(0.1):
                    client.holding_registers(sock, 1, 100)
            over.wait(0.2)

    thread = Thread(target=poll)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@pytest.mark.long
def test_a_bay_is_released(tmp_path: Path, visit: Visit, watches: list[Watch]) -> None:
    pictures, gone, file = tmp_path / "pictures", tmp_path / "gone", tmp_path / "plant.toml"
    pictures.mkdir()
    draw_truck(pictures, 50)
    hmi, modbus = free_port(), free_port()
    with Ranger() as board, polling(modbus):
        board.distance_mm = 620.0
        text = SHIPPED.format(
            **{"instance": own_name(), "folder": tmp_path, "camera": pictures, "port": board.port},
            **{"modbus": modbus, "hmi": hmi},
        )
        text = text.replace("[hmi]\n", 'plc_addresses = ["127.0.0.1"]\n\n[hmi]\n', 1)
        slow = "loop = true\ndeadline_s = 3.0"  # on a busy machine, too
        file.write_text(text.replace("loop = true", slow, 1) + USER + "[fusion]\nvision_deadline_s = 3.0\n")
        with Gateway("run", str(file)) as gateway:
            begun_s = time.monotonic()
            started(gateway)
            url = f"http://127.0.0.1:{hmi}"
            first_visit(url)
            page = visit(f"{url}/login?next=/setup/release")
            watches[-1].excused = re.compile(f"{SERVER_GONE.pattern}|status of (401|409)")

            def done(name: str) -> None:
                expect(page.locator(f'[data-item="{name}"]')).to_have_attribute("data-done", "true")

            log_in(page, "theo", PASSWORD)
            expect(page.locator("[data-release]")).to_have_text("Not released for operation yet.")
            begin, saved = page.get_by_role("button", name="Begin the checklist"), file.read_text()
            file.write_text(saved.replace("[fusion]\n", "[fusion]\nradius_threshold_px = 150.0\n"))
            begin.click()
            expect(page.get_by_role("alert")).to_contain_text("wait for a restart: fusion.radius_threshold_px")
            expect(page.get_by_role("button", name="Restart the gateway")).to_be_visible()
            file.write_text(saved)
            begin.click()
            for name in ("function_check", "camera", "marker", "ranger", "plc"):
                done(name)
            expect(page.get_by_text("4 items are open.")).to_be_visible()
            judgements.accessible(page)
            for width_px in (360, 3840, 1366):
                page.set_viewport_size({"width": width_px, "height": 900})
                judgements.no_sideways_scroll(page)

            pictures.rename(gone)
            expect(page.locator('[data-item="camera_out"]')).to_contain_text("link down since")
            page.wait_for_timeout(1500)
            gone.rename(pictures)
            done("camera_out")
            board.forced[RangerFault.UNPLUGGED] = float("inf")
            expect(page.locator('[data-item="ranger_out"]')).to_contain_text("stop is on")
            page.wait_for_timeout(1500)
            board.forced.clear()
            done("ranger_out")

            page.wait_for_timeout(max(0.0, 1000 * (begun_s + 11 - time.monotonic())))
            page.get_by_role("button", name="Restart the gateway").click()
            dialog = page.get_by_role("dialog")
            dialog.get_by_role("button", name="Restart now").click()
            despite = dialog.get_by_label("Restart although a truck is at a bay")
            expect(despite.or_(page.locator("[data-restarting]"))).to_be_visible()
            if despite.is_visible():
                despite.check()
                dialog.get_by_role("button", name="Restart now").click()
            confirm = page.get_by_role("button", name="Confirm: the PLC stopped")
            expect(confirm).to_be_enabled(timeout=2 * PATIENCE_MS)  # logged in as before
            confirm.click()
            done("heartbeat")
            page.get_by_role("button", name="Confirm: these are wanted").click()
            done("thresholds")
            page.get_by_role("button", name="Sign as theo").click()
            expect(page.locator("[data-release]")).to_contain_text("Released for operation by theo")
            page.get_by_role("button", name="End the function check").click()
            expect(page.get_by_role("button", name="End the function check")).to_be_hidden()
            (record,) = (tmp_path / "state").glob("bay.*.bay1.released-*.json")
            assert json.loads(record.read_text())["signature"]["who"] == "theo"
