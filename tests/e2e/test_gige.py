"""A GigE Vision camera through Aravis: its frames, its settings, lost packets, and what happens when it goes."""

import asyncio
import time
from typing import Any

import numpy as np
import pytest

from gateway.clock import SystemClock
from gateway.config import CameraConfig
from gateway.core.readings import AgeProof, Quality
from gateway.errors import LinkError
from gateway.vision.exposure.settings import Exposure, ExposureRules
from gateway.vision.source.gige_source import GigeSource
from gateway.vision.source.specs import source_spec
from tests.e2e.gige_camera import URL, FakeCamera, fake_camera
from tests.e2e.test_vision_pool import Bay

PATIENCE_S = 30.0


def opened(**keys: Any) -> GigeSource:
    """As soon as it answers: after the one before it may belong to a program that has ended for some seconds."""
    spec = source_spec(CameraConfig.model_validate({"url": URL, "deadline_s": 5} | keys))
    end_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            source = spec.open(SystemClock())
        except LinkError:
            if time.monotonic() > end_s:
                raise
            time.sleep(0.05)
        else:
            assert isinstance(source, GigeSource)
            return source


def test_its_region_rate_format_exposure_and_gain_are_set_and_its_frames_dated() -> None:
    clock = SystemClock()
    with fake_camera() as camera:
        camera.plug_in()
        keys = {
            "width_px": 160,
            "height_px": 120,
            "fps": 50.0,
            "gige": {"pixel_format": "BayerRG8", "offset_x_px": 16, "offset_y_px": 8, "packet_size_bytes": 1000},
            "controls": {"exposure_time_absolute": 30, "gain": 4},
        }
        source = opened(**keys)
        begun_ns = clock.now_ns()
        frames = [source.read() for _ in range(80)]
        while frames[-1].age_proof is AgeProof.UNPROVEN and clock.now_ns() < begun_ns + PATIENCE_S * 10**9:
            frames.append(source.read())
        now_ns = clock.now_ns()
        settings = {one.name: one.value for one in source.controls().offered()}
        region = [source._camera.ask(f"get_{it}", b) for it, b in (("integer", b"OffsetX"), ("integer", b"OffsetY"))]
        assert source._camera.ask("get_integer", b"GevSCPSPacketSize") == 1000
        exposure = source.exposure_controls(ExposureRules(max_time_us=8000, gain_range_db=(0, 20)))
        assert exposure is not None
        assert exposure.now.time_us == 8000 or exposure.now.amount == pytest.approx(Exposure(3000, 8).amount, rel=0.1)
        assert exposure.set(Exposure(5000, 6)) == Exposure(5000, 6)
        source.close()
    assert {frame.pixels.shape for frame in frames} == {(120, 160, 3)}
    assert all(begun_ns - 10**9 < frame.t_capture_ns <= now_ns for frame in frames)
    assert frames[-1].age_proof is AgeProof.PRESENTATION_TIME  # Aravis' camera has no clock that can be read
    times_ms = np.diff([frame.t_capture_ns for frame in frames]) / 1e6
    assert (times_ms > 0).all()
    assert np.median(times_ms) == pytest.approx(20, abs=2)
    assert region == [16, 8]
    assert settings == {"exposure_time_absolute": 30, "gain_automatic": 0, "gain": 4}


@pytest.mark.parametrize("pixel_format", ["Mono8", "RGB8", "Mono16", "BayerBG8"])
def test_each_of_its_formats_is_a_picture(pixel_format: str) -> None:
    with fake_camera() as camera:
        camera.plug_in()
        source = opened(gige={"pixel_format": pixel_format})
        frame = source.read()
        source.close()
    assert frame.pixels.shape == (512, 512, 3)
    assert frame.pixels.max() > frame.pixels.min()


def test_what_it_can_not_be_set_to_is_said_in_its_words() -> None:
    with fake_camera() as camera:
        camera.plug_in()
        opened().close()
        for keys, words in (
            ({"gige": {"pixel_format": "Mono12"}}, r"^gige://127.0.0.1: cannot be opened: .*'Mono12' not an entry"),
            ({"url": "usb3://127.0.0.1"}, "usb3://127.0.0.1: cannot be opened: it is another kind of camera"),
            ({"controls": {"brightness": 3}}, "camera.controls.brightness = 3: the camera has no such control"),
            ({"controls": {"gain": 11}}, "camera.controls.gain = 11: the camera takes 0 to 10"),
        ):
            with pytest.raises(LinkError, match=words):
                source_spec(CameraConfig.model_validate({"url": URL} | keys)).open(SystemClock())


def test_a_frame_that_lacks_packets_is_skipped_and_counted(caplog: pytest.LogCaptureFixture) -> None:
    with fake_camera() as camera:
        camera.plug_in(lost_per_mille=1)  # a frame has 190 packets
        source = opened(fps=50.0)
        damaged = sum(source.read().damaged for _ in range(80))
        again, missing = source._camera.packets
        source.close()
    assert 0 < damaged <= again + missing
    assert len(caplog.messages) == 1
    assert "pictures were damaged or lost" in caplog.text


def test_unplugged_and_back() -> None:
    async def scene(camera: FakeCamera) -> None:
        camera.plug_in()
        async with Bay(URL, detector=None, deadline_s=2.0) as bay:
            seen = await bay.quality(Quality.NO_TARGET)
            camera.unplug()
            gone = await bay.quality(Quality.LINK_DOWN, seen)
            assert "gige://127.0.0.1: " in bay.readings[gone].detail
            camera.plug_in()
            await bay.quality(Quality.NO_TARGET, gone)
            camera.unplug()  # the service is to leave no process behind: nor is the camera

    with fake_camera() as camera:
        asyncio.run(scene(camera))
