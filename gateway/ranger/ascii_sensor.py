"""A sensor that sends lines of text by itself, such as `R1234` and a carriage return. Sans-IO.

Its lines have no number of their own. They are counted here, and judged by arrival_times.py like numbered ones: what a
serial server had stored is not used, nor a line that was held up. With a period of more than 150 ms a lost line looks
like one that was held up, until the sensor's pace has been kept again.
"""

import re
from collections import deque
from itertools import pairwise
from statistics import median
from typing import Final

from gateway.config import RangerConfig
from gateway.core import details
from gateway.core.readings import RangeReading
from gateway.ranger.arrival_times import MAX_SEQ, Arrival, ArrivalTracker
from gateway.ranger.contract import RangerType
from gateway.ranger.number_session import NumberSession

MAX_LINE: Final = 128
PACE_LINES: Final = 9
"""The sensor's pace is the median of so many lines' pauses, less one."""
SLOWEST: Final = 1.5
"""Times the configured period."""
PLACES: Final = {r"\{distance\}": rb"\s*([+-]?\d{1,10}(?:\.\d{1,10})?)\s*", r"\{any\}": rb"[^\r\n]*?"}


def compiled(pattern: str) -> re.Pattern[bytes]:
    """The line of `ranger.ascii.line`, without its last byte."""
    expression = re.escape(pattern[:-1]).encode()
    for place, meaning in PLACES.items():
        expression = expression.replace(place.encode(), meaning)
    return re.compile(expression)


class AsciiSensorSession(NumberSession):
    """Each line that fits the pattern is a distance; another one is counted as damaged."""

    def __init__(self, config: RangerConfig) -> None:
        self._line, self._end = compiled(config.ascii.line), config.ascii.line[-1].encode()
        self._byte_ns = config.byte_ns
        super().__init__(config, "a sensor that sends text")

    def _start(self, now_ns: int) -> None:
        super()._start(now_ns)
        self._buffer = b""
        self._skipping = True  # the first line may have begun before the port was open
        self._count = 0
        self._arrivals = ArrivalTracker(self.period_ns)
        self._arrived: deque[int] = deque(maxlen=PACE_LINES)

    def request(self, now_ns: int) -> bytes:
        return b""

    def feed(self, data: bytes, arrived_ns: int) -> list[RangeReading]:
        readings: list[RangeReading] = []
        *lines, rest = (self._buffer + data).split(self._end)
        after = sum(len(line) + 1 for line in lines) + len(rest)
        for line in lines:
            after -= len(line) + 1
            if self._skipping:
                self._skipping = False
                continue
            readings += self._on_line(line, arrived_ns, arrived_ns - after * self._byte_ns)
        if len(rest) > MAX_LINE:
            self._unusable(details.SENSOR_NO_LINE_END(), damaged=not self._skipping)
            rest, self._skipping = b"", True
        self._buffer = rest
        return readings

    def _on_line(self, line: bytes, arrived_ns: int, end_ns: int) -> list[RangeReading]:
        self._count = (self._count + 1) & MAX_SEQ
        self._arrived.append(arrived_ns)
        if self._slow():
            self._arrivals = ArrivalTracker(self.period_ns)
        judged = self._arrivals.judge(self._count, arrived_ns, end_ns, after_hello=False)
        found = self._line.fullmatch(line)
        if found is None:
            self._unusable(details.SENSOR_OTHER_FORM(), damaged=1)
            return []
        if judged.arrival is not Arrival.LIVE:
            self._unusable(details.SENSOR_STORED(), rejected=1)
            self._conditioner.gap()
            return []
        return self._received(float(found[1]), end_ns - (len(line) + 1) * self._byte_ns, arrived_ns)

    def _slow(self) -> bool:
        """The sensor's own period is longer than the configured one: a line that was held up could not be told."""
        if len(self._arrived) < PACE_LINES:
            return False
        return median(later - earlier for earlier, later in pairwise(self._arrived)) > SLOWEST * self.period_ns


RANGER = RangerType(
    AsciiSensorSession,
    period_s=lambda config: config.number.period_ms / 1000,
    max_range_mm=lambda config: config.number.farthest_mm,
)
