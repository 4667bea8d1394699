"""The register image, word for word."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.core import events, fusion
from gateway.core.detection import Circle, Ellipse, Tracking
from gateway.core.events import EventKind
from gateway.core.fusion import forced_stop
from gateway.core.pose import MetricPose
from gateway.core.readings import AgeProof, PictureHealth, Quality, RangeReading, RangeStats, VisionReading, VisionStats
from gateway.core.setpoint import DriveState, Setpoint
from gateway.core.shown import resumed, withdrawn
from gateway.core.state import FusionMemory, Moved, Reason, StateVector, Visit, VisitPhase
from gateway.errors import ProtocolError
from gateway.modbus.registers.bay_identity import BayIdentity
from gateway.modbus.registers.bay_unit import image_of
from gateway.modbus.registers.register import WordOrder
from gateway.modbus.registers.register_map import (
    BLOCK_WORDS,
    REGISTERS,
    RESERVED,
    STATUS,
    Value,
    decode,
    encode,
)
from tests.virtual_time import LoopClock

S = 1_000_000_000
MS = 1_000_000
UNIX_NS = 1_763_640_000_123_456_789  # 0x19AA122BE7B ms

STATE = StateVector(
    bay="north",
    t_ns=100 * S,
    seq=0x1_2345,
    heartbeat=0x2_ABCD,
    vision=VisionReading(
        100 * S - 21 * MS,
        Quality.GOOD,
        Circle(u_px=640.27, v_px=-3.06, radius_px=181.26),
        frame_id=0x1_0002_0003,
        ellipse=Ellipse(640.27, -3.06, 181.26, 169.94, 0.5),
        confidence=0.9876,
        visible=0.75,
        tracking=Tracking.MEASURED,
        picture=PictureHealth(0.5213, 0.01, 0.4567, 0.618, 0.2049, 3.26, status=0b101000, veil_proven=0.85),
        x_n=0.25,
        y_n=-0.5,
        stats=VisionStats(
            frames=9, skipped=0x1_0001, lost=2, restarts=3, reopens=4, rate_hz=29.96, latency_ms=3.14
        ),
    ),
    range=RangeReading(
        100 * S - 40_999_999,
        Quality.GOOD,
        299.6,
        seq=0x1_0007,
        stats=RangeStats(lines=9, damaged=5, gaps=6, rejected=7, reopens=8, rate_hz=16.7),
    ),
    d=True,
    stop=True,
    may_move=False,
    reason=Reason.TARGET_REACHED,
    z_vision_mm=301.5,
    setpoint=Setpoint(DriveState.CREEP, enable=True, speed_mm_s=29.6, stopping_mm=41.2),
    pose=MetricPose(-12.5, 3.25, 10.0, 0.52, 0.55, 1.94),
)  # fmt: skip

# address: word, high word first
BAY = BayIdentity(9, 0x3456789A)
EXPECTED: dict[int, int] = {
    0: 0x468A,  # 2 * 0x12345 modulo 65536
    1: 8,
    2: 0xABCD,
    3: 0b0000_0000_0111_0101,  # healthy, range good, vision good, D, stop
    4: 1,
    5: 0,
    6: 1,
    7: 0,
    8: 0,
    9: 1,
    10: 6403,
    11: 0x1_0000 - 31,
    12: 1813,
    13: 300,
    14: 302,  # half to even
    15: 21,
    16: 40,
    17: 300,
    18: 167,
    19: 31,
    20: 0x0002,  # frame id modulo 2^32
    21: 0x0003,
    22: 0x0000,
    23: 0x019A,
    24: 0xA122,
    25: 0xBE7B,
    26: 1,
    27: 2,
    28: 3,
    29: 4,
    30: 5,
    31: 6,
    32: 7,
    33: 8,
    34: 7,
    40: 0x1234,
    41: 0x5678,
    42: 0x47F1,
    43: 0x2000,
    44: 0x4420,
    45: 0x1148,
    46: 0xC043,
    47: 0xD70A,
    48: 0x4335,
    49: 0x428F,
    50: 0x4395,
    51: 0xCCCD,
    52: 0x4396,
    53: 0xC000,
    54: 0x3E80,
    55: 0x0000,
    56: 0xBF00,
    57: 0x0000,
    58: 521,
    59: 457,
    69: 618,
    70: 1,
    71: 988,  # 98.76 %
    72: 750,
    73: 0x8000,  # measured, so nothing is predicted
    74: 0x8000,
    75: 0xFFFF,
    76: 1699,
    77: 204,  # acos(169.94 / 181.26) = 20.354 degrees
    78: 0b101000,  # blurred, shifted
    79: 205,
    97: 33,
    98: 850,
    63: 0xFFFF,
    61: 0b1000,  # maintenance, for the picture's sake
    60: 4,
    **dict.fromkeys(range(64, 69), 0x8000),  # no guidance
    38: 0xFFFF,  # not held
    90: 0x8000,  # no triggered result
    91: 0x8000,
    92: 0xFFFF,
    93: 0xFFFF,
    94: 0xFFFF,
    99: 0x468A,
    100: 0b1,  # red
    101: 9,
    102: 0x3456,
    105: 0xFFFF,  # no beacon
    103: 0x789A,
    110: 1,
    111: 4,
    112: 30,
    113: 41,
    114: 0xC148,
    115: 0x0000,
    116: 0x4050,
    117: 0x0000,
    118: 0x4120,
    119: 0x0000,
    120: 5,
    121: 6,
    122: 19,
}


def values(state: StateVector) -> dict[str, Value]:
    return decode(encode(state, UNIX_NS, "big"))


def bits(state: StateVector) -> set[str]:
    return STATUS.on(int(values(state)["status"] or 0))


def test_every_word_of_the_image() -> None:
    assert encode(STATE, UNIX_NS, "big", BAY) == tuple(EXPECTED.get(address, 0) for address in range(BLOCK_WORDS))


PICTURE = (
    *("picture_brightness", "picture_contrast", "picture_sharpness", "picture_veil", "picture_shift"),
    "picture_veil_proven",
)


@pytest.mark.parametrize(
    ("quality", "reason", "known"),
    [
        (Quality.GOOD, Reason.NONE, True),
        (Quality.NO_TARGET, Reason.NO_TARGET, True),
        (Quality.COASTED, Reason.TARGET_COASTED, True),
        (Quality.STALE, Reason.VISION_STALE, False),
        (Quality.LINK_DOWN, Reason.CAMERA_DOWN, False),
        (Quality.PROCESS_FAULT, Reason.VISION_FAULT, False),
        (Quality.NO_TARGET, Reason.GATEWAY_FAULT, False),
        (Quality.NO_TARGET, Reason.SHUTDOWN, False),
    ],
)
def test_the_health_of_the_picture_is_that_of_a_fresh_frame_or_none(
    quality: Quality, reason: Reason, known: bool
) -> None:
    now = values(replace(STATE, vision=replace(STATE.vision, quality=quality), reason=reason))
    assert [now[name] is not None for name in PICTURE] == [known] * len(PICTURE)
    assert now["picture_status"] == (0b101000 if known else 0)


def test_what_is_not_known_of_a_picture_has_no_value() -> None:
    health = PictureHealth(0.01, 0.0, 0.02, None, None, None, status=1)
    now = values(replace(STATE, vision=replace(STATE.vision, picture=health)))
    assert [now[name] for name in PICTURE] == pytest.approx([1.0, 2.0, None, None, None, None])
    assert now["picture_status"] == 1


def test_little_word_order_swaps_words_and_nothing_else() -> None:
    little = encode(STATE, UNIX_NS, "little", BAY)
    swapped = dict(EXPECTED)
    for first in (20, 40, 42, 44, 46, 48, 50, 52, 54, 56, 102, 114, 116, 118):
        swapped[first], swapped[first + 1] = EXPECTED[first + 1], EXPECTED[first]
    for place in range(4):
        swapped[22 + place] = EXPECTED[25 - place]
    assert little == tuple(swapped.get(address, 0) for address in range(BLOCK_WORDS))


def test_a_drive_that_may_not_run_reads_zero_and_an_unknown_way_or_pose_has_no_value() -> None:
    known = ("drive_enable", "drive_state", "speed_setpoint")
    unknown = ("stopping_distance", "pose_x", "pose_y", "pose_z", "pose_x_sd", "pose_y_sd", "pose_z_sd")
    for state, code in (
        (replace(STATE, setpoint=Setpoint(), pose=None), 0),
        (replace(STATE, setpoint=Setpoint(DriveState.INHIBITED), pose=None), 1),
        (forced_stop(STATE, Reason.GATEWAY_FAULT, STATE.t_ns), 1),
        (resumed(replace(STATE, valid_until_ns=0), STATE.t_ns), 1),
    ):
        now = values(state)
        assert [now[name] for name in known] == [0, code, 0]
        assert [now[name] for name in unknown] == [None] * 7


def test_the_table_covers_the_block_once_and_is_in_order() -> None:
    spans = sorted([(r.address, r.words) for r in REGISTERS] + [(p.address, p.words) for p in RESERVED])
    at = 0
    for address, words in spans:
        assert address == at
        at += words
    assert at == BLOCK_WORDS <= 125
    assert [r.address for r in REGISTERS] == sorted(r.address for r in REGISTERS)
    assert len({r.name for r in REGISTERS}) == len(REGISTERS)


def test_addresses_are_never_renumbered() -> None:
    """The published map. A failure here means a PLC somewhere reads the wrong thing."""
    version_1 = (
        "0 seq_begin uint16, 1 map_version uint16, 2 heartbeat uint16, 3 status uint16, 4 stop uint16, "
        "5 may_move uint16, 6 reason uint16, 7 vision_quality uint16, 8 range_quality uint16, 9 d uint16, 10 u int16, "
        "11 v int16, 12 radius uint16, 13 distance uint16, 14 z_vision uint16, 15 vision_age uint16, "
        "16 range_age uint16, 17 vision_rate uint16, 18 range_rate uint16, 19 vision_latency uint16, "
        "20 frame_id uint32, 22 timestamp uint64, 26 frames_skipped uint16, 27 frames_lost uint16, "
        "28 worker_restarts uint16, 29 camera_reopens uint16, 30 ranger_damaged uint16, 31 ranger_gaps uint16, "
        "32 ranger_rejected uint16, 33 ranger_reopens uint16, 34 range_seq uint16, 40 known_u32 uint32, "
        "42 known_f32 float32, 44 u_f32 float32, 46 v_f32 float32, 48 radius_f32 float32, 50 distance_f32 float32, "
        "52 z_vision_f32 float32, 54 x_n_f32 float32, 56 y_n_f32 float32, 99 seq_end uint16"
    )
    rows = [f"{r.address} {r.name} {r.kind.name}" for r in REGISTERS]
    assert set(version_1.split(", ")) <= set(rows)
    tracking_of_version_2 = (
        "70 tracking uint16, 71 confidence uint16, 72 visible uint16, 73 predicted_u int16, 74 predicted_v int16, "
        "75 predicted_radius uint16, 76 semi_minor uint16, 77 tilt uint16"
    )
    assert tracking_of_version_2 in ", ".join(rows)
    assert "100 signal_lamps uint16" in rows
    assert {"101 unit_id uint16", "102 bay_identity uint32"} <= set(rows)


def test_a_prediction_has_its_own_registers_and_only_while_the_marker_is_coasted() -> None:
    coasted = VisionReading(
        STATE.t_ns, Quality.COASTED, tracking=Tracking.COASTED, predicted=Circle(12.34, -5.0, 99.96)
    )
    read = values(replace(STATE, vision=coasted, d=None))
    assert (read["tracking"], read["vision_quality"], read["d"]) == (2, 12, None)
    assert [read[name] for name in ("u", "v", "radius", "u_f32", "confidence", "visible", "tilt")] == [None] * 7
    assert (read["predicted_u"], read["predicted_v"], read["predicted_radius"]) == (12.3, -5.0, 100.0)
    for quality in set(Quality) - {Quality.COASTED}:
        read = values(replace(STATE, vision=replace(coasted, quality=quality)))
        assert [read[name] for name in ("predicted_u", "predicted_v", "predicted_radius")] == [None] * 3
    assert "vision_fault" not in bits(replace(STATE, vision=coasted))


def test_tracking_is_reported_of_fresh_frames_only() -> None:
    fresh = {Quality.GOOD: 1, Quality.NO_TARGET: 3, Quality.COASTED: 2}
    for quality in Quality:
        label = Tracking(fresh.get(quality, Tracking.MEASURED))
        read = values(replace(STATE, vision=replace(STATE.vision, quality=quality, tracking=label)))
        assert read["tracking"] == fresh.get(quality)
        if quality is not Quality.GOOD:
            assert [read[name] for name in ("confidence", "visible", "semi_minor", "tilt")] == [None] * 4


@pytest.mark.parametrize(
    ("major", "minor", "degrees"), [(100, 100, 0), (100, 50, 60), (100, 101, 0), (100, 0, 90), (0, 0, None)]
)
def test_tilt(major: float, minor: float, degrees: float | None) -> None:
    seen = replace(STATE.vision, ellipse=Ellipse(0, 0, major, minor, 0))
    assert values(replace(STATE, vision=seen))["tilt"] == degrees


@pytest.mark.parametrize("quality", [q for q in Quality if q is not Quality.GOOD])
def test_no_value_without_good_quality_even_if_one_is_handed_in(quality: Quality) -> None:
    image = encode(replace(STATE, vision=replace(STATE.vision, quality=quality)), UNIX_NS, "big")
    assert (image[10], image[11], image[12], image[14]) == (0x8000, 0x8000, 0xFFFF, 0xFFFF)
    for address in (44, 46, 48, 52, 54, 56):
        assert image[address : address + 2] == (0x7FC0, 0x0000)
    assert image[7] == quality
    assert (image[13], image[50]) == (300, 0x4395)  # the other sensor keeps its own

    image = encode(replace(STATE, range=replace(STATE.range, quality=quality)), UNIX_NS, "big")
    assert (image[13], image[50], image[51]) == (0xFFFF, 0x7FC0, 0x0000)
    assert image[8] == quality
    assert image[12] == 1813


def test_the_position_of_a_truck() -> None:
    covered_ns = STATE.t_ns - 13 * S + 1
    held = Visit(VisitPhase.HELD, in_place=True, covered_since_ns=covered_ns)
    assert encode(replace(STATE, visit=held), UNIX_NS, "big")[35:40] == (0b00110, 1, 0, 12, 6)
    seen = Visit(VisitPhase.IN_PLACE, in_place=True)
    assert encode(replace(STATE, visit=seen), UNIX_NS, "big")[35:40] == (0b00010, 1, 0, 0xFFFF, 5)
    moved = Visit(VisitPhase.UNKNOWN, moved=Moved.MARKER, covered_since_ns=covered_ns)
    assert encode(replace(STATE, visit=moved), UNIX_NS, "big")[35:40] == (0b01000, 0, Moved.MARKER, 0xFFFF, 0)
    released = replace(STATE, visit=Visit(VisitPhase.RELEASED, released=True), stop=False, may_move=True)
    assert encode(released, UNIX_NS, "big")[35:40] == (0b10001, 0, 0, 0xFFFF, 7)


def test_a_known_zero_is_a_value_and_a_missing_one_is_not() -> None:
    at_origin = replace(STATE, vision=replace(STATE.vision, circle=Circle(0.0, 0.0, 0.0)), z_vision_mm=None, d=None)
    read = values(at_origin)
    assert (read["u"], read["v"], read["radius"], read["u_f32"]) == (0, 0, 0, 0)
    assert (read["z_vision"], read["z_vision_f32"], read["d"]) == (None, None, None)
    assert encode(at_origin, UNIX_NS, "big")[9] == 0xFFFF


def test_good_without_a_value_is_no_value() -> None:
    broken = replace(STATE, vision=replace(STATE.vision, circle=None), range=replace(STATE.range, distance_mm=None))
    read = values(broken)
    assert [read[name] for name in ("u", "v", "radius", "distance", "z_vision")] == [None] * 5


def test_an_age_that_nothing_proves_is_a_bit_and_no_dead_task_shows_it() -> None:
    unproven = replace(STATE, vision=replace(STATE.vision, age_proof=AgeProof.UNPROVEN))
    assert bits(unproven) == bits(STATE) | {"vision_age_unproven"}
    assert encode(unproven, UNIX_NS, "big")[3] >> 15 == 1
    assert bits(replace(STATE, vision=replace(STATE.vision, age_proof=AgeProof.BUFFER_TIME))) == bits(STATE)
    assert "vision_age_unproven" not in bits(fusion.forced_stop(unproven, Reason.GATEWAY_FAULT, unproven.t_ns))


def test_a_limited_value_is_reported_and_its_mirror_is_true() -> None:
    wide = replace(STATE, vision=replace(STATE.vision, circle=Circle(4000.5, 10.0, 180.0)))
    read = values(wide)
    assert read["u"] == 3276.7
    assert read["u_f32"] == 4000.5
    assert bits(wide) == bits(STATE) | {"clamped"}
    assert "clamped" not in bits(STATE)
    old = replace(STATE, vision=replace(STATE.vision, t_ns=STATE.t_ns - 70 * S))
    assert values(old)["vision_age"] == 65534
    assert "clamped" not in bits(old)


def test_ages() -> None:
    ahead = replace(STATE, vision=replace(STATE.vision, t_ns=STATE.t_ns + 5))
    assert values(ahead)["vision_age"] == 0
    waiting = fusion.initial("north", 5 * S)
    assert encode(waiting, UNIX_NS, "big")[15:17] == (0xFFFF, 0xFFFF)


def test_status_bits() -> None:
    waiting = fusion.initial("north", 5 * S)
    assert bits(waiting) == {"stop", "d_unknowable", "starting"}
    permitted = replace(STATE, d=False, stop=False, may_move=True, reason=Reason.NONE)
    assert bits(permitted) == {"may_move", "vision_good", "range_good", "healthy"}
    torn_apart = replace(STATE, memory=FusionMemory(disagree=True), reason=Reason.SENSORS_DISAGREE)
    assert bits(torn_apart) == {
        "stop", "d", "vision_good", "range_good", "fault", "disagree",
    }  # fmt: skip
    leaving = fusion.forced_stop(permitted, Reason.SHUTDOWN, STATE.t_ns)
    assert bits(leaving) == {
        "stop", "d_unknowable", "shutdown", "fault", "vision_fault",
        "range_fault",
    }  # fmt: skip


@pytest.mark.parametrize("quality", list(Quality))
def test_fault_bits_and_fault_events_agree(quality: Quality) -> None:
    """What MQTT reports as a sensor fault is a fault in the registers, and nothing else is."""
    for sensor, bit in (("vision", "vision_fault"), ("range", "range_fault")):
        reading = replace(getattr(STATE, sensor), quality=quality)
        state = replace(STATE, **{sensor: reading})
        reported = any(event.kind is EventKind.SENSOR_FAULT for event in events.diff(STATE, state))
        assert reported == (bit in bits(state)) == ("fault" in bits(state))


def test_the_dead_image() -> None:
    alive = encode(STATE, UNIX_NS, "big")
    image = encode(withdrawn(STATE, STATE.t_ns + S), UNIX_NS, "big")
    read = decode(image)
    assert (read["stop"], read["may_move"], read["reason"]) == (1, 0, 40)
    assert image[2] == alive[2]  # the heartbeat as it stood
    assert (image[10], image[11], image[12], image[13], image[14]) == (0x8000, 0x8000, 0xFFFF, 0xFFFF, 0xFFFF)
    assert (image[7], image[8], image[9]) == (Quality.STALE, Quality.STALE, 0xFFFF)
    assert "gateway_fault" in STATUS.on(image[3])
    assert image[0] == image[99] == alive[0] + 1  # a number no living state can have
    following = encode(replace(STATE, seq=STATE.seq + 1), UNIX_NS, "big")
    assert following[0] == alive[0] + 2


@given(seq=st.integers(0, 2**40))
def test_sequence_numbers_of_living_and_dead_never_meet(seq: int) -> None:
    state = StateVector("b", seq=seq)
    assert encode(state, 0, "big")[0] % 2 == 0
    assert encode(withdrawn(state, 0), 0, "big")[0] == (encode(state, 0, "big")[0] + 1) % 0x1_0000


class HandClock(LoopClock):
    """Monotonic time by hand; the wall clock is UNIX_NS ahead of the state's time."""

    t_ns = STATE.t_ns + 7 * MS

    def now_ns(self) -> int:
        return self.t_ns

    def wall_ns(self) -> int:
        return UNIX_NS + self.t_ns - STATE.t_ns


def test_the_current_image_is_encoded_once_per_state() -> None:
    clock, state = HandClock(), STATE
    read = image_of(lambda: state, "big", clock)
    first = read()
    assert first == encode(STATE, UNIX_NS, "big")  # the timestamp is the state's, not the poll's
    clock.t_ns += S
    assert read() is first
    state = fusion.forced_stop(STATE, Reason.GATEWAY_FAULT, clock.t_ns)
    dead = read()
    assert dead[4:7] == (1, 0, 40)
    # A dead bay's state carries a new time at every call; one sequence number must still mean one image.
    clock.t_ns += 9 * S
    state = fusion.forced_stop(STATE, Reason.GATEWAY_FAULT, clock.t_ns)
    assert read() is dead
    state = replace(STATE, seq=STATE.seq + 1)
    assert read()[0] == dead[0] + 1
    assert read()[6] == 1


@pytest.mark.parametrize("order", ["big", "little"])
def test_decode_gives_back_what_was_encoded(order: WordOrder) -> None:
    read = decode(encode(STATE, UNIX_NS, order))
    assert read["frame_id"] == 0x0002_0003
    assert read["timestamp"] == 1_763_640_000_123
    assert read["known_u32"] == 305_419_896
    assert read["known_f32"] == 123_456.0
    assert (read["u"], read["v"], read["radius"], read["distance"]) == (640.3, -3.1, 181.3, 300)
    assert (read["x_n_f32"], read["y_n_f32"]) == (0.25, -0.5)
    assert read["distance_f32"] == pytest.approx(299.6, abs=1e-4)
    assert read["vision_rate"] == 30.0


def test_decode_refuses_what_it_cannot_trust() -> None:
    image = encode(STATE, UNIX_NS, "big")
    for wrong, message in (
        (image[:100], "123 words, not 100"),
        ((*image[:40], 0, 0, *image[42:]), "registers 40 and 41 do not hold 0x12345678"),
        ((*image[:99], image[99] ^ 2, *image[100:]), "torn"),
        ((*image[:1], 0, *image[2:]), "map version 0"),
    ):
        with pytest.raises(ProtocolError, match=message):
            decode(wrong)


NUMBERS = st.one_of(st.floats(), st.floats(-10_000, 10_000), st.integers(-(2**70), 2**70).map(float))
COUNTS = st.integers(0, 2**70)


@pytest.mark.one_interpreter
@given(
    u=NUMBERS,
    v=NUMBERS,
    radius=NUMBERS,
    distance=NUMBERS,
    z_vision=st.none() | NUMBERS,
    rate=NUMBERS,
    count=COUNTS,
    times=st.tuples(*[st.integers(-(2**70), 2**70)] * 4),
    qualities=st.tuples(st.sampled_from(Quality), st.sampled_from(Quality)),
    order=st.sampled_from(("big", "little")),
)
def test_any_numbers_encode_without_raising_or_wrapping(
    u: float,
    v: float,
    radius: float,
    distance: float,
    z_vision: float | None,
    rate: float,
    count: int,
    times: tuple[int, int, int, int],
    qualities: tuple[Quality, Quality],
    order: WordOrder,
) -> None:
    state = StateVector(
        "b",
        t_ns=times[0],
        seq=count,
        heartbeat=count,
        vision=VisionReading(
            times[1],
            qualities[0],
            Circle(u, v, radius),
            count,
            x_n=u,
            y_n=v,
            stats=VisionStats(count, count, count, count, count, rate, rate),
        ),
        range=RangeReading(
            times[2], qualities[1], distance, count, stats=RangeStats(count, count, count, count, count, rate)
        ),
        z_vision_mm=z_vision,
    )
    image = encode(state, times[3], order)

    assert len(image) == BLOCK_WORDS
    assert all(type(word) is int and 0 <= word <= 0xFFFF for word in image)
    read = decode(image)
    for name, value, scale, low, high, quality in (
        ("u", u, 0.1, -3276.7, 3276.7, qualities[0]),
        ("v", v, 0.1, -3276.7, 3276.7, qualities[0]),
        ("radius", radius, 0.1, 0, 6553.4, qualities[0]),
        ("z_vision", z_vision, 1, 0, 65534, qualities[0]),
        ("distance", distance, 1, 0, 65534, qualities[1]),
    ):
        shown = read[name]
        if quality is not Quality.GOOD or value is None or not abs(value) < float("inf"):
            assert shown is None
        else:
            assert shown is not None
            assert abs(shown - min(max(value, low), high)) <= scale * 0.5000001
    if qualities[0] is not Quality.WAITING:
        assert read["vision_age"] == min(max(0, times[0] - times[1]) // MS, 65534)
    assert read["frames_lost"] == count % 65536
    assert read["frame_id"] == count % 2**32
    assert read["timestamp"] == min(max(0, times[3] // MS), 2**64 - 1)
