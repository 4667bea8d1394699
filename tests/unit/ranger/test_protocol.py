"""The line protocol: exact bytes, every way to cut and to damage a stream, and nothing wrong ever accepted."""

import random
from itertools import combinations
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.core.readings import RelayOutput
from gateway.ranger.hcsr04.protocol import (
    ALL_FLAGS,
    FLAG_MEANING,
    MAX_LINE,
    NOISE_RUN,
    Damage,
    Damaged,
    Decoder,
    Event,
    Flags,
    Hello,
    Measurement,
    RelayCommand,
    RelayReport,
    commands_in,
    encode_command,
    encode_hello,
    encode_measurement,
    frame,
    reset_cause,
    tenths_at_20c,
)
from tests.examples import examples
from tools.hcsr04 import wire_ms

DOCS = Path(__file__).parents[3] / "docs" / "ranger.md"

measurements = st.builds(
    Measurement,
    seq=st.integers(0, 0xFFFF),
    ticks=st.integers(0, 999_999),
    flags=st.integers(0, 31).map(Flags),
    temperature_dc=st.none() | st.integers(-400, 850),
    beacon=st.none() | st.integers(0, 255),
    relay=st.none()
    | st.builds(RelayReport, run=st.integers(0, 0xFFFF), output=st.sampled_from(RelayOutput), pins=st.integers(0, 3)),
)
hellos = st.builds(
    Hello,
    name=st.text("abcXYZ019_.-", min_size=1, max_size=16),
    version=st.just(1),
    period_ms=st.integers(10, 500),
    mcusr=st.integers(0, 255),
)
foreign_hellos = st.builds(Hello, name=st.just("other"), version=st.sampled_from((0, 2, 65535)))
messages = st.one_of(measurements, hellos, foreign_hellos)


def encode(message: Hello | Measurement) -> bytes:
    return encode_hello(message) if isinstance(message, Hello) else encode_measurement(message)


def fed(data: bytes) -> list[Event]:
    return Decoder().feed(data)


def bitwise_crc(data: bytes) -> int:
    """CRC-16/XMODEM as avr-libc documents `_crc_xmodem_update`, one bit at a time."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = ((crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


# -- the wire ---------------------------------------------------------------------------------------------------------


def test_these_are_the_bytes_on_the_wire() -> None:
    assert encode_measurement(Measurement(1234, 2912)) == b"$HCM,1234,2912,2500,0*A851\r\n"
    assert b"$HCM,1235,2912,2500,0,215*%04X\r\n" % bitwise_crc(b"HCM,1235,2912,2500,0,215") == encode_measurement(
        Measurement(1235, 2912, temperature_dc=215)
    )
    assert b"$HCM,7,0,0,1*%04X\r\n" % bitwise_crc(b"HCM,7,0,0,1") == encode_measurement(
        Measurement(7, 0, Flags.NO_ECHO)
    )
    assert b"$HCI,hcsr04,1,60,2*%04X\r\n" % bitwise_crc(b"HCI,hcsr04,1,60,2") == encode_hello(Hello("hcsr04", 1, 60, 2))


def test_crc_is_xmodem() -> None:
    assert frame(b"123456789") == b"$123456789*31C3\r\n"  # the check value of the CRC catalogue


def test_distance_for_people_is_echo_time_at_20_degrees() -> None:
    assert [tenths_at_20c(t) for t in (0, 1, 2, 2912, 46_590)] == [0, 1, 2, 2500, 40_000]
    assert all(abs(tenths_at_20c(t) - t * 0.5e-6 * 343.42 / 2 * 1e4) <= 0.5 + 1e-6 for t in range(0, 60_000, 7))


def test_line_times_at_9600_baud() -> None:
    assert len(encode_measurement(Measurement(1234, 2912))) == 28
    assert pytest.approx(29.1667, abs=1e-3) == wire_ms(28, 9600)


def test_every_flag_has_a_meaning_and_its_bit() -> None:
    assert set(Flags) == set(FLAG_MEANING)
    assert [flag.value for flag in Flags] == [1, 2, 4, 8, 16]
    assert ALL_FLAGS == 31


def test_reset_causes() -> None:
    assert reset_cause(8) == "watchdog"
    assert reset_cause(5) == "power on, brown-out"
    assert reset_cause(0) == "unknown"


@given(messages)
def test_round_trip(message: Hello | Measurement) -> None:
    line = encode(message)
    assert [message] == fed(line)
    assert line.startswith(b"$")
    assert line.endswith(b"\r\n")
    assert len(line) - 2 <= MAX_LINE
    event = fed(line)[0]
    if isinstance(event, Measurement):
        assert len(line) == event.size


@pytest.mark.parametrize(
    "message",
    [
        Measurement(65536, 0),
        Measurement(-1, 0),
        Measurement(0, 1_000_000),
        Measurement(0, -1),
        Measurement(0, 0, temperature_dc=-401),
        Measurement(0, 0, temperature_dc=851),
    ],
)
def test_what_cannot_be_encoded_is_refused(message: Measurement) -> None:
    with pytest.raises(ValueError, match="cannot be encoded"):
        encode_measurement(message)


@pytest.mark.parametrize(
    "hello",
    [Hello("", 1, 60), Hello("seventeen-letters", 1, 60), Hello("käse", 1, 60), Hello("a,b", 1, 60), Hello("a", 1, 9)],
)
def test_a_hello_that_cannot_be_encoded_is_refused(hello: Hello) -> None:
    with pytest.raises(ValueError, match="cannot be encoded"):
        encode_hello(hello)


# -- damage, by kind --------------------------------------------------------------------------------------------------

GOOD = encode_measurement(Measurement(5, 3000))


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (b"$HCM,5,3000,2576,0\r\n", Damage.NO_CHECKSUM),
        (b"$HCM,5,3000,2576,0*12G4\r\n", Damage.NO_CHECKSUM),
        (GOOD.lower().replace(b"hcm", b"HCM"), Damage.NO_CHECKSUM),  # lower-case digits: not our spelling
        (b"$\r\n", Damage.NO_CHECKSUM),
        (GOOD.replace(b"3000", b"3001"), Damage.CHECKSUM),
        (frame(b"HCX,1,2,3"), Damage.CONTENT),
        (frame(b"HCM,5,3000,2576"), Damage.CONTENT),
        (frame(b"HCM,05,3000,2576,0"), Damage.CONTENT),
        (frame(b"HCM,+5,3000,2576,0"), Damage.CONTENT),
        (frame(b"HCM,5, 3000,2576,0"), Damage.CONTENT),
        (frame(b"HCM,65536,3000,2576,0"), Damage.CONTENT),
        (frame(b"HCM,5,3000,2576,32"), Damage.CONTENT),
        (frame(b"HCM,5,3000,2576,0,851"), Damage.CONTENT),
        (frame(b"HCM,5,3000,2576,0,-0"), Damage.CONTENT),
        (frame(b"HCM,5,3000,2576,0,"), Damage.CONTENT),
        (frame(b"HCI,name,1"), Damage.CONTENT),
        (frame(b"HCI,name,1,0,1"), Damage.CONTENT),
        (frame(b"HCI,name,1,60,256"), Damage.CONTENT),
        (frame(b"HCM,5,3000,2578,0"), Damage.MISMATCH),
        (frame(b"HCM,5,3000,2574,0"), Damage.MISMATCH),
        (frame(b"HCM,5,3000,0,0"), Damage.MISMATCH),
    ],
)
def test_a_damaged_line_is_one_event_with_its_size(data: bytes, kind: Damage) -> None:
    assert [Damaged(kind, len(data)), Measurement(5, 3000)] == fed(data + GOOD)


def test_firmware_may_round_the_second_distance_either_way() -> None:
    assert tenths_at_20c(3000) == 2576
    for tenths in (2575, 2576, 2577):
        assert [Measurement(5, 3000)] == fed(frame(b"HCM,5,3000,%d,0" % tenths))


def test_a_hello_of_another_version_is_understood_whatever_follows() -> None:
    assert [Hello("new", 2)] == fed(frame(b"HCI,new,2,60,1,more,x=y"))
    assert [Hello("new", 2)] == fed(frame(b"HCI,new,2"))


def test_the_rest_of_a_line_that_began_before_us_is_not_damage() -> None:
    for cut in range(1, len(GOOD)):
        assert [Measurement(5, 3000)] == fed(GOOD[cut:] + GOOD), cut


def test_later_loose_bytes_are_noise() -> None:
    assert [Measurement(5, 3000), Damaged(Damage.NOISE, 3), Measurement(5, 3000)] == fed(GOOD + b"abc" + GOOD)
    assert [Measurement(5, 3000), Damaged(Damage.NOISE, 3)] == fed(GOOD + b"abc\n")
    assert [Measurement(5, 3000), Measurement(5, 3000)] == fed(GOOD + b"\r\n\r\n\n" + GOOD)


def test_a_dollar_inside_a_line_starts_anew() -> None:
    assert [Damaged(Damage.TRUNCATED, 8), Measurement(5, 3000)] == fed(GOOD[:8] + GOOD)


def test_endless_input_without_lines_is_counted_and_not_kept() -> None:
    decoder = Decoder()
    events = decoder.feed(b"$" + b"A" * 100_000)
    assert Damaged(Damage.TOO_LONG, MAX_LINE + 1) == events[0]
    assert set(events[1:]) == {Damaged(Damage.NOISE, NOISE_RUN)}
    size = sum(e.size for e in events if isinstance(e, Damaged))
    assert 100_001 - MAX_LINE - NOISE_RUN <= size <= 100_001  # what is not counted yet is all that is kept
    assert [Measurement(5, 3000)] == [e for e in decoder.feed(b"\n" + GOOD) if isinstance(e, Measurement)]


def test_the_longest_line_passes_and_one_byte_more_does_not() -> None:
    body = b"HCI,n,2," + b"x" * (MAX_LINE - 8 - 6)
    assert len(frame(body)) == MAX_LINE + 2
    assert [Hello("n", 2)] == fed(frame(body))
    assert Damaged(Damage.TOO_LONG, MAX_LINE + 1) == fed(frame(body + b"x"))[0]


def test_a_lost_carriage_return_does_no_harm_and_a_lost_line_feed_costs_one_line() -> None:
    assert [Measurement(5, 3000)] == fed(GOOD.replace(b"\r", b""))
    assert [Damaged(Damage.TRUNCATED, len(GOOD) - 1), Measurement(5, 3000)] == fed(GOOD.replace(b"\n", b"") + GOOD)


# -- any bytes, any cut -----------------------------------------------------------------------------------------------

pieces = st.lists(st.one_of(st.binary(max_size=90), messages.map(encode), st.sampled_from((b"$", b"\n", b"\r", b"*"))))


@given(pieces, st.lists(st.integers(1, 40)))
def test_how_a_stream_is_cut_makes_no_difference(parts: list[bytes], cuts: list[int]) -> None:
    data = b"".join(parts)
    whole = fed(data)

    decoder = Decoder()
    assert whole == [e for n in range(len(data)) for e in decoder.feed(data[n : n + 1])]

    decoder, at, ragged = Decoder(), 0, []
    for cut in cuts:
        ragged += decoder.feed(data[at : at + cut])
        at += cut
    assert whole == ragged + decoder.feed(data[at:])


@pytest.mark.one_interpreter
@given(st.lists(measurements, min_size=1, max_size=6), st.data())
def test_damage_never_makes_a_measurement(sent: list[Measurement], data: st.DataObject) -> None:
    stream = bytearray(b"".join(map(encode_measurement, sent)))
    for _ in range(data.draw(st.integers(1, 12))):
        at = data.draw(st.integers(0, max(0, len(stream) - 1)))
        match data.draw(st.sampled_from(("flip", "drop", "insert"))):
            case "flip" if stream:
                stream[at] ^= 1 << data.draw(st.integers(0, 7))
            case "drop":
                del stream[at : at + 1]
            case _:
                stream.insert(at, data.draw(st.integers(0, 255)))
    events = fed(bytes(stream) + b"\n" + GOOD)
    accepted = [e for e in events if isinstance(e, Measurement)]
    assert Measurement(5, 3000) == accepted[-1]
    assert all(m in sent for m in accepted[:-1])


@settings(max_examples=examples(20))
@given(measurements)
def test_every_flip_of_one_bit_is_noticed(message: Measurement) -> None:
    line = encode_measurement(message)
    for bit in range(8 * (len(line) - 2)):
        hit = bytearray(line)
        hit[bit // 8] ^= 1 << bit % 8
        assert not [e for e in fed(bytes(hit) + GOOD)[:-1] if isinstance(e, Measurement)], bit


def test_every_flip_of_two_bits_in_a_line_is_noticed() -> None:
    line = encode_measurement(Measurement(9, 3011))
    accepted = set()
    for a, b in combinations(range(8 * (len(line) - 2)), 2):
        hit = bytearray(line)
        hit[a // 8] ^= 1 << a % 8
        hit[b // 8] ^= 1 << b % 8
        accepted |= {e for e in fed(bytes(hit)) if isinstance(e, Measurement)}
    assert set() == accepted


@pytest.mark.one_interpreter
def test_twenty_thousand_lines_with_random_damage() -> None:
    chance = random.Random(4)
    decoder = Decoder()
    right = wrong = 0
    for n in range(20_000):
        message = Measurement(n & 0xFFFF, chance.randrange(120, 46_000))
        line = bytearray(encode_measurement(message))
        for _ in range(chance.choice((0, 1, 2, 5, 20))):
            at = chance.randrange(len(line))
            line[at : at + 1] = chance.choice((b"", bytes((chance.randrange(256),)), b"%c%c" % (line[at], 48)))
            line = line or bytearray(b"$")
        for event in decoder.feed(bytes(line)):
            if isinstance(event, Measurement):
                right += event == message
                wrong += event != message
    assert wrong == 0
    assert 4_000 < right < 6_000  # a fifth was left whole; a few hits repeat what was there


def test_the_relays_field_and_command_have_one_spelling() -> None:
    on = RelayReport(0xA1B2, RelayOutput.MAY_MOVE, 2)
    line = encode_measurement(Measurement(7, 2912, temperature_dc=215, relay=on))
    assert line == frame(b"HCM,7,2912,2500,0,215,rA1B2A")
    command = RelayCommand(0xA1B2, 7, RelayOutput.MAY_MOVE, 2562, 3262)
    assert encode_command(command) == frame(b"HCR,A1B2,7,2,2562,3262")
    assert commands_in(b"?$HCR" + encode_command(command) + encode_command(RelayCommand()) + b"$HCR,1") == [
        command,
        RelayCommand(),
    ]
    assert commands_in(encode_command(command).replace(b",7,", b",8,")) == []


def test_an_unknown_optional_field_is_ignored_and_a_wrong_one_is_damage() -> None:
    """Each field once, in the alphabet's order."""
    assert fed(frame(b"HCM,7,2912,2500,0,a1,rA1B20,z0F")) == [
        Measurement(7, 2912, relay=RelayReport(0xA1B2, RelayOutput.NONE, 0))
    ]
    assert fed(frame(b"HCM,7,2912,2500,0,215,b5A,rA1B20"))[0] == Measurement(
        7, 2912, temperature_dc=215, relay=RelayReport(0xA1B2, RelayOutput.NONE, 0), beacon=0x5A
    )
    for wrong in (
        b"rA1B2",
        b"rA1B2C",
        b"rA1B200",
        b"rA1B20,a1",
        b"rA1B20,rA1B20",
        b"r",
        b"a1,215",
        b"b1",
        b"bA",
        b"B1",
    ):
        assert [event.kind for event in fed(frame(b"HCM,7,2912,2500,0," + wrong)) if isinstance(event, Damaged)] == [
            Damage.CONTENT
        ]
