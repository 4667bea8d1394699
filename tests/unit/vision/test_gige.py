"""The samples of a GigE Vision camera, and its URL, without a camera."""

import ctypes
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gateway.clock import SystemClock
from gateway.config import CameraConfig
from gateway.errors import ConfigError, LinkError
from gateway.vision.exposure.settings import ExposureRules
from gateway.vision.source import aravis, v4l2_exposure
from gateway.vision.source.aravis import AravisCamera, Buffer, DamagedError
from gateway.vision.source.contract import Needs
from gateway.vision.source.gige import GigeSpec, sample_format
from gateway.vision.source.gige_source import GigeSource, open_gige, picture, unpacked
from gateway.vision.source.raw_format import RawFormat
from gateway.vision.source.specs import source_spec


@pytest.mark.parametrize(
    ("pixel_format", "data", "samples"),
    [
        ("Mono16", "3412 ffff", [0x1234, 0xFFFF]),
        ("Mono12", "3402 ff0f", [0x234, 0xFFF]),
        ("BayerRG12p", "ab1c2d 0100f0", [0xCAB, 0x2D1, 0x001, 0xF00]),
        ("BayerGB12Packed", "ab1c2d 0100f0", [0xABC, 0x2D1, 0x010, 0xF00]),
        ("Mono10p", "ff03000080", [0x3FF, 0x000, 0x000, 0x200]),
        ("Mono10p", "0110000000", [0x001, 0x004, 0x000, 0x000]),
        ("BayerBG10Packed", "ab1301 00100a", [0x2AF, 0x005, 0x000, 0x029]),
    ],
)
def test_samples_are_unpacked_as_the_pixel_format_naming_convention_says(
    pixel_format: str, data: str, samples: list[int]
) -> None:
    kind = sample_format(pixel_format)
    assert kind is not None
    assert unpacked(np.frombuffer(bytes.fromhex(data), np.uint8), len(samples), kind).tolist() == samples


def made(pixel_format: str, data: bytes, width: int = 4, height: int = 4, red_gain: float = 1.0) -> Any:
    return picture(
        Buffer(np.frombuffer(data, np.uint8), width, height, 0), pixel_format, RawFormat("", "", red_gain=red_gain)
    )


def test_a_red_scene_is_red_in_every_format_with_colours() -> None:
    rggb = np.zeros((4, 4), np.uint16)
    rggb[::2, ::2] = 1
    for pixel_format, data, white in (
        ("BayerRG8", (rggb * 255).astype(np.uint8).tobytes(), 255),
        ("BayerRG12", (rggb * 4095).tobytes(), 65535),
        ("BayerRG16", (rggb * 65535).tobytes(), 65535),
        ("BayerBG8", (np.roll(rggb, (1, 1), (0, 1)) * 255).astype(np.uint8).tobytes(), 255),
        ("RGB8", bytes((255, 0, 0)) * 16, 255),
        ("BGR8Packed", bytes((0, 0, 255)) * 16, 255),
        ("YUV422_8", bytes((82, 90, 82, 240)) * 8, 255),
        ("YUV422_8_UYVY", bytes((90, 82, 240, 82)) * 8, 255),
    ):
        middle = made(pixel_format, data)[1:3, 1:3].reshape(-1, 3) / white
        assert middle.mean(axis=0) == pytest.approx((0, 0, 1), abs=0.01), pixel_format


def test_red_and_blue_of_more_than_8_bits_are_amplified_as_the_file_says() -> None:
    grey_card = np.full((4, 4), 2000, "<u2")
    grey_card[::2, ::2] //= 2  # the sensor sees half as much red
    middle = made("BayerRG12", grey_card.tobytes(), red_gain=2.0)[1:3, 1:3].reshape(-1, 3)
    assert (middle == middle[0, 0]).all()


def test_grey_is_grey_and_what_is_cut_short_or_unknown_is_a_damaged_frame() -> None:
    assert made("Mono8", bytes(range(16))).reshape(-1, 3).tolist() == [[n, n, n] for n in range(16)]
    assert made("Mono12p", b"\xff" * 24).tolist() == [[[255, 255, 255]] * 4] * 4
    for pixel_format, data in (
        ("Mono12p", b"\0" * 23),
        ("RGB8", b"\0" * 47),
        ("BayerRG8", b""),
        ("Coord3D_C16", b"\0" * 99),
    ):
        with pytest.raises(ValueError, match=r"no 4 x 4 px|not understood"):
            made(pixel_format, data)


def test_the_url_and_its_section() -> None:
    config = CameraConfig.model_validate({"url": "GIGE://10.0.0.7/", "gige": {"pixel_format": "BayerRG10Packed"}})
    spec = source_spec(config)
    assert spec == GigeSpec("gige", "10.0.0.7", "BayerRG10Packed")
    assert (spec.label, spec.needs) == ("gige://10.0.0.7", Needs.DEVICE)
    assert config.refuses_unproven_age


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"url": "gige://"}, r"camera.url: gige:// needs the camera's address or serial number"),
        ({"url": "gige://a@b"}, "needs the camera's address"),
        ({"url": "usb3://1", "username": "joe"}, "only a stream"),
        ({"url": "gige://1", "gige": {"pixel_format": "Mono14"}}, "camera.gige.pixel_format: known are Mono, "),
        ({"url": "rtsp://cam/1", "gige": {"offset_x_px": 8}}, "camera.gige: only gige:// and usb3:// take it"),
        ({"url": "0", "gige": {"offset_x_px": 8}}, "camera.gige: only gige:// and usb3:// take it"),
        ({"url": "gige://1", "raw": {"format": "Y10"}}, "camera.raw.format: only a camera of this machine"),
    ],
)
def test_what_could_never_work_is_a_configuration_error(keys: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        source_spec(CameraConfig.model_validate(keys))


MONO8 = 0x01080001


class Library:
    """Stands in for Aravis: a camera with these pictures waiting, each by its status. A function not named gives 0."""

    def __init__(self, *statuses: int, padding: int = 0, pixel_format: int = MONO8, stamp_ns: int = 5) -> None:
        self.waiting = list(enumerate(statuses, 1))
        self.status = dict(self.waiting)
        self.padding, self.buffer_format, self.stamp_ns = padding, pixel_format, stamp_ns
        self.name: bytes | None = b"Mono8"
        self.ids: dict[int, int] = {}  # of pictures that are not counted from 1 on
        self.pixels = ctypes.create_string_buffer(b"abcd", 4)
        self.pushed: list[int] = []
        self.closed: list[int] = []

    def __getattr__(self, name: str) -> Any:
        return {
            "arv_camera_new": lambda *_: 7,
            "arv_camera_is_gv_device": lambda _: 1,
            "arv_camera_get_pixel_format": lambda *_: MONO8,
            "arv_camera_get_pixel_format_as_string": lambda *_: self.name,
            "arv_camera_get_frame_rate": lambda *_: 25.0,
            "arv_camera_create_stream": lambda *_: 8,
            "arv_stream_push_buffer": lambda _, buffer: self.pushed.append(buffer),
            "arv_stream_timeout_pop_buffer": lambda *_: self.pop(),
            "arv_stream_try_pop_buffer": lambda *_: self.pop(),
            "arv_buffer_get_frame_id": lambda buffer: self.ids.get(buffer, buffer),
            "arv_buffer_get_status": lambda buffer: self.status[buffer],
            "arv_buffer_get_timestamp": lambda buffer: buffer + self.stamp_ns,
            "arv_buffer_get_system_timestamp": lambda buffer: buffer + 1000,
            "arv_buffer_get_image_pixel_format": lambda _: self.buffer_format,
            "arv_buffer_get_image_padding": self.padded,
            "arv_buffer_get_image_width": lambda _: 2,
            "arv_buffer_get_image_height": lambda _: 2,
            "arv_buffer_get_data": self.data,
            "g_object_unref": self.closed.append,
        }.get(name, lambda *_: 0)

    def pop(self) -> int | None:
        return self.waiting.pop(0)[0] if self.waiting else None

    def padded(self, _: int, padding: Any, __: None) -> None:
        padding._obj.value = self.padding

    def data(self, _: int, size: Any) -> int:
        size._obj.value = 4
        return ctypes.addressof(self.pixels)


def started(monkeypatch: pytest.MonkeyPatch, library: Library) -> AravisCamera:
    monkeypatch.setattr(aravis, "_library", lambda: library)
    camera = AravisCamera("10.0.0.7")
    camera.start()
    library.pushed.clear()
    return camera


def test_the_newest_whole_picture_counts_and_every_damaged_one_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    library = Library(3, 0, 0, 2)
    buffer = started(monkeypatch, library).newest(1)
    assert buffer is not None
    assert (buffer.stamp_ns, buffer.damaged, buffer.data.tobytes()) == (3 + 5, 2, b"abcd")
    assert sorted(library.pushed) == [1, 2, 3, 4]
    with pytest.raises(DamagedError, match="packets were lost") as error:
        started(monkeypatch, Library(2, 3)).newest(1)
    assert error.value.count == 2
    assert started(monkeypatch, Library()).newest(1) is None


@pytest.mark.parametrize(
    ("ids", "lost"), [((7, 8, 9), 0), ((7, 10, 12), 3), ((65534, 65535, 1), 0), ((7, 3, 4), 0), ((0, 0, 0), 0)]
)
def test_a_picture_of_which_nothing_came_is_counted_by_the_numbers_of_the_others(
    monkeypatch: pytest.MonkeyPatch, ids: tuple[int, ...], lost: int
) -> None:
    library = Library(0, 0, 0)
    library.ids = dict(enumerate(ids, 1))
    buffer = started(monkeypatch, library).newest(1)
    assert buffer is not None
    assert buffer.damaged == lost


def test_every_damaged_picture_is_counted_though_none_of_them_was_whole() -> None:
    whole = Buffer(np.zeros(4, np.uint8), 2, 2, 5, damaged=1)
    lost = [3, 1]

    def newest(timeout_us: int) -> Buffer:
        if lost:
            raise DamagedError("packets were lost", lost.pop())
        return whole

    camera: Any = SimpleNamespace(newest=newest, controlled=True, pixel_format="Mono8", packets=(0, 0), clock_ns=int)
    controls: Any = SimpleNamespace(look=lambda now_ns: None)
    source = GigeSource(camera, GigeSpec("gige", "10.0.0.7"), SystemClock(), controls)
    assert [source.read().damaged for _ in range(2)] == [5, 1]


def test_a_stamp_that_aravis_made_at_the_arrival_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    buffer = started(monkeypatch, Library(0, stamp_ns=1000)).newest(1)
    assert buffer is not None
    assert buffer.stamp_ns == 0


def test_rows_with_padding_and_another_pixel_format_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    for library, words in (
        (Library(0, padding=2), "rows end in 2 bytes of padding"),
        (Library(0, pixel_format=0x01100003), r"is 0x01100003, not Mono8 \(0x01080001\)"),
    ):
        with pytest.raises(LinkError, match=words):
            started(monkeypatch, library).newest(1)
        assert library.pushed == [1]


def test_whatever_fails_while_it_opens_the_camera_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    library = Library()
    monkeypatch.setattr(aravis, "_library", lambda: library)

    def broken(*_: Any) -> None:
        raise KeyError

    library.name = None
    with pytest.raises(LinkError, match=r"gige://10.0.0.7: cannot be opened: it states no pixel format"):
        open_gige(GigeSpec("gige", "10.0.0.7"), SystemClock())
    assert library.closed == [7]
    monkeypatch.setattr(AravisCamera, "start", broken)
    with pytest.raises(KeyError):
        open_gige(GigeSpec("gige", "10.0.0.7"), SystemClock())
    assert library.closed == [7, 7]


@pytest.mark.parametrize(("asked", "found"), [(None, 25.0), (50.0, 50.0)])
def test_an_exposure_is_kept_within_the_frame_period_that_the_camera_states(
    monkeypatch: pytest.MonkeyPatch, asked: float | None, found: float
) -> None:
    library = Library()
    monkeypatch.setattr(aravis, "_library", lambda: library)
    rates: list[float] = []
    monkeypatch.setattr(v4l2_exposure, "taken_over", lambda *arguments: rates.append(arguments[-1]))
    open_gige(GigeSpec("gige", "10.0.0.7", fps=asked), SystemClock()).exposure_controls(ExposureRules(8000))
    assert rates == [found]


def test_a_library_that_lacks_a_function_is_too_old(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ctypes, "CDLL", lambda _: object())
    with pytest.raises(LinkError, match=r"needs a newer libaravis-0.8.so.0: it lacks g_object_unref"):
        aravis._library.__wrapped__()
