"""Timing diagrams for the PLC's pages, played by the gateway's own state machine: none is drawn by hand.

Each is a short sequence (what the sensors see and what the PLC writes, at which millisecond) run through
gateway/core/interlock.py; the resulting signals are drawn as SVG. Pure.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from html import escape
from typing import Any

from gateway.config import parse
from gateway.core import interlock
from gateway.core.detection import Circle
from gateway.core.fusion import Observation
from gateway.core.interlock import Rules
from gateway.core.plc import Control, PlcWrite, Writer
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import StateVector, Tick
from gateway.modbus.registers.handshake import HANDSHAKE_STATUS
from gateway.modbus.registers.register_map import decode, encode

MS = 1_000_000
T0 = 1_000_000 * MS
NEVER_MS = 10**9
PLC = Writer("10.0.0.9")
WIDTH, ROW, LEFT, TOP = 860, 34, 150, 14
STYLE = (
    "text{font:13px sans-serif;fill:#222}.t{font-size:11px;fill:#666}.n{font-size:11px;text-anchor:middle}"
    ".s{fill:none;stroke:#1f5fa8;stroke-width:2}.p{stroke:#a85a1f}.g{stroke:#ddd;stroke-width:1}"
)

Image = Mapping[str, Any]
Signal = Callable[[Image], Any]
Seen = Callable[[int, int], tuple[Observation, ...]]


@dataclass(frozen=True)
class SignalSequence:
    """`writes`: from that millisecond on. `seen`: what both sensors report at a time, ms and ns; before 0 as at 0.

    Signals: name -> (whose, value). `grid_ms`: between two lines; every second one has its number, in `unit_ms`.
    """

    title: str
    until_ms: int
    config: dict[str, Any]
    writes: dict[int, tuple[Control, ...]]
    signals: dict[str, tuple[str, Signal]]
    seen: Seen
    silent_ms: int = NEVER_MS
    again_ms: int = NEVER_MS
    frame_ms: int = 60
    step_ms: int = 5
    grid_ms: int = 100
    unit_ms: int = 1


def approach(distances: dict[int, float]) -> Seen:
    """A marker large enough all along, at these distances (mm) from that millisecond on."""

    def seen(now_ms: int, now_ns: int) -> tuple[Observation, ...]:
        distance = distances[max(at for at in distances if at <= max(0, now_ms))]
        vision = VisionReading(now_ns, Quality.GOOD, Circle(320, 240, 200))
        return vision, RangeReading(now_ns, Quality.GOOD, distance)

    return seen


def _bit(name: str) -> Signal:
    mask = HANDSHAKE_STATUS.mask(name)
    return lambda image: bool(int(image["handshake_status"]) & mask)


def control(which: Control) -> Signal:
    return lambda image: int(image["plc_control"]) >> which & 1


def word(name: str) -> Signal:
    return lambda image: int(image[name])


BIT, PLC_SIDE, NUMBER = "gateway", "plc", "number"
MEASUREMENT = SignalSequence(
    "One triggered measurement, and a trigger that arrives too early",
    900,
    {},
    {100: (Control.TRIGGER,), 300: (Control.TRIGGER, Control.RESULTS_ACK), 380: (), 500: (Control.TRIGGER,), 560: (),
     600: (Control.TRIGGER,), 700: (Control.RESULTS_ACK,), 780: ()},
    {
        "trigger": (PLC_SIDE, control(Control.TRIGGER)),
        "trigger_ready": (BIT, _bit("trigger_ready")),
        "trigger_ack": (BIT, _bit("trigger_ack")),
        "acquiring": (BIT, _bit("acquiring")),
        "acquisition_id": (NUMBER, word("acquisition_id")),
        "results_valid": (BIT, _bit("results_valid")),
        "result_id": (NUMBER, word("result_id")),
        "results_ack": (PLC_SIDE, control(Control.RESULTS_ACK)),
        "overrun": (BIT, _bit("overrun")),
    },
    approach({0: 900.0}),
)  # fmt: skip
LATCH = SignalSequence(
    "A latched stop: a reset while its cause is active is refused, a later one ends it",
    1500,
    {"fusion": {"latch_stop": True}},
    {100: (Control.RESET,), 200: (), 700: (Control.RESET,), 800: (), 1200: (Control.RESET,), 1300: ()},
    {
        "D": (BIT, lambda image: int(image["d"] or 0)),
        "stop_latched": (BIT, _bit("stop_latched")),
        "reset": (PLC_SIDE, control(Control.RESET)),
        "reset_verdict": (NUMBER, word("reset_verdict")),
        "stop": (BIT, word("stop")),
        "may_move": (BIT, word("may_move")),
        "reason": (NUMBER, word("reason")),
    },
    approach({0: 900.0, 400: 250.0, 1000: 900.0}),
)
HEARTBEAT = SignalSequence(
    "The PLC's heartbeat stops and starts again (heartbeat_deadline_s = 0.5)",
    1800,
    {"modbus": {"handshake": {"heartbeat_deadline_s": 0.5}}},
    {},
    {
        "plc_heartbeat": (PLC_SIDE, lambda image: int(image["plc_heartbeat"]) & 1),
        "plc_alive": (BIT, _bit("plc_alive")),
        "stop": (BIT, word("stop")),
        "may_move": (BIT, word("may_move")),
        "reason": (NUMBER, word("reason")),
    },
    approach({0: 900.0}),
    silent_ms=400,
    again_ms=1300,
)
STORIES = {"handshake-measurement": MEASUREMENT, "handshake-latch": LATCH, "handshake-heartbeat": HEARTBEAT}


def figures() -> dict[str, str]:
    """File name without its ending -> SVG."""
    return {name: svg(sequence) for name, sequence in STORIES.items()}


def states(sequence: SignalSequence) -> Iterator[StateVector]:
    """The state after every step, from time 0 on."""
    modbus = {"writes": True, "plc_addresses": [PLC.address]} | sequence.config.get("modbus", {})
    config = parse(sequence.config | {"modbus": modbus})
    rules = Rules.of(config.bays[0], config)
    state = interlock.initial("bay1", T0 - MS, rules)
    state = interlock.step(state, PlcWrite(PLC, control=0), T0 - MS, rules)
    beat = 0
    for now_ms in range(-200, sequence.until_ms, sequence.step_ms):
        now_ns = T0 + now_ms * MS
        seen: list[Observation] = [Tick()]
        if now_ms % sequence.frame_ms == 0:
            seen.extend(sequence.seen(now_ms, now_ns))
        if now_ms % 100 == 0 and not sequence.silent_ms <= now_ms < sequence.again_ms:
            beat += 1
            seen.append(PlcWrite(PLC, heartbeat=beat))
        if now_ms in sequence.writes:
            seen.append(PlcWrite(PLC, control=sum(1 << bit for bit in sequence.writes[now_ms])))
        for observation in seen:
            state = interlock.step(state, observation, now_ns, rules)
        if now_ms >= 0:
            yield state


def svg(sequence: SignalSequence) -> str:
    images = [decode(encode(state, 0, "big")) for state in states(sequence)]
    height = TOP + ROW * len(sequence.signals) + 34
    scale = (WIDTH - LEFT - 20) / sequence.until_ms
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" role="img">',
        f"<title>{escape(sequence.title)}</title><style>{STYLE}</style>",
        f'<rect width="{WIDTH}" height="{height}" fill="#fff"/>',
    ]
    foot = TOP + ROW * len(sequence.signals)
    for at_ms in range(0, sequence.until_ms + 1, sequence.grid_ms):
        x = LEFT + at_ms * scale
        out.append(f'<path class="g" d="M{x:.1f} {TOP}V{foot}"/>')
        if at_ms % (2 * sequence.grid_ms) == 0:
            number = at_ms // sequence.unit_ms
            out.append(f'<text class="t" x="{x:.1f}" y="{foot + 16}" text-anchor="middle">{number}</text>')
    unit = "ms" if sequence.unit_ms == 1 else "s"
    out.append(f'<text class="t" x="{LEFT - 12}" y="{foot + 16}" text-anchor="end">{unit}</text>')
    for n, (name, (whose, value)) in enumerate(sequence.signals.items()):
        low, high = TOP + ROW * (n + 1) - 8, TOP + ROW * n + 8
        out.append(f'<text x="{LEFT - 12}" y="{low - 3}" text-anchor="end">{escape(name)}</text>')
        out.append(_row([value(image) for image in images], scale, low, high, whose, sequence.step_ms))
    return "\n".join([*out, "</svg>"]) + "\n"


def _row(values: list[Any], scale: float, low: int, high: int, whose: str, step_ms: int) -> str:
    runs: list[tuple[int, int, Any]] = []  # begin and end in ms, value
    for n, value in enumerate(values):
        if runs and runs[-1][2] == value:
            runs[-1] = (runs[-1][0], (n + 1) * step_ms, value)
        else:
            runs.append((n * step_ms, (n + 1) * step_ms, value))
    if whose == NUMBER:
        shapes = []
        for begin, end, value in runs:
            x, width = LEFT + begin * scale, (end - begin) * scale
            shapes.append(f'<rect class="s" x="{x:.1f}" y="{high}" width="{width:.1f}" height="{low - high}"/>')
            shapes.append(f'<text class="n" x="{x + width / 2:.1f}" y="{low - 4}">{value}</text>')
        return "".join(shapes)
    path = ""
    for begin, end, value in runs:
        y = high if value else low
        path += f"{'V' if path else f'M{LEFT + begin * scale:.1f} '}{y}H{LEFT + end * scale:.1f}"
    return f'<path class="s{" p" if whose == PLC_SIDE else ""}" d="{path}"/>'
