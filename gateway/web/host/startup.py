"""How this gateway was started, and how it is started again: what the settings page must know of the command line."""

import asyncio
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from hashlib import sha256
from typing import Any

import msgspec

from gateway.config import GatewayConfig
from gateway.web.auth.sessions import Session

LOGIN = "LOADING_GATEWAY_LOGIN"
"""The environment variable from one start to the next. No login can be used from it: it has only a hash of its id."""


@dataclass(slots=True)
class Restart:
    """A request to end cleanly, as SIGTERM does, and to start again. `stop`: ends the gateway; whoever waits for that
    end looks at `requested`, and gives the `environment` to the next start."""

    stop: asyncio.Event
    requested: bool = False
    environment: dict[str, str] = field(default_factory=dict)

    def request(self, in_force: Callable[[], GatewayConfig], login: Session | None) -> None:
        if login is not None:
            self.environment[LOGIN] = msgspec.json.encode((_users(in_force()), login)).decode()
        self.requested = True
        self.stop.set()


@dataclass(frozen=True, slots=True)
class Startup:
    """`overrides`: of the file, from the command line. `restart`: None: impossible. `warnings`: of settings that are
    legal and make no sense. `login`: as the start before has given it; empty: none."""

    overrides: Mapping[str, Any] = field(default_factory=dict)
    restart: Restart | None = None
    warnings: Callable[[GatewayConfig], Iterable[str]] = lambda _: ()
    login: str = ""

    @property
    def file_overrides(self) -> Mapping[str, Any]:
        """Without other bays than the file's: these share the devices of the file's only bay where they are
        simulated."""
        return {key: value for key, value in self.overrides.items() if key != "bays"}

    @property
    def starts_again(self) -> bool:
        """Is the end that has begun a restart?"""
        return self.restart is not None and self.restart.requested

    def restart_of(self, in_force: Callable[[], GatewayConfig]) -> Callable[[Session | None], None] | None:
        """None: the pages may not, or nobody can."""
        if self.restart is None or not in_force().hmi.setup_page:
            return None
        return partial(self.restart.request, in_force)

    def login_of(self, config: GatewayConfig) -> Session | None:
        """The login that outlives this restart: none where the users, their passwords or roles have changed."""
        try:
            users, login = msgspec.json.decode(self.login, type=tuple[str, Session])
        except msgspec.DecodeError:
            return None
        return login if users == _users(config) else None


def _users(config: GatewayConfig) -> str:
    """A digest of them."""
    return sha256(config.hmi.model_dump_json(include={"users"}).encode()).hexdigest()


ALONE = Startup()
"""Of a gateway that knows nothing of a command line."""
