"""The addresses of a running gateway's pages, called as a page calls them: with its session's token."""

import http.client
import json
import ssl
from types import TracebackType
from typing import Any, Self
from urllib.parse import urlsplit


class PageClient:
    """A context manager. `url`: of the pages, as the gateway prints it; `trusting`: whose certificate."""

    def __init__(self, url: str, trusting: ssl.SSLContext | None = None) -> None:
        parts = urlsplit(url)
        self._origin, self._host = f"{parts.scheme}://{parts.netloc}", parts.netloc
        self._connection = (
            http.client.HTTPConnection(self._host, timeout=100)
            if trusting is None
            else http.client.HTTPSConnection(self._host, timeout=100, context=trusting)
        )

    def __enter__(self) -> Self:
        session = self.get("/api/session")
        self._headers = {
            "Content-Type": "application/json",
            "Origin": self._origin,
            "X-CSRF-Token": session["csrf"],
        }
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._connection.close()

    def get(self, path: str, status: int = 200) -> Any:
        return json.loads(self.data(path, status))

    def data(self, path: str, status: int = 200) -> bytes:
        self._connection.request("GET", path)
        return self._body(status)

    def post(self, path: str, body: object = None, status: int = 200) -> Any:
        self._connection.request("POST", path, json.dumps(body or {}), self._headers)
        return json.loads(self._body(status))

    def posted(self, path: str, body: object) -> int:
        """The answer's status, whatever it is."""
        self._connection.request("POST", path, json.dumps(body), self._headers)
        response = self._connection.getresponse()
        response.read()
        return response.status

    def _body(self, status: int) -> bytes:
        response = self._connection.getresponse()
        body = response.read()
        assert response.status == status, (response.status, body[:500])
        return body
