"""The line numbers in an error must be right even in files that are written by accident only."""

import tomllib
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.config.strict.toml_file import line_of
from tests.examples import examples

TEXT = """\
site = "plant1"   # line 1
  indented=1
"quoted key" = 2
'single' = 3

[modbus]
port = 502

[ vision . intrinsics ]   # spaces are allowed
fx = 1.0

[fusion]
cross_check.focal_px = 600
cross_check . "marker_radius_mm" = 90

[[bays]]
name = "a"
camera.url = "0"
[bays.ranger]
port = "x"
reconnect = { min_s = 1, max_s = 2 }

[[bays]]
name = "b"
[[bays.things]]
n = 1
[[bays.things]]
n = 2
[[bays]]
[[bays.things]]
n = 3
"""


@pytest.mark.parametrize(
    ("place", "line"),
    [
        (("site",), 1),
        (("indented",), 2),
        (("quoted key",), 3),
        (("single",), 4),
        (("modbus",), 6),
        (("modbus", "port"), 7),
        (("modbus", "prot"), 6),  # not there: the table it would stand in
        (("vision", "intrinsics"), 9),
        (("vision", "intrinsics", "fx"), 10),
        (("fusion", "cross_check"), 13),
        (("fusion", "cross_check", "focal_px"), 13),
        (("fusion", "cross_check", "marker_radius_mm"), 14),
        (("bays",), 16),
        (("bays", 0), 16),
        (("bays", 0, "name"), 17),
        (("bays", 0, "camera", "url"), 18),
        (("bays", 0, "ranger"), 19),
        (("bays", 0, "ranger", "port"), 20),
        (("bays", 0, "ranger", "reconnect", "max_s"), 21),  # inside an inline table: the key that opens it
        (("bays", 1), 23),
        (("bays", 1, "name"), 24),
        (("bays", 1, "ranger", "port"), 23),
        (("bays", 1, "things"), 25),
        (("bays", 1, "things", 7), 25),
        (("bays", 1, "things", 1, "n"), 28),
        (("bays", 2, "things", 0, "n"), 31),
        (("bays", 3), 16),
        (("nowhere",), None),
        ((), None),
    ],
)
def test_finds_the_line_or_the_deepest_table_above(place: tuple[str | int, ...], line: int | None) -> None:
    tomllib.loads(TEXT)
    assert line_of(TEXT, place) == line


@pytest.mark.parametrize(
    "text",
    [
        'a = """\n[fusion]\nperiod_s = 1\n"""\n[fusion]\nperiod_s = 2',
        "a = '''\n[fusion]\nperiod_s = 1\n'''\n[fusion]\nperiod_s = 2",
        'a = """one line"""\n[x]\ny = 1\n\n[fusion]\nperiod_s = 2',
        'a = """\n\\"""\n[fusion] \\\n """\n[fusion]\nperiod_s = 2',
        "a = '''\n\"\"\"\n\\'''\n\n[fusion]\nperiod_s = 2",
        'a = 1 # """\n[x]\ny = 1\n\n[fusion]\nperiod_s = 2',
        'a = "\\"\\"\\""\nb = "#[{"\n\n\n[fusion]\nperiod_s = 2',
        "a = '[' # ]\n\nb = '\"\"\"'\n\n[fusion]\nperiod_s = 2",
        "a = [\n  [0, 43]\n]\n\n[fusion]\nperiod_s = 2",
        'a = [ # ]\n  "]", """\n[fusion]\n"""]\n[fusion]\nperiod_s = 2',
        "# a comment with a line separator \u2028 and \u0085 in it\nb = 1\nc = 1\n\n[fusion]\nperiod_s = 2",
        "[a.'fusion']\nperiod_s = 1\n[b.\"c.d\"]\nfusion = 1\n[fusion]\nperiod_s = 2",
    ],
)
def test_is_not_taken_in_by_strings_arrays_and_comments(text: str) -> None:
    assert tomllib.loads(text)["fusion"]["period_s"] == 2

    assert line_of(text, ("fusion",)) == 5
    assert line_of(text, ("fusion", "period_s")) == 6


def test_windows_line_ends_do_not_matter() -> None:
    text = TEXT.replace("\n", "\r\n")
    assert line_of(text, ("bays", 1, "name")) == 24


VALUES = st.sampled_from(
    [
        "1",
        "'# it [ is'",
        '"a # \\" ["',
        '"""one"""',
        '"""\n[t0]\nk0 = 1\n"""',
        "[1, [2]]",
        "[\n  1,\n  [2]\n]",
        "{ k0 = [1] }",
    ]
)


@pytest.mark.one_interpreter
@given(
    tables=st.lists(st.tuples(st.booleans(), st.integers(0, 3), st.lists(VALUES, max_size=3)), max_size=6),
    comment=st.sampled_from(["", " # x", ' # """ [', "  "]),
)
@settings(max_examples=examples(100), deadline=None)
def test_every_key_of_any_document_is_found(tables: list[tuple[bool, int, list[str]]], comment: str) -> None:
    """Documents are written together with the truth about their lines, and tomllib agrees about their keys."""
    lines: list[str] = []
    truth: dict[tuple[str | int, ...], int] = {}
    arrays: dict[str, int] = {}
    plain: set[str] = set()
    for is_array, n, values in tables:
        name = f"{'a' if is_array else 't'}{n}"
        if name in plain:
            continue  # TOML forbids to open a table twice
        here: tuple[str | int, ...] = (name,)
        if is_array:
            arrays[name] = arrays.get(name, -1) + 1
            here = (name, arrays[name])
        else:
            plain.add(name)
        lines.append(f"[[{name}]]{comment}" if is_array else f"[{name}]{comment}")
        truth[here] = len(lines)
        for k, value in enumerate(values):
            truth[(*here, f"k{k}")] = len(lines) + 1
            lines += f"k{k} = {value}{comment}".split("\n")
    text = "\n".join(lines)

    document: Any = tomllib.loads(text)
    for place, line in truth.items():
        inside = document
        for part in place:
            inside = inside[part]
        assert line_of(text, place) == line
