"""The first connection of one who may write, and the last: that is all a bay is told."""

import pytest

from gateway.modbus.protocol.answers import Access, Peer, Unit
from gateway.modbus.server.presence import Presence

PLC = Peer("10.0.0.9")


def presence() -> tuple[Presence, list[tuple[str, str, bool]]]:
    told: list[tuple[str, str, bool]] = []
    unit = Unit(list, connection=lambda peer, here: told.append((peer.address, peer.subject, here)))
    return Presence([unit, Unit(list)]), told


def test_the_first_and_the_last() -> None:
    watched, told = presence()
    for _ in range(3):
        watched.came(PLC)
    assert told == [("10.0.0.9", "", True)]
    for _ in range(3):
        watched.left(PLC)
    assert told == [("10.0.0.9", "", True), ("10.0.0.9", "", False)]
    assert not watched._open


def test_each_address_and_subject_is_somebody_else() -> None:
    watched, told = presence()
    watched.came(Peer("10.0.0.9", subject="plc1"))
    watched.came(Peer("10.0.0.9", subject="plc2"))
    watched.left(Peer("10.0.0.9", subject="plc1"))
    assert told[-1] == ("10.0.0.9", "plc1", False)
    assert len(told) == 3


@pytest.mark.parametrize("access", [Access.NONE, Access.READ])
def test_who_may_not_write_is_nobody(access: Access) -> None:
    watched, told = presence()
    watched.came(Peer("10.0.0.9", access))
    watched.left(Peer("10.0.0.9", access))
    assert told == []
