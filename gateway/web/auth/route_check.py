"""Has every route a row in the table `access`? Uses Starlette."""

import re
from collections.abc import Iterable, Iterator, Sequence

from starlette.routing import BaseRoute, Mount, Route, WebSocketRoute

from gateway.web.auth.access import RULES, Rule


def without_rule(routes: Sequence[BaseRoute], rules: Iterable[Rule] = RULES) -> list[str]:
    """The routes, as `METHOD path`, that have no row of their own."""
    known = {(rule.method, _shape(rule.path)) for rule in rules}
    return [f"{method} {path}" for method, path in calls(routes) if (method, _shape(path)) not in known]


def calls(routes: Sequence[BaseRoute], before: str = "") -> Iterator[tuple[str, str]]:
    """Every method and path there is. A mounted application is one path with everything below it."""
    for route in routes:
        match route:
            case Route():
                methods = sorted(route.methods or {"(any)"})
                yield from ((method, before + route.path) for method in methods if method != "HEAD")
            case WebSocketRoute():
                yield "WS", before + route.path
            case Mount() if route.routes:
                yield from calls(route.routes, before + route.path)
            case Mount():
                yield "GET", before + route.path + "/{path:path}"
            case _:
                yield "(any)", f"{before}{route!r}"


def _shape(path: str) -> str:
    return re.sub(r"\{\w+(:\w+)?\}", lambda found: "{:path}" if found[1] == ":path" else "{}", path)
