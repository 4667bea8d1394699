"""RTSP from gst-rtsp-server: codecs, login, and what happens when server or network fail."""

import asyncio
import random
import signal
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from gateway.clock import SystemClock
from gateway.config import CameraConfig
from gateway.core.readings import AgeProof, Quality
from gateway.errors import LinkError
from gateway.vision.source.specs import source_spec
from tests.e2e.rtsp_server import LOGIN, RtspServer, rtsp_server
from tests.e2e.tcp_proxy import NetworkConditions, Proxy
from tests.e2e.test_vision_pool import Bay, family
from tests.long import mostly_long


@pytest.mark.parametrize("codec", mostly_long(["h264", "mjpeg"]))
def test_frames_are_dated_and_whole(codec: str) -> None:
    clock = SystemClock()
    with rtsp_server(codec) as server:
        source = source_spec(CameraConfig(url=server.url)).open(clock)
        frames = [source.read() for _ in range(30)]
        age_s = (clock.now_ns() - frames[-1].t_capture_ns) / 1e9
        source.close()
    assert {frame.pixels.shape for frame in frames} == {(240, 320, 3)}
    assert sum(frame.damaged for frame in frames) == 0
    assert 0 <= age_s < 0.5
    span_s = (frames[-1].t_capture_ns - frames[4].t_capture_ns) / 1e9
    assert span_s == pytest.approx(1.0, abs=0.3)


def test_a_server_that_asks_for_a_digest_takes_the_login_and_no_other(tmp_path: Any) -> None:
    secret = tmp_path / "password"
    with rtsp_server(login=True) as server:
        for password, accepted in ((LOGIN[1], True), ("guess", False)):
            secret.write_text(password)
            config = CameraConfig(url=server.url, username=LOGIN[0], password_file=str(secret))
            if accepted:
                source = source_spec(config).open(SystemClock())
                assert source.read().pixels.shape == (240, 320, 3)
                source.close()
            else:
                with pytest.raises(LinkError, match="cannot be opened: no answer, refused") as error:
                    source_spec(config).open(SystemClock())
                assert "guess" not in str(error.value)


@pytest.mark.long
def test_sender_reports_of_a_synchronised_clock_show_a_constant_delay() -> None:
    """300 ms in the network; and FFmpeg holds an H.264 frame back until the next one comes."""
    clock = SystemClock()
    with rtsp_server() as server, Proxy(server.port, conditions=NetworkConditions(delay_s=0.3)) as proxy:
        url = server.url.replace(str(server.port), str(proxy.port))
        source = source_spec(CameraConfig(url=url, clock="synchronised", deadline_s=5)).open(clock)
        until_ns = clock.now_ns() + int(60e9)
        while (frame := source.read()).age_proof is AgeProof.UNPROVEN and clock.now_ns() < until_ns:
            pass
        age_s = (clock.now_ns() - frame.t_capture_ns) / 1e9
        source.close()
        proxy.cut()
    assert frame.age_proof is AgeProof.DEVICE_TIME
    assert 0.33 < age_s < 1.0


Scene = Callable[[Bay, RtspServer], Coroutine[Any, Any, None]]


def played(scene: Scene, server: RtspServer, url: str = "", **camera: Any) -> Bay:
    """`scene`, once pictures have come; then the server ends before the bay, which is to leave no process."""

    async def whole() -> Bay:
        async with Bay(url or server.url, detector=None, **({"deadline_s": 2.0} | camera)) as bay:
            await bay.quality(Quality.NO_TARGET)
            await scene(bay, server)
            server.end()
            return bay

    return asyncio.run(whole())


def test_a_read_that_hangs_for_ever_costs_its_process_which_is_replaced() -> None:
    async def scene(bay: Bay, server: RtspServer) -> None:
        (before,) = (one.pid for one in family("worker"))
        assert server.process is not None
        server.process.send_signal(signal.SIGSTOP)
        begun_ns = bay.clock.now_ns()
        lost = await bay.quality(Quality.LINK_DOWN, len(bay.readings))
        assert bay.clock.now_ns() - begun_ns < 8e9
        assert "no frame within 2 s" in bay.readings[lost].detail
        server.process.send_signal(signal.SIGCONT)
        await bay.quality(Quality.NO_TARGET, lost)
        assert before not in [one.pid for one in family("worker")]

    with rtsp_server() as server:
        played(scene, server)


@pytest.mark.long
def test_a_server_that_ends_and_returns_with_another_size_is_refused_until_the_size_is_back() -> None:
    async def scene(bay: Bay, server: RtspServer) -> None:
        for width_px, height_px, quality, words in (
            (640, 480, Quality.LINK_DOWN, "its frames are 640 x 480 px; they were 320 x 240 px"),
            (320, 240, Quality.NO_TARGET, ""),
        ):
            server.end()
            await bay.quality(Quality.LINK_DOWN, len(bay.readings))
            server.start(width_px, height_px)
            await bay.until(lambda one, q=quality, w=words: one.quality is q and w in one.detail, len(bay.readings))  # type: ignore[misc]

    with rtsp_server() as server:
        played(scene, server)


@pytest.mark.long
def test_a_link_slower_than_the_stream_is_a_lost_one_by_the_age_of_its_frames() -> None:
    async def scene(bay: Bay, server: RtspServer) -> None:
        proxy.conditions = NetworkConditions(bytes_per_s=150_000)
        lost = await bay.until(lambda one: one.quality is Quality.LINK_DOWN and "late" in one.detail)
        proxy.conditions = NetworkConditions()
        await bay.quality(Quality.NO_TARGET, lost)

    with rtsp_server("mjpeg") as server, Proxy(server.port) as proxy:
        played(scene, server, server.url.replace(str(server.port), str(proxy.port)))


@pytest.mark.long
@pytest.mark.parametrize("codec", ["h264", "mjpeg"])
def test_garbled_bytes_cost_frames_or_the_connection_and_nothing_else(codec: str) -> None:
    chance, altered = random.Random(1), 0

    def garbled(from_client: bool, data: bytes) -> bytes:
        if from_client or len(data) < 1000 or chance.random() < 0.5:
            return data
        nonlocal altered
        altered += 1
        changed = bytearray(data)
        changed[chance.randrange(len(data))] ^= 0xFF
        return bytes(changed)

    async def scene(bay: Bay, server: RtspServer) -> None:
        proxy.alter = garbled
        await asyncio.sleep(5)
        proxy.alter = None
        await bay.until(lambda one: one.quality is Quality.NO_TARGET, len(bay.readings))

    with rtsp_server(codec) as server, Proxy(server.port) as proxy:
        bay = played(scene, server, server.url.replace(str(server.port), str(proxy.port)))
    assert altered > 20
    assert Quality.PROCESS_FAULT not in {one.quality for one in bay.readings}
