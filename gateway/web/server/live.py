"""What moves on the pages: one JSON text after another over a WebSocket, each sent when the page is ready for it. IO.

The page answers every text when it has drawn it, and only then gets the next, which is the newest there is. So a page
that stalls has no backlog: what it missed is not sent at all.
"""

import asyncio
import contextlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from starlette.websockets import WebSocket, WebSocketDisconnect

from gateway.web.server.gateway_client import GatewayClient

WAIT_S = 2.0  # nothing new for this time: the same is sent again, with the ages of now
SHARED_NS = 10_000_000  # older than this, a text is made anew for the next page: the ages in it are those of its making
ANSWER_S = 30.0  # a page that has not answered for this time is disconnected
TOO_MANY, UNKNOWN_BAY, BAD_ANSWER = 4429, 4404, 4400  # close codes of our own
HELD_NONE = '{"held_ms":0.0,'  # as every text begins: what is put there is of one page
MAX_ANSWER = 64  # characters: "next", or any other text as short

Render = Callable[[GatewayClient, tuple[str, ...]], str]


@dataclass(slots=True)
class ViewerCounts:
    """Since the web process began."""

    open: int = 0
    opened: int = 0
    sent: int = 0
    refused: int = 0
    dropped: int = 0


@dataclass(slots=True)
class Live:
    """One kind of view, for any number of pages: what they share is rendered once."""

    client: GatewayClient
    render: Render
    limit: int
    limit_per_address: int  # for one address
    urgent: bool = True
    counts: ViewerCounts = field(default_factory=ViewerCounts)
    _open: Counter[str] = field(default_factory=Counter)  # by address
    _made: dict[tuple[str, ...], tuple[int, int, str]] = field(default_factory=dict)

    async def serve(self, page: WebSocket) -> None:
        """Serve one page until it disconnects. `?bay=` (several; none: all) selects the bays."""
        with contextlib.suppress(WebSocketDisconnect, OSError):  # at any moment, also while it is being closed
            await self._accept(page)

    async def _accept(self, page: WebSocket) -> None:
        requested = tuple(dict.fromkeys(page.query_params.getlist("bay")))
        await page.accept()
        if any(bay not in self.client.bays for bay in requested):
            await page.close(UNKNOWN_BAY, "no such bay")
            return
        address = page.client.host if page.client is not None else ""
        if (why := self._full(address)) is not None:
            self.counts.refused += 1
            await page.close(TOO_MANY, f"too many pages are open: {why}")
            return
        self.counts.open += 1
        self.counts.opened += 1
        self._open[address] += 1
        bays = requested or self.client.bays
        try:
            with self.client.watching(*bays, urgent=self.urgent and len(bays) == 1):
                await self._serve(page, bays)
        except TimeoutError:
            self.counts.dropped += 1
            await page.close(BAD_ANSWER, "no answer")
        finally:
            self.counts.open -= 1
            self._open[address] -= 1
            if not self._open[address]:
                del self._open[address]

    def _full(self, address: str) -> str | None:
        """The key of the limit that is reached; None: one more is allowed from there."""
        if self.counts.open >= self.limit:
            return "hmi.max_viewers"
        return "hmi.viewers_per_address" if self._open[address] >= self.limit_per_address else None

    async def _serve(self, page: WebSocket, bays: tuple[str, ...]) -> None:
        number = 0
        while True:
            asked_ns = self.client.clock.now_ns()
            number = await self.client.next(number, WAIT_S)
            text = self._rendered(bays).removeprefix(HELD_NONE)
            await page.send_text(f'{{"held_ms":{self.client.age_ms(asked_ns)},{text}')
            self.counts.sent += 1
            async with asyncio.timeout(ANSWER_S):
                message = await page.receive()
            if message["type"] == "websocket.disconnect":
                raise WebSocketDisconnect(message.get("code", 1005))
            answer = message.get("text")
            if answer is None or len(answer) > MAX_ANSWER:  # a client may send anything, binary frames too
                await page.close(BAD_ANSWER, "not an answer")
                return

    def _rendered(self, bays: tuple[str, ...]) -> str:
        number, made_ns, text = self._made.get(bays, (-1, 0, ""))
        now_ns = self.client.clock.now_ns()
        if number != self.client.answers or now_ns - made_ns > SHARED_NS:
            if len(self._made) > 2 * len(self.client.bays) + 16:  # a client may request any combination
                self._made.clear()
            text = self.render(self.client, bays)
            self._made[bays] = (self.client.answers, now_ns, text)
        return text
