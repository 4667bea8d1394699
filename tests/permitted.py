"""A state of the gateway that the tests of what a PLC makes of it begin with."""

from dataclasses import replace
from typing import Any

from gateway.model import Circle, Quality, RangeReading, Reason, StateVector, VisionReading

FOREVER_NS = 2**62


def permitted(heartbeat: int = 7, **changes: Any) -> StateVector:
    """A truck on its way: everything healthy, no stop."""
    state = StateVector(
        "bay1",
        t_ns=5_000_000_000,
        seq=70_000,
        heartbeat=heartbeat,
        vision=VisionReading(4_960_000_000, Quality.GOOD, Circle(640.28, -3.21, 120.04), frame_id=70_123),
        range=RangeReading(4_980_000_000, Quality.GOOD, 812.4),
        d=False,
        stop=False,
        may_move=True,
        valid_until_ns=FOREVER_NS,
        reason=Reason.NONE,
    )
    return replace(state, **changes)
