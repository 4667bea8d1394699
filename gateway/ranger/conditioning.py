"""What stands between a raw distance and a trusted one: a glitch gate, then a median. Pure; all times in ns.

The gate's rule: one odd reading is held back, a second one decides. Held back means nothing is reported and the last
good value ages, so a sensor that stays odd can never hide behind it for longer than the staleness deadline.

The median of N delays a moving target by (N - 1) / 2 readings: 60 ms for the default of 3 at a 60 ms cycle. The delay
is not hidden: the filtered value carries the time of the middle of its window.
"""

from collections import deque
from dataclasses import dataclass
from enum import Enum, auto
from statistics import median, median_high, median_low

HISTORY = 8
UNSTABLE_ODD = 3
"""So many odd readings among the last HISTORY: the sensor alternates, and nobody knows which of its values are true."""


class Verdict(Enum):
    PASS = auto()  # use it; a fault: report it
    HOLD = auto()  # say nothing yet
    UNSTABLE = auto()  # say that readings jump


@dataclass(frozen=True, slots=True)
class _Level:
    mm: float
    t_ns: int


class GlitchGate:
    """A jump over `gate_mm` must be confirmed by a second consecutive reading near the first. 0: everything passes.

    After a start, a confirmed fault or a silence longer than `memory_ns` there is nothing to compare with: then two
    readings must agree before the first one passes. A single fault (an echo lost) is held back like a single jump.
    """

    def __init__(self, gate_mm: float, memory_ns: int) -> None:
        self.memory_ns = memory_ns
        self._gate_mm = gate_mm
        self.reset()

    def reset(self) -> None:
        """Forget everything: another sensor, or the same one after a restart."""
        self._reference: _Level | None = None  # the newest reading believed
        self._candidate: _Level | None = None  # the odd one waiting for a second opinion
        self._odd_ns: int | None = None  # when the reading before this one was odd, and held back
        self._history: deque[bool] = deque(maxlen=HISTORY)

    def distance(self, mm: float, t_ns: int) -> Verdict:
        """Judge a reading without any fault flag."""
        if not self._gate_mm:
            return Verdict.PASS
        if self._near(self._reference, mm, t_ns) or self._near(self._candidate, mm, t_ns):
            self._reference, self._candidate, self._odd_ns = _Level(mm, t_ns), None, None
            self._history.append(False)
            return Verdict.UNSTABLE if self._alternating() else Verdict.PASS
        second = self._recent(self._odd_ns, t_ns)
        if second or self._believed(t_ns):  # else there was nothing to compare with, and nothing is odd
            self._history.append(True)
        self._candidate, self._odd_ns = _Level(mm, t_ns), t_ns
        return Verdict.UNSTABLE if second or self._alternating() else Verdict.HOLD

    def fault(self, t_ns: int) -> Verdict:
        """Judge a reading with a fault flag: PASS (report it) or HOLD."""
        if not self._gate_mm:
            return Verdict.PASS
        self._history.append(True)
        if not self._believed(t_ns) or self._recent(self._odd_ns, t_ns) or self._alternating():
            self.reset()
            return Verdict.PASS
        self._candidate, self._odd_ns = None, t_ns
        return Verdict.HOLD

    def _near(self, level: _Level | None, mm: float, t_ns: int) -> bool:
        return level is not None and self._recent(level.t_ns, t_ns) and abs(mm - level.mm) <= self._gate_mm

    def _believed(self, t_ns: int) -> bool:
        return self._reference is not None and self._recent(self._reference.t_ns, t_ns)

    def _recent(self, then_ns: int | None, t_ns: int) -> bool:
        return then_ns is not None and t_ns - then_ns <= self.memory_ns

    def _alternating(self) -> bool:
        return sum(self._history) >= UNSTABLE_ODD


class MedianFilter:
    """Median of the newest `size` readings; of fewer while the window fills. The caller resets it at every gap."""

    def __init__(self, size: int) -> None:
        self._window: deque[_Level] = deque(maxlen=size)

    def reset(self) -> None:
        self._window.clear()

    @property
    def oldest_ns(self) -> int | None:
        """Time of the oldest reading in the window; None: it is empty."""
        return self._window[0].t_ns if self._window else None

    def push(self, mm: float, t_ns: int) -> tuple[float, int]:
        """The median and the time of the window's middle. While the window has an even number, the means of two."""
        self._window.append(_Level(mm, t_ns))
        times = [level.t_ns for level in self._window]
        return median(level.mm for level in self._window), (median_low(times) + median_high(times)) // 2
