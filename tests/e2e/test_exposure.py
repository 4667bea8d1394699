"""Exposure control in a vision process of its own: the settings of the simulated camera arrive with the readings."""

import asyncio

import pytest

from gateway.clock import SystemClock
from gateway.config import CameraConfig, VisionConfig
from gateway.core.readings import CameraExposure, ExposureState, VisionReading
from gateway.durations import NS_PER_S
from gateway.sim.camera import SimCameraSpec
from gateway.sim.scenario import parse
from gateway.vision.process.vision_service import VisionService

PATIENCE_S = 60.0
DARK = {
    "start": {"distance_cm": 60},
    "light": {"level": 0.1, "drift": 0.0},
    "clutter": {"things": 0},
    "camera": {"width_px": 320, "height_px": 240, "focal_px": 300, "fps": 15},
}


def last_exposure(camera: CameraConfig, *, least_frames: int) -> CameraExposure | None:
    """Of the first reading after so many that shows gain, or of the last of so many."""
    clock, arrived = SystemClock(), asyncio.Event()
    readings: list[VisionReading] = []

    def emit(reading: VisionReading) -> None:
        readings.append(reading)
        arrived.set()

    def done() -> bool:
        exposure = readings[-1].exposure if readings else None
        return len(readings) >= least_frames and (exposure is None or (exposure.gain_db or 0) > 6)

    async def scene() -> None:
        spec = SimCameraSpec(parse(DARK), clock.now_ns() - NS_PER_S)
        service = VisionService("bay1", spec, camera, VisionConfig(method="paper"), clock, emit)
        running = asyncio.get_running_loop().create_task(service.run())
        try:
            async with asyncio.timeout(PATIENCE_S):
                while not done():
                    arrived.clear()
                    await arrived.wait()
        finally:
            running.cancel()
            await asyncio.wait([running], timeout=PATIENCE_S)

    asyncio.run(scene())
    return readings[-1].exposure


def test_in_the_dark_the_time_is_as_long_as_allowed_and_the_gain_makes_up_for_the_rest() -> None:
    exposure = last_exposure(CameraConfig(exposure="marker", exposure_max_ms=6, deadline_s=10), least_frames=1)
    assert exposure is not None
    assert exposure.state in (ExposureState.CONTROLLED, ExposureState.TOO_DARK)
    assert exposure.time_ms == pytest.approx(6.0)


def test_by_default_nothing_is_set_and_nothing_reported() -> None:
    assert last_exposure(CameraConfig(deadline_s=10), least_frames=5) is None
