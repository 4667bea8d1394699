"""A Modbus distance sensor: what each answer becomes, and that an answer to another request is never used."""

from typing import Any

import pytest
from pydantic import ValidationError
from pymodbus.framer import FramerRTU

from gateway.config import RangerConfig
from gateway.config.sections.ranger import NumberConfig
from gateway.core.readings import Quality, RangeReading
from gateway.ranger.modbus_sensor import ModbusSensorSession

MS = 1_000_000
ASK_20 = bytes.fromhex("0103010100 01")
"""FC03, register 0101, one: as in the Modbus Application Protocol V1.1b3, 6.3."""
LINE_MS = 16  # request and answer, 8 + 7 bytes of 10 bits at 9600 baud: 15.6 ms


def rtu(body: bytes) -> bytes:
    return body + FramerRTU.compute_CRC(body).to_bytes(2, "big")


def answer(number: int, unit_id: int = 1) -> bytes:
    return rtu(bytes([unit_id, 3, 2]) + number.to_bytes(2, "big"))


class Line:
    """A sensor's session, and the time in ms."""

    def __init__(self, port: str = "/dev/ttyUSB0", median: int = 1, **modbus: Any) -> None:
        number = {key: modbus.pop(key) for key in NumberConfig.model_fields if key in modbus}
        keys = {"address": 0x0101, **modbus}
        config = {"type": "modbus", "port": port, "median": median, "glitch_gate_mm": 0, "modbus": keys}
        self.session = ModbusSensorSession(RangerConfig.model_validate(config | {"number": number}))
        self.session.opened(0)

    def ask(self, ms: float) -> bytes:
        return self.session.request(round(ms * MS))

    def hear(self, ms: float, data: bytes) -> list[RangeReading]:
        return self.session.feed(data, round(ms * MS))

    def good(self, ms: float, number: int) -> RangeReading:
        """A request at `ms`, answered as fast as the line can."""
        assert self.ask(ms) == rtu(ASK_20)
        [reading] = self.hear(ms + LINE_MS, answer(number))
        return reading


def test_the_request_is_that_of_the_standard_and_the_answer_is_as_old_as_its_request() -> None:
    line = Line(delay_ms=30)
    reading = line.good(100, 253)
    assert (reading.quality, reading.distance_mm, reading.t_ns) == (Quality.GOOD, 253.0, 70 * MS)
    assert line.session.identity == "Modbus RTU unit 1, holding register 257"
    assert line.ask(134 - 25) == b""  # a period is 60 ms, and a request may be 25 ms early
    assert line.good(160, 254).distance_mm == 254.0
    assert line.session.stats.lines == 2


@pytest.mark.parametrize(
    ("keys", "registers", "mm"),
    [
        ({"mm_per_unit": 0.1}, "09C4", 250.0),
        ({"data_type": "int16", "offset_mm": 300}, "FFCE", 250.0),
        ({"data_type": "uint32", "mm_per_unit": 0.001}, "0003D090", 250.0),
        ({"data_type": "uint32", "mm_per_unit": 0.001, "word_order": "low_first"}, "D0900003", 250.0),
        ({"data_type": "int32"}, "000000FA", 250.0),
        ({"data_type": "float32", "mm_per_unit": 1000}, "3E800000", 250.0),
        ({"shift_bits": 2}, "03EB", 250.0),  # an IO-Link sensor's two status bits
        ({"mm_per_unit": -0.01, "offset_mm": 500}, "61A8", 250.0),  # falls with the distance
    ],
)
def test_registers_become_mm(keys: dict[str, Any], registers: str, mm: float) -> None:
    line = Line(**keys)
    assert line.ask(0)
    data = bytes.fromhex(registers)
    [reading] = line.hear(50, rtu(bytes([1, 3, len(data)]) + data))
    assert reading.distance_mm == pytest.approx(mm)


@pytest.mark.parametrize(
    ("number", "quality"),
    [
        (65535, Quality.NO_ECHO),
        (10, Quality.LINK_DOWN),
        (65534, Quality.LINK_DOWN),
        (11, Quality.TOO_NEAR),
        (4001, Quality.TOO_FAR),
        (65000, Quality.TOO_FAR),
    ],
)
def test_what_is_no_distance_has_none(number: int, quality: Quality) -> None:
    line = Line(no_echo=[65535], fault_below=11, fault_above=65000)
    line.good(0, 300)
    reading = line.good(60, number)
    assert (reading.quality, reading.distance_mm) == (quality, None)


def test_a_number_counts_only_while_the_status_before_it_says_so_and_both_are_one_request() -> None:
    line = Line(port="socket://10.0.0.9:502", framing="tcp", address=1002, status_mask=0x7F, status_valid=3)
    readings = []
    for n, status in enumerate((0x0003, 0xFF03, 0x0007, 0x0001, 0x0000, 0x0003)):  # IOL mode, connected, invalid data
        asked = line.ask(60 * n)
        assert asked[7:] == bytes.fromhex("03 03E9 0002")
        readings += line.hear(60 * n + 50, asked[:2] + bytes.fromhex(f"0000 0007 01 03 04 {status:04X} 00FA"))
    gone = Quality.LINK_DOWN
    assert [one.quality for one in readings] == [Quality.GOOD, Quality.GOOD, gone, gone, gone, Quality.GOOD]
    assert [one.distance_mm for one in readings] == [250, 250, None, None, None, 250]
    assert readings[2].detail == "its status register holds 0x0007"


@pytest.mark.parametrize("registers", ["7FC00000", "7F800000", "FF800000"])
def test_nan_and_infinity_are_no_distance(registers: str) -> None:
    line = Line(data_type="float32")
    assert line.ask(0)
    [reading] = line.hear(50, rtu(bytes([1, 3, 4]) + bytes.fromhex(registers)))
    assert reading.quality in (Quality.TOO_NEAR, Quality.TOO_FAR)
    assert reading.distance_mm is None


def test_a_number_that_never_changes_is_stuck_where_that_is_asked_for() -> None:
    line = Line(unchanged_s=1)
    qualities = [line.good(60 * n, 300).quality for n in range(20)]
    assert qualities == [Quality.GOOD] * 17 + [Quality.STUCK] * 3  # 60 * 17 ms is more than a second
    assert line.good(1200, 301).quality is Quality.GOOD


def test_a_late_answer_is_not_taken_for_that_to_the_next_request() -> None:
    """The serial server held the first one back: what it says is 100 ms older than the second request."""
    line = Line()
    line.good(0, 300)
    assert line.ask(60)
    assert line.ask(161) == b""  # given up; nothing is asked until the line was quiet
    assert line.hear(170, answer(400)) == []
    assert line.ask(262) == b""  # its bytes began the wait again
    assert line.good(271, 500).distance_mm == 500.0
    assert line.session.stats.gaps == 1


def test_an_answer_that_the_line_cannot_have_carried_yet_is_an_earlier_ones() -> None:
    """A serial server keeps one answer back for good: each request is answered with the one before, at once."""
    line = Line(timeout_ms=50)
    for ms in range(0, 1200, 100):
        assert line.ask(ms)
        assert line.hear(ms + 1, answer(300 + ms)) == []
    [stale] = line.session.tick(1200 * MS)
    assert stale.quality is Quality.STALE
    assert "ranger.baud" in stale.detail


def test_of_answers_that_come_at_once_none_is_used() -> None:
    """A connection was stuck: all that a serial server had to say comes together, and the first is seconds old."""
    line = Line()
    line.good(0, 300)
    assert line.ask(60)
    assert line.hear(155, answer(400) + answer(500)) == []
    assert line.ask(156) == b""  # nothing is asked until the line was quiet
    assert line.good(256, 600).distance_mm == 600.0


@pytest.mark.parametrize("body", ["01 04 02 0190", "01 06 0101 0190"])
def test_an_answer_to_another_function_is_no_distance(body: str) -> None:
    line = Line()
    assert line.ask(0)
    assert line.hear(50, rtu(bytes.fromhex(body))) == []
    assert line.session.stats.rejected == 1


def test_a_number_without_echo_is_known_as_float32() -> None:
    line = Line(data_type="float32", mm_per_unit=1000, no_echo=[3.3])
    assert line.ask(0)
    [reading] = line.hear(50, rtu(bytes.fromhex("01 03 04 40533333")))
    assert (reading.quality, reading.distance_mm) == (Quality.NO_ECHO, None)


def test_silence_is_stale_and_says_what_was_received_instead() -> None:
    line = Line()
    line.good(0, 300)
    for ms in range(60, 1100, 50):
        line.ask(ms)
    [stale] = line.session.tick(1017 * MS)
    assert (stale.quality, stale.distance_mm, stale.detail) == (Quality.STALE, None, "no answer for 1 s")
    line = Line()
    for ms in range(0, 1000, 60):
        assert line.ask(ms)
        assert line.hear(ms + 20, rtu(bytes([1, 0x83, 2]))) == []
    [stale] = line.session.tick(1000 * MS)
    assert stale.detail == "exception 02 for 1 s"


def test_damage_foreign_units_and_the_lines_own_echo() -> None:
    line = Line(timeout_ms=200)
    asked = line.ask(0)
    good = answer(300)
    assert line.hear(20, good[:4] + bytes([good[4] ^ 1]) + good[5:]) == []  # a bit of it is wrong
    assert line.hear(30, answer(300, unit_id=2)) == []
    assert line.hear(40, asked[:5]) == []
    [reading] = line.hear(50, asked[5:] + good)  # a two-wire adapter returns what was sent
    assert reading.distance_mm == 300.0
    stats = line.session.stats
    assert (stats.damaged, stats.rejected, stats.lines) == (1, 1, 1)


def test_nothing_is_asked_while_others_talk_on_the_line() -> None:
    line = Line()
    line.good(0, 300)
    for ms in range(60, 1200, 20):
        assert line.hear(ms, b"\x07\x03\x00\x00") == []
        assert line.ask(ms + 1) == b""
    assert [r.quality for r in line.session.tick(1200 * MS)] == [Quality.STALE]


def test_modbus_tcp_answers_are_known_by_their_transaction_id() -> None:
    line = Line(port="socket://127.0.0.1:502", framing="tcp", timeout_ms=100)
    first = line.ask(0)
    assert first == bytes.fromhex("0001 0000 0006 01 03 0101 0001")
    assert line.ask(100)[:2] == b"\x00\x02"  # the first was given up
    late, now = (bytes.fromhex(f"{n:04X} 0000 0005 01 03 02") + mm.to_bytes(2, "big") for n, mm in ((1, 400), (2, 500)))
    [reading] = line.hear(101, late + now)
    assert (reading.distance_mm, reading.t_ns) == (500.0, 100 * MS)
    assert (line.session.stats.gaps, line.session.stats.rejected) == (1, 1)
    assert line.ask(160)
    assert line.hear(161, bytes.fromhex("0003 1234") + bytes(300)) == []  # another protocol
    assert line.session.stats.damaged >= 1
    assert line.ask(270)
    [reading] = line.hear(271, bytes.fromhex("0004 0000 0005 01 03 02 0258"))
    assert reading.distance_mm == 600.0
    assert line.ask(330)
    assert line.hear(331, bytes.fromhex("0000 0000 0005 01 03 02 0258")) == []  # of no request


@pytest.mark.parametrize(
    ("port", "keys", "fault"),
    [
        ("/dev/ttyUSB0", {"framing": "tcp"}, "socket://"),
        ("/dev/ttyUSB0", {"unit_id": 0}, "1 to 247"),
        ("/dev/ttyUSB0", {"data_type": "float32", "shift_bits": 2}, "float32"),
        ("/dev/ttyUSB0", {"mm_per_unit": 0}, "zero"),
        ("/dev/ttyUSB0", {"nearest_mm": 500, "farthest_mm": 500}, "nearest_mm"),
    ],
)
def test_what_cannot_work_is_refused(port: str, keys: dict[str, Any], fault: str) -> None:
    with pytest.raises(ValidationError, match=fault):
        Line(port=port, **keys)
