"""The alarms as sinks get them: of now, or marked as not evaluated."""

from dataclasses import replace

from gateway.alarms.definition import GatewayConditions
from gateway.alarms.monitor import AlarmMonitor
from gateway.alarms.records import OperatorAction
from gateway.alarms.states import AlarmEvent
from gateway.alarms.table import ALARM_DEFINITIONS
from gateway.config import BayConfig
from gateway.core.fusion import initial
from gateway.core.readings import Quality, VisionReading
from gateway.core.state import Reason, StateVector
from gateway.sinks.contract import AlarmStep, BayAlarms, ShownAlarm
from gateway.web.host.shown_alarms import ShownAlarms, step_of

S = 1_000_000_000


class Clock:
    """Only what the monitor reads."""

    def __init__(self) -> None:
        self.ns = 100 * S

    def now_ns(self) -> int:
        return self.ns


class Plant:
    def __init__(self) -> None:
        self.clock = Clock()
        self.state: StateVector = replace(
            initial("bay1", 5), vision=VisionReading(5, Quality.LINK_DOWN, detail="cable"), reason=Reason.CAMERA_DOWN
        )
        self.conditions = GatewayConditions(sinks_connected={"mqtt": False})
        self.steps: list[AlarmStep] = []
        self.monitor = AlarmMonitor(
            {"bay1": BayConfig()},
            lambda bay: self.state,
            self.clock,  # type: ignore[arg-type]
            lambda change: self.steps.append(step_of(change)),
        )
        self.shown = ShownAlarms(self.monitor)

    def scan(self, seconds: int) -> BayAlarms:
        for _ in range(seconds):
            self.clock.ns += S
            self.monitor.scan(self.conditions)
        return self.now()

    def now(self) -> BayAlarms:
        return self.shown("bay1", self.clock.ns)

    def act(self, event: AlarmEvent, minutes: float | None = None) -> None:
        self.monitor.act(OperatorAction("bay1.camera_down", event, "joe", "seen", minutes))


def camera(alarms: BayAlarms) -> ShownAlarm:
    (found,) = [alarm for alarm in alarms.bay if alarm.kind == "camera_down"]
    return found


def test_each_change_is_a_step_with_who_made_it() -> None:
    plant = Plant()
    plant.scan(5)
    plant.act(AlarmEvent.ACKNOWLEDGE)
    steps = [step for step in plant.steps if step.kind == "camera_down"]
    same = ("bay1.camera_down", "camera_down", "bay1", "Camera down", "high")
    assert steps == [
        AlarmStep(steps[0].number, steps[0].t_ns, *same, "occurs", "normal", "unacknowledged", "cable"),
        AlarmStep(
            steps[0].number + 1, plant.clock.ns, *same,
            "acknowledge", "unacknowledged", "acknowledged", "cable", "joe", "seen",
        ),
    ]  # fmt: skip
    assert 100 * S < steps[0].t_ns < plant.clock.ns


def test_an_alarm_is_shown_as_it_is_raised_acknowledged_shelved_and_returns() -> None:
    plant = Plant()
    assert not plant.now().evaluated
    assert {alarm.kind for alarm in (*plant.now().bay, *plant.now().gateway)} == set(ALARM_DEFINITIONS)

    raised = plant.scan(5)
    assert (raised.unacknowledged, raised.active, raised.highest_priority) == (1, 1, "high")
    found = camera(raised)
    assert raised.bay[0] is found, "the most important first"
    assert (found.state, found.priority, found.title, found.detail) == (
        "unacknowledged",
        "high",
        "Camera down",
        "cable",
    )
    assert (found.occurrences, found.unacknowledged, found.active) == (1, True, True)

    plant.act(AlarmEvent.ACKNOWLEDGE)
    found = camera(plant.now())
    assert (found.state, found.unacknowledged, found.active, found.who, found.note) == (
        "acknowledged", False, True, "joe", "seen",
    )  # fmt: skip
    plant.act(AlarmEvent.SHELVE, 10)
    found = camera(plant.now())
    assert (found.state, found.shelved_until_ns) == ("shelved", plant.clock.ns + 600 * S)

    plant.state = replace(plant.state, vision=VisionReading(6, Quality.NO_TARGET), reason=Reason.NO_TARGET)
    assert camera(plant.scan(10)).active is False
    plant.act(AlarmEvent.UNSHELVE)
    assert camera(plant.now()).normal
    assert plant.now().highest_priority is None


def test_the_gateways_own_alarms_are_shown_with_those_of_each_bay() -> None:
    plant = Plant()
    lost = next(alarm for alarm in plant.scan(32).gateway if alarm.kind == "broker_lost")
    assert (lost.state, lost.priority) == ("unacknowledged", "medium")


def test_alarms_that_nothing_evaluates_any_more_are_marked_so() -> None:
    plant = Plant()
    assert plant.scan(5).evaluated
    plant.clock.ns += 5 * S
    assert plant.now().evaluated
    plant.clock.ns += 1
    assert not plant.now().evaluated
    assert plant.scan(1).evaluated
