"""Which version of MQTT is tried next."""

from typing import Literal

import pytest

from gateway.sinks.mqtt.protocol_versions import Protocol, Versions

V5, V311 = Protocol.V5, Protocol.V311


def test_a_broker_that_does_not_know_5_is_asked_with_311() -> None:
    versions = Versions("auto")
    assert versions.next is V5
    versions.failed(certain=True)
    assert versions.next is V311
    versions.greeted()
    versions.failed(certain=False)  # a bad moment: what it has greeted is kept
    assert versions.next is V311
    versions.failed(certain=True)  # another broker at the same address
    assert versions.next is V5


def test_silence_lets_both_have_their_turn_until_one_is_greeted() -> None:
    versions = Versions("auto")
    seen = []
    for _ in range(4):
        seen.append(versions.next)
        versions.failed(certain=False)
    assert seen == [V5, V311, V5, V311]
    versions.greeted()
    for _ in range(3):
        versions.failed(certain=False)
    assert versions.next is V5


@pytest.mark.parametrize(("asked", "protocol"), [("5", V5), ("3.1.1", V311)])
def test_what_was_asked_for_stays(asked: Literal["5", "3.1.1"], protocol: Protocol) -> None:
    versions = Versions(asked)
    for certain in (True, False, True):
        assert versions.next is protocol
        versions.failed(certain=certain)
    assert versions.next is protocol
