"""Exceptions of the addresses as problem details (RFC 9457), for every server of pages."""

from collections.abc import Callable
from typing import Any

from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response

from gateway.errors import ConfigError, GatewayError, LinkError
from gateway.web.auth.refusals import AGAIN, RefusalError, problem

Status = tuple[type[GatewayError], int, str]  # what is raised; status and code of its answer, 204: without a body
_USUAL: tuple[Status, ...] = ((ConfigError, 422, "settings"), (LinkError, 503, "link"))


def handlers(*statuses: Status) -> dict[Any, Callable[..., Any]]:
    """FastAPI's `exception_handlers`. Of `statuses`, before the usual ones, the first that matches counts."""

    async def of_gateway(_: Request, error: Exception) -> Response:
        """Raises again what no route should raise: a fault in the software."""
        if isinstance(error, RefusalError):
            return problem(error.status, error.code, str(error), error.headers, error.members)
        for kind, status, code in (*statuses, *_USUAL):
            if isinstance(error, kind):
                if status == 204:
                    return Response(status_code=204)
                return problem(status, code, str(error), AGAIN if status == 503 else None)
        raise error

    return {
        HTTPException: _of_http,
        RequestValidationError: _of_validation,
        GatewayError: of_gateway,
        Exception: _of_fault,
    }


async def _of_http(_: Request, error: Exception) -> Response:
    """Starlette's own: no such address, not this method."""
    assert isinstance(error, HTTPException)
    return problem(error.status_code, "http", str(error.detail), error.headers)


async def _of_validation(_: Request, error: Exception) -> Response:
    """Every fault with its place. What a body contains is not repeated."""
    assert isinstance(error, RequestValidationError)
    faults = error.errors()
    if faults[0]["loc"][0] != "body":
        return problem(400, "query", "; ".join(map(_query_fault, faults))[:1000])
    return problem(400, "body", "; ".join(map(_body_fault, faults))[:1000])


async def _of_fault(_: Request, error: Exception) -> Response:
    """An unexpected exception; its text is not shown."""
    return problem(500, "fault", "a fault in the software; see the gateway's log")


def _query_fault(fault: dict[str, Any]) -> str:
    return f"{_place(fault)} = {str(fault['input'])[:40]!r}: {_message(fault)}"


def _body_fault(fault: dict[str, Any]) -> str:
    return f"{_place(fault)}: {_message(fault)}"


def _place(fault: dict[str, Any]) -> str:
    if fault["type"] == "json_invalid":
        return "body"
    where: tuple[str, ...] = fault["loc"]
    return ".".join(map(str, where[1:])) or "body"


def _message(fault: dict[str, Any]) -> str:
    context = fault.get("ctx")
    return str(context["error"]) if isinstance(context, dict) and "error" in context else str(fault["msg"])
