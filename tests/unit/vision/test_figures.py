"""The figures say what the trace says, for pictures of any size; the documentation's pictures are up to date."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from gateway.config import VisionConfig
from gateway.errors import ConfigError
from gateway.vision.detect.paper import pipeline
from gateway.vision.detect.paper.pipeline import Trace
from gateway.vision.view import drawing, figures
from tests import example_scene

IMAGES = Path(__file__).parents[3] / "docs" / "images"
PAPER = VisionConfig()


def disc(height: int, width: int, u: float, v: float, r: float) -> NDArray[np.uint8]:
    y, x = np.mgrid[0:height, 0:width]
    cover = np.clip(r + 0.5 - np.hypot(x - u, y - v), 0, 1)[..., None]
    colour = (1 - cover) * np.array((95, 95, 92)) + cover * np.array((30, 30, 200))
    return np.asarray(np.rint(colour), np.uint8)


@pytest.fixture(scope="module")
def trace() -> Trace:
    image = disc(600, 800, 500.0, 250.0, 120.0)
    image[300:305, 480:486] = (95, 95, 92)  # a chip: closing fills it
    return pipeline.trace(image, PAPER)


def reddish_to_green(pixel: NDArray[np.uint8]) -> bool:
    blue, green, red = (int(value) for value in pixel)
    return green > 180 and red < 150 and blue < 150


def test_figure_3_panels_are_the_stages_themselves(trace: Trace) -> None:
    panels = figures.figure3(trace)
    assert list(panels) == ["fig3a-hsv", "fig3b-mask", "fig3c-clean", "fig3d-circle", "fig3"]
    assert np.array_equal(trace.hsv, panels["fig3a-hsv"])
    assert np.array_equal(trace.initial, panels["fig3b-mask"])
    assert np.array_equal(trace.cleaned, panels["fig3c-clean"])
    assert not np.array_equal(trace.opened, panels["fig3c-clean"])
    assert panels["fig3d-circle"].shape == (600, 800, 3)


def test_the_circle_is_drawn_where_it_was_found(trace: Trace) -> None:
    panel = figures.figure3(trace)["fig3d-circle"]
    circle = trace.detection.circle
    assert circle is not None
    for angle in np.radians(range(0, 360, 15)):
        x, y = circle.u_px + circle.radius_px * np.cos(angle), circle.v_px + circle.radius_px * np.sin(angle)
        if abs(np.degrees(angle) - 330) > 20:  # the radius line ends there
            assert reddish_to_green(panel[round(y), round(x)]), np.degrees(angle)
    yellow = panel[250, 500].astype(int)  # the centre cross
    assert min(yellow[1:]) > 200
    assert yellow[0] < 120
    half = 60 * np.array([np.cos(np.pi / 6), -np.sin(np.pi / 6)])
    on_line = panel[round(250 + half[1]), round(500 + half[0])].astype(int)
    assert min(on_line[1:]) > 150
    assert np.array_equal(trace.image[250, 440], panel[250, 440]), "the rest of the picture is as it was"
    assert trace.image[5, 5].tolist() == [95, 95, 92], "the picture itself is not drawn on"


def test_the_values_stand_in_the_corner_farthest_from_the_marker(trace: Trace) -> None:
    panel = figures.figure3(trace)["fig3d-circle"]
    corners = {"tl": panel[2, 2], "tr": panel[2, -3], "bl": panel[-3, 2], "br": panel[-3, -3]}
    assert [name for name, pixel in corners.items() if pixel.max() < 60] == ["bl"]
    assert (panel[-60:, :200] > 230).any(), "white letters"


def test_small_pictures_are_enlarged_by_a_whole_factor_and_the_circle_with_them() -> None:
    trace = pipeline.trace(disc(40, 60, 30.0, 18.0, 10.0), PAPER)
    panels = figures.figure3(trace)
    assert panels["fig3b-mask"].shape == (40, 60)
    panel = panels["fig3d-circle"]
    assert panel.shape == (320, 480, 3)
    circle = trace.detection.circle
    assert circle is not None
    x = round((circle.u_px + 0.5) * 8 - 0.5 - circle.radius_px * 8)
    assert reddish_to_green(panel[round((circle.v_px + 0.5) * 8 - 0.5), x])


def test_figure_4_sets_canny_beside_the_contours(trace: Trace) -> None:
    panels = figures.figure4(trace)
    assert list(panels) == ["fig4a-canny", "fig4b-contour", "fig4"]
    grey = cv2.cvtColor(trace.blurred, cv2.COLOR_BGR2GRAY)
    assert np.array_equal(cv2.Canny(grey, 50, 150), panels["fig4a-canny"])
    assert trace.chosen is not None
    points = trace.chosen[::20, 0]
    assert all(panels["fig4b-contour"][y, x].tolist() == [255, 255, 255] for x, y in points)
    assert panels["fig4b-contour"][10, 790].tolist() == [0, 0, 0]


def test_sheets_hold_the_panels_in_order(trace: Trace) -> None:
    sheet = figures.figure3(trace)["fig3"]
    assert sheet.shape == (1126, 1340, 3)
    small = cv2.resize(trace.cleaned, (640, 480), interpolation=cv2.INTER_AREA)
    assert np.array_equal(small, sheet[578:1058, 20:660, 0])  # (c), bottom left
    assert not np.array_equal(sheet[20:500, 20:660], sheet[20:500, 680:1320])
    assert figures.figure4(trace)["fig4"].shape == (568, 1340, 3)


@pytest.mark.parametrize("shape", [(1, 1), (1, 3000), (3000, 1), (7, 5), (1200, 1600)])
def test_any_size_with_and_without_a_marker(shape: tuple[int, int]) -> None:
    for colour in ((0, 0, 255), (128, 128, 128)):
        trace = pipeline.trace(np.full((*shape, 3), colour, np.uint8), PAPER)
        panels = figures.figure3(trace) | figures.figure4(trace)
        assert len(panels) == 8
        for name, picture in panels.items():
            assert picture.dtype == np.uint8
            assert picture.ndim == (2 if name in {"fig3b-mask", "fig3c-clean", "fig4a-canny"} else 3)


def test_save(tmp_path: Path, trace: Trace) -> None:
    panels = figures.figure3(trace)
    written = drawing.save(tmp_path, "ü 日本", panels)
    assert [path.name for path in written] == [f"ü 日本-{name}.png" for name in panels]
    back = cv2.imdecode(np.fromfile(written[2], np.uint8), cv2.IMREAD_UNCHANGED)
    assert back is not None
    assert np.array_equal(trace.cleaned, back)
    drawing.save(tmp_path, "ü 日本", panels)  # over what is there
    with pytest.raises(ConfigError, match=r"cannot be written: No such file"):
        drawing.save(tmp_path / "none", "a", panels)


@pytest.mark.long
@pytest.mark.one_interpreter
def test_the_scene_is_the_same_every_time_and_differs_by_seed() -> None:
    scene = example_scene.scene()
    assert scene.shape == (480, 640, 3)
    assert np.array_equal(scene, example_scene.scene())
    assert not np.array_equal(scene, example_scene.scene(8))
