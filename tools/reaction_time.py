"""How long it takes at worst from a cause to the PLC's outputs: the tables of docs/reaction-time.md. Pure.

A guaranteed bound rests only on deadlines, which the gateway and the exported function block keep by themselves
whatever the sensors do. The others also rest on how often a sensor reports, at the rates as shipped; a new measurement
is decided on at once, without waiting for a tick.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from gateway.config import BayConfig, GatewayConfig, parse
from gateway.core import rolling
from gateway.core.interlock import Rules
from gateway.modbus.exports.diagnosis import HEARTBEAT_TIMEOUT_MS
from gateway.modbus.exports.tables import markdown_table

POLL_MS = 100  # the slowest poll that the pages recommend
SCAN_MS = 20  # of the PLC's task that calls the function block
FRAME_MS = 34  # 30 pictures a second
VISION_MS = 66  # capture to result: two frames, twice what the robust method takes on one core
WIRE_MS = 32  # trigger to the complete line at 9600 baud, docs/ranger.md


@dataclass(frozen=True, slots=True)
class Part:
    """One share of a time. `key`: where it can be changed."""

    name: str
    ms: float
    key: str = ""


@dataclass(frozen=True, slots=True)
class Bound:
    """From `cause` to both outputs off (`effect` defines which counts), at most the sum of `parts`."""

    cause: str
    effect: str
    parts: tuple[Part, ...]

    @property
    def ms(self) -> float:
        return sum(part.ms for part in self.parts)


def shares(config: GatewayConfig, bay: BayConfig) -> tuple[Part, ...]:
    """The budget: every share that a bound is made of, but for the sensors' rates."""
    fusion, visit = bay.fusion, bay.visit
    return (
        _s("the camera's deadline", fusion.vision_deadline_s, "`fusion.vision_deadline_s`"),
        _s("the ranger's deadline", fusion.range_deadline_s, "`fusion.range_deadline_s`"),
        _s("a tick: ages are checked so often", fusion.period_s, "`fusion.period_s`"),
        _s(
            "a dead decision: nothing is vouched for any more",
            Rules.of(bay).valid_for_ns / 1e9,
            "`fusion.period_s`: two periods, at least 250 ms",
        ),
        _s("a doubt while in place", visit.hold_grace_s, "`visit.hold_grace_s`"),
        _s(
            "the PLC's own heartbeat",
            config.modbus.handshake.heartbeat_deadline_s,
            "`modbus.handshake.heartbeat_deadline_s`",
        ),
        *_tail(),
        Part("the heartbeat's time in the function block", HEARTBEAT_TIMEOUT_MS, "its input `HeartbeatTimeout`"),
    )


def guaranteed(config: GatewayConfig, bay: BayConfig) -> tuple[Bound, ...]:
    """What holds whatever the sensors do."""
    fusion = bay.fusion
    tick = _s("tick", fusion.period_s)
    beat = Part("heartbeat", HEARTBEAT_TIMEOUT_MS)
    scan = Part("scan", SCAN_MS)
    return (
        Bound(
            "camera dead: unplugged, hung, its process killed",
            "MayMove, InPlace off",
            (_s("deadline", fusion.vision_deadline_s), tick, *_tail()),
        ),
        Bound(
            "ranger dead: unplugged, hung, silent",
            "MayMove, InPlace off",
            (_s("deadline", fusion.range_deadline_s), tick, *_tail()),
        ),
        Bound(
            "the gateway's decision has stopped, its server runs",
            "MayMove, InPlace off",
            (_s("dead after", Rules.of(bay).valid_for_ns / 1e9), *_tail()),
        ),
        Bound("gateway killed, frozen, or cut off from the PLC", "MayMove, InPlace off", (beat, scan)),
        Bound(
            "PLC's heartbeat lost (writes on)",
            "stop on, MayMove off",
            (_s("deadline", config.modbus.handshake.heartbeat_deadline_s), tick, *_tail()),
        ),
        Bound(
            "in place, and the sensors contradict each other from then on",
            "InPlace off",
            (_s("grace", bay.visit.hold_grace_s), tick, *_tail()),
        ),
    )


def at_shipped_rates(bay: BayConfig, range_ms: int) -> tuple[Bound, ...]:
    """What also takes a measurement or two. `range_ms`: the ranger's cycle."""
    lines = bay.ranger.median // 2 + 1  # so many beyond a threshold move the median over it
    distances = Part(f"{lines} distances, {range_ms} ms each", lines * range_ms)
    line = Part("line on the wire", WIRE_MS)
    frame, seen = Part("next picture", FRAME_MS), Part("capture to result", VISION_MS)
    both = max((distances, line), (frame, seen), key=lambda parts: sum(part.ms for part in parts))
    return (
        Bound("D = 1 reached, by both sensors", "MustStop on, MayMove off", (*both, *_tail())),
        Bound(
            f"in place, Z leaves its band of {bay.visit.band_mm:g} mm",
            "InPlace off, Moved on",
            (distances, line, *_tail()),
        ),
        Bound(
            f"in place, Z differs by {bay.visit.rolling_mm:g} mm from where the truck stands",
            "`rolling` on",
            (distances, line, *_tail()),
        ),
        Bound(
            f"in place, R differs by {bay.visit.rolling_share:.0%} of itself, or the centre by twice as much",
            "`rolling` on",
            (Part(f"{rolling.FRAMES} pictures, {FRAME_MS} ms each", rolling.FRAMES * FRAME_MS), seen, *_tail()),
        ),
        Bound(
            "in place, the marker seen elsewhere at a fitting size",
            "InPlace off, Moved on",
            (frame, seen, *_tail()),
        ),
        Bound(
            "in place, the ranger answers without a distance",
            "InPlace off (register in_place: after the grace)",
            (Part("next distance", range_ms), line, *_tail()),
        ),
    )


def budget_markdown() -> str:
    config, bay = _default()
    rows = ((part.name, f"{part.ms:g}", part.key) for part in shares(config, bay))
    return markdown_table(("share", "ms at most", "where it is set"), rows)


def guaranteed_markdown() -> str:
    return _bounds(guaranteed(*_default()))


def blocks(range_ms: int) -> Mapping[str, Callable[[], str]]:
    """The generated parts of the page. `range_ms`: the ranger's cycle as shipped."""
    return {
        "budget": budget_markdown,
        "guaranteed": guaranteed_markdown,
        "at shipped rates": lambda: _bounds(at_shipped_rates(_default()[1], range_ms)),
    }


def _default() -> tuple[GatewayConfig, BayConfig]:
    config = parse({"modbus": {"writes": True, "plc_addresses": ["10.0.0.9"]}})
    return config, config.bays[0]


def _tail() -> tuple[Part, ...]:
    """From a decision to the PLC's outputs: the image is made at the moment of the request, and is never older."""
    return Part("poll", POLL_MS, "your program"), Part("scan", SCAN_MS, "your program")


def _s(name: str, seconds: float, key: str = "") -> Part:
    return Part(name, round(seconds * 1000, 3), key)


def _bounds(bounds: Iterable[Bound]) -> str:
    rows = (
        (b.cause, b.effect, " + ".join(f"{part.ms:g} {part.name}" for part in b.parts), f"**{b.ms:g}**") for b in bounds
    )
    return markdown_table(("cause", "effect", "made of, ms", "at most, ms"), rows)
