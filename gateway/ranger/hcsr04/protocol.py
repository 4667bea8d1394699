"""The ranger's line protocol, sans-IO: any bytes in, frozen events out. Never raises on what a peer sends.

A line is `$`, a body of comma-separated printable ASCII, `*`, four upper-case hex digits, CR LF; a technician can read
it in a serial monitor. The checksum is CRC-16/XMODEM over the body (`_crc_xmodem_update` from 0 in avr-libc). Numbers
are decimal without sign, leading zeros or spaces, so a message has exactly one spelling.

A measurement contains its distance twice, as time and as length. The second is for people; the decoder uses it as a
further check, so that a damaged line must get past both.
"""

import binascii
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import IntFlag, StrEnum

from gateway.core.readings import RelayOutput

PROTOCOL_VERSION = 1
"""Carried by the hello. A further optional field at a line's end keeps the version; anything else raises it."""

QUESTION = b"?"
"""The request for a hello. The host's only longer message is the command for the relay."""
BEACON_REQUEST = b"b"
"""From now on, until a reset, the LED blinks the code of a beacon, and lines carry it (docs/beacon.md)."""

TICK_NS = 500  # Timer1 of the Uno at 16 MHz / 8
BURST_NS = 450_000  # from the trigger to ECHO's rising edge: the module sends its eight pulses
PERIOD_MS = 60  # the datasheet's shortest cycle that keeps an old echo out of the next one
MIN_PERIOD_MS, MAX_PERIOD_MS = 10, 500
HELLO_PERIOD_S = 5
MAX_SEQ = 0xFFFF
MAX_TICKS = 999_999
MAX_MCUSR = 0xFF
MIN_TEMPERATURE_DC, MAX_TEMPERATURE_DC = -400, 850  # 0.1 °C
RELAY_HOLD_MS = 280
"""So long after the measurement whose number it bore a command keeps an output on, at most."""
BEACON_CYCLES = 8
"""Of the beacon's field."""
MAX_LINE = 64
"""Bytes between `$` and line feed. Longer is damage: the decoder never keeps more."""
NOISE_RUN = 64
"""Bytes outside any line are counted in runs of at most so many."""

# 343.42 m/s at 20 °C: 0.5 us there and back is 0.85855 tenths of a millimetre.
TENTHS_PER_TICK = (17_171, 20_000)


class Flags(IntFlag):
    """What is wrong with a measurement; 0 is a valid one."""

    NO_ECHO = 1
    NO_RISING_EDGE = 2
    TOO_NEAR = 4
    TOO_FAR = 8
    STUCK_HIGH = 16


NO_FLAGS = Flags(0)
ALL_FLAGS = Flags.NO_ECHO | Flags.NO_RISING_EDGE | Flags.TOO_NEAR | Flags.TOO_FAR | Flags.STUCK_HIGH
FLAG_MEANING: dict[Flags, str] = {
    Flags.NO_ECHO: "ECHO rose, but no echo came back in time",
    Flags.NO_RISING_EDGE: "ECHO never rose after the trigger: dead sensor, or TRIG wire broken",
    Flags.TOO_NEAR: "nearer than 2 cm",
    Flags.TOO_FAR: "farther than 4 m",
    Flags.STUCK_HIGH: "ECHO is still high when the next cycle begins: hanging sensor, or ECHO wire broken",
}
RESET_CAUSES = ((1, "power on"), (2, "reset line"), (4, "brown-out"), (8, "watchdog"))  # MCUSR of the ATmega328P


class Damage(StrEnum):
    """Why bytes were thrown away."""

    NOISE = "noise"  # outside any line
    TRUNCATED = "truncated"  # a new `$` before the line's end
    TOO_LONG = "too_long"
    NO_CHECKSUM = "no_checksum"  # does not end in `*` and four digits
    CHECKSUM = "checksum"
    CONTENT = "content"  # right checksum, but not a message of this version
    MISMATCH = "mismatch"  # right checksum, but time and length contradict each other


@dataclass(frozen=True, slots=True)
class Hello:
    """The ranger's identification. Of another version only name and version are known; the rest is 0."""

    name: str
    version: int
    period_ms: int = 0
    mcusr: int = 0


@dataclass(frozen=True, slots=True)
class RelayReport:
    """The relay's field of a measurement, from the first command on. With the measurement's number, `run` is the
    number that a command must bear to be obeyed."""

    run: int  # 16 bit, another one after each reset and each wrap of the sequence number
    output: RelayOutput  # what the board switches on
    pins: int  # RelayOutput of the pins that are high, read back; a sum


@dataclass(frozen=True, slots=True)
class RelayCommand:
    """The host's message: an output is to be on, while the measured pulse stays within the band. It bears the number of
    a measurement, is obeyed once, and holds for RELAY_HOLD_MS from that measurement on. NONE is obeyed always."""

    run: int = 0
    seq: int = 0
    output: RelayOutput = RelayOutput.NONE
    nearest_ticks: int = 0
    farthest_ticks: int = 0


@dataclass(frozen=True, slots=True)
class Measurement:
    """One cycle of the sensor. With any flag set, `ticks` is not a distance."""

    seq: int  # 16 bit, 0 after a reset, +1 with every cycle
    ticks: int  # width of the ECHO pulse, 0.5 us
    flags: Flags = NO_FLAGS
    temperature_dc: int | None = None  # of the air, 0.1 °C; None: the ranger has no thermometer
    relay: RelayReport | None = None  # None: the board was not asked for its relay since its reset
    beacon: int | None = None  # LED in the newest cycles, bit 0: this one; None: as relay
    size: int = field(default=0, compare=False)  # bytes on the wire, `$` to line feed; set by the decoder


@dataclass(frozen=True, slots=True)
class Damaged:
    """Bytes that were dropped, and why."""

    kind: Damage
    size: int


Event = Hello | Measurement | Damaged

_NUMBER = rb"(0|[1-9][0-9]{0,5})"
_TAGGED = rb",([a-z])([0-9A-F]+)"
_MEASUREMENT = re.compile(rb"HCM,%b,%b,%b,%b(?:,(0|-?[1-9][0-9]{0,2}))?((?:,[a-z][0-9A-F]+)*)" % ((_NUMBER,) * 4))
_COMMAND = re.compile(rb"\$(HCR,([0-9A-F]{4}),%b,([0-2]),%b,%b)\*([0-9A-F]{4})\r\n" % ((_NUMBER,) * 3))
_HELLO = re.compile(rb"HCI,([A-Za-z0-9_.-]{1,16}),%b((?:,.*)?)" % _NUMBER)
_HELLO_REST = re.compile(rb",%b,%b" % ((_NUMBER,) * 2))
_CHECKSUM = re.compile(rb"[0-9A-F]{4}")
_TOKEN = re.compile(rb"[$\n]|[^$\n]+")


def tenths_at_20c(ticks: int) -> int:
    """The distance the line shows to people, 0.1 mm at 20 °C, rounded half up."""
    above, below = TENTHS_PER_TICK
    return (ticks * above + below // 2) // below


def reset_cause(mcusr: int) -> str:
    """The reset causes as text."""
    return ", ".join(name for bit, name in RESET_CAUSES if mcusr & bit) or "unknown"


def frame(body: bytes) -> bytes:
    """A body between `$` and its checksum, with the line's end."""
    return b"$%b*%04X\r\n" % (body, binascii.crc_hqx(body, 0))


def encode_hello(hello: Hello) -> bytes:
    """The hello's line. Raises ValueError for what no decoder would take."""
    line = frame(b"HCI,%b,%d,%d,%d" % (hello.name.encode(), hello.version, hello.period_ms, hello.mcusr))
    return _checked(line, hello)


def encode_measurement(measurement: Measurement) -> bytes:
    """The measurement's line. Raises ValueError for what no decoder would take."""
    m = measurement
    body = b"HCM,%d,%d,%d,%d" % (m.seq, m.ticks, tenths_at_20c(m.ticks), m.flags)
    if m.temperature_dc is not None:
        body += b",%d" % m.temperature_dc
    if m.beacon is not None:
        body += b",b%02X" % m.beacon
    if m.relay is not None:
        body += b",r%04X%X" % (m.relay.run, m.relay.output << 2 | m.relay.pins)
    return _checked(frame(body), m)


def encode_command(command: RelayCommand) -> bytes:
    """The relay command's line."""
    c = command
    return frame(b"HCR,%04X,%d,%d,%d,%d" % (c.run, c.seq, c.output, c.nearest_ticks, c.farthest_ticks))


def commands_in(data: bytes) -> list[RelayCommand]:
    """The undamaged relay commands among bytes from the host: what a board hears."""
    return [
        RelayCommand(int(found[2], 16), int(found[3]), RelayOutput(int(found[4])), int(found[5]), int(found[6]))
        for found in _COMMAND.finditer(data)
        if int(found[7], 16) == binascii.crc_hqx(found[1], 0)
    ]


def _checked(line: bytes, message: Hello | Measurement) -> bytes:
    if Decoder().feed(line) != [message]:
        raise ValueError(f"cannot be encoded in protocol version {PROTOCOL_VERSION}: {message}")
    return line


class Decoder:
    """Finds lines in a stream of bytes. How the stream is cut into `feed` calls makes no difference."""

    def __init__(self) -> None:
        self._line: bytearray | None = None  # bytes since `$`; None: between lines
        self._noise = 0
        self._forgiven = MAX_LINE  # the rest of a line that began before we listened is not damage

    def feed(self, data: bytes) -> list[Event]:
        """Everything that became certain with these bytes, in order."""
        events: list[Event] = []
        for token in _TOKEN.findall(data):
            if token == b"$":
                events += self._end_noise()
                if self._line is not None:
                    events.append(Damaged(Damage.TRUNCATED, 1 + len(self._line)))
                self._line = bytearray()
            elif token == b"\n":
                events += self._end_noise()
                if self._line is not None:
                    events.append(_parse(bytes(self._line)))
                self._line = None
            elif self._line is None:
                events += self._noisy(token)
            else:
                room = MAX_LINE - len(self._line)
                self._line += token[:room]
                if len(token) > room:
                    events.append(Damaged(Damage.TOO_LONG, 1 + MAX_LINE))
                    self._line = None
                    events += self._noisy(token[room:])
        return events

    def _noisy(self, run: bytes) -> Iterator[Damaged]:
        """Count bytes outside any line. A single carriage return is not counted."""
        count = len(run) - run.count(b"\r")
        forgiven = min(self._forgiven, count)
        self._forgiven -= forgiven
        self._noise += count - forgiven
        while self._noise >= NOISE_RUN:
            self._noise -= NOISE_RUN
            yield Damaged(Damage.NOISE, NOISE_RUN)

    def _end_noise(self) -> Iterator[Damaged]:
        self._forgiven = 0
        if self._noise:
            yield Damaged(Damage.NOISE, self._noise)
            self._noise = 0


def _parse(line: bytes) -> Event:
    """The message between `$` and line feed."""
    size = len(line) + 2
    body, star, checksum = line.removesuffix(b"\r").rpartition(b"*")
    if not star or not _CHECKSUM.fullmatch(checksum):
        return Damaged(Damage.NO_CHECKSUM, size)
    if int(checksum, 16) != binascii.crc_hqx(body, 0):
        return Damaged(Damage.CHECKSUM, size)
    if found := _MEASUREMENT.fullmatch(body):
        return _measurement(found, size)
    if found := _HELLO.fullmatch(body):
        name, version = found[1].decode(), int(found[2])
        if version != PROTOCOL_VERSION:
            return Hello(name, version)
        rest = _HELLO_REST.fullmatch(found[3])
        if rest and MIN_PERIOD_MS <= int(rest[1]) <= MAX_PERIOD_MS and int(rest[2]) <= MAX_MCUSR:
            return Hello(name, version, int(rest[1]), int(rest[2]))
    return Damaged(Damage.CONTENT, size)


def _measurement(found: re.Match[bytes], size: int) -> Event:
    seq, ticks, tenths, flags = (int(found[n]) for n in range(1, 5))
    temperature_dc = None if found[5] is None else int(found[5])
    if seq > MAX_SEQ or flags > ALL_FLAGS:
        return Damaged(Damage.CONTENT, size)
    if temperature_dc is not None and not MIN_TEMPERATURE_DC <= temperature_dc <= MAX_TEMPERATURE_DC:
        return Damaged(Damage.CONTENT, size)
    tagged = re.findall(_TAGGED, found[6])
    fields: dict[bytes, bytes] = dict(tagged)
    relay, beacon = fields.get(b"r"), fields.get(b"b")
    wrong_relay = relay is not None and (len(relay) != 5 or relay[4:] > b"B")
    wrong_beacon = beacon is not None and len(beacon) != BEACON_CYCLES // 4
    if [tag for tag, _ in tagged] != sorted(fields) or wrong_relay or wrong_beacon:
        return Damaged(Damage.CONTENT, size)
    if abs(tenths - tenths_at_20c(ticks)) > 1:  # firmware may round otherwise
        return Damaged(Damage.MISMATCH, size)
    lit = None if beacon is None else int(beacon, 16)
    return Measurement(seq, ticks, Flags(flags), temperature_dc, _relay(relay), lit, size)


def _relay(field: bytes | None) -> RelayReport | None:
    if field is None:
        return None
    state = int(field[4:], 16)
    return RelayReport(int(field[:4], 16), RelayOutput(state >> 2), state & 3)
