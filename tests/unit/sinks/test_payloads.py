"""The content of the messages; every one follows its JSON Schema."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from gateway.core import fusion
from gateway.core.detection import Circle, Ellipse, Tracking
from gateway.core.events import Event, EventKind
from gateway.core.marker_wear import MarkerWear, WearTrend
from gateway.core.pose import MetricPose
from gateway.core.readings import (
    CameraExposure,
    ExposureState,
    PictureHealth,
    Quality,
    RangeReading,
    RangeStats,
    RelayOutput,
    RelayStatus,
    VisionReading,
    VisionStats,
)
from gateway.core.scale import MarkerScale, ScaleSample
from gateway.core.setpoint import DriveState, Setpoint
from gateway.core.shown import shown, withdrawn
from gateway.core.state import (
    FusionMemory,
    GuidanceCode,
    Moved,
    Reason,
    StateVector,
    Visit,
    VisitPhase,
)
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.sinks.contract import BayAlarms, ShownAlarm
from gateway.sinks.mqtt import messages, payloads
from gateway.sinks.mqtt.payloads import encode, event_payload, state_payload, status_payload
from gateway.sinks.mqtt.topic_plan import PLAN
from gateway.sinks.mqtt.topics import Gateway, Topics
from gateway.values.gateway_values import GatewayFacts
from tests.mqtt_messages import checked
from tools import mqtt

DOCS = Path(__file__).parents[3] / "docs"
MS = 1_000_000
GATEWAY = Gateway(Topics("loading", "plant7", "north"), ("bay1", "bay2"), "1.2.3", "0123456789abcdef")
NOW_NS = 5_000 * MS
WALL_NS = 1_700_000_000_123 * MS + 456_789  # 2023-11-14T22:13:20.123Z
OFFSET_NS = WALL_NS - NOW_NS
GOOD = StateVector(
    bay="bay2",
    t_ns=NOW_NS,
    seq=77,
    heartbeat=70,
    vision=VisionReading(
        NOW_NS - 21 * MS,
        Quality.GOOD,
        Circle(320.12345, 240.5, 181.25),
        frame_id=9,
        x_n=0.0123456789,
        y_n=-0.5,
        ellipse=Ellipse(320.12345, 240.5, 181.25, 169.94321, 0.5),
        confidence=0.98765432,
        visible=0.75,
        tracking=Tracking.MEASURED,
        stats=VisionStats(frames=9, skipped=1, lost=2, restarts=3, reopens=4, rate_hz=29.994, latency_ms=11.426),
    ),
    range=RangeReading(
        NOW_NS - 44_440_000,
        Quality.GOOD,
        299.999,
        seq=5,
        stats=RangeStats(lines=5, damaged=6, gaps=7, rejected=8, reopens=9, rate_hz=19.5),
    ),
    d=True,
    stop=True,
    reason=Reason.TARGET_REACHED,
    z_vision_mm=301.004,
    setpoint=Setpoint(DriveState.CREEP, enable=True, speed_mm_s=29.64, stopping_mm=41.234),
    pose=MetricPose(-12.504, 3.25, 10.0, 0.521, 0.55, 1.94),
)


def sent(payload: BaseModel) -> dict[str, Any]:
    """What a subscriber reads; checked against the schema file that the documentation offers."""
    (kind,) = (kind.name for kind in PLAN if kind.model is type(payload))
    return checked(kind, encode(payload))


def test_the_health_of_the_picture_is_published_with_fresh_frames_only() -> None:
    health = PictureHealth(0.52134, 0.01, 0.45671, 0.6182, None, 3.257, status=0b101000, veil_proven=0.85)
    state = replace(GOOD, vision=replace(GOOD.vision, picture=health))
    assert sent(state_payload(state, GATEWAY, OFFSET_NS, 2500))["picture"] == {
        "brightness": 0.5213,
        "clipped": 0.01,
        "contrast": 0.4567,
        "sharpness": 0.6182,
        "veil": None,
        "veil_proven": 0.85,
        "shift_px": 3.26,
        "faults": ["BLURRED", "SHIFTED"],
    }
    stale = replace(state, vision=replace(state.vision, quality=Quality.STALE, circle=None))
    assert sent(state_payload(stale, GATEWAY, OFFSET_NS, 2500))["picture"] is None


@pytest.mark.parametrize(
    ("state", "drive"),
    [
        (replace(GOOD, setpoint=Setpoint(), pose=None), None),
        (
            fusion.forced_stop(GOOD, Reason.SHUTDOWN, NOW_NS),
            {"enable": False, "state": "INHIBITED", "speed_setpoint_mm_s": 0.0, "stopping_mm": None},
        ),
    ],
)
def test_without_a_drive_there_is_none_and_a_gateway_that_ends_withdraws_its_setpoint(
    state: StateVector, drive: dict[str, Any] | None
) -> None:
    now = sent(state_payload(state, GATEWAY, OFFSET_NS, 2500))
    assert (now["drive"], now["pose"]) == (drive, None)


@pytest.mark.parametrize(
    ("exposure", "shown"),
    [
        (
            CameraExposure(ExposureState.TOO_DARK, 7.99961, 23.987),
            {"state": "TOO_DARK", "time_ms": 8.0, "gain_db": 23.99},
        ),
        (CameraExposure(ExposureState.NO_CONTROLS), {"state": "NO_CONTROLS", "time_ms": None, "gain_db": None}),
        (None, None),
    ],
)
def test_the_cameras_exposure_is_published_with_fresh_frames_only(
    exposure: CameraExposure | None, shown: dict[str, Any] | None
) -> None:
    state = replace(GOOD, vision=replace(GOOD.vision, exposure=exposure))
    assert sent(state_payload(state, GATEWAY, OFFSET_NS, 2500))["exposure"] == shown
    stale = replace(state, vision=replace(state.vision, quality=Quality.STALE, circle=None))
    assert sent(state_payload(stale, GATEWAY, OFFSET_NS, 2500))["exposure"] is None


def test_a_good_state() -> None:
    assert sent(state_payload(GOOD, GATEWAY, OFFSET_NS, 2500)) == {
        "schema_version": 1,
        "site": "plant7",
        "bay": "bay2",
        "instance": "north",
        "status_topic": "loading/plant7/north/status",
        "stale_after_ms": 2500,
        "seq": 77,
        "heartbeat": 70,
        "timestamp_ms": 1_700_000_000_123,
        "timestamp": "2023-11-14T22:13:20.123Z",
        "stop": True,
        "may_move": False,
        "in_place": False,
        "held": False,
        "moved": "NO",
        "rolling": False,
        "phase": "UNKNOWN",
        "reason": {"name": "TARGET_REACHED", "code": 1, "text": Reason.TARGET_REACHED.meaning},
        "d": True,
        "u": 320.123,
        "v": 240.5,
        "radius_px": 181.25,
        "distance_mm": 300.0,
        "z_vision_mm": 301.0,
        "vision": {"quality": {"name": "GOOD", "code": 0}, "age_ms": 21.0, "detail": "", "age_proof": None},
        "range": {"quality": {"name": "GOOD", "code": 0}, "age_ms": 44.4, "detail": ""},
        "frame_id": 9,
        "x_n": 0.012346,
        "y_n": -0.5,
        "tracking": "MEASURED",
        "confidence": 0.9877,
        "visible": 0.75,
        "frames_summed": 1,
        "semi_minor_px": 169.943,
        "tilt_deg": 20.34,
        "predicted": None,
        "in_place_ms": None,
        "held_ms": None,
        "scale": None,
        "marker": None,
        "picture": None,
        "exposure": None,
        "rangers": None,
        "beacon": None,
        "relay": None,
        "drive": {"enable": True, "state": "CREEP", "speed_setpoint_mm_s": 29.6, "stopping_mm": 41.23},
        "pose": {"x_mm": -12.5, "y_mm": 3.25, "z_mm": 10.0, "x_sd_mm": 0.52, "y_sd_mm": 0.55, "z_sd_mm": 1.94},
        "ne107": {"name": "GOOD", "code": 0, "active": []},
        "guidance": {
            "name": "WAIT",
            "code": 0,
            "text": GuidanceCode.WAIT.meaning,
            **dict.fromkeys(["amount_mm", "offset_u_px", "offset_v_px", "offset_mm", "closing_mm_s", "to_go_mm"]),
        },
        "plc": {
            "link": "UNUSED",
            "age_ms": None,
            "stop_latched": False,
            "recipe": 0,
            "acquisition_id": 0,
            "results_valid": False,
            "writes": 0,
            "write_conflicts": 0,
        },
        "rates": {"vision_hz": 29.99, "range_hz": 19.5, "vision_latency_ms": 11.43},
        "counters": {
            "frames": 9,
            "frames_skipped": 1,
            "frames_lost": 2,
            "vision_restarts": 3,
            "camera_reopens": 4,
            "range_lines": 5,
            "range_damaged": 6,
            "range_gaps": 7,
            "range_rejected": 8,
            "ranger_reopens": 9,
        },
    }


def test_how_long_a_truck_is_in_place_and_how_long_it_is_held() -> None:
    here = Visit(VisitPhase.HELD, in_place=True, in_place_since_ns=NOW_NS - 61_000 * MS, covered_since_ns=NOW_NS - MS)
    found = sent(state_payload(replace(GOOD, visit=here), GATEWAY, OFFSET_NS, 1))
    assert (found["in_place"], found["held"], found["in_place_ms"], found["held_ms"]) == (True, True, 61_000.0, 1.0)
    lost = replace(here, in_place=False)  # the marker is still covered
    found = sent(state_payload(replace(GOOD, visit=lost), GATEWAY, OFFSET_NS, 1))
    assert (found["in_place"], found["held"], found["in_place_ms"], found["held_ms"]) == (False, False, None, None)


def test_worn_markers_with_what_is_left() -> None:
    wear = MarkerWear(31, WearTrend(0.82345, -0.0152, 14.8), WearTrend(1.2), worn=False)
    found = sent(state_payload(replace(GOOD, marker=wear), GATEWAY, OFFSET_NS, 1))
    assert found["marker"] == {
        "visible": 0.8235, "visible_a_day": -0.0152, "contrast": 1.2, "contrast_a_day": None, "days_left": 14.8,
        "worn": False,
    }  # fmt: skip


def test_the_learned_scale_with_its_date() -> None:
    newest = ScaleSample(0, 200.0, 280.0, t_ns=NOW_NS - 1000 * MS)
    scale = MarkerScale(56_000.04, 281.5, 0.012345, 12, newest)
    found = sent(state_payload(replace(GOOD, memory=FusionMemory(scale=scale)), GATEWAY, OFFSET_NS, 1))
    assert found["scale"] == {
        "px_mm": 56_000.0,
        "spread": 0.0123,
        "visits": 12,
        "newest_ms": 1_699_999_999_000,
        "jump": None,
    }
    before = replace(scale, newest=replace(newest, unix_s=1_600_000_000), jump=-0.25)  # of before the restart
    found = sent(state_payload(replace(GOOD, memory=FusionMemory(scale=before)), GATEWAY, OFFSET_NS, 1))
    assert (found["scale"]["newest_ms"], found["scale"]["jump"]) == (1_600_000_000_000, -0.25)


def test_the_relay_by_its_command_and_its_pins() -> None:
    status = RelayStatus(RelayOutput.IN_PLACE, RelayOutput.IN_PLACE | RelayOutput.MAY_MOVE, fault=True)
    state = replace(GOOD, range=replace(GOOD.range, relay=status))
    found = sent(state_payload(state, GATEWAY, OFFSET_NS, 1))
    assert found["relay"] == {"commanded": "IN_PLACE", "in_place": True, "may_move": True, "fault": True}
    assert sent(state_payload(withdrawn(state, NOW_NS), GATEWAY, OFFSET_NS, 1))["relay"] is None


@pytest.mark.parametrize("quality", [q for q in Quality if q is not Quality.GOOD])
def test_a_value_without_good_quality_is_not_published(quality: Quality) -> None:
    """Even where the record wrongly still carries one."""
    blind = sent(state_payload(replace(GOOD, vision=replace(GOOD.vision, quality=quality)), GATEWAY, 0, 1))
    assert [blind[key] for key in ("u", "v", "radius_px", "z_vision_mm", "x_n", "y_n")] == [None] * 6
    assert [
        blind[key] for key in ("confidence", "visible", "frames_summed", "semi_minor_px", "tilt_deg", "predicted")
    ] == [None] * 6
    fresh = quality in (Quality.NO_TARGET, Quality.COASTED)
    assert blind["tracking"] == ("MEASURED" if fresh else None)
    assert blind["distance_mm"] == 300.0
    assert blind["vision"]["quality"] == {"name": quality.name, "code": int(quality)}

    deaf = sent(state_payload(replace(GOOD, range=replace(GOOD.range, quality=quality)), GATEWAY, 0, 1))
    assert deaf["distance_mm"] is None
    assert deaf["u"] == 320.123
    assert deaf["range"]["quality"] == {"name": quality.name, "code": int(quality)}


def test_a_prediction_is_in_no_measured_field() -> None:
    place = Circle(12.34567, -5.0, 99.96)
    coasted = VisionReading(NOW_NS, Quality.COASTED, tracking=Tracking.COASTED, predicted=place)
    found = sent(state_payload(replace(GOOD, vision=coasted, d=None), GATEWAY, 0, 1))
    assert found["predicted"] == {"u": 12.346, "v": -5.0, "radius_px": 99.96}
    assert (found["tracking"], found["u"], found["v"], found["radius_px"]) == ("COASTED", None, None, None)
    for quality in set(Quality) - {Quality.COASTED}:
        other = replace(GOOD, vision=replace(coasted, quality=quality))
        assert sent(state_payload(other, GATEWAY, 0, 1))["predicted"] is None
    broken = replace(GOOD, vision=replace(coasted, predicted=Circle(float("nan"), 0.0, 1.0)))
    assert sent(state_payload(broken, GATEWAY, 0, 1))["predicted"] is None


def test_where_nothing_was_received_there_is_no_age() -> None:
    state = replace(GOOD, vision=VisionReading(0, Quality.WAITING), range=RangeReading(0, Quality.STALE))
    found = sent(state_payload(state, GATEWAY, OFFSET_NS, 1))
    assert found["vision"]["age_ms"] is None
    assert found["range"]["age_ms"] == 5000.0


def test_an_event() -> None:
    reading = replace(GOOD.range, quality=Quality.NO_ECHO, distance_mm=None)
    state = replace(GOOD, range=reading, d=None, reason=Reason.NO_ECHO)
    event = Event(EventKind.SENSOR_FAULT, "bay2", NOW_NS, state, "range", Quality.NO_ECHO, "nothing came back")
    found = sent(event_payload(event, 12, GATEWAY, OFFSET_NS))
    assert (
        found.items()
        >= {
            "id": "0123456789abcdef-12",
            "kind": "sensor_fault",
            "sensor": "range",
            "quality": {"name": "NO_ECHO", "code": 6},
            "detail": "nothing came back",
            "bay": "bay2",
            "site": "plant7",
            "timestamp_ms": 1_700_000_000_123,
            "timestamp": "2023-11-14T22:13:20.123Z",
            "stop": True,
            "d": None,
            "u": 320.123,
            "distance_mm": None,
            "seq": 77,
        }.items()
    )
    assert found["reason"]["name"] == "NO_ECHO"
    later = sent(event_payload(replace(event, t_ns=NOW_NS + 250 * MS), 12, GATEWAY, OFFSET_NS))
    assert later["timestamp_ms"] - found["timestamp_ms"] == 250, "time and ages are those at the event"
    assert later["vision"]["age_ms"] - found["vision"]["age_ms"] == pytest.approx(250)


@pytest.mark.parametrize("sensor", ["", "cross_check", "an unknown sensor"])
def test_only_a_sensor_that_has_one_is_given_a_quality(sensor: str) -> None:
    found = sent(event_payload(Event(EventKind.SENSOR_FAULT, "bay2", NOW_NS, GOOD, sensor), 1, GATEWAY, 0))
    assert found["quality"] is None
    assert found["sensor"] == ("cross_check" if sensor == "cross_check" else None)


def test_the_status_and_the_will() -> None:
    delivery = messages.DeliveryPayload(published=5, failed=4, reconnects=3, dropped=2, queued=1)
    common = {
        "schema_version": 1,
        "site": "plant7",
        "instance": "north",
        "version": "1.2.3",
        "boot": "0123456789abcdef",
        "bays": ["bay1", "bay2"],
    }
    assert sent(status_payload(GATEWAY, "running", WALL_NS, delivery)) == common | {
        "status": "online",
        "cause": "running",
        "timestamp_ms": 1_700_000_000_123,
        "timestamp": "2023-11-14T22:13:20.123Z",
        "delivery": {"published": 5, "failed": 4, "reconnects": 3, "dropped": 2, "queued": 1, "store": None},
        "gateway": None,
        "health": [],
    }
    assert sent(status_payload(GATEWAY, "connection lost")) == common | {
        "status": "offline",
        "cause": "connection lost",
        "timestamp_ms": None,
        "timestamp": None,
        "delivery": None,
        "gateway": None,
        "health": [],
    }
    assert sent(status_payload(GATEWAY, "shutdown", WALL_NS, delivery))["status"] == "offline"


def test_the_status_says_what_is_known_of_the_gateway_and_of_each_bay() -> None:
    """Nothing in it may be taken for an output: those are in the state, which expires."""
    facts = GatewayFacts("a" * 64, "b" * 64, "proving", "", {"hmi": 12}, "https://north:8080/")
    visit = VisitSummary(
        1_700_000_000_000, 61.23, VisitEnd.CLEAR, moved=Moved.MARKER, faults=((Reason.RANGE_STALE, 2, 3.0),)
    )
    alarms = BayAlarms((alarm("high"), alarm("low"), alarm("low", active=False)), (alarm("low"),), evaluated=True)
    bays = [payloads.bay_health(GOOD, "Loading 2", alarms, visit, OFFSET_NS),
            payloads.bay_health(StateVector(bay="bay1"), "", BayAlarms(), None, OFFSET_NS)]  # fmt: skip
    found = sent(status_payload(GATEWAY, "running", WALL_NS, None, payloads.gateway_payload(facts, 30), bays))
    assert found["gateway"] == {
        "configuration": {"in_force": "a" * 64, "reviewed": "b" * 64, "as_reviewed": False},
        "update": {"stage": "proving", "outcome": None},
        "certificate_days": {"hmi": 12, "mqtt": 30},
        "pages": "https://north:8080/",
    }
    known, unknown = found["health"]
    assert (known["bay"], known["title"], known["function_check"]) == ("bay2", "Loading 2", "OFF")
    assert known["alarms"] == {"high": 1, "medium": 0, "low": 2}
    assert known["last_visit"] == {
        "begun_ms": 1_700_000_000_000, "end": "clear", "length_s": 61.23, "moved": "MARKER", "fault_times": 2,
    }  # fmt: skip
    assert [unknown[name] for name in ("veil", "marker", "alarms", "last_visit")] == [None] * 4
    assert {"stop", "may_move", "in_place"}.isdisjoint(known)


def test_without_an_update_and_a_reviewed_configuration_both_are_null() -> None:
    own = payloads.gateway_payload(GatewayFacts("a" * 64), None)
    found = sent(status_payload(GATEWAY, "running", WALL_NS, own=own))
    assert found["gateway"] == {
        "configuration": {"in_force": "a" * 64, "reviewed": None, "as_reviewed": None},
        "update": None, "certificate_days": {}, "pages": None,
    }  # fmt: skip


def alarm(priority: str, *, active: bool = True) -> ShownAlarm:
    return ShownAlarm("bay2.x", "x", "X", priority, "unacknowledged", True, active, 0)


def test_a_state_that_is_not_computed_any_more_is_stop_without_values() -> None:
    moving = replace(GOOD, stop=False, may_move=True, d=False, reason=Reason.NONE, valid_until_ns=NOW_NS)
    found = sent(state_payload(shown(moving, NOW_NS + 3_000_000_001), GATEWAY, OFFSET_NS, 1))
    assert (found["stop"], found["may_move"], found["d"]) == (True, False, None)
    assert found["reason"]["name"] == "GATEWAY_FAULT"
    assert [found[key] for key in ("u", "v", "radius_px", "distance_mm", "z_vision_mm")] == [None] * 5
    assert (found["vision"]["quality"]["name"], found["range"]["quality"]["name"]) == ("STALE", "STALE")
    assert found["heartbeat"] == 70
    assert found["timestamp_ms"] == 1_700_000_003_123


def test_the_final_state_is_stop_without_values() -> None:
    permitted = replace(GOOD, stop=False, may_move=True, d=False, reason=Reason.NONE)
    left = payloads.final(permitted, NOW_NS + 5)
    assert (left.stop, left.may_move, left.reason, left.d) == (True, False, Reason.SHUTDOWN, None)
    assert (left.vision.circle, left.range.distance_mm) == (None, None)
    assert payloads.final(left, NOW_NS + 9) is left


def test_text_for_people_is_bounded_and_always_utf_8() -> None:
    ugly = replace(GOOD, vision=replace(GOOD.vision, detail="\udcff€\0\n" + "x" * 1000))
    detail = sent(state_payload(ugly, GATEWAY, 0, 1))["vision"]["detail"]
    assert detail == "?€\0\n" + "x" * (payloads.MAX_TEXT_CHARS - 4)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_what_json_has_no_number_for_is_no_number(value: float) -> None:
    state = replace(GOOD, range=replace(GOOD.range, distance_mm=value), z_vision_mm=value)
    payload = state_payload(state, GATEWAY, OFFSET_NS, 1)
    assert (payload.distance_mm, payload.z_vision_mm) == (None, None)


WILD_NUMBER = st.floats() | st.integers(-(2**70), 2**70).map(float)
WILD_TIME = st.integers(-(2**80), 2**80)
COUNT = st.integers(0, 2**70)
WILD_STATE = st.builds(
    StateVector,
    bay=st.just("bay1"),
    t_ns=WILD_TIME,
    seq=COUNT,
    heartbeat=COUNT,
    vision=st.builds(
        VisionReading,
        t_ns=WILD_TIME,
        quality=st.sampled_from(Quality),
        circle=st.none() | st.builds(Circle, WILD_NUMBER, WILD_NUMBER, WILD_NUMBER),
        frame_id=COUNT,
        x_n=st.none() | WILD_NUMBER,
        y_n=st.none() | WILD_NUMBER,
        detail=st.text(st.characters(exclude_categories=[])),
        stats=st.builds(VisionStats, COUNT, COUNT, COUNT, COUNT, COUNT, WILD_NUMBER, WILD_NUMBER),
    ),
    range=st.builds(
        RangeReading,
        t_ns=WILD_TIME,
        quality=st.sampled_from(Quality),
        distance_mm=st.none() | WILD_NUMBER,
        detail=st.text(st.characters(exclude_categories=[])),
        stats=st.builds(RangeStats, COUNT, COUNT, COUNT, COUNT, COUNT, WILD_NUMBER),
    ),
    d=st.none() | st.booleans(),
    stop=st.booleans(),
    may_move=st.booleans(),
    reason=st.sampled_from(Reason),
    z_vision_mm=st.none() | WILD_NUMBER,
)


@pytest.mark.long
@pytest.mark.one_interpreter
@given(state=WILD_STATE, offset_ns=WILD_TIME, now_ns=WILD_TIME)
def test_any_state_becomes_a_valid_message(state: StateVector, offset_ns: int, now_ns: int) -> None:
    for state_ in (state, shown(state, now_ns), payloads.final(state, now_ns)):
        sent(state_payload(state_, GATEWAY, offset_ns, 1))


@pytest.mark.one_interpreter
@given(
    state=WILD_STATE,
    kind=st.sampled_from(EventKind),
    t_ns=WILD_TIME,
    sensor=st.sampled_from(["", *messages.SENSORS]) | st.text(),
    quality=st.sampled_from(Quality),
    number=st.integers(1, 2**70),
)
def test_any_event_becomes_a_valid_message(
    state: StateVector, kind: EventKind, t_ns: int, sensor: str, quality: Quality, number: int
) -> None:
    event = Event(kind, "bay1", t_ns, state, sensor, quality, state.vision.detail)
    sent(event_payload(event, number, GATEWAY, OFFSET_NS))


def test_every_event_has_its_text() -> None:
    assert set(mqtt.EVENT_MEANING) == set(EventKind)


@pytest.mark.parametrize("name", sorted(mqtt.schemas()))
def test_the_schemas_are_schemas(name: str) -> None:
    jsonschema.Draft202012Validator.check_schema(json.loads(mqtt.schemas()[name]))


def test_the_examples_follow_their_schemas() -> None:
    for example in mqtt.examples().values():
        sent(example)
