"""Live views: the next one goes out when the page has taken the last; a stalled page has no backlog."""

import asyncio
import json
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Any

import pytest
from starlette.websockets import WebSocket

from gateway.web.server import views
from gateway.web.server.live import ANSWER_S, BAD_ANSWER, TOO_MANY, UNKNOWN_BAY, Live, Render
from tests.unit.web.gateway_client import plant
from tests.virtual_time import in_virtual_time


class Page:
    """A page at the other end: it answers each text after `think_s`, or never."""

    def __init__(
        self,
        query: str = "",
        think_s: float | None = 0.0,
        words: Sequence[str | bytes] = (),
        address: str = "10.0.1.7",
    ) -> None:
        self.sent: list[dict[str, Any]] = []
        self.closed: int | None = None
        self.at_s: list[float] = []
        self._think_s = think_s
        self._words = list(words)
        self.gone_at: tuple[str, ...] = ()  # types of messages which it does not take any more
        self._inbox: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        self._inbox.put_nowait({"type": "websocket.connect"})
        scope = {"type": "websocket", "query_string": query.encode(), "headers": [], "path": "/api/live"}
        scope |= {"client": (address, 40000)}
        self.socket = WebSocket(scope, self._receive, self._send)

    def leave(self) -> None:
        self._inbox.put_nowait({"type": "websocket.disconnect", "code": 1001})

    async def _receive(self) -> dict[str, Any]:
        return await self._inbox.get()

    async def _send(self, message: Any) -> None:
        if message["type"] in self.gone_at:
            raise OSError("the page is gone")
        if message["type"] == "websocket.close":
            self.closed = message["code"]
        elif message["type"] == "websocket.send":
            self.sent.append(json.loads(message["text"]))
            self.at_s.append(asyncio.get_running_loop().time())
            if self._think_s is not None:
                word = self._words.pop(0) if self._words else "next"
                answer = {"type": "websocket.receive", "text" if isinstance(word, str) else "bytes": word}
                asyncio.get_running_loop().call_later(self._think_s, self._inbox.put_nowait, answer)


@asynccontextmanager
async def served(live: Live, *pages: Page) -> AsyncIterator[None]:
    async with asyncio.TaskGroup() as group:
        for page in pages:
            group.create_task(live.serve(page.socket))
        yield
        for page in pages:
            page.leave()


@in_virtual_time
async def test_a_page_that_keeps_up_gets_ten_views_a_second_each_newer_than_the_last() -> None:
    async with plant() as made:
        live, page = Live(made.client, views.live_json, 4, 4), Page("bay=bay1")
        async with served(live, page):
            await asyncio.sleep(5)
        assert 48 <= len(page.sent) <= 53
        numbers = [view["bays"][0]["state"]["seq"] for view in page.sent]
        assert numbers == sorted(set(numbers))
        assert max(view["bays"][0]["age_ms"] for view in page.sent) <= 20.0
        assert live.counts.open == 0


@in_virtual_time
async def test_a_message_says_how_long_its_question_was_held() -> None:
    async with plant() as made:
        live, page = Live(made.client, views.driver_json, 4, 4), Page("bay=bay1", think_s=0.03)
        async with served(live, page):
            await asyncio.sleep(2)
        assert [view["held_ms"] for view in page.sent[5:15]] == [pytest.approx(70, abs=15)] * 10  # of 100 ms


@pytest.mark.one_interpreter
@in_virtual_time
async def test_a_page_that_stalled_gets_the_newest_view_and_no_older_one() -> None:
    async with plant() as made:
        live, page = Live(made.client, views.live_json, 4, 4), Page("bay=bay1", think_s=20.0)
        async with served(live, page):
            await asyncio.sleep(50)
        assert len(page.sent) == 3  # at 0, 20 and 40 s
        assert all(view["bays"][0]["age_ms"] <= 130.0 for view in page.sent)


@pytest.mark.parametrize("render", [views.live_json, views.driver_json])
@in_virtual_time
async def test_while_the_gateway_hangs_what_is_sent_again_is_as_old_as_it_is(render: Render) -> None:
    """To a page that was there, and to one that is opened only then."""

    def ages_ms(page: Page) -> list[float]:
        return [view.get("bays", [view])[0]["age_ms"] for view in page.sent]

    async with plant() as made:
        live, page, late = Live(made.client, render, 4, 4), Page("bay=bay1"), Page("bay=bay1")
        async with asyncio.TaskGroup() as group:
            served = [group.create_task(live.serve(page.socket))]
            await asyncio.sleep(1)
            made.hang()
            before = len(page.sent)
            await asyncio.sleep(3)
            served.append(group.create_task(live.serve(late.socket)))
            await asyncio.sleep(1.5)
            for each in served:
                each.cancel()
        assert ages_ms(page)[before:] == [pytest.approx(age_ms, abs=150) for age_ms in (2000, 4000)]
        assert ages_ms(late)[0] == pytest.approx(3000, abs=150)


@pytest.mark.one_interpreter
@in_virtual_time
async def test_a_page_that_never_answers_is_disconnected() -> None:
    async with plant() as made:
        live, page = Live(made.client, views.live_json, 4, 4), Page("bay=bay1", think_s=None)
        begun_s = asyncio.get_running_loop().time()
        await live.serve(page.socket)
        assert asyncio.get_running_loop().time() - begun_s <= ANSWER_S + 3
        assert (page.closed, len(page.sent), live.counts.dropped, live.counts.open) == (BAD_ANSWER, 1, 1, 0)


@in_virtual_time
async def test_no_more_pages_than_allowed_and_none_for_a_bay_that_does_not_exist() -> None:
    async with plant() as made:
        live = Live(made.client, views.live_json, 2, 2)
        pages = [Page("bay=bay1") for _ in range(3)]
        stranger = Page("bay=bay9")
        async with served(live, *pages, stranger):
            await asyncio.sleep(1)
            assert live.counts.open == 2
        assert [page.closed for page in pages] == [None, None, TOO_MANY]
        assert (stranger.closed, stranger.sent) == (UNKNOWN_BAY, [])
        assert live.counts.refused == 1


@in_virtual_time
async def test_one_address_has_its_share_of_the_pages() -> None:
    async with plant() as made:
        live = Live(made.client, views.driver_json, 64, 16)
        greedy = [Page("bay=bay1", address="10.0.1.66") for _ in range(64)]
        driver = Page("bay=bay1", address="10.0.1.8")
        async with served(live, *greedy, driver):
            await asyncio.sleep(1)
            assert live.counts.open == 17
            assert len(driver.sent) > 5
            greedy[0].leave()
            await asyncio.sleep(1)
            again = Page("bay=bay1", address="10.0.1.66")
            async with served(live, again):
                await asyncio.sleep(1)
                assert (again.closed, live.counts.open) == (None, 17)
        assert [page.closed for page in greedy] == [None] * 16 + [TOO_MANY] * 48
        assert (live.counts.refused, live.counts.open, len(live._open)) == (48, 0, 0)


@in_virtual_time
async def test_a_page_that_talks_too_much_is_closed() -> None:
    async with plant() as made:
        live, page = Live(made.client, views.live_json, 4, 4), Page("bay=bay1", words=["next", "x" * 65])
        await live.serve(page.socket)
        assert (page.closed, len(page.sent)) == (BAD_ANSWER, 2)


@pytest.mark.parametrize("render", [views.live_json, views.driver_json])
@in_virtual_time
async def test_a_page_that_answers_with_a_binary_frame_is_closed_and_nothing_is_raised(render: Render) -> None:
    async with plant() as made:
        live, page = Live(made.client, render, 4, 4), Page("bay=bay1", words=["next", b"next"])
        await live.serve(page.socket)
        assert (page.closed, len(page.sent), live.counts.open) == (BAD_ANSWER, 2, 0)


@pytest.mark.parametrize("gone_at", ["websocket.accept", "websocket.send", "websocket.close"])
@in_virtual_time
async def test_a_page_that_disconnects_during_a_send_is_no_fault(gone_at: str) -> None:
    async with plant() as made:
        live = Live(made.client, views.live_json, 4, 4)
        for page in (Page("bay=bay1", think_s=None), Page("bay=bay9"), Page("bay=bay1", words=[b""])):
            page.gone_at = (gone_at,)
            await live.serve(page.socket)
        assert live.counts.open == 0


@in_virtual_time
async def test_many_pages_share_one_rendering() -> None:
    async with plant() as made:
        rendered: list[tuple[str, ...]] = []

        def render(client: Any, bays: tuple[str, ...]) -> str:
            rendered.append(bays)
            return views.live_json(client, bays)

        live, pages = Live(made.client, render, 30, 30), [Page() for _ in range(20)]
        async with served(live, *pages):
            await asyncio.sleep(3)
        answers = made.client.answers
        assert all(len(page.sent) >= 28 for page in pages)
        assert len(rendered) <= answers + 1
