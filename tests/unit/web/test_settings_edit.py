"""Changes by path: the file then says exactly that, and every line that is not concerned is what it was."""

import difflib
import tomllib
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.web.profile.settings_edit import ChangeError, SettingChange, by_name, edited, path_of
from tests.examples import examples

PLANT = """\
# The plant's file.
site = "a" # c

[modbus]
host = "1"  # x
# about the port
port = 502

# the broker
[mqtt]
url = "x"
tls.ca_file = "y" # dotted

[mqtt.sparkplug]
group_id = "g"

[vision]
coast_s = 1.0

# bay a
[[bays]]
name = "a"
camera.url = "0"
camera.fps = 3
[bays.vision]
coast_s = 2

# bay b
[[bays]]
name = "b"
vision = {coast_s = 1, method = "paper"} # inline
unit_id = 2

[[recipes]]
id = 7
"""


def changed(*changes: tuple[str, Any], text: str = PLANT) -> str:
    return edited(text, [SettingChange(tuple(path.split(".")), value) for path, value in changes], source="p.toml")


def difference(old: str, new: str) -> list[str]:
    return [line for line in difflib.ndiff(old.splitlines(), new.splitlines()) if line[0] in "+-"]


@pytest.mark.parametrize(
    ("path", "value", "lines"),
    [
        ("site", "b", ['- site = "a" # c', '+ site = "b" # c']),
        ("instance", "b", ['+ instance = "b"']),
        ("modbus.port", 802, ["- port = 502", "+ port = 802"]),
        ("modbus.port", None, ["- port = 502"]),
        ("modbus.plain", True, ["+ plain = true"]),
        ("modbus.allow", ["10.0.0.7", "10.0.0.8"], ['+ allow = ["10.0.0.7", "10.0.0.8"]']),
        ("vision.coast_s", 2, ["- coast_s = 1.0", "+ coast_s = 2.0"]),
        ("vision.red_low_1", [0, 43, 46], ["+ red_low_1 = [0, 43, 46]"]),
        ("mqtt.root", 'a "quoted" \\ ü', ['+ root = "a \\"quoted\\" \\\\ ü"']),
        ("mqtt.tls.cert_file", "z", ['+ tls.cert_file = "z"']),
        ("mqtt.tls.ca_file", None, ['- tls.ca_file = "y" # dotted']),
        ("mqtt.reconnect.min_s", 0.5, ["+ reconnect.min_s = 0.5"]),
        ("mqtt.sparkplug", None, ["- ", "- [mqtt.sparkplug]", '- group_id = "g"']),
        ("bays.a.unit_id", 5, ["+ unit_id = 5"]),
        ("bays.a.camera", None, ['- camera.url = "0"', "- camera.fps = 3"]),
        ("bays.a.camera.reconnect.min_s", 2.0, ["+ camera.reconnect.min_s = 2.0"]),
        ("bays.a.vision.method", "paper", ['+ method = "paper"']),
        ("bays.b.vision.method", None, [
            '- vision = {coast_s = 1, method = "paper"} # inline', "+ vision = {coast_s = 1 } # inline"]),
        ("bays.b.vision.intrinsics", {"fx": 2.0}, [
            '- vision = {coast_s = 1, method = "paper"} # inline',
            '+ vision = {coast_s = 1, method = "paper", intrinsics = {fx = 2.0}} # inline']),
        ("recipes.7.name", "x", ['+ name = "x"']),
        ("recipes.7", None, ["- [[recipes]]", "- id = 7"]),
        ("sinks.postgresql", {"url": "p", "tls": {"ca_file": "c"}}, [
            "+ ", "+ [sinks.postgresql]", '+ url = "p"', '+ tls.ca_file = "c"']),
        ("hmi.users.anna", {"role": "viewer"}, ["+ ", "+ [[hmi.users]]", '+ name = "anna"', '+ role = "viewer"']),
    ],
)  # fmt: skip
def test_only_the_lines_of_the_change_differ(path: str, value: Any, lines: list[str]) -> None:
    assert difference(PLANT, changed((path, value))) == lines


def test_a_bay_is_added_below_the_others_and_removed_with_its_comment() -> None:
    with_c = changed(("bays.c", {"unit_id": 7, "camera": {"url": "9", "fps": 3}}))
    block = '[[bays]]\nname = "c"\nunit_id = 7\ncamera.url = "9"\ncamera.fps = 3\n\n'
    assert with_c == PLANT.replace("[[recipes]]", f"{block}[[recipes]]")
    assert changed(("bays.c", None), text=with_c) == PLANT
    without_a = changed(("bays.a", None))
    assert "# bay a" not in without_a
    assert difference(PLANT, without_a) == [
        "- # bay a", "- [[bays]]", '- name = "a"', '- camera.url = "0"', "- camera.fps = 3", "- [bays.vision]",
        "- coast_s = 2", "- "]  # fmt: skip


def test_a_renamed_bay_is_addressed_by_its_new_name() -> None:
    text = changed(("bays.a.name", "z"), ("bays.z.unit_id", 5))
    assert [bay["name"] for bay in tomllib.loads(text)["bays"]] == ["z", "b"]
    assert tomllib.loads(text)["bays"][0]["unit_id"] == 5


def test_a_file_without_bays_has_one_until_there_is_another() -> None:
    alone = "[camera]\nurl = '1'  # the only one\n"
    assert changed(("bays.bay1.camera.url", "2"), text=alone) == '[camera]\nurl = "2"  # the only one\n'
    two = tomllib.loads(changed(("bays.bay2", {"unit_id": 2}), text=alone))
    assert two["bays"] == [{"name": "bay1", "unit_id": 1}, {"name": "bay2", "unit_id": 2}]
    with pytest.raises(ChangeError, match="the last one can't be removed"):
        changed(("bays.a", None), text='[[bays]]\nname = "a"\n')
    with pytest.raises(ChangeError, match="there is no bay7; there is: bay1"):
        changed(("bays.bay7.unit_id", 2), text=alone)


def test_a_table_as_a_value_keeps_the_comments_of_what_it_does_not_change() -> None:
    assert difference(PLANT, changed(("modbus", {"host": "1", "plain": False}))) == ["+ plain = false", "- port = 502"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", 'site = "s"\n'),
        ("# intro\n\n[camera]\nurl = '1'\n", "# intro\n\nsite = \"s\"\n\n[camera]\nurl = '1'\n"),
        ("# the camera\n[camera]\nurl = '1'\n", "site = \"s\"\n\n# the camera\n[camera]\nurl = '1'\n"),
        ("\ufeffhmi.port = 1\r\n[camera]\r\n", '\ufeffhmi.port = 1\r\nsite = "s"\r\n[camera]\r\n'),
    ],
)
def test_a_key_above_all_tables_is_not_put_into_one(text: str, expected: str) -> None:
    assert changed(("site", "s"), text=text) == expected


@pytest.mark.parametrize(
    ("path", "value", "why"),
    [
        ("modbus.port.x", 1, "modbus.port: is no table"),
        ("bays.c.unit_id", 1, "bays: there is no c; there is: a, b"),
        ("site", "\ud800", "site: is not text that can be written"),
        ("site", b"x", "site: a value of this kind"),
        ("modbus.allow", [None], "modbus.allow: a value of this kind"),
        ("a.b.c.d.e.f.g.h.i.j.k.l.m", 1, "is not the path of a key"),
        ("modbus..port", 1, "is not the path of a key"),
    ],
)
def test_what_cannot_be_changed_is_refused_with_its_path(path: str, value: Any, why: str) -> None:
    with pytest.raises(ChangeError, match=why) as caught:
        changed((path, value))
    assert ".".join(caught.value.path) == path


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[a.b]\n[c]\n[a.d]\n", "[a.b]\nx = 1\n[c]\n[a.d]\n"),
        ('  a.b.y = """\n\n# no comment"""\n\n# c\n[c]\n', None),
        ("  a.b.y = 1 # y\n", "  a.b.y = 1 # y\n  a.b.x = 1\n"),
        ("[a]\n[a.b.c]\n", "[a]\nb.x = 1\n[a.b.c]\n"),
        ("[[a.b.c]]", "[[a.b.c]]\n\n[a.b]\nx = 1\n"),
    ],
)
def test_any_layout_takes_a_new_key(text: str, expected: str | None) -> None:
    after = changed(("a.b.x", 1), text=text)
    assert after == (text.replace('comment"""\n', 'comment"""\na.b.x = 1\n') if expected is None else expected)


def test_a_key_that_has_another_place_since_leaves_its_former_one() -> None:
    text = (
        '[ranger]\nport = "p"\ntemperature_c = 25.0 # of the hall\n\n[[bays]]\nname = "a"\nranger.temperature_c = 8\n'
    )
    assert changed(("ranger.hcsr04.temperature_c", 5), ("bays.a.ranger.hcsr04", {"temperature_c": 7}), text=text) == (
        '[ranger]\nport = "p"\nhcsr04.temperature_c = 5\n\n[[bays]]\nname = "a"\nranger.hcsr04.temperature_c = 7\n'
    )


def test_lists_of_tables_are_addressed_by_name_and_places_become_paths() -> None:
    document = tomllib.loads(PLANT)
    assert by_name(document)["bays"]["b"]["vision"] == {"coast_s": 1, "method": "paper"}
    assert by_name(document)["recipes"] == {"7": {"id": 7}}
    assert path_of(("bays", 1, "vision", "method"), document) == ("bays", "b", "vision", "method")
    assert path_of(("recipes", 0, "id"), document) == ("recipes", "7", "id")
    assert path_of(("bays", 9, "name"), document) == ("bays", "9", "name")


# --- any edit of any layout

KEYS = {
    "site": st.sampled_from(["a", "b"]),
    "modbus.port": st.integers(0, 9),
    "modbus.tls.port": st.integers(0, 9),
    "mqtt.url": st.sampled_from(["x", "# no comment", 'q"]']),
    "mqtt.tls.ca_file": st.sampled_from(["y", "z"]),
    "mqtt.urls": st.lists(st.sampled_from(["u", "v,w"]), max_size=3),
    "vision.coast_s": st.floats(0, 9),
    "vision.tracking": st.booleans(),
    "camera.reconnect.min_s": st.floats(0, 9),
    "bays.a.unit_id": st.integers(1, 9),
    "bays.a.camera.url": st.sampled_from(["0", "1"]),
    "bays.b.vision.coast_s": st.floats(0, 9),
    "bays.b.camera.reconnect.min_s": st.floats(0, 9),
    "bays.c.unit_id": st.integers(1, 9),
}
TABLES = ("modbus.tls", "mqtt", "mqtt.tls", "vision", "camera", "bays.a", "bays.a.camera", "bays.b", "bays.b.vision")
CHANGE = st.one_of(
    *(st.tuples(st.just(path), st.none() | values) for path, values in KEYS.items()),
    st.tuples(st.sampled_from(TABLES), st.none()),
    st.tuples(st.just("bays.c"), st.just({"unit_id": 3, "camera": {"url": "2"}})),
    st.tuples(st.just("mqtt.tls"), st.just({"ca_file": "new"})),
)
PIECES = (
    "[modbus]\n# ABOVE\nport = 1 # SIDE\n", "[modbus.tls]\nport = 2\n", "[mqtt]\nurl = 'x'\ntls.ca_file = 'y' # SIDE\n",
    "[camera]\nreconnect = {min_s = 0.5}\n",
)  # fmt: skip
VISION = (
    "[vision]  # SIDE\ncoast_s = 0.5\n", "[ vision ]\n\t'coast_s'=0.5 # SIDE\n  # ABOVE\n",
    "[vision.intrinsics]\nfx = 1 # SIDE\n",
    "[vision]\nred_low_1 = [ 0x1, 4_3,\n 46, # SIDE\n]\n# ABOVE [vision]\n",
)  # fmt: skip
DOTTED = 'vision . coast_s = 1e0 # SIDE\n"vision" . tracking=true\n'
BAYS = (
    "# ABOVE\n[[bays]]\nname = 'a'\ncamera.url = '0' # SIDE\n\n# ABOVE\n[[bays]]\nname = 'b'\nunit_id = 2\n"
    "[bays.vision]\ncoast_s = 1.5\n",
    "[[bays]]\nname = 'a'\n[bays.camera]\nurl = '0'\n[bays.camera.reconnect]\nmin_s = 1.5 # SIDE\n[[bays]]\n"
    "name = 'b'\nvision = {coast_s = 1.5}\n",
)


@st.composite
def files(draw: st.DrawFn) -> str:
    vision = draw(st.sampled_from([*VISION, DOTTED, ""]))
    head = draw(st.sampled_from(["", "# ABOVE\n\n", "site = 'a' # SIDE\n", "# ABOVE\nsite = 'a'\n\n"]))
    pieces = [*draw(st.lists(st.sampled_from(PIECES), unique=True)), "" if vision == DOTTED else vision]
    bays = [draw(st.sampled_from(BAYS))]
    gap = draw(st.sampled_from(["", "\n", "\n\n"]))
    text = head + (vision if vision == DOTTED else "") + gap.join(draw(st.permutations([*pieces, *bays])))
    text = text.removesuffix("\n") if draw(st.booleans()) else text
    return text.replace("\n", "\r\n") if draw(st.booleans()) else text


def at(document: Any, path: str) -> Any:
    tree: Any = by_name(document)
    for part in path.split("."):
        tree = tree.get(part) if isinstance(tree, dict) else None
    return tree


@pytest.mark.long
@pytest.mark.one_interpreter
@settings(max_examples=examples(250), deadline=None)
@given(text=files(), change=CHANGE)
def test_an_edit_changes_its_key_and_nothing_else(text: str, change: tuple[str, Any]) -> None:
    path, value = change
    before = tomllib.loads(text)
    if path.startswith("bays.c.") and value is not None:
        with pytest.raises(ChangeError, match="there is no c"):
            changed(change, text=text)
        return
    if path.startswith("bays.c") and value is None:
        return
    after_text = changed(change, text=text)
    after = tomllib.loads(after_text)
    if not isinstance(value, dict):
        assert at(after, path) == value
    else:
        assert value.items() <= at(after, path).items()
    others = [key for key in KEYS if not key.startswith(path) and at(before, key) is not None]
    assert [at(after, key) for key in others] == [at(before, key) for key in others]
    kept = [line for line in text.splitlines() if "#" in line]
    concerned = path.split(".")[-1]
    lost = [line for line in kept if line not in after_text.splitlines()]
    if value is not None and not isinstance(value, dict):
        assert all(concerned in line for line in lost), after_text
        assert after_text.count("#") == text.count("#") + str(value).count("#") - str(at(before, path) or "").count("#")
    if "\r\n" in text:
        assert after_text.count("\n") == after_text.count("\r\n")
    if at(before, path) == value:
        assert after_text == text or isinstance(value, dict | float)
