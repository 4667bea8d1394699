"""When alarms are evaluated: once a second, and as soon as a truck in place moves."""

import asyncio
import contextlib
from dataclasses import replace
from itertools import pairwise

import pytest

from gateway.alarms.definition import GatewayConditions
from gateway.alarms.monitor import AlarmMonitor
from gateway.config import BayConfig
from gateway.core.state import Moved, ReferencePosition, StateVector, Visit
from tests.virtual_time import LoopClock, run

UNTIL_S = 10.0
ROLLING = ReferencePosition(distance_mm=270.0, rolling_since_ns=1, sensor="range")
ROLLS = Visit(reference=ROLLING)


def scanned(at_s: float, visit: Visit, before: Visit | None = None) -> list[float]:
    """When, in s since the start, where `visit` is the bay's from `at_s` on, and `before` until then."""
    moments: list[float] = []

    async def main() -> None:
        clock = LoopClock()
        begun_ns = clock.now_ns()

        def since_s() -> float:
            return (clock.now_ns() - begun_ns) / 1e9

        def state(bay: str) -> StateVector:
            now = StateVector(bay, clock.now_ns(), visit=before or Visit())
            return replace(now, visit=visit) if since_s() >= at_s else now

        def conditions() -> GatewayConditions:
            moments.append(since_s())
            return GatewayConditions()

        monitor = AlarmMonitor({"bay1": BayConfig()}, state, clock, lambda change: None)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(UNTIL_S):
                await monitor.run(conditions)

    run(main())
    return moments


def test_once_a_second() -> None:
    moments = scanned(UNTIL_S, Visit())
    assert [after - before for before, after in pairwise(moments)] == pytest.approx([1.0] * 9)


@pytest.mark.parametrize(
    ("before", "visit"),
    [
        (Visit(), ROLLS),
        (ROLLS, Visit(reference=replace(ROLLING, nearer=True))),
        (Visit(), Visit(moved=Moved.DISTANCE)),
        (Visit(), Visit(in_place=True)),
    ],
)
@pytest.mark.parametrize("at_s", [3.01, 3.5, 3.97])
def test_a_truck_that_moves_does_not_wait_for_the_next_second(before: Visit, visit: Visit, at_s: float) -> None:
    sooner = [moment for moment in scanned(at_s, visit, before) if moment >= at_s]
    assert sooner[0] <= at_s + 0.051
    assert sooner[1] == pytest.approx(sooner[0] + 1.0)
