"""How this gateway was started, and how it is started again: what the settings page must know of the command line."""

import asyncio
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from gateway.config import GatewayConfig


@dataclass(slots=True)
class Restart:
    """A request to end cleanly, as SIGTERM does, and to start again. `stop`: ends the gateway; whoever waits for that
    end looks at `requested`."""

    stop: asyncio.Event
    requested: bool = False

    def request(self) -> None:
        self.requested = True
        self.stop.set()


@dataclass(frozen=True, slots=True)
class Startup:
    """`overrides`: of the file, from the command line. `restart`: None: impossible. `warnings`: of settings that are
    legal and make no sense."""

    overrides: Mapping[str, Any] = field(default_factory=dict)
    restart: Restart | None = None
    warnings: Callable[[GatewayConfig], Iterable[str]] = lambda _: ()

    @property
    def file_overrides(self) -> Mapping[str, Any]:
        """Without other bays than the file's: these share the devices of the file's only bay where they are
        simulated."""
        return {key: value for key, value in self.overrides.items() if key != "bays"}

    @property
    def starts_again(self) -> bool:
        """Is the end that has begun a restart?"""
        return self.restart is not None and self.restart.requested

    def restart_of(self, config: GatewayConfig) -> Callable[[], None] | None:
        """None: the pages may not, or nobody can."""
        return self.restart.request if self.restart is not None and config.hmi.setup_page else None


ALONE = Startup()
"""Of a gateway that knows nothing of a command line."""
