"""The OpenAPI 3.1 description of the programs' side, made from the table of calls, the models and the table of rights.

Pure. The live views (WebSocket) and the pages' own requests are no part of it; the models of the live views are.
"""

from collections.abc import Iterable
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from gateway import __version__
from gateway.web.auth.access import RULES, Level, Rule
from gateway.web.server.api import CALLS, MAX_NUMBER, Call, Query
from gateway.web.server.models import DriverView, FrameView, LiveView, Problem
from gateway.web.server.problems import MEDIA_TYPE

Json = dict[str, Any]
COOKIE = "gateway-session"  # with the default instance; __Host-... with TLS
LIVE = (LiveView, DriverView, FrameView)
ABOUT = """State, events, registers, alarms and pictures of a bulk loading gateway, for programs.

Whoever asks needs the role that each operation names (`x-role`), by HTTP Basic or by the session of a login; `[hmi]
without_login` of the configuration says what is open to everybody. What changes something needs a session and its token
in `X-CSRF-Token`, which `GET /api/session` tells. Nothing here can end a stop.

Ages are those at sending. Numbers that are not known are null. docs/hmi-api.md says more."""
REFUSED = ((401, "needs a login"), (403, "the role is not enough, or the request is not from the gateway's own pages"))


def document(cookie: str = COOKIE) -> Json:
    """The whole description. `cookie`: the name of the session's. Raises LookupError for a call without a row in
    `access`: nobody could make it."""
    models: list[type[BaseModel]] = list(dict.fromkeys([*_models(CALLS), *LIVE, Problem]))
    _, schemas = models_json_schema(
        [(model, _mode(model)) for model in models], ref_template="#/components/schemas/{model}"
    )
    paths: Json = {}
    for call in CALLS:
        paths.setdefault(call.path, {})[call.method.lower()] = _operation(call, _rule(call))
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "Loading gateway",
            "version": __version__,
            "description": ABOUT,
            "license": {"name": "Apache-2.0", "identifier": "Apache-2.0"},
        },
        "jsonSchemaDialect": "https://json-schema.org/draft/2020-12/schema",
        "servers": [{"url": "/"}],
        "paths": paths,
        "components": {
            "schemas": schemas["$defs"],
            "securitySchemes": {
                "basic": {"type": "http", "scheme": "basic", "description": "for programs; GET only"},
                "session": {"type": "apiKey", "in": "cookie", "name": cookie, "description": "made by a login"},
                "csrf": {"type": "apiKey", "in": "header", "name": "X-CSRF-Token", "description": "of the session"},
            },
        },
    }


def _models(calls: Iterable[Call]) -> Iterable[type[BaseModel]]:
    for call in calls:
        yield from (model for _, model in call.says if model is not None)
        if call.body is not None:
            yield call.body


def _mode(model: type[BaseModel]) -> Any:
    return "validation" if any(call.body is model for call in CALLS) else "serialization"


def _rule(call: Call) -> Rule:
    for rule in RULES:
        if (rule.method, rule.path) == (call.method, call.path):
            return rule
    raise LookupError(f"{call.method} {call.path} has no row in gateway/web/auth/access.py")


def _operation(call: Call, rule: Rule) -> Json:
    operation: Json = {
        "operationId": call.name,
        "summary": call.summary,
        "tags": [_tag(call.path)],
        "x-role": rule.least.role,
        "security": _security(rule),
        "responses": {"200": _said(call), **_errors(call, rule)},
    }
    parameters = [*_in_path(call.path), *(_in_query(query) for query in call.query)]
    if parameters:
        operation["parameters"] = parameters
    if call.body is not None:
        content = {"application/json": {"schema": _ref(call.body)}}
        required = any(field.is_required() for field in call.body.model_fields.values())
        operation["requestBody"] = {"required": required, "content": content}
    return operation


def _said(call: Call) -> Json:
    content: Json = {}
    for media, model in call.says:
        schema: Json = {} if model is None else _ref(model)
        if call.many:
            schema = {"type": "array", "items": schema}
        content[media] = {"schema": schema} if schema else {}
    return {"description": call.summary, "content": content}


def _errors(call: Call, rule: Rule) -> Json:
    refused = REFUSED if rule.least > Level.OPEN else ()
    if call.name == "health":  # its 503 is an answer, and looks like the other one
        failing = {"description": "a restart may help; the reasons say why", "content": _said(call)["content"]}
        return {"503": failing}
    content = {MEDIA_TYPE: {"schema": _ref(Problem)}}
    return {str(status): {"description": when, "content": content} for status, when in (*call.errors, *refused)}


def _security(rule: Rule) -> list[Json]:
    """The ways to be let in, any of which will do; an empty one: without a login. `without_login` may open more."""
    if rule.least is Level.OPEN:
        return [{}]
    if rule.method == "POST":
        return [{"session": [], "csrf": []}]
    return [{"basic": []}, {"session": []}]


def _tag(path: str) -> str:
    for word in ("alarms", "bays", "events"):
        if f"/{word}" in path:
            return word
    return "bays" if path == "/api/state" else "gateway"


def _in_path(path: str) -> Iterable[Json]:
    meanings = {"bay": "name of the bay", "alarm": "id of the alarm, `bay1.camera_down` or `broker_lost`"}
    for name, meaning in meanings.items():
        if f"{{{name}}}" in path:
            schema = {"type": "string", "minLength": 1}
            yield {"name": name, "in": "path", "required": True, "description": meaning, "schema": schema}


def _in_query(query: Query) -> Json:
    schema: Json = {"type": "string", "maxLength": 0}
    if query.least is not None:
        schema = {"type": "integer", "minimum": query.least, "maximum": query.most or MAX_NUMBER}
        schema |= {"default": query.default}
    parameter: Json = {"name": query.name, "in": "query", "required": False, "description": query.meaning}
    if query.least is None:
        parameter["allowEmptyValue"] = True
    return parameter | {"schema": schema}


def _ref(model: type[BaseModel]) -> Json:
    return {"$ref": f"#/components/schemas/{model.__name__}"}


def markdown() -> str:
    """The calls with their roles, for docs/hmi-api.md."""
    rows = [f"| {call.method} | `{call.path}` | {_rule(call).least.role} | {call.summary} |" for call in CALLS]
    return "\n".join(["| method | address | role | answers |", "|---|---|---|---|", *rows]) + "\n"
