"""One value to words and back: exact bits, limits, sentinels, and nothing that raises or wraps."""

import math
import struct

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gateway.modbus.registers.register import (
    FLOAT32,
    MEASURED_FLOAT32,
    MEASURED_INT16,
    MEASURED_UINT16,
    UINT16,
    UINT32,
    UINT64,
    WireType,
    WordOrder,
    packer,
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
        (MEASURED_INT16, None, 0.1, (0x8000,), False),
        (MEASURED_INT16, math.nan, 0.1, (0x8000,), False),
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
        (UINT64, 2**64, 1, (0xFFFF,) * 4, True),
        (FLOAT32, 123456.0, 1, (0x47F1, 0x2000), False),
        (FLOAT32, -1.5, 1, (0xBFC0, 0x0000), False),
        (MEASURED_FLOAT32, 1e39, 1, (0x7F7F, 0xFFFF), False),
        (MEASURED_FLOAT32, -(10**400), 1, (0xFF7F, 0xFFFF), False),
        (MEASURED_FLOAT32, None, 1, (0x7FC0, 0x0000), False),
        (MEASURED_FLOAT32, -math.inf, 1, (0x7FC0, 0x0000), False),
    ],
)
def test_exact_words(kind: WireType, value: float | None, scale: float, words: tuple[int, ...], cut: bool) -> None:
    assert packer(kind, scale, "big")(value) == (words, cut)
    assert packer(kind, scale, "little")(value) == (words[::-1], cut)


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
