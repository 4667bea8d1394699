"""The addresses at which a broker can be reached, in the order in which they are tried. No sockets: names are looked
up by `lookup`.

A round goes through all of them: first those that have not failed, the preferred broker's before the others', then
those that have, the longest ago first. One that accepts a connection has not failed any more.
"""

from collections.abc import AsyncGenerator, Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from gateway.errors import LinkError
from gateway.sinks.mqtt.broker import Broker
from gateway.sinks.mqtt.lookup import Address

Version = Literal["5", "3.1.1"]
LookUp = Callable[[str, int], Awaitable[Sequence[Address]]]
SETTLED_S = 3600.0  # a connection of this length to a preferred broker proves it; longest wait between two checks, too


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One address of a broker. `rank`: the broker's place in the configuration, 0 is the preferred one."""

    broker: Broker
    address: Address
    rank: int = 0

    def __str__(self) -> str:
        ip = str(self.address[4][0])
        return str(self.broker) if ip == self.broker.reached_at[0] else f"{self.broker} ({ip})"


class VersionChoice:
    """`next` is the version to connect with; report its result."""

    def __init__(self, configured: Literal["auto", "5", "3.1.1"]) -> None:
        self._fixed = configured != "auto"
        self._accepted = False
        self.next: Version = "5" if configured == "auto" else configured

    def accepted(self) -> None:
        """The broker has accepted `next`."""
        self._accepted = True

    def failed(self, *, certain: bool) -> bool:
        """It has not. `certain`: because it does not support that version. Returns whether `next` is another one."""
        if self._fixed or (self._accepted and not certain):
            return False
        self._accepted = False
        self.next = "3.1.1" if self.next == "5" else "5"
        return True


class Endpoints:
    """`protocol`: see `VersionChoice`; each address has a choice of its own, so that a hung node decides nothing about
    its neighbours."""

    def __init__(
        self, brokers: Sequence[Broker], look_up: LookUp, protocol: Literal["auto", "5", "3.1.1"] = "auto"
    ) -> None:
        self.brokers = tuple(brokers)
        self._look_up = look_up
        self._protocol = protocol
        self._versions: dict[Endpoint, VersionChoice] = {}
        self._failed: dict[Endpoint, None] = {}  # those that have, the longest ago first

    async def of(self, rank: int) -> list[Endpoint]:
        """Of one broker; what is known of addresses that its name no longer has is forgotten. Raises LinkError."""
        broker = self.brokers[rank]
        try:
            found = await self._look_up(*broker.reached_at)
        except LinkError as error:
            raise LinkError(f"{broker}: {error}") from error
        now = [Endpoint(broker, address, rank) for address in found]
        for gone in [known for known in self._versions if known.rank == rank and known not in now]:
            del self._versions[gone]
            self._failed.pop(gone, None)
        return now

    async def in_order(self, faults: list[LinkError]) -> AsyncGenerator[Endpoint, None]:
        """One round. Names that can't be looked up are added to `faults`."""
        failed_before: list[Endpoint] = []
        for rank in range(len(self.brokers)):
            try:
                found = await self.of(rank)
            except LinkError as error:
                faults.append(error)
                continue
            for endpoint in found:
                if endpoint in self._failed:
                    failed_before.append(endpoint)
                else:
                    yield endpoint
        for endpoint in sorted(failed_before, key=list(self._failed).index):
            yield endpoint

    def versions(self, endpoint: Endpoint) -> VersionChoice:
        return self._versions.setdefault(endpoint, VersionChoice(self._protocol))

    def forget(self, endpoint: Endpoint) -> None:
        """It is as if it had never been tried."""
        self._versions.pop(endpoint, None)
        self._failed.pop(endpoint, None)

    def failed(self, endpoint: Endpoint) -> None:
        self._failed.pop(endpoint, None)
        self._failed[endpoint] = None

    def accepted(self, endpoint: Endpoint) -> None:
        self._failed.pop(endpoint, None)


class ReturnPace:
    """How long to wait before the preferred brokers are checked. After a return that did not last, twice as long."""

    def __init__(self, first_s: float) -> None:
        self._first_s = first_s
        self._returned = False
        self.wait_s = first_s

    def returned(self) -> None:
        """A connection is ended for the sake of a preferred broker."""
        self._returned = True

    def connected(self, rank: int) -> None:
        """To the broker with this rank. Not to the preferred one: the return has failed."""
        if rank:
            self.ended(0.0)

    def ended(self, lasted_s: float) -> None:
        """A connection was lost."""
        if lasted_s >= SETTLED_S:
            self.wait_s = self._first_s
        elif self._returned:
            self.wait_s = max(self._first_s, min(SETTLED_S, 2 * self.wait_s))
        self._returned = False
