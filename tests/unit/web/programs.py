"""Calls the programs' side without socket or security: a gateway client, a main process's side, one request."""

import json
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

from fastapi import FastAPI
from starlette.types import Message

from gateway.config.sections.hmi import HmiConfig
from gateway.web.auth.access import Level
from gateway.web.auth.logins import Logins
from gateway.web.auth.sessions import Caller, with_caller
from gateway.web.server.app import routes_app
from gateway.web.server.metrics.family import PageStatistics
from gateway.web.server.services import services_of
from tests.unit.web.gateway_client import Plant
from tests.virtual_time import AtOnce

ANNA = Caller("anna", Level.TECHNICIAN, "10.0.0.7", "token")


@dataclass(frozen=True)
class Said:
    """One answer."""

    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


@dataclass
class ApiClient:
    """Asks as `caller`."""

    app: FastAPI
    caller: Caller = ANNA

    async def get(self, path: str, query: str = "", headers: dict[str, str] | None = None) -> Said:
        return await self.ask("GET", path, query, headers=headers)

    async def post(self, path: str, body: object = None) -> Said:
        return await self.ask("POST", path, body=b"" if body is None else json.dumps(body).encode())

    async def ask(
        self, method: str, path: str, query: str = "", *, body: bytes = b"", headers: dict[str, str] | None = None
    ) -> Said:
        scope = {
            "type": "http",
            "http_version": "1.1",
            "method": method,
            "scheme": "http",
            "path": path,
            "raw_path": quote(path).encode(),
            "query_string": query.encode(),
            "headers": [(name.lower().encode(), value.encode()) for name, value in (headers or {}).items()],
            "client": (self.caller.address, 1),
            "server": ("localhost", 80),
        }
        told: list[Message] = []

        async def receive() -> Message:
            return {"type": "http.request", "body": body, "more_body": False}

        async def send(message: Any) -> None:
            told.append(message)

        await self.app(with_caller(scope, self.caller), receive, send)
        start = told[0]
        headers_told = {name.decode(): value.decode() for name, value in start["headers"]}
        return Said(start["status"], headers_told, b"".join(message.get("body", b"") for message in told[1:]))


def api_client(made: Plant, statistics: PageStatistics | None = None) -> ApiClient:
    """Of the real application without its security."""
    services = services_of(made.client, made.client.clock, AtOnce())
    if statistics is not None:
        services.live.counts = statistics.viewers["live"]
        services.pictures.encoded = statistics.pictures_encoded
        services.refusals.update(statistics.refusals)
    return ApiClient(routes_app(services, Logins(HmiConfig(), made.client.clock, lambda _: None)))
