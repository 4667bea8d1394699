"""Kept answers are never old."""

from collections.abc import Sequence

import pytest

from gateway.modbus.protocol.adu import ModbusException, frame_bytes
from gateway.modbus.protocol.answers import Access, Peer, Unit
from gateway.modbus.protocol.request_handler import MAX_KEPT, RequestHandler, RequestStats

PEER = Peer("10.0.0.9")


def read(address: int, count: int, *, transaction: int = 1, function: int = 3) -> bytes:
    return frame_bytes(transaction, 1, bytes([function, 0, address, 0, count]))


class Bench:
    def __init__(self, image: object) -> None:
        self.image = image
        self.asked = 0
        self.faults: list[Exception] = []
        self.stats = RequestStats()
        self.handler = RequestHandler({1: Unit(self._read, self._write)}, self.stats, self.faults.append)

    def _read(self) -> Sequence[int]:
        self.asked += 1
        if isinstance(self.image, Exception):
            raise self.image
        return self.image  # type: ignore[return-value]  # some tests hand in what is no image

    def _write(self, address: int, words: Sequence[int], peer: Peer, mask: int = 0xFFFF) -> ModbusException | None:
        assert isinstance(self.image, tuple)
        self.image = (*self.image[:address], *words, *self.image[address + len(words) :])
        return None

    def ask(self, frame: bytes) -> bytes:
        return self.handler.answer(frame, PEER)


def test_the_image_is_asked_for_once_at_every_request() -> None:
    bench = Bench((1, 2, 3))
    for n in range(5):
        assert bench.ask(read(0, 2, transaction=n)) == frame_bytes(n, 1, b"\x03\x04\x00\x01\x00\x02")
        assert bench.asked == n + 1


def test_a_new_image_shows_at_once_whatever_was_kept() -> None:
    bench = Bench((1, 2, 3))
    for image in [(1, 2, 3), (4, 5, 6), (1, 2, 3), (7, 7, 7), (7, 7)]:
        bench.image = image
        for _ in range(3):
            assert bench.ask(read(0, 2)) == frame_bytes(1, 1, bytes([3, 4, 0, image[0], 0, image[1]]))
    assert bench.ask(read(0, 3)) == frame_bytes(1, 1, b"\x83\x02")  # it was kept for the longer images


def test_an_image_that_can_change_in_place_is_never_kept() -> None:
    words = [1, 2, 3]
    bench = Bench(words)
    assert bench.ask(read(0, 1))[-1] == 1
    words[0] = 9
    assert bench.ask(read(0, 1))[-1] == 9


def test_a_write_shows_in_the_next_read() -> None:
    bench = Bench((1, 2, 3))
    assert bench.ask(read(1, 1))[-1] == 2
    assert bench.ask(frame_bytes(2, 1, b"\x06\x00\x01\x00\x63")) == frame_bytes(2, 1, b"\x06\x00\x01\x00\x63")
    assert bench.ask(read(1, 1))[-1] == 0x63


def test_a_scanner_does_not_make_the_kept_answers_grow() -> None:
    bench = Bench(tuple(range(100)))
    for count in range(1, 101):
        for address in range(101 - count):
            for function in (3, 4):
                answer = bench.ask(read(address, count, function=function))
                assert answer[9:11] == address.to_bytes(2, "big")
    assert len(bench.handler._units[1].answers) == MAX_KEPT


@pytest.mark.parametrize(
    "image", [ZeroDivisionError("of the bay"), None, ("x", 1, 1, 1), (-1, 0, 0, 0), (1 << 16, 0, 0, 0)]
)
def test_what_is_no_image_is_exception_04_until_there_is_one_again(image: object) -> None:
    bench = Bench((5, 6, 7, 8))
    assert bench.ask(read(0, 1))[-1] == 5
    bench.image = image
    for n in range(3):
        assert bench.ask(read(0, 1)) == frame_bytes(1, 1, b"\x83\x04")
        assert bench.stats.image_faults == bench.stats.exceptions == len(bench.faults) == n + 1
    bench.image = (5, 6, 7, 8)
    assert bench.ask(read(0, 1))[-1] == 5


def test_exceptions_are_counted_every_time() -> None:
    bench = Bench((1, 2))
    for n in range(4):
        assert bench.ask(read(1, 2))[7:] == b"\x83\x02"
        assert (bench.stats.requests, bench.stats.exceptions) == (n + 1, n + 1)


def test_a_kept_answer_is_not_sent_to_a_peer_that_may_not_read() -> None:
    bench = Bench((1, 2))
    assert bench.ask(read(0, 1))[-1] == 1
    assert bench.handler.answer(read(0, 1), Peer("10.0.0.9", Access.NONE))[7:] == b"\x83\x01"
