"""Alarms: the standard's diagram and nothing else, delays that keep them from chattering, and people's actions."""

from dataclasses import replace

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from gateway.alarms import table
from gateway.alarms.bay_alarms import BAY_ALARMS
from gateway.alarms.definition import GatewayConditions, Priority
from gateway.alarms.engine import HISTORY, AlarmEngine
from gateway.alarms.gateway_alarms import GATEWAY_ALARMS
from gateway.alarms.records import (
    MAX_NOTE,
    MAX_SHELVE_MIN,
    OPERATOR_EVENTS,
    ActionOutcome,
    ActionReply,
    Alarm,
    AlarmChange,
    OperatorAction,
)
from gateway.alarms.states import AlarmEvent, AlarmState, next_state
from gateway.config import BayConfig
from gateway.core.beacon import Beacon, BeaconStatus
from gateway.core.detection import Circle
from gateway.core.marker_wear import MarkerWear, WearTrend
from gateway.core.plc import Handshake, PlcLink
from gateway.core.readings import (
    AgeProof,
    CameraExposure,
    ExposureState,
    PictureFault,
    PictureHealth,
    Quality,
    RangeReading,
    RelayOutput,
    RelayStatus,
    VisionReading,
)  # fmt: skip
from gateway.core.scale import MarkerScale, ScaleSample
from gateway.core.state import (
    FunctionCheck,
    FusionMemory,
    Moved,
    Reason,
    ReferencePosition,
    StateVector,
    TruckPosition,
    Visit,
)
from tests.examples import examples
from tests.permitted import permitted

S = 1_000_000_000
T0 = 1_000 * S
BAY = BayConfig()
N, U, A, R = AlarmState.NORMAL, AlarmState.UNACKNOWLEDGED, AlarmState.ACKNOWLEDGED, AlarmState.RETURNED
LU, LA = AlarmState.LATCHED_UNACKNOWLEDGED, AlarmState.LATCHED_ACKNOWLEDGED
SH, SU, OUT = AlarmState.SHELVED, AlarmState.SUPPRESSED, AlarmState.OUT_OF_SERVICE

# ISA-18.2's diagram, written down by hand: (from, what happens, to), of alarms that latch and of those that don't.
BOTH = {
    (N, "occurs", U), (R, "occurs", U), (U, "acknowledge", A), (R, "acknowledge", N),
    *((shown, "shelve", SH) for shown in (N, U, A, R)), *((shown, "suppress", SU) for shown in (N, U, A, R)),
    *((shown, "remove", OUT) for shown in (N, U, A, R, SH, SU)),
    (SH, "unshelve", N), (SH, "unshelve", U), (SU, "unsuppress", N), (OUT, "restore", N), (OUT, "restore", U),
}  # fmt: skip
PLAIN = {(U, "returns", R), (A, "returns", N)}
LATCHING = {
    (U, "returns", LU), (A, "returns", LA), (LU, "acknowledge", LA), (LA, "reset", N), (LU, "occurs", U),
    (LA, "occurs", U), *((shown, event, hidden) for shown in (LU, LA) for event, hidden in
                         (("shelve", SH), ("suppress", SU), ("remove", OUT))),
}  # fmt: skip
# Only a latching alarm gets into LU and LA, so its arrows from there are asked of latching alarms alone.
NOWHERE_ELSE = {(source, event, target) for source, event, target in LATCHING if source in (LU, LA)}


@pytest.mark.parametrize("latching", [False, True])
def test_the_machine_has_every_arrow_of_the_diagram_and_no_other(latching: bool) -> None:
    found = {
        (source, event.value, target)
        for source in AlarmState
        for event in AlarmEvent
        for active in (False, True)
        if (target := next_state(source, event, latching=latching, active=active)) is not None
    }
    assert found == (BOTH | LATCHING if latching else BOTH | PLAIN | NOWHERE_ELSE)


def test_a_hidden_alarm_returns_by_whether_its_cause_holds() -> None:
    for hidden, event in ((SH, AlarmEvent.UNSHELVE), (OUT, AlarmEvent.RESTORE)):
        assert next_state(hidden, event, latching=False, active=True) is U
        assert next_state(hidden, event, latching=False, active=False) is N


def new_engine() -> AlarmEngine:
    return AlarmEngine({"bay1": BAY, "bay2": BAY})


def camera_down() -> AlarmEngine:
    """With bay1's camera lost at 0 s, and the alarm announced at 2 s."""
    alarms = new_engine()
    look(alarms, DOWN, 0, 2)
    return alarms


def camera(quality: Quality, detail: str = "", bay: str = "bay1") -> StateVector:
    return permitted(bay=bay, vision=VisionReading(4_960_000_000, quality, detail=detail))


DOWN = camera(Quality.LINK_DOWN)


def look(alarms: AlarmEngine, state: StateVector, *seconds: float) -> list[AlarmChange]:
    """Look at these moments; what changed."""
    return [change for second in seconds for change in alarms.update_bay(state, T0 + round(second * S))]


def reached(changes: list[AlarmChange]) -> list[tuple[str, str]]:
    return [(change.id, change.after.value) for change in changes]


class TestDelays:
    def test_a_cause_is_announced_after_its_on_delay_and_not_before(self) -> None:
        alarms = new_engine()
        assert look(alarms, DOWN, 0, 1, 1.999) == []
        (change,) = look(alarms, camera(Quality.LINK_DOWN, "no such device"), 2)
        assert (change.id, change.before, change.after, change.event) == ("bay1.camera_down", N, U, AlarmEvent.OCCURS)
        assert (change.detail, change.number, change.t_ns) == ("no such device", 1, T0 + 2 * S)
        assert look(alarms, DOWN, 3, 60) == []

    def test_a_cause_that_flickers_is_never_announced(self) -> None:
        alarms = new_engine()
        for second in range(0, 100, 2):
            assert look(alarms, DOWN, second, second + 1) == []
            assert look(alarms, permitted(), second + 1.5) == []

    def test_a_cause_that_flickers_away_does_not_return(self) -> None:
        alarms = camera_down()
        for second in range(10, 100, 6):
            assert look(alarms, permitted(), second, second + 4.9) == []
            assert look(alarms, DOWN, second + 5) == []
        assert reached(look(alarms, permitted(), 200, 205)) == [("bay1.camera_down", "returned")]

    def test_another_fault_of_the_same_sensor_is_another_alarm(self) -> None:
        alarms = camera_down()
        changes = look(alarms, camera(Quality.PROCESS_FAULT), 10, 12, 15)
        assert reached(changes) == [("bay1.vision_fault", "unacknowledged"), ("bay1.camera_down", "returned")]

    def test_bays_do_not_share_anything(self) -> None:
        alarms = camera_down()
        look(alarms, permitted(bay="bay2"), 0, 2)
        assert [alarm.id for alarm in alarms.summary().alarms] == ["bay1.camera_down"]


def no_echo(radius_px: float, quality: Quality = Quality.NO_ECHO) -> StateVector:
    return permitted(
        vision=VisionReading(4_960_000_000, Quality.GOOD, Circle(1, 1, radius_px)),
        range=RangeReading(4_980_000_000, quality),
    )


def picture(*faults: PictureFault, quality: Quality = Quality.NO_TARGET) -> StateVector:
    health = PictureHealth(0.012, 0.0, 0.25, 0.19, 0.71, 12.4, status=sum(1 << fault for fault in faults))
    return permitted(
        vision=VisionReading(4_960_000_000, quality, picture=health), range=RangeReading(1, Quality.NO_ECHO)
    )


def unproven(quality: Quality) -> StateVector:
    reading = VisionReading(4_960_000_000, quality, age_proof=AgeProof.UNPROVEN)
    return permitted(vision=reading, range=RangeReading(1, Quality.NO_ECHO))


def exposed(state: ExposureState) -> StateVector:
    reading = VisionReading(4_960_000_000, Quality.NO_TARGET, exposure=CameraExposure(state, 8.0))
    return permitted(vision=reading, range=RangeReading(1, Quality.NO_ECHO))


def ranger(quality: Quality) -> StateVector:
    return permitted(range=RangeReading(4_980_000_000, quality))


PLACE = TruckPosition(280.0, Circle(320, 240, 200.0))
SCALE = MarkerScale(56_000.0, 280.0, 0.01, 12, ScaleSample(0, 224.0, 280.0), jump=0.12)
LONG = (0, 40 * 60)
UNPROVEN = replace(
    camera(Quality.STALE),
    memory=FusionMemory(beacon=Beacon(BeaconStatus.LOST, unproven=True)),
    reason=Reason.BEACON_LOST,
)
CAUSES = {
    "control_dead": permitted(reason=Reason.GATEWAY_FAULT),
    "plc_lost": permitted(plc=replace(permitted().plc, missed=True)),
    "camera_down": DOWN,
    "camera_stale": camera(Quality.STALE),
    "camera_age_unproven": unproven(Quality.NO_TARGET),
    "beacon_lost": UNPROVEN,
    "vision_fault": camera(Quality.PROCESS_FAULT),
    "ranger_down": ranger(Quality.LINK_DOWN),
    "ranger_stale": ranger(Quality.STALE),
    "ranger_stuck": ranger(Quality.STUCK),
    "ranger_version": ranger(Quality.WRONG_VERSION),
    "relay_fault": permitted(
        range=RangeReading(4_980_000_000, Quality.GOOD, 900.0, relay=RelayStatus(RelayOutput.NONE, pins=1, fault=True))
    ),
    "ranger_no_echo": no_echo(100.0),
    "ranger_unstable": ranger(Quality.UNSTABLE),
    "ranger_too_near": ranger(Quality.TOO_NEAR),
    "temperature_lost": permitted(range=RangeReading(4_980_000_000, Quality.GOOD, 900.0, temperature_lost=True)),
    "sensors_disagree": permitted(memory=FusionMemory(disagree=True)),
    "picture_blind": picture(PictureFault.DARK),
    "picture_poor": picture(PictureFault.DUSTY),
    "camera_moved": picture(PictureFault.SHIFTED),
    "exposure_uncontrolled": exposed(ExposureState.IGNORED),
    "maintenance": permitted(memory=FusionMemory(restarts=1, restarted_ns=4_000_000_000)),
    "function_check_forgotten": permitted(function_check=FunctionCheck.MAY_MOVE_KEPT),
    "truck_rolling": permitted(
        visit=Visit(
            in_place=True,
            place=PLACE,
            reference=ReferencePosition(280.0, rolling_since_ns=1, sensor="range", covered=True),
        )
    ),
    "truck_moved": permitted(visit=Visit(place=PLACE, moved=Moved.DISTANCE, moved_covered=True)),
    "in_place_lost": permitted(d=None, visit=Visit(place=PLACE, ended="held for too long")),
    "scale_changed": permitted(memory=FusionMemory(scale=SCALE)),
    "marker_worn": permitted(marker=MarkerWear(12, WearTrend(0.82, -0.015, 8.0), WearTrend(1.2), worn=True)),
}
NO_ALARM = {
    "exposure in order": exposed(ExposureState.CONTROLLED),
    "exposure at its end": exposed(ExposureState.TOO_DARK),
    "on its way": permitted(),
    "picture in order": picture(),
    "dark, but the frames are old": picture(PictureFault.DARK, quality=Quality.WAITING),
    "empty bay": permitted(
        vision=VisionReading(1, Quality.NO_TARGET), range=RangeReading(1, Quality.NO_ECHO), reason=Reason.NO_TARGET
    ),
    "truck in place": permitted(d=True, stop=True, may_move=False, reason=Reason.TARGET_REACHED),
    "starting": StateVector("bay1"),
    "coasting": camera(Quality.COASTED),
    "truck far away": no_echo(20.0),
    "truck far away, by the ranger": no_echo(20.0, Quality.TOO_FAR),
    "stop latched": permitted(memory=FusionMemory(latched=True), stop=True, reason=Reason.STOP_LATCHED),
    "in place": permitted(d=True, stop=True, may_move=False, visit=Visit(in_place=True, place=PLACE)),
    "held": permitted(d=None, stop=True, may_move=False, visit=Visit(in_place=True, place=PLACE, covered_since_ns=1)),
    "a truck begins to leave where nobody can release it": permitted(
        visit=Visit(in_place=True, place=PLACE, reference=ReferencePosition(280.0, rolling_since_ns=1, sensor="vision"))
    ),
    "a truck leaves where nobody can release it": permitted(visit=Visit(place=PLACE, moved=Moved.DISTANCE)),
    "released": permitted(d=True, plc=Handshake(link=PlcLink.ALIVE), visit=Visit(place=PLACE, released=True)),
    "gone by both sensors": permitted(d=False, visit=Visit(place=PLACE, ended="D = 0")),
    "learned": permitted(memory=FusionMemory(scale=replace(SCALE, jump=None))),
}


class TestTheTable:
    @pytest.mark.parametrize("kind", [kind.id for kind in BAY_ALARMS])
    def test_each_cause_raises_its_alarm_and_no_other(self, kind: str) -> None:
        changes = look(new_engine(), CAUSES[kind], *LONG)
        assert [change.id for change in changes if change.after is U] == [f"bay1.{kind}"]
        assert {change.after for change in changes} <= {U, SU}

    @pytest.mark.parametrize("state", NO_ALARM.values(), ids=NO_ALARM.keys())
    def test_what_needs_no_action_is_no_alarm(self, state: StateVector) -> None:
        assert look(new_engine(), state, *LONG, 3 * 3600) == []

    @pytest.mark.parametrize(
        ("kind", "conditions"),
        [
            ("plc_not_reading", GatewayConditions(plc_reads=False)),
            ("modbus_not_served", GatewayConditions(modbus_fault="this machine does not have that address (yet)")),
            ("broker_lost", GatewayConditions(sinks_connected={"mqtt": False})),
            ("sparkplug_lost", GatewayConditions(sinks_connected={"sparkplug": False})),
            ("client_id_shared", GatewayConditions(sink_alarms={"client_id_shared": "our client id gw"})),
            ("certificate_expiring", GatewayConditions(sink_alarms={"certificate_expiring": "ends soon"})),
            ("sink_lost", GatewayConditions(sinks_connected={"mqtt": True, "historian": False})),
            ("events_lost", GatewayConditions(events_lost=1)),
            ("event_store_fault", GatewayConditions(store_fault="disk full")),
            ("task_crashed", GatewayConditions(crashes=1)),
            ("configuration_not_loaded", GatewayConditions(config_fault="g.toml:7: hmi.port = -1: ...")),
            ("recorder_fault", GatewayConditions(recorder_fault="no space left")),
            ("records_lost", GatewayConditions(records_lost=5)),
            ("pictures_not_kept", GatewayConditions(pictures_not_kept=3, pictures_detail="bay1: 3 of 11")),
            ("index_fault", GatewayConditions(index_fault="index.sqlite: database is locked")),
            ("bay_file_fault", GatewayConditions(bay_file_fault="no space left")),
            ("bay_file_damaged", GatewayConditions(bay_file_damaged="bay1: cut")),
        ],
    )
    def test_each_condition_raises_its_alarm_and_no_other(self, kind: str, conditions: GatewayConditions) -> None:
        alarms = new_engine()
        changes = [*alarms.update_gateway(conditions, T0), *alarms.update_gateway(conditions, T0 + 181 * S)]
        assert reached(changes) == [(kind, "unacknowledged")]

    def test_an_index_that_catches_up_within_three_minutes_is_no_alarm(self) -> None:
        alarms = new_engine()
        locked = GatewayConditions(index_fault="index.sqlite: database is locked")
        seconds = {0: locked, 60: locked, 120: locked, 179: locked, 185: GatewayConditions(), 360: locked, 530: locked}
        assert [alarms.update_gateway(now, T0 + second * S) for second, now in seconds.items()] == [[]] * 7

    def test_a_gateway_without_broker_and_known_plcs_has_no_alarm(self) -> None:
        alarms = new_engine()
        assert [alarms.update_gateway(GatewayConditions(), T0 + second * S) for second in (0, 3600)] == [[], []]

    def test_every_picture_fault_has_one_alarm_with_its_figure(self) -> None:
        details = {
            PictureFault.DARK: ("bay1.picture_blind", "dark (brightness 1.2%)"),
            PictureFault.BRIGHT: ("bay1.picture_blind", "bright (0% burnt out)"),
            PictureFault.FLAT: ("bay1.picture_blind", "flat (contrast 25.0%)"),
            PictureFault.BLURRED: ("bay1.picture_poor", "blurred (sharpness 19%)"),
            PictureFault.DUSTY: ("bay1.picture_poor", "dusty (veil 71%)"),
            PictureFault.SHIFTED: ("bay1.camera_moved", "shifted (shift 12 px)"),
        }
        assert set(details) == set(PictureFault)
        for fault, (kind, detail) in details.items():
            changes = look(new_engine(), picture(fault), *LONG)
            assert [(change.id, change.detail) for change in changes] == [(kind, detail)]

    def test_the_marker_s_distance_is_the_cross_check_s_where_there_is_one(self) -> None:
        near = replace(no_echo(20.0), z_vision_mm=2000.0)
        far = replace(no_echo(100.0), z_vision_mm=3000.0)
        assert reached(look(new_engine(), near, *LONG)) == [("bay1.ranger_no_echo", "unacknowledged")]
        assert look(new_engine(), far, *LONG) == []

    def test_a_dead_camera_is_its_own_alarm_until_it_is_back(self) -> None:
        lost = Visit(place=PLACE, ended="camera dead")
        alarms = new_engine()
        dead = replace(DOWN, d=None, visit=lost)
        assert reached(look(alarms, dead, 0, 10)) == [("bay1.camera_down", "unacknowledged")]
        covered = replace(camera(Quality.NO_TARGET), d=None, visit=lost)
        changes = [change for change in look(alarms, covered, 20, 25, 30) if change.after is U]
        assert [(change.id, change.detail) for change in changes] == [("bay1.in_place_lost", "camera dead")]

    def test_every_row_says_what_to_do(self) -> None:
        for kind in table.ALARM_DEFINITIONS.values():
            assert all((kind.title, kind.meaning, kind.consequence, kind.causes, kind.action)), kind.id
            assert kind.respond_min > 0, kind.id
            assert kind.off_delay_s > 0 or kind.on_delay_s > 60, f"{kind.id} would chatter"
        high = sum(kind.priority is Priority.HIGH for kind in table.ALARM_DEFINITIONS.values())
        assert high < len(table.ALARM_DEFINITIONS)


class TestSuppressedByDesign:
    def test_a_function_check_hides_the_sensors_alarms_and_shows_them_again(self) -> None:
        alarms = camera_down()
        checked = look(alarms, replace(DOWN, function_check=FunctionCheck.MAY_MOVE_OFF), 10)
        assert ("bay1.camera_down", "suppressed") in reached(checked)
        assert "bay1.plc_lost" not in dict(reached(checked))
        back = look(alarms, DOWN, 20)
        assert ("bay1.camera_down", "normal") in reached(back)
        assert look(alarms, DOWN, 21.9) == []
        assert reached(look(alarms, DOWN, 22)) == [("bay1.camera_down", "unacknowledged")]

    def test_while_permit_is_kept_nothing_is_hidden(self) -> None:
        state = replace(DOWN, function_check=FunctionCheck.MAY_MOVE_KEPT)
        assert reached(look(new_engine(), state, 0, 2)) == [("bay1.camera_down", "unacknowledged")]

    def test_a_dead_control_task_is_one_alarm_not_four(self) -> None:
        alarms = new_engine()
        dead = replace(camera(Quality.STALE), range=RangeReading(1, Quality.STALE), reason=Reason.GATEWAY_FAULT)
        changes = look(alarms, dead, 0, 1, 10)
        assert [change.id for change in changes if change.after is U] == ["bay1.control_dead"]
        # The first states after it still hold nothing new from the sensors.
        assert U not in [change.after for change in look(alarms, camera(Quality.STALE), 11, 12)]
        assert U not in [change.after for change in look(alarms, permitted(), 12.5, 60)]

    def test_nothing_is_announced_at_the_end(self) -> None:
        gone = replace(CAUSES["control_dead"], reason=Reason.SHUTDOWN, vision=VisionReading(1, Quality.STALE))
        assert U not in [change.after for change in look(new_engine(), gone, *LONG)]

    def test_shelving_that_ends_under_suppression_announces_nothing(self) -> None:
        alarms = camera_down()
        assert action(alarms, AlarmEvent.SHELVE, 3, minutes=1).outcome is ActionOutcome.DONE
        checked = replace(DOWN, function_check=FunctionCheck.MAY_MOVE_OFF)
        changes = look(alarms, checked, 62, 63)
        assert [state for name, state in reached(changes) if name == "bay1.camera_down"] == ["normal", "suppressed"]


def action(
    alarms: AlarmEngine, event: AlarmEvent, second: float, name: str = "bay1.camera_down", minutes: float | None = None,
    occurrence: int | None = None, note: str = "",
) -> ActionReply:  # fmt: skip
    asked = OperatorAction(name, event, "anna", note, minutes, occurrence)
    reply, changes = alarms.act(asked, T0 + round(second * S))
    assert bool(changes) == (reply.outcome is ActionOutcome.DONE) == (reply.why == "")
    return reply


def of(alarms: AlarmEngine, name: str = "bay1.camera_down") -> Alarm:
    alarm = alarms.alarm(name)
    assert alarm is not None
    return alarm


class TestOperatorActions:
    def test_an_acknowledged_alarm_ends_by_itself(self) -> None:
        alarms = camera_down()
        assert action(alarms, AlarmEvent.ACKNOWLEDGE, 3, note="gone to look").outcome is ActionOutcome.DONE
        alarm = of(alarms)
        assert (alarm.state, alarm.who, alarm.note, alarm.active) == (A, "anna", "gone to look", True)
        assert reached(look(alarms, permitted(), 10, 15)) == [("bay1.camera_down", "normal")]

    def test_an_unacknowledged_alarm_stays_until_it_is_acknowledged(self) -> None:
        alarms = camera_down()
        look(alarms, permitted(), 10, 15, 24 * 3600)
        assert of(alarms).state is R
        assert action(alarms, AlarmEvent.ACKNOWLEDGE, 24 * 3600 + 1).outcome is ActionOutcome.DONE
        assert of(alarms).state is N

    def test_a_new_occurrence_must_be_seen_anew(self) -> None:
        alarms = camera_down()
        look(alarms, permitted(), 10, 15)
        look(alarms, DOWN, 20, 22)
        assert of(alarms).occurrences == 2
        late = action(alarms, AlarmEvent.ACKNOWLEDGE, 23, occurrence=1)
        assert (late.outcome, of(alarms).state) == (ActionOutcome.REFUSED, U)
        assert "occurred again" in late.why
        assert action(alarms, AlarmEvent.ACKNOWLEDGE, 24, occurrence=2).outcome is ActionOutcome.DONE

    def test_a_latched_alarm_wants_acknowledgement_and_reset(self) -> None:
        alarms, lost = new_engine(), GatewayConditions(events_lost=3)
        alarms.update_gateway(lost, T0)
        assert of(alarms, "events_lost").detail == "3 since the start of the gateway"
        alarms.update_gateway(lost, T0 + S)
        alarms.update_gateway(lost, T0 + 61 * S)
        assert of(alarms, "events_lost").state is LU
        assert action(alarms, AlarmEvent.RESET, 62, "events_lost").outcome is ActionOutcome.REFUSED
        assert action(alarms, AlarmEvent.ACKNOWLEDGE, 63, "events_lost").outcome is ActionOutcome.DONE
        alarms.update_gateway(lost, T0 + 3600 * S)
        assert of(alarms, "events_lost").state is LA
        assert action(alarms, AlarmEvent.RESET, 3601, "events_lost").outcome is ActionOutcome.DONE
        assert alarms.summary().alarms == ()
        alarms.update_gateway(GatewayConditions(events_lost=4), T0 + 3602 * S)
        assert of(alarms, "events_lost").state is U

    def test_shelving_ends_by_itself_and_announces_what_is_still_active(self) -> None:
        alarms = camera_down()
        assert action(alarms, AlarmEvent.SHELVE, 3, minutes=10).outcome is ActionOutcome.DONE
        assert of(alarms).shelved_until_ns == T0 + 603 * S
        assert look(alarms, DOWN, 4, 602.9) == []
        assert reached(look(alarms, DOWN, 603)) == [("bay1.camera_down", "unacknowledged")]
        assert of(alarms).shelved_until_ns is None

    def test_a_shelved_alarm_whose_cause_has_gone_is_normal_afterwards(self) -> None:
        alarms = camera_down()
        action(alarms, AlarmEvent.SHELVE, 3, minutes=10)
        assert look(alarms, permitted(), 10, 15) == []
        assert reached(look(alarms, permitted(), 603)) == [("bay1.camera_down", "normal")]

    def test_out_of_service_lasts_until_it_is_ended(self) -> None:
        alarms = new_engine()
        assert action(alarms, AlarmEvent.REMOVE, 0, note="camera is away for repair").outcome is ActionOutcome.DONE
        assert look(alarms, DOWN, 1, 3, 365 * 86400) == []
        assert of(alarms).state is OUT
        assert action(alarms, AlarmEvent.RESTORE, 365 * 86400 + 1).outcome is ActionOutcome.DONE
        assert of(alarms).state is U

    @pytest.mark.parametrize("minutes", [None, 0.0, 0.9, MAX_SHELVE_MIN + 1, float("nan"), float("inf")])
    def test_shelving_is_limited(self, minutes: float | None) -> None:
        reply = action(new_engine(), AlarmEvent.SHELVE, 0, minutes=minutes)
        assert reply.outcome is ActionOutcome.INVALID
        assert str(MAX_SHELVE_MIN) in reply.why

    def test_what_is_not_for_people_or_not_there_is_refused(self) -> None:
        alarms = new_engine()
        assert action(alarms, AlarmEvent.ACKNOWLEDGE, 0, "bay9.camera_down").outcome is ActionOutcome.UNKNOWN
        assert action(alarms, AlarmEvent.RETURNS, 0).outcome is ActionOutcome.INVALID
        assert action(alarms, AlarmEvent.ACKNOWLEDGE, 0, note="x" * (MAX_NOTE + 1)).outcome is ActionOutcome.INVALID
        assert action(alarms, AlarmEvent.ACKNOWLEDGE, 0).outcome is ActionOutcome.REFUSED
        assert alarms.history() == ()


class TestSummaryAndHistory:
    def test_the_most_important_alarm_comes_first(self) -> None:
        alarms = new_engine()
        look(alarms, CAUSES["maintenance"], 0, 10)
        look(alarms, camera(Quality.LINK_DOWN, bay="bay2"), 20, 22)
        look(alarms, CAUSES["plc_lost"], 30, 31)
        action(alarms, AlarmEvent.ACKNOWLEDGE, 32, "bay1.plc_lost")
        standing = alarms.summary()
        assert [a.id for a in standing.alarms] == ["bay2.camera_down", "bay1.maintenance", "bay1.plc_lost"]
        assert dict(standing.counts)[U] == 2
        assert dict(standing.counts)[A] == 1
        assert sum(count for _, count in standing.counts) == 2 * len(BAY_ALARMS) + len(GATEWAY_ALARMS)
        assert dict(standing.announced) == {"maintenance": 1, "camera_down": 1, "plc_lost": 1}
        assert standing.newest_change == 4
        short = alarms.summary(most=1)
        assert ([a.id for a in short.alarms], short.omitted) == (["bay2.camera_down"], 2)

    def test_one_of_high_priority_that_is_over_and_not_acknowledged_precedes_an_active_low_one(self) -> None:
        alarms = new_engine()
        look(alarms, CAUSES["maintenance"], 0, 10)
        look(alarms, camera(Quality.LINK_DOWN, bay="bay2"), 20, 22)
        look(alarms, permitted(bay="bay2"), 30, 36)
        first, second = alarms.summary().alarms
        assert (first.id, first.state, first.active) == ("bay2.camera_down", AlarmState.RETURNED, False)
        assert (second.id, second.state) == ("bay1.maintenance", AlarmState.UNACKNOWLEDGED)

    @pytest.mark.one_interpreter
    def test_the_history_is_bounded_and_shows_what_it_has_lost(self) -> None:
        alarms = new_engine()
        for second in range(0, 20 * HISTORY, 20):
            look(alarms, DOWN, second, second + 2)
            look(alarms, permitted(), second + 3, second + 8)
        history = alarms.history()
        assert len(history) == HISTORY
        assert [change.number for change in history] == list(range(HISTORY + 1, 2 * HISTORY + 1))
        assert [change.number for change in alarms.history(after=2 * HISTORY - 2)] == [2 * HISTORY - 1, 2 * HISTORY]
        assert alarms.history(most=1) == history[:1]


class Life(RuleBasedStateMachine):
    """Whatever happens to one alarm in whatever order: only arrows of the diagram, and a cause is never lost.

    `camera_down`: 2 s on-delay, 5 s off-delay, not latching. The model keeps the raw cause and when it changed.
    """

    @initialize()
    def begin(self) -> None:
        self.alarms = new_engine()
        self.now_ns = T0
        self.cause = self.checked = False
        self.since_ns = T0  # the cause is as it is since then, as far as anybody looked
        self.unseen = False  # announced, and no person has done anything about it since
        self.number = 0

    def state(self) -> AlarmState:
        return of(self.alarms).state

    def take(self, changes: list[AlarmChange]) -> None:
        for change in changes:
            self.number += 1
            assert change.number == self.number
            if change.id != "bay1.camera_down":
                continue
            assert (change.before, change.event.value, change.after) in BOTH | PLAIN
            if change.event is AlarmEvent.OCCURS:
                assert self.cause
                assert self.now_ns - self.since_ns >= 2 * S
            if change.event is AlarmEvent.RETURNS:
                assert not self.cause
                assert self.now_ns - self.since_ns >= 5 * S
            if change.after is U:
                self.unseen = True
            elif change.event.value in {event.value for event in OPERATOR_EVENTS} or change.after in (SU, SH):
                self.unseen = False

    def look(self) -> None:
        function = FunctionCheck.MAY_MOVE_OFF if self.checked else FunctionCheck.OFF
        base = DOWN if self.cause else permitted()
        self.take(self.alarms.update_bay(replace(base, function_check=function), self.now_ns))

    @rule()
    def cause_changes(self) -> None:
        self.cause, self.since_ns = not self.cause, self.now_ns
        self.look()

    @rule(wait_s=st.sampled_from([0.1, 1.0, 2.0, 5.0, 61.0]))
    def time_passes(self, wait_s: float) -> None:
        self.now_ns += round(wait_s * S)
        self.look()

    @rule()
    def technician(self) -> None:
        self.checked = not self.checked
        self.look()

    @rule(event=st.sampled_from(list(AlarmEvent)), minutes=st.sampled_from([None, 1.0]))
    def person(self, event: AlarmEvent, minutes: float | None) -> None:
        before = of(self.alarms)
        wanted = next_state(before.state, event, latching=False, active=before.active)
        possible = wanted is not None and event in OPERATOR_EVENTS and (minutes or event is not AlarmEvent.SHELVE)
        asked = OperatorAction("bay1.camera_down", event, "anna", minutes=minutes)
        reply, changes = self.alarms.act(asked, self.now_ns)
        assert (reply.outcome is ActionOutcome.DONE) == bool(possible)
        assert self.state() is (wanted if possible else before.state)
        if event is AlarmEvent.ACKNOWLEDGE and possible:
            self.unseen = False
        self.take(changes)

    @precondition(lambda self: self.state() not in (SH, SU, OUT))
    @invariant()
    def an_announcement_waits_for_a_person(self) -> None:
        assert self.unseen == (self.state() in (U, R))

    @invariant()
    def a_lasting_cause_is_announced(self) -> None:
        if self.cause and not self.checked and self.now_ns - self.since_ns >= 65 * S:
            assert self.state() in (U, A, SH, OUT, SU, N)
            self.time_passes(2.0)  # whatever hid it just now: its on-delay
            assert self.state() in (U, A, SH, OUT)

    @invariant()
    def shelving_ends(self) -> None:
        alarm = of(self.alarms)
        if alarm.state is SH:
            assert alarm.shelved_until_ns is not None
            assert self.now_ns < alarm.shelved_until_ns <= self.now_ns + 60 * S
        else:
            assert alarm.shelved_until_ns is None


TestLife = Life.TestCase
TestLife.settings = settings(max_examples=examples(60), stateful_step_count=40, deadline=None)
