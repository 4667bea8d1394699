"""Who may call what: one table. What does not stand in it is answered to nobody. Pure.

An address of the pages is a row here and a route in `web`; `protected` refuses to start with a route that has no row.
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
    """How far somebody is let in; each may do what the ones before it may."""

    OPEN = 0  # everybody
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


Method = Literal["GET", "POST", "WS"]
_PARAMETER = re.compile(r"\{\w+(:path)?\}")


@dataclass(frozen=True)
class Rule:
    """`path` as a route writes it. POST needs a login, too, unless its level is OPEN (or everybody is technician)."""

    method: Method
    path: str
    least: Level
    says: str
    body_bytes: int = 0  # of a POST, at most
    tries: bool = False  # a POST that changes nothing but what its own page looks at: not told

    @cached_property
    def pattern(self) -> re.Pattern[str]:
        parts = _PARAMETER.split(self.path)  # text, parameter's kind, text, ...
        kinds = {None: "[^/]+", ":path": ".*"}
        return re.compile("".join(kinds[p] if n % 2 else re.escape(p or "") for n, p in enumerate(parts)), re.DOTALL)

    @property
    def page(self) -> bool:
        """Looked at by a person, who is shown the way to the login rather than an error."""
        return self.method == "GET" and not self.path.startswith(("/api/", "/static/", "/healthz", "/metrics"))

    @property
    def for_programs(self) -> bool:
        """May be asked for with HTTP Basic."""
        return self.method == "GET" and self.path.startswith(("/api/", "/metrics"))


def _get(path: str, least: Level, says: str) -> Rule:
    return Rule("GET", path, least, says)


def _post(path: str, least: Level, says: str, body_bytes: int = BODY_BYTES) -> Rule:
    return Rule("POST", path, least, says, body_bytes)


def _try(path: str, says: str, body_bytes: int = BODY_BYTES) -> Rule:
    return Rule("POST", path, Level.TECHNICIAN, says, body_bytes, tries=True)


RULES: tuple[Rule, ...] = (
    _get("/login", Level.OPEN, "the login page"),
    _get("/static/{path:path}", Level.OPEN, "scripts, styles and symbols of the pages; nothing of the plant"),
    _get("/favicon.ico", Level.OPEN, "the pages' symbol"),
    _get("/healthz", Level.OPEN, "works, or why not; for a watchdog"),
    _get("/api/session", Level.OPEN, "who is logged in, and the token against forged requests"),
    _post("/api/login", Level.OPEN, "log in", LOGIN_BYTES),
    _post("/api/logout", Level.OPEN, "log out", LOGIN_BYTES),
    _get("/driver", Level.DRIVER, "the driver's display of the first bay"),
    _get("/driver/{bay}", Level.DRIVER, "the driver's display"),
    Rule("WS", "/api/driver", Level.DRIVER, "what the driver's display shows, live"),
    _get("/", Level.VIEWER, "the operator's page"),
    Rule("WS", "/api/live", Level.VIEWER, "what the operator's page shows, live"),
    _get("/metrics", Level.VIEWER, "for Prometheus"),
    _get("/api/openapi.json", Level.VIEWER, "the description of the programs' side"),
    _get("/api/state", Level.VIEWER, "all bays"),
    _get("/api/bays/{bay}/state", Level.VIEWER, "one bay"),
    _get("/api/bays/{bay}/events", Level.VIEWER, "what happened in one bay"),
    _get("/api/bays/{bay}/registers", Level.VIEWER, "the registers as the PLC reads them now"),
    _get("/api/bays/{bay}/snapshot.jpg", Level.VIEWER, "the newest picture"),
    _get("/api/bays/{bay}/snapshot.png", Level.VIEWER, "the newest picture, without loss"),
    _get("/api/bays/{bay}/picture", Level.VIEWER, "the pages' pictures"),
    _get("/api/events", Level.VIEWER, "what happened"),
    _get("/api/alarms", Level.VIEWER, "the alarms with their states"),
    _post("/api/alarms/{alarm}/acknowledge", Level.VIEWER, "acknowledge an alarm"),
    _post("/api/alarms/{alarm}/reset", Level.VIEWER, "end a latched alarm whose cause is gone"),
    _post("/api/alarms/{alarm}/shelve", Level.TECHNICIAN, "put an alarm aside for a while"),
    _post("/api/alarms/{alarm}/unshelve", Level.TECHNICIAN, "take a shelved alarm back"),
    _post("/api/alarms/{alarm}/remove", Level.TECHNICIAN, "take an alarm out of service"),
    _post("/api/alarms/{alarm}/restore", Level.TECHNICIAN, "put an alarm back into service"),
    _get("/tune/{bay}", Level.TECHNICIAN, "the technician's page"),
    _post("/api/bays/{bay}/function-check", Level.TECHNICIAN, "begin or end a function check"),
    _try("/api/bays/{bay}/freeze", "keep the newest frame to try settings on"),
    _try("/api/bays/{bay}/record", "keep the frames of the next few seconds"),
    _get("/api/bays/{bay}/taken", Level.TECHNICIAN, "the kept frames and recordings"),
    _get("/api/bays/{bay}/taken/{name}/{frame}", Level.TECHNICIAN, "one of these frames as a picture"),
    _try("/api/bays/{bay}/trial", "try settings on a kept frame or a recording"),
    _get("/api/bays/{bay}/trial/{number}/{panel}", Level.TECHNICIAN, "a stage of a trial as a picture"),
    _try("/api/bays/{bay}/eyedropper", "the red ranges that would admit a place in a frame"),
    _get("/api/bays/{bay}/profile", Level.TECHNICIAN, "the settings in force, and what may be set"),
    _get("/api/bays/{bay}/profile/export", Level.TECHNICIAN, "the settings in force as a file"),
    _try("/api/bays/{bay}/profile/export", "other settings as a file"),
    _try("/api/bays/{bay}/profile/import", "read settings from a file", PROFILE_BYTES),
    _try("/api/bays/{bay}/profile/diff", "what saving would change"),
    _post("/api/bays/{bay}/profile/apply", Level.TECHNICIAN, "let settings go live"),
    _post("/api/bays/{bay}/profile/undo", Level.TECHNICIAN, "go back to the settings before"),
    _post("/api/bays/{bay}/profile/save", Level.TECHNICIAN, "write settings into the configuration"),
)


@dataclass(frozen=True, slots=True)
class Match:
    """The row for a call; or none, and the methods under which there is one."""

    rule: Rule | None
    methods: tuple[Method, ...] = ()


def find(method: str, path: str, rules: Iterable[Rule] = RULES) -> Match:
    """The first row that fits. HEAD is a GET whose answer is not read."""
    wanted = "GET" if method == "HEAD" else method
    others: list[Method] = []
    for rule in rules:
        if rule.pattern.fullmatch(path):
            if rule.method == wanted:
                return Match(rule)
            others.append(rule.method)
    return Match(None, tuple(others))


def markdown() -> str:
    """The table for the documentation, by level."""
    lines = ["| who | method | address | what |", "|---|---|---|---|"]
    names = {Level.OPEN: "everybody", Level.DRIVER: "driver", Level.VIEWER: "viewer", Level.TECHNICIAN: "technician"}
    for rule in sorted(RULES, key=lambda rule: rule.least):
        lines.append(f"| {names[rule.least]} | {rule.method} | `{rule.path}` | {rule.says} |")
    return "\n".join(lines)
