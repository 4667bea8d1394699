"""A sensor that sends text: which lines are distances, when they were measured, and that no stored line is used."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from gateway.config import RangerConfig
from gateway.core.readings import Quality, RangeReading
from gateway.ranger.ascii_sensor import MAX_LINE, AsciiSensorSession

MS = 1_000_000
BYTE_MS = 10 / 9.6


def session(pattern: str = "R{distance}\r", **keys: object) -> AsciiSensorSession:
    made = AsciiSensorSession(
        RangerConfig(type="ascii", median=1, glitch_gate_mm=0, ascii={"line": pattern}, number=keys)
    )
    made.opened(0)
    return made


def heard(sensor: AsciiSensorSession, ms: float, data: bytes) -> list[RangeReading]:
    return sensor.feed(data, round(ms * MS))


def live(sensor: AsciiSensorSession, line: bytes = b"R0300\r") -> float:
    """A connection whose pace is kept; the time of its newest line, ms."""
    for n in range(5):
        heard(sensor, 60 * n, line)
    return 240.0


def test_a_line_is_a_distance_of_the_moment_at_which_it_began() -> None:
    sensor = session(delay_ms=20)
    ms = live(sensor)
    assert heard(sensor, ms + 30, b"R0") == []
    [reading] = heard(sensor, ms + 60, b"253\rR")
    assert (reading.quality, reading.distance_mm) == (Quality.GOOD, 253.0)
    assert reading.t_ns / MS == pytest.approx(ms + 60 - 20 - 7 * BYTE_MS)  # with the R that followed it


@pytest.mark.parametrize(
    ("pattern", "line", "mm_per_unit", "mm"),
    [
        ("R{distance}\r", b"R1234\r", 1.0, 1234.0),
        ("{distance} m,{any}\r\n", b"  0.253 m, 88%\r\n", 1000.0, 253.0),
        ("D={distance}mm\n", b"D=+253mm\n", 1.0, 253.0),
        ("({distance})\r", b"(12.5)\r", 25.4, 317.5),
    ],
)
def test_patterns(pattern: str, line: bytes, mm_per_unit: float, mm: float) -> None:
    sensor = session(pattern, mm_per_unit=mm_per_unit)
    ms = live(sensor, line)
    [reading] = heard(sensor, ms + 60, line)
    assert reading.distance_mm == pytest.approx(mm)


def test_the_line_that_had_begun_before_is_not_used() -> None:
    """`R1250` of which `50` arrives is no 50 mm."""
    sensor = session("{distance}\r")
    for n, line in enumerate([b"50\r", *[b"1250\r"] * 6]):
        for reading in heard(sensor, 60 * n, line):
            assert reading.distance_mm == 1250.0
    assert sensor.stats.lines == 4


def test_a_store_of_lines_is_not_used() -> None:
    sensor = session()
    assert heard(sensor, 0, b"R0300\r" * 100) == []
    assert heard(sensor, 5, b"R0300\r" * 100) == []
    ms = 1000.0
    assert [heard(sensor, ms + 60 * n, b"R0400\r") != [] for n in range(4)] == [False, True, True, True]


def test_a_stream_that_stalls_and_then_hurries_is_not_used_until_its_pace_is_kept() -> None:
    sensor = session()
    ms = live(sensor)
    late = [heard(sensor, ms + 1000 + n, b"R0300\r") for n in range(16)]  # 960 ms of lines within 16 ms
    used = [60 * (n + 1) for n, readings in enumerate(late) if readings]
    assert min(used) >= 1000 - 150  # by the sensor's pace these are 150 ms late at most
    [reading] = [r for n in range(1, 5) for r in heard(sensor, ms + 1016 + 60 * n, b"R0500\r")][-1:]
    assert reading.distance_mm == 500.0


@pytest.mark.parametrize("real_ms", [100, 300, 900])
def test_a_sensor_that_is_slower_than_configured_is_not_used(real_ms: int) -> None:
    """What a store had kept would pass for lines that are on time at last."""
    sensor = session()
    times = [real_ms * n for n in range(60)]
    late = [times[-1] + 5000 + n for n in range(17)]  # stuck for 5 s, then at once
    found = [reading for ms in (*times, *late) for reading in heard(sensor, ms, b"R0300\r")]
    assert all(reading.t_ns / MS < 9 * real_ms for reading in found)
    assert "period_ms" in sensor.tick((late[-1] + 2000) * MS)[0].detail


def test_other_lines_are_counted_and_silence_is_stale() -> None:
    sensor = session()
    ms = live(sensor)
    for n in range(20):
        assert heard(sensor, ms + 60 * (n + 1), b"E07\r") == []
    assert sensor.stats.damaged == 20
    [stale] = sensor.tick(round((ms + 1200) * MS))
    assert (stale.quality, stale.detail) == (Quality.STALE, "lines of another form for 1 s")


@given(st.lists(st.binary(max_size=400), max_size=20))
def test_no_bytes_raise_or_pile_up(pieces: list[bytes]) -> None:
    sensor = session("{any}{distance} {any}\r\n")
    for n, piece in enumerate(pieces):
        heard(sensor, 60 * n, piece)
        assert len(sensor._buffer) <= MAX_LINE


@pytest.mark.parametrize(
    ("pattern", "fault"),
    [
        ("R\r", "distance"),
        ("{distance}{distance}\r", "distance"),
        ("R{distance}", "end as"),
        ("Ä{distance}\r", "ASCII"),
    ],
)
def test_what_cannot_work_is_refused(pattern: str, fault: str) -> None:
    with pytest.raises(ValidationError, match=fault):
        session(pattern)
