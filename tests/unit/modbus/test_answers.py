"""Every answer against the specification's table (tests/modbus_oracle.py), over the whole grid."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import product

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gateway.modbus.protocol.adu import ModbusException, frame_bytes
from gateway.modbus.protocol.answers import FUNCTIONS, Access, Peer, Unit, answer
from gateway.modbus.protocol.request_handler import RequestHandler, RequestStats
from gateway.modbus.registers.bits import coil_of
from tests import modbus_oracle as oracle
from tests.examples import examples
from tests.modbus_fuzzing import writing

ANYBODY = Peer("10.0.0.9")
WORDS = [(1000 + 257 * n) & 0xFFFF for n in range(123)]
WRITABLE = frozenset(range(80, 90))
OBJECTS = {0: b"vendor", 1: b"code", 2: b"1.0", 4: b"product", 6: b"site/bay"}


class Pair:
    """One bay twice: as the gateway's unit and as the oracle's."""

    def __init__(self, writes_on: bool = False, objects: dict[int, bytes] | None = None) -> None:
        self.words = list(WORDS)
        answered = OBJECTS if objects is None else objects
        self.unit = Unit(lambda: self.words, writing(self.words, WRITABLE) if writes_on else None, answered)
        self.bay = oracle.Bay(list(WORDS), WRITABLE, writes_on, answered)
        self.server = oracle.Server({1: self.bay, 2: self.bay})

    def check(self, pdu: bytes) -> bytes:
        answered = answer(self.unit, pdu, ANYBODY)
        assert answered == oracle.answer(self.server, 1, pdu), pdu.hex(" ")
        assert self.words == self.bay.words, pdu.hex(" ")
        return answered


def pdu(function: int, *numbers: int) -> bytes:
    return bytes([function]) + b"".join(number.to_bytes(2, "big") for number in numbers)


CONTROL = coil_of("plc_control", 0)  # the first coil that can be written
ADDRESSES = [*range(112), 126, 127, 128, 255, 256, 32767, 32768, 65409, 65410, 65411, 65434, 65435, 65436, 65535]
COUNTS = [*range(131), 255, 256, 257, 1999, 2000, 2001, 2002, 32767, 32768, 65535]


@pytest.mark.parametrize("function", [1, 2, 3, 4])
def test_reads_over_every_address_and_count(function: int) -> None:
    pair = Pair()
    exceptions = {pair.check(pdu(function, *asked))[:2].hex() for asked in product(ADDRESSES, COUNTS)}
    codes = {text for text in exceptions if text.startswith("8")}
    assert codes == {f"8{function}02", f"8{function}03"}  # the grid has both, and good answers besides
    assert len(exceptions) > len(codes)


@pytest.mark.parametrize("writes_on", [False, True])
def test_every_function_code_with_every_length(writes_on: bool) -> None:
    tail = pdu(0, 80, 1, 80, 1)[1:] + bytes([2, 0x12, 0x34]) + bytes(range(40))
    for function in range(256):
        pair = Pair(writes_on)
        for length in range(len(tail)):
            pair.check(bytes([function]) + tail[:length])


def _writes() -> Iterator[bytes]:
    for address in [0, 3, 78, 79, 80, 81, 84, 88, 89, 90, 99, 100, 122, 123, 124, 65535]:
        for word in (0, 1, 0x1234, 0xFFFF):
            yield pdu(6, address, word)
        for count in [0, 1, 2, 5, 9, 10, 11, 120, 121, 122, 123, 124, 65535]:
            for size in {2 * count & 0xFF, (2 * count + 1) & 0xFF, (2 * count + 2) & 0xFF, 0}:
                body = bytes(n & 0xFF for n in range(size))
                yield pdu(16, address, count) + bytes([size]) + body
                yield pdu(16, address, count) + bytes([size]) + body[:-1]
                for read, read_count in [(0, 1), (79, 12), (0, 123), (0, 124), (122, 2), (0, 125), (0, 126), (0, 0)]:
                    yield pdu(23, read, read_count, address, count) + bytes([size]) + body

    bits = oracle.Bay([]).bits
    for address in [0, 3, *range(CONTROL - 3, bits + 3), 255, 65535]:
        for value in (0, 1, 0xFF00, 0xFF01, 0xFFFF):
            yield pdu(5, address, value)
        for count in [*range(20), bits, bits + 1, 1968, 1969, 65535]:
            for size in {(count + 7) // 8 & 0xFF, (count + 8) // 8 & 0xFF, 0}:
                yield pdu(15, address, count) + bytes([size]) + bytes((29 * n + 0xA5) & 0xFF for n in range(size))
    for address in range(78, 102):
        for masks in product((0, 0xFFFF, 0x00F2, 0x1234), repeat=2):
            yield pdu(22, address, *masks)


def test_writes_over_the_grid() -> None:
    pair = Pair(writes_on=True)
    answers = [pair.check(request) for request in _writes() if len(request) <= 253]
    refused = {answered[:2].hex() for answered in answers if answered[0] & 0x80}
    assert refused == {"8502", "8503", "8602", "8f02", "8f03", "9002", "9003", "9602", "9702", "9703"}
    assert len([answered for answered in answers if answered[0] in (5, 6, 15, 16, 22, 23)]) >= 300
    assert pair.words != WORDS  # something was written


def test_where_writes_are_off_their_functions_do_not_exist() -> None:
    pair = Pair()
    assert {pair.check(request)[1] for request in _writes() if len(request) <= 253} == {1}
    assert pair.words == WORDS


def test_a_coil_is_the_bit_of_its_register() -> None:
    pair = Pair(writes_on=True)
    for bit in range(16):
        pair.check(pdu(6, 81, 0))
        pair.check(pdu(5, CONTROL + bit, 0xFF00))
        assert pair.words[81] == 1 << bit
        assert pair.check(pdu(1, CONTROL + bit, 1))[-1] == 1
        pair.check(pdu(6, 81, 0xFFFF))
        pair.check(pdu(5, CONTROL + bit, 0))
        assert pair.words[81] == 0xFFFF & ~(1 << bit)
    pair.check(pdu(15, CONTROL + 3, 10) + b"\x02\x55\xfd")
    assert pair.words[81] == 0x7FFF & ~(0b1010101010 << 3)


def test_coils_of_two_registers_are_not_written_and_reported() -> None:
    answered: list[str] = []
    pair = Pair(writes_on=True)
    unit = replace(pair.unit, refused=lambda _, why: answered.append(why))
    assert answer(unit, pdu(15, CONTROL - 1, 2) + b"\x01\x03", ANYBODY) == b"\x8f\x02"
    assert answered == [f"coils {CONTROL - 1} to {CONTROL} are not of one register"]
    assert pair.words == WORDS


def test_the_mask_write_of_the_specification() -> None:
    """Its example (6.16): 12 with and mask F2 and or mask 25 becomes 17."""
    pair = Pair(writes_on=True)
    pair.check(pdu(6, 81, 0x12))
    assert pair.check(pdu(22, 81, 0xF2, 0x25)) == pdu(22, 81, 0xF2, 0x25)
    assert pair.words[81] == 0x17


@pytest.mark.parametrize(("status", "running"), [(0, 0xFF), (1, 0xFF), (1 << 12, 0), (1 << 13, 0), (0xFFFF, 0)])
def test_report_server_id(status: int, running: int) -> None:
    pair = Pair()
    pair.words[3] = pair.bay.words[3] = status
    assert pair.check(b"\x11") == bytes([17, 19, 1, running]) + b"code 1.0 site/bay"


def test_report_server_id_fits_whatever_the_names_are() -> None:
    answered = Pair(objects=LONG | {2: b"v" * 244}).check(b"\x11")
    assert (len(answered), answered[1]) == (253, 251)


def test_function_23_reads_what_it_wrote() -> None:
    assert Pair(writes_on=True).check(pdu(23, 80, 2, 81, 1) + bytes([2, 0xAB, 0xCD]))[-2:] == b"\xab\xcd"


def test_function_23_writes_nothing_where_it_can_not_read() -> None:
    pair = Pair(writes_on=True)
    assert pair.check(pdu(23, 122, 2, 81, 1) + bytes([2, 0xAB, 0xCD])) == b"\x97\x02"
    assert pair.words == WORDS


def test_where_the_number_of_registers_is_known_function_23_reads_one_image_after_its_write() -> None:
    done: list[str] = []

    def read() -> list[int]:
        done.append("read")
        return WORDS

    def write(address: int, words: Sequence[int], peer: Peer, mask: int = 0xFFFF) -> ModbusException | None:
        done.append("write")
        return None

    unit = Unit(read, write, words=len(WORDS))
    assert answer(unit, pdu(23, 98, 2, 80, 1) + b"\x02\x00\x01", ANYBODY)[:2] == b"\x17\x04"
    assert done == ["write", "read"]
    assert answer(unit, pdu(23, 122, 2, 80, 1) + b"\x02\x00\x01", ANYBODY) == b"\x97\x02"
    assert answer(unit, pdu(23, 0, 2, 122, 2) + b"\x04\x00\x01\x00\x01", ANYBODY) == b"\x97\x02"
    assert answer(unit, pdu(6, 123, 1), ANYBODY) == b"\x86\x02"
    assert done == ["write", "read"]


def test_the_exception_is_that_of_the_write() -> None:
    unit = Unit(lambda: WORDS, lambda address, words, peer, mask=0: ModbusException.ILLEGAL_VALUE)
    assert answer(unit, pdu(6, 80, 7), ANYBODY) == b"\x86\x03"


REQUESTS = {
    5: pdu(5, CONTROL, 0xFF00),
    6: pdu(6, 80, 1),
    15: pdu(15, CONTROL, 3) + b"\x01\x05",
    16: pdu(16, 80, 1) + b"\x02\x00\x01",
    17: b"\x11",
    22: pdu(22, 81, 0xFFF0, 0x0005),
    23: pdu(23, 0, 1, 80, 1) + b"\x02\x00\x01",
    43: b"\x2b\x0e\x01\x00",
}


@pytest.mark.parametrize(("access", "read", "write"), [(Access.NONE, 1, 1), (Access.READ, 0, 1), (Access.WRITE, 0, 0)])
def test_a_role_decides_what_exists(access: Access, read: int, write: int) -> None:
    """Modbus/TCP Security: what a role may not do is answered with exception 01. 0 here: it may."""
    pair = Pair(writes_on=True)
    for function in FUNCTIONS.values():
        request = REQUESTS.get(function.code, pdu(function.code, 0, 1))
        answered = answer(pair.unit, request, Peer("10.0.0.9", access, "some role"))
        refused = write if function.writes else read
        assert (answered == bytes([function.code | 0x80, 1])) == bool(refused), function.name


LONG = {0: b"v" * 100, 1: b"c" * 100, 2: b"1" * 40, 4: b"p" * 244, 5: b"m", 0x80: b"x" * 200, 0xFF: b"y" * 44}


@pytest.mark.parametrize("objects", [OBJECTS, LONG, {0: b"", 1: b"", 2: b""}, {0: b"a", 1: b"b", 2: b"c", 0x90: b"d"}])
def test_identity_over_every_code_and_object(objects: dict[int, bytes]) -> None:
    pair = Pair(objects=objects)
    for code, first in product([0, 1, 2, 3, 4, 5, 255], range(256)):
        assert len(pair.check(bytes([43, 14, code, first]))) <= 253
    for mei_type in range(256):
        pair.check(bytes([43, mei_type, 1, 0]))


def test_identity_in_parts_has_every_object_once() -> None:
    """Following "more follows" as a client does."""
    unit = Unit(lambda: WORDS, identity=LONG)
    found: dict[int, bytes] = {}
    first, parts = 0, 0
    while True:
        answered = answer(unit, bytes([43, 14, 3, first]), ANYBODY)
        at = 7
        for _ in range(answered[6]):
            found[answered[at]] = answered[at + 2 : at + 2 + answered[at + 1]]
            at += 2 + answered[at + 1]
        assert at == len(answered)
        parts += 1
        if answered[4] == 0:
            break
        first = answered[5]
    assert found == LONG
    assert parts == 4


@pytest.mark.long
@pytest.mark.one_interpreter
@settings(max_examples=examples(1500), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.binary(min_size=1, max_size=253), st.booleans())
def test_any_bytes_at_all(request: bytes, writes_on: bool) -> None:
    Pair(writes_on).check(request)


@pytest.mark.parametrize("units", [(1,), (1, 2), (5, 247), ()])
def test_units(units: tuple[int, ...]) -> None:
    """Every unit id; 0 and 255 are the device itself where it has one bay."""
    images = {unit: [unit * 100 + n for n in range(100)] for unit in units}
    stats = RequestStats()
    failed: list[Exception] = []
    handler = RequestHandler({unit: Unit(partial(images.__getitem__, unit)) for unit in units}, stats, failed.append)
    server = oracle.Server({unit: oracle.Bay(words) for unit, words in images.items()})
    exceptions = 0
    for unit in range(256):
        for request in (pdu(3, 98, 2), pdu(4, 0, 1), pdu(3, 0, 0), pdu(3, 99, 2), pdu(8, 0, 0), b"\x03", pdu(6, 80, 1)):
            answered = handler.answer(frame_bytes(0xA55A, unit, request), ANYBODY)
            expected = oracle.answer(server, unit, request)
            assert answered == frame_bytes(0xA55A, unit, expected)
            exceptions += expected[0] >= 0x80
    assert failed == []
    assert (stats.requests, stats.exceptions, stats.image_faults) == (256 * 7, exceptions, 0)


def test_what_is_written_under_unit_id_0_is_refused_and_reported() -> None:
    told: list[str] = []
    unit = replace(Pair(writes_on=True).unit, refused=lambda _, why: told.append(why))
    handler = RequestHandler({1: unit}, RequestStats(), lambda error: None)
    assert handler.answer(frame_bytes(1, 0, pdu(6, 81, 1)), ANYBODY) == frame_bytes(1, 0, b"\x86\x0b")
    assert told == ["write single register: nothing is written under unit id 0"]
