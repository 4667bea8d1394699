"""Which source a URL or path means, and how its frames come: at what pace, with what stamp, until what end."""

import os
import socketserver
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from gateway.clock import SystemClock
from gateway.config import CameraConfig
from gateway.errors import ConfigError, LinkError
from gateway.vision.source.capture import CaptureSource
from gateway.vision.source.contract import Source
from gateway.vision.source.files import Pace
from gateway.vision.source.frame_time import ArrivalTime, BufferTime, FrameTime, PresentationTime
from gateway.vision.source.specs import CameraSpec, FileSpec, StreamSpec, source_spec
from gateway.vision.transport.messages import SourceRecord
from tests.virtual_time import LoopClock

S = 1_000_000_000


class StepClock(LoopClock):
    """A clock that only moves when somebody blocks on it."""

    def __init__(self) -> None:
        self.now = 0
        self.naps: list[float] = []

    def now_ns(self) -> int:
        return self.now

    def block(self, seconds: float) -> None:
        self.naps.append(seconds)
        self.now += round(seconds * S)


@pytest.fixture
def clock() -> StepClock:
    return StepClock()


# Which source.


@pytest.mark.parametrize(
    ("url", "spec"),
    [
        ("0", CameraSpec(0)),
        (" 12 ", CameraSpec(12)),
        ("/dev/video2", CameraSpec("/dev/video2")),
        ("/dev/v4l/by-id/usb-cam", CameraSpec("/dev/v4l/by-id/usb-cam")),
        ("film.mp4", FileSpec("film.mp4")),
        ("/data/frames", FileSpec("/data/frames")),
        ("2024-05-01", FileSpec("2024-05-01")),
        ("1234567890", FileSpec("1234567890")),
        ("rtsp://cam/1", StreamSpec("rtsp://cam/1", 9.0, 2.0)),
        ("RTSP://cam:8554/1", StreamSpec("RTSP://cam:8554/1", 9.0, 2.0)),
        ("https://[::1]:8080/mjpg", StreamSpec("https://[::1]:8080/mjpg", 9.0, 2.0, stamped=False)),
    ],
)
def test_the_url_decides(url: str, spec: object) -> None:
    assert source_spec(CameraConfig(url=url)) == spec


def test_the_configuration_reaches_the_source() -> None:
    asked = CameraConfig(url="3", width_px=640, height_px=480, fps=30)
    assert source_spec(asked) == CameraSpec(3, 640, 480, 30.0)
    files = CameraConfig(url="~/x", fps=5, pace="fast", loop=True)
    assert source_spec(files) == FileSpec(str(Path.home() / "x"), 5.0, fast=True, loop=True)
    stream = CameraConfig(url="http://h/", open_deadline_s=3, deadline_s=0.4)
    assert source_spec(stream) == StreamSpec("http://h/", 0.9 * 3, 2 * 0.4, late_s=0.4, stamped=False)


@pytest.mark.parametrize("url", ["0", "/dev/video0", "rtsp://cam/1", "http://cam/mjpg", "gst:///pipeline", "usb3://"])
@pytest.mark.parametrize("key", [{"loop": True}, {"pace": "fast"}])
def test_how_a_file_is_played_is_refused_of_a_camera(url: str, key: dict[str, Any]) -> None:
    (name,) = key
    with pytest.raises(ConfigError, match=rf'^camera.{name}: is (true|"fast"); only a film, a picture or a folder'):
        source_spec(CameraConfig(url=url, **key))


@pytest.mark.parametrize(
    ("url", "frame_time", "by_arrival"),
    [
        ("0", "auto", False),
        ("/dev/video2", "presentation", False),
        ("0", "arrival", True),
        ("rtsp://cam/1", "auto", False),
        ("RTSPS://cam/1", "auto", False),
        ("rtsp://cam/1", "arrival", True),
        ("http://cam/mjpg", "auto", True),
        ("http://cam/mjpg", "arrival", True),
        ("http://cam/live.ts", "presentation", False),
    ],
)
def test_where_the_stamps_come_from(url: str, frame_time: Any, by_arrival: bool) -> None:
    spec = source_spec(CameraConfig(url=url, frame_time=frame_time))
    assert isinstance(spec, CameraSpec | StreamSpec)
    stamped = not isinstance(spec, StreamSpec) or spec.stamped
    assert (spec.by_arrival or not stamped) == by_arrival


@pytest.mark.parametrize(
    ("url", "words"),
    [
        (
            "ftp://secret:word@host/x",
            r"scheme ftp:// is unknown; known: rtsp, rtsps, http, https, gige, usb3, gst, or a path",
        ),
        ("rtps://cam/1", "scheme rtps:// is unknown"),
        ("://", "scheme :// is unknown"),
        ("rtsp:///1", "rtsp:// needs a host"),
        ("http://", "http:// needs a host"),
        ("~nobody-of-that-name/film.avi", "there is no such user"),
        ("~\0", "a NUL is part of no address"),
        ("rtsp://joe:secret@cam/\0", "a NUL is part of no address"),
        ("http://secret:word@host:99999/", "not a usable http:// address"),
        ("http://[::1/", "not a usable http:// address"),
        (
            "rtsp://joe:secret#1@cam/1",
            r"not a usable rtsp:// address; write / \? # in a password as %2F %3F %23, or use",
        ),
        ("rtsp://joe:secret/1@cam/1", "not a usable rtsp:// address; write"),
        ("rtsp://joe#secret@cam/1", "has @ behind the host; write"),
        ("http://joe:1?secret@cam/1", r"has @ behind the host; write .* and @ elsewhere as %40"),
    ],
)
def test_what_could_never_work_is_a_configuration_error_without_the_password(url: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words) as error:
        source_spec(CameraConfig(url=url))
    assert "secret" not in str(error.value)


def test_user_and_password_as_keys_of_their_own(tmp_path: Path) -> None:
    secret = tmp_path / "password"
    secret.write_text("s#c/r?t@\n")
    spec = source_spec(CameraConfig(url="rtsp://cam:554/1?a=b@c", username="jo:e", password_file=str(secret)))
    assert isinstance(spec, StreamSpec)
    assert spec.url == "rtsp://jo%3Ae:s%23c%2Fr%3Ft%40@cam:554/1?a=b@c"
    assert spec.label == "rtsp://cam:554/1"
    one = source_spec(CameraConfig(url="http://cam/", username="joe"))
    assert isinstance(one, StreamSpec)
    assert one.url == "http://joe@cam/"


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"url": "rtsp://cam/1", "password_file": "PW"}, "camera.username: is missing; a password needs a user name"),
        ({"url": "rtsp://joe@cam/1", "username": "joe"}, "camera.username: camera.url names a user, too"),
        (
            {"url": "rtsp://cam/1", "username": "joe", "password_file": "none"},
            r"camera\.password_file = .none.: No such",
        ),
        ({"url": "0", "username": "joe"}, "camera.username: only a stream"),
        ({"url": "film.avi", "password_file": "PW"}, "camera.username: only a stream"),
    ],
)
def test_keys_for_a_login_that_could_never_work(tmp_path: Path, values: dict[str, str], words: str) -> None:
    (tmp_path / "PW").write_text("secret")
    given = {key: str(tmp_path / "PW") if value == "PW" else value for key, value in values.items()}
    with pytest.raises(ConfigError, match=words):
        source_spec(CameraConfig(**given))


@pytest.mark.parametrize("keys", [{"url": "0"}, {"url": "gst:///a"}, {"url": "rtsp://cam/1", "frame_time": "arrival"}])
def test_a_clock_that_the_source_does_not_show_is_refused(keys: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=r"camera\.clock: only the times of an rtsp:// or http:// stream show it"):
        source_spec(CameraConfig(clock="synchronised", **keys))
    shown = source_spec(CameraConfig(clock="synchronised", url="rtsp://cam/1"))
    assert isinstance(shown, StreamSpec)
    assert shown.synchronised


def test_a_pace_slower_than_the_deadline_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"fps = 0\.5 is one frame in 2 s, but camera\.deadline_s = 1"):
        source_spec(CameraConfig(url="frames", fps=0.5, deadline_s=1))
    source_spec(CameraConfig(url="frames", fps=0.5, deadline_s=1, pace="fast"))
    source_spec(CameraConfig(url="frames", fps=0.5, deadline_s=3))


@settings(deadline=None)
@given(st.one_of(st.text(max_size=30), st.text("~/0ahtp:s@[]?#.\\\0", max_size=12)))
def test_any_url_is_a_source_or_a_configuration_error(url: str) -> None:
    try:
        spec = source_spec(CameraConfig().model_copy(update={"url": url}))
    except ConfigError:
        return
    assert SourceRecord.of(spec).spec() == spec


def test_no_password_is_shown() -> None:
    spec = source_spec(CameraConfig(url="rtsp://joe:secret@cam:554/live?user=joe&password=secret#secret"))

    assert spec.label == "rtsp://cam:554/live"
    assert "secret" not in repr(spec)


# Files.


def shade(value: int, height: int = 8, width: int = 12) -> NDArray[np.uint8]:
    return np.full((height, width, 3), value, np.uint8)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for number in (10, 9, 1, 2):
        cv2.imwrite(str(tmp_path / f"frame{number}.png"), shade(number))
    (tmp_path / "labels.jsonl").write_text("{}")
    return tmp_path


def shades(source: Source, count: int) -> list[int]:
    return [int(source.read().image[0, 0, 0]) for _ in range(count)]


def test_a_folder_is_read_in_natural_order_at_its_pace_and_ends(folder: Path, clock: StepClock) -> None:
    source = source_spec(CameraConfig(url=str(folder))).open(clock)
    assert not source.lossless
    assert source.may_repeat
    assert source.finite

    frames = [source.read() for _ in range(4)]

    assert [int(frame.image[0, 0, 0]) for frame in frames] == [1, 2, 9, 10]
    assert [frame.t_capture_ns for frame in frames] == [0, S // 10, 2 * S // 10, 3 * S // 10]
    with pytest.raises(LinkError, match=r"ended$"):
        source.read()
    assert clock.now == 4 * S // 10  # the last picture had its full time
    source.close()
    source.close()


def test_fast_means_every_frame_at_once(folder: Path, clock: StepClock) -> None:
    source = source_spec(CameraConfig(url=str(folder), pace="fast", fps=1)).open(clock)

    assert source.lossless
    assert shades(source, 4) == [1, 2, 9, 10]
    assert (clock.now, clock.naps) == (0, [])
    with pytest.raises(LinkError, match="ended"):
        source.read()


def test_loop_begins_again_without_losing_the_beat(folder: Path, clock: StepClock) -> None:
    source = source_spec(CameraConfig(url=str(folder), loop=True, fps=4)).open(clock)

    assert shades(source, 9) == [1, 2, 9, 10, 1, 2, 9, 10, 1]
    assert clock.now == 8 * S // 4


def test_a_broken_picture_is_skipped_and_named(
    folder: Path, clock: StepClock, caplog: pytest.LogCaptureFixture
) -> None:
    (folder / "frame2.png").write_bytes(b"not a picture")
    source = source_spec(CameraConfig(url=str(folder), pace="fast")).open(clock)

    assert shades(source, 3) == [1, 9, 10]
    assert "frame2.png: damaged, cut short, or not a picture in a known format; skipped" in caplog.text


def test_names_that_are_not_utf_8_are_no_harm(folder: Path, clock: StepClock, caplog: pytest.LogCaptureFixture) -> None:
    """OpenCV's own file functions end the process on such a name."""
    odd = os.fsencode(folder) + b"/frame3\xff"
    (folder / "frame2.png").rename(os.fsdecode(odd + b".png"))
    Path(os.fsdecode(odd + b".jpg")).write_bytes(b"junk")
    Path(os.fsdecode(odd + b".avi")).write_bytes(b"something")

    source = source_spec(CameraConfig(url=str(folder), pace="fast")).open(clock)
    assert shades(source, 4) == [1, 2, 9, 10]
    assert "damaged" in caplog.text

    spec = FileSpec(os.fsdecode(odd + b".avi"))
    assert spec.label == f"{folder}/frame3\\udcff.avi"
    with pytest.raises(LinkError, match=r"the name of a video must be valid UTF-8$") as error:
        spec.open(clock)
    str(error.value).encode()  # a message goes on to the plant
    assert shades(FileSpec(os.fsdecode(odd + b".png")).open(clock), 1) == [2]


@pytest.mark.parametrize("loop", [False, True])
def test_a_folder_of_broken_pictures_is_lost_not_searched_for_ever(
    tmp_path: Path, clock: StepClock, loop: bool
) -> None:
    for name in ("a.png", "b.jpg"):
        (tmp_path / name).write_bytes(b"junk")
    source = source_spec(CameraConfig(url=str(tmp_path), loop=loop)).open(clock)

    with pytest.raises(LinkError, match="no picture here can be read"):
        source.read()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path: None, "no such file or folder"),
        (lambda path: path.mkdir(), "no pictures in this folder"),
        (lambda path: path.write_bytes(b"junk" * 100), "neither a video nor a picture"),
        (lambda path: path.write_bytes(b""), "neither a video nor a picture"),
    ],
)
def test_what_cannot_be_opened_may_come_back(
    tmp_path: Path, clock: StepClock, make: Callable[[Path], object], words: str
) -> None:
    path = tmp_path / "source"
    make(path)
    spec = source_spec(CameraConfig(url=str(path)))

    with pytest.raises(LinkError, match=words):
        spec.open(clock)


def test_a_path_that_the_system_refuses_is_a_link_error(clock: StepClock) -> None:
    with pytest.raises(LinkError, match="x: cannot be read: File name too long"):
        source_spec(CameraConfig().model_copy(update={"url": "x" * 5000})).open(clock)


def test_a_missing_camera_is_a_link_error(clock: StepClock) -> None:
    with pytest.raises(LinkError, match=r"camera /dev/video97: cannot be opened: no such device; there is "):
        source_spec(CameraConfig(url="/dev/video97")).open(clock)


def test_a_single_picture_is_a_source(folder: Path, clock: StepClock) -> None:
    source = source_spec(CameraConfig(url=str(folder / "frame9.png"), loop=True)).open(clock)
    assert shades(source, 3) == [9, 9, 9]


def test_an_animated_gif_is_a_film_alone_and_a_picture_in_a_folder(tmp_path: Path, clock: StepClock) -> None:
    animation = cv2.Animation()
    animation.frames = [shade(value) for value in (10, 90, 200)]
    animation.durations = [50] * 3
    assert cv2.imwriteanimation(str(tmp_path / "a.gif"), animation)

    alone = source_spec(CameraConfig(url=str(tmp_path / "a.gif"))).open(clock)
    assert shades(alone, 3) == pytest.approx([10, 90, 200], abs=35)  # its palette is coarse
    assert clock.now == 2 * S // 20
    in_folder = source_spec(CameraConfig(url=str(tmp_path), pace="fast")).open(clock)
    assert shades(in_folder, 1) == pytest.approx([10], abs=35)
    with pytest.raises(LinkError, match="ended"):
        in_folder.read()


@pytest.fixture
def film(tmp_path: Path) -> Path:
    path = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (64, 48))
    assert writer.isOpened()
    for number in range(5):
        writer.write(shade(40 * number + 20, 48, 64))
    writer.release()
    return path


def test_a_film_runs_at_its_own_rate_and_ends(film: Path, clock: StepClock) -> None:
    source = source_spec(CameraConfig(url=str(film), fps=3)).open(clock)
    assert source.finite
    assert not source.lossless
    frames = [source.read() for _ in range(5)]

    assert [frame.t_capture_ns for frame in frames] == [n * S // 20 for n in range(5)]
    assert [round(float(frame.image.mean()), -1) for frame in frames] == [20, 60, 100, 140, 180]
    assert frames[0].image.shape == (48, 64, 3)
    with pytest.raises(LinkError, match=r"film\.avi: ended"):
        source.read()
    assert clock.now == 5 * S // 20
    source.close()
    source.close()


def test_a_film_in_a_loop_keeps_the_beat(film: Path, clock: StepClock) -> None:
    source = source_spec(CameraConfig(url=str(film), loop=True)).open(clock)
    assert not source.finite
    assert source.may_repeat
    frames = [source.read() for _ in range(12)]

    assert [frame.t_capture_ns for frame in frames] == [n * S // 20 for n in range(12)]
    assert [round(float(frame.image.mean()), -1) for frame in frames][4:7] == [180, 20, 60]


def test_a_fast_film_is_lossless(film: Path, clock: StepClock) -> None:
    source = source_spec(CameraConfig(url=str(film), pace="fast")).open(clock)
    assert source.lossless
    for _ in range(5):
        source.read()
    assert clock.naps == []


def test_a_source_that_falls_behind_goes_on_from_now_instead_of_rushing(clock: StepClock) -> None:
    pace = Pace(0.1, clock)
    pace.wait()
    clock.now += round(0.35 * S)
    pace.wait()  # late: at once
    late = clock.now
    pace.wait()
    pace.wait()

    assert late == round(0.35 * S)
    assert clock.now - late == pytest.approx(0.1 * S, abs=2)


# Live sources.


class Driver:
    """Stands in for cv2.VideoCapture: `retrieve` takes 30 ms of the clock."""

    def __init__(self, clock: StepClock, images: list[NDArray[Any] | None], stamps_ms: Iterable[float] = ()) -> None:
        self.clock = clock
        self.images = images
        self.stamps_ms = iter(stamps_ms)
        self.released = 0

    def get(self, key: int) -> float:
        assert key == cv2.CAP_PROP_POS_MSEC
        return next(self.stamps_ms, 0.0)

    def grab(self) -> bool:
        return bool(self.images)

    def retrieve(self) -> tuple[bool, NDArray[Any] | None]:
        self.clock.now += 30_000_000
        image = self.images.pop(0)
        return image is not None, image

    def release(self) -> None:
        self.released += 1


def live(driver: Driver, clock: StepClock, frame_time: FrameTime) -> CaptureSource:
    return CaptureSource(driver, CameraSpec("1"), clock, frame_time)  # type: ignore[arg-type]  # has what is used


def test_a_live_frame_is_stamped_when_it_is_handed_over_not_when_it_is_converted(clock: StepClock) -> None:
    clock.now = 5 * S
    driver = Driver(clock, [np.full((2, 2), 0x4200, np.uint16)])
    source = live(driver, clock, ArrivalTime())

    frame = source.read()

    assert (frame.t_capture_ns, tuple(frame.image[0, 0])) == (5 * S, (0x42, 0x42, 0x42))
    assert not source.lossless
    assert not source.may_repeat
    assert not source.finite
    with pytest.raises(LinkError, match="camera 1: lost: it gave no further frame"):
        source.read()
    source.close()
    assert driver.released == 1


def test_a_damaged_frame_is_skipped_and_counted_and_only_many_in_a_row_are_a_lost_source(clock: StepClock) -> None:
    two_channels = np.zeros((2, 2, 2), np.uint8)
    driver = Driver(clock, [shade(1), None, shade(2), two_channels, *[None] * 8, shade(3), *[None] * 9, two_channels])
    source = live(driver, clock, ArrivalTime())

    frames = [source.read() for _ in range(3)]
    assert [(int(frame.image[0, 0, 0]), frame.damaged) for frame in frames] == [(1, 0), (2, 1), (3, 9)]
    with pytest.raises(LinkError, match=r"^camera 1: lost: 2 channels: only grey"):
        source.read()
    assert driver.images == []


def test_frames_held_back_by_the_driver_are_as_old_as_their_buffers(clock: StepClock) -> None:
    clock.now = 50 * S
    driver = Driver(clock, [shade(n) for n in range(3)], [49_900.0, 49_200.0, 50_030.0])
    source = live(driver, clock, BufferTime(lambda: 0))
    taken = [source.read().t_capture_ns for _ in range(3)]
    assert taken == [49_900_000_000, 49_200_000_000, 50_030_000_000]


def test_a_stream_that_stays_behind_is_lost_with_its_delay(clock: StepClock) -> None:
    """One frame every 30 ms of its own time, delivered at half that pace."""
    driver = Driver(clock, [shade(1)] * 500, (15.0 * n for n in range(500)))
    source = live(driver, clock, PresentationTime())
    assert [source.read().t_capture_ns for _ in range(101)] == [n * 15_000_000 for n in range(101)]
    with pytest.raises(LinkError, match=r"^camera 1: its frames arrive 1\.5 s late$"):
        shades(source, 500)
    assert clock.now == 101 * 30_000_000


def test_a_short_delay_is_no_loss(clock: StepClock) -> None:
    stamps = [30.0 * n for n in range(200)]
    stamps[100:] = [stamp - 990.0 for stamp in stamps[100:]]
    source = live(Driver(clock, [shade(1)] * 200, stamps), clock, PresentationTime())
    for _ in range(200):
        source.read()


@pytest.fixture
def transport_stream(tmp_path: Path) -> bytes:
    """4 s of MPEG-TS at 25 frames a second, each with its presentation time."""
    path = tmp_path / "film.ts"
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"mp4v"), 25.0, (320, 240))
    assert writer.isOpened()
    chance = np.random.default_rng(1)
    for _ in range(100):
        writer.write(chance.integers(0, 256, (240, 320, 3), dtype=np.uint8))
    writer.release()
    return path.read_bytes()


class StallingServer(socketserver.ThreadingTCPServer):
    """Sends a film over HTTP at its pace; after its half nothing for `stall_s`, then at once what was held back."""

    allow_reuse_address = True
    daemon_threads = True
    film: bytes
    stall_s = 0.9


class StallingHandler(socketserver.StreamRequestHandler):
    server: StallingServer

    def handle(self) -> None:
        while self.rfile.readline().strip():
            pass
        self.wfile.write(b"HTTP/1.0 200 OK\r\nContent-Type: video/mp2t\r\n\r\n")
        film, begun = self.server.film, time.monotonic()
        with suppress(OSError):
            for n in range(100):
                due = begun + 0.04 * n
                if 0 <= n - 50 < 25 * self.server.stall_s:
                    due = begun + 0.04 * 50 + self.server.stall_s
                time.sleep(max(0.0, due - time.monotonic()))
                self.wfile.write(film[n * len(film) // 100 : (n + 1) * len(film) // 100])


@pytest.mark.long
def test_what_a_network_held_back_is_as_old_as_the_stream_says(transport_stream: bytes) -> None:
    with StallingServer(("127.0.0.1", 0), StallingHandler) as server:
        server.film = transport_stream
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        clock = SystemClock()
        url = f"http://127.0.0.1:{server.server_address[1]}/live.ts"
        source = source_spec(CameraConfig(url=url, frame_time="presentation", deadline_s=5)).open(clock)
        ages_s = []
        with suppress(LinkError):
            while True:
                frame = source.read()
                ages_s.append((clock.now_ns() - frame.t_capture_ns) / S)
        source.close()
        server.shutdown()
        thread.join()
    assert len(ages_s) > 60
    oldest = max(range(len(ages_s)), key=ages_s.__getitem__)
    assert 0.5 < ages_s[oldest] < 3.0
    assert ages_s[oldest + 10] < ages_s[oldest] - 0.2  # the burst works itself off


@dataclass
class Requests:
    """Every request to cv2.VideoCapture, in whose place it stands."""

    opens: bool
    made: list[Any] = field(default_factory=list)
    options: list[str] = field(default_factory=list)

    def __call__(self, *args: Any) -> "Requests":
        self.made.append(args)
        self.options.append(os.environ.get("OPENCV_FFMPEG_CAPTURE_OPTIONS", ""))
        return self

    def isOpened(self) -> bool:
        return self.opens

    def set(self, key: int, value: float) -> bool:
        self.made.append((key, value))
        return False


def test_a_camera_is_asked_for_what_is_configured_and_for_nothing_else(
    clock: StepClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    requests = Requests(opens=True)
    monkeypatch.setattr(cv2, "VideoCapture", requests)
    CameraSpec("/dev/video2").open(clock)
    CameraSpec(3, 640, 480, 30.0).open(clock)

    assert requests.made == [
        ("/dev/video2", cv2.CAP_V4L2),
        (3, cv2.CAP_V4L2),
        (cv2.CAP_PROP_FRAME_WIDTH, 640),
        (cv2.CAP_PROP_FRAME_HEIGHT, 480),
        (cv2.CAP_PROP_FPS, 30.0),
    ]


def test_streams_are_opened_for_low_delay_with_time_limits(clock: StepClock, monkeypatch: pytest.MonkeyPatch) -> None:
    requests = Requests(opens=False)
    monkeypatch.setattr(cv2, "VideoCapture", requests)
    monkeypatch.delenv("OPENCV_FFMPEG_CAPTURE_OPTIONS", raising=False)

    with pytest.raises(LinkError, match=r"^rtsp://cam/1: cannot be opened"):
        StreamSpec("rtsp://a:b@cam/1", open_timeout_s=10.0, read_timeout_s=1.0).open(clock)

    assert "OPENCV_FFMPEG_CAPTURE_OPTIONS" not in os.environ  # a film that is opened afterwards has its own
    ((url, backend, parameters),) = requests.made
    assert (url, backend) == ("rtsp://a:b@cam/1", cv2.CAP_FFMPEG)
    assert requests.options == [
        "rtsp_transport;tcp|fflags;nobuffer|flags;low_delay"
        "|format_whitelist;rtsp,sdp,rtp,mpegts,mpjpeg,mjpeg,jpeg_pipe,h264,hevc"
        "|protocol_whitelist;rtsp,rtsps,rtp,udp,tcp,tls,http,https|codec_whitelist;h264,hevc,mjpeg,mpeg4"
    ]
    pairs = dict(zip(parameters[::2], parameters[1::2], strict=True))
    assert pairs == {
        cv2.CAP_PROP_OPEN_TIMEOUT_MSEC: 10_000,
        cv2.CAP_PROP_READ_TIMEOUT_MSEC: 1000,
        cv2.CAP_PROP_N_THREADS: 1,
    }


def test_what_an_operator_sets_of_ffmpeg_wins_and_the_rest_stays_in_force(
    clock: StepClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    requests = Requests(opens=False)
    monkeypatch.setattr(cv2, "VideoCapture", requests)
    monkeypatch.setenv("OPENCV_FFMPEG_CAPTURE_OPTIONS", "rtsp_transport;udp|flags;0")

    with pytest.raises(LinkError, match="cannot be opened"):
        StreamSpec("rtsp://cam/1", open_timeout_s=10.0, read_timeout_s=1.0).open(clock)

    assert requests.options[0].startswith("rtsp_transport;udp|flags;0|fflags;nobuffer|format_whitelist;rtsp,")
    assert os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] == "rtsp_transport;udp|flags;0"
