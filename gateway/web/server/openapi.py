"""The OpenAPI 3.1 description of the addresses for programs, as FastAPI makes it from the routes.

The live views (WebSocket) and the pages' own requests are no part of it; the models of the live views are.
"""

import json
from collections.abc import Sequence
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from fastapi.routing import APIRoute
from pydantic import TypeAdapter
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute

from gateway import __version__
from gateway.web.auth.access import Level
from gateway.web.auth.addresses import ApiAddresses
from gateway.web.auth.logins import Logins
from gateway.web.auth.refusals import Problem
from gateway.web.server.models import AlarmsLiveView, DriverView, FrameView, LiveView

Json = dict[str, Any]
ADDRESSES = ApiAddresses(least=Level.VIEWER)
COOKIE = "gateway-session"  # with the default instance; __Host-... with TLS
ABOUT = """State, events, registers, alarms and pictures of a bulk loading gateway, for programs.

Every caller needs the role that the operation names (`x-role`), by HTTP Basic or by the session of a login; `[hmi]
without_login` of the configuration defines what is open to everybody. What changes something needs a session and its
token in `X-CSRF-Token`, which `GET /api/session` returns. Nothing here can end a stop.

Ages are those at sending. Numbers that are not known are null. See docs/hmi-api.md."""


@ADDRESSES.get("/api/openapi.json", "openapi", "this description", media="application/json")
async def _openapi(request: Request) -> Response:
    app: FastAPI = request.app
    logins: Logins = app.state.logins
    cookie = logins.cookie(secure=request.scope["scheme"] == "https")
    app.openapi_schema = app.openapi_schema or document(app.routes, cookie, logins.config.base_path)
    return Response(json.dumps(app.openapi_schema), media_type="application/json")


def document(every: Sequence[BaseRoute], cookie: str = COOKIE, base_path: str = "") -> Json:
    """The complete description of those that have one. `cookie`: the name of the session's."""
    routes = [route for route in every if isinstance(route, APIRoute) and route.include_in_schema]
    made = get_openapi(
        title="Loading gateway",
        version=__version__,
        description=ABOUT,
        license_info={"name": "Apache-2.0", "identifier": "Apache-2.0"},
        servers=[{"url": f"{base_path}/"}],
        routes=routes,
    )
    for route in routes:
        _corrected(made["paths"][route.path][_method(route)], route)
    made["jsonSchemaDialect"] = "https://json-schema.org/draft/2020-12/schema"
    made["components"] = {
        "schemas": _schemas(routes),
        "securitySchemes": {
            "basic": {"type": "http", "scheme": "basic", "description": "for programs; GET only"},
            "session": {"type": "apiKey", "in": "cookie", "name": cookie, "description": "made by a login"},
            "csrf": {"type": "apiKey", "in": "header", "name": "X-CSRF-Token", "description": "of the session"},
        },
    }
    return made


def _method(route: APIRoute) -> str:
    return next(iter(route.methods or ())).lower()


def _corrected(operation: Json, route: APIRoute) -> None:
    """Where the gateway differs from FastAPI: 400 for what is wrong, and no body is an empty object."""
    if 422 not in route.responses:
        operation["responses"].pop("422", None)
    if route.body_field is not None:
        fields = route.body_field.field_info.annotation.model_fields.values()  # type: ignore[union-attr]
        operation["requestBody"]["required"] = any(field.is_required() for field in fields)


def _schemas(routes: list[APIRoute]) -> Json:
    """Of all models at once: FastAPI leaves out defaults that are null."""
    live = (LiveView, AlarmsLiveView, DriverView, FrameView)
    models: list[tuple[str, Any]] = [("serialization", model) for model in (*live, Problem)]
    for route in routes:
        models.append(("serialization", route.response_model))
        models += [("validation", parameter.field_info.annotation) for parameter in route.dependant.query_params]
        if route.body_field is not None:
            models.append(("validation", route.body_field.field_info.annotation))
    adapters = [(n, mode, TypeAdapter(model)) for n, (mode, model) in enumerate(models)]
    _, schemas = TypeAdapter.json_schemas(adapters, ref_template="#/components/schemas/{model}")  # type: ignore[arg-type]
    definitions: Json = schemas["$defs"]
    return definitions
