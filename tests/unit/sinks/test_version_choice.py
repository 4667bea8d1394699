"""Which version of MQTT is tried next."""

from typing import Literal

import pytest

from gateway.sinks.mqtt.endpoints import VersionChoice


@pytest.mark.parametrize(
    ("configured", "tries"),
    [
        # A broker without MQTT 5. What it has accepted is kept, until another one at that address refuses it.
        ("auto", ["5 refused", "3.1.1 accepted", "3.1.1 no answer", "3.1.1 refused", "5 accepted"]),
        # Without an answer both are tried in turn, until one is accepted.
        ("auto", [*["5 no answer", "3.1.1 no answer"] * 2, "5 accepted", *["5 no answer"] * 3]),
        ("5", ["5 refused", "5 no answer", "5 refused", "5 accepted"]),
        ("3.1.1", ["3.1.1 refused", "3.1.1 no answer", "3.1.1 refused", "3.1.1 accepted"]),
    ],
)
def test_the_version_of_each_try(configured: Literal["auto", "5", "3.1.1"], tries: list[str]) -> None:
    versions = VersionChoice(configured)
    for expected in tries:
        version, result = expected.split(" ", 1)
        assert versions.next == version
        if result == "accepted":
            versions.accepted()
        else:
            versions.failed(certain=result == "refused")
