"""Another client with our client id is recognised, and a broker that is only not well is not taken for one."""

import pytest

from gateway.sinks.mqtt.takeovers import ENOUGH, REMEMBERED_NS, SHORT_NS, End, Takeovers

BARE, TAKEN, FAULT = End("closed", bare=True), End("taken over", taken_over=True), End("not authorized")
S = 1_000_000_000


def test_mqtt_5_says_so_at_once() -> None:
    takeovers = Takeovers("gw")
    assert takeovers.detail(0) == ""
    news = takeovers.lost(5 * S, 3600 * S, TAKEN)
    assert news == "another client is connected with our client id gw"
    assert takeovers.lost(6 * S, S, TAKEN) == ""  # told already
    assert takeovers.detail(6 * S + REMEMBERED_NS - 1) == news
    assert takeovers.detail(6 * S + REMEMBERED_NS) == ""
    assert takeovers.lost(100 * S, S, TAKEN) == news


@pytest.mark.parametrize(
    ("ends", "found"),
    [
        ([(S, BARE)] * ENOUGH, True),
        ([(S, BARE)] * (ENOUGH - 1), False),
        ([(SHORT_NS - 1, BARE)] * ENOUGH, True),
        ([(SHORT_NS, BARE)] * 2 * ENOUGH, False),
        ([(S, FAULT)] * 2 * ENOUGH, False),
        ([(S, None)] * 2 * ENOUGH, False),  # it was the gateway that ended it
        ([(S, BARE), (S, BARE), (S, FAULT), (S, BARE), (S, BARE)], False),
        ([(S, BARE), (S, BARE), (SHORT_NS, BARE), (S, BARE), (S, BARE)], False),
    ],
)
def test_mqtt_311_only_closes_the_connection(ends: list[tuple[int, End | None]], found: bool) -> None:
    takeovers = Takeovers("gw")
    news = [takeovers.lost(0, lasted_ns, end) for lasted_ns, end in ends]
    assert (takeovers.detail(0) != "") == found
    assert [("client id gw?" in text) for text in news] == [False] * (len(ends) - 1) + [found]


def test_a_broker_that_is_killed_and_refuses_meanwhile_is_no_other_client() -> None:
    takeovers = Takeovers("gw")
    for _ in range(2 * ENOUGH):
        assert takeovers.lost(0, S, BARE) == ""
        takeovers.refused()
