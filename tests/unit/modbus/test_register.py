"""One value to words and back: exact bits, limits, sentinels, and nothing that raises or wraps."""

import math
import struct
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gateway.core.detection import Circle
from gateway.core.plc import TriggerOutcome
from gateway.core.readings import Quality, VisionReading, VisionStats
from gateway.core.state import StateVector
from gateway.modbus.registers.register import (
    FLOAT32,
    MEASURED_FLOAT32,
    MEASURED_INT16,
    MEASURED_UINT16,
    UINT16,
    UINT32,
    UINT64,
    StatusWord,
    WireType,
    WordOrder,
    named,
    packer,
    part,
    shown,
    unpack,
)

CALM = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])  # a busy machine is no finding

NUMBERS = st.one_of(st.floats(), st.integers(), st.integers(-(10**400), 10**400), st.floats(-7000, 7000))
SCALED = [(MEASURED_UINT16, 0.1), (MEASURED_UINT16, 1), (MEASURED_INT16, 0.1)]
PLAIN = [(UINT16, 1), (UINT32, 1), (UINT64, 1)]
ORDERS: tuple[WordOrder, ...] = ("big", "little")


@pytest.mark.parametrize(
    ("kind", "value", "scale", "words", "cut"),
    [
        (MEASURED_INT16, 0.04, 0.1, (0,), False),
        (MEASURED_INT16, -0.3, 0.1, (0xFFFD,), False),
        (MEASURED_INT16, 3276.7, 0.1, (0x7FFF,), False),
        (MEASURED_INT16, 3276.8, 0.1, (0x7FFF,), True),
        (MEASURED_INT16, -3276.7, 0.1, (0x8001,), False),
        (MEASURED_INT16, -3276.8, 0.1, (0x8001,), True),  # one further would be the sentinel
        (MEASURED_INT16, -(10**400), 0.1, (0x8001,), True),
        (MEASURED_INT16, -math.inf, 0.1, (0x8000,), False),
        (MEASURED_INT16, None, 0.1, (0x8000,), False),
        (MEASURED_INT16, math.nan, 0.1, (0x8000,), False),
        (MEASURED_UINT16, 5, 0.1, (50,), False),
        (MEASURED_UINT16, 6553.4, 0.1, (0xFFFE,), False),
        (MEASURED_UINT16, 6553.5, 0.1, (0xFFFE,), True),  # would be the sentinel
        (MEASURED_UINT16, 1e308, 0.1, (0xFFFE,), True),  # overflows when divided by the scale
        (MEASURED_UINT16, 10**400, 1, (0xFFFE,), True),  # an integer beyond any float
        (MEASURED_UINT16, -1, 1, (0,), True),
        (MEASURED_UINT16, math.inf, 1, (0xFFFF,), False),
        (MEASURED_UINT16, None, 1, (0xFFFF,), False),
        (UINT16, 0xFFFF, 1, (0xFFFF,), False),
        (UINT16, 0x1_0000, 1, (0xFFFF,), True),
        (UINT16, None, 1, (0,), False),
        (UINT32, 0x1234_5678, 1, (0x1234, 0x5678), False),
        (UINT64, 0x0001_0002_0003_0004, 1, (1, 2, 3, 4), False),
        (UINT64, 2**64 - 2, 1, (0xFFFF, 0xFFFF, 0xFFFF, 0xFFFE), False),  # no float has so many digits
        (UINT64, 2**64, 1, (0xFFFF,) * 4, True),
        (FLOAT32, 123456.0, 1, (0x47F1, 0x2000), False),
        (FLOAT32, -1.5, 1, (0xBFC0, 0x0000), False),
        (MEASURED_FLOAT32, 1e39, 1, (0x7F7F, 0xFFFF), False),
        (MEASURED_FLOAT32, -(10**400), 1, (0xFF7F, 0xFFFF), False),
        (MEASURED_FLOAT32, None, 1, (0x7FC0, 0x0000), False),
        (MEASURED_FLOAT32, -math.inf, 1, (0x7FC0, 0x0000), False),
        (MEASURED_FLOAT32, math.inf, 1, (0x7FC0, 0x0000), False),
    ],
)
def test_exact_words(kind: WireType, value: float | None, scale: float, words: tuple[int, ...], cut: bool) -> None:
    assert packer(kind, scale, "big")(value) == (words, cut)
    assert packer(kind, scale, "little")(value) == (words[::-1], cut)


@pytest.mark.one_interpreter
@CALM
@given(value=NUMBERS, case=st.sampled_from(SCALED + PLAIN), order=st.sampled_from(ORDERS))
def test_integers_are_right_or_at_their_limit_or_nothing(
    value: float, case: tuple[WireType, float], order: WordOrder
) -> None:
    kind, scale = case
    words, cut = packer(kind, scale, order)(value)
    back = unpack(kind, words, scale, order)

    assert len(words) == kind.words
    assert all(0 <= word <= 0xFFFF for word in words)
    if not -math.inf < value < math.inf:
        assert back == (None if kind.no_value is not None else 0)
        return
    assert back is not None
    low, high = kind.low * scale, kind.high * scale
    if value >= high + scale or value <= low - scale:
        assert cut
        assert back == pytest.approx(high if value > 0 else low)
    elif not cut:
        assert abs(back - value) <= scale * 0.5000001 + abs(value) * 1e-15


@CALM
@given(value=NUMBERS, order=st.sampled_from(ORDERS))
def test_floats_are_the_nearest_float32(value: float, order: WordOrder) -> None:
    words, cut = packer(MEASURED_FLOAT32, 1, order)(value)
    back = unpack(MEASURED_FLOAT32, words, 1, order)

    assert not cut
    if not -math.inf < value < math.inf:
        assert back is None
        return
    assert back is not None
    assert math.isfinite(back)
    if abs(value) < 3.4e38:
        assert back == struct.unpack(">f", struct.pack(">f", value))[0]
    else:
        assert abs(back) > 3.39e38
        assert (back > 0) == (value > 0)


SEEN = StateVector("bay1", stop=False, vision=VisionReading(0, Quality.GOOD, Circle(1.5, 2.5, 0.75), visible=0.75))


def test_a_part_of_a_record_that_may_be_missing() -> None:
    assert part(lambda state: state.vision.circle, "v_px")(SEEN, 7) == 2.5
    blind = StateVector("bay1")
    assert part(lambda state: state.vision.circle, "v_px")(blind, 7) is None


def test_a_register_of_a_value() -> None:
    share = shown(72, "visible", MEASURED_UINT16, 0.1, "visible")
    assert (share.read(SEEN, 7), share.unit, share.meaning) == (75.0, "%", "share of the rim seen, 0 to 1")
    assert shown(71, "confidence", MEASURED_UINT16, 0.1, "confidence").read(SEEN, 7) is None
    lost = replace(SEEN, vision=replace(SEEN.vision, stats=VisionStats(lost=65_541)))
    count = shown(27, "frames_lost", UINT16, 1, "counters.frames_lost", "lost, modulo 65536")
    assert (count.read(lost, 7), count.unit, count.meaning) == (5, "", "lost, modulo 65536")
    assert shown(44, "x_n", MEASURED_FLOAT32, 1, "x_n").unit == ""


def test_codes_have_names_in_small_letters() -> None:
    assert named(TriggerOutcome)[2] == ("not_in_place", "D = 0")
    assert list(named(TriggerOutcome)) == [0, 1, 2, 3, 4]


def test_a_status_word() -> None:
    word = StatusWord((
        ("stop", "it is on", lambda state: state.stop),
        ("seen", "a circle", lambda state: state.vision.circle is not None),
        ("known", "D", lambda state: state.d is not None),
        ("bay", "its name", lambda state: state.bay == "bay1"),
    ))  # fmt: skip
    assert word.read(SEEN, 7) == 0b1010
    assert word.names == {0: ("stop", "it is on"), 1: ("seen", "a circle"), 2: ("known", "D"), 3: ("bay", "its name")}
    assert word.on(0b1010) == {"seen", "bay"}
    assert word.on(0b11_0000) == set(), "bits without a name"
    assert (word.mask("bay"), word.mask("stop", "known"), word.mask()) == (0b1000, 0b0101, 0)
    with pytest.raises(ValueError, match="gone"):
        word.mask("gone")
