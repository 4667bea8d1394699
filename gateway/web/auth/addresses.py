"""Registers the addresses of the web process: one entry holds an address's path, role, limits and OpenAPI description.

FastAPI's routes and the security middleware's rules are both made from these entries, so no route exists without a
rule.
"""

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import reduce
from json import JSONDecodeError
from operator import or_
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, TypeVar, get_args

from fastapi.routing import APIRoute, APIWebSocketRoute
from pydantic import BeforeValidator, Field
from pydantic_core import from_json
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Mount

from gateway.web.auth.access import BODY_BYTES, Level, Rule
from gateway.web.auth.page_files import PageFiles
from gateway.web.auth.refusals import PROBLEM_CONTENT

REFUSALS = {401: "needs a login", 403: "the role is not enough, or the request is not from the gateway's own pages"}
Endpoint = TypeVar("Endpoint", bound=Callable[..., Any])


@dataclass(frozen=True, slots=True)
class Description:
    """OpenAPI's part of an address. `model`: of the JSON answer; `media`: of one that is not JSON."""

    operation_id: str
    model: Any = None
    media: str | None = None
    errors: Mapping[int, str] = field(default_factory=dict)  # status: when
    failing: Mapping[int, str] = field(default_factory=dict)  # statuses whose answer is `model`, too
    empty: Mapping[int, str] = field(default_factory=dict)  # statuses without a body
    query: tuple[dict[str, Any], ...] = ()  # parameters that FastAPI does not read


class AddressGroup:
    """A group of addresses below `prefix`."""

    def __init__(self, prefix: str = "") -> None:
        self._prefix = prefix
        self.routes: list[BaseRoute] = []
        self.rules: list[Rule] = []

    def _http(
        self, rule: Rule, described: Callable[[Any], Description] | None = None
    ) -> Callable[[Endpoint], Endpoint]:
        """`described` gets what the endpoint returns."""
        rule = replace(rule, path=self._prefix + rule.path)

        def register(endpoint: Endpoint) -> Endpoint:
            self.rules.append(rule)
            openapi: dict[str, Any] = {"include_in_schema": False}
            if described is not None:
                openapi = _openapi(rule, described(endpoint.__annotations__["return"]))
            self.routes.append(_JsonRoute(rule.path, endpoint, methods=[rule.method], **openapi))
            return endpoint

        return register


class ApiAddresses(AddressGroup):
    """Addresses for programs: each is described, with the model that its endpoint returns, or by `media` where that is
    not JSON. `least`: of each that has no other; `errors`: what may go wrong at each, but where an address has an empty
    text for it."""

    def __init__(self, prefix: str = "", *, least: Level, errors: Mapping[int, str] | None = None) -> None:
        super().__init__(prefix)
        self._least = least
        self._errors = errors or {}

    def get(
        self,
        path: str,
        operation_id: str,
        summary: str,
        *,
        least: Level | None = None,
        exports: bool = False,
        **more: Any,
    ) -> Callable[[Endpoint], Endpoint]:
        return self._described(Rule("GET", path, self._of(least), summary, exports=exports), operation_id, **more)

    def post(
        self,
        path: str,
        operation_id: str,
        summary: str,
        *,
        least: Level | None = None,
        body_bytes: int = BODY_BYTES,
        audited: bool = True,
        **more: Any,
    ) -> Callable[[Endpoint], Endpoint]:
        rule = Rule("POST", path, self._of(least), summary, body_bytes, audited)
        return self._described(rule, operation_id, {400: "the body is not what is described here"}, **more)

    def delete(
        self, path: str, operation_id: str, summary: str, *, audited: bool = True, **more: Any
    ) -> Callable[[Endpoint], Endpoint]:
        """Its body is not read."""
        return self._described(Rule("DELETE", path, self._least, summary, audited=audited), operation_id, **more)

    def _of(self, least: Level | None) -> Level:
        return self._least if least is None else least

    def _described(
        self, rule: Rule, operation_id: str, usual: Mapping[int, str] | None = None, /, **more: Any
    ) -> Callable[[Endpoint], Endpoint]:
        """`more`: of the `Description`, but for its model."""
        named = {**self._errors, **(usual or {}), **more.pop("errors", {})}
        errors = {status: when for status, when in named.items() if when}

        def description(returned: Any) -> Description:
            kinds = get_args(returned) if isinstance(returned, UnionType) else (returned,)
            models = [kind for kind in kinds if kind is not Response]
            model = reduce(or_, models) if models else None
            return Description(operation_id, model, errors=errors, **more)

        return self._http(rule, description)


class Addresses(AddressGroup):
    """Those of the pages themselves: they are not described."""

    def get(self, path: str, least: Level, summary: str) -> Callable[[Endpoint], Endpoint]:
        return self._http(Rule("GET", path, least, summary))

    def post(
        self, path: str, least: Level, summary: str, *, body_bytes: int = BODY_BYTES, audited: bool = True
    ) -> Callable[[Endpoint], Endpoint]:
        return self._http(Rule("POST", path, least, summary, body_bytes, audited))

    def web_socket(self, path: str, least: Level, summary: str) -> Callable[[Endpoint], Endpoint]:
        def register(endpoint: Endpoint) -> Endpoint:
            self.rules.append(Rule("WS", self._prefix + path, least, summary))
            self.routes.append(APIWebSocketRoute(self._prefix + path, endpoint))
            return endpoint

        return register

    def files(self, path: str, directory: Path, least: Level, summary: str) -> None:
        self.rules.append(Rule("GET", f"{path}/{{path:path}}", least, summary))
        self.routes.append(Mount(path, PageFiles(directory=directory)))


def whole_number(least: int, most: int) -> BeforeValidator:
    """For numbers in an address: digits only, where pydantic would take " 1.0" and other scripts' digits, too."""

    def checked(value: str | int) -> int:
        text = str(value)  # a number where it is the default
        if not (text.isascii() and text.isdigit() and len(text) < 20 and least <= int(text) <= most):
            raise ValueError(f"a whole number from {least} to {most}")
        return int(text)

    return BeforeValidator(checked, json_schema_input_type=Annotated[int, Field(ge=least, le=most)])


class _JsonRequest(Request):
    """Its body is JSON, regardless of Content-Type, and no body is an empty object."""

    @property
    def headers(self) -> Headers:
        others = [(name, value) for name, value in self.scope["headers"] if name != b"content-type"]
        return Headers(raw=[*others, (b"content-type", b"application/json")])

    async def body(self) -> bytes:
        return await super().body() or b"{}"

    async def json(self) -> Any:
        """Strict about text, where `json` would take half of a surrogate pair."""
        try:
            return from_json(await self.body())
        except ValueError as error:
            raise JSONDecodeError(str(error), "", 0) from None


class _JsonRoute(APIRoute):
    def get_route_handler(self) -> Callable[[Request], Awaitable[Response]]:  # type: ignore[override]
        handler = super().get_route_handler()

        async def handle(request: Request) -> Response:
            return await handler(_JsonRequest(request.scope, request.receive))

        return handle


def _openapi(rule: Rule, described: Description) -> dict[str, Any]:
    """What FastAPI's route needs to describe itself."""
    refusals = REFUSALS if rule.least > Level.OPEN else {}
    responses: dict[int, dict[str, Any]] = {200: {"description": rule.summary}}
    if described.media is not None:
        responses[200]["content"] = {described.media: {}}
    for status, when in sorted({**described.errors, **refusals}.items()):
        responses[status] = {"description": when, "content": PROBLEM_CONTENT}
    for status, when in described.failing.items():
        responses[status] = {"description": when, "model": described.model}
    for status, when in described.empty.items():
        responses[status] = {"description": when}
    extra = {"x-role": rule.least.role, "security": _security(rule)}
    if described.query:
        extra["parameters"] = list(described.query)
    plain = {"response_class": Response} if described.media is not None else {}
    return {
        "operation_id": described.operation_id,
        "summary": rule.summary,
        "tags": [_tag(rule.path)],
        "response_model": described.model,
        "responses": responses,
        "openapi_extra": extra,
        **plain,
    }


def _security(rule: Rule) -> list[dict[str, list[str]]]:
    """The ways to be let in, any of which will do; an empty one: without a login. `without_login` may open more."""
    if rule.least is Level.OPEN:
        return [{}]
    return [{"session": [], "csrf": []}] if rule.acts else [{"basic": []}, {"session": []}]


def _tag(path: str) -> str:
    for word in ("alarms", "bays", "events", "setup"):
        if f"/{word}" in path:
            return word
    return "bays" if path == "/api/state" else "gateway"
