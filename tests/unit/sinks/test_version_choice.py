"""Which version of MQTT is tried next."""

from typing import Literal

import pytest

from gateway.sinks.mqtt.broker_link import ProtocolVersion
from gateway.sinks.mqtt.session import VersionChoice

V5, V311 = ProtocolVersion.V5, ProtocolVersion.V311


def test_a_broker_that_does_not_know_5_is_asked_with_311() -> None:
    versions = VersionChoice("auto")
    assert versions.next is V5
    versions.failed(certain=True)
    assert versions.next is V311
    versions.accepted()
    versions.failed(certain=False)  # a bad moment: what it has accepted is kept
    assert versions.next is V311
    versions.failed(certain=True)  # another broker at the same address
    assert versions.next is V5


def test_silence_lets_both_have_their_turn_until_one_is_accepted() -> None:
    versions = VersionChoice("auto")
    seen = []
    for _ in range(4):
        seen.append(versions.next)
        versions.failed(certain=False)
    assert seen == [V5, V311, V5, V311]
    versions.accepted()
    for _ in range(3):
        versions.failed(certain=False)
    assert versions.next is V5


@pytest.mark.parametrize(("asked", "protocol"), [("5", V5), ("3.1.1", V311)])
def test_what_was_asked_for_stays(asked: Literal["5", "3.1.1"], protocol: ProtocolVersion) -> None:
    versions = VersionChoice(asked)
    for certain in (True, False, True):
        assert versions.next is protocol
        versions.failed(certain=certain)
    assert versions.next is protocol
