"""The addresses of a running gateway's pages, called as a page calls them: with its session's token."""

import http.client
import json
from types import TracebackType
from typing import Any, Self
from urllib.parse import urlsplit


class PageClient:
    """A context manager. `url`: of the pages, as the gateway prints it."""

    def __init__(self, url: str) -> None:
        self._host = urlsplit(url).netloc
        self._connection = http.client.HTTPConnection(self._host, timeout=100)

    def __enter__(self) -> Self:
        session = self.get("/api/session")
        self._headers = {
            "Content-Type": "application/json",
            "Origin": f"http://{self._host}",
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

    def _body(self, status: int) -> bytes:
        response = self._connection.getresponse()
        body = response.read()
        assert response.status == status, (response.status, body[:500])
        return body
