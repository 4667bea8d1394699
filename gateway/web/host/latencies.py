"""How long frames took, as histograms: one for each bay and stage, and one for capture to result. Pure."""

from bisect import bisect_left
from collections.abc import Callable

from gateway.core.model import FRESH_FRAME, VisionReading
from gateway.web.ipc.messages import BOUNDS_S, CAPTURE_TO_RESULT, Histogram

NS_PER_S = 1_000_000_000
_BOUNDS_NS = tuple(round(bound_s * NS_PER_S) for bound_s in BOUNDS_S)
MAX_STAGES = 32  # of one bay; a method has a dozen


class LatencyHistograms:
    """`note` costs a few microseconds a frame and never raises."""

    def __init__(self) -> None:
        self._rows: dict[str, dict[str, list[int]]] = {}  # bay -> stage -> counts, then the sum in ns

    def observing(self, bay: str, emit: Callable[[VisionReading], None]) -> Callable[[VisionReading], None]:
        """`emit` that notes what passes, afterwards: the decision does not wait for it."""
        rows = self._rows.setdefault(bay, {})

        def both(reading: VisionReading) -> None:
            emit(reading)
            if reading.stage_ns and reading.quality in FRESH_FRAME:
                _note(rows, CAPTURE_TO_RESULT, round(reading.stats.latency_ms * 1e6))
                for stage, took_ns in reading.stage_ns:
                    _note(rows, stage, took_ns)

        return both

    def histograms(self) -> tuple[Histogram, ...]:
        """As it stands now, since the start."""
        return tuple(
            Histogram(bay, stage, tuple(row[:-1]), row[-1] / NS_PER_S)
            for bay, rows in self._rows.items()
            for stage, row in rows.items()
        )


def _note(rows: dict[str, list[int]], stage: str, took_ns: int) -> None:
    row = rows.get(stage)
    if row is None:
        if len(rows) >= MAX_STAGES:
            return
        row = rows[stage] = [0] * (len(_BOUNDS_NS) + 2)
    row[bisect_left(_BOUNDS_NS, took_ns)] += 1
    row[-1] += took_ns
