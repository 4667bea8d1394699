"""The firmware's codec against the gateway's: same bytes for the same message, and each understands the other."""

import binascii
import ctypes
import random

from gateway.core.readings import RelayOutput
from gateway.ranger.hcsr04.protocol import (
    ALL_FLAGS,
    MAX_PERIOD_MS,
    MAX_SEQ,
    MAX_TICKS,
    MIN_PERIOD_MS,
    QUESTION,
    Decoder,
    Event,
    Flags,
    Hello,
    Measurement,
    RelayReport,
    encode_hello,
    encode_measurement,
    tenths_at_20c,
)
from tests.firmware.core import MS, Core, library

LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_.-"
NO_TEMPERATURE = -(2**15)
MESSAGES = 60_000


def random_message(draw: random.Random) -> Hello | Measurement:
    """Spread over the digits, so that short numbers are as common as long ones."""
    if draw.random() < 0.2:
        name = "".join(draw.choices(LETTERS, k=draw.randint(1, 16)))
        return Hello(name, 1, draw.randint(MIN_PERIOD_MS, MAX_PERIOD_MS), draw.randint(0, 255) >> draw.randrange(8))
    return Measurement(
        draw.randint(0, MAX_SEQ) >> draw.randrange(16),
        draw.randint(0, MAX_TICKS) >> draw.randrange(20),
        Flags(draw.randint(0, ALL_FLAGS.value)),
        draw.choice((None, draw.randint(-400, 850), draw.randint(-20, 20))),
        draw.choice((None, RelayReport(draw.randint(0, 0xFFFF), RelayOutput(draw.randrange(3)), draw.randrange(4)))),
    )


def relay_number(report: RelayReport | None) -> int:
    """As the harness takes it."""
    return -1 if report is None else report.run << 4 | report.output << 2 | report.pins


class Board:
    """The firmware's encoder, with a line's worth of memory behind it that must stay as it was."""

    def __init__(self) -> None:
        self._library = library()
        self._line = ctypes.create_string_buffer(52 + 8)

    def encode(self, message: Hello | Measurement) -> bytes:
        ctypes.memset(self._line, 0xA5, 60)
        if isinstance(message, Hello):
            size = self._library.harness_hello(message.name.encode(), message.period_ms, message.mcusr, self._line)
        else:
            temperature_dc = NO_TEMPERATURE if message.temperature_dc is None else message.temperature_dc
            size = self._library.harness_measurement(
                message.seq,
                message.ticks,
                message.flags.value,
                temperature_dc,
                relay_number(message.relay),
                -1 if message.beacon is None else message.beacon,
                self._line,
            )
        assert size <= 52
        assert self._line.raw[size:] == b"\xa5" * (60 - size)
        return self._line.raw[:size]


def test_the_gateway_decodes_what_the_board_says_on_random_messages() -> None:
    draw, board = random.Random(1), Board()
    messages = [random_message(draw) for _ in range(MESSAGES)]
    events: list[Event] = Decoder().feed(b"".join(map(board.encode, messages)))
    assert events == messages


def test_the_board_says_a_message_with_the_very_bytes_of_the_gateways_encoder() -> None:
    draw, board = random.Random(2), Board()
    for _ in range(MESSAGES):
        message = random_message(draw)
        theirs = encode_hello(message) if isinstance(message, Hello) else encode_measurement(message)
        assert board.encode(message) == theirs


def test_the_longest_lines_fit() -> None:
    board = Board()
    longest = Measurement(MAX_SEQ, MAX_TICKS, ALL_FLAGS, -400, RelayReport(0xFFFF, RelayOutput.MAY_MOVE, 3), 255)
    hello = Hello("ABCDEFGHIJKLMNOP", 1, 500, 255)
    assert len(board.encode(longest)) == len(encode_measurement(longest)) == 50
    assert len(board.encode(hello)) == len(encode_hello(hello)) == 38


def test_the_board_hears_the_gateways_question_among_any_bytes() -> None:
    """The only thing the gateway says. 60 000 random bytes, about one in six cycles with a question."""
    draw = random.Random(3)
    core = Core()
    asked = answered = 0
    for _ in range(2000):
        data = draw.randbytes(30) if draw.random() < 0.5 else draw.randbytes(30) + QUESTION + draw.randbytes(3)
        core.begin()
        core.receive(data)
        said = core.poll(core.due - core.period + 1).said
        asked += QUESTION in data
        answered += Hello("hcsr04", 1, 60, 1) in said
        assert (QUESTION in data) == (len(said) == 1)
    assert asked == answered > 1000
    core.close()


def test_the_printed_distance_is_the_gateways_for_every_tick() -> None:
    tenths = library().ranger_tenths_at_20c
    assert [tenths(ticks) for ticks in range(50_001)] == [tenths_at_20c(ticks) for ticks in range(50_001)]


def test_and_beyond_what_a_sensor_can_cause() -> None:
    tenths = library().ranger_tenths_at_20c
    spread = [*range(50_000, MAX_TICKS, 37), *(n * 20_000 + d for n in range(1, 50) for d in (-1, 0, 1)), MAX_TICKS]
    assert [tenths(ticks) for ticks in spread] == [tenths_at_20c(ticks) for ticks in spread]


def test_the_checksum_is_crc_16_xmodem() -> None:
    crc = library().ranger_crc
    for seed in (0, 1, 0x8000, 0xFFFF, 0x1021):
        for byte in range(256):
            assert crc(seed, byte) == binascii.crc_hqx(bytes([byte]), seed)


def test_the_thermometers_volts_become_degrees() -> None:
    """TMP36: 0.5 V at 0 °C and 10 mV a degree; 64 samples of 1024 steps of the reference."""
    tmp36 = library().ranger_tmp36
    for reference_mv in (1000, 1100, 1200):
        for tenths in range(-400, min(850, reference_mv - 501)):
            sum_of_64 = round((tenths + 500) * 65_536 / reference_mv)
            assert tmp36(sum_of_64, reference_mv) == tenths
    assert tmp36(0, 1100) == -500  # nothing connected, input low: no temperature
    assert tmp36(64 * 1023, 1100) == 599


# -- DS18B20: the bytes of its memory ---------------------------------------------------------------------------------

HOLD = 10_000 * MS
POWER_ON = 0x0550


def crc8(data: bytes) -> int:
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0x8C if crc & 1 else crc >> 1
    return crc


def pad(raw: int, configuration: int = 0x7F) -> bytes:
    """Its memory, for a temperature in 1/16 degree."""
    body = (raw & 0xFFFF).to_bytes(2, "little") + bytes([0x4B, 0x46, configuration, 0xFF, 0x0C, 0x10])
    return body + bytes([crc8(body)])


def taken(memory: bytes, *, now: int = 0, later: int = 0) -> int:
    answer: int = library().harness_ds18b20(memory, now, later)
    return answer


def test_the_crc_of_this_test_is_that_of_1_wire() -> None:
    assert crc8(bytes.fromhex("02 1C B8 01 00 00 00")) == 0xA2  # application note 27


def test_every_temperature_of_a_ds18b20_is_right_or_refused() -> None:
    for raw in range(-880, 2001):
        tenths = raw * 10 / 16
        possible = raw != POWER_ON and -400 <= tenths <= 850
        assert abs(taken(pad(raw)) - tenths) <= 0.5 if possible else taken(pad(raw)) == NO_TEMPERATURE, raw
    assert [taken(pad(raw)) for raw in (0x0158, -8, -197, -640)] == [215, -5, -123, -400]
    assert {taken(pad(raw)) for raw in (-641, 0x7FFF, -0x8000, POWER_ON)} == {NO_TEMPERATURE}
    assert taken(pad(0x0158, configuration=0x1F)) == 215  # nine bits


def test_what_no_ds18b20_says_is_refused() -> None:
    """Open, held low, all damage to one bit, and a chip that is another one."""
    assert {taken(memory) for memory in (b"\xff" * 9, b"\0" * 9)} == {NO_TEMPERATURE}
    good = pad(0x0158)
    for bit in range(72):
        assert taken((int.from_bytes(good) ^ 1 << bit).to_bytes(9)) == NO_TEMPERATURE
    assert taken(pad(0x0158, configuration=0xFF)) == NO_TEMPERATURE


def test_its_temperature_ends_ten_seconds_after_it_was_read() -> None:
    for now in (0, 2**32 - HOLD // 2):  # the clock may wrap
        assert [taken(pad(0x0158), now=now, later=later) for later in (HOLD - 1, HOLD)] == [215, NO_TEMPERATURE]
