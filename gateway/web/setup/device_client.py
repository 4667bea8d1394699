"""The web process's side of the process that opens devices (gateway/doctor/device_process.py): questions and looks. IO.

A look at a camera or a board lasts as long as its page asks for news: a page that is closed ends it. One at a time.
"""

import asyncio
import itertools
from collections.abc import AsyncGenerator
from contextlib import aclosing
from dataclasses import dataclass, field
from typing import TypeVar

from gateway.errors import LinkError, ProtocolError
from gateway.web.auth.refusals import RefusalError
from gateway.web.helper_client import DEVICES, HelperClient
from gateway.web.ipc.devices import (
    DEVICE_ANSWERS,
    CameraSeen,
    DeviceAnswer,
    DeviceQuestion,
    Examine,
    Finding,
    FlashRanger,
    FlashSeen,
    LookAtCamera,
    LookAtRanger,
    RangerSeen,
    TriedParts,
    Verdict,
)

EXAMINED_S = 55.0  # the process gives it 60
KEPT_S = 10.0  # an examination
SILENT_S = 20.0  # a look whose device has given nothing for this time has ended
NEWS_S = 5.0  # a page's question waits at most this long for something newer
UNWATCHED_S = NEWS_S + 5.0  # a look that no page asks for ends
BUSY = "another page is looking at a device; close it there, or wait a few seconds"

DeviceLook = LookAtCamera | LookAtRanger | FlashRanger
Answer = TypeVar("Answer", bound=DeviceAnswer)


@dataclass(slots=True)
class DevicePreview:
    """One device that is looked at. `seen`: the newest; `end`: why it has ended; None: it goes on."""

    number: int
    question: DeviceLook
    watched_s: float
    pieces: int = 0
    seen: CameraSeen | RangerSeen | FlashSeen | None = None
    end: Finding | None = None
    changed: asyncio.Event = field(default_factory=asyncio.Event)
    task: asyncio.Task[None] | None = None

    def take(self, piece: DeviceAnswer) -> None:
        match piece:
            case CameraSeen() | RangerSeen() | FlashSeen():
                self.seen = piece
            case TriedParts((line, *_)):
                self.end = line
            case _:
                self.finish("another answer", "look at the gateway's log")
        self.news()

    def finish(self, why: str, remedy: str = "check cable, power and address") -> None:
        self.end = self.end or Finding("device", "", Verdict.FAULT, "look at it", why, remedy)
        self.news()

    def news(self) -> None:
        self.pieces += 1
        self.changed.set()
        self.changed = asyncio.Event()


class DeviceClient:
    """`fd`: of the socket to that process; None: there is none. For one event loop."""

    def __init__(self, fd: int | None) -> None:
        self._helper: HelperClient[DeviceQuestion] = HelperClient(DEVICES, fd)
        self._numbers = itertools.count(1)
        self._look: DevicePreview | None = None
        self._examining = asyncio.Lock()
        self._examined: tuple[float | None, list[Finding], bool] = None, [], False

    def close(self) -> None:
        if self._look is not None and self._look.task is not None:
            self._look.task.cancel()
        self._helper.close()

    async def ask(self, question: DeviceQuestion, kind: type[Answer]) -> Answer:
        """The one answer to a question other than a look. Raises RefusalError."""
        try:
            answer: DeviceAnswer = DEVICE_ANSWERS.unpacked(await self._helper.ask(question))
        except ProtocolError as error:
            raise RefusalError(503, DEVICES.code, str(error)) from None
        if not isinstance(answer, kind):
            raise RefusalError(503, DEVICES.code, "another answer")
        return answer

    async def examined(self) -> tuple[list[Finding], bool]:
        """What the doctor finds beside the running gateway, and whether that is all of it: a part may take too long.
        Who asks again within KEPT_S gets the same. Raises RefusalError."""
        async with self._examining:
            at_s, lines, complete = self._examined
            if at_s is not None and _now_s() - at_s < KEPT_S:
                return lines, complete
            lines, complete = [], False
            try:
                async with asyncio.timeout(EXAMINED_S), aclosing(self._answers(Examine())) as pieces:
                    async for piece in pieces:
                        if not isinstance(piece, TriedParts):
                            raise LinkError("another answer")
                        lines += piece.lines
                complete = bool(lines)
            except TimeoutError:
                pass
            except (LinkError, ProtocolError, OSError) as error:
                raise RefusalError(503, DEVICES.code, str(error)) from None
            self._examined = _now_s(), lines, complete
            return lines, complete

    def begin(self, question: DeviceLook, replaces: int | None) -> DevicePreview:
        """`replaces`: the page's own look before, which ends. Raises RefusalError where another page has one."""
        running = self._look
        if running is not None and running.end is None and running.number != replaces:
            raise RefusalError(409, "busy", BUSY)
        self.end(replaces)
        look = self._look = DevicePreview(next(self._numbers), question, _now_s())
        look.task = asyncio.get_running_loop().create_task(self._follow(look), name=f"look {look.number}")
        return look

    def end(self, number: int | None) -> None:
        """The device is closed; nothing happens where the look is another, or over."""
        if (look := self._look) is not None and look.number == number:
            if look.task is not None:
                look.task.cancel()
            look.finish("it was closed")

    async def news(self, number: int, after: int) -> DevicePreview:
        """The look once it has more than `after` pieces, or has ended; waits some seconds. Raises RefusalError."""
        look = self._look
        if look is None or look.number != number:
            raise RefusalError(404, "gone", "this look has ended: look again")
        look.watched_s = _now_s()
        try:
            async with asyncio.timeout(NEWS_S):
                while look.pieces <= after and look.end is None:
                    await look.changed.wait()
        except TimeoutError:
            pass
        look.watched_s = _now_s()
        return look

    async def _follow(self, look: DevicePreview) -> None:
        """Until the device, its process or the page has ended."""
        why = "the process that looked has ended; see the gateway's log"
        try:
            async with aclosing(self._answers(look.question)) as pieces:
                while look.end is None:
                    async with asyncio.timeout(SILENT_S):
                        piece = await anext(pieces, None)
                    if piece is None:
                        break
                    if _now_s() - look.watched_s > UNWATCHED_S:
                        why = "no page was watching"
                        break
                    look.take(piece)
        except TimeoutError:
            why = DEVICES.late
        except RefusalError as refusal:
            look.finish(str(refusal), "look at the gateway's log")
        except (LinkError, ProtocolError, OSError) as error:
            why = str(error)
        finally:
            look.finish(why)

    async def _answers(self, question: DeviceQuestion) -> AsyncGenerator[DeviceAnswer]:
        async with aclosing(self._helper.pieces(question)) as pieces:
            async for piece in pieces:
                yield DEVICE_ANSWERS.unpacked(piece)


def _now_s() -> float:
    return asyncio.get_running_loop().time()
