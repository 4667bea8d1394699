"""TLS handshakes are bounded in number and rate, for all unknown addresses together and for one address."""

import asyncio
import ssl
from typing import Any, cast

from gateway.modbus.server.limits import Refusal
from gateway.modbus.server.tls_handshake_limiter import (
    AT_ONCE,
    BURST,
    MAX_ADDRESSES,
    PER_S,
    PLC_AT_ONCE,
    REFILL_S,
    PendingHandshake,
    TlsHandshakeLimiter,
)
from tests.virtual_time import in_virtual_time

PLC, SCADA, STRANGER = "10.0.0.7", "10.0.1.5", "192.168.7.7"
SHARE = 8


class Client(PendingHandshake):
    """A stream and its TCP connection in one."""

    def __init__(self, address: str) -> None:
        self.address = address

    def get_extra_info(self, _: str) -> tuple[str, int]:
        return self.address, 40000


class Listener:
    """A server and its handshake limiter."""

    def __init__(self) -> None:
        self.refusals: list[tuple[str, Refusal]] = []
        self.limiter = TlsHandshakeLimiter(lambda: cast(ssl.SSLContext, None), 5.0, SHARE, self, asyncio.Protocol)

    def refusal_of(self, _: str) -> Refusal | None:
        return None

    def is_plc(self, address: str) -> bool:
        return address == PLC

    def refused(self, address: str, why: Refusal, _: str = "") -> None:
        self.refusals.append((address, why))

    def opened(self, _: Any) -> None: ...
    def closed(self, _: Any) -> None: ...

    def connect(self, address: str) -> Client | None:
        client = Client(address)
        admitted = self.limiter.admit(client, cast(asyncio.Transport, client))
        return client if admitted else None

    def done(self, client: Client) -> None:
        self.limiter.established(client)


@in_virtual_time
async def test_one_address_can_not_take_all_handshakes() -> None:
    listener = Listener()
    greedy = [listener.connect(STRANGER) for _ in range(100)]
    assert len([client for client in greedy if client]) == SHARE
    assert listener.refusals == [(STRANGER, Refusal.TLS_BUSY)] * (100 - SHARE)
    assert listener.connect(SCADA) is not None


@in_virtual_time
async def test_one_address_can_not_use_the_complete_rate() -> None:
    """A stranger that finishes each handshake at once, and begins a hundred a second, for a minute."""

    listener = Listener()
    begun = others = 0
    for n in range(6000):
        if (client := listener.connect(STRANGER)) is not None:
            begun += 1
            listener.done(client)
        if n % 100 == 50 and (client := listener.connect(SCADA)) is not None:
            others += 1
            listener.done(client)
        await asyncio.sleep(0.01)
    assert SHARE + 60 * SHARE / REFILL_S - 1 <= begun <= SHARE + 60 * SHARE / REFILL_S
    assert others == 60


@in_virtual_time
async def test_all_unknown_addresses_together_are_limited() -> None:
    listener = Listener()
    crowd = [listener.connect(f"10.1.{n // 250}.{n % 250}") for n in range(500)]
    there = [client for client in crowd if client]
    assert len(there) == AT_ONCE
    for client in there:
        listener.done(client)
    more = [came for n in range(500) if (came := listener.connect(f"10.2.{n // 250}.{n % 250}"))]
    assert len(more) == BURST - AT_ONCE
    await asyncio.sleep(1.0)
    again = [listener.connect(f"10.3.0.{n}") for n in range(100)]
    assert len([client for client in again if client]) == PER_S


@in_virtual_time
async def test_a_plc_is_not_delayed_by_others() -> None:
    listener = Listener()
    strangers = [listener.connect(f"10.1.0.{n}") for n in range(100)]
    assert len([client for client in strangers if client]) == AT_ONCE
    plcs = [listener.connect(PLC) for _ in range(100)]
    assert len([client for client in plcs if client]) == PLC_AT_ONCE - AT_ONCE


@in_virtual_time
async def test_addresses_are_forgotten_but_not_those_with_a_handshake() -> None:
    listener = Listener()
    waiting = [listener.connect(STRANGER) for _ in range(SHARE)]
    for n in range(3 * MAX_ADDRESSES):
        if (client := listener.connect(f"10.{n // 65025}.{n // 255 % 255}.{n % 255}")) is not None:
            listener.done(client)
    assert len(listener.limiter._by_address) <= MAX_ADDRESSES
    await asyncio.sleep(REFILL_S)
    assert listener.connect(STRANGER) is None
    for stranger in waiting:
        assert stranger is not None
        listener.done(stranger)
    assert not listener.limiter._waiting
    assert listener.connect(STRANGER) is not None
