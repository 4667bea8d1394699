"""The bits of FC 1 and 2 are those of five registers."""

from dataclasses import replace
from itertools import pairwise

import pytest

from gateway.core.fusion import initial
from gateway.core.plc import Control
from gateway.core.state import ReferencePosition, StateVector, Visit
from gateway.modbus.registers import bits
from gateway.modbus.registers.bits import Bit
from gateway.modbus.registers.position import POSITION_STATUS
from gateway.modbus.registers.register_map import BLOCK_WORDS, STATUS, encode


def test_every_bit_of_the_table() -> None:
    rows = list(bits.table())
    assert [row.address for row in rows] == [*range(22), *range(32, 39), *range(48, 56), 67]
    assert [(row.name, row.meaning) for row in rows[:16]] == [STATUS.names[n] for n in range(16)]
    assert [row.name for row in rows[22:29]] == [bit.name.lower() for bit in Control]
    lamps = ["red", "amber", "green", "forward", "back", "left", "right", "flash"]
    assert [row.name for row in rows[29:]] == [*lamps, "alive"]
    assert rows[17] == Bit(17, "in_place", "position_status", 1, POSITION_STATUS.names[1][1])


def test_the_address_of_a_bit() -> None:
    assert bits.coil_of("status", 14) == 14
    assert bits.coil_of("plc_control", Control.RELEASE) == 37
    with pytest.raises(ValueError, match="not in tuple"):
        bits.coil_of("seq_begin", 0)


def test_bits_of_an_image() -> None:
    image = [0] * BLOCK_WORDS
    image[3], image[35], image[81], image[100] = 0x8001, 0x0002, 0x0020, 0x000C
    assert bits.bits_of(image) == (80, 0x000C_0020_0002_8001)
    assert bits.bits_of(image[:101]) == (80, 0x000C_0020_0002_8001)
    assert bits.bits_of(image[:100]) == (0, 0), "too short to have signal_lamps"


@pytest.mark.failure_mode("G1")
@pytest.mark.parametrize("poll_ms", [20, 50, 70, 100, 130])
def test_the_bit_of_the_heartbeat_is_seen_to_change_in_time_at_any_poll_that_a_plc_makes(poll_ms: int) -> None:
    """It is dead after 500 ms without a change."""
    (alive,) = [row for row in bits.table() if row.register == "heartbeat"]
    for phase_ms in range(0, 20, 7):
        polls = [(phase_ms + n * poll_ms) for n in range(300)]
        images = [encode(StateVector("b", heartbeat=t_ms // 20), 0, "big") for t_ms in polls]
        seen = [bits.bits_of(image)[1] >> alive.address & 1 for image in images]
        changes = [t for t, before, now in zip(polls[1:], seen, seen[1:], strict=False) if before != now]
        assert max(b - a for a, b in pairwise([0, *changes])) <= 160 + 2 * poll_ms <= 500


def test_a_truck_that_rolls_is_bit_5_of_the_position_status() -> None:
    visit = Visit(reference=ReferencePosition(rolling_since_ns=1, sensor="range"))
    assert POSITION_STATUS.read(replace(initial("bay1", 1), visit=visit), 1) == 0b100000
    assert POSITION_STATUS.read(initial("bay1", 1), 1) == 0
