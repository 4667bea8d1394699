"""The simulated ranger without its pty: an Uno with an HC-SR04, bytes leaving it at the pace of the wire. Pure.

`advance(now_ns)` returns the bytes that have left since the last call; time may run at any speed.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from enum import StrEnum
from random import Random

from gateway.core.readings import RelayOutput
from gateway.ranger.hcsr04.protocol import (
    BEACON_CYCLES,
    BEACON_REQUEST,
    HELLO_PERIOD_S,
    MAX_SEQ,
    PERIOD_MS,
    PROTOCOL_VERSION,
    QUESTION,
    RELAY_HOLD_MS,
    Flags,
    Hello,
    Measurement,
    RelayCommand,
    RelayReport,
    commands_in,
    encode_hello,
    encode_measurement,
)
from gateway.ranger.hcsr04.session import FARTHEST_MM, NEAREST_MM
from gateway.sim.hcsr04 import Echo, SensorErrors, echo_at, flight_ns, measure, no_echo

NAME = "hcsr04-sim"  # in its hello
BYTE_NS = 10_000_000_000 // 9600  # 10 bits at 9600 baud
PERIOD_NS = PERIOD_MS * 1_000_000
HELLO_NS = HELLO_PERIOD_S * 1_000_000_000
SKIP_CYCLES = 20
"""Behind by more than this (a stopped process), cycles pass unheard."""
WIRE_LINES = 8
"""Lines the board keeps for a busy wire; a further one is lost and counted."""

HOLD_NS = RELAY_HOLD_MS * 1_000_000
RELAY_NUMBERS, RELAY_ODD, RELAY_PAUSE = 4, 2, 3  # as in firmware/ranger/src/relay.h
MAX_COMMAND = 64  # bytes of a command that is not complete

POWER_ON, RESET_LINE = 1, 2  # MCUSR


class RangerFault(StrEnum):
    """What can be wrong with a ranger."""

    SILENT = "silent"  # the board has power, but sends and receives nothing
    NO_ECHO = "no_echo"
    STUCK = "stuck"  # ECHO held high, as an HC-SR04P can
    TOO_NEAR = "too_near"
    TOO_FAR = "too_far"
    SCATTER = "scatter"  # readings scatter; amount: standard deviation, mm
    ECHO = "echo"  # of something nearer than the target, where that is nearer; amount: its distance, mm
    WILD = "wild"  # true and wild readings alternate, as clones do; amount: the wild distance, mm
    LINE_NOISE = "line_noise"  # bytes flipped, lost and made up on the wire; amount: share of bytes hit
    UNPLUGGED = "unplugged"  # acted on by the pty around the board
    WRONG_VERSION = "wrong_version"  # the board reboots with another firmware; amount: its protocol version
    NO_TEMPERATURE = "no_temperature"  # its thermometer, if it has one, is gone


Faults = Mapping[RangerFault, float]
"""The faults that hold now, with their amounts; 0 for those that take none."""


class RelayBoard:
    """The board's relay as in firmware/ranger/src/relay.c, but for one thing: a number may be used twice."""

    def __init__(self, run: int) -> None:
        self.output = RelayOutput.NONE
        self._run, self._asked, self._heard = run, False, b""
        self._issued: dict[int, int] = {}  # the newest numbers, and when they were issued, ns
        self._band, self._ticks, self._odd, self._pause, self._ends_ns = (0, 0), 0, 0, 0, 0

    def hear(self, data: bytes) -> None:
        self._heard += data
        for command in commands_in(self._heard):
            self._obey(command)
        self._heard = self._heard.rpartition(b"\n")[2][-MAX_COMMAND:]

    def measured(self, seq: int, echo: Echo, now_ns: int) -> RelayReport | None:
        """The field of the measurement's line; None: the board was not asked for it."""
        if not self._asked:
            return None
        self._issued = dict([*self._issued.items(), (seq, now_ns)][-RELAY_NUMBERS:])
        self._ticks = 0 if echo.flags else echo.ticks
        self._pause = max(0, self._pause - 1)
        self._odd = 0 if self._inside() else min(RELAY_ODD, self._odd + 1)
        pins = self.output
        if self._odd == RELAY_ODD:
            self._off()
        return RelayReport(self._run, self.output, pins)

    def poll(self, now_ns: int) -> None:
        if now_ns >= self._ends_ns:
            self._off()

    def _obey(self, command: RelayCommand) -> None:
        self._asked = True
        if command.output is RelayOutput.NONE:
            self._off()
        elif command.run == self._run and (issued_ns := self._issued.get(command.seq)) is not None:
            if self.output is not command.output:
                self._off()
            self._band = (command.nearest_ticks, command.farthest_ticks)
            if self.output is RelayOutput.NONE:
                if self._pause or not self._inside():
                    return
                self._odd = 0
            self.output, self._ends_ns = command.output, issued_ns + HOLD_NS

    def _inside(self) -> bool:
        return self._ticks > 0 and self._band[0] <= self._ticks <= self._band[1]

    def _off(self) -> None:
        if self.output is not RelayOutput.NONE:
            self.output, self._pause = RelayOutput.NONE, RELAY_PAUSE


class RangerBoard:
    """One board, from power on. `distance_mm(t_ns)` is the truth, None where nothing is in the beam."""

    def __init__(
        self,
        distance_mm: Callable[[int], float | None],
        *,
        seed: int = 0,
        errors: SensorErrors | None = None,
        air_c: float = 20.0,
        temperature_sensor: bool = False,
        boot_ns: int = 0,
    ) -> None:
        self.faults: Faults = {}
        self.show: Callable[[int, bool], None] | None = None
        """Called with each state of the beacon's LED and when it begins, a cycle ahead: in time for a picture of it."""
        self._distance_mm = distance_mm
        self._errors = errors or SensorErrors()
        self._air_c, self._boot_ns = air_c, boot_ns
        self._temperature_sensor = temperature_sensor
        self._sensor, self._noise = Random(f"{seed}/sensor"), Random(f"{seed}/noise")
        self._runs = Random(f"{seed}/runs")
        self._code = Random(f"{seed}/code")
        self._wire: deque[tuple[int, bytes]] = deque()  # (time of the first start bit, bytes still to go)
        self._version = PROTOCOL_VERSION
        self._lit, self._lit_ns = False, 0
        self.lost_lines = 0

    def boot(self, now_ns: int, mcusr: int) -> None:
        """Power on or reset: the boot loader's wait, then hello and sequence number 0."""
        self._mcusr = mcusr
        self._seq = 0
        self.relay = RelayBoard(self._runs.getrandbits(16))
        self._beacon: int | None = None
        self._wire.clear()
        self._up_ns = self._wire_free_ns = self._trigger_ns = now_ns + self._boot_ns
        if self._lit:
            self._light(self._up_ns, False)
        self._hello(self._up_ns)

    def hear(self, data: bytes, now_ns: int) -> None:
        """Bytes from the host. Several questions at once get one answer."""
        if QUESTION in data and RangerFault.SILENT not in self.faults and now_ns >= self._up_ns:
            self._hello(now_ns)
        if RangerFault.SILENT not in self.faults and now_ns >= self._up_ns:
            self.relay.hear(data)
        if BEACON_REQUEST in data and self._beacon is None and now_ns >= self._up_ns:
            self._beacon = 0
            self._draw(self._trigger_ns)

    def advance(self, now_ns: int) -> bytes:
        """Run up to `now_ns`; the bytes that were completely sent since the last call."""
        version = round(self.faults.get(RangerFault.WRONG_VERSION, PROTOCOL_VERSION))
        if version != self._version:  # as if flashed anew
            self._version = version
            self.boot(now_ns, RESET_LINE)
        behind = (now_ns - self._trigger_ns) // PERIOD_NS
        if behind > SKIP_CYCLES:
            self._seq = (self._seq + behind) & MAX_SEQ
            self._trigger_ns += behind * PERIOD_NS
        while self._trigger_ns <= now_ns:
            self._cycle(self._trigger_ns)
            self._trigger_ns += PERIOD_NS
        self.relay.poll(now_ns)
        sent = bytearray()
        while self._wire:
            start_ns, data = self._wire[0]
            count = min(len(data), max(0, now_ns - start_ns) // BYTE_NS)
            sent += data[:count]
            if count < len(data):
                self._wire[0] = (start_ns + count * BYTE_NS, data[count:])
                break
            self._wire.popleft()
        if RangerFault.SILENT in self.faults:
            return b""
        return self._damaged(bytes(sent), self.faults.get(RangerFault.LINE_NOISE, 0.0))

    def wake_ns(self) -> int:
        """When there is something to do next: the middle or the end of a line, or the next trigger."""
        if not self._wire:
            return self._trigger_ns
        start_ns, data = self._wire[0]
        part = len(data) if len(data) <= 16 else len(data) // 2
        return min(start_ns + part * BYTE_NS, self._trigger_ns)

    def _cycle(self, trigger_ns: int) -> None:
        echo = self._echo(trigger_ns)
        if self._beacon is not None:
            self._beacon = (self._beacon << 1 | self._lit) % (1 << BEACON_CYCLES)
            self._draw(trigger_ns + PERIOD_NS)
        ready_ns = trigger_ns + min(echo.fell_ns, PERIOD_NS)
        relay = self.relay.measured(self._seq, echo, ready_ns)
        measured = self._temperature_sensor and RangerFault.NO_TEMPERATURE not in self.faults
        temperature_dc = round(10 * self._air_c) if measured else None
        measurement = Measurement(self._seq, echo.ticks, echo.flags, temperature_dc, relay, self._beacon)
        self._send(encode_measurement(measurement), ready_ns)
        self._seq = (self._seq + 1) & MAX_SEQ
        if trigger_ns - self._hello_ns >= HELLO_NS:
            self._hello(trigger_ns)

    def _draw(self, trigger_ns: int) -> None:
        self._light(trigger_ns, bool(self._code.getrandbits(1)))

    def _light(self, from_ns: int, lit: bool) -> None:
        self._lit, self._lit_ns = lit, max(from_ns, self._lit_ns)
        if self.show is not None:
            self.show(self._lit_ns, lit)

    def _echo(self, trigger_ns: int) -> Echo:
        here_mm = self._distance_mm(trigger_ns)
        if here_mm is not None:  # the sound meets the target half a flight later
            here_mm = self._distance_mm(trigger_ns + flight_ns(here_mm, self._air_c) // 2)
        faults = self.faults
        errors = self._errors
        if RangerFault.ECHO in faults:
            here_mm = min(faults[RangerFault.ECHO], math.inf if here_mm is None else here_mm)
        if RangerFault.SCATTER in faults:
            errors = replace(errors, jitter_mm=faults[RangerFault.SCATTER])
        echo = measure(here_mm, self._air_c, errors, self._sensor)
        if RangerFault.STUCK in faults:
            return Echo(0, Flags.STUCK_HIGH, PERIOD_NS)
        if RangerFault.NO_ECHO in faults:
            return no_echo()
        if RangerFault.TOO_NEAR in faults:
            return echo_at(NEAREST_MM / 2, self._air_c)
        if RangerFault.TOO_FAR in faults:
            return echo_at(FARTHEST_MM + 200.0, self._air_c)
        if RangerFault.WILD in faults and self._seq % 2:
            return echo_at(faults[RangerFault.WILD], self._air_c)
        return echo

    def _hello(self, now_ns: int) -> None:
        self._hello_ns = now_ns
        same = self._version == PROTOCOL_VERSION
        hello = Hello(NAME, self._version, PERIOD_MS, self._mcusr) if same else Hello(NAME, self._version)
        self._send(encode_hello(hello), now_ns)

    def _send(self, line: bytes, ready_ns: int) -> None:
        if len(self._wire) >= WIRE_LINES:
            self.lost_lines += 1
            return
        start_ns = max(ready_ns, self._wire_free_ns)
        self._wire_free_ns = start_ns + len(line) * BYTE_NS
        self._wire.append((start_ns, line))

    def _damaged(self, data: bytes, share: float) -> bytes:
        if not share:
            return data
        out = bytearray()
        for byte in data:
            if self._noise.random() >= share:
                out.append(byte)
                continue
            kind = self._noise.randrange(3)  # 2: the byte is lost
            if kind == 0:
                out.append(byte ^ 1 << self._noise.randrange(8))
            elif kind == 1:
                out += bytes((byte, self._noise.randrange(256)))
        return bytes(out)
