"""Two states of the gateway that the tests of what a PLC makes of it begin with."""

from dataclasses import replace
from typing import Any

from gateway.core.detection import Circle
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import Reason, StateVector, TruckPosition, Visit, VisitPhase

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


def standing(heartbeat: int = 7, *, covered: bool = False, **changes: Any) -> StateVector:
    """A truck in place: everything healthy, stop on. `covered`: the marker is, and the ranger alone holds it."""
    t_ns, circle = 5_000_000_000, Circle(640.28, 352.5, 190.5)
    seen = VisionReading(4_960_000_000, Quality.NO_TARGET if covered else Quality.GOOD, None if covered else circle)
    state = permitted(
        heartbeat,
        vision=seen,
        range=RangeReading(4_980_000_000, Quality.GOOD, 281.0),
        d=None if covered else True,
        stop=True,
        may_move=False,
        reason=Reason.NO_TARGET if covered else Reason.TARGET_REACHED,
        visit=Visit(
            VisitPhase.HELD if covered else VisitPhase.IN_PLACE,
            in_place=True,
            place=TruckPosition(281.0, circle),
            covered_since_ns=t_ns - 3_000_000_000 if covered else None,
        ),
    )
    return replace(state, **changes)
