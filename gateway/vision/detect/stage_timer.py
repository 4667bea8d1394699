"""How long each stage of a detection took: `Detection.stage_ns`. Pure: the clock is handed in."""

from collections.abc import Callable

StageNs = tuple[tuple[str, int], ...]


class StageTimer:
    """Begins when it is made."""

    def __init__(self, now_ns: Callable[[], int]) -> None:
        self._now_ns = now_ns
        self._last_ns = now_ns()
        self._stages: list[tuple[str, int]] = []

    def ended(self, stage: str, _result: object = None) -> None:
        """The next stage begins now."""
        now_ns = self._now_ns()
        self._stages.append((stage, now_ns - self._last_ns))
        self._last_ns = now_ns

    @property
    def stage_ns(self) -> StageNs:
        """The ended stages, in order."""
        return tuple(self._stages)


def total_ns(stage_ns: StageNs) -> int:
    return sum(ns for _, ns in stage_ns)
