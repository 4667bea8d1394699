"""Requests to an ASGI application without a server, as a server would make them."""

import asyncio
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

from starlette.types import ASGIApp, Message

Headers = list[tuple[bytes, bytes]]


@dataclass(frozen=True)
class Answer:
    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def text(self) -> str:
        return self.body.decode()

    @property
    def json(self) -> Any:
        return json.loads(self.body)


def scope(kind: str, path: str, headers: Headers, *, address: str, scheme: str = "http") -> dict[str, Any]:
    path, _, query = path.partition("?")
    return {
        "type": kind,
        "asgi": {"version": "3.0"},
        "http_version": "1.1",
        "scheme": scheme,
        "path": path,
        "raw_path": quote(path).encode(),
        "root_path": "",
        "query_string": query.encode(),
        "headers": headers,
        "client": (address, 40000),
        "server": ("10.0.0.5", 8080),
    }


async def answer_to(app: ASGIApp, method: str, scope: dict[str, Any], parts: Sequence[bytes]) -> Answer:
    """`parts`: the pieces in which the body arrives; none: it never does."""
    left = list(parts)
    sent: list[Message] = []

    async def receive() -> Message:
        if not left:
            await asyncio.Event().wait()
        return {"type": "http.request", "body": left.pop(0), "more_body": bool(left)}

    async def send(message: Any) -> None:
        sent.append(message)

    await app({**scope, "method": method}, receive, send)
    assert [message["type"] for message in sent[:1]] == ["http.response.start"]
    headers = {key.decode().lower(): value.decode() for key, value in sent[0]["headers"]}
    assert len(headers) == len(sent[0]["headers"]), f"a header twice: {sent[0]['headers']}"
    return Answer(sent[0]["status"], headers, b"".join(message.get("body", b"") for message in sent[1:]))
