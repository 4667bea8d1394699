"""When a frame was taken, by the time that its source stamped it with. Pure.

Frames that a driver or a network held back arrive in a burst, and a link that is slower than its stream delivers each
one later than the one before: by the time of arrival they all look new.
"""

import math
from collections.abc import Callable
from typing import Protocol

from gateway.durations import NS_PER_MS, NS_PER_S

SAME_CLOCK_NS = 10 * NS_PER_S  # a buffer's stamp that lies so near before its arrival is of CLOCK_MONOTONIC
CLOCK_SET_NS = NS_PER_S  # arriving so much earlier than ever before: its clock was set, or its film began again
DRIFT_WINDOW_NS = 20 * NS_PER_S
MOST_DRIFT = 500e-6  # between two clocks; what grows faster is a backlog


class FrameTime(Protocol):
    def taken_ns(self, arrival_ns: int, stamp_ms: float) -> int:
        """When the frame was taken, in the time of `arrival_ns`, never later than that. `stamp_ms`: its source's."""


class ArrivalTime:
    """For sources whose stamps mean nothing (an HTTP stream of JPEGs carries none, FFmpeg makes them up)."""

    def taken_ns(self, arrival_ns: int, stamp_ms: float) -> int:
        return arrival_ns


class PresentationTime:
    """Stamps of another clock, whose zero is unknown: the frame that arrived fastest counts as one without delay.

    So a constant delay from the opening on is not detected. Two clocks drift: what the smallest delay of 20 s differs
    from that of the 20 s before is drift, up to 500 ppm. A clock that is set, or a film that begins again, starts a new
    count with the delay that the last frame had.
    """

    def __init__(self) -> None:
        self._zero_ns: float | None = None  # arrival minus stamp of a frame without delay
        self._stamp_ns = 0.0
        self._late_ns = 0.0
        self._window_end_ns = 0
        self._least_ns = math.inf  # delay in this window
        self._least_before_ns = math.inf

    def taken_ns(self, arrival_ns: int, stamp_ms: float) -> int:
        stamp_ns = stamp_ms * NS_PER_MS
        if not math.isfinite(stamp_ns):
            return arrival_ns - round(self._late_ns)
        shift_ns = arrival_ns - stamp_ns
        if self._zero_ns is None or stamp_ns <= self._stamp_ns or shift_ns < self._zero_ns - CLOCK_SET_NS:
            self._zero_ns = shift_ns - self._late_ns
            self._begin_window(arrival_ns, math.inf)
        self._stamp_ns = stamp_ns
        self._zero_ns = min(self._zero_ns, shift_ns)
        self._late_ns = shift_ns - self._zero_ns
        self._follow_drift(arrival_ns)
        return arrival_ns - round(self._late_ns)

    def _follow_drift(self, arrival_ns: int) -> None:
        self._least_ns = min(self._least_ns, self._late_ns)
        if arrival_ns < self._window_end_ns or self._zero_ns is None:
            return
        drift_ns = self._least_ns - self._least_before_ns
        least_ns = self._least_ns
        if abs(drift_ns) <= MOST_DRIFT * DRIFT_WINDOW_NS:
            self._zero_ns += drift_ns
            least_ns -= drift_ns
        self._begin_window(arrival_ns, least_ns)

    def _begin_window(self, arrival_ns: int, least_before_ns: float) -> None:
        self._window_end_ns = arrival_ns + DRIFT_WINDOW_NS
        self._least_ns, self._least_before_ns = math.inf, least_before_ns


class BufferTime:
    """A V4L2 buffer's stamp: of CLOCK_MONOTONIC, as nearly every driver gives it, else of another clock.

    `behind_ns`: how far CLOCK_MONOTONIC is behind the gateway's clock now (`clock.suspended_ns`).
    """

    def __init__(self, behind_ns: Callable[[], int]) -> None:
        self._behind_ns = behind_ns
        self._own_clock = PresentationTime()

    def taken_ns(self, arrival_ns: int, stamp_ms: float) -> int:
        taken_ns = stamp_ms * NS_PER_MS + self._behind_ns()
        if stamp_ms > 0 and 0 <= arrival_ns - taken_ns <= SAME_CLOCK_NS:
            return round(taken_ns)
        return self._own_clock.taken_ns(arrival_ns, stamp_ms)
