"""`gateway evaluate` as a process of its own, on a small set drawn here."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.discs import disc
from tests.e2e.conftest import Cli
from tests.e2e.processes import command
from tests.self_contained import fetches_nothing


def label(folder: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    (folder / "labels.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Nine pictures with a disc, the first two of them labelled at another place; two without a disc, one of them with
    a red bar, which the paper's method takes for one."""
    rows: list[Mapping[str, Any]] = []
    for n in range(9):
        u, v, r = 100.0 + 12 * n, 110.0, 60.0 - 3 * n
        cv2.imwrite(str(tmp_path / f"d{n}.png"), disc(u, v, r))
        moved = 90 if n < 2 else 0
        row = {"file": f"d{n}.png", "found": True, "u": u + moved, "v": v, "r": r, "z_cm": 12_000 / r, "frame": n}
        rows.append(row | {"group": "moved" if moved else "true", "series": "run", "source": "drawn"})
    grey = np.full((240, 320, 3), 120, np.uint8)
    cv2.imwrite(str(tmp_path / "grey.png"), grey)
    grey[100:130, 40:280] = (30, 30, 200)
    cv2.imwrite(str(tmp_path / "bar.png"), grey)
    label(tmp_path, [*rows, {"file": "grey.png", "found": False}, {"file": "bar.png", "found": False}])
    return tmp_path


def test_json_report_split_and_gate(folder: Path) -> None:
    done = command(
        *("evaluate", ".", "--method", "paper", "--json", "--split", "--tracking"),
        *("--report", "out/report.html", "--worst", "3"),
        *("--require", "detected=0.77,false=1", "--require", "wrong=1"),
        cwd=folder,
    )
    assert done.code == 1
    assert done.err.splitlines() == [
        "labels.jsonl: keys not used here: source",
        "report: out/report.html",
        "not met: paper: wrong <= 1 count required, measured 2",
    ]
    found = json.loads(done.out)
    assert found["unmet"] == ["paper: wrong <= 1 count required, measured 2"]
    (method,) = found["methods"]
    whole = method["whole"]
    counts = {"pictures": 11, "with_marker": 9, "on_target": 7, "wrong": 2, "missed": 0, "false": 1}
    assert {key: whole[key] for key in counts} == counts
    assert whole["detected_share"] == pytest.approx(7 / 9)
    assert whole["centre_median_px"] < 0.1
    assert whole["radius_bias_pct"] == pytest.approx(100 * 1.27 / 45, abs=0.5)  # the mask swells it by 1.27 px
    assert whole["ms_median"] > 0
    assert sum(half["pictures"] for half in method["halves"].values()) == 11
    wrong = {name: group["wrong"] for name, group in method["groups"].items()}
    assert wrong == {"moved": 2, "true": 0, "(no group)": 0}
    (sequence,) = method["sequences"]
    assert (sequence["series"], sequence["frames"], sequence["acquired_after"]) == ("run", 9, 2)
    assert sequence["after"]["detected_share"] == 1.0
    assert [row["tracking"] for row in method["pictures"]] == ["measured"] * 9 + ["off"] * 2
    (constant,) = method["r_times_z"]
    assert constant["pictures"] == 7
    assert constant["label_largest_pct"] == pytest.approx(0, abs=1e-6)
    assert 0.2 < constant["largest_pct"] < 2
    report = (folder / "out/report.html").read_text("utf-8")
    assert fetches_nothing(report)
    assert report.count('<div class="case">') == 3
    assert 'class="file">bar.png<' in report


def test_the_table_for_people_and_every_method(folder: Path) -> None:
    done = command("evaluate", ".", "--method", "all", "--series", "^[a-z]", cwd=folder)
    assert done.code == 0
    assert "Method paper" in done.out
    assert "Method robust" in done.out
    paper = done.out[done.out.index("Method paper") :]
    (whole,) = [line for line in paper.split("Method robust")[0].splitlines() if "whole set" in line]
    assert whole.split()[:8] == ["whole", "set", "11", "77.8", "77.8", "2", "0", "1"]
    assert "\x1b" not in done.out


def test_one_half_alone(folder: Path, cli: Cli) -> None:
    halves = []
    for half in ("tuning", "reporting"):
        done = cli("evaluate", ".", "--json", "--method", "paper", "--split", half, cwd=folder)
        assert done.code == 0
        halves.append(json.loads(done.out)["methods"][0])
    names = [{row["file"] for row in half["pictures"]} for half in halves]
    assert names[0] | names[1] == {*(f"d{n}.png" for n in range(9)), "grey.png", "bar.png"}
    assert names[0] & names[1] == set()
    assert all(
        {row["half"] for row in half["pictures"]} == {name}
        for half, name in zip(halves, ("tuning", "reporting"), strict=True)
    )


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["none"], "none: no such folder"),
        ([".", "--method", "magic"], "--method magic: there is: robust, paper, all"),
        ([".", "--require", "speed=1"], "--require speed=1: expected NAME=LIMIT with NAME one of detected"),
        ([".", "--series", "("], "--series (: not a regular expression"),
        ([".", "--bay", "north"], "--bay needs --config"),
        ([".", "--fps", "0"], "--fps 0: must be 0.01 to 1000"),
        (["bad"], "bad/labels.jsonl:2: r = -1: Input should be greater than 0"),
        (["lost"], 'lost/labels.jsonl:1: file = "no.png": no such picture'),
        (["broken"], "broken/labels.jsonl:1: file = b.png: the file is empty"),
        (["outside"], "outside/labels.jsonl:1: d.png: u = 900, v = 5, r = 3: lies outside the picture"),
        (["single", "--tracking"], "single/labels.jsonl: --tracking needs labels with a frame number"),
    ],
)
def test_what_must_be_edited(folder: Path, arguments: list[str], says: str, cli: Cli) -> None:
    place = {"found": True, "u": 5, "v": 5, "r": 3}
    for name, rows in {
        "bad": [{"file": "d.png", **place}, {"file": "e.png", **place, "r": -1}],
        "lost": [{"file": "no.png", **place}],
        "broken": [{"file": "b.png", **place}],
        "outside": [{"file": "d.png", **place, "u": 900}],
        "single": [{"file": "d.png", **place}],
    }.items():
        (folder / name).mkdir()
        label(folder / name, rows)
        (folder / name / "d.png").write_bytes((folder / "d0.png").read_bytes())
        (folder / name / "e.png").write_bytes((folder / "d0.png").read_bytes())
        (folder / name / "b.png").write_bytes(b"")
    method = [] if "--method" in arguments else ["--method", "paper"]
    done = cli("evaluate", *arguments, *method, cwd=folder)
    assert (done.code, done.out) == (2, "")
    assert done.err.splitlines()[-1].startswith(says)


def test_processes_find_the_same_in_all_sets_below_a_folder_and_a_second_run_takes_it(folder: Path) -> None:
    for name in ("north", "south"):
        (folder / name).mkdir()
        rows = [
            {"file": f"{n}.png", "found": True, "u": 100.0 + n, "v": 110.0, "r": 50.0, "frame": n} for n in range(18)
        ]
        for n in range(18):
            cv2.imwrite(str(folder / name / f"{n}.png"), disc(100.0 + n, 110.0, 50.0 if name == "north" else 49.0))
        label(folder / name, rows)
    (folder / "labels.jsonl").unlink()
    asked = ("evaluate", str(folder), "--method", "paper", "--json")
    serial, shared, again = (
        json.loads(command(*asked, *more).out)
        for more in (
            ("--tracking",),
            ("--tracking", "--jobs", "2", "--results", str(folder / "kept")),
            ("--tracking", "--jobs", "1", "--results", str(folder / "kept")),
        )
    )
    assert shared == again, "times, too"
    for found in (serial, shared):
        assert {name: of["pictures"] for name, of in found["methods"][0]["groups"].items()} == {
            "north": 18,
            "south": 18,
        }
        for row in found["methods"][0]["pictures"]:
            assert row.pop("ms") > 0
    assert serial["methods"][0]["pictures"] == shared["methods"][0]["pictures"]
    assert [each["frames"] for each in shared["methods"][0]["sequences"]] == [18, 18]
    assert len([path for path in (folder / "kept").rglob("*") if path.is_file()]) == 2
    (folder / "south" / "labels.jsonl").write_text('{"file": "1.png", "found": true, "u": 9000, "v": 1, "r": 5}\n')
    wrong = command(*asked)
    assert wrong.code == 2
    assert wrong.err.startswith(f"{folder}/south/labels.jsonl:1: south/1.png: u = 9000, v = 1, r = 5: lies outside")
