"""Who may begin a TLS handshake: bounded in number and rate, for all strangers together and for one address."""

import asyncio
import ssl
from typing import Any, cast

from gateway.modbus.server.limits import Refusal
from gateway.modbus.server.tls_handshakes import AT_ONCE, BURST, MAX_ADDRESSES, PER_S, PLC_AT_ONCE, REFILL_S, Porch
from gateway.modbus.server.tls_stream import TlsStream
from tests.virtual_time import run

PLC, SCADA, STRANGER = "10.0.0.7", "10.0.1.5", "192.168.7.7"
SHARE = 8


class Visitor:
    """A stream and its TCP connection in one."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.counted = False

    def get_extra_info(self, _: str) -> tuple[str, int]:
        return self.address, 40000


class Listener:
    """The host behind the porch, and the porch."""

    def __init__(self) -> None:
        self.refused: list[tuple[str, Refusal]] = []
        self.porch = Porch(lambda: cast(ssl.SSLContext, None), 5.0, SHARE, self, asyncio.Protocol)

    def allowed(self, _: str) -> Refusal | None:
        return None

    def is_plc(self, address: str) -> bool:
        return address == PLC

    def turned_away(self, address: str, why: Refusal, _: str = "") -> None:
        self.refused.append((address, why))

    def coming(self, _: Any) -> None: ...
    def went(self, _: Any) -> None: ...

    def knock(self, address: str) -> Visitor | None:
        visitor = Visitor(address)
        let_in = self.porch.knock(cast(TlsStream, visitor), cast(asyncio.Transport, visitor))
        return visitor if let_in else None

    def done(self, visitor: Visitor) -> None:
        self.porch.enter(cast(TlsStream, visitor))


def test_one_address_can_not_take_all_handshakes() -> None:
    async def scene() -> None:
        listener = Listener()
        greedy = [listener.knock(STRANGER) for _ in range(100)]
        assert len([visitor for visitor in greedy if visitor]) == SHARE
        assert listener.refused == [(STRANGER, Refusal.TLS_BUSY)] * (100 - SHARE)
        assert listener.knock(SCADA) is not None

    run(scene())


def test_nor_the_whole_rate() -> None:
    """A stranger that finishes each handshake at once, and begins a hundred a second, for a minute."""

    async def scene() -> None:
        listener = Listener()
        begun = others = 0
        for n in range(6000):
            if (visitor := listener.knock(STRANGER)) is not None:
                begun += 1
                listener.done(visitor)
            if n % 100 == 50 and (visitor := listener.knock(SCADA)) is not None:
                others += 1
                listener.done(visitor)
            await asyncio.sleep(0.01)
        assert SHARE + 60 * SHARE / REFILL_S - 1 <= begun <= SHARE + 60 * SHARE / REFILL_S
        assert others == 60

    run(scene())


def test_all_strangers_together_have_no_more_than_before() -> None:
    async def scene() -> None:
        listener = Listener()
        crowd = [listener.knock(f"10.1.{n // 250}.{n % 250}") for n in range(500)]
        there = [visitor for visitor in crowd if visitor]
        assert len(there) == AT_ONCE
        for visitor in there:
            listener.done(visitor)
        more = [came for n in range(500) if (came := listener.knock(f"10.2.{n // 250}.{n % 250}"))]
        assert len(more) == BURST - AT_ONCE
        await asyncio.sleep(1.0)
        again = [listener.knock(f"10.3.0.{n}") for n in range(100)]
        assert len([visitor for visitor in again if visitor]) == PER_S

    run(scene())


def test_a_plc_is_held_up_by_nobody() -> None:
    async def scene() -> None:
        listener = Listener()
        strangers = [listener.knock(f"10.1.0.{n}") for n in range(100)]
        assert len([visitor for visitor in strangers if visitor]) == AT_ONCE
        plcs = [listener.knock(PLC) for _ in range(100)]
        assert len([visitor for visitor in plcs if visitor]) == PLC_AT_ONCE - AT_ONCE

    run(scene())


def test_addresses_are_forgotten_but_not_those_that_wait() -> None:
    async def scene() -> None:
        listener = Listener()
        waiting = [listener.knock(STRANGER) for _ in range(SHARE)]
        for n in range(3 * MAX_ADDRESSES):
            if (visitor := listener.knock(f"10.{n // 65025}.{n // 255 % 255}.{n % 255}")) is not None:
                listener.done(visitor)
        assert len(listener.porch._shares) == MAX_ADDRESSES
        await asyncio.sleep(REFILL_S)
        assert listener.knock(STRANGER) is None
        for stranger in waiting:
            assert stranger is not None
            listener.done(stranger)
        assert listener.porch._all.waiting == 0
        assert listener.knock(STRANGER) is not None

    run(scene())
