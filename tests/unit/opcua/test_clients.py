"""What clients that others wrote read of the server, and what they may do."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from asyncua import ua

from gateway.alarms.records import Alarm, AlarmSummary, OperatorAction
from gateway.alarms.states import AlarmEvent, AlarmState
from gateway.core.events import Event, EventKind
from gateway.core.plc import Acquired, TriggerOutcome, TriggerPhase, Writer
from gateway.core.readings import Quality, RangeReading
from gateway.core.state import Reason
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.durations import NS_PER_S
from gateway.values.gateway_values import GatewayFacts
from gateway.web.ipc.messages import NumberedEvent, SystemStatus, TriggerMeasurement
from gateway.web.server.gateway_client import RefusedError
from tests.opcua_clients import PROGRAMS, Client, CommandError
from tests.plant_certs import Plant
from tests.unit.opcua.server import Main, OpcuaServer, good

pytestmark = [pytest.mark.one_interpreter, pytest.mark.xdist_group("opcua")]

UNCERTAIN_SUBSTITUTE, BAD_NO_COMMUNICATION, BAD_ACCESS = 0x40910000, 0x80310000, 0x801F0000
BAD_OUT_OF_RANGE, BAD_NO_DATA, BAD_STATE, BAD_EVENT_ID = 0x803C0000, 0x80B10000, 0x80AF0000, 0x809A0000
ALARM_CONDITION = "i=2915"
CAMERA_DOWN, ACKNOWLEDGE = "ns=2;s=Alarms.bay1.camera_down", "i=9111"


def nodes(*names: str) -> list[str]:
    return [f"ns=2;s=bay1.{name}" for name in names]


@dataclass
class World:
    plant: Plant
    server: OpcuaServer
    folder: Path

    def connect(self, name: str, who: str = "scada") -> Client:
        """Raises CommandError."""
        client = Client(name)
        files = self.plant.folder
        try:
            client(
                "connect",
                url=self.server.url,
                cert=str(files.certificate_path(who)),
                key=str(files.key_path(who)),
                ca=str(files.certificate_path("ca")),
                crl=str(files.crl_path),
                uri=f"urn:{who}",
                **({"folder": str(self.folder / "pki")} if name == "node-opcua" else {}),
            )
        except CommandError:
            client.close()
            raise
        return client


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    folder = tmp_path_factory.mktemp("opcua")
    plant = Plant(folder / "certs", kind="rsa")
    plant.opcua("opcua")
    plant.opcua("scada", "viewer")
    plant.opcua("mes", "operator")
    plant.opcua("idle", "cleaner")
    files = plant.folder
    opcua = {
        "cert": str(files.certificate_path("opcua")),
        "key": str(files.key_path("opcua")),
        "ca": str(files.certificate_path("ca")),
        "crl": str(files.crl_path),
        "writes": True,
    }
    server = OpcuaServer({"opcua": opcua, "modbus": {"writes": True, "plc_addresses": ["127.0.0.1"]}})
    yield World(plant, server, folder)
    server.close()


@pytest.fixture(params=list(PROGRAMS))
def client(world: World, request: pytest.FixtureRequest) -> Iterator[Client]:
    made = world.connect(request.param)
    yield made
    made.close()


@pytest.fixture(params=list(PROGRAMS))
def operator(world: World, request: pytest.FixtureRequest) -> Iterator[Client]:
    made = world.connect(request.param, "mes")
    yield made
    made.close()


def test_values_have_their_numbers_codes_and_times(world: World, client: Client) -> None:
    now_ns = world.server.main.clock.now_ns()
    state = good(now_ns)
    world.server.show(state)
    read = client("read", nodes=nodes("stop", "may_move", "reason", "radius_px", "distance_mm", "vision.quality"))
    assert [(one["value"], one["status"]) for one in read] == [
        (False, 0), (True, 0), (int(Reason.NONE), 0), (181.5, 0), (412.5, 0), (int(Quality.GOOD), 0),
    ]  # fmt: skip
    assert all(one["at"].startswith("20") for one in read)

    world.server.show(replace(state, range=RangeReading(now_ns - 2 * NS_PER_S, Quality.TOO_FAR)))
    distance, quality = client("read", nodes=nodes("distance_mm", "range.quality"))
    assert (distance["value"], distance["status"]) == (None, BAD_OUT_OF_RANGE)
    assert quality["value"] == int(Quality.TOO_FAR)
    assert client("read", nodes=nodes("scale.px_mm"))[0]["status"] == BAD_NO_DATA


def test_the_gateway_tells_its_configuration_certificates_and_alarms(world: World, client: Client) -> None:
    main = world.server.main
    alarms = AlarmSummary(
        alarms=(Alarm("bay1.camera_down", "camera_down", "bay1", AlarmState.UNACKNOWLEDGED, active=True),)
    )
    facts = GatewayFacts("a" * 64, "", certificate_days={"opcua": 12, "hmi": 30})
    main.links, main.links_ns = SystemStatus(alarms=alarms, facts=facts), main.clock.now_ns()
    world.server.show(good(main.clock.now_ns()))
    names = ("configuration.in_force", "configuration.reviewed", "certificate_days", "alarms.high", "alarms.low")
    wanted = [f"ns=2;s=Gateway.{name}" for name in names]
    read = client("read", nodes=wanted)
    assert [one["value"] for one in read] == ["a" * 64, None, 12, 1, 0]
    assert [one["status"] for one in read] == [0, BAD_NO_DATA, 0, 0, 0]

    main.links_known = False
    world.server.show()
    assert {one["status"] for one in client("read", nodes=wanted)} == {BAD_NO_COMMUNICATION}
    main.links, main.links_known, main.links_ns = SystemStatus(), True, main.clock.now_ns()
    world.server.show()


def test_a_silent_gateway_shows_stop_as_a_substitute_and_nothing_else(world: World, client: Client) -> None:
    now_ns = world.server.main.clock.now_ns()
    world.server.show(replace(good(now_ns), valid_until_ns=now_ns - 5 * NS_PER_S))

    read = client("read", nodes=nodes("stop", "may_move", "in_place", "reason"))
    assert [(one["value"], one["status"]) for one in read] == [
        (True, UNCERTAIN_SUBSTITUTE),
        (False, UNCERTAIN_SUBSTITUTE),
        (False, UNCERTAIN_SUBSTITUTE),
        (int(Reason.GATEWAY_FAULT), UNCERTAIN_SUBSTITUTE),
    ]
    others = client("read", nodes=nodes("distance_mm", "radius_px", "heartbeat", "vision.quality", "phase"))
    assert [(one["value"], one["status"]) for one in others] == [(None, BAD_NO_COMMUNICATION)] * 5


def test_a_viewer_may_neither_write_trigger_nor_acknowledge(world: World, client: Client) -> None:
    world.server.show(good(world.server.main.clock.now_ns()))
    assert client("write", node="ns=2;s=bay1.stop", value=False) == BAD_ACCESS
    assert client("call", node="ns=2;s=bay1", method="ns=2;s=bay1.Trigger")["status"] == BAD_ACCESS
    answer = client("call", node=CAMERA_DOWN, method=ACKNOWLEDGE, event="00", comment="seen")
    assert answer["status"] == BAD_ACCESS
    assert world.server.main.commands == []


def test_a_value_cannot_be_written_by_an_operator_either(operator: Client) -> None:
    assert operator("write", node="ns=2;s=bay1.stop", value=False) == BAD_ACCESS


def test_an_operator_triggers_a_measurement(world: World, operator: Client) -> None:
    main = world.server.main
    state = good(main.clock.now_ns())
    running = replace(state, plc=replace(state.plc, phase=TriggerPhase.ACQUIRING, acquisition=7))
    found = Acquired(7, state.t_ns, TriggerOutcome.IN_PLACE, 320.25, 240.5, 181.5, None)
    held = replace(state, plc=replace(running.plc, phase=TriggerPhase.VALID, result=found))
    main.after = [running, held]

    answer = operator("call", node="ns=2;s=bay1", method="ns=2;s=bay1.Trigger")

    assert answer == {"status": 0, "outputs": [7, "IN_PLACE", 181.5, None]}
    ((action, who),) = main.commands
    assert (action, who) == (TriggerMeasurement("bay1"), Writer("127.0.0.1", "mes", "operator"))
    main.commands.clear()

    main.refusal = RefusedError("the handshake block was not free")
    assert operator("call", node="ns=2;s=bay1", method="ns=2;s=bay1.Trigger")["status"] == BAD_STATE
    main.refusal = None
    main.commands.clear()


def test_an_alarm_is_a_condition_that_an_operator_acknowledges(world: World, operator: Client) -> None:
    main = quiet(world)
    operator("subscribe")
    alarm = Alarm(
        "bay1.camera_down", "camera_down", "bay1", AlarmState.UNACKNOWLEDGED, True, main.clock.now_ns(), occurrences=3
    )
    main.links = SystemStatus(alarms=AlarmSummary((alarm,)))
    world.server.show(good(main.clock.now_ns()))

    (raised,) = events_of(operator, 1)
    assert raised["SourceName"] == "bay1"
    assert raised["Severity"] == 800
    assert operator("call", node=CAMERA_DOWN, method=ACKNOWLEDGE, event="00", comment="")["status"] == BAD_EVENT_ID

    answer = operator("call", node=CAMERA_DOWN, method=ACKNOWLEDGE, event=raised["EventId"], comment="on my way")
    assert answer["status"] == 0
    ((action, _),) = main.commands
    assert action == OperatorAction("bay1.camera_down", AlarmEvent.ACKNOWLEDGE, "mes", "on my way", occurrence=3)
    main.commands.clear()

    main.links = SystemStatus()
    world.server.show()
    (ended,) = events_of(operator, 1)
    assert ended["SourceName"] == "bay1"
    if "Retain" in ended:  # the fields that node-opcua has asked for
        assert (raised["ActiveState.Id"], raised["AckedState.Id"], raised["Retain"]) == (True, False, True)
        assert (ended["ActiveState.Id"], ended["AckedState.Id"], ended["Retain"]) == (False, True, False)


def test_a_visit_that_is_over_is_an_event(world: World, client: Client) -> None:
    main = quiet(world)
    client("subscribe")
    state = good(main.clock.now_ns())
    summary = VisitSummary(1_700_000_000_000, 61.5, VisitEnd.CLEAR, times_in_place=2)
    event = Event(EventKind.VISIT, "bay1", state.t_ns, state, summary=summary)
    main.events.append(NumberedEvent(len(main.events) + 1, event))
    world.server.show(state)

    (seen,) = events_of(client, 1)
    assert (seen["SourceName"], seen["Severity"], seen["Message"]) == ("bay1", 100, summary.text)
    if "end" in seen:
        assert (seen["Bay"], seen["end"], seen["times_in_place"]) == ("bay1", "clear", 2)


def test_the_last_hour_can_be_read(world: World, client: Client) -> None:
    now_ns = world.server.main.clock.now_ns()
    for n, stop in enumerate((True, False, True)):
        state = good(now_ns + n * NS_PER_S)
        world.server.show(
            replace(state, stop=stop, may_move=not stop, reason=Reason.TARGET_REACHED if stop else Reason.NONE)
        )
    read = client("history", node="ns=2;s=bay1.stop")
    assert [one["value"] for one in read][-3:] == [True, False, True]
    assert [one["status"] for one in read][-3:] == [0, 0, 0]


def test_visits_and_alarms_of_before_can_be_read(world: World) -> None:
    """By a client that was not there. The wheel of open62541 can't ask for them."""
    main = quiet(world)
    state = good(main.clock.now_ns())
    alarm = Alarm("bay1.camera_down", "camera_down", "bay1", AlarmState.UNACKNOWLEDGED, True, state.t_ns)
    main.links = SystemStatus(alarms=AlarmSummary((alarm,)))
    world.server.show(state)
    summary = VisitSummary(1_700_000_000_000, 61.5, VisitEnd.CLEAR, times_in_place=9)
    event = Event(EventKind.VISIT, "bay1", state.t_ns + NS_PER_S, state, summary=summary)
    main.events.append(NumberedEvent(len(main.events) + 1, event))
    main.links = SystemStatus()
    world.server.show()

    visits = str(world.server.served._conditions._visit.nodeid.to_string())
    names = ["SourceName", "Severity", "ActiveState.Id", "2:times_in_place", "data_types"]
    client = world.connect("node-opcua")
    try:
        alarms, visit = (client("events", names=names, kind=kind)[-2:] for kind in (ALARM_CONDITION, visits))
    finally:
        client.close()
    assert [list(one.values()) for one in alarms] == [["bay1", 800, on, None, None] for on in (True, False)]
    assert list(visit[-1].values()) == ["bay1", 100, None, 9, None]
    server = world.server.served.server.get_node("i=2253")
    assert world.server.run(server.read_event_notifier()) == {
        ua.EventNotifier.SubscribeToEvents,
        ua.EventNotifier.HistoryRead,
    }


def test_a_certificate_without_a_role_is_refused(world: World) -> None:
    """What else is, without a client: test_access.py. node-opcua tries again for minutes."""
    sessions = world.server.served.server.iserver
    before = sessions.now(4840).certificates_refused
    with pytest.raises(CommandError) as refused:
        world.connect("open62541", "idle")
    assert refused.value.code == BAD_ACCESS
    assert sessions.now(4840).certificates_refused > before


def quiet(world: World) -> Main:
    """Without an alarm."""
    main = world.server.main
    main.links = SystemStatus()
    world.server.show(good(main.clock.now_ns()))
    return main


def events_of(client: Client, count: int) -> list[dict[str, Any]]:
    """Of the bay; waits for them."""
    found: list[dict[str, Any]] = []
    for _ in range(300):
        found += [event for event in client("seen") if event["SourceName"] == "bay1"]
        if len(found) >= count:
            break
        time.sleep(0.05)
    return found
