"""`gateway calibrate` from pictures of a drawn board to the configuration."""

import json
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest

from gateway import config
from gateway.vision.offline.calibration.boards import parse
from tests.e2e.conftest import Cli
from tests.e2e.processes import command
from tests.unit.vision.board_pictures import POSES, Camera, shot

SPEC = "checkerboard:8x6:18mm"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("boards")
    for n, pose in enumerate(POSES[:9]):
        cv2.imwrite(str(folder / f"b{n}.png"), shot(parse(SPEC), pose, seed=n))
    cv2.imwrite(str(folder / "empty.png"), np.full((360, 480, 3), 128, np.uint8))
    (folder / "damaged.png").write_bytes(b"\x89PNG nonsense")
    small = cv2.resize(shot(parse(SPEC), POSES[1]), None, fx=0.9, fy=0.9)
    (folder / "mixed").mkdir()
    cv2.imwrite(str(folder / "mixed" / "small.png"), small)
    return folder


@pytest.mark.long
def test_from_pictures_to_the_configuration(folder: Path) -> None:
    words = ["calibrate", ".", "mixed", "--board", SPEC, "--marker-radius-mm", "150"]
    words += ["--out", "new/lens.toml", "--report", "lens.html", "--picture", "lens.svg"]
    done = command(*words, cwd=folder)
    assert done.code == 0, done.err
    lines = done.err.splitlines()
    assert lines[0].startswith("warning: damaged.png: damaged, cut short")
    assert lines[1] == "warning: left out, not 480 x 360 px: small.png (432 x 324)"
    assert any(line.startswith("warning: only 9 views") for line in lines)
    assert lines[-3:] == ["written: new/lens.toml", "written: lens.svg", "written: lens.html"]
    lens = config.load(folder / "new/lens.toml").bays[0].vision.intrinsics
    assert lens is not None
    true = Camera()
    assert lens.fx == pytest.approx(true.fx, rel=0.003)
    assert lens.fy == pytest.approx(true.fy, rel=0.003)
    assert [lens.cx, lens.cy] == pytest.approx([true.cx, true.cy], abs=2)
    assert "reprojection error: rms 0.0" in done.out
    assert "empty.png" in done.out
    assert "no board" in done.out
    printed = done.out[done.out.index("# checkerboard") : done.out.index("A marker of")]
    assert tomllib.loads(printed) == tomllib.loads((folder / "new/lens.toml").read_text())
    said = f"R = 180 px means Z_vision = {(lens.fx + lens.fy) / 2 * 150 / 180 / 10:.1f} cm"
    assert said in done.out
    assert "<svg" in (folder / "lens.svg").read_text()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["b0.png", "--board", "9x6"], "--board 9x6: expected KIND:COLUMNSxROWS:SIZE"),
        (["none", "--board", SPEC], "gateway calibrate: no picture could be read"),
        (
            ["empty.png", "--board", SPEC],
            "gateway calibrate: no checkerboard of 8 x 6 inner corners, 18 mm in any of 1 pictures",
        ),
        (
            ["b1.png", "--board", "checkerboard:9x7:18mm"],
            "a checkerboard of 8 x 6 inner corners was found: is that the board?",
        ),
        (["b1.png", "--board", SPEC], "gateway calibrate: 1 picture shows the whole board; at least 3 are needed"),
        (["b0.png", "empty.png", "--board", SPEC], "without the board: empty.png"),
        (
            ["b1.png", "mixed", "--board", SPEC],
            "gateway calibrate: pictures of different sizes: 480 x 360 px (1), 432 x 324 px (1)",
        ),
        (["b1.png", "--board", SPEC, "--marker-radius-mm", "0"], "--marker-radius-mm 0: must be more than 0"),
    ],
)
def test_what_must_be_changed(folder: Path, arguments: list[str], says: str, cli: Cli) -> None:
    done = cli("calibrate", *arguments, cwd=folder)
    assert (done.code, done.out) == (2, "")
    assert any(line.startswith(says) for line in done.err.splitlines()), done.err


def test_json(folder: Path, cli: Cli) -> None:
    done = cli("calibrate", "b[1-5].png", "--board", SPEC, "--json", "--distortion", "4", cwd=folder)
    assert done.code == 0
    found = json.loads(done.out)
    assert found["intrinsics"]["fx"] == pytest.approx(Camera().fx, rel=0.01)
    assert [view["file"] for view in found["views"]] == [f"b{n}.png" for n in range(1, 6)]
    assert list(found["sigma"]) == ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"]
