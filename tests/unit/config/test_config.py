"""An operator reads these errors on a phone in a plant: each must name file, line, key, value and what is allowed."""

import re
import tomllib
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, Self, get_origin

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError, model_validator
from pydantic.fields import FieldInfo

from gateway.config import (
    SHARED_SECTIONS,
    BayConfig,
    BayRangerConfig,
    FusionConfig,
    GatewayConfig,
    ModbusConfig,
    Reconnect,
    VisionConfig,
    load,
    parse,
    reference,
)
from gateway.config.sections.ranger import Hcsr04Config
from gateway.config.strict import forms
from gateway.config.strict.errors import explain, without_password
from gateway.config.strict.section import Section, bounds_of, inner_model
from gateway.config.strict.toml_file import merge
from gateway.errors import ConfigError
from tests.examples import examples


def errors(text: str, overrides: dict[str, Any] | None = None) -> list[str]:
    """The lines of the ConfigError that this text gives, file name `g.toml`."""
    with pytest.raises(ConfigError) as caught:
        parse(merge(tomllib.loads(text), overrides or {}), source="g.toml", text=text)
    return str(caught.value).split("\n")


def parsed(text: str, **overrides: Any) -> GatewayConfig:
    return parse(merge(tomllib.loads(text), overrides), source="g.toml", text=text)


# Defaults are the paper's.


def test_an_empty_file_is_one_bay_that_decides_as_the_paper() -> None:
    settings_ = parsed("")

    assert (settings_.site, settings_.instance, settings_.modbus.port, settings_.mqtt) == (
        "site1",
        "gateway",
        502,
        None,
    )
    (bay,) = settings_.bays
    assert (bay.name, bay.unit_id) == ("bay1", 1)
    fusion = bay.fusion
    assert (fusion.radius_threshold_px, fusion.distance_threshold_mm, fusion.fail_safe) == (180.0, 300.0, True)
    assert (fusion.radius_hysteresis_px, fusion.distance_hysteresis_mm) == (0.0, 0.0)
    assert (fusion.raise_debounce_s, fusion.clear_debounce_s, fusion.cross_check) == (0.0, 0.0, None)
    vision = bay.vision
    assert (vision.gaussian_kernel_px, vision.morph_kernel_px, vision.morph_iterations) == (5, 3, 2)
    assert (vision.red_low_1, vision.red_high_1) == ((0, 43, 46), (10, 255, 255))
    assert (vision.red_low_2, vision.red_high_2) == ((156, 43, 46), (180, 255, 255))
    assert (vision.min_circularity, vision.min_fill) == (0.0, 0.0)
    assert bay.ranger.baud == 9600


def test_settings_cannot_be_changed_afterwards() -> None:
    with pytest.raises(ValidationError):
        parsed("").bays[0].fusion.fail_safe = False  # type: ignore[misc]  # that is the point


# Sharing.

FOUR = """\
[camera]
fps = 10
reconnect = { min_s = 1, max_s = 2 }
[fusion]
radius_threshold_px = 150
[fusion.cross_check]
focal_px = 600
marker_radius_mm = 90

[[bays]]
name = "north"
[bays.fusion]
distance_threshold_mm = 250
cross_check.tolerance_mm = 10

[[bays]]
name = "south"
unit_id = 2
camera = { url = "1", reconnect.max_s = 9 }
fusion.radius_threshold_px = 160
"""


def test_a_bay_overrides_shared_sections_key_by_key() -> None:
    north, south = parsed(FOUR).bays

    assert (north.camera.url, north.camera.fps) == ("0", 10)
    assert (north.camera.reconnect.min_s, north.camera.reconnect.max_s) == (1, 2)
    assert (north.fusion.radius_threshold_px, north.fusion.distance_threshold_mm) == (150, 250)
    assert north.fusion.cross_check is not None
    assert (north.fusion.cross_check.focal_px, north.fusion.cross_check.tolerance_mm) == (600, 10)
    assert (south.camera.url, south.camera.fps) == ("1", 10)
    assert (south.camera.reconnect.min_s, south.camera.reconnect.max_s) == (1, 9)
    assert (south.fusion.radius_threshold_px, south.fusion.distance_threshold_mm) == (160, 300)
    assert south.fusion.cross_check is not None
    assert south.fusion.cross_check.tolerance_mm == 50


def test_shared_sections_reach_the_one_bay_of_a_file_without_bays() -> None:
    (bay,) = parsed("[ranger]\nbaud = 115200\n").bays

    assert (bay.name, bay.ranger.baud) == ("bay1", 115200)


TREES = st.recursive(
    st.integers(), lambda inner: st.dictionaries(st.sampled_from("abc"), inner, max_size=3), max_leaves=10
)


@given(st.dictionaries(st.sampled_from("abc"), TREES), st.dictionaries(st.sampled_from("abc"), TREES))
@settings(max_examples=examples(60), deadline=None)
def test_merge_takes_every_leaf_of_the_upper_and_loses_none_of_the_lower(
    below: dict[str, Any], over: dict[str, Any]
) -> None:
    before = repr((below, over))
    merged = merge(below, over)

    def holds(upper: Any, found: Any) -> bool:
        if isinstance(upper, dict):
            return isinstance(found, dict) and all(k in found and holds(v, found[k]) for k, v in upper.items())
        return bool(upper == found)

    assert holds(over, merged)
    assert merged.keys() == below.keys() | over.keys()
    assert all(merged[key] == below[key] for key in below.keys() - over.keys())
    assert repr((below, over)) == before


# The shape of an error.


def _bays(section: str, count: int) -> str:
    """So many bays, each with this section."""
    return "".join(f"[[bays]]\nname = 'b{n}'\nunit_id = {n}\n{section}" for n in range(2, 2 + count))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        # Out of range: at the top, in a section, in a nested table, in an inline table, dotted.
        (
            "[modbus]\nport = 70000\n",
            "g.toml:2: modbus.port = 70000: Input should be less than or equal to 65535 (allowed: >= 0, <= 65535)",
        ),
        (
            "\n\n[fusion]\n# why\nperiod_s = 9  # too slow\n",
            "g.toml:5: fusion.period_s = 9: Input should be less than or equal to 1 (allowed: >= 0.005, <= 1)",
        ),
        (
            "[fusion]\nperiod_s = nan",
            "g.toml:2: fusion.period_s = nan: Input should be a finite number (allowed: >= 0.005, <= 1)",
        ),
        (
            "[fusion]\ncross_check = { focal_px = -1, marker_radius_mm = 90 }\n",
            "g.toml:2: fusion.cross_check.focal_px = -1: Input should be greater than 0 (allowed: > 0, <= 100000)",
        ),
        (
            "[camera]\nreconnect.max_s = 601\n",
            "g.toml:2: camera.reconnect.max_s = 601: Input should be less than or equal to 600"
            " (allowed: >= 0.05, <= 600)",
        ),
        (
            "[vision]\nred_low_1 = [200, 0, 0]\n",
            "g.toml:2: vision.red_low_1.0 = 200: Input should be less than or equal to 180",
        ),
        # Of another type: nothing is converted.
        (
            "[fusion]\nfail_safe = 0\n",
            "g.toml:2: fusion.fail_safe = 0: should be true or false, without quotes",
        ),
        (
            '[fusion]\nfail_safe = "false"\n',
            'g.toml:2: fusion.fail_safe = "false": should be true or false, without quotes',
        ),
        (
            "[fusion]\nradius_threshold_px = true\n",
            "g.toml:2: fusion.radius_threshold_px = true: should be a number, without quotes (allowed: > 0, <= 20000)",
        ),
        (
            '[modbus]\nport = "502"\n',
            'g.toml:2: modbus.port = "502": should be a number, without quotes (allowed: >= 0, <= 65535)',
        ),
        ("[camera]\nurl = 0\n", "g.toml:2: camera.url = 0: Input should be a valid string"),
        (
            "[vision]\nred_low_1 = [true, 0, 0]\n",
            "g.toml:2: vision.red_low_1.0 = true: Input should be a valid integer",
        ),
        ("[vision]\nred_low_1 = 5\n", "g.toml:2: vision.red_low_1 = 5: should be an array"),
        ("[vision]\nred_low_1 = [1, 2]\n", "g.toml:2: vision.red_low_1.2 = [1, 2]: is missing"),
        ('camera = "0"\n', 'g.toml:1: camera = "0": should be a table'),
        ('modbus = "0"\n', 'g.toml:1: modbus = "0": should be a table'),
        ("[bays]\nname = 'a'\n", "g.toml:1: bays: should be an array"),
        ("bays = ['a']\n", 'g.toml:1: bays.0 = "a": should be a table'),
        ("bays = []\n", "g.toml:1: bays = []: Tuple should have at least 1 item after validation, not 0"),
        (
            "[[camera]]\nurl = 'rtsp://user:secret@camera'\n",
            "g.toml:1: camera: should be a table",
        ),
        (
            "[modbus]\n[modbus.port]\nx = 1\n",
            "g.toml:2: modbus.port: Input should be a valid integer (allowed: >= 0, <= 65535)",
        ),
        # One of a few words.
        (
            "[modbus]\nword_order = 'BIG'\n",
            "g.toml:2: modbus.word_order = \"BIG\": Input should be 'big' or 'little'",
        ),
        ("log_level = 'loud'", "g.toml:1: log_level = \"loud\": Input should be 'debug', 'info', 'warning' or 'error'"),
        ('site = "a b"', f"g.toml:1: site = \"a b\": should be {forms.WORDS[forms.NAME]}"),
        ('site = "a\\n"', f"g.toml:1: site = \"a\\n\": should be {forms.WORDS[forms.NAME]}"),
        ("[mqtt]\nurl = 'http://x'", f"g.toml:2: mqtt.url = \"http://x\": should be {forms.WORDS[forms.BROKER_URL]}"),
        # Missing.
        ("[mqtt]\nroot = 'a'\n", "g.toml:1: mqtt.url: is missing; or urls, a list of several brokers"),
        ("[mqtt]\nurls = []\n", "g.toml:1: mqtt.url: is missing; or urls, a list of several brokers"),
        (
            "[mqtt]\nurls = ['mqtt://a', 'http://x']",
            "g.toml:2: mqtt.urls.1 = \"http://x\": should be an address that begins with mqtt://, mqtts://, ws:// or wss://",
        ),
        (
            "[mqtt]\nurl = 'mqtt://a'\nurls = ['mqtt://b']",
            'g.toml:3: mqtt.urls = ["mqtt://b"]: url is given, too; keep one of them',
        ),
        (
            "[fusion.cross_check]\nfocal_px = 600\n",
            "g.toml:1: fusion.cross_check.marker_radius_mm: is missing (allowed: > 0, <= 10000)",
        ),
        # Unknown.
        (
            "[modbus]\nprot = 502\n",
            "g.toml:2: modbus.prot = 502: unknown key (misspelt?); known here: " + ", ".join(ModbusConfig.model_fields),
        ),
        (
            "[fuson]\nperiod_s = 0.02\n",
            "g.toml:1: fuson: unknown key (misspelt?); known here: site, instance, log_level, log_format, state_dir, "
            "initial_function_check, modbus, mqtt, opcua, "
            "sinks, hmi, records, recipes, bays, camera, vision, ranger, fusion, guidance, visit, drive",
        ),
        (
            "[ranger]\nreconnect = { min = 1 }\n",
            "g.toml:2: ranger.reconnect.min = 1: unknown key (misspelt?); known here: min_s, max_s",
        ),
        (
            "[ranger.reconnect.deeper]\nx = 1\n",
            "g.toml:1: ranger.reconnect.deeper: unknown key (misspelt?); known here: min_s, max_s",
        ),
        (
            "[[bays]]\nname = 'a'\n\n[[bays]]\nname = 'b'\nunit_id = 2\nfan = 3\n",
            "g.toml:7: bays.1.fan = 3: unknown key (misspelt?); known here: " + ", ".join(BayConfig.model_fields),
        ),
        (
            "bays = [{ name = 'a' }, { name = 'b', unit_id = 2, fan = 3 }]\n",
            "g.toml:1: bays.1.fan = 3: unknown key (misspelt?); known here: name, title, unit_id, camera,"
            " vision, ranger, fusion, guidance, visit, drive",
        ),
        # Rules of our own, over one key and over several.
        (
            "[vision]\ngaussian_kernel_px = 4\n",
            "g.toml:2: vision.gaussian_kernel_px = 4: must be odd (allowed: >= 1, <= 31)",
        ),
        ("[ranger]\nmedian = 2\n", "g.toml:2: ranger.median = 2: must be odd (allowed: >= 1, <= 15)"),
        (
            "[vision.intrinsics]\nfx = 1\nfy = 1\ncx = 1\ncy = 1\ndistortion = [0.1, 0.2, 0.3]\n",
            "g.toml:6: vision.intrinsics.distortion = [0.1, 0.2, 0.3]:"
            " distortion takes 0, 4, 5, 8, 12 or 14 coefficients",
        ),
        (
            "[vision.intrinsics]\nfx = 1\nfy = 1\ncx = 1\ncy = 1\nheight_px = 480\n",
            "g.toml:6: vision.intrinsics.height_px = 480: height_px is set, so width_px must be, too"
            " (allowed: >= 16, <= 16384)",
        ),
        (
            "[camera]\nwidth_px = 640\nheight_px = 360\n[vision.intrinsics]\nfx = 1\nfy = 1\ncx = 1\ncy = 1\n"
            "width_px = 640\nheight_px = 480\n",
            "g.toml:10: vision.intrinsics.height_px = 480: camera.height_px is 360: other intrinsics"
            " (allowed: >= 16, <= 16384)",
        ),
        (
            "[vision]\nred_high_2 = [170, 255, 40]\n",
            "g.toml:1: vision.red_low_2: V = 46 lies above red_high_2's V = 40",
        ),
        (
            "[vision]\nred_low_1 = [11, 0, 0]\n",
            "g.toml:2: vision.red_low_1 = [11, 0, 0]: H = 11 lies above red_high_1's H = 10",
        ),
        (
            "[mqtt]\nurl = 'mqtt://b'\nreconnect.min_s = 6\n",
            "g.toml:3: mqtt.reconnect.max_s: max_s = 5.0 must be at least min_s = 6.0 (allowed: >= 0.05, <= 600)",
        ),
        (
            "[fusion]\nperiod_s = 0.4\n",
            "g.toml:2: fusion.period_s = 0.4: must not be longer than the shorter deadline, 0.3 s"
            " (allowed: >= 0.005, <= 1)",
        ),
        (
            "[[bays]]\n[[bays]]\nunit_id = 2\nname = 'bay1'\n",
            'g.toml:4: bays.1.name = "bay1": an earlier bay has the name bay1, too',
        ),
        (
            "[[bays]]\n[[bays]]\nname = 'b'\n",
            "g.toml:2: bays.1.unit_id: an earlier bay has the unit_id 1, too (allowed: >= 1, <= 247)",
        ),
        (
            "[camera]\naffinity = []\n",
            "g.toml:2: camera.affinity = []: Tuple should have at least 1 item after validation, not 0",
        ),
        (
            "[vision]\naffinity = [0, -1]\n",
            "g.toml:2: vision.affinity.1 = -1: Input should be greater than or equal to 0",
        ),
        # Where it was written: in a shared section (once for all bays), in a bay's own section, in an inline table.
        (
            "[ranger]\nbaud = 1\n" + _bays("[bays.ranger]\nport = 'p'\n", 4),
            "g.toml:2: ranger.baud = 1: Input should be greater than or equal to 300 (allowed: >= 300, <= 2e+06)",
        ),
        (
            "[ranger]\nbaud = 9600\n[[bays]]\n[bays.ranger]\nbaud = 1\n" + _bays("", 1),
            "g.toml:5: bays.0.ranger.baud = 1: Input should be greater than or equal to 300"
            " (allowed: >= 300, <= 2e+06)",
        ),
        (
            "[ranger]\nbaud = 9600\n[[bays]]\nranger = { bauds = 1 }\n",
            "g.toml:4: bays.0.ranger.bauds = 1: unknown key (misspelt?); known here: "
            + ", ".join(BayRangerConfig.model_fields),
        ),
        (
            "# x\nbays = [{ fusion = { period_s = 9 } }]\n",
            "g.toml:2: bays.0.fusion.period_s = 9: Input should be less than or equal to 1 (allowed: >= 0.005, <= 1)",
        ),
        (
            "[fusion]\nperiod_s = 0.02\n[[bays]]\n[bays.fusion.cross_check]\nfocal_px = 600\n",
            "g.toml:4: bays.0.fusion.cross_check.marker_radius_mm: is missing (allowed: > 0, <= 10000)",
        ),
        # The checker finds a tuple of bays too short after it has itself dropped the faulty one.
        *(
            (
                "[[bays]]\nname = '!'\n" + _bays("", good_bays),
                "g.toml:2: bays.0.name = \"!\": should be letters from A to Z, digits, _ and -, at most sixty-four",
            )
            for good_bays in (0, 3)
        ),
        # A value is shown as in the file.
        (
            'site = "S\u00fcd \\u0007"\n',
            "g.toml:1: site = \"S\u00fcd \\u0007\": should be letters from A to Z, digits, _ and -, at most sixty-four",
        ),
    ],
)  # fmt: skip
def test_one_fault_is_one_line(text: str, expected: str) -> None:
    assert errors(text) == [expected]


def test_a_number_too_long_to_be_written_is_a_fault_like_any_other() -> None:
    text = f"[modbus]\nport = 0x{'f' * 5000}\n"
    with pytest.raises(ConfigError, match=r"gateway\.toml:2: modbus\.port = \(a number of thousands of digits\)"):
        parse(tomllib.loads(text), source="gateway.toml", text=text)


def test_several_faults_are_several_lines() -> None:
    assert errors("[modbus]\nport = -1\nhost = ''\n[fusion]\nperiod = 1\n") == [
        "g.toml:3: modbus.host = \"\": String should have at least 1 character",
        "g.toml:2: modbus.port = -1: Input should be greater than or equal to 0 (allowed: >= 0, <= 65535)",
        "g.toml:5: fusion.period = 1: unknown key (misspelt?); known here: "
        + ", ".join(FusionConfig.model_fields),
    ]  # fmt: skip


def test_a_fault_of_the_complete_file_has_no_key() -> None:
    """Other files are checked by the same means, with models of their own."""

    class Pair(Section):
        a: int = 1
        b: int = 1

        @model_validator(mode="after")
        def _same(self) -> Self:
            if self.a != self.b:
                raise ValueError("a and b must agree")
            return self

    text = "a = 2\n"
    with pytest.raises(ValidationError) as caught:
        Pair.model_validate(tomllib.loads(text))

    assert explain(caught.value, source="w.toml", text=text, model=Pair) == ["w.toml: (whole file): a and b must agree"]


def test_a_long_value_is_cut() -> None:
    (line,) = errors(f"site = '{'x' * 5000}'\n")

    assert line.startswith('g.toml:1: site = "xxxx')
    assert "xxx...: should be letters" in line
    assert len(line) < 250


# The command line.


@pytest.mark.parametrize("text", ["", "[modbus]\nhost = 'x'\n", "[modbus]\nport = 502\n"])
def test_a_fault_of_the_command_line_is_not_attributed_to_the_file(text: str) -> None:
    (line,) = errors(text, {"modbus": {"port": 99999}})

    assert line.endswith("modbus.port = 99999: Input should be less than or equal to 65535 (allowed: >= 0, <= 65535)")
    assert line.startswith("command line: " if text else "g.toml: ")


def test_a_fault_of_the_file_is_not_attributed_to_the_command_line() -> None:
    text = "[fusion]\nperiod_s = 9\n"
    over = {"bays": [{"name": "b1", "unit_id": 1}, {"name": "b2", "unit_id": 2}], "modbus": {"port": 0}}

    assert errors(text, over) == [
        "g.toml:2: fusion.period_s = 9: Input should be less than or equal to 1 (allowed: >= 0.005, <= 1)"
    ]


def test_a_fault_of_the_command_line_names_the_key_as_given() -> None:
    (name,) = errors("site = 'a'\n", {"bays": [{"name": "!"}]})
    (period,) = errors("site = 'a'\n", {"fusion": {"period_s": 9}})

    assert name.startswith('command line: bays.0.name = "!": ')
    assert period.startswith("command line: fusion.period_s = 9: ")


def test_overrides_win_over_the_file(tmp_path: Path) -> None:
    path = tmp_path / "g.toml"
    path.write_text("[modbus]\nport = 1\nhost = 'h'\n[mqtt]\nurl = 'mqtt://a'\nroot = 'r'\n[[bays]]\nname = 'x'\n")
    settings_ = load(path, {"modbus": {"port": 2}, "mqtt": {"url": "mqtt://b"}, "bays": [{"name": "y"}]})

    assert (settings_.modbus.port, settings_.modbus.host) == (2, "h")
    assert settings_.mqtt is not None
    assert (settings_.mqtt.url, settings_.mqtt.root) == ("mqtt://b", "r")
    assert [bay.name for bay in settings_.bays] == ["y"]


def test_a_good_override_mends_a_fault_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "g.toml"
    path.write_text("[modbus]\nport = 99999\n")

    assert load(path, {"modbus": {"port": 2}}).modbus.port == 2


# Files.


def test_keys_of_the_hcsr04_may_stand_where_they_stood() -> None:
    old = parse({"ranger": {"temperature_c": 5, "hcsr04": {"temperature_tolerance_c": 9}}})
    assert old.bays[0].ranger.hcsr04 == Hcsr04Config(temperature_c=5, temperature_tolerance_c=9)
    one, other = parse(
        {
            "ranger": {"temperature_c": 5},
            "bays": [{"name": "a"}, {"name": "b", "unit_id": 2, "ranger": {"hcsr04": {"temperature_c": 6}}}],
        }
    ).bays
    assert (one.ranger.hcsr04.temperature_c, other.ranger.hcsr04.temperature_c) == (5, 6)
    with pytest.raises(ConfigError, match=r"ranger\.temperature_c.*ranger\.hcsr04\.temperature_c is given, too"):
        parse({"ranger": {"temperature_c": 5, "hcsr04": {"temperature_c": 6}}})
    with pytest.raises(
        ConfigError, match=r"file:2: ranger\.temperature_c = 99: Input should be less than or equal to 85"
    ):
        parse(tomllib.loads(text := "[ranger]\ntemperature_c = 99"), source="file", text=text)


def test_load_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "bay.toml"
    path.write_text("[modbus]\r\nport = -1\r\n", newline="")

    with pytest.raises(ConfigError, match=re.escape(f"{path}:2: modbus.port = -1: ")):
        load(path)


def test_a_byte_order_mark_is_no_fault(tmp_path: Path) -> None:
    path = tmp_path / "bay.toml"
    path.write_bytes(b"\xef\xbb\xbf[modbus]\nport = 1\n")

    assert load(path).modbus.port == 1


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (b"[modbus\nport = 1\n", ":1: not valid TOML: Expected ']'"),
        (b"a = 1\na = 2\n", ":2: a: not valid TOML: Cannot overwrite a value$"),
        (b"[mqtt]\nurl = [1,\n\n", ":2: url: not valid TOML: Invalid value"),
        (b"[camera]\nurl = \xff\n", ":2: not UTF-8 text: the byte 0xff is of another code, as Latin-1; save the"),
        ("[camera]\n".encode("utf-16"), ":1: not UTF-8 text: UTF-16; save the file as UTF-8"),
        (b"a = " + b"9" * 5000 + b"\n", ": not valid TOML"),
        (b"a = " + b"[" * 100_000 + b"\n", ": not valid TOML"),
    ],
)
def test_what_is_no_toml_is_a_config_error(tmp_path: Path, content: bytes, fault: str) -> None:
    path = tmp_path / "bay.toml"
    path.write_bytes(content)

    with pytest.raises(ConfigError, match=f"{re.escape(str(path))}{fault}"):
        load(path)


def test_a_missing_file_and_a_folder_are_config_errors(tmp_path: Path) -> None:
    for path in (tmp_path / "absent.toml", tmp_path):
        with pytest.raises(ConfigError, match=f"{re.escape(str(path))}: cannot read the configuration"):
            load(path)


# Passwords.

SECRET = "hunter2/@:#"


@pytest.mark.parametrize(
    "text",
    [
        f"[camera]\nuri = 'rtsp://admin:{SECRET}@camera/stream'",
        f"[camera]\nurl = ['rtsp://admin:{SECRET}@camera/stream']",
        f"[camera]\nurl = [['x', 'rtsp://admin:{SECRET}@camera/stream']]",
        f"[[camera]]\nurl = 'rtsp://admin:{SECRET}@camera/stream'",
        f"camera = 'rtsp://admin:{SECRET}@camera/stream'",
        f"bays = 'rtsp://admin:{SECRET}@camera/stream'",
        f"bays = ['rtsp://admin:{SECRET}@camera/stream']",
        f"[[bays]]\ncamera = 'rtsp://admin:{SECRET}@camera/stream'",
        f"[[bays]]\n[bays.camera]\nurl = 'rtsp://admin:{SECRET}@camera/stream'\n[[bays]]\nname = '!'",
        f"[camera]\nurl = 'rtsp://admin:{SECRET}@camera'\nfps = 0\n",
        f"[mqtt]\nurl = 'admin:{SECRET}@broker'",
        f"[mqtt]\nurl = 'mqtt:/admin:{SECRET}@broker'",
        f"[mqtt]\nurl = 'MQTT://admin:{SECRET}@broker'",
        f"[mqtt]\nurl = 'mqtt://admin:{SECRET}@broker'\nroot = '#'",
        f"[mqtt]\nurls = ['mqtt://broker', 'MQTT://admin:{SECRET}@broker']",
        f"[mqtt]\nurl = 'mqtt://broker'\nurls = ['mqtt://admin:{SECRET}@broker']",
        f"[mqtt]\nurl = 'mqtt://broker'\npassword = '{SECRET}'",
        f"[mqtt]\nurl = 'mqtt://broker'\nPASSWD = '{SECRET}'",
        f"mqtt_password = '{SECRET}'",
        f"[camera]\nuri = 'http://camera/video?user=admin&pwd={SECRET.replace('#', '')}&x=1'",
        f"[camera]\nuri = 'http://camera/video?password={SECRET.replace('#', '')}'",
        f"mqtt = 'admin:{SECRET}@broker'",
    ],
)
def test_no_password_appears_in_an_error_nor_behind_it(text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse(tomllib.loads(text), source="g.toml", text=text)

    assert "hunter2" not in str(caught.value)
    assert "hunter2" not in "".join(traceback.format_exception(caught.value))


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("mqtt://broker:1883", "mqtt://broker:1883"),
        ("mqtt://user:pw@broker:1883", "mqtt://***@broker:1883"),
        ("mqtts://user:p@:/w@broker", "mqtts://***@broker"),
        ("mqtt://user@broker", "mqtt://***@broker"),
        ("user:pw@broker", "***@broker"),
        ("http://cam/v?user=me&pwd=x&n=1", "http://cam/v?user=me&pwd=***&n=1"),
        ("http://me:pw@cam/v?access_token=x#f", "http://***@cam/v?access_token=***#f"),
        ("http://cam/v.asf?loginuse=admin&loginpas=x", "http://cam/v.asf?loginuse=admin&loginpas=***"),
        ("http://cam/v.cgi?usr=admin&pw=x#f", "http://cam/v.cgi?usr=admin&pw=***#f"),
        (
            "rtsp://cam/user=admin_password=x_y_channel=1_stream=0.sdp",
            "rtsp://cam/user=admin_password=***_channel=1_stream=0.sdp",
        ),
        ("rtsp://cam/user=admin&password=x&channel=1", "rtsp://cam/user=admin&password=***&channel=1"),
        ("rtsp://cam/password=x/main?n=1&m=2", "rtsp://cam/password=***&m=2"),
        ("rtsp://passcam/user=admin", "rtsp://passcam/user=admin"),
        ("/dev/video0", "/dev/video0"),
        ("truck@noon.mp4", "truck@noon.mp4"),
        ("0", "0"),
    ],
)
def test_a_url_that_may_be_shown(url: str, shown: str) -> None:
    assert without_password(url) == shown


def test_the_values_in_force_show_no_password_of_a_list_of_brokers() -> None:
    text = f"[mqtt]\nurls = ['mqtt://broker', 'mqtt://admin:{SECRET}@broker']"
    shown = dict(reference.flat(parse(tomllib.loads(text))))
    assert shown["mqtt.urls"] == '["mqtt://broker", "mqtt://***@broker"]'


# Every bound of every field, from the table of fields itself.


def _fields(model: type[Section], prefix: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], FieldInfo]]:
    for name, info in model.model_fields.items():
        below = inner_model(info.annotation)
        if below is not None and issubclass(model, below):
            continue
        if below is None:
            yield (*prefix, name), info
        elif issubclass(below, Section) and below is not BayConfig:
            yield from _fields(below, (*prefix, name))


BOUNDED = [(place, info) for place, info in [*_fields(GatewayConfig), *_fields(BayConfig)] if bounds_of(info)]


def test_every_number_has_bounds() -> None:
    """A number without limits is a hole: NaN, a million hertz, a deadline of a year."""
    assert len(BOUNDED) >= 45
    for place, info in [*_fields(GatewayConfig), *_fields(BayConfig)]:
        kind = "" if get_origin(info.annotation) is Literal else str(info.annotation)
        if "int" in kind or "float" in kind:
            bounded = ">" in bounds_of(info) and "<" in bounds_of(info)
            assert bounded or "tuple" in kind, place


@pytest.mark.parametrize(("place", "info"), BOUNDED, ids=[".".join(place) for place, _ in BOUNDED])
def test_just_outside_its_bounds_every_number_is_refused(place: tuple[str, ...], info: FieldInfo) -> None:
    for constraint in info.metadata:
        for sign, outside in (("ge", -1), ("gt", 0), ("le", 1), ("lt", 0)):
            limit = getattr(constraint, sign, None)
            if limit is None:
                continue
            data: Any = limit + outside if outside else limit
            for key in reversed(place):
                data = {key: data}
            if place[0] == "recipes":
                data = {"recipes": [data["recipes"]]}
            elif place[0] not in {*SHARED_SECTIONS, *GatewayConfig.model_fields}:
                data = {"bays": [data]}
            with pytest.raises(ConfigError) as caught:
                parse(data)
            lines = str(caught.value).replace("recipes.0.", "recipes.").split("\n")
            line = next(line for line in lines if f"{'.'.join(place)} = " in line)
            assert line.endswith(f"(allowed: {bounds_of(info)})")


# Anything at all.

KEYS = st.sampled_from(
    ["site", "modbus", "mqtt", "bays", "camera", "fusion", "ranger", "vision", "url", "port", "name", "reconnect", "x"]
)
JUNK: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=4),
    max_leaves=12,
)


@pytest.mark.long
@pytest.mark.one_interpreter
@given(st.dictionaries(KEYS, JUNK, max_size=5))
@settings(max_examples=examples(100), deadline=None)
def test_junk_is_a_config_or_a_config_error(data: dict[str, Any]) -> None:
    lines: list[str] = []
    try:
        parse(data, source="g.toml")
    except ConfigError as error:
        lines = str(error).split("\n")

    assert all(line.startswith("g.toml: ") for line in lines)


# Constructed in code.


@pytest.mark.parametrize("length", range(16))
def test_distortion_has_as_many_coefficients_as_opencv_knows(length: int) -> None:
    text = f"[vision.intrinsics]\nfx = 1\nfy = 1\ncx = 1\ncy = 1\ndistortion = {[0.1] * length}\n"
    if length in (0, 4, 5, 8, 12, 14):
        intrinsics = parsed(text).bays[0].vision.intrinsics
        assert intrinsics is not None
        assert intrinsics.distortion == (0.1,) * length
    else:
        assert len(errors(text)) == 1


def test_a_threshold_of_a_single_colour_is_one() -> None:
    assert VisionConfig(red_low_1=(10, 255, 255)).red_low_1 == (10, 255, 255)


def test_rules_hold_in_code_as_well() -> None:
    with pytest.raises(ValidationError):
        Reconnect(min_s=2, max_s=1)
    with pytest.raises(ValidationError):
        VisionConfig(red_low_1=(20, 0, 0))
    with pytest.raises(ValidationError):
        FusionConfig(period_s=0.02, vision_deadline_s=0.02, range_deadline_s=0.019)
    assert FusionConfig(period_s=0.02, vision_deadline_s=0.02).period_s == 0.02
    assert Reconnect(min_s=1, max_s=1).max_s == 1
    assert GatewayConfig(bays=(BayConfig(), BayConfig(name="b", unit_id=2))).bays[1].unit_id == 2
