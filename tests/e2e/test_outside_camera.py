"""A camera type that another distribution brings: found by the scheme of `camera.url`, checked like any other."""

import asyncio
from pathlib import Path
from typing import Any

import pytest

from gateway.clock import SystemClock
from gateway.config import CameraConfig, Reconnect, VisionConfig, load
from gateway.config_check import check
from gateway.core.readings import Quality, VisionReading
from gateway.errors import ConfigError
from gateway.vision.process.vision_service import VisionService
from gateway.vision.source.specs import source_spec
from tests import pattern_camera
from tests.pattern_camera import PatternSpec

ROOT = Path(__file__).parents[2]
PATIENCE_S = 30.0


@pytest.fixture(autouse=True)
def _installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "site-packages"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.syspath_prepend(str(ROOT))
    pattern_camera.install(folder)


def readings_until(quality: Quality, **camera: Any) -> list[VisionReading]:
    """Of a vision process of its own."""
    config = CameraConfig(reconnect=Reconnect(min_s=0.05, max_s=0.1), **camera)
    readings: list[VisionReading] = []
    arrived = asyncio.Event()

    def emit(reading: VisionReading) -> None:
        readings.append(reading)
        arrived.set()

    async def scene() -> None:
        service = VisionService("bay1", source_spec(config), config, VisionConfig(method="paper"), SystemClock(), emit)
        running = asyncio.get_running_loop().create_task(service.run())
        try:
            async with asyncio.timeout(PATIENCE_S):
                while not readings or readings[-1].quality is not quality:
                    arrived.clear()
                    await arrived.wait()
        finally:
            running.cancel()
            await asyncio.wait([running], timeout=PATIENCE_S)

    asyncio.run(scene())
    return readings


def test_its_frames_are_looked_at_and_a_picture_that_repeats_is_a_lost_source() -> None:
    *seen, lost = readings_until(Quality.LINK_DOWN, url="pattern://40", frozen_s=0.5)

    assert seen[0].quality is Quality.GOOD
    assert seen[0].circle is not None
    assert (seen[0].circle.u_px, seen[0].circle.v_px) == pytest.approx((80, 60), abs=1)
    assert lost.detail == "pattern: frozen: the picture has not changed for 0.5 s"
    assert len({reading.t_ns for reading in seen}) < len(seen)  # before that, its age is that of the last new picture


def test_its_frames_have_the_size_that_is_asked_for() -> None:
    config = CameraConfig(url="pattern://9", width_px=320, height_px=240)
    assert source_spec(config) == PatternSpec(9, 320, 240)
    (lost,) = readings_until(Quality.LINK_DOWN, url="pattern://99", max_megapixels=0.01)
    assert lost.detail == "frame of 160 x 120 = 0.0 megapixels, more than camera.max_megapixels = 0.01"


def test_its_configuration_errors_name_the_line_and_an_unknown_scheme_lists_it(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    for url, words in (
        ("pattern://x", "needs a number of frames"),
        ("patern://4", "rtsp, rtsps, http, https, gige, usb3, gst, pattern"),
    ):
        file.write_text(f'[[bays]]\nname = "bay1"\nunit_id = 1\n[bays.camera]\nurl = "{url}"\n')
        with pytest.raises(ConfigError, match=rf":5: bays\.0\.camera\.url.*{words}"):
            check(load(file), source=str(file), text=file.read_text())
