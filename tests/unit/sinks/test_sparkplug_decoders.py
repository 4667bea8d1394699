"""What decoders that others wrote read of our bytes: every name, datatype, value and time, in births and in data."""

import math
from dataclasses import replace
from typing import Any

import pytest

from gateway.core.detection import Circle
from gateway.core.fusion import initial
from gateway.core.readings import PictureHealth, Quality, RangeReading, VisionReading
from gateway.core.state import Moved, Reason, StateVector
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.sinks.contract import BayAlarms, ShownAlarm
from gateway.sinks.mqtt.topics import MqttMessage
from gateway.sinks.outbox.outbox import MemoryOutbox, OutboxLimits
from gateway.sinks.sparkplug import node as edge_node
from gateway.sinks.sparkplug.history import History
from gateway.sinks.sparkplug.node import EdgeNode, Identity
from gateway.sinks.sparkplug.wire import DataType, Metric, Payload, encode
from tests.sparkplug_decoders import DECODERS, Decoder, ReadMetric, UnreadableError, pysparkplug, sparkplug_payload

T0 = 1_700_000_000_000
EDGES: dict[DataType, tuple[Any, ...]] = {
    DataType.INT32: (-(2**31), -1, 0, 1, 2**31 - 1),
    DataType.INT64: (-(2**63), -1, 0, 255, 2**63 - 1),
    DataType.DOUBLE: (-1e300, -0.5, 0.0, 0.1, 1e-300, 1e300),
    DataType.BOOLEAN: (False, True),
    DataType.STRING: ("", "stop", "Tor Süd ≥ 3 °C", "x" * 300),
    DataType.DATETIME: (0, 1, T0, 253_402_300_799_999),
}


def wrote(payload: Payload) -> list[ReadMetric]:
    """What a host application must get of it."""
    return [ReadMetric(m.name, m.datatype.name, m.value, m.timestamp_ms, m.historical) for m in payload.metrics]


@pytest.fixture
def payloads(monkeypatch: pytest.MonkeyPatch) -> list[Payload]:
    """All that edge nodes have encoded."""
    made: list[Payload] = []

    def kept(payload: Payload, *, typed: bool = True) -> bytes:
        made.append(payload)
        return encode(payload, typed=typed)

    monkeypatch.setattr(edge_node, "encode", kept)
    return made


def good_state(stop: bool = False) -> StateVector:
    return replace(
        initial("bay1", 5),
        vision=VisionReading(
            5,
            Quality.GOOD,
            Circle(320.25, 240.5, 181.4),
            picture=PictureHealth(0.4, 0.01, 0.5, 0.6, 0.1, 3.0),
            confidence=0.987,
        ),
        range=RangeReading(5, Quality.GOOD, 296.5),
        d=stop,
        stop=stop,
        may_move=not stop,
        reason=Reason.TARGET_REACHED if stop else Reason.NONE,
    )


VISIT = VisitSummary(
    T0 + 1, 60.04, VisitEnd.NEXT_TRUCK, to_position_s=12.34, in_place_s=30.0, times_in_place=1,
    corrections=2, distance_mm=301.6, moved=Moved.MARKER, interruptions=1, faults=((Reason.CAMERA_DOWN, 2, 3.0),),
)  # fmt: skip


def node(*, typed_data: bool = True) -> EdgeNode:
    history = History(MemoryOutbox(OutboxLimits(10)), 10, "ab", ["bay1", "bay2"])
    alarm = ShownAlarm("bay1.camera_down", "camera_down", "Camera down", "high", "unacknowledged", True, True, 5)
    alarms = BayAlarms((alarm,), evaluated=True)
    return EdgeNode(Identity("group", "node"), "1.0", history, typed_data=typed_data, alarms=lambda bay: alarms)


def life(edge: EdgeNode) -> list[MqttMessage]:
    """NBIRTH, DBIRTHs of a bay without values and of one with all, history, data with and without values."""
    edge.changed(good_state(stop=True), T0 + 1)
    edge.changed(good_state(), T0 + 2)
    edge.visited("bay1", VISIT, T0 + 3)
    states = {"bay1": good_state(), "bay2": initial("bay2", 5)}
    edge.will(255, T0 + 10)
    messages = edge.connected(states, T0 + 11)
    messages += edge.states(states | {"bay1": good_state(stop=True)}, T0 + 12)
    messages += edge.states(states | {"bay1": replace(initial("bay1", 6), reason=Reason.SENSORS_DISAGREE)}, T0 + 13)
    return messages


@pytest.mark.parametrize("decoder", DECODERS)
def test_foreign_decoders_read_every_message_of_a_life(decoder: Decoder, payloads: list[Payload]) -> None:
    messages = life(node())
    kinds = [message.topic.split("/")[2] for message in messages]
    assert kinds == ["NBIRTH", "DBIRTH", "DBIRTH", "DDATA", "DDATA", "DDATA", "DDATA"]
    read = decoder([message.payload for message in messages])
    assert read == [wrote(payload) for payload in payloads[1:]]  # but for the NDEATH
    history, stop, outbox, blind = ({(m.name, m.value) for m in metrics} for metrics in read[3:])
    assert {("Stop", True), ("Stop", False), ("Reason/Code", 1), ("Visit/Last/Times In Place", 1)} <= history
    assert {("Stop", True), ("Reason/Code", 1), ("D", True)} <= stop
    assert {("Reason/Code", 30), ("Marker/Radius", None), ("Distance", None), ("D", None)} <= blind
    assert outbox == {("Outbox/Waiting", 0)}, "of the other bay"
    births = {(m.name, m.value) for m in read[1]}
    assert {("Alarms/State/camera_down", "unacknowledged"), ("Alarms/Highest Priority", "high")} <= births
    assert {("Guidance/Name", "WAIT"), ("NE107/Code", 0), ("PLC/Link", "UNUSED"), ("Outbox/File OK", None)} <= births
    assert all(metric.historical for metric in read[3])


@pytest.mark.parametrize("decoder", DECODERS)
def test_foreign_decoders_read_every_datatype_to_its_ends(decoder: Decoder) -> None:
    assert set(EDGES) == set(DataType)
    payload = Payload(
        T0,
        tuple(
            Metric(f"{datatype.name} {n}", T0 + n, datatype, value, historical=n % 2 == 1, unit="mm")
            for datatype, values in EDGES.items()
            for n, value in enumerate((*values, None))
        ),
        seq=255,
    )
    (read,) = decoder([encode(payload)])
    assert read == wrote(payload)
    assert all(math.copysign(1, m.value) == 1 for m in read if m.value == 0.0)


@pytest.mark.long
@pytest.mark.one_interpreter
def test_without_datatypes_in_data_these_decoders_read_nothing() -> None:
    """What `datatypes_in_data = false` costs; the births are the same."""
    messages = life(node(typed_data=False))
    births, data = messages[:3], messages[3:]
    for decoder in DECODERS:
        assert all(metric.datatype for metrics in decoder([m.payload for m in births]) for metric in metrics)
    for message in data:
        (read,) = sparkplug_payload([message.payload])
        assert {(metric.datatype, metric.value) for metric in read} == {("", None)}
        with pytest.raises(UnreadableError, match="UNKNOWN not implemented"):
            pysparkplug([message.payload])
