"""The addresses of the fleet page, behind the same security as a gateway's pages. Every one of them only reads."""

import asyncio
import gzip
from typing import Any

import msgspec
from fastapi import FastAPI
from prometheus_client.registry import Collector
from starlette.exceptions import HTTPException
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.types import ASGIApp

from gateway import __version__
from gateway.clock import Clock
from gateway.fleet import rows
from gateway.fleet.answer import Answers
from gateway.fleet.config import FleetConfig
from gateway.fleet.listener import Listener
from gateway.fleet.trends import PERIOD_MS
from gateway.web.auth import common_pages, login
from gateway.web.auth.access import Level
from gateway.web.auth.addresses import Addresses
from gateway.web.auth.logins import Logins
from gateway.web.auth.page_files import STATIC, page_file
from gateway.web.auth.problems import handlers
from gateway.web.auth.security import SecurityMiddleware
from gateway.web.languages import languages
from gateway.web.server.metrics.text import encoded

ADDRESSES = Addresses()


def _listener(request: Request) -> Listener:
    found: Listener = request.app.state.listener
    return found


@ADDRESSES.get("/", Level.VIEWER, "the fleet page")
async def _fleet_page(request: Request) -> Response:
    return page_file(STATIC / "fleet.html", request.app.state.base_path)


@ADDRESSES.get("/api/fleet", Level.VIEWER, "a row for each bay")
async def _fleet(request: Request) -> Response:
    answers: Answers = request.app.state.answers
    body, headers = (await answers.newest()).compressed, {"Vary": "Accept-Encoding"}
    if "gzip" in request.headers.get("accept-encoding", ""):
        headers["Content-Encoding"] = "gzip"
    else:
        body = await asyncio.to_thread(gzip.decompress, body)
    return Response(body, media_type="application/json", headers=headers)


@ADDRESSES.get("/api/fleet/{site}/{instance}", Level.VIEWER, "all that is known of a gateway, and its newest changes")
async def _gateway(request: Request, site: str, instance: str) -> Response:
    listener, key = _listener(request), (site, instance)
    roster = listener.roster
    if key not in roster:
        raise HTTPException(404, "no such gateway was heard of, and none is in the inventory")
    one, wanted = roster.known.get(key), (roster.expected or {}).get(key)
    life = roster.life(key, listener.now_ms())
    kept = await listener.keeper.past(key)
    past = listener.keeper.newest(key, kept)
    return Response(
        msgspec.json.encode(
            {
                "life": life,
                "heard_ms": None if one is None else one.heard_ms,
                "attention": roster.attention(key, life, roster.deviations(key)),
                "expected": None if wanted is None else wanted.model_dump(),
                "status": None if one is None or not one.text else msgspec.Raw(one.text),
                "changes": [
                    {"t_ms": change.t_ms, "what": change.what, "was": change.was, "now": change.now}
                    for change in past.changes
                ],
                "kept": kept is not None,
                "trends": [
                    {
                        "bay": s.bay,
                        "t_ms": s.period * PERIOD_MS,
                        "veil": s.veil,
                        "visible": s.visible,
                        "contrast": s.contrast,
                    }
                    for s in past.samples
                ],
            }
        ),
        media_type="application/json",
    )


@ADDRESSES.get("/metrics", Level.VIEWER, "for Prometheus")
async def _metrics(request: Request) -> Response:
    collector = _Collector(_listener(request))
    async with request.app.state.metrics:
        body, content_type = await asyncio.to_thread(encoded, collector, request.headers.get("accept", ""))
    return Response(body, media_type=content_type)


@ADDRESSES.get("/healthz", Level.OPEN, "200 with a connection to the broker, else 503")
async def _healthz(request: Request) -> JSONResponse:
    connected = _listener(request).connected
    return JSONResponse({"connected": connected, "version": __version__}, 200 if connected else 503)


class _Collector(Collector):
    """Of what is known when it is made: the text is made on a thread."""

    def __init__(self, listener: Listener) -> None:
        roster, keeper = listener.roster, listener.keeper
        self._rows = rows.rows(roster, listener.now_ms())
        self._counts = {
            "connected": listener.connected,
            "damaged_messages": roster.damaged,
            "gateways_left_out": roster.left_out,
            "database_connected": keeper.connected,
            "changes_waiting": keeper.waiting,
            "changes_dropped": keeper.dropped,
        }

    def collect(self) -> Any:
        return rows.metrics(self._rows, self._counts)


def app(listener: Listener, logins: Logins, clock: Clock, config: FleetConfig) -> ASGIApp:
    groups = (login.ADDRESSES, common_pages.ADDRESSES, ADDRESSES)
    made = FastAPI(
        routes=[route for group in groups for route in group.routes],
        exception_handlers=handlers(),
        openapi_url=None,
        redirect_slashes=False,
    )
    made.add_middleware(GZipMiddleware, minimum_size=1000, compresslevel=6)  # none of the answers holds a secret
    made.state.listener, made.state.logins, made.state.bays = listener, logins, {}
    made.state.answers, made.state.metrics = Answers(listener), asyncio.Lock()
    made.state.base_path = config.hmi.base_path
    made.state.languages = languages({})
    return SecurityMiddleware(made, [rule for group in groups for rule in group.rules], logins, clock)
