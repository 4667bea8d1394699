"""Camera controls tried in a vision process of its own: reported as they are, kept over a new process, put back."""

import asyncio
from collections.abc import Callable

import pytest

from gateway.clock import SystemClock
from gateway.config import CameraConfig, ControlsConfig, VisionConfig
from gateway.core.readings import VisionReading
from gateway.durations import NS_PER_S
from gateway.sim.camera import SimCameraSpec
from gateway.sim.scenario import parse
from gateway.vision.process.vision_service import VisionService
from gateway.vision.source.v4l2_controls import settings_of
from tests.virtual_time import in_real_time

PATIENCE_S = 60.0
SMALL = {
    "start": {"distance_cm": 60},
    "clutter": {"things": 0},
    "camera": {"width_px": 320, "height_px": 240, "focal_px": 300, "fps": 15},
}


@pytest.mark.long
@in_real_time
async def test_what_is_tried_outlives_the_process_and_the_file_comes_back() -> None:
    clock = SystemClock()
    readings: list[VisionReading] = []
    fixed = ControlsConfig(gain=5)
    spec = SimCameraSpec(parse(SMALL), clock.now_ns() - NS_PER_S, controls=settings_of(fixed))
    camera = CameraConfig(deadline_s=10, controls=fixed)
    service = VisionService("bay1", spec, camera, VisionConfig(method="paper"), clock, readings.append)

    def values() -> dict[str, int]:
        report = service.controls.report
        return {} if report is None else {one.name: one.value for one in report.offered}

    async def until(wanted: Callable[[], bool], *, ask: bool = True) -> None:
        while not wanted():
            if ask:
                service.ask_controls()
            await asyncio.sleep(0.05)

    running = asyncio.get_running_loop().create_task(service.run())
    try:
        async with asyncio.timeout(PATIENCE_S):
            await until(lambda: values().get("gain") == 5)
            service.try_controls(ControlsConfig(gain=40, brightness=-10))
            await until(lambda: (values().get("gain"), values().get("brightness")) == (40, -10))
            assert service.controls.message().found == {"gain": 5, "brightness": 0}

            service.controls.report = None
            service.apply(VisionConfig(method="paper", coast_s=0.5))  # a new process, which begins as the file says
            seen = len(readings)
            await until(lambda: len(readings) > seen and values().get("gain") == 40, ask=False)
            service.try_controls(ControlsConfig())
            await until(lambda: (values().get("gain"), values().get("brightness")) == (5, 0))
            assert not service.controls.under_way

            service.apply(VisionConfig(method="paper"), ControlsConfig(brightness=12))  # another file
            await until(lambda: values().get("brightness") == 12)
            assert values()["gain"] == 0
            service.try_controls(ControlsConfig(gain=33))
            await until(lambda: values().get("gain") == 33)
            await service.put_back()  # the gateway ends
            assert (values()["gain"], service.controls.under_way) == (0, False)
    finally:
        running.cancel()
        await asyncio.wait([running], timeout=PATIENCE_S)
