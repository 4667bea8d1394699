"""What outlives the fleet page's process: each gateway's last status, what has changed, and the trends of its bays.

One seam between the page and what keeps them: a file (`sqlite_store`) or a server (`postgresql_store`), with the same
tables.
"""

from collections.abc import Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from typing import Protocol

from gateway.fleet.roster import GatewayChange, Key, Known
from gateway.fleet.trends import TREND_PERIODS, Sample

MAX_CHANGES = 500_000  # some 60 MB; the oldest go first
MAX_CHANGES_EACH = 1000  # of a gateway: one that changes without end takes nothing from the others
SHOWN_CHANGES = 50
SHOWN_SAMPLES = 64 * TREND_PERIODS  # of a gateway


@dataclass(frozen=True, slots=True)
class News:
    """What is to be kept: together or not at all."""

    known: Sequence[Known] = ()
    changes: Sequence[GatewayChange] = ()
    gone: Sequence[Key] = ()
    samples: Sequence[Sample] = ()


@dataclass(frozen=True, slots=True)
class Past:
    """Of a gateway: its newest changes, the newest first, and the samples of its bays, in order."""

    changes: Sequence[GatewayChange] = ()
    samples: Sequence[Sample] = ()


class StoreSession(Protocol):
    """One request at a time. Raises LinkError when nothing can be read or written now."""

    async def read(self) -> dict[Key, Known]:
        """As they were kept. None of them is alive before it is heard. Raises ConfigError where only the operator can
        mend what was kept."""

    async def keep(self, news: News) -> None: ...

    async def past(self, key: Key) -> Past: ...


class FleetStore(Protocol):
    def opened(self) -> AbstractAsyncContextManager[StoreSession]:
        """Raises LinkError, also from the body."""
