"""The addresses that the reader process answers."""

import asyncio
import re
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from starlette.types import Message

from gateway.records.questions import EvidenceQuestion, Question, ValuesQuestion, WhyQuestion
from gateway.web.auth.access import Level
from gateway.web.auth.refusals import RefusalError
from gateway.web.auth.sessions import Caller, with_caller
from gateway.web.history.routes import BAY as ROUTE
from gateway.web.history.why import ADDRESSES
from tests.unit.web import asgi
from tests.unit.web.gateway_client import plant
from tests.unit.web.history import VISIT, config, indexed
from tests.unit.web.programs import ApiClient, api_client
from tests.unit.web.test_api import fitting, wrong
from tests.virtual_time import in_virtual_time

BAY = "/api/bays/bay1"
Answer = Callable[[], Awaitable[bytes]]


@dataclass
class Asked:
    """In place of its client: what it is asked, and what it answers."""

    answer: Answer
    questions: list[Question] = field(default_factory=list)

    async def ask(self, question: Question) -> bytes:
        self.questions.append(question)
        return await self.answer()

    async def file(self, question: Question) -> AsyncIterator[bytes]:
        yield await self.ask(question)
        yield b""


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


@in_virtual_time
async def test_the_evidence_of_a_visit(tmp_path: Path) -> None:
    async def answer() -> bytes:
        return b"PK"

    indexed(tmp_path)
    url = f"{BAY}/visits/{VISIT.begun_ms}/evidence.zip"
    async with asking(tmp_path, answer, "technician") as (api, asked):
        told = await api.get(url)
        assert (told.status, told.text, told.headers["content-type"]) == (200, "PK", "application/zip")
        assert re.match(
            r'attachment; filename="evidence-bay1-2026112\dT\d{6}\.zip"', told.headers["content-disposition"]
        )
        span = VISIT.begun_ms - 30_000, VISIT.last_seen_ms + 30_000
        assert asked.questions == [EvidenceQuestion("bay1", *span, pictures=True)]
        wrong(await api.get(f"{BAY}/visits/5/evidence.zip"), 404, "visit")
    async with asking(tmp_path, answer, "nobody") as (api, asked):
        assert (await api.get(url)).status == 200
        assert asked.questions == [EvidenceQuestion("bay1", *span, pictures=False)]
    exporting = [(rule.path, rule.least) for rule in ADDRESSES.rules if rule.exports]
    assert exporting == [(f"{ROUTE}/visits/{{begun_ms}}/evidence.zip", Level.TECHNICIAN)]


@in_virtual_time
async def test_who_leaves_before_the_first_piece_lets_the_next_one_in(tmp_path: Path) -> None:
    given_up: list[bool] = []

    async def answer() -> bytes:
        try:
            await asyncio.sleep(500)
        finally:
            given_up.append(True)
        return b""

    async def gone() -> Message:
        return {"type": "http.disconnect"}

    async def send(message: Message) -> None:
        pass

    indexed(tmp_path)
    async with asking(tmp_path, answer, "technician") as (api, asked):
        url = f"{BAY}/visits/{VISIT.begun_ms}/evidence.zip"
        scope = with_caller(asgi.scope("http", url, [], address="10.0.0.7"), api.caller)
        begun_s = asyncio.get_running_loop().time()
        await api.app({**scope, "method": "GET"}, gone, send)
        assert (len(asked.questions), given_up) == (1, [True])
        assert asyncio.get_running_loop().time() - begun_s < 1
