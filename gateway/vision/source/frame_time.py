"""When a frame was taken, by the time that its source stamped it with.

Frames that a driver or a network held back arrive in a burst, and a link that is slower than its stream delivers each
one later than the one before: by the time of arrival they all look new.
"""

import logging
import math
from collections.abc import Callable
from typing import Protocol

from gateway.clock import Clock
from gateway.core.readings import AgeProof
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.errors import LinkError

log = logging.getLogger(__name__)

SAME_CLOCK_NS = 10 * NS_PER_S  # a buffer's stamp that lies so near before its arrival is of CLOCK_MONOTONIC
CLOCK_SET_NS = NS_PER_S  # arriving so much earlier than ever before: its clock was set, or its film began again
DRIFT_WINDOW_NS = 20 * NS_PER_S
LATCH_NS = 10 * NS_PER_S  # between two looks at a camera's clock: 50 ppm are 0.5 ms
MOST_DRIFT = 500e-6  # between two clocks; what grows faster is a backlog
SETTLED_NS = 5 * NS_PER_S  # without a frame that is faster than those before it by more than clocks drift in it
FASTER_NS = 20 * NS_PER_MS  # once settled: a frame faster by more than this shows that those before it were older
AHEAD_NS = 50 * NS_PER_MS  # two clocks that are set by NTP agree to less
WRONG_NS = 60 * NS_PER_S  # then the stream is opened again: its clock may have been set
STANDING_NS = NS_PER_S  # stamps that do not go on for so long say nothing


class FrameTime(Protocol):
    @property
    def proof(self) -> AgeProof:
        """What shows that the frame asked for last was not taken earlier."""

    def taken_ns(self, arrival_ns: int, stamp_ms: float) -> int:
        """When the frame was taken, in the time of `arrival_ns`, never later than that. `stamp_ms`: its source's."""


class ArrivalTime:
    """For sources whose stamps mean nothing (of an HTTP stream without times FFmpeg makes them up)."""

    proof = AgeProof.UNPROVEN

    def taken_ns(self, arrival_ns: int, stamp_ms: float) -> int:
        return arrival_ns


class PresentationTime:
    """Stamps of another clock, whose zero is unknown: the frame that arrived fastest counts as one without delay.

    A backlog that is sent faster than it was taken makes each frame the fastest: nothing is proven until that has
    ended, and nothing any more once it begins. A constant delay, in the camera or in a relay, is not seen, nor a
    backlog that drains by no more than clocks drift. Two clocks drift: what the smallest delay of 20 s differs from
    that of the 20 s before is drift, up to 500 ppm. A clock that is set, a film that begins again, and a backlog that
    is dropped look alike: they start a new count with the delay that the last frame had, unproven.
    """

    def __init__(self) -> None:
        self._zero_ns: float | None = None  # arrival minus stamp of a frame without delay
        self._stamp_ns = 0.0
        self._late_ns = 0.0
        self._window_end_ns = 0
        self._least_ns = math.inf  # delay in this window
        self._least_before_ns = math.inf
        self._settled_ns: int | None = None  # when it will be; None: no frame yet
        self._settled_zero_ns = math.inf  # may fall by as much as clocks drift
        self._went_on_ns = 0  # the stamps did, last
        self.proof = AgeProof.UNPROVEN

    def taken_ns(self, arrival_ns: int, stamp_ms: float) -> int:
        stamp_ns = stamp_ms * NS_PER_MS
        if not stamp_ns > self._stamp_ns and arrival_ns - self._went_on_ns >= STANDING_NS and self._zero_ns is not None:
            self._settled_ns = None
            self.proof = AgeProof.UNPROVEN
        if not math.isfinite(stamp_ns):
            return arrival_ns - round(self._late_ns)
        shift_ns = arrival_ns - stamp_ns
        twice = stamp_ns >= self._stamp_ns - FASTER_NS and arrival_ns - self._went_on_ns < STANDING_NS
        back = stamp_ns <= self._stamp_ns and not twice
        if self._zero_ns is None or back or shift_ns < self._zero_ns - CLOCK_SET_NS:
            self._settled_ns = None
            self._zero_ns = shift_ns - self._late_ns
            self._begin_window(arrival_ns, math.inf)
        if stamp_ns != self._stamp_ns:
            self._went_on_ns = arrival_ns
        self._stamp_ns = stamp_ns
        self._zero_ns = min(self._zero_ns, shift_ns)
        self._late_ns = shift_ns - self._zero_ns
        self._look_whether_settled(arrival_ns, self._zero_ns)
        self._follow_drift(arrival_ns)
        return arrival_ns - round(self._late_ns)

    def _look_whether_settled(self, arrival_ns: int, zero_ns: float) -> None:
        faster_ns = MOST_DRIFT * SETTLED_NS if self.proof is AgeProof.UNPROVEN else FASTER_NS
        if self._settled_ns is None or zero_ns < self._settled_zero_ns - faster_ns:
            self.proof = AgeProof.UNPROVEN
            self._settled_ns, self._settled_zero_ns = arrival_ns + SETTLED_NS, zero_ns
        elif arrival_ns >= self._settled_ns and self._went_on_ns == arrival_ns:
            self.proof = AgeProof.PRESENTATION_TIME

    def _follow_drift(self, arrival_ns: int) -> None:
        self._least_ns = min(self._least_ns, self._late_ns)
        if arrival_ns < self._window_end_ns or self._zero_ns is None:
            return
        drift_ns = self._least_ns - self._least_before_ns
        least_ns = self._least_ns
        if abs(drift_ns) <= MOST_DRIFT * DRIFT_WINDOW_NS:
            self._zero_ns += drift_ns
            least_ns -= drift_ns
        self._settled_zero_ns = max(self._zero_ns, self._settled_zero_ns - MOST_DRIFT * DRIFT_WINDOW_NS)
        self._begin_window(arrival_ns, least_ns)

    def _begin_window(self, arrival_ns: int, least_before_ns: float) -> None:
        self._window_end_ns = arrival_ns + DRIFT_WINDOW_NS
        self._least_ns, self._least_before_ns = math.inf, least_before_ns


class LatchedTime:
    """Stamps of a camera's clock that can be read, so that a delay is seen which is there from the opening on.

    `latch` returns that clock, ns, or None where it can't be read; what it returns was true at some moment of the call.
    The narrowest of three calls counts, every 10 s anew. A frame is as old as this or `PresentationTime` says,
    whichever is more. Without such a clock, and for a stamp that does not fit it, the latter alone. A stamp of 0 is
    none: by arrival.
    """

    def __init__(self, latch: Callable[[], int | None], now_ns: Callable[[], int]) -> None:
        self._latch = latch
        self._now_ns = now_ns
        self._by_arrival = PresentationTime()
        self._shift_ns: int | None = None  # from the camera's clock to ours
        self._due_ns: int | None = None
        self.proof = AgeProof.UNPROVEN

    def taken_ns(self, arrival_ns: int, stamp_ms: float) -> int:
        if stamp_ms <= 0:
            self.proof = AgeProof.UNPROVEN
            return arrival_ns
        if self._due_ns is None or arrival_ns >= self._due_ns:
            self._due_ns = arrival_ns + LATCH_NS
            self._shift_ns = self._read()
        latest_ns = self._by_arrival.taken_ns(arrival_ns, stamp_ms)
        self.proof = self._by_arrival.proof
        if self._shift_ns is None or not math.isfinite(stamp_ms):
            return latest_ns
        taken_ns = round(stamp_ms * NS_PER_MS) + self._shift_ns
        if not -FASTER_NS <= arrival_ns - taken_ns <= SAME_CLOCK_NS:
            return latest_ns
        self.proof = AgeProof.DEVICE_TIME
        return min(taken_ns, latest_ns)

    def _read(self) -> int | None:
        found: list[tuple[int, int]] = []
        for _ in range(3):
            before_ns = self._now_ns()
            value_ns = self._latch()
            after_ns = self._now_ns()
            if value_ns is None:
                return None
            found.append((after_ns - before_ns, (before_ns + after_ns) // 2 - value_ns))
        width_ns, shift_ns = min(found)
        return None if width_ns > 2 * FASTER_NS else shift_ns  # it may be wrong by half the width


class SynchronisedTime:
    """Stamps of a camera whose clock is set by NTP, as the gateway's is: a constant delay is seen, too.

    `unix_ms` returns the Unix time of a stamp of 0, NaN where it is not known. It is exact for a moment only, because
    the stamps may drift against the camera's clock. So what the fastest frame was late by is measured once, when
    `PresentationTime` has settled, plus what may have drifted by then; each frame is older by that than the latter
    says. `exact`: it is so for each stamp; then nothing is kept of one frame for another. Not seen is a clock that is
    up to 50 ms ahead. A wrong one proves nothing, and is looked at anew after 60 s.
    """

    def __init__(self, unix_ms: Callable[[], float], clock: Clock, label: str, *, exact: bool = False) -> None:
        self._unix_ms = unix_ms
        self._exact = exact
        self._clock = clock
        self._label = label
        self._by_arrival = PresentationTime()
        self._first_ns: int | None = None
        self._known_ns: int | None = None  # since when the camera has stated its clock
        self._wrong_ns: int | None = None  # since when it has been wrong
        self._told = False
        self._shift_ns: float | None = None  # our time less the camera's wall clock, of the fastest frame
        self.proof = AgeProof.UNPROVEN

    def taken_ns(self, arrival_ns: int, stamp_ms: float) -> int:
        """Raises LinkError where the camera's clock stays wrong."""
        self._first_ns = arrival_ns if self._first_ns is None else self._first_ns
        latest_ns = self._by_arrival.taken_ns(arrival_ns, stamp_ms)
        settled = self._by_arrival.proof is not AgeProof.UNPROVEN
        self.proof = AgeProof.UNPROVEN
        shift_ns = self._shift_ns
        if shift_ns is None:
            shift_ns = latest_ns - (self._unix_ms() + stamp_ms) * NS_PER_MS
            if not math.isfinite(shift_ns):
                if self._known_ns is None and arrival_ns - self._first_ns > WRONG_NS:
                    self._tell("it does not state its clock: no RTCP sender report, no Unix time")
                return latest_ns
            self._known_ns = arrival_ns if self._known_ns is None else self._known_ns
            shift_ns += 0 if self._exact else MOST_DRIFT * (arrival_ns - self._known_ns)
        delay_ns = shift_ns + self._clock.wall_ns() - self._clock.now_ns()  # anew each time: a wall clock is set
        if not -AHEAD_NS <= delay_ns <= SAME_CLOCK_NS:
            self._wrong_ns = arrival_ns if self._wrong_ns is None else self._wrong_ns
            side = "behind" if delay_ns > 0 else "ahead of"
            what = f"its clock is {abs(delay_ns) / NS_PER_S:.1f} s {side} the gateway's"
            self._tell(what)
            if arrival_ns - self._wrong_ns > WRONG_NS:
                raise LinkError(f"{self._label}: {what}")
            return latest_ns
        self._wrong_ns = None
        if settled:
            self._shift_ns = None if self._exact else shift_ns
            self.proof = AgeProof.DEVICE_TIME
        return latest_ns - max(0, round(delay_ns))

    def _tell(self, what: str) -> None:
        if not self._told:
            log.error("%s: %s; the age of its frames is not proven (camera.clock)", self._label, what)
        self._told = True


class BufferTime:
    """A V4L2 buffer's stamp: of CLOCK_MONOTONIC, as nearly every driver gives it, else of another clock.

    `behind_ns`: how far CLOCK_MONOTONIC is behind the gateway's clock now (`clock.suspended_ns`).
    """

    def __init__(self, behind_ns: Callable[[], int]) -> None:
        self._behind_ns = behind_ns
        self._own_clock = PresentationTime()
        self.proof = AgeProof.UNPROVEN

    def taken_ns(self, arrival_ns: int, stamp_ms: float) -> int:
        taken_ns = stamp_ms * NS_PER_MS + self._behind_ns()
        if stamp_ms > 0 and 0 <= arrival_ns - taken_ns <= SAME_CLOCK_NS:
            self.proof = AgeProof.BUFFER_TIME
            return round(taken_ns)
        taken_ns = self._own_clock.taken_ns(arrival_ns, stamp_ms)
        self.proof = self._own_clock.proof if stamp_ms > 0 else AgeProof.UNPROVEN  # a driver without stamps gives 0
        return taken_ns
