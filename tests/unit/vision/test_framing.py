"""Crop and rotation: which pixel is where afterwards, what is seen of a marker there, and what does not fit."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gateway.config import BayConfig, CameraConfig, CropConfig, GatewayConfig, VisionConfig
from gateway.config import parse as parsed
from gateway.doctor import settings as advice
from gateway.errors import ConfigError, LinkError
from gateway.processes.codec import record_of, record_packed
from gateway.vision.detect import registry
from gateway.vision.process.vision_service import frame_rules
from gateway.vision.source.checks import FrameChecks
from gateway.vision.source.contract import Frame
from gateway.vision.source.frame_rules import FrameRules
from gateway.vision.source.framing import Framing
from tests.discs import disc

LETTERS = np.array([[1, 2, 3], [4, 5, 6]])  # 3 x 2


def coloured(levels: NDArray[Any], kind: type[np.uint8 | np.uint16] = np.uint8) -> NDArray[Any]:
    return np.repeat(levels[:, :, None], 3, axis=2).astype(kind)


@pytest.mark.parametrize(
    ("rotation_deg", "expected"),
    [
        (0, [[1, 2, 3], [4, 5, 6]]),
        (90, [[4, 1], [5, 2], [6, 3]]),
        (180, [[6, 5, 4], [3, 2, 1]]),
        (270, [[3, 6], [2, 5], [1, 4]]),
    ],
)
def test_a_rotation_is_clockwise_in_8_bits_and_in_more(rotation_deg: int, expected: list[list[int]]) -> None:
    for white, kind in ((1, np.uint8), (1000, np.uint16)):
        used = Framing(None, rotation_deg).used(Frame(coloured(white * LETTERS, kind), 7))
        assert (used.pixels[:, :, 1] // white).tolist() == expected
        assert used.t_capture_ns == 7
    assert Framing(None, rotation_deg).size_px((3, 2)) == (len(expected[0]), len(expected))


def test_the_crop_is_of_the_delivered_picture_and_a_view_of_it() -> None:
    frame = Frame(coloured(np.arange(12).reshape(3, 4)), 7)
    cropped = Framing((1, 1, 3, 2)).used(frame)
    assert cropped.image[:, :, 0].tolist() == [[5, 6, 7], [9, 10, 11]]
    assert np.shares_memory(cropped.image, frame.image)
    turned = Framing((1, 1, 3, 2), 90).used(frame)
    assert turned.image[:, :, 0].tolist() == [[9, 5], [10, 6], [11, 7]]
    assert Framing((1, 1, 3, 2), 90).size_px((4, 3)) == (2, 3)


@pytest.mark.one_interpreter
@pytest.mark.parametrize("method", ["robust", "paper"])
@pytest.mark.parametrize("rotation_deg", [0, 90, 180, 270])
def test_the_marker_is_found_where_the_framing_puts_it(method: str, rotation_deg: int) -> None:
    """In the view as in a copy of it, so nothing reads past its rows."""
    u, v = 400.0 - 150, 200.0 - 60
    expected = {0: (u, v), 90: (299 - v, u), 180: (449 - u, 299 - v), 270: (v, 449 - u)}[rotation_deg]
    delivered = disc(400, 200, 60, size=(480, 640))
    image = Framing((150, 60, 450, 300), rotation_deg).used(Frame(delivered, 0)).image
    vision = VisionConfig(method=method)
    found = registry.detector(vision)(image, 0).circle
    again = registry.detector(vision)(np.ascontiguousarray(image), 0).circle
    assert found is not None
    assert (found.u_px, found.v_px, found.radius_px) == pytest.approx((*expected, 60.0), abs=1.5)
    assert found == again


def rules(camera: dict[str, Any], **vision: Any) -> FrameChecks:
    return FrameChecks("cam", frame_rules(CameraConfig(**camera), VisionConfig(**vision)), None, may_repeat=True)


CROP = {"x_px": 10, "y_px": 0, "width_px": 40, "height_px": 32}
LENS = {"fx": 60.0, "fy": 60.0, "cx": 20.0, "cy": 16.0}


@pytest.mark.parametrize(
    ("camera", "lens", "words"),
    [
        ({"crop": {**CROP, "x_px": 30}}, None,
         r"cam: camera\.crop needs 70 x 32 px: 40 x 32 from \(30, 0\) on; its frames are 64 x 48 px"),
        ({"crop": {**CROP, "y_px": 17}}, None, "needs 50 x 49 px"),
        ({"width_px": 40, "crop": None}, None, "its frames are 64 x 48 px; camera.width_px and height_px require 40"),
        ({"rotation_deg": 90}, (64, 48), "its frames are 64 x 48 px, 48 x 64 px after crop and rotation; .* 64 x 48"),
        ({"crop": CROP}, (64, 48), "40 x 32 px after crop and rotation; vision.intrinsics hold for 64 x 48 px"),
        ({"crop": CROP, "max_megapixels": 0.01, "url": "0"}, None, ""),
        ({"crop": CROP, "rotation_deg": 270}, (32, 40), ""),
        ({"crop": CROP, "width_px": 64, "height_px": 48}, (40, 32), ""),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_a_lost_camera_with_the_sizes(
    camera: dict[str, Any], lens: tuple[int, int] | None, words: str
) -> None:
    intrinsics = None if lens is None else {**LENS, "width_px": lens[0], "height_px": lens[1]}
    checks = rules(camera, intrinsics=intrinsics)
    frame = Frame(np.zeros((48, 64, 3), np.uint8), 0)
    if words:
        with pytest.raises(LinkError, match=words):
            checks.passed(frame)
    else:
        passed = checks.passed(frame)
        assert passed is not None
        assert passed.used.image.shape[:2] == ((40, 32) if "rotation_deg" in camera else (32, 40))


def test_another_picture_of_which_the_crop_is_as_large_is_still_another_size() -> None:
    """At twice the pixels R is twice as large."""
    checks = rules({"crop": CROP})
    assert checks.passed(Frame(np.zeros((48, 64, 3), np.uint8), 0)) is not None
    with pytest.raises(LinkError, match="its frames are 128 x 96 px; they were 64 x 48 px"):
        checks.passed(Frame(np.zeros((96, 128, 3), np.uint8), 1))


@pytest.mark.parametrize(
    ("bay", "words"),
    [
        ({"camera": {"width_px": 640, "crop": {**CROP, "x_px": 601}}}, "ends at 641 px: camera.width_px is 640"),
        ({"camera": {"height_px": 480, "crop": {**CROP, "y_px": 449}}}, "ends at 481 px: camera.height_px is 480"),
        ({"camera": {"rotation_deg": 45}}, "rotation_deg = 45: .*multiple of 90"),
        ({"camera": {"rotation_deg": 360}}, "rotation_deg = 360: .*<= 270"),
        ({"camera": {"crop": {"x_px": 0, "y_px": 0, "width_px": 40}}}, "crop.height_px: is missing"),
        ({"camera": {"width_px": 64, "height_px": 48, "rotation_deg": 90},
          "vision": {"intrinsics": {**LENS, "width_px": 64, "height_px": 48}}},
         "intrinsics.width_px = 64: width_px after camera.crop and rotation_deg is 48: other intrinsics"),
    ],
)  # fmt: skip
def test_what_the_file_alone_shows_not_to_fit_is_an_error_of_the_file(bay: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        parsed(bay)


def test_advice_speaks_of_the_picture_that_is_used(tmp_path: Path) -> None:
    crop = CropConfig(x_px=0, y_px=0, width_px=500, height_px=400)
    camera = CameraConfig(width_px=640, height_px=480, crop=crop, rotation_deg=90)
    assert camera.picture_px == (400, 500)
    config = GatewayConfig.model_validate(
        {
            "state_dir": str(tmp_path),
            "bays": [
                BayConfig.model_validate(
                    {"camera": camera, "guidance": {"aim_u_px": 450.0}, "vision": {"intrinsics": LENS}}
                )
            ],
        }
    )
    lines = "\n".join(advice.warnings(config))
    assert "guidance.aim_u_px = 450: outside a picture of 400 x 500 px" in lines
    assert "vision.intrinsics without width_px and height_px" in lines


def test_the_framing_travels_to_the_vision_process() -> None:
    rules_sent = frame_rules(CameraConfig(rotation_deg=270, crop=CropConfig(**CROP)), VisionConfig())
    assert rules_sent.framing == Framing((10, 0, 40, 32), 270)
    assert record_of(FrameRules, record_packed(rules_sent)) == rules_sent
