"""The operator's page on a bay at work: live picture, trend, decision; and what it shows when the gateway hangs."""

import re
import signal
from collections.abc import Iterator

import psutil
import pytest
from playwright.sync_api import Page, expect

from tests.browser.chromium import PATIENCE_MS, until
from tests.browser.conftest import Visit
from tests.browser.plant import Plant, plant
from tests.e2e.plc import Plc

# Comes under the spout and backs off, again and again.
VISITS = """
seed = 7
repeat = true
camera = { fps = 10 }
start = { distance_cm = 45 }
legs = [
  { distance_cm = 27, speed_cm_s = 15, hold_s = 2.5 },
  { distance_cm = 45, speed_cm_s = 15, hold_s = 2.5 },
]
"""
NEAR_MM, FAR_MM = 270, 450
FOCAL_X_RADIUS = 600.0 * 90.0  # px x mm: the circle's radius is this by the distance
# Columns of a chart's picture in which there is something of the line's colour: the first, the last, how many.
LINE = """(canvas) => {
  const { width, height } = canvas;
  const { data } = canvas.getContext('2d').getImageData(0, 0, width, height);
  const columns = [];
  for (let x = 0; x < width; x++)
    for (let y = 0; y < height; y++) {
      const at = 4 * (y * width + x);
      if (data[at] < 60 && data[at + 2] - data[at] > 35 && data[at + 3] > 200) {  // dark, and blue
        columns.push(x);
        break;
      }
    }
  return [columns.at(0) ?? -1, columns.at(-1) ?? -1, columns.length];
}"""


@pytest.fixture(scope="module")
def bay(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    with plant(tmp_path_factory.mktemp("plant"), VISITS) as running:
        yield running


@pytest.fixture
def page(bay: Plant, visit: Visit) -> Page:
    opened = visit(f"{bay.url}/#bay1")
    expect(opened.locator(".picture .tag")).to_have_text("LIVE")
    return opened


def number(text: str, pattern: str) -> float:
    found = re.search(pattern, text)
    assert found, text
    return float(found.group(1).replace("−", "-").replace("\u202f", "").replace(" ", ""))


def later(page: Page, frames: int) -> None:
    """Waits until the page shows a picture at least so many frames newer than now."""
    caption = page.locator(".picture figcaption")
    first = number(caption.inner_text(), r"frame (\d+)")
    until(page, lambda: number(caption.inner_text(), r"frame (\d+)") >= first + frames)


def test_the_picture_is_live_and_the_circle_is_that_of_its_frame(page: Page) -> None:
    later(page, 6)
    caption = page.locator(".picture figcaption")
    captions: list[str] = []

    def evaluated() -> bool:
        captions.append(caption.inner_text())
        return "circle" in captions[-1]

    until(page, evaluated)
    radius_px = number(captions[-1], r"R ([\d.,]+)")
    assert FOCAL_X_RADIUS / FAR_MM - 5 < radius_px < FOCAL_X_RADIUS / NEAR_MM + 5
    photo, lines = page.locator(".picture canvas").all()
    # Of the photo every pixel is painted; of what was seen, only lines; and they go when nobody wants them.
    painted = """(canvas) => {
      const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
      let count = 0;
      for (let at = 3; at < data.length; at += 4) count += data[at] > 0;
      return count / (data.length / 4);
    }"""
    assert photo.evaluate(painted) == 1.0
    until(page, lambda: 0 < lines.evaluate(painted) < 0.2)
    page.get_by_label("show what was seen").uncheck()
    until(page, lambda: lines.evaluate(painted) == 0.0)


@pytest.mark.long
def test_the_trend_moves(page: Page) -> None:
    """What was measured when the page was opened wanders to the left, and new values are added on the right."""
    radius = page.locator(".trend canvas").first
    until(page, lambda: radius.evaluate(LINE)[2] >= 20)
    begun, newest, _ = radius.evaluate(LINE)
    until(page, lambda: radius.evaluate(LINE)[0] <= begun - 10)
    until(page, lambda: radius.evaluate(LINE)[1] >= newest - 3)
    page.get_by_role("button", name="Pause").click()
    later(page, 2)  # what was under way is drawn
    still = radius.evaluate(LINE)
    later(page, 7)
    assert radius.evaluate(LINE) == still


@pytest.mark.long
def test_the_decision_is_the_plcs(bay: Plant, page: Page) -> None:
    """What the page shows for more than a moment is what the registers say, on and off."""
    stop = page.locator("dl.facts-grid div", has=page.locator("dt", has_text=re.compile("^Stop$"))).locator("dd")
    with Plc(bay.modbus_port) as plc:
        for bit, word in ((1, "on"), (0, "off")):
            plc.wait_for(lambda image, bit=bit: image["stop"] == bit, PATIENCE_MS / 1000)  # type: ignore[misc]
            expect(stop).to_have_text(word)
            if plc.last["stop"] == bit:
                expect(page.locator(".decision .word")).to_have_text(re.compile("STOP" if bit else "^(?!STOP)"))


def test_a_gateway_that_hangs_is_shown_as_unknown_until_it_goes_on(bay: Plant, page: Page) -> None:
    stop = page.locator("dl.facts-grid div", has=page.locator("dt", has_text=re.compile("^Stop$"))).locator("dd")
    expect(stop).to_have_text(re.compile("on|off"))
    gateway = psutil.Process(bay.gateway.process.pid)
    gateway.send_signal(signal.SIGSTOP)
    try:
        expect(stop).to_have_text("–")
        expect(page.locator(".picture .tag")).to_have_text("NOT LIVE")
        expect(page.locator(".trend header .value")).to_have_text(re.compile("R –, Z –"))
        expect(page.locator(".decision")).to_contain_text("treat the bay as STOP")
    finally:
        gateway.send_signal(signal.SIGCONT)
    expect(stop).to_have_text(re.compile("on|off"))
    expect(page.locator(".picture .tag")).to_have_text("LIVE")
