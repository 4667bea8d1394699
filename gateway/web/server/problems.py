"""How the programs' side says what went wrong: problem details after RFC 9457. Uses Starlette."""

from collections.abc import Mapping
from http import HTTPStatus

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from gateway.web.server.models import Problem

MEDIA_TYPE = "application/problem+json"


def problem(status: int, error: str, detail: str, headers: Mapping[str, str] | None = None) -> Response:
    """`error`: a short code for programs; `detail`: in words, for people."""
    body = Problem(title=HTTPStatus(status).phrase, status=status, detail=detail, error=error)
    return JSONResponse(body.model_dump(), status, headers=headers, media_type=MEDIA_TYPE)


async def of_starlette(_: Request, error: Exception) -> Response:
    """For Starlette's own errors, and for those nobody foresaw, whose text is nobody's business."""
    if isinstance(error, HTTPException):
        return problem(error.status_code, "http", str(error.detail), error.headers)
    return problem(500, "fault", "a fault in the software; the gateway's log says more")
