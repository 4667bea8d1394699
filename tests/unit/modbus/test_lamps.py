"""The lamps of a signal for the driver: every instruction, with and without stop."""

import re
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from gateway.core.fusion import forced_stop, initial
from gateway.core.shown import withdrawn
from gateway.core.state import Guidance, GuidanceCode, Reason, StateVector
from gateway.modbus.registers.register_map import encode
from tests.permitted import permitted

DISPLAY = Path(__file__).parents[3] / "gateway" / "web" / "static" / "lib" / "guidance.js"
# The specification, written a second time: the word at address 100 while the truck may move.
RED, AMBER, GREEN, FORWARD, BACK, LEFT, RIGHT, FLASH = (1 << bit for bit in range(8))
WORDS = {
    "WAIT": 0x01,
    "FORWARD": 0x0C,
    "BACK": 0x11,
    "LEFT": 0x24,
    "RIGHT": 0x44,
    "SLOW": 0x0A,
    "STOP": 0x01,
    "OK": 0x01,
    "TOO_FAR": 0x81,
    "FAULT": 0x01,
    "LEAVE": 0x04,
    "DRIVE_UP": 0x0C,
    "BRAKE": 0x81,
}


def shown(state: StateVector) -> int:
    return encode(state, 0, "big")[100]


def with_code(code: GuidanceCode, **changes: Any) -> StateVector:
    return permitted(guidance=Guidance(code), **changes)


def display() -> dict[str, tuple[str, str, bool]]:
    """Code -> (kind, symbol, drives) of the driver's display, from its own table."""
    rows = re.findall(r"^  (\w+): \{ kind: '(\w+)', symbol: '(\w+)', drives: (\w+) \},$", DISPLAY.read_text(), re.M)
    return {code: (kind, symbol, drives == "true") for code, kind, symbol, drives in rows}


@pytest.mark.parametrize("code", GuidanceCode)
def test_every_instruction_has_its_lamps(code: GuidanceCode) -> None:
    assert shown(with_code(code)) == WORDS[code.name]


@pytest.mark.parametrize("code", GuidanceCode)
def test_stop_or_no_may_move_is_red_whatever_the_instruction(code: GuidanceCode) -> None:
    for stop, may_move in product((False, True), repeat=2):
        word = shown(with_code(code, stop=stop, may_move=may_move))
        assert [bool(word & lamp) for lamp in (RED, AMBER, GREEN)].count(True) == 1
        if stop or not may_move:
            assert word & RED
            assert word & ~RED == (WORDS[code.name] & ~RED if WORDS[code.name] & RED else 0)


def test_the_lamps_show_what_the_drivers_display_shows() -> None:
    arrows = {"up": FORWARD, "ahead": FORWARD, "slow": FORWARD, "down": BACK, "left": LEFT, "right": RIGHT}
    table = display()
    assert table.keys() == {code.name for code in GuidanceCode}
    for code, (kind, symbol, drives) in table.items():
        word = WORDS[code]
        assert bool(word & RED) is not drives
        assert word & (FORWARD | BACK | LEFT | RIGHT) == arrows.get(symbol, 0)
        assert word & RED or kind != "halt"
        assert bool(word & GREEN) == (kind == "go")


def test_red_where_nothing_is_known() -> None:
    moving = with_code(GuidanceCode.FORWARD)
    assert shown(moving) == GREEN | FORWARD
    assert shown(initial("bay1", 0)) == RED
    assert shown(withdrawn(moving, moving.t_ns)) == RED
    assert shown(forced_stop(moving, Reason.SHUTDOWN, moving.t_ns)) == RED
