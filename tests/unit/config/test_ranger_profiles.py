"""Ready profiles of distance sensors: what `ranger.profile` sets, what the file says itself, and what it must say."""

import argparse
from pathlib import Path
from typing import Any

import pytest

from gateway.cli import check
from gateway.config import RangerConfig, load, parse
from gateway.config.sections.ranger_profiles import PROFILES
from gateway.config.strict.errors import FaultsError
from gateway.processes.codec import Codec
from gateway.web.ipc.devices import LookAtRanger

FILE = """
[ranger]
profile = "geolux-lx80-o"
baud = 19200

[[ranger.more]]
profile = "waveshare-ai-8ch"
port = "/dev/ttyUSB1"
number = { mm_per_unit = 0.3, offset_mm = -1000, nearest_mm = 200, farthest_mm = 5000, delay_ms = 50 }
modbus.address = 2

[[bays]]
[bays.ranger]
port = "/dev/ttyUSB0"
"""


def test_a_profile_sets_what_the_file_does_not(tmp_path: Path) -> None:
    (tmp_path / "bay.toml").write_text(FILE)
    first, second = load(tmp_path / "bay.toml").bays[0].ranger.sensors
    assert (first.type, first.baud, first.parity, first.modbus.address) == ("modbus", 19200, "even", 1)
    assert (first.number.period_ms, first.number.farthest_mm) == (100, 15000)
    assert (second.baud, second.modbus.table, second.modbus.address) == (9600, "input_register", 2)
    assert (second.number.fault_below, second.number.mm_per_unit) == (3600, 0.3)


def test_a_value_of_the_file_stays_on_the_way_to_another_process() -> None:
    """`baud` is the default of [ranger], and another than the profile's."""
    sent = LookAtRanger(RangerConfig(profile="benewake-tf02-i", baud=9600))
    codec = Codec(LookAtRanger)
    assert codec.unpacked(codec.packed(sent)) == sent


@pytest.mark.parametrize(
    ("ranger", "fault"),
    [
        ({"profile": "sonar"}, "ranger.profile = \"sonar\": Input should be 'none', 'benewake-tf02-i', "),
        ({"profile": "waveshare-ai-8ch"}, "ranger.number.mm_per_unit: is missing: profile 'waveshare-ai-8ch' leaves"),
        ({"profile": "dfrobot-sen0492"}, "ranger.baud: is missing: profile 'dfrobot-sen0492' leaves it to you"),
        ({"profile": "geolux-lx80-o", "type": "ascii"}, "is one of ranger.type = 'modbus'; type is 'ascii'"),
    ],
)
def test_a_profile_that_does_not_fit(ranger: dict[str, Any], fault: str) -> None:
    with pytest.raises(FaultsError, match="ranger") as raised:
        parse({"ranger": ranger})
    assert fault in str(raised.value)


def test_every_profile_is_one_of_known_keys() -> None:
    for name, one in PROFILES.items():
        left = {key.removeprefix("number."): 1 + n for n, key in enumerate(one.required) if key != "baud"}
        ranger = {"profile": name, "port": "socket://10.0.0.9:502", "baud": one.keys.get("baud", 9600), "number": left}
        assert parse({"ranger": ranger}).bays[0].ranger.type == one.keys["type"]


@pytest.mark.parametrize("key", ["nearest_mm", "farthest_mm", "delay_ms"])
def test_no_profile_has_the_range_or_the_delay_of_another_sensor(key: str) -> None:
    """The defaults are those of the HC-SR04, and no delay."""
    silent = [
        n
        for n, one in PROFILES.items()
        if key not in one.keys.get("number", {}) and f"number.{key}" not in one.required
    ]
    assert silent == []


def test_a_profile_is_as_strict_as_its_source() -> None:
    number = parse({"ranger": {"profile": "dfrobot-sen0492", "baud": 115200}}).bays[0].ranger.number
    assert (number.nearest_mm, number.farthest_mm, number.delay_ms) == (40, 4000, 50)


def test_check_shows_the_values_in_force(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bay.toml").write_text(FILE)
    assert check.main(argparse.Namespace(config=tmp_path / "bay.toml", keys=False, full=False, digest=False)) == 0
    shown = capsys.readouterr().out
    assert (
        'bay bay1: ranger 1, profile geolux-lx80-o: type = "modbus", baud = 19200, parity = "even", '
        "number.nearest_mm = 200.0, number.farthest_mm = 15000.0, number.period_ms = 100.0, number.delay_ms = 100.0, "
        "modbus.unit_id = 1, modbus.address = 1\n"
    ) in shown
    assert "ranger 2, profile waveshare-ai-8ch:" in shown
    assert "number.mm_per_unit = 0.3, number.offset_mm = -1000.0" in shown
