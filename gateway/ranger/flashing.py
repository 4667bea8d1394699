"""Writes the gateway's firmware to an Arduino Uno through its boot loader. IO, and blocks.

The port is opened exclusively, as a bay opens it: a port that a running bay has is refused.
"""

from collections.abc import Callable
from pathlib import Path

from gateway.clock import Clock
from gateway.durations import NS_PER_S
from gateway.errors import ConfigError, LinkError, ProtocolError
from gateway.ranger.hcsr04 import stk500
from gateway.ranger.port import Port

PLACES = (
    Path(__file__).with_name("hcsr04") / "ranger.hex",  # of a package
    Path(__file__).parents[2] / "firmware" / "build" / "ranger.hex",  # of a checkout
)
ANSWER_S = 1.0
SYNC_S = 0.3  # for one of these answers
SYNCS = 14  # four seconds: a boot loader listens for one after a reset, and blinks before
TRIES = 3  # of the whole work, where a byte was lost or changed
OPEN_S = 5.0  # a bay that has been told to release the port does so within half a second
CUT_OFF = (
    "the board may have only a part of the firmware now, and gives no distance until it is written again; where that "
    "fails, too, take another USB cable, then another board"
)


def image(places: tuple[Path, ...] = PLACES) -> bytes:
    """The firmware of this gateway. Raises ConfigError where it was built without, ProtocolError for a damaged file."""
    for place in places:
        if place.is_file():
            return stk500.image_of(place.read_text(encoding="ascii", errors="replace"))
    raise ConfigError("this gateway was built without the firmware: see docs/firmware.md#flashing")


def flash(url: str, program: bytes, clock: Clock, progress: Callable[[float], None]) -> None:
    """`progress` gets 0 to 1. Raises LinkError and ProtocolError, whose texts say what the board has on it then."""
    if "://" in url:
        raise ConfigError(f"ranger port {url}: the board must be at this machine's own USB")
    written = False

    def told(done: float) -> None:
        nonlocal written
        written |= done > 0
        progress(done)

    for tries in range(1, TRIES + 1):
        try:
            _write(url, program, clock, told)
        except (LinkError, ProtocolError) as error:
            if tries == TRIES or not isinstance(error, stk500.TransferError):
                raise type(error)(f"{error}; {CUT_OFF if written else 'nothing was written'}") from error
        else:
            return
        clock.block(SYNC_S)  # closed for so long, it is opened anew for the board, too


def _write(url: str, program: bytes, clock: Clock, progress: Callable[[float], None]) -> None:
    port = _opened(url, clock)
    try:
        _synchronized(port, clock)
        talk = stk500.conversation(program)
        ask = next(talk)
        while True:
            progress(ask.done)
            port.write(ask.data)
            ask = talk.send(_answer(port, ask.answer_bytes, ANSWER_S, clock))
    except StopIteration:
        return
    finally:
        port.close()


def _opened(url: str, clock: Clock) -> Port:
    until_ns = clock.now_ns() + round(OPEN_S * NS_PER_S)
    while True:
        try:
            return Port(url, stk500.BAUD)
        except LinkError as error:
            if "another program" not in str(error) or clock.now_ns() > until_ns:
                raise
        clock.block(SYNC_S)


def _synchronized(port: Port, clock: Clock) -> None:
    port.reset(clock)
    for _ in range(SYNCS):
        port.write(stk500.SYNC)
        if stk500.SYNCED in _answer(port, 2, SYNC_S, clock):
            _answer(port, 2 * SYNCS, SYNC_S, clock)  # to those before it
            return
    raise LinkError("no boot loader answers: is it an Arduino Uno, and is its USB cable one for data?")


def _answer(port: Port, size: int, timeout_s: float, clock: Clock) -> bytes:
    """What has come of so many bytes, at the latest after this time."""
    data, until_ns = b"", clock.now_ns() + round(timeout_s * NS_PER_S)
    while len(data) < size and clock.now_ns() < until_ns:
        data += port.read()
    return data
