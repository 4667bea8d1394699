"""`gateway detect` as a process of its own: what it prints, writes and returns."""

import json
import os
import struct
import subprocess
import sys
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from gateway.vision.pixels import Image
from tests import discs
from tests.e2e.conftest import Cli
from tests.e2e.processes import Done, command

KEYS = [
    *("file", "found", "u", "v", "r", "area", "circularity", "fill", "ellipse", "confidence", "visible"),
    *("candidates", "rejected", "width", "height", "ms"),
]
STAGES = ["scan", "look", "select", "circle", "normalise", "total"]
PANELS = {
    "paper": ["fig3", "fig3a-hsv", "fig3b-mask", "fig3c-clean", "fig3d-circle", "fig4", "fig4a-canny", "fig4b-contour"],
    "robust": ["candidates", "fit", "redness", "rim"],
}


def rows(done: Done) -> list[dict[str, Any]]:
    return [json.loads(line) for line in done.out.splitlines()]


def disc(u: float = 150.25) -> Image:
    return discs.disc(u, 100.5, 60)


def video(path: Path, count: int) -> None:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (320, 240))
    for n in range(count):
        writer.write(disc(u=100 + 20 * n))
    writer.release()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A batch of good and bad inputs."""
    cv2.imwrite(str(tmp_path / "a1.png"), disc())
    cv2.imwrite(str(tmp_path / "a2.png"), np.full((50, 70, 3), 120, np.uint8))
    (tmp_path / "a3.png").write_bytes(b"")
    (tmp_path / "a4.jpg").write_bytes(b"\xff\xd8\xff\xe0 nonsense")
    cv2.imwrite(str(tmp_path / "a10.png"), disc().astype(np.uint16) * 257)
    video(tmp_path / "a11.avi", 2)
    return tmp_path


def test_one_json_object_a_line_and_the_batch_goes_on(folder: Path) -> None:
    done = command("detect", "--json", "--method", "paper", ".", "gone.png", cwd=folder)
    found = rows(done)

    assert done.code == 1
    assert done.err.strip() == "pictures: 5, marker found: 4, inputs failed: 3"
    files = ["a1.png", "a2.png", "a3.png", "a4.jpg", "a10.png", "a11.avi", "a11.avi", "gone.png"]
    assert [row["file"] for row in found] == files
    assert [row["found"] for row in found] == [True, False, False, False, True, True, True, False]
    assert {row["file"]: row["error"] for row in found if "error" in row} == {
        "a3.png": "the file is empty",
        "a4.jpg": "damaged, cut short, or not a picture in a known format",
        "gone.png": "no such file",
    }
    assert list(found[0]) == KEYS
    assert found[0]["u"] == pytest.approx(150.25, abs=0.1)
    assert found[0]["v"] == pytest.approx(100.5, abs=0.1)
    assert found[0]["r"] == pytest.approx(61.27, abs=0.15)
    assert (found[0]["width"], found[0]["height"], found[0]["candidates"]) == (320, 240, 1)
    assert list(found[0]["ms"]) == STAGES
    assert found[0]["ms"]["total"] == pytest.approx(sum(list(found[0]["ms"].values())[:-1]), abs=0.01)
    assert all(value > 0 for value in found[0]["ms"].values())
    for row in found:
        if not row["found"]:
            assert (row["u"], row["v"], row["r"]) == (None, None, None)
    assert (found[1]["area"], found[1]["circularity"], found[1]["fill"]) == (None, None, None)
    same = {key: value for key, value in found[4].items() if key not in {"file", "ms"}}
    assert same == {key: value for key, value in found[0].items() if key not in {"file", "ms"}}, "16 bit as 8 bit"
    assert [row["frame"] for row in found[5:7]] == [0, 1]
    assert [row["u"] for row in found[5:7]] == pytest.approx([100, 120], abs=0.5)


def test_the_table_for_people(folder: Path) -> None:
    with open(os.fsencode(folder) + b"/b\xff\n\x1b[2J.png", "wb") as file:
        file.write((folder / "a1.png").read_bytes())
    done = command("detect", "--method", "paper", ".", cwd=folder)
    lines = done.out.splitlines()

    assert done.code == 1
    assert " ".join(lines[0].split()) == "file u px v px r px area px2 circ. fill conf. seen ms"
    assert lines[1].split()[0] == "a1.png"
    assert [float(value) for value in lines[1].split()[1:4]] == pytest.approx([150.25, 100.5, 61.27], abs=0.15)
    assert lines[2].split()[:3] == ["a2.png", "no", "marker"]
    assert lines[3] == f"{'a3.png':{lines[3].index('error')}}error: the file is empty"
    assert lines[6].startswith("a11.avi #0 ")
    assert lines[8].startswith("b\\udcff\\n\\x1b[2J.png ")
    assert len(lines) == 9
    assert "\x1b" not in done.out + done.err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["nothing-*.png"], "no picture or video in: nothing-*.png"),
        (["empty"], "no picture or video in: empty"),
        (["a1.png", "--bay", "north"], "--bay needs --config"),
        (["a1.png", "--method", "magic"], "command line: method = \"magic\": Input should be 'robust' or 'paper'"),
        (["a1.png", "--min-fill", "0.5"], "--min-area, --min-circularity and --min-fill are the paper's method's: add"),
        (["a1.png", "--min-fill", "2"], "command line: min_fill = 2.0: Input should be less than or equal to 1"),
        (["a1.png", "--config", "none.toml"], "none.toml: cannot read"),
        (["a1.png", "--config", "bays.toml", "--bay", "west"], "bays.toml: no bay west; there is: east, north"),
        (["a1.png", "--stages", "a1.png"], "a1.png: cannot be made: File exists"),
        (["a1.png", "--draw", "a1.png"], "a1.png: cannot be made: File exists"),
    ],
)
def test_arguments_that_must_be_edited(folder: Path, arguments: list[str], says: str, cli: Cli) -> None:
    (folder / "empty").mkdir()
    (folder / "bays.toml").write_text('[[bays]]\nname = "east"\n[[bays]]\nname = "north"\nunit_id = 2\n')
    done = cli("detect", *arguments, cwd=folder)
    assert done.code == 2
    assert done.err.startswith(says)
    assert done.out == ""


def test_the_settings_of_a_bay_and_of_the_command_line(tmp_path: Path, cli: Cli) -> None:
    image = disc()
    image[180:230, 10:300] = (30, 30, 200)  # larger than the disc, less round
    cv2.imwrite(str(tmp_path / "a.png"), image)
    (tmp_path / "plant.toml").write_text(
        "[vision]\nmin_circularity = 0.7\n[vision.intrinsics]\nfx = 500\nfy = 500\ncx = 150.25\ncy = 0.5\n"
        '[[bays]]\nname = "east"\n[[bays]]\nname = "north"\nunit_id = 2\n[bays.vision]\nmin_area_px2 = 20000\n'
    )

    def one(*arguments: str) -> dict[str, Any]:
        (row,) = rows(cli("detect", "--json", "--method", "paper", "a.png", *arguments, cwd=tmp_path))
        return row

    assert one()["v"] > 180
    assert "x_n" not in one()
    assert one("--min-circularity", "0.7")["v"] == pytest.approx(100.5, abs=0.1)
    assert one("--min-fill", "0.7")["v"] == pytest.approx(100.5, abs=0.1)
    assert one("--min-area", "12000")["candidates"] == 1
    east = one("--config", "plant.toml")
    assert east["v"] == pytest.approx(100.5, abs=0.1)
    assert (east["x_n"], east["y_n"]) == (pytest.approx(0, abs=2e-4), pytest.approx(0.2, abs=2e-4))
    north = one("--config", "plant.toml", "--bay", "north")
    assert (north["found"], north["candidates"], north["x_n"]) == (False, 0, None)
    assert one("--config", "plant.toml", "--min-circularity", "0")["v"] > 180


def test_intrinsics_of_another_picture_size_are_refused(tmp_path: Path, cli: Cli) -> None:
    image = disc()
    height, width = image.shape[:2]
    cv2.imwrite(str(tmp_path / "a.png"), image)
    lens = "[vision.intrinsics]\nfx = 500\nfy = 500\ncx = 150\ncy = 0\n"
    (tmp_path / "right.toml").write_text(f"{lens}width_px = {width}\nheight_px = {height}\n")
    (tmp_path / "wrong.toml").write_text(f"{lens}width_px = {2 * width}\nheight_px = {height}\n")

    (right,) = rows(cli("detect", "--json", "--config", "right.toml", "a.png", cwd=tmp_path))
    assert right["x_n"] is not None
    refused = cli("detect", "--json", "--config", "wrong.toml", "a.png", cwd=tmp_path)
    assert refused.code == 1
    assert rows(refused)[0]["error"] == (f"{width} x {height} px; vision.intrinsics hold for {2 * width} x {height} px")


@pytest.mark.parametrize("method", PANELS)
def test_stages_writes_those_of_the_method_under_names_of_their_own(folder: Path, method: str, cli: Cli) -> None:
    (folder / "other").mkdir()
    cv2.imwrite(str(folder / "other" / "A1.bmp"), disc(u=200))
    inputs = ("other", "a1.png", "a2.png", "a3.png", "a11.avi")
    done = cli("detect", "--json", *inputs, "--method", method, "--stages", "out/deep", cwd=folder)
    stems = ["A1", "a1-2", "a2", "a11-frame000000", "a11-frame000001"]

    assert [row.get("stages") for row in rows(done)] == [f"out/deep/{stem}" for stem in stems[:3]] + [None] + [
        f"out/deep/{stem}" for stem in stems[3:]
    ]
    written = sorted(path.name for path in (folder / "out/deep").iterdir())
    assert written == sorted(f"{stem}-{panel}.png" for stem in stems for panel in PANELS[method])
    if method == "robust":
        return
    mask = cv2.imread(str(folder / "out/deep/A1-fig3c-clean.png"), cv2.IMREAD_UNCHANGED)
    assert mask is not None
    assert mask.shape == (240, 320)
    assert (mask[100, 200], mask[100, 100]) == (255, 0)


def test_the_robust_method_reports_ellipse_confidence_and_rejections(folder: Path, cli: Cli) -> None:
    (row,) = rows(cli("detect", "--json", "--method", "robust", "a1.png", cwd=folder))
    assert list(row) == KEYS
    assert (row["u"], row["v"], row["r"]) == pytest.approx((150.25, 100.5, 60), abs=0.1)
    ellipse = row["ellipse"]
    assert [ellipse[key] for key in ("u", "v", "semi_major")] == pytest.approx([row[key] for key in "uvr"], abs=1e-9)
    assert ellipse["semi_minor"] == pytest.approx(60, abs=0.1)
    assert 0 <= ellipse["angle_deg"] < 180
    assert 0.7 < row["confidence"] <= 1
    assert 0.9 < row["visible"] <= 1
    for rejected in row["rejected"]:
        assert list(rejected) == ["u", "v", "r", "why"]


@pytest.mark.parametrize("method", ["paper", "robust"])
def test_in_a_sequence_a_hidden_marker_is_no_measurement(tmp_path: Path, method: str, cli: Cli) -> None:
    for n in range(12):
        image = np.full((240, 320, 3), 95, np.uint8) if n in (6, 7) else disc(u=100 + 4 * n)
        cv2.imwrite(str(tmp_path / f"{n}.png"), image)
    found = rows(cli("detect", "--json", "--method", method, "--track", "30", ".", cwd=tmp_path))
    assert [row["tracking"] for row in found] == ["measured"] * 6 + ["coasted"] * 2 + ["measured"] * 4
    for n, row in enumerate(found):
        if n in (6, 7):
            assert (row["found"], row["u"], row["v"], row["r"]) == (False, None, None, None)
            assert [row["predicted"][key] for key in "uvr"] == pytest.approx([100 + 4 * n, 100.5, 60.5], abs=1.5)
        else:
            assert row["predicted"] is None
            assert row["u"] == pytest.approx(100 + 4 * n, abs=0.1)
    alone = rows(cli("detect", "--json", "--method", method, ".", cwd=tmp_path))
    for one, other in zip(found, alone, strict=True):
        assert "tracking" not in other
        assert one["found"] == other["found"]
        if one["found"]:
            assert [one[key] for key in "uvr"] == pytest.approx([other[key] for key in "uvr"], abs=0.01)


def test_a_frame_rate_that_is_none(folder: Path, cli: Cli) -> None:
    for pace in ("0", "-3", "fast", "nan"):
        done = cli("detect", "--track", pace, "a1.png", cwd=folder)
        assert done.code == 2
        assert "must be a number of frames a second" in done.err


def test_draw_writes_every_picture_with_what_was_found(folder: Path, cli: Cli) -> None:
    done = cli(
        "detect", "--json", "a1.png", "a2.png", "a3.png", "a11.avi", "--draw", "out", "--method", "robust", cwd=folder
    )
    stems = ["a1", "a2", None, "a11-frame000000", "a11-frame000001"]
    assert [row.get("drawn") for row in rows(done)] == [stem and f"out/{stem}-found.png" for stem in stems]
    drawn = cv2.imread(str(folder / "out" / "a1-found.png"))
    assert drawn is not None
    assert drawn.shape == (480, 640, 3)
    blue, green, red = (int(value) for value in drawn[round(2 * 101 - 0.5), round(2 * (150.75 - 60) - 0.5)])
    assert green > 150 > max(blue, red)  # the rim


def test_names_from_standard_input(folder: Path) -> None:
    done = command("detect", "--json", "a10.png", "-", cwd=folder, stdin=b"a1.png\n\n./a2.png\nno\xff.png")
    assert [row["file"] for row in rows(done)] == ["a10.png", "a1.png", "a2.png", "no\udcff.png"]
    assert done.code == 1


def test_a_reader_that_leaves_early(folder: Path) -> None:
    names = "a1.png\n" * 2000
    command = [sys.executable, "-m", "gateway", "detect", "--json", "-"]
    with subprocess.Popen(
        command, cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdin.write(names.encode())
        process.stdin.close()
        json.loads(process.stdout.readline())
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(timeout=60) == 1


def test_a_full_disk_ends_it(folder: Path) -> None:
    with open("/dev/full", "wb") as full:
        command = [sys.executable, "-m", "gateway", "detect", "--json", "a1.png", "a2.png"]
        done = subprocess.run(command, cwd=folder, stdout=full, stderr=subprocess.PIPE, timeout=60, check=False)
    assert done.returncode == 1
    assert done.stderr == b"gateway: the output cannot be written: No space left on device\n"


@pytest.mark.long
@pytest.mark.parametrize(("method", "r"), [("paper", 2001.5), ("robust", 2000.0)])
def test_a_hundred_megapixels(tmp_path: Path, method: str, r: float) -> None:
    image = np.full((8000, 12500, 3), (95, 95, 92), np.uint8)
    cv2.circle(image, (9000, 3000), 2000, (30, 30, 200), -1)
    cv2.imwrite(str(tmp_path / "large.jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, 95])
    (row,) = rows(command("detect", "--json", "--method", method, "large.jpg", cwd=tmp_path))
    assert (row["width"], row["height"]) == (12500, 8000)
    assert (row["u"], row["v"]) == pytest.approx((9000, 3000), abs=0.5)
    assert row["r"] == pytest.approx(r, abs=1)


def test_a_small_file_that_claims_a_gigapixel_takes_no_memory(tmp_path: Path) -> None:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    for name, side in (("more", 30_000), ("limit", 16_400)):  # 900 and 269 megapixels
        header = chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0))
        data = b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(bytes(10**6))) + chunk(b"IEND", b"")
        (tmp_path / f"{name}.png").write_bytes(data)
    measured = (
        "import pathlib, runpy, sys; sys.argv[:1] = ['gateway']\n"
        "try: runpy.run_module('gateway', run_name='__main__')\n"
        # Not getrusage: its peak holds the peak of the process that started this one.
        "finally: print(pathlib.Path('/proc/self/status').read_text().split('VmHWM:')[1].split()[0], file=sys.stderr)"
    )
    command = [sys.executable, "-c", measured, "detect", "--json", "."]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, timeout=100, check=False)
    errors = [json.loads(row)["error"][:42] for row in done.stdout.splitlines()]
    assert errors == ["too large: more than 268435456 pixels, or "] * 2
    assert int(done.stderr.split()[-1]) < 400_000  # kB


def test_the_decoders_say_nothing_of_their_own(folder: Path) -> None:
    cv2.imwrite(str(folder / "b.tif"), disc().astype(np.float32))
    (folder / "c.mp4").write_bytes(b"nonsense" * 100)
    (folder / "d.webp").write_bytes((folder / "a1.png").read_bytes()[:300])
    done = command("detect", ".", cwd=folder)
    assert done.code == 1
    said = [line for line in done.err.splitlines() if not line.startswith("libpng")]
    assert said == ["pictures: 5, marker found: 4, inputs failed: 5"]
