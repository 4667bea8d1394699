"""An alarm that the package does not know, from outside it: raised, shown first by its priority, acknowledged."""

from gateway.alarms.bay_alarms import BAY_ALARMS
from gateway.alarms.definition import AlarmDefinition, BayInputs, Priority
from gateway.alarms.engine import AlarmEngine
from gateway.alarms.records import ActionReply, OperatorAction
from gateway.alarms.states import AlarmEvent, AlarmState
from gateway.config import BayConfig
from gateway.core.detection import Circle
from gateway.core.readings import Quality, VisionReading
from tests.permitted import permitted

S = 1_000_000_000
OFF_CENTRE: AlarmDefinition[BayInputs] = AlarmDefinition(
    "off_centre",
    "Marker at the edge of the picture",
    Priority.HIGH,
    "the marker is nearer than 20 px to the left edge of the picture",
    "the next truck may leave the picture before it is in place",
    ("the camera was turned", "the truck stands askew"),
    "turn the camera until the marker is in the middle",
    30,
    lambda inputs: (circle := inputs.state.vision.circle) is not None and circle.u_px < 20.0,
    on_delay_s=3.0,
)


def test_an_alarm_from_outside_lives_like_any_other() -> None:
    engine = AlarmEngine({"bay1": BayConfig()}, (*BAY_ALARMS, OFF_CENTRE))
    state = permitted(vision=VisionReading(4_960_000_000, Quality.GOOD, Circle(10.0, 240.0, 100.0)))
    assert engine.update_bay(state, 0) == engine.update_bay(state, 2 * S) == []
    (change,) = engine.update_bay(state, 3 * S)
    assert (change.id, change.after) == ("bay1.off_centre", AlarmState.UNACKNOWLEDGED)
    assert [alarm.id for alarm in engine.summary().alarms] == ["bay1.off_centre"]
    reply, _ = engine.act(OperatorAction("bay1.off_centre", AlarmEvent.ACKNOWLEDGE, "anna"), 4 * S)
    assert reply == ActionReply()
    assert engine.update_bay(permitted(), 5 * S) == []
    (change,) = engine.update_bay(permitted(), 10 * S)
    assert change.after is AlarmState.NORMAL
