"""A program through a boot loader, without a port: what is sent, and what is refused."""

import pytest

from gateway.clock import Clock
from gateway.errors import LinkError, ProtocolError
from gateway.ranger import flashing
from gateway.ranger.hcsr04 import stk500
from tests.virtual_time import BlockingClock

IMAGE = bytes(range(200))


class BootLoader:
    """As Optiboot answers. `signature`: of the chip; `weak`: an address whose bit does not stay."""

    def __init__(self, signature: bytes = stk500.SIGNATURE, weak: int | None = None) -> None:
        self.flash = bytearray(b"\xee" * 0x8000)
        self.signature, self.weak, self.at, self.commands = signature, weak, 0, ""

    def answer(self, sent: bytes) -> bytes:
        assert sent[-1:] == b" "
        command, body = sent[:1].decode(), sent[1:-1]
        self.commands += command
        data = b""
        match command:
            case "u":
                data = self.signature
            case "U":
                self.at = 2 * int.from_bytes(body, "little")
            case "d":
                assert body[:3] == b"\x00\x80F"
                self.flash[self.at : self.at + 128] = body[3:]
                if self.weak is not None:
                    self.flash[self.weak] ^= 1
            case "t":
                data = bytes(self.flash[self.at : self.at + 128])
        return b"\x14" + data + b"\x10"


def talk(board: BootLoader, image: bytes = IMAGE) -> list[float]:
    done, conversation = [], stk500.conversation(image)
    ask = next(conversation)
    try:
        while True:
            done.append(ask.done)
            answer = board.answer(ask.data)
            assert len(answer) == ask.answer_bytes
            ask = conversation.send(answer)
    except StopIteration:
        return done


def test_a_program_is_written_by_pages_and_read_back() -> None:
    board = BootLoader()
    done = talk(board)
    assert board.flash[:256] == IMAGE + b"\xff" * 56
    assert board.flash[256:] == b"\xee" * (0x8000 - 256)
    assert board.commands == "uP" + "Ud" * 2 + "Ut" * 2 + "Q"
    assert done == [0, 0, 0.25, 0.25, 0.5, 0.5, 0.75, 0.75, 1, 1, 1]


def test_nothing_is_written_to_another_chip() -> None:
    board = BootLoader(bytes.fromhex("1e9801"))
    with pytest.raises(ProtocolError, match="signature 1E 98 01: not an Arduino Uno"):
        talk(board)
    assert board.commands == "u"


def test_a_cell_that_does_not_hold_is_noticed() -> None:
    with pytest.raises(ProtocolError, match="byte 128 and following read otherwise than written"):
        talk(BootLoader(weak=130))


@pytest.mark.parametrize("answer", [b"", b"\x14", b"\x15\x1e\x95\x0f\x10", b"\x14\x1e\x95\x0f\x11"])
def test_a_damaged_answer_ends_it(answer: bytes) -> None:
    conversation = stk500.conversation(IMAGE)
    next(conversation)
    with pytest.raises(ProtocolError, match="answer is damaged"):
        conversation.send(answer)


def test_intel_hex_with_a_gap() -> None:
    assert stk500.image_of(":020000000102FB\n:01000400AA51\n:00000001FF\n") == b"\x01\x02\xff\xff\xaa"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "no end"),
        (":00000001FF\n", "no end"),
        (":020000000102FB\n", "no end"),
        (":020000000102FC\n:00000001FF\n", "damaged"),
        ("020000000102FB\n", "damaged"),
        (":02000000\n", "damaged"),
        (":zz\n", "damaged"),
        (":017E00000081\n:00000001FF\n", "no room"),
    ],
)
def test_a_wrong_file_is_refused(text: str, why: str) -> None:
    with pytest.raises(ProtocolError, match=why):
        stk500.image_of(text)


class BoardPort:
    """A port of a board with a boot loader. Answers whose numbers are in `lost` do not come; behind the last one the
    program talks, at another baud rate."""

    def __init__(self, lost: set[int]) -> None:
        self.board, self.lost, self.answers, self.opened, self.waiting = BootLoader(), lost, 0, 0, b""

    def __call__(self, _url: str, _baud: int) -> "BoardPort":
        self.opened += 1
        return self

    def reset(self, _clock: Clock) -> None: ...

    def close(self) -> None: ...

    def write(self, data: bytes) -> None:
        self.answers += 1
        self.waiting = b"" if self.answers in self.lost else self.board.answer(data) + bytes(6 * (data == b"Q "))

    def read(self) -> bytes:
        data, self.waiting = self.waiting, b""
        return data


class ReadingClock(BlockingClock):
    """Each look at it takes 50 ms, as a read of nothing does."""

    def now_ns(self) -> int:
        self.block(0.05)
        return super().now_ns()


@pytest.mark.parametrize(("lost", "opened"), [(set(), 1), ({9}, 2), ({9, 20}, 3)])
def test_a_lost_byte_is_followed_by_another_try(lost: set[int], opened: int, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[float] = []
    port = BoardPort(lost)
    monkeypatch.setattr(flashing, "Port", port)
    flashing.flash("/dev/board", IMAGE, ReadingClock(0), done.append)
    assert (port.opened, done[-1]) == (opened, 1)
    assert port.board.flash[:256] == IMAGE + b"\xff" * 56


HALF_WRITTEN = "may have only a part of the firmware now, .* until it is written again; .* another USB cable"


@pytest.mark.parametrize(
    ("lost", "why"),
    [
        (range(5, 1000, 5), rf"answer is damaged .*; the board {HALF_WRITTEN}"),  # in each page
        (range(6, 1000), rf"no boot loader answers: .*; the board {HALF_WRITTEN}"),  # the cable came off
        (range(2, 1000, 2), r"answer is damaged \(nothing\); nothing was written"),  # before the first page
    ],
)
def test_after_the_last_try_it_says_what_the_board_has(lost: range, why: str, monkeypatch: pytest.MonkeyPatch) -> None:
    port = BoardPort(set(lost))
    monkeypatch.setattr(flashing, "Port", port)
    with pytest.raises((LinkError, ProtocolError), match=why):
        flashing.flash("/dev/board", IMAGE, ReadingClock(0), lambda _: None)
    assert port.opened <= flashing.TRIES


def test_another_chip_after_a_part_was_written_is_not_said_to_be_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    """A damaged signature looks like another chip."""
    port = BoardPort({6})
    monkeypatch.setattr(flashing, "Port", port)

    def damaged(_: float) -> None:
        port.board.signature = bytes.fromhex("1e9801") if port.answers >= 6 else stk500.SIGNATURE

    with pytest.raises(ProtocolError, match=f"another chip, signature 1E 98 01.*; the board {HALF_WRITTEN}"):
        flashing.flash("/dev/board", IMAGE, ReadingClock(0), damaged)
    assert port.opened == 2
