"""Frames through real processes to readings; processes that die, hang and throw; and nothing left behind."""

import asyncio
import gc
import os
import signal
import socketserver
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Coroutine, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import psutil
import pytest

from gateway.clock import SystemClock
from gateway.config import CameraConfig, Reconnect, VisionConfig
from gateway.core.detection import Tracking
from gateway.core.readings import AgeProof, Quality, VisionReading
from gateway.errors import ConfigError
from gateway.vision.process import vision_service
from gateway.vision.process.vision_service import VisionService
from gateway.vision.source.contract import SourceSpec
from gateway.vision.source.specs import source_spec
from gateway.vision.transport.messages import DetectorSpec, FrameResult
from tests.e2e.vision_stand_ins import DIE, EXIT, HANG, HANG_LOCKED, THROW, ShadesSpec

FAST = Reconnect(min_s=0.05, max_s=0.1)
STAND_INS = "tests.e2e.vision_stand_ins"
ROOT = Path(__file__).parents[2]
PATIENCE_S = 30.0  # a busy machine may be slow; every wait ends as soon as it can


class Bay:
    """A running service with everything it has emitted. Its deadlines are long, unless a test is of them."""

    def __init__(
        self,
        spec: SourceSpec | str,
        *,
        workers: int = 1,
        look_s: float = 20.0,
        detector: str | None = f"{STAND_INS}:shade_reader",
        cpus: tuple[int, ...] | None = None,
        deadline_s: float = 20.0,
        tracking: bool = True,
        **camera: Any,
    ) -> None:
        camera_config = CameraConfig(
            url=spec if isinstance(spec, str) else "0",
            deadline_s=deadline_s,
            reconnect=FAST,
            affinity=cpus,
            **camera,
        )
        vision = VisionConfig(workers=workers, deadline_s=look_s, affinity=cpus, tracking=tracking)
        self.clock = SystemClock()
        self.readings: list[VisionReading] = []
        self._news = asyncio.Event()
        self._service = VisionService(
            "bay1",
            source_spec(camera_config) if isinstance(spec, str) else spec,
            camera_config,
            vision,
            self.clock,
            self._emit,
            detector=DetectorSpec(vision, detector) if detector else None,
        )

    def _emit(self, reading: VisionReading) -> None:
        self.readings.append(reading)
        self._news.set()

    async def __aenter__(self) -> "Bay":
        self.task = asyncio.get_running_loop().create_task(self._service.run())
        return self

    async def __aexit__(self, *_: object) -> None:
        self.task.cancel()
        await asyncio.wait([self.task], timeout=PATIENCE_S)
        assert self.task.done()
        if not self.task.cancelled():
            self.task.result()
        assert family() == []

    async def until(self, wanted: Callable[[VisionReading], bool], after: int = 0) -> int:
        """Index of the first reading from `after` on that is wanted; waits for it."""
        position = after
        async with asyncio.timeout(PATIENCE_S):
            while True:
                while position < len(self.readings):
                    if wanted(self.readings[position]):
                        return position
                    position += 1
                if self.task.done():
                    self.task.result()
                self._news.clear()
                await self._news.wait()

    async def quality(self, quality: Quality, after: int = 0) -> int:
        return await self.until(lambda reading: reading.quality is quality, after)


def family(role: str = "") -> list[psutil.Process]:
    """Our child processes, by the name they give themselves."""
    children = psutil.Process().children(recursive=True)
    return [child for child in children if not role or child.name().startswith(f"gw-{role}")]


def named_memory() -> list[str]:
    """Named shared memory, except that of gateways and databases that other tests may be running."""
    return sorted(name for name in os.listdir("/dev/shm") if not name.startswith(("loading-gateway", "PostgreSQL.")))


@pytest.fixture(scope="module", autouse=True)
def _compiled_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Where Python is told not to keep bytecode, each of some fifty processes would compile numpy's sources anew."""
    with pytest.MonkeyPatch.context() as patch:
        if sys.dont_write_bytecode:
            patch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
            patch.setenv("PYTHONPYCACHEPREFIX", str(tmp_path_factory.mktemp("bytecode")))
        yield


@pytest.fixture(autouse=True)
def _nothing_left_behind(_nothing_left_in_the_end: None) -> Iterator[None]:
    before = possessions()
    yield
    assert possessions() == before


@pytest.fixture(scope="module")
def _nothing_left_in_the_end() -> Iterator[None]:
    before = possessions()
    assert family() == []
    yield
    assert family() == []
    assert possessions() == before


def possessions() -> tuple[int, int, list[str], int]:
    """What may not grow: processes, descriptors, named memory, threads."""
    gc.collect()  # what tests before have left goes now, not in between
    return len(family()), len(os.listdir("/proc/self/fd")), named_memory(), threading.active_count()


def shades(folder: Path, *values: int) -> str:
    folder.mkdir(exist_ok=True)
    for number, value in enumerate(values):
        cv2.imwrite(str(folder / f"{number}.png"), np.full((16, 24, 3), value, np.uint8))
    return str(folder)


def disc(u: int, v: int, r: int) -> np.ndarray[Any, np.dtype[np.uint8]]:
    image = np.full((240, 320, 3), (120, 120, 120), np.uint8)
    cv2.circle(image, (u, v), r, (30, 30, 200), -1)
    return image


def play(story: Callable[[], Any]) -> None:
    asyncio.run(story())


# The straight road.


def test_a_folder_of_pictures_becomes_circles_with_the_real_pipeline(tmp_path: Path) -> None:
    for n in range(3):
        cv2.imwrite(str(tmp_path / f"{n}.png"), disc(100 + 12 * n, 120, 40))  # no jump, though one be skipped

    async def story() -> None:
        async with Bay(str(tmp_path), detector=None, loop=True, fps=50) as bay:
            at = await bay.until(lambda reading: reading.stats.frames == 20)
        good = bay.readings[: at + 1]
        assert {reading.quality for reading in good} == {Quality.GOOD}
        for before, reading in pairwise(good):
            assert reading.frame_id > before.frame_id
            assert reading.t_ns > before.t_ns
        for reading in good:
            assert reading.circle is not None
            assert reading.circle.u_px == pytest.approx(100 + 12 * ((reading.frame_id - 1) % 3), abs=0.5)
            assert (reading.circle.v_px, reading.circle.radius_px) == pytest.approx((120, 40), abs=1.5)
            assert len(reading.stage_ns) >= 2
            assert reading.tracking is Tracking.MEASURED
            spent_ns = [ns for _, ns in reading.stage_ns]
            assert min(spent_ns) >= 0
            assert 0 < sum(spent_ns) < reading.stats.latency_ms * 1e6  # the same clock
        for reading in good[1:]:  # measured after the result before
            assert reading.picture is not None
            assert reading.picture.brightness == pytest.approx(0.45, abs=0.05)
        last = good[-1]
        # Frames that came while the last one was looked at may have been skipped already.
        assert last.frame_id <= last.stats.frames + last.stats.skipped
        assert (last.stats.lost, last.stats.restarts, last.stats.reopens) == (0, 0, 0)
        assert last.t_ns <= bay.clock.now_ns()

    play(story)


def test_with_other_settings_or_begun_again_after_a_crash_frames_are_numbered_on_and_nothing_is_left(
    tmp_path: Path,
) -> None:
    async def story() -> None:
        async with Bay(shades(tmp_path / "shades", 10, 20, 30), fps=50, loop=True) as bay:
            await bay.quality(Quality.GOOD)
            before = possessions()
            for look_s in (0.9, 0.8, 0.7):
                seen = len(bay.readings)
                old = {child.pid for child in family()}
                bay._service.apply(VisionConfig(deadline_s=look_s))
                await bay.until(lambda _, old=old: not old & {child.pid for child in family()}, after=seen)  # type: ignore[misc]
            assert possessions() == before

            bay.task.cancel()
            with suppress(asyncio.CancelledError):
                await bay.task
            seen = len(bay.readings)
            bay.task = asyncio.get_running_loop().create_task(bay._service.run())
            await bay.quality(Quality.GOOD, after=seen)
            assert possessions() == before
        withdrawn = [reading for reading in bay.readings if reading.quality is Quality.STALE]
        assert len(withdrawn) == 3  # other settings: the values of the old ones count no more
        found = [reading for reading in bay.readings if reading.quality is not Quality.STALE]
        numbers = [reading.frame_id for reading in found]
        assert numbers == sorted(set(numbers))
        times = [reading.t_ns for reading in found]
        assert times == sorted(times)
        assert bay.readings[-1].stats.frames == len(found)

    play(story)


@pytest.mark.failure_mode("C9")
def test_every_frame_of_a_fast_film_is_reported_in_order_and_then_its_end(tmp_path: Path) -> None:
    path = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (320, 240))
    for n in range(60):
        writer.write(disc(40 + 4 * n, 120, 30))
    writer.release()

    async def story() -> None:
        async with Bay(str(path), pace="fast", detector=None, workers=2, look_s=PATIENCE_S, tracking=False) as bay:
            end = await bay.quality(Quality.LINK_DOWN)
            await asyncio.sleep(1.0)  # ten times as long as any other source would stay closed
            assert family() == []
            assert len(bay.readings) == end + 1
        film = bay.readings[:end]
        assert [reading.frame_id for reading in film] == list(range(1, 61))
        for n, reading in enumerate(film):
            assert reading.circle is not None
            assert reading.circle.u_px == pytest.approx(40 + 4 * n, abs=2)
        assert bay.readings[end].detail == f"{path}: ended; it begins again only with camera.loop = true"
        assert (bay.readings[end].stats.frames, bay.readings[end].stats.skipped) == (60, 0)

    play(story)


def test_cancelled_at_any_moment_of_the_start_leaves_nothing(tmp_path: Path) -> None:
    async def story() -> None:
        for delay_s in (0, 0.005, 0.03, 0.1, 0.3):
            async with Bay(shades(tmp_path, 1), workers=2, loop=True):
                await asyncio.sleep(delay_s)

    play(story)


# What the operator must mend.


def test_a_cpu_that_does_not_exist_is_a_configuration_error(tmp_path: Path) -> None:
    async def story() -> None:
        with pytest.raises(ConfigError, match=r"camera\.affinity = \[4000\]: this machine has the CPUs 0 to \d+"):
            async with Bay(shades(tmp_path, 1), cpus=(4000,)) as bay:
                await bay.task

    play(story)


def test_a_source_that_could_never_work_ends_the_service_after_telling(tmp_path: Path) -> None:
    async def story() -> None:
        bay = Bay(ShadesSpec(str(tmp_path / "diary"), 1, ("hopeless",)))
        with pytest.raises(ConfigError, match="bay1: shades: this could never work"):
            async with bay:
                await bay.task
        assert [reading.quality for reading in bay.readings] == [Quality.LINK_DOWN]

    play(story)


# One bay for several tests: what they break is mended, so each finds it whole.


@dataclass
class Standing:
    """A bay that outlives a test, and the loop it lives in."""

    runner: asyncio.Runner
    bay: Bay
    cpu: int
    started: list[psutil.Process]

    def play(self, story: Callable[[], Coroutine[Any, Any, None]]) -> None:
        self.runner.run(story())


@pytest.fixture(scope="class")
def standing(tmp_path_factory: pytest.TempPathFactory, _nothing_left_in_the_end: None) -> Iterator[Standing]:
    """Ctrl-C comes while its processes start."""
    pictures = shades(tmp_path_factory.mktemp("standing") / "pictures", 1)
    cpu = max(os.sched_getaffinity(0))
    with asyncio.Runner() as runner:
        bay = Bay(pictures, loop=True, fps=50, cpus=(cpu,), deadline_s=5)

        async def start() -> list[psutil.Process]:
            await bay.__aenter__()
            await asyncio.sleep(0.02)
            started = family()
            for process in started:
                process.send_signal(signal.SIGINT)
            await bay.quality(Quality.GOOD)
            return started

        yield Standing(runner, bay, cpu, runner.run(start()))
        runner.run(bay.__aexit__())


class TestAStandingBay:
    def test_one_message_a_frame_reaches_the_main_process_and_no_descriptor_is_left_over(
        self, standing: Standing, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        received: Counter[type] = Counter()
        report = vision_service._report

        def counted(monitor: Any, message: Any, now_ns: int) -> None:
            received[type(message)] += 1
            report(monitor, message, now_ns)

        monkeypatch.setattr(vision_service, "_report", counted)

        async def story() -> None:
            bay = standing.bay
            await bay.until(lambda reading: True, after=len(bay.readings))  # the first ones have come
            before = {process.pid: process.num_fds() for process in family()}
            received.clear()
            first = len(bay.readings)
            await bay.until(lambda reading: received.total() >= 20)
            assert received == {FrameResult: len(bay.readings) - first}
            assert {process.pid: process.num_fds() for process in family()} == before

        standing.play(story)

    def test_ctrl_c_hurts_no_process_neither_at_the_start_nor_later(self, standing: Standing) -> None:
        async def story() -> None:
            assert len(standing.started) == 1
            for process in standing.started:
                for _ in range(3):
                    process.send_signal(signal.SIGINT)  # Ctrl-C reaches everyone in the terminal
            bay = standing.bay
            at = await bay.until(lambda reading: reading.quality is Quality.GOOD, after=len(bay.readings) + 3)
            assert family() == standing.started
            assert (bay.readings[at].stats.restarts, bay.readings[at].stats.reopens) == (0, 0)

        standing.play(story)

    def test_affinity_and_names_of_the_processes(self, standing: Standing) -> None:
        assert (len(family("worker-bay1")), len(family())) == (1, 1)  # and no helper
        for process in family():
            assert process.cpu_affinity() == [standing.cpu]


# Vision processes that fail.


POISON = {
    THROW: "vision process: ValueError: poison",
    HANG: "vision process gave no result within 2 s",
    DIE: "vision process was killed by SIGKILL",
    EXIT: "vision process ended with exit code 7",
    HANG_LOCKED: "vision process gave no result within 2 s",
}


@pytest.mark.failure_mode("V3")
def test_each_frame_that_breaks_the_detector_costs_one_process_and_one_frame(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    pictures = [1, 2, THROW, 4, HANG, 6, DIE, 8, EXIT, 10, HANG_LOCKED, 12]

    async def story() -> None:
        async with Bay(shades(tmp_path, *pictures), look_s=2.0, pace="fast") as bay:
            end = await bay.quality(Quality.LINK_DOWN)
        story = [(reading.frame_id, reading.circle and reading.circle.u_px) for reading in bay.readings[:end]]
        assert story == [(n + 1, None if shade in POISON else shade) for n, shade in enumerate(pictures)]
        faults = [reading for reading in bay.readings[:end] if reading.circle is None]
        assert {reading.quality for reading in faults} == {Quality.PROCESS_FAULT}
        assert [reading.detail for reading in faults] == list(POISON.values())
        stats = bay.readings[end].stats
        assert (stats.frames, stats.lost, stats.restarts, stats.skipped) == (7, 5, 5, 0)

    play(story)
    assert "ValueError: poison" in capfd.readouterr().err  # the traceback is there for whoever mends it


@pytest.mark.failure_mode("V2")
def test_a_process_that_is_stopped_is_noticed_and_replaced(tmp_path: Path) -> None:
    async def story() -> None:
        async with Bay(shades(tmp_path, 1), look_s=2.0, deadline_s=2.0, loop=True, fps=20) as bay:
            await bay.until(lambda reading: reading.stats.frames == 3)
            (old,) = family()
            old.suspend()
            fault = await bay.quality(Quality.PROCESS_FAULT)
            await bay.quality(Quality.GOOD, after=fault)
            assert bay.readings[-1].stats.restarts == 1
        frames = [reading.frame_id for reading in bay.readings if reading.quality is Quality.GOOD]
        assert frames == sorted(set(frames))

    play(story)


def test_a_detector_that_cannot_be_built_is_told_and_tried_again(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    async def story() -> None:
        async with Bay(shades(tmp_path, 1), loop=True, detector=f"{STAND_INS}:broken_detector") as bay:
            await bay.until(lambda reading: reading.stats.restarts == 1)
        assert {reading.quality for reading in bay.readings} == {Quality.PROCESS_FAULT}
        assert {reading.detail for reading in bay.readings} == {"vision process: RuntimeError: no such model"}

    play(story)
    assert "RuntimeError: no such model" in capfd.readouterr().err


# Cameras that fail.


@pytest.mark.long
def test_a_source_that_fails_is_noticed_told_and_opened_again_however_it_fails(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    ways = {
        "end": "shades: ended",
        "crash": "ZeroDivisionError: a bug in the driver",
        "large": "shades: its frames are 200 x 200 px; they were 16 x 16 px: "
        "set camera.width_px and height_px to the right size",
        "driver crash": "shades: vision process was killed by SIGSEGV in the source's driver",
        "stall": "shades: no frame within 2 s",
    }

    async def story() -> None:
        spec = ShadesSpec(str(tmp_path / "diary"), 5, tuple(ways))
        async with Bay(spec, deadline_s=2.0, max_megapixels=0.03) as bay:
            downs, at = [], 0
            for _ in ways:
                downs.append(await bay.quality(Quality.LINK_DOWN, after=at))
                at = downs[-1] + 1
            again = await bay.quality(Quality.GOOD, after=at)
        told = [bay.readings[down] for down in downs]
        assert [reading.detail for reading in told] == list(ways.values())
        assert [reading.frame_id for reading in told] == [5, 10, 15, 20, 25]  # numbers go on
        assert bay.readings[again].frame_id > 25
        assert bay.readings[again].stats.reopens == 5
        stalled = downs[-1]
        silence_ns = bay.readings[stalled].t_ns - bay.readings[stalled - 1].t_ns
        assert silence_ns >= 2e9

    play(story)
    assert "ZeroDivisionError: a bug in the driver" in capfd.readouterr().err


@pytest.mark.failure_mode("V6")
def test_a_driver_that_hangs_with_the_interpreter_s_lock_held_is_noticed_from_outside(tmp_path: Path) -> None:
    async def story() -> None:
        async with Bay(ShadesSpec(str(tmp_path / "diary"), 5, ("driver hangs locked",)), deadline_s=2.0) as bay:
            fault = await bay.quality(Quality.PROCESS_FAULT)
            await bay.quality(Quality.GOOD, after=fault)
        assert bay.readings[fault].detail == "vision process has stopped: no sign of life for 2 s"
        assert bay.readings[-1].stats.lost == 0

    play(story)


class MjpegServer(socketserver.ThreadingTCPServer):
    """An HTTP camera on loopback. While `frozen` it says nothing to its connections, while `repeating` one picture with
    a clock burnt into it that goes on; while `half` its pictures are half as wide and high; while `stamped` each has
    its time."""

    allow_reuse_address = True
    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), MjpegHandler)
        self.frozen = threading.Event()
        self.repeating = threading.Event()
        self.half = threading.Event()
        self.stamped = threading.Event()
        self.over = threading.Event()
        self.connections = 0


class MjpegHandler(socketserver.StreamRequestHandler):
    server: MjpegServer

    def handle(self) -> None:
        self.server.connections += 1
        while self.rfile.readline().strip():
            pass
        self.wfile.write(b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n\r\n")
        sent = 0
        with suppress(OSError):
            while not self.server.over.wait(0.04):
                sent += 1
                if not self.server.frozen.is_set():
                    dead, half = self.server.repeating.is_set(), self.server.half.is_set()
                    stamp = f"X-Timestamp: {time.time():.6f}\r\n" if self.server.stamped.is_set() else ""
                    self.wfile.write(self.part(9 if dead else None, sent, 0.5 if half else 1.0, stamp.encode()))

    @staticmethod
    def part(exposure: int | None, clock: int, size: float, stamp: bytes) -> bytes:
        """A live picture's noise is never twice the same: by default each has its own exposure."""
        chance = np.random.default_rng(clock if exposure is None else exposure)
        picture = np.clip(disc(160, 120, 50) + chance.normal(0, 2, (240, 320, 3)), 0, 255).astype(np.uint8)
        cv2.putText(picture, f"12:00:{clock % 60:02d}", (5, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255))
        scaled = cv2.resize(picture, None, fx=size, fy=size)
        jpeg = cv2.imencode(".jpg", scaled)[1].tobytes()
        return b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n%s\r\n%s\r\n" % (len(jpeg), stamp, jpeg)


@pytest.fixture
def mjpeg() -> Iterator[MjpegServer]:
    before = threading.enumerate()
    with MjpegServer() as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        yield server
        server.over.set()
        server.shutdown()
        thread.join()
    for connection in set(threading.enumerate()) - set(before):
        connection.join(5)


@pytest.mark.long
def test_an_http_stream_that_freezes_breaks_off_and_refuses(mjpeg: MjpegServer) -> None:
    port = mjpeg.server_address[1]
    camera = f"http://127.0.0.1:{port}/mjpg"

    async def story() -> None:
        url = f"http://joe:secret@127.0.0.1:{port}/mjpg?password=secret"
        async with Bay(url, detector=None, deadline_s=2.0, frozen_s=1.5, unproven_age="accept") as bay:
            good = await bay.quality(Quality.GOOD)
            circle = bay.readings[good].circle
            assert circle is not None
            assert (circle.u_px, circle.v_px, circle.radius_px) == pytest.approx((160, 120, 50), abs=2)
            assert not any("secret" in " ".join(process.cmdline()) for process in family())
            await bay.until(lambda reading: reading.stats.frames == 10)

            mjpeg.frozen.set()
            down = await bay.quality(Quality.LINK_DOWN)
            assert bay.readings[down].detail == f"{camera}: no frame within 2 s"

            mjpeg.frozen.clear()
            again = await bay.quality(Quality.GOOD, after=down)
            assert mjpeg.connections >= 2
            assert bay.readings[again].frame_id > bay.readings[down].frame_id

            mjpeg.repeating.set()  # frames go on coming, all the same one: once noticed, it is not believed again
            still = await bay.quality(Quality.LINK_DOWN, after=again)
            told = bay.readings[again:still]
            assert sum(reading.t_ns == told[-1].t_ns for reading in told) >= 5  # as old as its first sight
            assert told[-1].frame_id >= told[-5].frame_id + 4
            assert bay.readings[still].detail == f"{camera}: frozen: the picture has not changed for 1.5 s"
            await bay.quality(Quality.LINK_DOWN, after=still + 1)
            assert {reading.quality for reading in bay.readings[still:]} == {Quality.LINK_DOWN}
            mjpeg.repeating.clear()
            again = await bay.quality(Quality.GOOD, after=still)

            mjpeg.shutdown()
            mjpeg.server_close()
            mjpeg.over.set()
            lost = await bay.quality(Quality.LINK_DOWN, after=again)
            refused = await bay.quality(Quality.LINK_DOWN, after=lost + 1)
            refused_again = await bay.quality(Quality.LINK_DOWN, after=refused + 1)
            assert bay.readings[lost].detail == f"{camera}: lost: it gave no further frame"
            for reading in (bay.readings[refused], bay.readings[refused_again]):
                assert (
                    reading.detail
                    == f"{camera}: cannot be opened: no answer, refused, or not a video stream that is accepted"
                )

    play(story)


@pytest.mark.long
@pytest.mark.failure_mode("C11")
def test_an_http_stream_is_good_once_the_times_of_its_parts_prove_its_age(mjpeg: MjpegServer) -> None:
    async def story() -> None:
        async with Bay(f"http://127.0.0.1:{mjpeg.server_address[1]}/mjpg", detector=None) as bay:
            await bay.until(lambda reading: reading.stats.frames == 10)
            assert {reading.quality for reading in bay.readings if reading.stats.frames} == {Quality.STALE}
            mjpeg.stamped.set()
            good = await bay.quality(Quality.GOOD)
            assert bay.readings[good].age_proof is AgeProof.PRESENTATION_TIME

    play(story)


@pytest.mark.failure_mode("C7")
def test_a_picture_of_another_size_is_a_lost_camera_until_it_has_its_size_again(mjpeg: MjpegServer) -> None:
    camera = f"http://127.0.0.1:{mjpeg.server_address[1]}/mjpg"

    async def story() -> None:
        async with Bay(camera, detector=None, deadline_s=0.5, unproven_age="accept") as bay:
            good = await bay.quality(Quality.GOOD)
            mjpeg.frozen.set()  # within one connection FFmpeg scales every picture to the size of the first
            silent = await bay.quality(Quality.LINK_DOWN, after=good)
            mjpeg.half.set()
            mjpeg.frozen.clear()
            of_size = lambda reading: "its frames are" in reading.detail  # noqa: E731
            down = await bay.until(of_size, after=silent)
            again = await bay.until(of_size, after=down + 1)  # opened again it is no better
            for reading in (bay.readings[down], bay.readings[again]):
                assert reading.detail.startswith(f"{camera}: its frames are 160 x 120 px; they were 320 x 240 px")
            assert {reading.quality for reading in bay.readings[silent:]} == {Quality.LINK_DOWN}
            mjpeg.half.clear()
            back = await bay.quality(Quality.GOOD, after=again)
            circle = bay.readings[back].circle
            assert circle is not None
            assert circle.radius_px == pytest.approx(50, abs=2)

        async with Bay(camera, detector=None, width_px=640, height_px=480, unproven_age="accept") as bay:
            down = await bay.quality(Quality.LINK_DOWN)
            assert bay.readings[down].detail == (
                f"{camera}: its frames are 320 x 240 px; camera.width_px and height_px require 640 x 480 px"
            )
            assert down == 0

    play(story)


# The parent dies.

PARENT = """
import asyncio, pathlib, sys
from gateway.clock import SystemClock
from gateway.config import CameraConfig, VisionConfig
from gateway.vision.process.vision_service import VisionService
from gateway.vision.source.specs import source_spec
from gateway.vision.transport.messages import DetectorSpec
from tests.e2e.vision_stand_ins import ShadesSpec

folder = pathlib.Path(sys.argv[1])
camera = CameraConfig(url=str(folder), loop=True, deadline_s=60, open_deadline_s=60)
vision = VisionConfig(deadline_s=60)
hung = DetectorSpec(vision, "tests.e2e.vision_stand_ins:hung_reader")
stalling = ShadesSpec(str(folder / "diary"), 5, ("stall",))
emit = lambda reading: print(reading.quality.name, flush=True)

async def both():
    bays = (
        VisionService("at-work", source_spec(camera), camera, vision, SystemClock(), emit),
        VisionService("stuck", stalling, camera, vision, SystemClock(), emit, detector=hung),
    )
    await asyncio.gather(*(bay.run() for bay in bays))

asyncio.run(both())
"""


@pytest.mark.parametrize("when", ["starting", "running"])
def test_a_parent_killed_without_warning_leaves_no_process_and_no_memory(tmp_path: Path, when: str) -> None:
    """Neither children that are at work, nor such as hear nothing, not even the end of their connection."""
    shm_before = named_memory()
    cv2.imwrite(str(tmp_path / "0.png"), disc(100, 100, 40))
    command = [sys.executable, "-c", PARENT, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as parent:
        assert parent.stdout is not None
        watched = psutil.Process(parent.pid)
        if when == "starting":  # the children are still importing
            wait_for(lambda: len(watched.children(recursive=True)) == 2)
        else:
            missing = {"GOOD", "hung", "stalled"}
            while missing:
                missing.discard(parent.stdout.readline().strip())
        children = watched.children(recursive=True)
        assert len(children) == 2
        assert named_memory() == shm_before
        rings = frame_memory(parent.pid)
        assert len(rings) == 2

        parent.kill()

        wait_for(lambda: all(map(dead, children)))
        assert named_memory() == shm_before
    assert not any(rings & frame_memory(process.pid) for process in psutil.process_iter())


def wait_for(condition: Callable[[], bool]) -> None:
    until = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.002)


def dead(process: psutil.Process) -> bool:
    """A zombie is dead, too: it has given everything back, and only waits for init to take note of it."""
    try:
        return process.status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def frame_memory(pid: int) -> set[int]:
    """Which rings a process holds, by inode: they have no name."""
    found: set[int] = set()
    with suppress(OSError):
        for fd in Path(f"/proc/{pid}/fd").iterdir():
            if "memfd:gateway-frames" in os.readlink(fd):
                found.add(fd.stat().st_ino)
    return found


def test_settings_change_while_it_runs_and_the_frames_are_counted_on(tmp_path: Path) -> None:
    image = np.full((240, 320, 3), 120, np.uint8)
    cv2.circle(image, (150, 110), 50, (30, 30, 200), -1)
    for n in range(2):
        cv2.imwrite(str(tmp_path / f"{n}.png"), image)

    async def scene() -> None:
        async with Bay(str(tmp_path), detector=None, loop=True, fps=30.0) as bay:
            first = await bay.until(lambda reading: reading.quality is Quality.GOOD)
            settings = bay._service.settings
            with pytest.raises(ConfigError, match=r"vision\.workers can't change"):
                bay._service.apply(settings.model_copy(update={"workers": 3}))
            before = family()

            bay._service.apply(settings.model_copy(update={"method": "paper", "tracking": False}))
            withdrawn = bay.readings[-1]  # at once, and not only when it is too old
            assert (withdrawn.quality, withdrawn.circle) == (Quality.STALE, None)
            assert withdrawn.detail == "other settings: a new vision process starts"

            def by_the_paper(reading: VisionReading) -> bool:
                return reading.quality is Quality.GOOD and reading.tracking is Tracking.OFF

            changed = await bay.until(by_the_paper, first)
            assert bay._service.settings.method == "paper"
            assert not [process for process in before if process.is_running()]
            told = [reading for reading in bay.readings if reading.quality in (Quality.GOOD, Quality.NO_TARGET)]
            assert all(old.frame_id < new.frame_id for old, new in pairwise(told))
            assert bay.readings[changed].stats.frames >= bay.readings[first].stats.frames
            assert not [r for r in bay.readings if r.quality in (Quality.PROCESS_FAULT, Quality.LINK_DOWN)]

    asyncio.run(scene())


def test_a_vision_process_heeds_the_radii_it_is_told_and_forgets_them(tmp_path: Path) -> None:
    image = np.full((240, 320, 3), 120, np.uint8)
    cv2.circle(image, (200, 110), 70, (30, 30, 200), -1)
    cv2.circle(image, (50, 190), 20, (30, 30, 200), -1)
    for n in range(2):
        cv2.imwrite(str(tmp_path / f"{n}.png"), image)

    def of(radius_px: float) -> Callable[[VisionReading], bool]:
        return lambda reading: reading.circle is not None and abs(reading.circle.radius_px - radius_px) < 3

    async def scene() -> None:
        async with Bay(str(tmp_path), detector=None, loop=True, fps=30.0) as bay:
            radii: list[tuple[float, float] | None] = [(15.0, 30.0)]

            async def told() -> None:
                while radii:
                    bay._service.expect(radii[0])
                    await asyncio.sleep(0.06)

            at = await bay.until(of(70))
            telling = asyncio.create_task(told())
            at = await bay.until(of(20), at)
            radii[0] = (100.0, 140.0)
            at = await bay.until(lambda reading: reading.quality is Quality.NO_TARGET, at)
            wrong = bay.readings[at].wrong_size
            assert wrong is not None
            assert abs(wrong.radius_px - 20) < 3  # it was followed, and fitted
            radii.clear()
            await telling
            await bay.until(lambda reading: reading.circle is not None, at)  # nobody says it any more
            assert not [r for r in bay.readings if r.quality in (Quality.PROCESS_FAULT, Quality.LINK_DOWN)]

    asyncio.run(scene())
