"""A detection method that another distribution brings: found by name everywhere, without a change in the package."""

import asyncio
import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from gateway.clock import SystemClock
from gateway.config import CameraConfig, VisionConfig, load
from gateway.core.detection import Detection, Tracking
from gateway.core.readings import Quality, VisionReading
from gateway.errors import ConfigError
from gateway.registry import Registry
from gateway.vision.detect import registry
from gateway.vision.pixels import Image
from gateway.vision.process.vision_service import VisionService
from gateway.vision.source.specs import source_spec
from gateway.web.profile import parameter_schema
from gateway.web.tuning import stages
from tests import brightest_spot
from tests.e2e.processes import command

ROOT = Path(__file__).parents[2]
PATIENCE_S = 30.0


@pytest.fixture
def name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Installed."""
    folder = tmp_path / "site-packages"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(folder), str(ROOT)]))
    return brightest_spot.install(folder)


def picture() -> Image:
    image = np.full((120, 160, 3), 60, np.uint8)
    image[70, 90] = 255
    return image


def test_configuration_and_registry_know_it(name: str) -> None:
    params = VisionConfig(method=name, tracking=False)

    found = registry.detector(params)(picture())

    assert found.circle is not None
    assert (found.circle.u_px, found.circle.v_px) == (90.0, 70.0)
    assert registry.detector(VisionConfig(method=name))(picture(), 1).tracking is Tracking.MEASURED
    assert registry.once(params)(np.zeros_like(picture())).rejected[0].why == "dark"
    assert registry.rejection_meanings()["dark"] == "no pixel is bright enough"
    used = VisionConfig(method=name, min_confidence=0.2, max_radius_share=0.4, min_fill=0.1)
    assert registry.method(name).without_effect(used) == ("min_fill", "max_radius_share")


def test_the_tuning_page_has_its_panels_and_choice(name: str) -> None:
    shown = stages.panels(picture(), VisionConfig(method=name), Detection(None))

    assert [panel.name for panel in shown] == ["grey"]
    (choices,) = (key.choices for key in parameter_schema.schema() if key.name == "method")
    assert choices == ("robust", "paper", name)


def test_an_unknown_name_is_an_error_of_the_file_that_lists_the_known_ones(tmp_path: Path, name: str) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text('[vision]\nmethod = "brightest"\n[[bays]]\nname = "bay1"\nunit_id = 1\n')

    with pytest.raises(ConfigError) as error:
        load(file)

    said = f"{file}:2: vision.method = \"brightest\": Input should be 'robust', 'paper' or '{name}'"
    assert str(error.value).startswith(said)
    with pytest.raises(
        ConfigError, match=f"no detection method is called 'brightest'; there is: robust, paper, {name}"
    ):
        registry.method("brightest")


def test_a_part_that_cannot_be_imported_or_is_offered_twice_is_an_error(name: str, tmp_path: Path) -> None:
    other = tmp_path / "site-packages" / "other-1.0.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 1.0\n")
    (other / "entry_points.txt").write_text(
        f"[gateway.detection_methods]\n{name} = tests.nowhere:METHOD\nbroken = tests.nowhere:METHOD\n"
    )
    known = Registry("detection method", "gateway.detection_methods", {})

    assert known.names() == ("brightest-spot", "broken")
    shipped = Registry("detection method", "gateway.detection_methods", {"broken": "tests.brightest_spot:METHOD"})
    with pytest.raises(ConfigError, match=r"offered twice: tests\.brightest_spot:METHOD, tests\.nowhere:METHOD"):
        shipped.load("broken")
    with pytest.raises(ConfigError, match=r"offered twice: tests\.brightest_spot:METHOD, tests\.nowhere:METHOD"):
        known.load(name)
    with pytest.raises(ConfigError, match=r"'broken': tests\.nowhere:METHOD cannot be imported: No module"):
        known.load("broken")


def test_a_spawned_vision_process_runs_it(name: str, tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    frames.mkdir()
    for n in range(2):
        cv2.imwrite(str(frames / f"{n}.png"), picture())
    camera = CameraConfig(url=str(frames), loop=True, fps=30.0)
    readings: asyncio.Queue[VisionReading] = asyncio.Queue()

    async def first_good() -> VisionReading:
        service = VisionService(
            "bay1", source_spec(camera), camera, VisionConfig(method=name), SystemClock(), readings.put_nowait
        )
        running = asyncio.get_running_loop().create_task(service.run())
        try:
            async with asyncio.timeout(PATIENCE_S):
                while (reading := await readings.get()).quality is not Quality.GOOD:
                    pass
            return reading
        finally:
            running.cancel()
            await asyncio.wait([running], timeout=PATIENCE_S)

    reading = asyncio.run(first_good())

    assert reading.circle is not None
    assert (reading.circle.u_px, reading.circle.v_px) == (90.0, 70.0)
    assert [stage for stage, _ in reading.stage_ns] == ["brightest"]


def test_the_command_line_runs_it_and_writes_its_panels(name: str, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), picture())

    words = ["detect", "a.png", "--json", "--method", name, "--stages", "out"]
    row = json.loads(command(*words, cwd=tmp_path).out)
    assert (row["u"], row["v"], row["found"]) == (90.0, 70.0, True)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["a-grey.png"]
