"""A bay as a unit of the Modbus server: what is wired to what."""

import zlib
from typing import Any

import pytest

from gateway.bay import BayControl
from gateway.config import parse
from gateway.core.events import EventKind
from gateway.core.plc import Writer
from gateway.hub import EventQueue, Hub
from gateway.modbus.protocol import identity
from gateway.modbus.protocol.answers import Access, Peer, Unit
from gateway.modbus.registers.bay_identity import BayIdentity
from gateway.modbus.registers.bay_unit import unit_of
from gateway.modbus.registers.register_map import decode, encode
from tests.virtual_time import HandClock

PLC = Peer("10.0.0.9", Access.WRITE, None, "plc1")
WHO = Writer("10.0.0.9", "plc1", "")


class Bench:
    def __init__(self, **modbus: Any) -> None:
        config = parse({"site": "cement1", "bays": [{"name": "north"}], "modbus": modbus})
        self.clock, self.hub = HandClock(), Hub(["north"])
        self.bay = BayControl(config.bays[0], self.hub, self.clock, (), config)
        self.events: EventQueue = self.hub.subscribe()
        self.unit: Unit = unit_of(self.bay, config, self.clock)


WRITES = {"writes": True, "plc_addresses": ["10.0.0.9"]}


@pytest.mark.parametrize("order", ["big", "little"])
def test_its_image_is_that_of_the_bay_s_state_in_the_configured_word_order(order: Any) -> None:
    bench = Bench(word_order=order)
    bench.clock.t_ns += 3_000_000
    image = bench.unit.read()
    unix_ns = bench.clock.wall_ns() - 3_000_000
    bay = BayIdentity(1, 1_909_633_855)
    assert image == encode(bench.hub.state("north"), unix_ns, order, bay)
    read = decode(image)
    assert (read["unit_id"], read["bay_identity"]) == (1, zlib.crc32(b"cement1/gateway/north") & 0x7FFF_FFFF)
    assert read["timestamp"] == unix_ns // 1_000_000


def test_a_dead_bay_is_the_same_bay() -> None:
    bench = Bench()
    alive = bench.unit.read()
    bench.clock.t_ns += 10_000_000_000
    dead = bench.unit.read()
    assert decode(dead)["reason"] == 40
    assert dead[101:104] == alive[101:104] != (0, 0, 0)


def test_it_is_identified_by_site_and_bay_and_takes_writes_only_where_they_are_on() -> None:
    assert Bench().unit.write is None
    assert Bench().unit.identity == identity.objects("cement1/north")
    assert Bench(**WRITES).unit.write is not None


def test_writes_refusals_and_connections_reach_the_bay() -> None:
    bench = Bench(**WRITES)
    write = bench.unit.write
    assert write is not None
    assert write(81, (3,), PLC) is None
    plc = bench.hub.state("north").plc
    assert (plc.control, plc.owner) == (3, WHO)
    bench.unit.connection(PLC, False, 1)
    assert bench.hub.state("north").plc.owner_gone
    bench.unit.connection(PLC, True, 0)
    assert not bench.hub.state("north").plc.owner_gone
    bench.events.drain()
    bench.unit.refused(PLC, "function code 22 is not supported")
    write(4, (0,), PLC)
    told = [(event.kind, event.writer, event.detail.partition(": ")[2]) for event in bench.events.drain()]
    assert told == [
        (EventKind.WRITE_REFUSED, WHO, "function code 22 is not supported"),
        (EventKind.WRITE_REFUSED, WHO, "register 4 is read only"),
    ]
