"""One HC-SR04 with its board over its life: its identification, its faults, the age and meaning of a line. Sans-IO.

Time is an argument: `arrived_ns` is when the bytes arrived at the host, `now_ns` the present, both monotonic. The
methods are described in gateway/ranger/contract.py.
"""

from collections import Counter
from dataclasses import replace
from math import inf

from gateway.config import RangerConfig
from gateway.core import details
from gateway.core.beacon import BeaconCode
from gateway.core.readings import Quality, RangeReading, RangeStats
from gateway.core.relay import RelayDecision
from gateway.ranger.arrival_times import Arrival, ArrivalTracker
from gateway.ranger.conditioning import Conditioner
from gateway.ranger.contract import RangerType
from gateway.ranger.hcsr04.protocol import (
    BEACON_CYCLES,
    BEACON_REQUEST,
    BURST_NS,
    HELLO_PERIOD_S,
    PERIOD_MS,
    PROTOCOL_VERSION,
    QUESTION,
    TICK_NS,
    Damaged,
    Decoder,
    Flags,
    Hello,
    Measurement,
    reset_cause,
)
from gateway.ranger.hcsr04.relay import RelayRenewal

MS = 1_000_000
S = 1000 * MS

BOOT_NS = 2 * S
"""Opening the port pulls DTR, which resets an Uno: its boot loader listens for this time before the sketch runs."""
SILENCE_NS = 1 * S
"""No measurement for this time: reported, and a hello is requested from the ranger."""
ASK_NS = 1 * S
HELLO_DEADLINE_NS = (HELLO_PERIOD_S + 1) * S
LINK_LATENCY_NS = 1 * MS
"""Between the last bit and the host: one frame of full-speed USB."""

TEMPERATURE_DUE_NS = 5 * S
"""No believed temperature for this time is a loss. After a reset the first one takes the board 1 s."""
TEMPERATURE_K_S = 0.5
"""The temperature of the sound changes no faster: where one is lost or returns, a truck in place would else seem to
roll. So Z changes by less than `rolling.FOLLOW_MM_S`, up to 1.1 m. Only the first one is taken at once, and only within
TEMPERATURE_DUE_NS of the first measurement that was used since the gateway's start."""
TEMPERATURE_STEP_NS = 1 * S
"""A longer gap between two measurements allows no greater step of the temperature than this time does."""

NEAREST_MM, FARTHEST_MM = 20.0, 4000.0  # the HC-SR04's datasheet

# The worst first: what is wrong with a measurement that carries several flags.
FLAG_QUALITY: tuple[tuple[Flags, Quality], ...] = (
    (Flags.STUCK_HIGH, Quality.STUCK),
    (Flags.NO_RISING_EDGE, Quality.STUCK),
    (Flags.NO_ECHO, Quality.NO_ECHO),
    (Flags.TOO_NEAR, Quality.TOO_NEAR),
    (Flags.TOO_FAR, Quality.TOO_FAR),
)

# When the line of a measurement that is not valid begins, after the trigger.
FLAG_AFTER_NS = {Flags.STUCK_HIGH: PERIOD_MS * MS, Flags.NO_RISING_EDGE: 10 * MS, Flags.NO_ECHO: 38 * MS}


def speed_of_sound_m_s(temperature_c: float) -> float:
    """In air, to first order; the paper's V_s."""
    return 331.3 + 0.606 * temperature_c


def distance_mm(ticks: int, temperature_c: float) -> float:
    """Equation 12: Z = V_s dt / 2."""
    return speed_of_sound_m_s(temperature_c) * ticks * TICK_NS / 2e6


class Hcsr04Session:
    """The state of one ranger in the gateway. Counters outlive connections, the rest does not."""

    def __init__(self, config: RangerConfig) -> None:
        self._temperature_c = self._sound_c = config.hcsr04.temperature_c
        self._temperature_expected = config.hcsr04.temperature_sensor
        self._temperature_heard = False  # since the gateway's start
        self._sound_ns: int | None = None  # of the newest _sound_c
        self._settled_ns = 0  # from then on it never jumps
        self._temperature_tolerance_c = config.hcsr04.temperature_tolerance_c
        self._byte_ns = config.byte_ns
        self._beacon_wanted = config.hcsr04.beacon
        self._conditioner = Conditioner(config, PERIOD_MS * MS)
        self.damage: Counter[str] = Counter()
        """Damaged lines by protocol.Damage."""
        self.unused: Counter[Arrival] = Counter()
        """Good lines whose distance was not used."""
        self.implausible_temperatures = 0
        self.reboots = 0
        self._relay = RelayRenewal() if config.hcsr04.relay else None
        self._start(None)

    def _start(self, now_ns: int | None) -> None:
        self._decoder = Decoder()
        self.hello: Hello | None = None
        """The newest hello of this connection."""
        self._arrivals = ArrivalTracker(PERIOD_MS * MS)
        self._opened_ns = now_ns
        self._asked_ns: int | None = None
        self._beacon_asked_ns: int | None = None
        self._beacon = False  # the newest line carried its code
        self._air_c: float | None = None  # of the newest measurement
        self._air_ns = now_ns or 0  # of the newest one with a temperature; none yet: since when one is expected
        self._temperature_lost = False
        self._received_ns: int | None = None  # any byte
        self._measured_ns: int | None = None  # a measurement, usable or not
        self._hello_ns: int | None = None
        self._seq = 0
        self._after_hello = False  # a hello arrived after the newest measurement
        self._damaged_here = 0

    @property
    def stats(self) -> RangeStats:
        return self._conditioner.stats

    @property
    def identity(self) -> str:
        hello = self.hello
        if hello is None:
            return ""
        if hello.version != PROTOCOL_VERSION:
            return f"{hello.name}, protocol version {hello.version}"
        return (
            f"{hello.name}, protocol version {hello.version}, a measurement every {hello.period_ms} ms, "
            f"last reset: {reset_cause(hello.mcusr)}"
        )

    # -- what the service calls ----------------------------------------------------------------------------------

    def opened(self, now_ns: int) -> list[RangeReading]:
        self._start(now_ns)
        self._conditioner.opened()
        if self._relay is not None:
            self._relay.opened()
        return self._fault(Quality.WAITING, now_ns, details.PORT_OPEN())

    def lost(self, now_ns: int, detail: str) -> RangeReading:
        return self._conditioner.lost(now_ns, detail)

    def decided(self, decision: RelayDecision) -> None:
        """What the relay is to do; may be called by another thread."""
        if self._relay is not None:
            self._relay.decision = decision

    def request(self, now_ns: int) -> bytes:
        """The question for a hello, the request for the beacon, and the command for the relay."""
        command = b""
        if self._relay is not None:
            command = self._relay.request(now_ns, 1 / distance_mm(1, self._sound_c))
        return self._question(now_ns) + self._beacon_request(now_ns) + command

    def _beacon_request(self, now_ns: int) -> bytes:
        waits = self._beacon_asked_ns is not None and now_ns - self._beacon_asked_ns < ASK_NS
        if not self._beacon_wanted or self._beacon or waits or self._measured_ns is None:
            return b""
        self._beacon_asked_ns = now_ns
        return BEACON_REQUEST

    def _question(self, now_ns: int) -> bytes:
        """At once after opening, then once a second while something is missing."""
        if self._asked_ns is not None and now_ns - self._asked_ns < ASK_NS:
            return b""
        if self.hello is not None and not self._silent(now_ns):
            return b""
        self._asked_ns = now_ns
        return QUESTION

    def feed(self, data: bytes, arrived_ns: int) -> list[RangeReading]:
        """Readings in the order of their lines."""
        readings = self._with_relay(self._feed(data, arrived_ns), arrived_ns)
        if self._air_c is None and not self._temperature_lost:
            return readings
        return [replace(reading, air_c=self._air_c, temperature_lost=self._temperature_lost) for reading in readings]

    def _feed(self, data: bytes, arrived_ns: int) -> list[RangeReading]:
        if data:
            self._received_ns = arrived_ns
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
                    self._conditioner.count(damaged=1)
                elif isinstance(event, Hello):
                    readings += self._on_hello(event, arrived_ns)
                else:
                    readings += self._on_measurement(event, arrived_ns, end_ns)
        return readings

    def tick(self, now_ns: int) -> list[RangeReading]:
        return self._with_relay(self._tick(now_ns), now_ns)

    def _tick(self, now_ns: int) -> list[RangeReading]:
        if self._opened_ns is None:
            self._opened_ns = now_ns
        self._conditioner.update_rate(now_ns)
        if self._wrong_version() and not self._hello_overdue(now_ns):
            return self._fault(Quality.WRONG_VERSION, now_ns, self._version_detail())
        if self._silent(now_ns):
            return self._fault(Quality.STALE, now_ns, self._silence_detail(now_ns))
        if self.hello is None or self._measured_ns is None:
            waiting = details.WAITING_RANGER if self._measured_ns is None else details.WAITING_HELLO
            return self._fault(Quality.WAITING, now_ns, waiting())
        return []

    def _with_relay(self, readings: list[RangeReading], now_ns: int) -> list[RangeReading]:
        if self._relay is None:
            return readings
        return [replace(reading, relay=self._relay.status(now_ns)) for reading in readings]

    # -- lines ---------------------------------------------------------------------------------------------------

    def _on_hello(self, hello: Hello, arrived_ns: int) -> list[RangeReading]:
        self.hello, self._hello_ns, self._after_hello = hello, arrived_ns, True
        if self._wrong_version():
            self._conditioner.restarted()
            return self._fault(Quality.WRONG_VERSION, arrived_ns, self._version_detail())
        self._arrivals.period_ns = hello.period_ms * MS
        self._conditioner.set_cycle(hello.period_ms * MS)
        return []

    def _on_measurement(self, m: Measurement, arrived_ns: int, end_ns: int) -> list[RangeReading]:
        self._measured_ns = arrived_ns
        self._seq = m.seq
        self._beacon = m.beacon is not None
        self._conditioner.arrived(arrived_ns)
        line = self._arrivals.judge(m.seq, arrived_ns, end_ns, after_hello=self._after_hello)
        self._after_hello = False
        self._conditioner.count(lines=1, gaps=line.missing)
        if line.restarted:
            self.reboots += 1
            self._air_ns = arrived_ns
            self._conditioner.restarted()
        elif line.missing or line.arrival is Arrival.BACKLOG:
            self._conditioner.gap()
        if self.hello is None:
            return []  # the version is not known: tick reports WAITING
        if self._wrong_version():
            return self._fault(Quality.WRONG_VERSION, arrived_ns, self._version_detail())
        if line.arrival is not Arrival.LIVE:
            self.unused[line.arrival] += 1
            self._conditioner.count(rejected=1)
            return []
        if self._relay is not None:
            self._relay.measured(m, arrived_ns)
        # The sound met the target half a flight before ECHO fell, and the line began when ECHO fell.
        t_ns = line.end_ns - m.size * self._byte_ns - LINK_LATENCY_NS - m.ticks * TICK_NS // 2
        self._take_temperature(m, arrived_ns)
        raw_mm = distance_mm(m.ticks, self._sound_c)
        quality = next((q for flag, q in FLAG_QUALITY if m.flags & flag), Quality.GOOD)
        if quality is Quality.GOOD and raw_mm < NEAREST_MM:
            quality = Quality.TOO_NEAR
        elif quality is Quality.GOOD and raw_mm > FARTHEST_MM:
            quality = Quality.TOO_FAR  # clones report 3300 cm where they received no echo
        flags = "|".join(flag.name or "" for flag in m.flags)
        readings = self._conditioner.measured(raw_mm, quality, t_ns, m.seq, flags)
        if m.beacon is None or not readings:
            return readings
        code = self._code(m.beacon, m, line.end_ns - m.size * self._byte_ns - LINK_LATENCY_NS)
        return [replace(reading, beacon=code) for reading in readings]

    def _code(self, lit: int, m: Measurement, begun_ns: int) -> BeaconCode:
        """`begun_ns`: the line began, as soon as the board knew what became of the cycle."""
        after_ns = next((ns for flag, ns in FLAG_AFTER_NS.items() if m.flags & flag), BURST_NS + m.ticks * TICK_NS)
        known = min(BEACON_CYCLES, m.seq + 1)  # before a reset it was another code
        states = tuple(bool(lit >> n & 1) for n in reversed(range(known)))
        return BeaconCode(begun_ns - after_ns, self._arrivals.period_ns, states)

    def _take_temperature(self, m: Measurement, arrived_ns: int) -> None:
        """Measured where that is plausible; a broken thermometer reports 85 or -40 and would falsify every distance."""
        self._air_c = None if m.temperature_dc is None else m.temperature_dc / 10
        if self._air_c is not None and abs(self._air_c - self._temperature_c) > self._temperature_tolerance_c:
            self.implausible_temperatures += 1
            self._air_c = None
        if self._sound_ns is None:
            self._sound_ns, self._settled_ns = arrived_ns, arrived_ns + TEMPERATURE_DUE_NS
        most_k = TEMPERATURE_K_S * min(arrived_ns - self._sound_ns, TEMPERATURE_STEP_NS) / S
        if self._air_c is not None:
            if not self._temperature_heard and arrived_ns < self._settled_ns:
                most_k = inf
            self._temperature_heard, self._air_ns = True, arrived_ns
        wanted_c = self._temperature_c if self._air_c is None else self._air_c
        self._sound_c += max(-most_k, min(most_k, wanted_c - self._sound_c))
        self._sound_ns = arrived_ns
        due = self._temperature_expected or self._temperature_heard
        self._temperature_lost = due and arrived_ns - self._air_ns >= TEMPERATURE_DUE_NS

    # -- faults --------------------------------------------------------------------------------------------------

    def _fault(self, quality: Quality, now_ns: int, detail: str) -> list[RangeReading]:
        return self._conditioner.fault(quality, now_ns, self._seq, detail)

    def _wrong_version(self) -> bool:
        return self.hello is not None and self.hello.version != PROTOCOL_VERSION

    def _silent(self, now_ns: int) -> bool:
        """No measurement for SILENCE_NS, the time to boot allowed for."""
        opened_ns = now_ns if self._opened_ns is None else self._opened_ns
        if now_ns - opened_ns < BOOT_NS and self._measured_ns is None:
            return False
        heard_ns = opened_ns if self._measured_ns is None else self._measured_ns
        return now_ns - heard_ns >= SILENCE_NS

    def _hello_overdue(self, now_ns: int) -> bool:
        """No hello for longer than its period."""
        return self._hello_ns is None or now_ns - self._hello_ns > HELLO_DEADLINE_NS

    def _version_detail(self) -> str:
        if self.hello is None:
            return ""
        return details.RANGER_VERSION(self.hello.name, self.hello.version, PROTOCOL_VERSION)

    def _silence_detail(self, now_ns: int) -> str:
        since_ns = self._measured_ns if self._measured_ns is not None else self._opened_ns
        seconds = 0.0 if since_ns is None else (now_ns - since_ns) / S
        if self._received_ns is None or now_ns - self._received_ns >= SILENCE_NS:
            return details.NOTHING_RECEIVED(f"{seconds:.0f}")
        if self.hello is None and self._damaged_here:
            return details.NO_GOOD_LINE(f"{seconds:.0f}")
        return details.NO_MEASUREMENT(f"{seconds:.0f}")


RANGER = RangerType(Hcsr04Session, period_s=lambda _: PERIOD_MS / 1000, max_range_mm=lambda _: FARTHEST_MM)
