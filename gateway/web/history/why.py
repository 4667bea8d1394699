"""The addresses that are answered from the recordings themselves, by the reader process. IO."""

import asyncio
from collections.abc import AsyncIterator, Coroutine
from contextlib import aclosing
from typing import Annotated

import msgspec
from fastapi import Query
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from gateway.durations import NS_PER_MS
from gateway.errors import LinkError
from gateway.records.moment import local_name
from gateway.records.questions import EvidenceQuestion, ValuesQuestion, WhyQuestion
from gateway.web.auth.access import Level
from gateway.web.auth.addresses import ApiAddresses, whole_number
from gateway.web.auth.refusals import RefusalError
from gateway.web.history.models import TrendView
from gateway.web.history.routes import BAY, ERRORS, LAST_MS, MAX_POINTS, Begun, may_see_pictures, visit_of
from gateway.web.server.services import Bay, RequestCaller, WebServices

LONGEST_MS = 2 * 3_600_000  # of `values`: nine segments
AROUND_MS = 30_000  # evidence before a truck came and behind its leaving
ADDRESSES = ApiAddresses(least=Level.VIEWER, errors=ERRORS | {404: "no such bay, or nothing of that time is recorded"})

At = Annotated[int, whole_number(0, LAST_MS), Query(description="Unix time, ms")]
Points = Annotated[int, whole_number(1, MAX_POINTS), Query(description="at most so many buckets")]


@ADDRESSES.get(f"{BAY}/values", "values", "as trend, from the recordings themselves, of two hours at most")
async def _values(
    request: Request, services: WebServices, bay: Bay, since_ms: At, until_ms: At, points: Points = 500
) -> TrendView:
    if not 0 < until_ms - since_ms <= LONGEST_MS:
        raise RefusalError(400, "query", f"until_ms is to be behind since_ms, by {LONGEST_MS} ms at most")
    found = await _unless_gone(request, services.reader.ask(ValuesQuestion(bay.name, since_ms, until_ms, points)))
    return TrendView.model_validate({"bay": bay.name, **msgspec.json.decode(found)})


@ADDRESSES.get(
    f"{BAY}/why",
    "why",
    "why the outputs were as they were at a moment, as `gateway why --json`",
    media="application/json",
)
async def _why(request: Request, services: WebServices, bay: Bay, at_ms: At) -> Response:
    question = WhyQuestion(bay.name, at_ms, html=False, pictures=True)
    found = await _unless_gone(request, services.reader.ask(question))
    return Response(found, media_type="application/json")


@ADDRESSES.get(
    f"{BAY}/why.html",
    "why_report",
    "the same as a report in one file, with plots, and pictures for those who may see them",
    media="text/html",
)
async def _why_report(request: Request, services: WebServices, caller: RequestCaller, bay: Bay, at_ms: At) -> Response:
    """To be saved: the pages' own policy lets no page have styles and pictures inside."""
    pictures = may_see_pictures(services.client.about.config, caller)
    question = WhyQuestion(bay.name, at_ms, html=True, pictures=pictures)
    found = await _unless_gone(request, services.reader.ask(question))
    name = f"why-{bay.name}-{local_name(at_ms * NS_PER_MS)}.html"
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return Response(found, media_type="text/html; charset=utf-8", headers=headers)


@ADDRESSES.get(
    f"{BAY}/visits/{{begun_ms}}/evidence.zip",
    "visit_evidence",
    "all that is recorded of one visit: segments, kept pictures for those who may see them, a report, SHA256SUMS",
    media="application/zip",
    least=Level.TECHNICIAN,  # the segments hold the bay's whole configuration
    exports=True,
    errors={404: "no such bay or visit", 409: "more is recorded of it than 128 MB"},
)
async def _visit_evidence(
    request: Request, services: WebServices, caller: RequestCaller, bay: Bay, begun_ms: Begun
) -> Response:
    """Written to the audit log."""
    visit = await visit_of(services, bay.name, begun_ms)
    span = max(0, begun_ms - AROUND_MS), visit.last_seen_ms + AROUND_MS
    pictures = may_see_pictures(services.client.about.config, caller)
    pieces = services.reader.file(EvidenceQuestion(bay.name, *span, pictures))

    async def begun() -> bytes:
        try:
            return await anext(pieces)
        except LinkError as error:
            raise RefusalError(503, "records", str(error)) from None

    first = await _unless_gone(request, begun())

    async def sent() -> AsyncIterator[bytes]:
        async with aclosing(pieces):
            yield first
            async for piece in pieces:
                yield piece

    name = f"evidence-{bay.name}-{local_name(span[0] * NS_PER_MS)}.zip"
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return StreamingResponse(sent(), media_type="application/zip", headers=headers)


async def _unless_gone(request: Request, answer: Coroutine[object, object, bytes]) -> bytes:
    """Given up when the caller is gone. Raises RefusalError."""

    async def asked() -> bytes | RefusalError:
        try:
            return await answer
        except RefusalError as refusal:
            return refusal
        finally:
            watching.cancel()

    async with asyncio.TaskGroup() as group:
        asking = group.create_task(asked())
        watching = group.create_task(_cancel_when_gone(request, asking))
    if asking.cancelled():
        raise RefusalError(503, "gone", "the caller is gone")
    found = asking.result()
    if isinstance(found, RefusalError):
        raise found
    return found


async def _cancel_when_gone(request: Request, asking: asyncio.Task[bytes | RefusalError]) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass
    asking.cancel()
