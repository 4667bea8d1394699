"""`gateway tune` from labels, from clicks and from nothing, to a configuration that loads."""

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from gateway import config
from tests.discs import painted, rounded
from tests.e2e.conftest import Cli
from tests.e2e.processes import command

WOOD = (90, 105, 140)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Red discs on wood, which Table I takes for red as a whole."""
    rows = []
    for n in range(4):
        u, v, r = 120.0 + 20 * n, 110.0, 40.0 + 3 * n
        clean = cv2.GaussianBlur(painted(u, v, r, (40, 35, 190), WOOD), (0, 0), 0.8)
        noisy = clean + np.random.default_rng(n).normal(0, 2, clean.shape)
        cv2.imwrite(str(tmp_path / f"d{n}.png"), rounded(noisy))
        rows.append({"file": f"d{n}.png", "found": True, "u": u, "v": v, "r": r})
    (tmp_path / "labels.jsonl").write_text("\n".join(map(json.dumps, rows)))
    cv2.imwrite(str(tmp_path / "grey.png"), np.full((240, 320, 3), 128, np.uint8))
    (tmp_path / "broken.png").write_bytes(b"")
    return tmp_path


def test_from_labels_to_the_configuration(folder: Path) -> None:
    words = ["tune", "--labels", "labels.jsonl", "--out", "red.toml", "--report", "tune.html"]
    done = command(*words, cwd=folder)
    assert done.code == 0, done.err
    assert done.err.splitlines() == ["written: red.toml", "written: tune.html"]
    assert "too broad: 100 % of the surroundings" in done.out
    assert "S >= 43 admits wood, rust and warm light" in done.out
    cells = [re.split(r"  +", line.strip()) for line in done.out.splitlines()]
    rows = {row[0]: row[1:5] for row in cells if len(row) > 5}
    wood = [float(cell) for cell in rows["orange, brown (4 to 10)"]]
    assert wood[2] > 90, "H 9, S 91"
    assert [cell.strip() for cell in rows["now"]] == ["0.0 %", "0.0 %", "4", "0"]
    assert [cell.strip() for cell in rows["proposed thresholds and gates"]] == ["100 %", "100 %", "0", "0"]
    vision = config.load(folder / "red.toml").bays[0].vision
    assert vision.red_low_1[1] > 43 or vision.red_high_1[0] < 9
    assert vision.red_low_1[1:] == vision.red_low_2[1:]
    assert (folder / "red.toml").read_text() in done.out
    assert (folder / "tune.html").read_text("utf-8").startswith("<!DOCTYPE html>")


def test_one_click_is_enough(folder: Path, cli: Cli) -> None:
    one = cli("tune", "d1.png", "--at", "140,110,43", cwd=folder)
    assert one.code == 0
    assert "# Proposed from 1 marker;" in one.out
    assert cli("tune", "--at", "d1.png:140,110,43", cwd=folder) == one


def test_a_place_without_a_marker_gives_no_proposal(folder: Path, cli: Cli) -> None:
    for picture, place in (("grey.png", "160,120,40"), ("d1.png", "260,200,30")):
        output = cli("tune", picture, "--at", place, "--out", "none.toml", "--report", "none.html", cwd=folder)
        assert output.code == 1
        assert "[vision]" not in output.out
        assert output.err.splitlines() == [
            "written: none.html",
            f"gateway tune: no thresholds find a marker in {picture}: is it where you marked it?",
        ]
        assert not (folder / "none.toml").exists()
        assert "Nothing is proposed" in (folder / "none.html").read_text("utf-8")
    output = cli("tune", "--at", "d1.png:140,110,43", "--at", "grey.png:160,120,40", cwd=folder)
    assert output.code == 0
    assert "# Proposed from 2 markers" in output.out
    assert output.err == "warning: not found with the proposal: grey.png; is the marker where you marked it?\n"


def test_without_labels_the_origin_of_the_answers_is_reported(folder: Path, cli: Cli) -> None:
    done = cli("tune", "d0.png", "d1.png", "grey.png", cwd=folder)
    assert done.code == 0
    said = " ".join(done.out.split())
    assert "the robust method's own confident answers in 2 of 3 pictures were taken for the truth" in said
    assert "# Proposed from 2 markers" in said


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "gateway tune: no example with a marker; name pictures with --labels or --at"),
        (["grey.png"], "gateway tune: no marker was found with confidence in 1 pictures; give its place with --at"),
        (["d0.png", "--at", "1,2"], "--at 1,2: expected FILE:U,V,R, as bay.png:412.5,300,96"),
        (["d0.png", "--at", "1,2,x"], "--at 1,2,x: expected FILE:U,V,R"),
        (["d0.png", "--at", "1,2,0"], "--at 1,2,0: the radius must be 0.5 px or more"),
        (["d0.png", "--at", "nan,2,9"], "--at nan,2,9: the radius must be 0.5 px or more, and the centre a number"),
        (["d0.png", "d1.png", "--at", "1,2,3"], "--at 1,2,3: with 2 pictures name the one that is meant"),
        (["--at", "d0.png:9,9,9", "--at", "./d0.png:8,8,8"], "--at ./d0.png:8,8,8: d0.png was named before"),
        (["--at", "d0.png:900,9,9"], "d0.png: u = 900, v = 9, r = 9: lies outside the picture"),
        (["--at", "no.png:9,9,9"], "no.png: no such file"),
        (["--at", "broken.png:9,9,9"], "broken.png: the file is empty"),
        (["--labels", "none.jsonl"], "none.jsonl: no such file"),
        (["d0.png", "--bay", "north"], "--bay needs --config"),
    ],
)
def test_what_must_be_changed(folder: Path, arguments: list[str], says: str, cli: Cli) -> None:
    done = cli("tune", *arguments, cwd=folder)
    assert done.code == 2
    assert done.err.startswith(says)
