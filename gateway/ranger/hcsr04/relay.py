"""The gateway's end of the board's relay: a command for each measurement, and whether the pins follow. Sans-IO.

The board drops an output 280 ms after the measurement that the newest command replied to (docs/ranger.md). A
command needs a decision of the last DECISION_NS: without a living control task nothing is renewed.
"""

from gateway.core.readings import RelayOutput, RelayStatus
from gateway.core.relay import RelayDecision
from gateway.durations import NS_PER_MS
from gateway.ranger.hcsr04.protocol import (
    MAX_TICKS,
    RELAY_HOLD_MS,
    Measurement,
    RelayCommand,
    encode_command,
)

DECISION_NS = 50 * NS_PER_MS
"""An older decision renews nothing: with the line, that is at least 31 ms old when it is replied to, and the board's
280 ms, 300 ms from the decision."""
FAULT_NS = 500 * NS_PER_MS
"""Pins and command may differ for this time: 300 ms for the board, and two lines."""


class RelayRenewal:
    """The relay of one board on one connection."""

    def __init__(self) -> None:
        self.decision: RelayDecision | None = None
        """The newest; set by the event loop, while a thread of its own reads it."""
        self.opened()

    def opened(self) -> None:
        self._unanswered: Measurement | None = None
        self._commanded, self._commanded_ns = RelayOutput.NONE, 0
        self._pins: int | None = None
        self._heard_ns: int | None = None
        self._differs_since_ns: int | None = None
        self._fault = False

    def measured(self, measurement: Measurement, now_ns: int) -> None:
        """A line has arrived, whatever its distance is worth."""
        self._unanswered, self._heard_ns = measurement, now_ns
        report = measurement.relay
        self._pins = None if report is None else report.pins
        if self._pins == self._in_force(now_ns):
            self._differs_since_ns = None
        elif self._differs_since_ns is None:
            self._differs_since_ns = now_ns
        since_ns = self._differs_since_ns
        self._fault = since_ns is not None and now_ns - since_ns >= FAULT_NS

    def request(self, now_ns: int, ticks_per_mm: float) -> bytes:
        """The command to send now; empty: none."""
        decision, line = self.decision or RelayDecision(now_ns), self._unanswered
        off = decision.output is RelayOutput.NONE
        if not off and line is not None and line.relay is not None and now_ns - decision.t_ns > DECISION_NS:
            return b""  # not renewed, the board drops it by itself; a late control task alone need not move contacts
        if line is None and not (off and self._commanded is not RelayOutput.NONE):
            return b""
        self._unanswered = None
        report = None if line is None else line.relay
        if line is None or report is None:  # NONE also is the first command: from then on lines have numbers
            self._command(RelayOutput.NONE, now_ns)
            return encode_command(RelayCommand())
        self._command(decision.output, now_ns)
        if off:
            return b"" if report.output is RelayOutput.NONE else encode_command(RelayCommand())
        nearest, farthest = (
            min(MAX_TICKS, max(0, round(mm * ticks_per_mm))) for mm in (decision.nearest_mm, decision.farthest_mm)
        )
        return encode_command(RelayCommand(report.run, line.seq, decision.output, nearest, farthest))

    def status(self, now_ns: int) -> RelayStatus | None:
        """None: no line for as long as an output may stay on, so that nothing is known of it. A fault stands until a
        line shows the pins in order."""
        silent = self._heard_ns is None or now_ns - self._heard_ns > RELAY_HOLD_MS * NS_PER_MS
        if silent and not self._fault:
            return None
        return RelayStatus(self._in_force(now_ns), 0 if silent else self._pins or 0, self._fault)

    def _command(self, output: RelayOutput, now_ns: int) -> None:
        self._commanded, self._commanded_ns = output, now_ns

    def _in_force(self, now_ns: int) -> RelayOutput:
        """What the newest command asks for, as long as it can hold."""
        held = now_ns - self._commanded_ns <= RELAY_HOLD_MS * NS_PER_MS
        return self._commanded if held else RelayOutput.NONE
