"""Who may call what: the rule of each address, and which rule holds for a request. Pure.

A request without a rule is never answered. The rules are registered with their routes: see `addresses`.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Literal

BODY_BYTES = 64 * 1024
PROFILE_BYTES = 256 * 1024
LOGIN_BYTES = 4 * 1024


class Level(IntEnum):
    """A role as a level; each may do what the ones before it may."""

    OPEN = 0  # without a login
    DRIVER = 1
    VIEWER = 2
    TECHNICIAN = 3

    @property
    def role(self) -> str:
        """As configuration and pages call it."""
        return "none" if self is Level.OPEN else self.name.lower()

    @staticmethod
    def of(role: str) -> "Level":
        """Raises KeyError for a role that there is not."""
        return Level.OPEN if role == "none" else Level[role.upper()]


Method = Literal["GET", "POST", "DELETE", "WS"]


@dataclass(frozen=True)
class Rule:
    """`path` as a route writes it. POST and DELETE need a login, too, unless the level is OPEN (or all are technicians
    without a login)."""

    method: Method
    path: str
    least: Level
    summary: str
    body_bytes: int = 0  # of a POST, at most
    audited: bool = True  # False: it changes nothing but what its own page shows
    exports: bool = False  # a GET that is audited

    @cached_property
    def pattern(self) -> re.Pattern[str]:
        from starlette.routing import compile_path  # noqa: PLC0415 - not in the main process, which matches no address

        return re.compile(compile_path(self.path)[0].pattern, re.DOTALL)

    @property
    def acts(self) -> bool:
        """Not for looking: needs the token against forged requests."""
        return self.method in ("POST", "DELETE")

    @property
    def page(self) -> bool:
        """A page for a person, who is redirected to the login instead of getting an error."""
        return self.method == "GET" and not self.path.startswith(("/api/", "/static/", "/healthz", "/metrics"))

    @property
    def for_programs(self) -> bool:
        """May be requested with HTTP Basic."""
        return self.method == "GET" and self.path.startswith(("/api/", "/metrics"))


@dataclass(frozen=True, slots=True)
class Match:
    """The rule of a request; or none, and the methods for which the path has one."""

    rule: Rule | None
    methods: tuple[Method, ...] = ()


def find(method: str, path: str, rules: Iterable[Rule]) -> Match:
    """The first rule that matches. HEAD is a GET whose answer is not read."""
    method_name = "GET" if method == "HEAD" else method
    others: list[Method] = []
    for rule in rules:
        if rule.pattern.fullmatch(path):
            if rule.method == method_name:
                return Match(rule)
            others.append(rule.method)
    return Match(None, tuple(others))
