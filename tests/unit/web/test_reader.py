"""The web process's questions to the reader process, over a real socket and real pipes."""

import asyncio
import os
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest

from gateway.processes.channel import Channel
from gateway.records.questions import QUESTIONS, Question, ValuesQuestion, WhyQuestion
from gateway.web.auth.access import Level
from gateway.web.auth.refusals import RefusalError
from gateway.web.auth.sessions import Caller
from gateway.web.history import reader as module
from gateway.web.history.reader import Reader
from tests.unit.web.gateway_client import plant
from tests.unit.web.history import config
from tests.unit.web.programs import ApiClient, api_client
from tests.unit.web.test_api import fitting, wrong
from tests.virtual_time import in_real_time, in_virtual_time

AT = WhyQuestion("bay1", 5, html=False, pictures=True)
BAY = "/api/bays/bay1"
Answer = Callable[[], Awaitable[bytes]]


@dataclass
class StandIn:
    """In place of the reader process: takes one question, and has the pipe for its answer."""

    channel: Channel[Any, Question]

    def take(self) -> tuple[Question, int]:
        question, (fd,) = self.channel.receive_with_fds()
        return question, fd

    async def answers(self, *pieces: bytes) -> Question:
        await asyncio.sleep(0.01)
        question, fd = self.take()
        for piece in pieces:
            await asyncio.sleep(0.01)
            os.write(fd, piece)
        os.close(fd)
        return question


@asynccontextmanager
async def reading() -> AsyncIterator[tuple[Reader, StandIn]]:
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    reader = Reader(near.fileno())
    try:
        with near, far:
            yield reader, StandIn(Channel(far, QUESTIONS))
    finally:
        reader.close()


async def both(first: Awaitable[Any], second: Awaitable[Any]) -> tuple[Any, Any]:
    return await asyncio.gather(first, second, return_exceptions=True)


@in_real_time
async def test_an_answer_comes_in_pieces() -> None:
    async with reading() as (reader, stand_in):
        told, question = await both(reader.ask(AT), stand_in.answers(b"+ab", b"cd", b"e"))
        assert (told, question) == (b"abcde", AT)
        told, _ = await both(reader.ask(AT), stand_in.answers(b"+"))
        assert told == b""


@pytest.mark.parametrize(
    ("answer", "status", "code", "text"),
    [
        (b"0no segment", 404, "moment", "no segment"),
        (b"-disk \xff", 503, "records", "disk \ufffd"),
        (b"", 503, "records", "too long or too much memory"),
    ],
)
def test_what_is_no_answer_is_refused(answer: bytes, status: int, code: str, text: str) -> None:
    @in_real_time
    async def asked() -> None:
        async with reading() as (reader, stand_in):
            error, _ = await both(reader.ask(AT), stand_in.answers(*([answer] if answer else [])))
            assert isinstance(error, RefusalError)
            assert (error.status, error.code) == (status, code)
            assert text in str(error)

    asked()


@in_real_time
async def test_one_at_a_time_and_few_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    async with reading() as (reader, stand_in):
        first = asyncio.ensure_future(reader.ask(AT))
        others = [asyncio.ensure_future(reader.ask(replace_at(n))) for n in range(3)]
        await asyncio.sleep(0.05)
        with pytest.raises(RefusalError, match="too many"):
            await reader.ask(AT)
        _, fd = stand_in.take()
        stand_in.channel.sock.setblocking(False)
        with pytest.raises(BlockingIOError):
            stand_in.channel.receive_with_fds()
        stand_in.channel.sock.setblocking(True)
        others[0].cancel()
        os.close(fd)
        with suppress(RefusalError):
            await first
        assert await stand_in.answers(b"+1") == replace_at(1)
        assert await others[1] == b"1"
        assert await stand_in.answers(b"+2") == replace_at(2)
        assert await others[2] == b"2"


def replace_at(n: int) -> WhyQuestion:
    return WhyQuestion("bay1", n, html=False, pictures=True)


@in_real_time
async def test_what_nobody_waits_for_is_given_up() -> None:
    async with reading() as (reader, stand_in):
        asking = asyncio.ensure_future(reader.ask(AT))
        await asyncio.sleep(0.02)
        _, fd = stand_in.take()
        asking.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asking
        with pytest.raises(BrokenPipeError):
            os.write(fd, b"+late")
        os.close(fd)
        told, _ = await both(reader.ask(AT), stand_in.answers(b"+next"))
        assert told == b"next"


@in_real_time
async def test_too_late_too_long_and_nobody_there(monkeypatch: pytest.MonkeyPatch) -> None:
    async with reading() as (reader, stand_in):
        monkeypatch.setattr(module, "MAX_BYTES", 3)
        error, _ = await both(reader.ask(AT), stand_in.answers(b"+abc"))
        assert "too long" in str(error)
        monkeypatch.setattr(module, "ANSWER_S", 0.05)
        with pytest.raises(RefusalError, match="not be read in time"):
            await reader.ask(AT)
        stand_in.channel.sock.close()
        with pytest.raises(RefusalError, match="takes no requests"):
            await reader.ask(AT)
    with pytest.raises(RefusalError) as found:
        await Reader(None).ask(AT)
    assert found.value.code == "not_recorded"


@dataclass
class Asked:
    """In place of `Reader`: what it is asked, and what it answers."""

    answer: Answer
    questions: list[Question] = field(default_factory=list)

    async def ask(self, question: Question) -> bytes:
        self.questions.append(question)
        return await self.answer()


@asynccontextmanager
async def asking(
    folder: Path, answer: Callable[[], Awaitable[bytes]], least: str
) -> AsyncIterator[tuple[ApiClient, Asked]]:
    async with plant(config=config(folder, pictures_for=least)) as made:
        client = api_client(made)
        asked = Asked(answer)
        client.app.state.services = replace(client.app.state.services, reader=asked)
        yield client, asked


@in_virtual_time
async def test_why_and_who_may_see_its_pictures(tmp_path: Path) -> None:
    async def answer() -> bytes:
        return b'{"bay": "bay1"}'

    async with asking(tmp_path, answer, "technician") as (api, asked):
        told = await api.get(f"{BAY}/why?at_ms=1795400040000")
        assert (told.status, told.json, told.headers["content-type"]) == (200, {"bay": "bay1"}, "application/json")
        report = await api.get(f"{BAY}/why.html?at_ms=1795400040000")
        assert report.headers["content-type"] == "text/html; charset=utf-8"
        assert report.headers["content-disposition"].startswith('attachment; filename="why-bay1-2026112')
        viewer = replace(api, caller=Caller("otto", Level.VIEWER, "10.0.0.8", "token"))
        await viewer.get(f"{BAY}/why.html?at_ms=1795400040000")
        assert [(q.html, q.pictures) for q in asked.questions if isinstance(q, WhyQuestion)] == [
            (False, True), (True, True), (True, False),
        ]  # fmt: skip
        wrong(await api.get(f"{BAY}/why"), 400, "query")
        wrong(await api.get("/api/bays/bay9/why?at_ms=5"), 404, "bay")


@in_virtual_time
async def test_values_of_two_hours_at_most(tmp_path: Path) -> None:
    row = (
        b'{"t_ms":1000,"stop_s":{"no_echo":0.5},"recorded_s":1.0,"may_move_s":0.5,"in_place_s":0.0,"frames":3,'
        b'"faults":0,"r_min":1.0,"r_mean":2.0,"r_max":3.0,"z_min":null,"z_mean":null,"z_max":null}'
    )

    async def answer() -> bytes:
        return b'{"bucket_ms":1000,"missing":[],"buckets":[%s]}' % row

    async with asking(tmp_path, answer, "viewer") as (api, asked):
        view = fitting(await api.get(f"{BAY}/values?since_ms=1000&until_ms=2000&points=7"), "TrendView")
        assert (view["bucket_ms"], view["buckets"][0]["stop_s"], view["buckets"][0]["r_mean"]) == (
            1000,
            {"no_echo": 0.5},
            2.0,
        )
        assert asked.questions == [ValuesQuestion("bay1", 1000, 2000, 7)]
        for span in ((2000, 1000), (5, 5), (0, 7_200_001)):
            wrong(await api.get(f"{BAY}/values?since_ms={span[0]}&until_ms={span[1]}"), 400, "query")
        assert (await api.get(f"{BAY}/values?since_ms=0&until_ms=7200000")).status == 200


@in_virtual_time
async def test_a_refusal_is_passed_on(tmp_path: Path) -> None:
    async def answer() -> bytes:
        raise RefusalError(404, "moment", "nothing of that time")

    async with asking(tmp_path, answer, "viewer") as (api, _):
        assert wrong(await api.get(f"{BAY}/why?at_ms=5"), 404, "moment") == "nothing of that time"
