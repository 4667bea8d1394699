"""Calls the programs' side without socket or security: a gateway client, a main process's side, one request."""

import json
from dataclasses import dataclass
from typing import Any

import jsonschema
from fastapi import FastAPI

from gateway.config.sections.hmi import HmiConfig
from gateway.web.auth.access import Level, find
from gateway.web.auth.logins import Logins
from gateway.web.auth.sessions import Caller, with_caller
from gateway.web.server import openapi
from gateway.web.server.app import ROUTES, RULES, routes_app
from gateway.web.server.metrics.family import PageStatistics
from gateway.web.server.services import services_of
from tests.unit.web import asgi
from tests.unit.web.asgi import Answer, answer_to
from tests.unit.web.gateway_client import Plant
from tests.virtual_time import AtOnce

DOCUMENT = openapi.document(ROUTES)
COMPONENTS = DOCUMENT["components"]
ANNA = Caller("anna", Level.TECHNICIAN, "10.0.0.7", "token")


def fits(text: str | bytes, model: str) -> Any:
    """The parsed text, or list of texts, if it is what the description says."""
    found = json.loads(text)
    schema = {"$ref": f"#/components/schemas/{model}", "components": COMPONENTS}
    for one in found if isinstance(found, list) else [found]:
        jsonschema.Draft202012Validator(schema).validate(one)
    return found


def _as_described(method: str, path: str, answer: Answer) -> None:
    """Any answer of a described address has a described status, and its JSON is what the description says."""
    rule = find(method, path.partition("?")[0], RULES).rule
    operation = None if rule is None else DOCUMENT["paths"].get(rule.path, {}).get(method.lower())
    if operation is None or answer.status == 500 or "content-encoding" in answer.headers:
        return
    described = operation["responses"].get(str(answer.status))
    assert described is not None, f"{method} {path}: {answer.status} is not described: {answer.text[:200]}"
    schema = described.get("content", {}).get("application/json", {}).get("schema")
    if schema is not None:
        jsonschema.Draft202012Validator({**schema, "components": COMPONENTS}).validate(answer.json)


@dataclass
class ApiClient:
    """Sends requests as `caller`. Every answer is compared with the description."""

    app: FastAPI
    caller: Caller = ANNA

    async def get(self, path: str, headers: dict[str, str] | None = None) -> Answer:
        return await self.call("GET", path, headers=headers)

    async def post(self, path: str, body: object = None) -> Answer:
        return await self.call("POST", path, b"" if body is None else json.dumps(body).encode())

    async def call(self, method: str, path: str, body: bytes = b"", headers: dict[str, str] | None = None) -> Answer:
        sent = [(name.lower().encode(), value.encode()) for name, value in (headers or {}).items()]
        scope = with_caller(asgi.scope("http", path, sent, address=self.caller.address), self.caller)
        answer = await answer_to(self.app, method, scope, [body])
        _as_described(method, path, answer)
        return answer


def api_client(made: Plant, statistics: PageStatistics | None = None) -> ApiClient:
    """Of the real application without its security."""
    services = services_of(made.client, made.client.clock, AtOnce())
    if statistics is not None:
        services.live.counts = statistics.viewers["live"]
        services.pictures.encoded = statistics.pictures_encoded
        services.refusals.update(statistics.refusals)
    logins = Logins(HmiConfig(), made.client.clock, lambda _: None)
    logins.passwords._thread = AtOnce()
    return ApiClient(routes_app(services, logins))
