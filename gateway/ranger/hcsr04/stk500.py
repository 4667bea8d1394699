"""How an Arduino Uno's boot loader is given a program: STK500 version 1 as Optiboot speaks it. Sans-IO.

A conversation yields what is to be sent and is sent the answer; it ends when the board runs what was written. The boot
loader is never written over, so a conversation that was cut off can be repeated.
"""

from collections.abc import Generator
from dataclasses import dataclass

from gateway.errors import ProtocolError

BAUD = 115_200
PAGE_BYTES = 128  # of the ATmega328P's flash
ROOM_BYTES = 0x7E00  # below Optiboot
SIGNATURE = bytes.fromhex("1e950f")  # ATmega328P

_IN_SYNC, _OK, _END = b"\x14", b"\x10", b"\x20"
SYNC = b"\x30" + _END
SYNCED = _IN_SYNC + _OK
_ENTER, _LEAVE, _ADDRESS, _WRITE, _READ, _SIGN = b"\x50", b"\x51", b"\x55", b"\x64", b"\x74", b"\x75"


@dataclass(frozen=True, slots=True)
class Ask:
    """`data`: for the board. `answer_bytes`: how many come back. `done`: of the whole work, 0 to 1."""

    data: bytes
    answer_bytes: int
    done: float


Conversation = Generator[Ask, bytes, None]


class TransferError(ProtocolError):
    """A byte was lost or changed on the way: what was to be written can be written again."""


def conversation(image: bytes) -> Conversation:
    """After `SYNC`. Writes nothing to another chip; reads all back. Raises TransferError and ProtocolError."""
    signature = yield from _asked(_SIGN, 3, 0.0)
    if signature != SIGNATURE:
        raise ProtocolError(f"another chip, signature {signature.hex(' ').upper()}: not an Arduino Uno")
    yield from _asked(_ENTER, 0, 0.0)
    pages = [(at, image[at : at + PAGE_BYTES].ljust(PAGE_BYTES, b"\xff")) for at in range(0, len(image), PAGE_BYTES)]
    size = PAGE_BYTES.to_bytes(2, "big") + b"F"
    for n, (at, page) in enumerate(pages):
        yield from _asked(_ADDRESS + (at // 2).to_bytes(2, "little"), 0, (n + 1) / len(pages) / 2)
        yield from _asked(_WRITE + size + page, 0, (n + 1) / len(pages) / 2)
    for n, (at, page) in enumerate(pages):
        yield from _asked(_ADDRESS + (at // 2).to_bytes(2, "little"), 0, 0.5 + (n + 1) / len(pages) / 2)
        if (yield from _asked(_READ + size, PAGE_BYTES, 0.5 + (n + 1) / len(pages) / 2)) != page:
            raise TransferError(f"byte {at} and following read otherwise than written")
    answer = yield Ask(_LEAVE + _END, 2, 1.0)
    _check(answer, answer[:2] == SYNCED)  # what follows is the program's, at another baud rate


def _asked(command: bytes, size: int, done: float) -> Generator[Ask, bytes, bytes]:
    answer = yield Ask(command + _END, size + 2, done)
    _check(answer, len(answer) == size + 2 and answer[:1] == _IN_SYNC and answer[-1:] == _OK)
    return answer[1:-1]


def _check(answer: bytes, good: bool) -> None:
    if not good:
        raise TransferError(f"the boot loader's answer is damaged ({answer[:8].hex(' ') or 'nothing'})")


def image_of(intel_hex: str) -> bytes:
    """The program of an Intel HEX file, from address 0 on; gaps are erased flash. Raises ProtocolError."""
    image = bytearray()
    for line in intel_hex.split():
        try:
            record = bytes.fromhex(line.removeprefix(":"))
        except ValueError:
            record = b""
        if not line.startswith(":") or len(record) < 5 or len(record) != record[0] + 5 or sum(record) % 256:
            raise ProtocolError("the firmware's file is damaged")
        at, kind, data = int.from_bytes(record[1:3]), record[3], record[4:-1]
        if kind == 1 and image:
            return bytes(image)
        if kind == 0:
            if at + len(data) > ROOM_BYTES:
                raise ProtocolError("the firmware's file has no room below the boot loader")
            image.extend(b"\xff" * (at + len(data) - len(image)))
            image[at : at + len(data)] = data
    raise ProtocolError("the firmware's file has no end")
