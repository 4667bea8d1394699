"""The web process's questions to a helper process, over a real socket and real pipes."""

import asyncio
import os
from collections.abc import AsyncIterator, Awaitable
from contextlib import asynccontextmanager, suppress
from dataclasses import replace
from typing import Any

import pytest

from gateway.doctor import device_process
from gateway.errors import LinkError
from gateway.processes.answers import LENGTH_BYTES, AnswerKind
from gateway.records import reader_process
from gateway.records.questions import QUESTIONS, Question, WhyQuestion
from gateway.web.auth.refusals import RefusalError
from gateway.web.auth.security import EXPORT_S
from gateway.web.helper_client import DEVICES, READER, TEST_SETS, HelperAccess, HelperClient
from gateway.web.setup import device_client
from gateway.web.testsets import process as sets_process
from tests.unit.web.helper_stand_in import StandIn, send, stand_in
from tests.virtual_time import in_real_time

AT = WhyQuestion("bay1", 5, html=False, pictures=True)


def at(n: int) -> WhyQuestion:
    return WhyQuestion("bay1", n, html=False, pictures=True)


@asynccontextmanager
async def asking(access: HelperAccess = READER) -> AsyncIterator[tuple[HelperClient[Question], StandIn]]:
    with stand_in(QUESTIONS) as (fd, other):
        client: HelperClient[Question] = HelperClient(access, fd)
        try:
            yield client, other
        finally:
            client.close()


async def both(first: Awaitable[Any], second: Awaitable[Any]) -> tuple[Any, Any]:
    return await asyncio.gather(first, second, return_exceptions=True)


@in_real_time
async def test_an_answer_comes_whole_however_it_arrives() -> None:
    async with asking() as (client, other):
        asked = asyncio.ensure_future(client.ask(AT))
        await asyncio.sleep(0.01)
        question, fd = other.take()
        assert question == AT
        for byte in (4).to_bytes(LENGTH_BYTES) + b"+abc":
            os.write(fd, bytes([byte]))
            await asyncio.sleep(0)
        assert await asked == b"abc"
        with pytest.raises(BrokenPipeError):  # its end is what ends the work
            os.write(fd, b"x")
        os.close(fd)
        assert (await both(client.ask(AT), other.answers(b"")))[0] == b""


@in_real_time
async def test_data_travel_as_memory_that_is_the_helpers_own() -> None:
    async with asking() as (client, other):
        asked = asyncio.ensure_future(client.ask(AT, b"a picture"))
        await asyncio.sleep(0.01)
        _, (pipe, memory) = other.channel.receive_with_fds()
        assert os.pread(memory, 100, 0) == b"a picture"
        for fd in (pipe, memory):
            os.close(fd)
        with pytest.raises(RefusalError):
            await asked


@pytest.mark.parametrize(
    ("answer", "kind", "status", "code", "text"),
    [
        (b"no segment", AnswerKind.NOTHING, 404, "moment", "no segment"),
        (b"taken", AnswerKind.REFUSED, 409, "refused", "taken"),
        (b"disk \xff", AnswerKind.FAULT, 503, "records", "disk \ufffd"),
        (b"", None, 503, "records", "too long or too much memory"),
    ],
)
def test_what_is_no_answer_is_refused(
    answer: bytes, kind: AnswerKind | None, status: int, code: str, text: str
) -> None:
    @in_real_time
    async def asked() -> None:
        async with asking() as (client, other):
            error, _ = await both(client.ask(AT), other.answers(answer, kind))
            assert isinstance(error, RefusalError)
            assert (error.status, error.code) == (status, code)
            assert text in str(error)

    asked()


@pytest.mark.parametrize(
    ("sent", "text"),
    [((5).to_bytes(LENGTH_BYTES) + b"+abcd", "too long"), (b"\0\0\0\1x", "another answer"), (b"\0\0\0\0\0", "another")],
)
def test_what_is_no_piece_is_refused(sent: bytes, text: str) -> None:
    @in_real_time
    async def asked() -> None:
        async with asking(replace(READER, max_bytes=4)) as (client, other):
            answer = asyncio.ensure_future(client.ask(AT))
            await asyncio.sleep(0.01)
            _, fd = other.take()
            os.write(fd, sent)
            os.close(fd)
            with pytest.raises(RefusalError, match=text) as found:
                await answer
            assert found.value.status == 503

    asked()


@in_real_time
async def test_one_at_a_time_and_few_wait() -> None:
    async with asking() as (client, other):
        first = asyncio.ensure_future(client.ask(AT))
        others = [asyncio.ensure_future(client.ask(at(n))) for n in range(3)]
        await asyncio.sleep(0.05)
        with pytest.raises(RefusalError, match="too many"):
            await client.ask(AT)
        _, fd = other.take()
        other.channel.sock.setblocking(False)
        with pytest.raises(BlockingIOError):
            other.channel.receive_with_fds()
        other.channel.sock.setblocking(True)
        others[0].cancel()
        os.close(fd)
        with suppress(RefusalError):
            await first
        assert await other.answers(b"1") == at(1)
        assert await others[1] == b"1"
        assert await other.answers(b"2") == at(2)
        assert await others[2] == b"2"


@in_real_time
async def test_what_nobody_waits_for_is_given_up() -> None:
    async with asking() as (client, other):
        asked = asyncio.ensure_future(client.ask(AT))
        await asyncio.sleep(0.02)
        _, fd = other.take()
        asked.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asked
        with pytest.raises(BrokenPipeError):
            os.write(fd, b"late")
        os.close(fd)
        assert (await both(client.ask(AT), other.answers(b"next")))[0] == b"next"


@in_real_time
async def test_too_late_and_nobody_there() -> None:
    async with asking(replace(READER, answer_s=0.05)) as (client, other):
        with pytest.raises(RefusalError, match="not be read in time"):
            await client.ask(AT)
        other.channel.sock.close()
        with pytest.raises(RefusalError, match="takes no questions"):
            await client.ask(AT)
    with pytest.raises(RefusalError) as found:
        await HelperClient[Question](READER, None).ask(AT)
    assert found.value.code == "not_recorded"


def test_an_answer_is_ended_before_its_asker_gives_up() -> None:
    """Else it would go on, and its asker would ask once more beside it."""
    assert READER.answer_s > reader_process.LIMIT_S
    assert EXPORT_S > reader_process.EVIDENCE_LIMIT_S
    assert TEST_SETS.answer_s > sets_process.LIMIT_S
    assert DEVICES.answer_s < device_client.EXAMINED_S < device_process.LIMIT_S  # there a gone asker ends it


@in_real_time
async def test_a_file_is_whole_or_an_error() -> None:
    async def given(other: StandIn, *pieces: bytes) -> None:
        await asyncio.sleep(0.01)
        _, fd = other.take()
        send(fd, *pieces)
        os.close(fd)

    async with asking() as (client, other):
        giving = asyncio.ensure_future(given(other, b"ab", b"cd", b""))
        pieces = client.file(AT)
        assert await anext(pieces) == b"ab"
        with pytest.raises(RefusalError, match="gives a file to somebody"):
            await anext(client.file(AT))
        assert [piece async for piece in pieces] == [b"cd", b""]
        left = asyncio.ensure_future(anext(client.file(AT)))
        await asyncio.sleep(0.01)
        os.close(other.take()[1])
        left.cancel()
        await asyncio.wait([left])
        giving = asyncio.ensure_future(given(other, b"ab"))
        pieces = client.file(AT)
        assert await anext(pieces) == b"ab"
        with pytest.raises(LinkError, match="has failed, or it took too long"):
            await anext(pieces)
        await giving
