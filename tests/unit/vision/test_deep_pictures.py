"""Pictures with more than 8 bits: their samples, how they reach the detector, and that all bits count there."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from gateway.config import CameraConfig, VisionConfig
from gateway.core.detection import Circle, Tracking
from gateway.errors import ConfigError, LinkError
from gateway.sim.weather import dust
from gateway.vision.detect import registry
from gateway.vision.detect.robust.detect import detect
from gateway.vision.offline import inputs
from gateway.vision.pixels import DeepImage, Image, bgr, bgr8, grey_levels
from gateway.vision.source import raw
from gateway.vision.source.capture import CameraSource
from gateway.vision.source.checks import FrameChecks
from gateway.vision.source.contract import Frame
from gateway.vision.source.frame_rules import FrameRules
from gateway.vision.source.raw_format import FOURCC, RawFormat, raw_format
from gateway.vision.source.specs import CameraSpec, FileSpec, source_spec
from tests import decoys
from tests.virtual_time import LoopClock

pytestmark = pytest.mark.one_interpreter

PARAMS = VisionConfig()


class Stopped(LoopClock):
    """A clock that does not move."""

    def now_ns(self) -> int:
        return 0


PLACE = Circle(163.3, 118.8, 41.7)


def scene(seed: int = 1, ground: str = "concrete") -> Image:
    sheet = decoys.sheet(320, 240, ground, seed)
    sheet.disc(PLACE.u_px, PLACE.v_px, PLACE.radius_px)
    return sheet.finished(noise=2)


def deep(image: NDArray[Any], light: float = 1.0) -> DeepImage:
    return np.rint(257 * light * image.astype(np.float64)).astype(np.uint16)


# What a picture is.


def test_the_data_type_says_what_is_white() -> None:
    white8, white16 = np.full((2, 2, 3), 255, np.uint8), np.full((2, 2, 3), 65535, np.uint16)
    assert grey_levels(white8) is white8
    assert grey_levels(white16).dtype == np.float32
    assert float(grey_levels(white16).max()) == 255.0
    assert float(grey_levels(np.full((2, 2, 3), 1, np.uint16)).max()) == pytest.approx(1 / 257, rel=1e-6)


def test_all_16_bits_are_kept_of_colours_only() -> None:
    colours = np.arange(24, dtype=np.uint16).reshape(2, 3, 4)
    assert bgr(colours).dtype == np.uint16
    assert bgr(colours).tolist() == colours[:, :, :3].tolist()
    for eight in (colours.astype(np.uint8), colours[:, :, 0], colours[:, :, :1]):
        assert bgr(eight).dtype == np.uint8
        assert bgr(eight).shape == (2, 3, 3)


# In the detector.


@pytest.mark.parametrize("ground", ["concrete", "wood"])
@pytest.mark.parametrize("veil", [0.0, 0.9])
def test_the_same_content_gives_the_same_circle(ground: str, veil: float) -> None:
    image = scene(1, ground)
    if veil:
        image = dust(image, veil, at=(PLACE.u_px, PLACE.v_px), uneven=False)
    of8 = detect(image, PARAMS)
    assert of8.circle is not None
    for picture in (deep(image), image.astype(np.float32)):
        found = detect(picture, PARAMS)
        assert found.circle is not None
        allowed = 0.2 if veil else 0.03
        assert found.circle.u_px == pytest.approx(of8.circle.u_px, abs=allowed)
        assert found.circle.v_px == pytest.approx(of8.circle.v_px, abs=allowed)
        assert found.circle.radius_px == pytest.approx(of8.circle.radius_px, abs=allowed)
        assert found.confidence == pytest.approx(of8.confidence, abs=0.1)
        assert found.veil == pytest.approx(of8.veil, abs=0.03)


def test_a_window_of_a_deep_picture_is_searched_as_one_of_8_bits() -> None:
    image = scene()
    window = (90, 50, 240, 190)
    of8 = detect(image, PARAMS, window=window, expected=PLACE).circle
    of16 = detect(deep(image), PARAMS, window=window, expected=PLACE).circle
    assert of8 is not None
    assert of16 is not None
    assert (of16.u_px, of16.v_px, of16.radius_px) == pytest.approx((of8.u_px, of8.v_px, of8.radius_px), abs=0.03)


def test_a_marker_of_five_grey_levels_is_measured_with_all_bits() -> None:
    """A fortieth of the light: in 8 bits the rim is a staircase, which costs 0.06 px."""
    picture = deep(scene(), light=1 / 40)
    of8, of16 = detect(bgr8(picture), PARAMS).circle, detect(picture, PARAMS).circle
    assert of8 is not None
    assert of16 is not None
    error8, error16 = (math.hypot(c.u_px - PLACE.u_px, c.v_px - PLACE.v_px) for c in (of8, of16))
    assert error8 > 0.03
    assert error16 < 0.02


@pytest.mark.long
def test_deep_frames_are_followed() -> None:
    follow = registry.detector(VisionConfig(tracking=True))
    for number in range(10):
        found = follow(registry.given(PARAMS, deep(scene())), 33_000_000 * number)
        assert found.tracking is Tracking.MEASURED


def test_a_method_without_more_bits_is_given_eight() -> None:
    image = scene()
    paper = VisionConfig(method="paper")
    assert registry.given(paper, deep(image)).tolist() == image.tolist()
    assert registry.given(PARAMS, deep(image)).dtype == np.uint16
    assert registry.given(PARAMS, image) is registry.given(paper, image) is image


# From files.


@pytest.mark.long
def test_a_folder_of_png16_gives_all_bits_and_their_view(tmp_path: Path) -> None:
    picture = deep(scene())
    picture[::2] += 100  # less than half a grey level
    cv2.imwrite(str(tmp_path / "1.png"), picture)
    cv2.imwrite(str(tmp_path / "2.png"), scene())
    source = FileSpec(str(tmp_path), fast=True).open(Stopped())

    of16, of8 = source.read(), source.read()

    assert of16.pixels.dtype == np.uint16
    assert of16.pixels.tolist() == picture.tolist()
    assert of16.image.tolist() == bgr8(picture).tolist()
    assert of8.image is of8.pixels
    assert next(inputs.read(tmp_path / "1.png")).pixels.dtype == np.uint16


def test_frames_that_differ_below_8_bits_are_new() -> None:
    """A sensor of 12 bits has noise of less than a grey level: its 8-bit view repeats itself."""
    checks = FrameChecks("camera", FrameRules(), None, may_repeat=False)
    noise = np.random.default_rng(1)
    image = np.full((120, 160, 3), 100, np.uint8)
    verdicts = []
    for number in range(6):
        bits = (257 * image.astype(np.int64) + noise.integers(-60, 60, image.shape)).astype(np.uint16)
        verdicts.append(checks.passed(Frame(bits, 1000 + number)))
        assert bgr8(bits).tolist() == image.tolist()
    assert verdicts[0] is None
    assert verdicts[-1] is not None
    assert verdicts[-1].changed_ns.min() == 1005


# From cameras: known bytes.

GREY12 = RawFormat("Y12", "")


def test_samples_side_by_side_are_little_endian() -> None:
    buffer = np.array([[0x34, 0x02, 0xFF, 0x0F], [0x00, 0x00, 0x00, 0xF0]], np.uint8)
    assert raw.unpacked(buffer, (2, 2), GREY12).tolist() == [[0x234, 0xFFF], [0, 0xFFF]]  # above white is white
    ten = raw.unpacked(np.array([0x01, 0x02, 0x03, 0x00] * 2, np.uint8), (2, 2), RawFormat("SRGGB10", "RGGB"))
    assert ten.tolist() == [[0x201, 3], [0x201, 3]]
    sixteen = raw.unpacked(np.array([0xCD, 0xAB] * 4, np.uint8), (2, 2), RawFormat("SBGGR16", "BGGR"))
    assert sixteen.tolist() == [[0xABCD] * 2] * 2


def test_ten_bits_packed_are_four_samples_in_five_bytes() -> None:
    """MIPI RAW10: the upper eight bits of four samples, then their lower two, the first sample's lowest."""
    row = [0x12, 0x34, 0x56, 0x78, 0b11_10_01_00]
    found = raw.unpacked(np.array([row, row], np.uint8), (2, 4), RawFormat("SRGGB10P", "RGGB"))
    assert found[0].tolist() == [0x12 << 2, 0x34 << 2 | 1, 0x56 << 2 | 2, 0x78 << 2 | 3]
    assert found[1].tolist() == found[0].tolist()


def test_twelve_bits_packed_are_two_samples_in_three_bytes() -> None:
    row = [0xAB, 0xCD, 0x21, 0xFF, 0x00, 0x0F]
    found = raw.unpacked(np.array([row, row], np.uint8), (2, 4), RawFormat("SGBRG12P", "GBRG"))
    assert found[0].tolist() == [0xAB1, 0xCD2, 0xFFF, 0x000]


def test_rows_may_be_longer_than_their_samples() -> None:
    row = [0x01, 0x00, 0x02, 0x00, 0xEE, 0xEE, 0xEE, 0xEE]
    assert raw.unpacked(np.array([row] * 3, np.uint8), (3, 2), GREY12).tolist() == [[1, 2]] * 3
    packed = [0xAB, 0xCD, 0x21, 0xFF, 0x00, 0x0F, 0xEE, 0xEE]  # three of the four samples
    found = raw.unpacked(np.array([packed] * 2, np.uint8), (2, 3), RawFormat("SGBRG12P", "GBRG"))
    assert found.tolist() == [[0xAB1, 0xCD2, 0xFFF]] * 2


@pytest.mark.parametrize("samples", [np.zeros((4, 4), np.uint16), np.zeros((1, 32), np.uint8), np.zeros(32, np.uint8)])
def test_a_buffer_may_have_any_shape(samples: NDArray[Any]) -> None:
    assert raw.unpacked(samples, (4, 4), GREY12).shape == (4, 4)


@pytest.mark.parametrize(("size", "shape"), [(31, (4, 4)), (0, (4, 4)), (32, (0, 0)), (64, (1, 32))])
def test_a_buffer_that_cannot_be_it_is_refused(size: int, shape: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="are no"):
        raw.unpacked(np.zeros(size, np.uint8), shape, GREY12)


@pytest.mark.parametrize("mosaic", ["RGGB", "GRBG", "GBRG", "BGGR"])
def test_the_mosaic_is_filled_in(mosaic: str) -> None:
    """A covered lens gives 64; red is white, green half of the light, blue a tenth of it before its gain of 2."""
    light = {"R": 1.0, "G": 0.5, "B": 0.1}
    samples = np.zeros((8, 8), "<u2")
    for place, colour in enumerate(mosaic):
        samples[place // 2 :: 2, place % 2 :: 2] = round(64 + light[colour] * (4095 - 64))
    made = raw.picture(samples, (8, 8), RawFormat(f"S{mosaic}12", mosaic, black_level=64, blue_gain=2.0))
    assert made.dtype == np.uint16
    assert made.shape == (8, 8, 3)
    # sRGB: 0.2 of the light is 0.4845 of white, 0.5 is 0.7354.
    assert made[4, 4].tolist() == pytest.approx([0.4845 * 65535, 0.7354 * 65535, 65535], abs=12)


def test_grey_samples_stay_grey() -> None:
    made = raw.picture(np.array([[0, 4095], [4095, 0]], "<u2"), (2, 2), GREY12)
    assert made.tolist() == [[0, 65535], [65535, 0]]
    assert bgr(made).dtype == np.uint8


def test_the_four_characters_are_those_of_the_kernel() -> None:
    assert RawFormat("SRGGB12", "RGGB").fourcc == cv2.VideoWriter.fourcc(*"RG12") == 0x32314752
    assert RawFormat("Y10", "").fourcc == 0x20303159
    assert len(set(FOURCC.values())) == len(FOURCC) == 23


def test_a_camera_of_12_bits_is_asked_for_them_and_gives_them(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[int, float] = {}
    mosaic = np.full((1, 2 * 16 * 12), 0, np.uint8)  # bytes of a format that OpenCV doesn't know
    mosaic[0, 1::2] = 0x08

    class Driver:
        def __init__(self, *_: Any) -> None:
            self.released = 0

        def isOpened(self) -> bool:
            return True

        def set(self, key: int, value: float) -> bool:
            asked[key] = value
            return True

        def get(self, key: int) -> float:
            return {cv2.CAP_PROP_FRAME_WIDTH: 16, cv2.CAP_PROP_FRAME_HEIGHT: 12}.get(key, asked.get(key, 0.0))

        def grab(self) -> bool:
            return True

        def retrieve(self) -> tuple[bool, NDArray[Any]]:
            return True, mosaic

        def release(self) -> None:
            self.released += 1

    monkeypatch.setattr(cv2, "VideoCapture", Driver)
    spec = source_spec(CameraConfig.model_validate({"url": "2", "raw": {"format": "SGRBG12"}}))
    assert spec == CameraSpec(2, raw=RawFormat("SGRBG12", "GRBG"))
    camera = spec.open(Stopped())
    assert isinstance(camera, CameraSource)
    assert asked == {cv2.CAP_PROP_FOURCC: cv2.VideoWriter.fourcc(*"BA12"), cv2.CAP_PROP_CONVERT_RGB: 0}

    frame = camera.read()
    assert frame.pixels[6, 8].tolist() == pytest.approx([48200] * 3, abs=20)  # half of the light
    assert frame.image[6, 8].tolist() == [188] * 3

    mosaic = np.zeros((1, 100), np.uint8)
    with pytest.raises(LinkError, match="camera 2: lost: 100 bytes are no 16 x 12 px of SGRBG12"):
        camera.read()

    monkeypatch.setattr(Driver, "set", lambda self, key, value: False)
    asked.clear()
    with pytest.raises(LinkError, match=r"camera.raw.format: it does not give SGRBG12"):
        spec.open(Stopped())


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"bayer": "RGGB"}, "has no effect without format"),
        ({"format": "SRGGB12", "bayer": "RGGB"}, "already says it"),
        ({"format": "Y10", "black_level": 512}, "at least half of white"),
        ({"format": "YUYV"}, "Input should be"),
    ],
)
def test_samples_that_cannot_be_configured(keys: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        CameraConfig.model_validate({"raw": keys})


def test_only_a_camera_of_this_machine_has_samples() -> None:
    with pytest.raises(ConfigError, match=r"only a camera of this machine"):
        source_spec(CameraConfig.model_validate({"url": "rtsp://cam/1", "raw": {"format": "Y12"}}))


def test_a_colour_camera_may_call_its_samples_grey() -> None:
    config = CameraConfig.model_validate({"raw": {"format": "Y16", "bayer": "BGGR", "red_gain": 1.8}})
    assert raw_format(config) == replace(RawFormat("Y16", "BGGR"), red_gain=1.8)
    assert raw_format(CameraConfig()) is None
