"""One ranger over its life: who speaks, what is missing, how old a reading is, whether it can be believed. Sans-IO.

Time is an argument: `arrived_ns` is when the bytes were in the host's hands, `now_ns` the present, both monotonic. The
owner calls `opened` for every connection, `feed` with what comes, `tick` about every 0.1 s, and `lost` at the end.
"""

from collections import Counter, deque
from dataclasses import replace

from gateway.config import RangerConfig
from gateway.core.model import Quality, RangeReading, RangeStats
from gateway.ranger.conditioning import GlitchGate, MedianFilter, Verdict
from gateway.ranger.hcsr04.arrival_times import Pace, Place
from gateway.ranger.hcsr04.protocol import (
    HELLO_PERIOD_S,
    PERIOD_MS,
    PROTOCOL_VERSION,
    TICK_NS,
    Damaged,
    Decoder,
    Flags,
    Hello,
    Measurement,
    reset_cause,
)

MS = 1_000_000
S = 1000 * MS

BOOT_NS = 2 * S
"""Opening the port pulls DTR, which resets an Uno: its boot loader listens for so long before the sketch runs."""
SILENCE_NS = 1 * S
"""No measurement for so long: reported, and the ranger is asked for a hello."""
ASK_NS = 1 * S
REPEAT_NS = S // 10
"""A lasting trouble is said again after so long."""
HELLO_DEADLINE_NS = (HELLO_PERIOD_S + 1) * S
RATE_NS = 1 * S
LINK_LATENCY_NS = 1 * MS
"""Between the last bit and the host: one frame of full-speed USB."""
MEMORY_CYCLES = 5
"""The glitch gate compares readings at most so many cycles apart."""

NEAREST_MM, FARTHEST_MM = 20.0, 4000.0  # the HC-SR04's datasheet

# The worst first: what is wrong with a measurement that carries several flags.
FLAG_QUALITY: tuple[tuple[Flags, Quality], ...] = (
    (Flags.STUCK_HIGH, Quality.STUCK),
    (Flags.NO_RISING_EDGE, Quality.STUCK),
    (Flags.NO_ECHO, Quality.NO_ECHO),
    (Flags.TOO_NEAR, Quality.TOO_NEAR),
    (Flags.TOO_FAR, Quality.TOO_FAR),
)


def speed_of_sound_m_s(temperature_c: float) -> float:
    """In air, to first order; the paper's V_s."""
    return 331.3 + 0.606 * temperature_c


def distance_mm(ticks: int, temperature_c: float) -> float:
    """Equation 12: Z = V_s dt / 2."""
    return speed_of_sound_m_s(temperature_c) * ticks * TICK_NS / 2e6


class Session:
    """Everything the gateway knows of one ranger. Counters outlive connections, the rest does not."""

    def __init__(self, config: RangerConfig) -> None:
        self._temperature_c = config.temperature_c
        self._temperature_tolerance_c = config.temperature_tolerance_c
        self._byte_ns = 10 * S // config.baud
        self._gate = GlitchGate(config.glitch_gate_mm, MEMORY_CYCLES * PERIOD_MS * MS)
        self._median = MedianFilter(config.median)
        self._stats = RangeStats()
        self._connections = 0
        self.damage: Counter[str] = Counter()
        """Damaged lines by protocol.Damage."""
        self.unused: Counter[Place] = Counter()
        """Good lines whose distance was not looked at, by pace.Place."""
        self.unbelieved_temperatures = 0
        self.reboots = 0
        self.undelivered = 0
        """Readings that nobody was free to take; counted by the owner."""
        self._start(None)

    def _start(self, now_ns: int | None) -> None:
        self._decoder = Decoder()
        self._hello: Hello | None = None
        self._pace = Pace()
        self._opened_ns = now_ns
        self._asked_ns: int | None = None
        self._heard_ns: int | None = None  # any byte
        self._measured_ns: int | None = None  # a measurement, usable or not
        self._hello_ns: int | None = None
        self._seq = 0
        self._after_hello = False  # a hello came after the newest measurement
        self._damaged_here = 0
        self._said: tuple[Quality, int] | None = None
        self._arrivals: deque[int] = deque(maxlen=256)
        self._gate.reset()
        self._median.reset()

    @property
    def hello(self) -> Hello | None:
        """The newest hello of this connection."""
        return self._hello

    @property
    def stats(self) -> RangeStats:
        return self._stats

    # -- what the owner calls ------------------------------------------------------------------------------------

    def opened(self, now_ns: int) -> list[RangeReading]:
        """A connection is open, and its input was flushed: forget what belongs to the one before."""
        self._start(now_ns)
        self._connections += 1
        self._stats = replace(self._stats, reopens=self._connections - 1, rate_hz=0.0)
        return self._say(Quality.WAITING, now_ns, "port open, waiting for the ranger")

    def lost(self, now_ns: int, detail: str) -> RangeReading:
        """The port cannot be opened, or is gone."""
        self._stats = replace(self._stats, rate_hz=0.0)
        return RangeReading(now_ns, Quality.LINK_DOWN, detail=detail, stats=self._stats)

    def question_due(self, now_ns: int) -> bool:
        """True: send protocol.QUESTION now. At once after opening, then once a second while something is amiss."""
        if self._asked_ns is not None and now_ns - self._asked_ns < ASK_NS:
            return False
        if self._hello is not None and not self._silent(now_ns):
            return False
        self._asked_ns = now_ns
        return True

    def feed(self, data: bytes, arrived_ns: int) -> list[RangeReading]:
        """Bytes that were complete at `arrived_ns`; readings in the order of their lines."""
        if data:
            self._heard_ns = arrived_ns
        readings: list[RangeReading] = []
        after = len(data)
        for line in data.splitlines(keepends=True):
            after -= len(line)
            # What follows the line in the same delivery was on the wire later than the line.
            end_ns = arrived_ns - after * self._byte_ns
            for event in self._decoder.feed(line):
                if isinstance(event, Damaged):
                    self.damage[event.kind] += 1
                    self._damaged_here += 1
                    self._count(damaged=1)
                elif isinstance(event, Hello):
                    readings += self._on_hello(event, arrived_ns)
                else:
                    readings += self._on_measurement(event, arrived_ns, end_ns)
        return readings

    def tick(self, now_ns: int) -> list[RangeReading]:
        """Time passes: silence and lasting troubles are reported, about every 0.1 s."""
        if self._opened_ns is None:
            self._opened_ns = now_ns
        self._rate(now_ns)
        if self._wrong_version() and not self._deaf(now_ns):
            return self._say(Quality.WRONG_VERSION, now_ns, self._version_detail())
        if self._silent(now_ns):
            return self._say(Quality.STALE, now_ns, self._silence_detail(now_ns))
        if self._hello is None or self._measured_ns is None:
            return self._say(Quality.WAITING, now_ns, self._waiting_detail())
        return []

    # -- lines ---------------------------------------------------------------------------------------------------

    def _on_hello(self, hello: Hello, arrived_ns: int) -> list[RangeReading]:
        self._hello, self._hello_ns, self._after_hello = hello, arrived_ns, True
        if self._wrong_version():
            self._gate.reset()
            self._median.reset()
            return self._say(Quality.WRONG_VERSION, arrived_ns, self._version_detail())
        self._pace.period_ns = hello.period_ms * MS
        self._gate.memory_ns = MEMORY_CYCLES * hello.period_ms * MS
        return []

    def _on_measurement(self, m: Measurement, arrived_ns: int, end_ns: int) -> list[RangeReading]:
        self._measured_ns = arrived_ns
        self._seq = m.seq
        self._arrivals.append(arrived_ns)
        self._rate(arrived_ns)
        placed = self._pace.place(m.seq, arrived_ns, end_ns, after_hello=self._after_hello)
        self._after_hello = False
        self._count(lines=1, gaps=placed.missing)
        if placed.restarted:
            self.reboots += 1
            self._gate.reset()
        if placed.restarted or placed.missing or placed.place is Place.BACKLOG:
            self._median.reset()
        if self._hello is None:
            return []  # the version is not known: tick says WAITING
        if self._wrong_version():
            return self._say(Quality.WRONG_VERSION, arrived_ns, self._version_detail())
        if placed.place is not Place.LIVE:
            self.unused[placed.place] += 1
            self._count(rejected=1)
            return []
        # The sound met the target half a flight before ECHO fell, and the line began when ECHO fell.
        t_ns = placed.end_ns - m.size * self._byte_ns - LINK_LATENCY_NS - m.ticks * TICK_NS // 2
        return self._reading(m, t_ns)

    def _air_c(self, m: Measurement) -> float:
        """Measured where that can be; a thermometer that is broken says 85 or -40 and would bend every distance."""
        if m.temperature_dc is None:
            return self._temperature_c
        measured_c = m.temperature_dc / 10
        if abs(measured_c - self._temperature_c) <= self._temperature_tolerance_c:
            return measured_c
        self.unbelieved_temperatures += 1
        return self._temperature_c

    def _reading(self, m: Measurement, t_ns: int) -> list[RangeReading]:
        temperature_c = self._air_c(m)
        raw_mm = distance_mm(m.ticks, temperature_c)
        quality = next((q for flag, q in FLAG_QUALITY if m.flags & flag), Quality.GOOD)
        if quality is Quality.GOOD and raw_mm < NEAREST_MM:
            quality = Quality.TOO_NEAR
        elif quality is Quality.GOOD and raw_mm > FARTHEST_MM:
            quality = Quality.TOO_FAR  # clones say 3300 cm where they heard nothing
        if quality is not Quality.GOOD:
            self._median.reset()
            verdict = self._gate.fault(t_ns)
        else:
            verdict = self._gate.distance(raw_mm, t_ns)
        if verdict is Verdict.HOLD:
            self._count(rejected=1)
            return []
        if verdict is Verdict.UNSTABLE:
            self._median.reset()
            self._count(rejected=1)
            return self._emit(t_ns, Quality.UNSTABLE, None, m.seq, f"readings jump, now {raw_mm:.0f} mm")
        if quality is not Quality.GOOD:
            flags = "|".join(flag.name or "" for flag in m.flags) or f"{raw_mm:.0f} mm"
            return self._emit(t_ns, quality, None, m.seq, flags)
        value_mm, value_ns = self._median.push(raw_mm, t_ns)
        return self._emit(value_ns, Quality.GOOD, value_mm, m.seq, "", self._median.oldest_ns)

    # -- troubles ------------------------------------------------------------------------------------------------

    def _count(self, *, lines: int = 0, damaged: int = 0, gaps: int = 0, rejected: int = 0) -> None:
        s = self._stats
        self._stats = replace(
            s,
            lines=s.lines + lines,
            damaged=s.damaged + damaged,
            gaps=s.gaps + gaps,
            rejected=s.rejected + rejected,
        )

    def _wrong_version(self) -> bool:
        return self._hello is not None and self._hello.version != PROTOCOL_VERSION

    def _silent(self, now_ns: int) -> bool:
        """No measurement for SILENCE_NS, the time to boot allowed for."""
        opened_ns = now_ns if self._opened_ns is None else self._opened_ns
        if now_ns - opened_ns < BOOT_NS and self._measured_ns is None:
            return False
        heard_ns = opened_ns if self._measured_ns is None else self._measured_ns
        return now_ns - heard_ns >= SILENCE_NS

    def _deaf(self, now_ns: int) -> bool:
        """No hello for longer than its period."""
        return self._hello_ns is None or now_ns - self._hello_ns > HELLO_DEADLINE_NS

    def _version_detail(self) -> str:
        if self._hello is None:
            return ""
        return f"{self._hello.name} speaks protocol version {self._hello.version}, this gateway {PROTOCOL_VERSION}"

    def _waiting_detail(self) -> str:
        return "waiting for the ranger's hello" if self._measured_ns is not None else "waiting for the ranger"

    def _silence_detail(self, now_ns: int) -> str:
        since_ns = self._measured_ns if self._measured_ns is not None else self._opened_ns
        seconds = 0.0 if since_ns is None else (now_ns - since_ns) / S
        if self._heard_ns is None or now_ns - self._heard_ns >= SILENCE_NS:
            return f"nothing heard for {seconds:.0f} s"
        if self._hello is None and self._damaged_here:
            return f"bytes, but no good line for {seconds:.0f} s: wrong baud rate, or not a ranger"
        return f"no measurement for {seconds:.0f} s"

    def _say(self, quality: Quality, now_ns: int, detail: str) -> list[RangeReading]:
        """A trouble without a line of its own: at once when it is new, then again every REPEAT_NS."""
        if self._said is not None and self._said[0] is quality and now_ns - self._said[1] < REPEAT_NS:
            return []
        return self._emit(now_ns, quality, None, self._seq, detail)

    def _emit(
        self,
        t_ns: int,
        quality: Quality,
        value_mm: float | None,
        seq: int,
        detail: str,
        oldest_ns: int | None = None,
    ) -> list[RangeReading]:
        self._said = (quality, t_ns)
        return [RangeReading(t_ns, quality, value_mm, seq, detail, self._stats, oldest_ns)]

    def _rate(self, now_ns: int) -> None:
        """Measurements a second, over about the last second."""
        while self._arrivals and now_ns - self._arrivals[0] > RATE_NS:
            self._arrivals.popleft()
        spread_ns = self._arrivals[-1] - self._arrivals[0] if self._arrivals else 0
        rate_hz = (len(self._arrivals) - 1) * S / spread_ns if spread_ns else 0.0
        self._stats = replace(self._stats, rate_hz=rate_hz)


def describe(hello: Hello) -> str:
    """For people: who speaks."""
    return (
        f"{hello.name}, protocol version {hello.version}, a measurement every {hello.period_ms} ms, "
        f"last reset: {reset_cause(hello.mcusr)}"
    )
