"""The OpenAPI description: valid, complete, and consistent with rules and routes."""

import json
from typing import Any

import pytest
from openapi_spec_validator import validate

from gateway.web.auth.access import Level
from gateway.web.server import openapi
from gateway.web.server.app import ROUTES, RULES

DOCUMENT = openapi.document(ROUTES)
OPERATIONS = [
    pytest.param(path, method, operation, id=f"{method} {path}")
    for path, methods in DOCUMENT["paths"].items()
    for method, operation in methods.items()
]
NOT_DESCRIBED = {
    "of a browser's login": {"/api/session", "/api/login", "/api/logout"},
    "texts and files of the pages": {
        *("/static/{path:path}", "/favicon.ico", "/api/languages", "/api/languages/{code}", "/api/pages")
    },
    "pictures and live views come with the page's own state": {
        "/api/bays/{bay}/picture", "/api/live", "/api/alarms/live", "/api/driver",
    },
    "devices tried while a page is open": {
        "/api/setup/devices", "/api/setup/network-cameras", "/api/setup/streams", "/api/setup/camera-password",
        "/api/setup/flash", "/api/setup/look", "/api/setup/look/{number}",
        "/api/setup/look/{number}/picture",
        "/api/setup/look/{number}/end", "/api/setup/plc", "/api/setup/broker",
    },
}  # fmt: skip


@pytest.mark.long
@pytest.mark.one_interpreter
def test_it_is_valid() -> None:
    validate(DOCUMENT)
    assert DOCUMENT["openapi"].startswith("3.1")
    assert json.loads(json.dumps(DOCUMENT)) == DOCUMENT


def test_every_address_but_pages_and_a_named_few_is_described() -> None:
    described = {(method.upper(), path) for path, methods in DOCUMENT["paths"].items() for method in methods}
    registered = {(rule.method, rule.path) for rule in RULES}
    named = set().union(*NOT_DESCRIBED.values())
    assert {(rule.method, rule.path) for rule in RULES if not rule.page and rule.path not in named} == described
    assert named <= {path for _, path in registered}
    assert not named & {path for _, path in described}


@pytest.mark.parametrize(("path", "method", "operation"), OPERATIONS)
def test_every_operation_states_its_role_and_authentication(path: str, method: str, operation: dict[str, Any]) -> None:
    least = next(rule.least for rule in RULES if (rule.method, rule.path) == (method.upper(), path))
    assert operation["x-role"] == least.role
    ways = {
        (Level.OPEN, "get"): [{}],
        (Level.OPEN, "post"): [{}],
        (Level.VIEWER, "get"): [{"basic": []}, {"session": []}],
        (Level.TECHNICIAN, "get"): [{"basic": []}, {"session": []}],
        (Level.VIEWER, "post"): [{"session": [], "csrf": []}],
        (Level.TECHNICIAN, "post"): [{"session": [], "csrf": []}],
        (Level.TECHNICIAN, "delete"): [{"session": [], "csrf": []}],
    }
    assert operation["security"] == ways[least, method]
    assert {"401", "403"} <= set(operation["responses"]) or least is Level.OPEN
    for status, response in operation["responses"].items():
        if status == "204":
            assert "content" not in response
            continue
        kinds = list(response["content"])
        problem = int(status) >= 400 and path != "/healthz"
        assert (kinds == ["application/problem+json"]) == problem, status


def test_an_error_that_a_route_declares_is_described() -> None:
    """FastAPI's own 422 is left out: what is wrong is 400 here."""
    paths = DOCUMENT["paths"]
    assert "422" in paths["/api/bays/{bay}/profile/apply"]["post"]["responses"]
    assert "422" in paths["/api/setup/save"]["post"]["responses"]
    assert "422" not in paths["/api/bays/{bay}/record"]["post"]["responses"]
    assert paths["/api/bays/{bay}/function-check"]["post"]["x-role"] == "technician"


def test_ids_are_unique_and_what_is_referred_to_is_there() -> None:
    ids = [operation.values[2]["operationId"] for operation in OPERATIONS]  # type: ignore[index]
    assert len(set(ids)) == len(ids)
    schemas = DOCUMENT["components"]["schemas"]
    refs = {text.rsplit("/", 1)[1] for text in _refs(DOCUMENT)}
    assert refs <= set(schemas)
    assert [name for name in schemas if "__" in name] == []  # two models of one name
    live_views = {"LiveView", "AlarmsLiveView", "DriverView", "FrameView"}
    assert live_views <= set(schemas)
    assert set(schemas) - refs <= live_views


def _refs(part: Any) -> list[str]:
    if isinstance(part, dict):
        own = [part["$ref"]] if isinstance(part.get("$ref"), str) else []
        return own + [ref for value in part.values() for ref in _refs(value)]
    return [ref for value in part for ref in _refs(value)] if isinstance(part, list) else []


def test_every_field_of_every_model_is_described_by_its_name_or_in_words() -> None:
    """Units stand in the names: a number without one is a count, a pixel, or says what it is."""
    bare = [
        f"{model}.{name}"
        for model, schema in DOCUMENT["components"]["schemas"].items()
        for name, field in schema.get("properties", {}).items()
        if field.get("type") == "number" and "description" not in field
        if not name.endswith(("_ms", "_px", "_mm", "_mm_s", "_rad", "_hz", "_deg", "_s")) and name not in ("u", "v")
    ]
    assert bare == []


@pytest.mark.long
@pytest.mark.one_interpreter
def test_the_cookie_is_named_as_it_is() -> None:
    schemes = openapi.document(ROUTES, "__Host-north-session")["components"]["securitySchemes"]
    assert schemes["session"]["name"] == "__Host-north-session"
