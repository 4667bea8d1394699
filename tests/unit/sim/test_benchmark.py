"""The benchmark's frames: exact truth, the same every time, each condition what it says; and the verb."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from gateway.cli.main import main
from gateway.clock import SystemClock
from gateway.sim.benchmark import conditions, plain, scene
from gateway.sim.benchmark.compare import compare
from gateway.sim.benchmark.conditions import CONDITIONS, Condition, frame
from gateway.sim.canvas import Canvas
from gateway.sim.textures import pyramid
from gateway.vision.offline.evaluation.labels import Label
from gateway.vision.pixels import Image

pytestmark = pytest.mark.one_interpreter

BY_NAME = {condition.name: condition for condition in CONDITIONS}
SMALL = (320, 240)


def green(canvas: Canvas, r: float, chance: np.random.Generator) -> None:
    """A colour that nothing else in a bay has."""
    canvas.image[:] = (0, 230, 0)


def green_share(image: Image) -> NDArray[np.float64]:
    """Of each pixel; the light may differ over the picture."""
    colours = image.astype(np.float64)
    more = np.clip(colours[..., 1] - np.maximum(colours[..., 0], colours[..., 2]), 0, None)
    core = cv2.erode((more > 60).astype(np.float64), np.ones((7, 7)))  # what is green all over tells the light near it
    light, weight = (cv2.blur(part, (31, 31)) for part in (more * core, core))
    return np.where(weight > 0, more * weight / np.maximum(light, 1e-9), 0)


def rim(image: Image) -> tuple[float, float, float, float]:
    """Centre and semi-axes of the green ellipse by its moments: a / 2 and b / 2 are the deviations along the axes."""
    share = green_share(image)
    v, u = np.nonzero(share)
    weights = share[v, u]
    axes = 2 * np.sqrt(np.linalg.eigvalsh(np.cov(np.stack([u, v]), aweights=weights, bias=True)))
    return float(np.average(u, weights=weights)), float(np.average(v, weights=weights)), axes[1], axes[0]


@pytest.mark.mostly_long(short=2)
@pytest.mark.parametrize("name", ["tilt", "low-resolution", "clear", "wet-floor"])
def test_truth_is_exact(name: str) -> None:
    """By the moments of the marker's pixels, with nothing of the renderer or the detectors."""
    for number in range(4):
        image, label = frame(5, replace(BY_NAME[name], paint=green, noise=0.0), number)
        if name == "wet-floor":
            assert label.v is not None
            image = image[: round(label.v + 1.1 * (label.r or 0))]
        assert rim(image) == pytest.approx((label.u, label.v, label.a, label.b), abs=0.1)


def test_the_same_seed_gives_the_same_frames() -> None:
    first = [frame(3, BY_NAME[name], 1, SMALL)[0].tobytes() for name in ("crust", "veil-0.8", "rust-lid")]
    scene.bay.cache_clear()
    again = [frame(3, BY_NAME[name], 1, SMALL)[0].tobytes() for name in ("rust-lid", "veil-0.8", "crust")]
    assert first == again[::-1]
    assert frame(4, BY_NAME["crust"], 1, SMALL)[0].tobytes() != first[0]


@pytest.mark.parametrize("condition", CONDITIONS, ids=lambda condition: condition.name)
def test_a_marker_is_where_one_is_claimed_and_nowhere_else(
    condition: Condition, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The marker's own paint is green here: what is left of it in the frame is where the label says."""
    shown = replace(condition, paint=green) if condition.marker else condition
    if not condition.marker:
        monkeypatch.setattr(conditions, "bay", painted_green)
    image, label = frame(9, replace(shown, effect=None, stored=None), 0, SMALL)
    share = green_share(image)
    assert label.found is condition.marker
    if not condition.marker:
        assert share.sum() == 0
        return
    if condition.effect is None:  # these may change the geometry
        assert label.u is not None
        assert label.v is not None
        assert label.r is not None
        y, x = np.nonzero(share > 0.9)
        far = np.hypot(x - label.u, y - label.v) / label.r
        assert far.max() < 1.02
        assert far.max() > 0.9


def painted_green(*where: Any) -> scene.PaintedBay:
    here = scene.bay(*where)
    level = here.surfaces.paint[0]
    paint = pyramid(replace(level, image=np.full_like(level.image, (0, 230, 0))))
    return here._replace(surfaces=replace(here.surfaces, paint=paint))


def seen(name: str, number: int = 1, **other: Any) -> tuple[Image, Image, Label]:
    """With and without what the condition does, and without noise; the size of the frames may differ."""
    condition = replace(BY_NAME[name], noise=0.0, **other)
    without = replace(condition, paint=None, cover=None, effect=None, stored=None)
    image, label = frame(2, condition, number)
    return image, frame(2, without, number)[0], label


def times(name: str) -> NDArray[np.float64]:
    """Mean of each channel against that without the condition."""
    image, clean, _ = seen(name)
    return np.asarray(image.mean(axis=(0, 1)) / clean.mean(axis=(0, 1)))


def detail(image: Image) -> float:
    return float(np.abs(cv2.Laplacian(image, cv2.CV_32F)).mean())


def contrast(name: str) -> float:
    """Of the marker against its surroundings, share of that in clear air."""
    image, clean, label = seen(name)
    inside = cv2.circle(np.zeros(image.shape[:2], np.uint8), (round(label.u or 0), round(label.v or 0)), 12, 1, -1) > 0
    red = [picture[inside].astype(float).mean(axis=0) for picture in (image, clean)]
    return float(np.ptp(red[0]) / np.ptp(red[1]))


def test_each_condition_changes_what_it_says() -> None:
    assert times("dark") == pytest.approx([0.05] * 3, abs=0.005)
    assert times("orange-cast") == pytest.approx((0.45, 0.8, 1.15), abs=0.02)
    assert times("blue-cast")[1:] == pytest.approx((1.1, 0.62), abs=0.02)
    assert (seen("over-exposed")[0] == 255).mean() > 0.3
    for name, share in (("veil-0.5", 0.5), ("veil-0.8", 0.8), ("veil-0.9", 0.9)):
        assert contrast(name) == pytest.approx(1 - share, abs=0.08)  # the airlight has a tint, too
    for name in ("vibration", "defocus", "motion"):
        image, clean, _ = seen(name)
        assert detail(image) < 0.7 * detail(clean)
    image, clean, label = seen("half-frame")
    assert np.ptp(image[240:]) == 0
    assert (label.v or 0) + (label.r or 0) > 240
    assert seen("low-resolution")[0].shape == (180, 320, 3)
    ratios = [(label.b or 0) / (label.a or 1) for label in (seen("tilt", n)[2] for n in range(3))]
    assert all(0.74 < ratio < 0.96 for ratio in ratios)
    beyond = [(label.u or 0, label.v or 0, label.r or 0) for label in (seen("truncated", n)[2] for n in range(4))]
    cut = [max(r - u, r - v, u + r - 639, v + r - 479) / (2 * r) for u, v, r in beyond]
    assert all(0.1 <= share <= 0.4 for share in cut)
    assert all(0.5 <= (seen("crust", n)[2].visible or 0) <= 0.68 for n in range(4))
    assert seen("occluded")[2].visible == 0.7
    image, clean, _ = seen("lens-dirt")
    assert 0.15 < (np.abs(image.astype(int) - clean).max(axis=2) > 20).mean() < 0.4
    image, clean, _ = seen("jpeg-10")
    blocks = image[: 480 // 8 * 8].astype(np.float32)
    assert np.abs(np.diff(blocks, axis=1))[:, 7::8].mean() > 1.5 * np.abs(np.diff(blocks, axis=1))[:, 3::8].mean()


@pytest.mark.parametrize(
    "name", [c.name for c in CONDITIONS if c.paint or c.cover or c.effect or c.stored]
)  # fmt: skip
def test_no_condition_is_without_effect(name: str) -> None:
    image, clean, _ = seen(name, 0)
    if image.shape == clean.shape:
        assert (np.abs(image.astype(int) - clean).max(axis=2) > 8).sum() > 300


FINDER = """
def find(image):
    red = image[..., 2].astype(int) - image[..., 0] > 60
    if not red.any():
        return None
    v, u = red.nonzero()
    return u.mean(), v.mean(), (red.sum() / 3.14159) ** 0.5
"""


def test_a_strangers_function_beside_the_built_in_methods(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "stranger.py").write_text(FINDER)
    monkeypatch.chdir(tmp_path)
    asked = ["benchmark", "--conditions", "clear", "octagon", "--count", "1", "--size", "320x240", "--seed", "2"]
    assert main([*asked, "--method", "paper", "hough-circles", "stranger:find", "--out", "out", "--json"]) == 0
    methods = json.loads(capsys.readouterr().out)["methods"]
    assert [method["method"] for method in methods] == ["paper", "hough-circles", "stranger:find"]
    assert methods[2]["groups"]["clear"]["with_marker"] == 1
    assert methods[2]["whole"]["false"] == 1
    sheet = cv2.imread(str(tmp_path / "out" / "octagon.png"))
    assert sheet is not None
    assert main([*asked, "--method", "paper"]) == 0
    assert "paper: " in capsys.readouterr().out.splitlines()[-1]


BENCH = ["benchmark", "--conditions", "clear", "--count", "1", "--size", "320x240"]


@pytest.mark.parametrize(
    ("source", "complaint"),
    [
        ("raise SystemExit(0)", "SystemExit: 0"),
        ("def find(image): raise SystemExit(0)", "SystemExit: 0 (frame clear-000.png)"),
        ("def find(image): raise OSError('two\\nlines')", "OSError: two lines (frame clear-000.png)"),
        (
            "def find(image): return 1, 2",
            "ValueError: answered (1, 2); expected: (u, v, R) in px, or None (frame clear-000.png)",
        ),
        (
            "def find(image): return '123'",
            "ValueError: answered '123'; expected: (u, v, R) in px, or None (frame clear-000.png)",
        ),
    ],
)
def test_a_function_that_fails_is_named_with_its_frame(
    source: str, complaint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "failing.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "failing", raising=False)
    assert main([*BENCH, "--method", "failing:find"]) == 2
    assert capsys.readouterr().err.splitlines()[-1] == f"--method failing:find: {complaint}"


def test_what_a_function_draws_no_other_method_sees() -> None:
    given: list[int] = []

    def draws(image: Image) -> None:
        given.append(int(image.max()))
        image[:] = 0

    detectors = {name: plain.detector(draws, name) for name in ("first", "second")}
    seen_last: list[Image] = []
    how: dict[str, Any] = {"seed": 1, "count": 1, "size": SMALL, "clock": SystemClock()}
    compare(detectors, [BY_NAME["clear"]], see=lambda _, image, __: seen_last.append(image), **how)
    assert min(given) > 0
    assert seen_last[0].max() > 0


@pytest.mark.parametrize(("option", "picture"), [("--out", "clear.png"), ("--frames", "clear-000.png")])
def test_a_folder_or_a_picture_that_cannot_be_written_is_named(
    option: str, picture: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = [*BENCH, "--method", "hough-circles", option]
    (tmp_path / "file").touch()
    assert main([*asked, str(tmp_path / "file")]) == 2
    assert capsys.readouterr().err.splitlines()[-1] == f"{tmp_path / 'file'}: cannot be made: File exists"
    (tmp_path / picture).mkdir()
    assert main([*asked, str(tmp_path)]) == 2
    assert capsys.readouterr().err.splitlines()[-1] == f"{tmp_path / picture}: cannot be written: Is a directory"


def test_the_frames_can_be_evaluated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = str(tmp_path / "frames")
    assert (
        main(["benchmark", "--conditions", "faded", "empty", "--count", "2", "--size", "320x240", "--frames", folder])
        == 0
    )
    assert "4 frames" in capsys.readouterr().out
    assert main(["evaluate", folder, "--json", "--method", "paper"]) == 0
    (method,) = json.loads(capsys.readouterr().out)["methods"]
    assert (method["whole"]["with_marker"], method["whole"]["without"]) == (2, 2)


def test_labels_that_are_there_are_never_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    labels = tmp_path / "labels.jsonl"
    labels.write_text("by hand\n")
    assert main([*BENCH, "--frames", str(tmp_path)]) == 2
    assert capsys.readouterr().err == f"{labels}: is there already; choose another folder\n"
    assert [path.name for path in tmp_path.iterdir()] == ["labels.jsonl"]
    assert labels.read_text() == "by hand\n"


@pytest.mark.parametrize(
    ("argument", "complaint"),
    [
        (["--conditions", "fog"], "--conditions fog: there is: clear, crust"),
        (["--count", "0"], "--count 0: must be 1 to 10000"),
        (["--method", "magic"], "--method magic: there is: "),
        (["--method", "no_module:find"], "--method no_module:find: ModuleNotFoundError: No module named"),
    ],
)
def test_what_must_be_edited(argument: list[str], complaint: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["benchmark", "--conditions", "clear", *argument]) == 2
    assert complaint in capsys.readouterr().err
