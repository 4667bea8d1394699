"""What of a bay outlives a restart, and what a bay begins with after one. Pure; kept by gateway/bay_file.py.

A function check, what R times Z is learned from, and a truck that was in place and was not released. The latter can
hold `stop` and be reported as moved; nothing is permitted by it: no in_place, no release.
"""

from dataclasses import dataclass

from gateway.core.scale import ScaleSample
from gateway.core.state import FunctionCheck, Moved, StateVector, TruckPosition, Visit


@dataclass(frozen=True, slots=True)
class RetainedTruck:
    """A truck that was in place, is not known to have left the bay, and was not released.

    `place` None: not comparable any more, for the pictures have another size than before the restart.
    """

    place: TruckPosition | None
    moved: Moved = Moved.NO
    moved_covered: bool = False


@dataclass(frozen=True, slots=True)
class RetainedState:
    """What of a bay outlives a restart."""

    function_check: FunctionCheck = FunctionCheck.OFF
    scale_samples: tuple[ScaleSample, ...] = ()
    truck: RetainedTruck | None = None

    @staticmethod
    def of(state: StateVector) -> "RetainedState":
        """`state`: as it was published, not as it is shown without a control task."""
        visit, truck = state.visit, None
        if visit.unreleased:
            truck = RetainedTruck(visit.place, visit.moved, visit.moved_covered)
        return RetainedState(state.function_check, state.memory.scale_samples, truck)

    @property
    def visit(self) -> Visit:
        """The visit that a bay begins with."""
        truck = self.truck
        if truck is None:
            return Visit()
        return Visit(place=truck.place, restored=True, moved=truck.moved, moved_covered=truck.moved_covered)
