"""From a raw distance to a trusted one, for every ranger: a glitch gate, then a median. Pure; all times in ns.

The gate's rule: one odd reading is held back, a second one decides. Held back means nothing is reported and the last
good value ages, so a sensor that stays odd can never hide behind it for longer than the staleness deadline.

The median of N delays a moving target by (N - 1) / 2 readings: 60 ms for the default of 3 at a 60 ms cycle. The delay
is not hidden: the filtered value carries the time of the middle of its window.
"""

from collections import deque
from dataclasses import dataclass, replace
from enum import Enum, auto
from statistics import median, median_high, median_low

from gateway.config import RangerConfig
from gateway.core import details
from gateway.core.readings import Quality, RangeReading, RangeStats
from gateway.durations import NS_PER_S

HISTORY = 8
UNSTABLE_ODD = 3
"""So many odd readings among the last HISTORY: the sensor alternates, and which of its values are true is unknown."""
MEMORY_CYCLES = 5
"""The glitch gate compares readings at most so many cycles apart."""
REPEAT_NS = NS_PER_S // 10
"""A lasting fault is reported again after this time."""
RATE_NS = NS_PER_S


class ReadingVerdict(Enum):
    PASS = auto()  # use it; a fault: report it
    HOLD = auto()  # report nothing yet
    UNSTABLE = auto()  # report that readings jump


@dataclass(frozen=True, slots=True)
class _Distance:
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
        self._reference: _Distance | None = None  # the newest reading believed
        self._candidate: _Distance | None = None  # the odd one, until a second reading confirms it
        self._odd_ns: int | None = None  # when the reading before this one was odd, and held back
        self._history: deque[bool] = deque(maxlen=HISTORY)

    def distance(self, mm: float, t_ns: int) -> ReadingVerdict:
        """Judge a reading without any fault flag."""
        if not self._gate_mm:
            return ReadingVerdict.PASS
        if self._near(self._reference, mm, t_ns) or self._near(self._candidate, mm, t_ns):
            self._reference, self._candidate, self._odd_ns = _Distance(mm, t_ns), None, None
            self._history.append(False)
            return ReadingVerdict.UNSTABLE if self._alternating() else ReadingVerdict.PASS
        second = self._recent(self._odd_ns, t_ns)
        if second or self._believed(t_ns):  # else there was nothing to compare with, and nothing is odd
            self._history.append(True)
        self._candidate, self._odd_ns = _Distance(mm, t_ns), t_ns
        return ReadingVerdict.UNSTABLE if second or self._alternating() else ReadingVerdict.HOLD

    def fault(self, t_ns: int) -> ReadingVerdict:
        """Judge a reading with a fault flag: PASS (report it) or HOLD."""
        if not self._gate_mm:
            return ReadingVerdict.PASS
        self._history.append(True)
        if not self._believed(t_ns) or self._recent(self._odd_ns, t_ns) or self._alternating():
            self.reset()
            return ReadingVerdict.PASS
        self._candidate, self._odd_ns = None, t_ns
        return ReadingVerdict.HOLD

    def _near(self, level: _Distance | None, mm: float, t_ns: int) -> bool:
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
        self._window: deque[_Distance] = deque(maxlen=size)

    def reset(self) -> None:
        self._window.clear()

    @property
    def oldest_ns(self) -> int | None:
        """Time of the oldest reading in the window; None: it is empty."""
        return self._window[0].t_ns if self._window else None

    def push(self, mm: float, t_ns: int) -> tuple[float, int]:
        """The median and the time of the window's middle. While the window has an even number, the means of two."""
        self._window.append(_Distance(mm, t_ns))
        times = [level.t_ns for level in self._window]
        return median(level.mm for level in self._window), (median_low(times) + median_high(times)) // 2


class Conditioner:
    """Makes the readings of one ranger from its raw ones, and counts. The counters outlive connections."""

    def __init__(self, config: RangerConfig, cycle_ns: int) -> None:
        self._gate = GlitchGate(config.glitch_gate_mm, MEMORY_CYCLES * cycle_ns)
        self._median = MedianFilter(config.median)
        self.stats = RangeStats()
        self._connections = 0
        self._reported: tuple[Quality, int] | None = None
        self._arrivals: deque[int] = deque(maxlen=256)

    def set_cycle(self, cycle_ns: int) -> None:
        """The time between two measurements, once the ranger has reported it."""
        self._gate.memory_ns = MEMORY_CYCLES * cycle_ns

    def opened(self) -> None:
        """A new connection: nothing of the one before counts, but the counters."""
        self.restarted()
        self._connections += 1
        self._reported = None
        self._arrivals.clear()
        self.stats = replace(self.stats, reopens=self._connections - 1, rate_hz=0.0)

    def restarted(self) -> None:
        """Another sensor, or the same one after a restart."""
        self._gate.reset()
        self._median.reset()

    def gap(self) -> None:
        """Measurements are missing: the median begins anew."""
        self._median.reset()

    def count(self, *, lines: int = 0, damaged: int = 0, gaps: int = 0, rejected: int = 0) -> None:
        s = self.stats
        self.stats = replace(
            s,
            lines=s.lines + lines,
            damaged=s.damaged + damaged,
            gaps=s.gaps + gaps,
            rejected=s.rejected + rejected,
        )

    def arrived(self, now_ns: int) -> None:
        """A measurement arrived, usable or not."""
        self._arrivals.append(now_ns)
        self.update_rate(now_ns)

    def update_rate(self, now_ns: int) -> None:
        """Measurements a second, over about the last second."""
        while self._arrivals and now_ns - self._arrivals[0] > RATE_NS:
            self._arrivals.popleft()
        spread_ns = self._arrivals[-1] - self._arrivals[0] if self._arrivals else 0
        rate_hz = (len(self._arrivals) - 1) * NS_PER_S / spread_ns if spread_ns else 0.0
        if rate_hz != self.stats.rate_hz:
            self.stats = replace(self.stats, rate_hz=rate_hz)

    def measured(self, raw_mm: float, quality: Quality, t_ns: int, seq: int, detail: str = "") -> list[RangeReading]:
        """One measurement, from an echo at `t_ns`; what is wrong with it as `quality`. Empty: it is held back."""
        good = quality is Quality.GOOD
        if not good:
            self._median.reset()
        verdict = self._gate.distance(raw_mm, t_ns) if good else self._gate.fault(t_ns)
        if verdict is not ReadingVerdict.PASS:
            self.count(rejected=1)
        if verdict is ReadingVerdict.HOLD:
            return []
        if verdict is ReadingVerdict.UNSTABLE:
            self._median.reset()
            return self._emit(t_ns, Quality.UNSTABLE, None, seq, details.READINGS_JUMP(f"{raw_mm:.0f}"))
        if not good:
            return self._emit(t_ns, quality, None, seq, detail or details.RAW(f"{raw_mm:.0f}"))
        value_mm, value_ns = self._median.push(raw_mm, t_ns)
        return self._emit(value_ns, Quality.GOOD, value_mm, seq, "", self._median.oldest_ns, raw_mm)

    def fault(self, quality: Quality, now_ns: int, seq: int, detail: str) -> list[RangeReading]:
        """A fault without a measurement: at once when it is new, then again every REPEAT_NS."""
        if self._reported is not None and self._reported[0] is quality and now_ns - self._reported[1] < REPEAT_NS:
            return []
        return self._emit(now_ns, quality, None, seq, detail)

    def lost(self, now_ns: int, detail: str) -> RangeReading:
        """The port cannot be opened or was lost."""
        self.stats = replace(self.stats, rate_hz=0.0)
        return RangeReading(now_ns, Quality.LINK_DOWN, detail=detail, stats=self.stats)

    def _emit(
        self,
        t_ns: int,
        quality: Quality,
        mm: float | None,
        seq: int,
        detail: str,
        oldest_ns: int | None = None,
        echo_mm: float | None = None,
    ) -> list[RangeReading]:
        self._reported = (quality, t_ns)
        return [RangeReading(t_ns, quality, mm, seq, detail, self.stats, oldest_ns, echo_mm)]
