"""The register map is data: one table, from which the image, its decoding, docs/registers.md and the exports are made.

One block of BLOCK_WORDS registers from address 0, the same on function codes 3 and 4, encoded from one state.
Addresses are never renumbered: a new register takes a reserved place and raises MAP_VERSION. Up to version 4 the block
ended with `seq_end` (99); what came later lies behind it, where programs that read 100 registers never look.

Sequence number: `seq_begin` and `seq_end` carry 2 * StateVector.seq modulo 65536. The odd number in between belongs to
the image of a gateway whose control task has died, so that it can't share a number with the state that follows it.
Equal numbers therefore mean one image, however many reads fetched it.
"""

from collections.abc import Callable, Sequence

from gateway.core.beacon import BeaconStatus
from gateway.core.detection import Tracking
from gateway.core.readings import RANGE_FINE, VISION_FINE, Quality, RelayOutput, RelayStatus
from gateway.core.state import Reason, StateVector
from gateway.durations import NS_PER_MS
from gateway.errors import ProtocolError
from gateway.modbus.registers.bay_identity import NO_BAY, BayIdentity
from gateway.modbus.registers.drive import DRIVE
from gateway.modbus.registers.handshake import HANDSHAKE
from gateway.modbus.registers.health import HEALTH, PICTURE
from gateway.modbus.registers.lamps import SIGNAL_LAMPS
from gateway.modbus.registers.position import POSITION
from gateway.modbus.registers.register import (
    FLOAT32,
    MEASURED_FLOAT32,
    MEASURED_INT16,
    MEASURED_UINT16,
    UINT16,
    UINT32,
    UINT64,
    Reserved,
    StatusWord,
    WordOrder,
    named,
    packer,
    shown,
    unpack,
)
from gateway.modbus.registers.register import Register as Register  # noqa: PLC0414 - for those who read the table
from gateway.modbus.registers.register import Value as Value  # noqa: PLC0414

MAP_VERSION = 8
BLOCK_WORDS = 123  # a request takes 125 at most
KNOWN_UINT32 = 0x12345678  # 305419896; four different bytes, so every wrong order reads as another number
_KNOWN_WORDS = (KNOWN_UINT32 >> 16, KNOWN_UINT32 & 0xFFFF)
KNOWN_FLOAT32 = 123456.0  # 0x47F12000

Image = tuple[int, ...]


_FAULTS: tuple[tuple[str, str, Callable[[StateVector], bool]], ...] = (  # from bit 9 on
    ("vision_fault", "vision_quality is a fault: neither good, nor waiting, nor merely without a target",
     lambda s: s.vision.quality not in VISION_FINE),
    ("range_fault", "range_quality is a fault: neither good nor waiting", lambda s: s.range.quality not in RANGE_FINE),
    ("disagree", "camera and ranger contradict each other", lambda s: s.memory.disagree),
    ("gateway_fault", "the control task does not run: no values, no ages, stop on; nothing in the block changes",
     lambda s: s.reason is Reason.GATEWAY_FAULT),
)  # fmt: skip
STATUS = StatusWord((
    ("stop", "stop is on, as in register stop", lambda s: s.stop),
    ("may_move", "the truck may move, as in register may_move; never a condition for loading", lambda s: s.may_move),
    ("d", "D = 1, the paper's stop decision", lambda s: s.d is True),
    ("d_unknowable", "D can't be computed: a sensor has no good, fresh value", lambda s: s.d is None),
    ("vision_good", "u, v, radius are fresh and valid", lambda s: s.vision.quality is Quality.GOOD),
    ("range_good", "distance is fresh and valid", lambda s: s.range.quality is Quality.GOOD),
    ("healthy", "both sensors good and not in disagreement",
     lambda s: s.vision.quality is s.range.quality is Quality.GOOD and not s.memory.disagree),
    ("starting", "a sensor has sent nothing yet", lambda s: Quality.WAITING in (s.vision.quality, s.range.quality)),
    ("fault", "any of bits 9 to 12", lambda s: any(on(s) for _, _, on in _FAULTS)),
    *_FAULTS,
    ("shutdown", "the gateway is shutting down", lambda s: s.reason is Reason.SHUTDOWN),
    ("clamped", "an integer value is at its register's limit; its float32 mirror has the true one",
     lambda _: False),  # `encode` sets it: it depends on the other registers
    ("vision_age_unproven", "nothing proves how old the camera's newest frame is: refused, or accepted",
     lambda s: s.vision_age_unproven),
))  # fmt: skip


def _sequence(state: StateVector, _: int) -> Value:
    return (2 * state.seq - (state.reason is Reason.GATEWAY_FAULT)) & 0xFFFF


def _age_ms(state: StateVector, t_ns: int, quality: Quality) -> Value:
    return None if quality is Quality.WAITING or not state.running else (state.t_ns - t_ns) // NS_PER_MS


def _relay(on: Callable[[RelayStatus], bool]) -> Callable[[StateVector], bool]:
    return lambda s: s.range.relay is not None and on(s.range.relay)


RELAY = StatusWord((
    ("known", "the ranger's board reports its outputs; else all bits are 0", _relay(lambda r: True)),
    ("commanded_in_place", "output in place is to be on", _relay(lambda r: r.commanded is RelayOutput.IN_PLACE)),
    ("commanded_may_move", "output may move is to be on", _relay(lambda r: r.commanded is RelayOutput.MAY_MOVE)),
    ("pin_in_place", "its pin is high, read back", _relay(lambda r: bool(r.pins & RelayOutput.IN_PLACE))),
    ("pin_may_move", "its pin is high, read back", _relay(lambda r: bool(r.pins & RelayOutput.MAY_MOVE))),
    ("relay_fault", "pins and commands differ for more than 0.5 s", _relay(lambda r: r.fault)),
))  # fmt: skip

_QUALITY = named(Quality)
_REASON = named(Reason)
_TRACKING = named(Tracking)
_RANGER_BITS = {n: (f"ranger{n + 1}_good", f"ranger {n + 1} has a fresh, valid distance") for n in range(3)} | {
    n + 4: (f"ranger{n + 1}_agrees", f"ranger {n + 1} is one of those that the distance rests on") for n in range(3)
}
_NEVER_DECIDE = "while coasted; never decide on it"

REGISTERS: tuple[Register, ...] = (
    Register(0, "seq_begin", UINT16, 1, "", "sequence number of the image; equal to seq_end in one image", _sequence),
    Register(1, "map_version", UINT16, 1, "", "version of this table; grows when registers are added; none ever moves",
             lambda s, _: MAP_VERSION),
    shown(2, "heartbeat", UINT16, 1, "heartbeat", "+1 with every fusion tick, modulo 65536; stops when fusion does"),
    Register(3, "status", UINT16, 1, "", "status word, one bit each; bit 0 is the least significant", STATUS.read,
             bits=STATUS.names),
    shown(4, "stop", UINT16, 1, "stop", "1: stop the truck; also on whenever D is unknowable; 0 alone allows nothing"),
    shown(5, "may_move", UINT16, 1, "may_move", "1: the truck may move: stop is off and nothing withholds it; else 0"),
    shown(6, "reason", UINT16, 1, "reason", "why stop is on; 0 when it is off", codes=_REASON),
    shown(7, "vision_quality", UINT16, 1, "vision.quality", "0: u, v, radius may be used; else why not",
          codes=_QUALITY),
    shown(8, "range_quality", UINT16, 1, "range.quality", "0: distance may be used; else why not", codes=_QUALITY),
    shown(9, "d", MEASURED_UINT16, 1, "d", "equation 14: 1 when R >= R_th and Z <= Z_th; ends by fusion.decision"),
    shown(10, "u", MEASURED_INT16, 0.1, "u_px"),
    shown(11, "v", MEASURED_INT16, 0.1, "v_px"),
    shown(12, "radius", MEASURED_UINT16, 0.1, "radius_px"),
    shown(13, "distance", MEASURED_UINT16, 1, "distance_mm"),
    shown(14, "z_vision", MEASURED_UINT16, 1, "z_vision_mm", "distance f r / R from the camera, where configured"),
    Register(15, "vision_age", MEASURED_UINT16, 1, "ms", "age of the newest camera result or fault, at `timestamp`",
             lambda s, _: _age_ms(s, s.vision.t_ns, s.vision.quality)),
    Register(16, "range_age", MEASURED_UINT16, 1, "ms", "age of the newest ranger result or fault, at `timestamp`",
             lambda s, _: _age_ms(s, s.range.t_ns, s.range.quality)),
    shown(17, "vision_rate", MEASURED_UINT16, 0.1, "rates.vision_hz"),
    shown(18, "range_rate", MEASURED_UINT16, 0.1, "rates.range_hz"),
    shown(19, "vision_latency", MEASURED_UINT16, 0.1, "rates.vision_latency_ms"),
    shown(20, "frame_id", UINT32, 1, "frame_id", "number of the newest frame processed, modulo 2^32"),
    Register(22, "timestamp", UINT64, 1, "ms", "Unix time of this image, UTC; never use it to judge freshness",
             lambda _, unix_ns: unix_ns // NS_PER_MS),
    shown(26, "frames_skipped", UINT16, 1, "counters.frames_skipped"),
    shown(27, "frames_lost", UINT16, 1, "counters.frames_lost"),
    shown(28, "worker_restarts", UINT16, 1, "counters.vision_restarts"),
    shown(29, "camera_reopens", UINT16, 1, "counters.camera_reopens"),
    shown(30, "ranger_damaged", UINT16, 1, "counters.range_damaged"),
    shown(31, "ranger_gaps", UINT16, 1, "counters.range_gaps"),
    shown(32, "ranger_rejected", UINT16, 1, "counters.range_rejected"),
    shown(33, "ranger_reopens", UINT16, 1, "counters.ranger_reopens"),
    Register(34, "range_seq", UINT16, 1, "", "the ranger's own number of its newest measurement, modulo 65536",
             lambda s, _: s.range.seq & 0xFFFF),
    *POSITION,
    Register(40, "known_u32", UINT32, 1, "", f"always {KNOWN_UINT32} (0x{KNOWN_UINT32:08X}): proves the word order",
             lambda s, _: KNOWN_UINT32),
    Register(42, "known_f32", FLOAT32, 1, "", f"always {KNOWN_FLOAT32}: proves the word order",
             lambda s, _: KNOWN_FLOAT32),
    shown(44, "u_f32", MEASURED_FLOAT32, 1, "u_px", "u, not rounded"),
    shown(46, "v_f32", MEASURED_FLOAT32, 1, "v_px", "v, not rounded"),
    shown(48, "radius_f32", MEASURED_FLOAT32, 1, "radius_px", "radius, not rounded"),
    shown(50, "distance_f32", MEASURED_FLOAT32, 1, "distance_mm", "distance, not rounded"),
    shown(52, "z_vision_f32", MEASURED_FLOAT32, 1, "z_vision_mm", "z_vision, not rounded"),
    shown(54, "x_n_f32", MEASURED_FLOAT32, 1, "x_n", "x_n of equation 11, normalised; where configured"),
    shown(56, "y_n_f32", MEASURED_FLOAT32, 1, "y_n", "y_n of equation 11, normalised; where configured"),
    *PICTURE[:2],
    *HEALTH,
    PICTURE[2],
    shown(70, "tracking", MEASURED_UINT16, 1, "tracking", "how the position was found; no value: no fresh frame",
          codes=_TRACKING),
    shown(71, "confidence", MEASURED_UINT16, 0.1, "confidence", "of the detection, where the method gives one"),
    shown(72, "visible", MEASURED_UINT16, 0.1, "visible", "share of the marker's rim that was seen, where known"),
    shown(73, "predicted_u", MEASURED_INT16, 0.1, "predicted.u_px", f"centre, rightwards: {_NEVER_DECIDE}"),
    shown(74, "predicted_v", MEASURED_INT16, 0.1, "predicted.v_px", f"centre, downwards: {_NEVER_DECIDE}"),
    shown(75, "predicted_radius", MEASURED_UINT16, 0.1, "predicted.radius_px", f"radius: {_NEVER_DECIDE}"),
    shown(76, "semi_minor", MEASURED_UINT16, 0.1, "semi_minor_px",
          "of the rim's ellipse; its semi-major axis is the radius"),
    shown(77, "tilt", MEASURED_UINT16, 0.1, "tilt_deg",
          "of the disc against the line of sight, from the ellipse's axes"),
    *PICTURE[3:5],
    *HANDSHAKE,
    *PICTURE[5:],
    Register(99, "seq_end", UINT16, 1, "", "sequence number of the image, again", _sequence),
    SIGNAL_LAMPS,
    # `encode` sets both: they are the bay's own, whatever its state.
    Register(101, "unit_id", UINT16, 1, "", "unit id of this bay: compare it with the one that you poll",
             lambda s, _: 0),
    Register(102, "bay_identity", UINT32, 1, "", "made of site, instance and bay name; never 0: "
             "compare it with the exported one", lambda s, _: 0),
    Register(104, "beacon_status", UINT16, 1, "", "do the pictures show the beacon's code (docs/beacon.md)?",
             lambda s, _: s.beacon.status, codes=named(BeaconStatus)),
    shown(105, "beacon_latency", MEASURED_UINT16, 1, "beacon.latency_ms"),
    Register(106, "relay_status", UINT16, 1, "", "outputs of the ranger's board, one bit each; 0: nothing known, too",
             RELAY.read, bits=RELAY.names),
    shown(107, "rangers", UINT16, 1, "rangers.status", "of several rangers, one bit each; 0: one, or none is judged",
          bits=_RANGER_BITS),
    *DRIVE,
)  # fmt: skip

RESERVED: tuple[Reserved, ...] = (Reserved(108, 2, "for later map versions"),)

_ADDRESS = {register.name: register.address for register in REGISTERS}
STATUS_ADDRESS = _ADDRESS["status"]
_CLAMPED = STATUS.mask("clamped")
_UNIT_ID, _IDENTITY = _ADDRESS["unit_id"], _ADDRESS["bay_identity"]


def encode(state: StateVector, unix_ns: int, word_order: WordOrder, bay: BayIdentity = NO_BAY) -> Image:
    """The image of one state: BLOCK_WORDS words, each 0..65535. Never raises on any numbers.

    `unix_ns`: wall time of `state.t_ns`. Equal arguments give equal images. Without `bay` no program accepts it.
    """
    image = [0] * BLOCK_WORDS
    clamped = False
    for begin, end, read, packed, reported in _PLANS[word_order]:
        image[begin:end], cut = packed(read(state, unix_ns))
        clamped |= cut and reported
    if clamped:
        image[STATUS_ADDRESS] |= _CLAMPED
    image[_UNIT_ID] = bay.unit_id
    high, low = divmod(bay.number, 0x1_0000)
    image[_IDENTITY : _IDENTITY + 2] = (high, low) if word_order == "big" else (low, high)
    return tuple(image)


# Ages, rates and counters at their limit need no report; a position at its limit does.
_CLAMP_REPORTED = frozenset({"u", "v", "radius", "distance", "z_vision"})
_ORDERS: tuple[WordOrder, ...] = ("big", "little")
_PLANS = {
    order: tuple(
        (
            register.address,
            register.address + register.words,
            register.read,
            packer(register.kind, register.scale, order),
            register.name in _CLAMP_REPORTED,
        )
        for register in REGISTERS
    )
    for order in _ORDERS
}


def decode(image: Sequence[int], oldest: int = MAP_VERSION) -> dict[str, Value]:
    """Every register by name, in its unit; None where there is no value. Finds the word order by itself. Of a newer map
    version only what this one knows.

    Raises ProtocolError for an image that is torn, of a map version before `oldest`, or not one of ours.
    """
    if len(image) != BLOCK_WORDS:
        raise ProtocolError(f"an image has {BLOCK_WORDS} words, not {len(image)}")
    address = _ADDRESS["known_u32"]
    orders: dict[tuple[int, ...], WordOrder] = {_KNOWN_WORDS: "big", _KNOWN_WORDS[::-1]: "little"}
    if (order := orders.get(tuple(image[address : address + 2]))) is None:
        raise ProtocolError(
            f"registers {address} and {address + 1} do not hold 0x{KNOWN_UINT32:08X} in either word order"
        )
    values = {
        register.name: unpack(
            register.kind, image[register.address : register.address + register.words], register.scale, order
        )
        for register in REGISTERS
    }
    if (version := image[_ADDRESS["map_version"]]) < oldest:
        raise ProtocolError(f"map version {version} lacks registers of version {oldest}")
    if values["seq_begin"] != values["seq_end"]:
        raise ProtocolError(
            f"torn image: sequence number {values['seq_begin']} at the begin, {values['seq_end']} at the end"
        )
    return values
