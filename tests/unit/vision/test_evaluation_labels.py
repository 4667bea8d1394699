"""labels.jsonl: what is read, and that every fault is named with its line."""

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.errors import ConfigError
from gateway.vision.offline.evaluation.labels import MOST_FAULTS, Label, load, outside, parse

GOOD: dict[str, Any] = {"file": "a.png", "found": True, "u": 10, "v": 20.5, "r": 5}


def line(**changes: Any) -> str:
    return json.dumps({key: value for key, value in (GOOD | changes).items() if value != "absent"})


def test_a_label_with_everything_and_keys_of_others() -> None:
    text = line(a=6, b=4, group="g", series="s", tol_px=0.5, visible=0.9, z_cm=120, frame=3, source="x", licence=None)
    found = parse("\ufeff".strip("\ufeff") + text + "\n\n" + '{"file": "b.png", "found": false, "u": null}\r\n')
    first, second = found.labels
    assert (first.u, first.v, first.r, first.major_px) == (10, 20.5, 5, 6)
    assert (first.group, first.series, first.frame) == ("g", "s", 3)
    assert (first.tol_px, first.visible, first.z_cm) == (0.5, 0.9, 120)
    assert (second.found, second.u, second.major_px) == (False, None, None)
    assert found.lines == (1, 3)
    assert found.unused_keys == ("source", "licence")
    assert found.where(second) == "labels.jsonl:3"
    assert parse(line()).labels[0].major_px == 5


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "labels.jsonl: holds no label"),
        ("\n \n", "labels.jsonl: holds no label"),
        ("\n{", "labels.jsonl:2: not valid JSON: Expecting property name enclosed in double quotes at column 2"),
        ("[1]", "labels.jsonl:1: should be a JSON object"),
        ("[" * 100_000, "labels.jsonl:1: not valid JSON"),
        (line(file="absent"), "labels.jsonl:1: file: is missing"),
        (line(file=""), 'labels.jsonl:1: file = "": String should have at least 1 character'),
        (line(found="absent"), "labels.jsonl:1: found: is missing"),
        (line(found="yes"), 'labels.jsonl:1: found = "yes": should be true or false, without quotes'),
        (line(found=1), "labels.jsonl:1: found = 1: should be true or false"),
        (line(u="absent", r=None), "labels.jsonl:1: found is true, but u, r is missing"),
        (line(found=False), "labels.jsonl:1: found is false, but u, v, r is given"),
        (line(u="10"), 'labels.jsonl:1: u = "10": should be a number, without quotes'),
        (line(r=0), "labels.jsonl:1: r = 0: Input should be greater than 0 (allowed: > 0, <= 100000)"),
        (line(v=float("nan")), "labels.jsonl:1: v = NaN: Input should be a finite number"),
        (line(visible=1.1), "labels.jsonl:1: visible = 1.1: Input should be less than or equal to 1"),
        (line(frame=1.5), "labels.jsonl:1: frame = 1.5: Input should be a valid integer"),
        (line(a=3, b=4), "labels.jsonl:1: a = 3 is the semi-major axis: it can't be less than b = 4"),
        (line() + "\n\n" + line(file="./a.png"), 'labels.jsonl:3: file = "./a.png": already labelled in line 1'),
    ],
)
def test_every_fault_names_its_line(text: str, says: str) -> None:
    with pytest.raises(ConfigError) as error:
        parse(text)
    assert str(error.value).startswith(says)


def test_all_faults_at_once_but_not_thousands() -> None:
    with pytest.raises(ConfigError) as error:
        parse("\n".join(["{}"] * 100))
    lines = str(error.value).split("\n")
    assert len(lines) == MOST_FAULTS + 1
    assert lines[:3] == [
        "labels.jsonl:1: file: is missing",
        "labels.jsonl:1: found: is missing",
        "labels.jsonl:2: file: is missing",
    ]
    assert lines[-1] == f"... and {200 - MOST_FAULTS} more"


@given(
    st.text()
    | st.recursive(
        st.none() | st.floats() | st.text(), lambda x: st.dictionaries(st.text(max_size=9), x, max_size=3), max_leaves=9
    ).map(json.dumps)
)
def test_any_text_gives_labels_or_one_clear_error(text: str) -> None:
    said = "labels.jsonl"
    try:
        assert parse(text).labels
    except ConfigError as error:
        said = str(error)
    assert said.startswith("labels.jsonl")


def test_a_folder_is_checked_before_anything_runs(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such folder"):
        load(tmp_path / "none")
    with pytest.raises(ConfigError, match=r"labels\.jsonl: no such file; it holds one JSON object a line"):
        load(tmp_path)
    labels = tmp_path / "labels.jsonl"
    with pytest.raises(ConfigError, match="not a folder"):
        load(labels) if labels.write_bytes(b"\xff") else None
    with pytest.raises(ConfigError, match="not UTF-8 text: invalid start byte at byte 0"):
        load(tmp_path)
    labels.write_text("\ufeff" + line() + "\n" + line(file="sub/b.png") + "\n" + line(file="c.png"), "utf-8")
    (tmp_path / "a.png").touch()
    with pytest.raises(ConfigError) as error:
        load(tmp_path)
    assert str(error.value).split("\n") == [
        f'{labels}:2: file = "sub/b.png": no such picture',
        f'{labels}:3: file = "c.png": no such picture',
    ]
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub/b.png").touch()
    (tmp_path / "c.png").touch()
    assert [load(tmp_path).path(label) for label in load(tmp_path).labels][1] == tmp_path / "sub/b.png"


@pytest.mark.parametrize(
    ("u", "v", "inside"),
    [(50, 40, True), (-14, 40, True), (-15.6, 40, False), (50, 94.4, True), (50, 94.6, False), (112, 92, False)],
)
def test_a_disc_must_reach_into_the_picture(u: float, v: float, inside: bool) -> None:
    label = Label(file="a", found=True, u=u, v=v, r=12, a=15)
    said = outside(label, 100, 80)
    assert (said == "") is inside
    if not inside:
        assert said == f"u = {u:g}, v = {v:g}, r = 12: lies outside the picture, which has 100 x 80 px"
    assert outside(Label(file="a", found=False), 1, 1) == ""


def test_the_halves_depend_on_the_name_alone() -> None:
    names = [f"picture{n}.jpg" for n in range(1000)]
    halves = {name: Label(file=name, found=False).tuning_half for name in names}
    assert 450 < sum(halves.values()) < 550
    for name in names[:20]:
        assert Label(file=name, found=True, u=1, v=1, r=1, group="g").tuning_half is halves[name]
