"""What the main process sends to the recorder, and when; without a recorder process."""

from dataclasses import replace
from pathlib import Path

import pytest

from gateway.alarms.records import AlarmChange
from gateway.alarms.states import AlarmEvent, AlarmState
from gateway.config import GatewayConfig, parse
from gateway.core import fusion
from gateway.core.events import Event, EventKind
from gateway.core.plc import Handshake, PlcLink
from gateway.core.state import StateVector
from gateway.records.incident import matters
from gateway.records.messages import PicturesNotKept
from gateway.records.record import EventRecord, array_of, unpacked
from gateway.records.recorder_service import RecorderService, folder_of, head_of
from gateway.records.segment import Head
from tests.virtual_time import LoopClock, in_virtual_time

CONFIG = {
    "state_dir": "/var/lib/x",
    "mqtt": {"url": "mqtt://user:secret@broker"},
    "bays": [{"name": "bay1", "unit_id": 1}, {"name": "bay2", "unit_id": 2}],
}


def service(**more: object) -> RecorderService:
    return RecorderService(parse(CONFIG | more), LoopClock(), {}, "boot")  # type: ignore[arg-type]


def noted(made: RecorderService, bay: str) -> list[tuple[str, str]]:
    found: list[tuple[str, str]] = []
    while (chunk := made.collectors[bay].take()) is not None:
        found += [(r.kind, r.detail) for r in unpacked(array_of(chunk.records)) if isinstance(r, EventRecord)]
    return found


def change(bay: str | None, event: AlarmEvent, after: AlarmState = AlarmState.UNACKNOWLEDGED) -> AlarmChange:
    return AlarmChange(1, 5, "x.camera_down", "camera_down", bay, event, AlarmState.NORMAL, after, "no picture")


@pytest.mark.parametrize(
    ("config", "folder"),
    [
        ({"state_dir": "/var/lib/x"}, "/var/lib/x/records/site1.gateway"),
        ({"state_dir": "/a", "records": {"folder": "/mnt/ssd"}, "site": "north"}, "/mnt/ssd/north.gateway"),
        ({"state_dir": ""}, None),
        ({"state_dir": "/a", "records": {"enabled": False}}, None),
        ({"state_dir": "", "records": {"folder": "/mnt/ssd"}}, "/mnt/ssd/site1.gateway"),
    ],
)
def test_where_it_is_written(config: dict[str, object], folder: str | None) -> None:
    assert folder_of(parse(config)) == (None if folder is None else Path(folder))


def test_a_head_has_the_configuration_of_its_bay_and_no_password() -> None:
    head = head_of(parse(CONFIG), parse(CONFIG).bays[1], "boot")
    assert isinstance(head, Head)
    assert "secret" not in head.config
    read = GatewayConfig.model_validate_json(head.config)
    assert [bay.name for bay in read.bays] == ["bay2"]
    assert read.bays[0] == parse(CONFIG).bays[1]
    assert read.mqtt is None


def test_a_head_has_no_password_of_a_camera() -> None:
    config = parse({"camera": {"url": "rtsp://user:secret@10.0.0.3/live?token=secret"}})
    head = head_of(config, config.bays[0], "boot")
    assert "secret" not in head.config
    assert GatewayConfig.model_validate_json(head.config).bays[0].camera.url == "rtsp://***@10.0.0.3/live?token=***"


@in_virtual_time
async def test_where_nothing_is_recorded_nothing_runs_and_nothing_is_kept() -> None:
    made = service(state_dir="")
    assert made.tasks(lambda _bay, _visit: None) == []
    assert made.of_bay("bay1") is None
    made.on_alarm(change(None, AlarmEvent.OCCURS))
    assert not made._wanted
    await made.close(1.0)


@in_virtual_time
async def test_pictures_are_wanted_round_what_people_ask_about_and_alarms_that_occur() -> None:
    made = service()
    record, state = made.of_bay("bay1"), StateVector("bay1", plc=Handshake(PlcLink.ALIVE))
    assert record is not None
    record(None, state, [Event(kind, "bay1", 5, state) for kind in EventKind], lambda: None)
    made.on_alarm(change("bay2", AlarmEvent.OCCURS))
    made.on_alarm(change("bay2", AlarmEvent.ACKNOWLEDGE))
    made.on_alarm(change(None, AlarmEvent.OCCURS))
    assert {(wanted.bay, wanted.why) for wanted in made._wanted} == {
        ("bay2", "alarm camera_down"),
        *(
            ("bay1", why)
            for why in (
                "stop_raised", "in_place", "in_place_ended", "rolling", "moved", "released", "sensor_fault", "plc_lost",
                "function_check_begun", "function_check_ended", "operator_mark",
            )
        ),
    }  # fmt: skip


@in_virtual_time
async def test_alarms_are_noted_with_their_bay_and_those_of_the_gateway_with_all() -> None:
    made = service()
    made.on_alarm(change("bay1", AlarmEvent.OCCURS))
    made.on_alarm(change(None, AlarmEvent.OCCURS))
    made.on_alarm(change("bay1", AlarmEvent.SUPPRESS, AlarmState.SUPPRESSED))  # by design: no action was needed
    made.on_alarm(change("bay9", AlarmEvent.OCCURS))
    text = "x.camera_down: occurs, now unacknowledged: no picture"
    assert noted(made, "bay1") == [("alarm", text), ("alarm", text)]
    assert noted(made, "bay2") == [("alarm", text)]


@in_virtual_time
async def test_who_acted_on_an_alarm_is_noted_once_more_for_itself() -> None:
    made = service()
    done = replace(change("bay1", AlarmEvent.ACKNOWLEDGE, AlarmState.ACKNOWLEDGED), who="maria", note="seen")
    made.on_alarm(done)
    text = "x.camera_down: acknowledge, now acknowledged by maria (seen)"
    assert noted(made, "bay1") == [("alarm", text), ("alarm_action", text)]
    assert noted(made, "bay2") == []


@in_virtual_time
async def test_pictures_that_were_not_kept_are_noted_and_those_that_matter_are_counted() -> None:
    made = service()
    made._not_kept(PicturesNotKept("bay1", 8, "8 of 9 pictures of stop_raised: why", matters=False))
    assert (made.pictures_not_kept, made.pictures_detail) == (0, "")
    made._not_kept(PicturesNotKept("bay1", 2, "2 of 3 pictures of moved: why", matters=True))
    assert (made.pictures_not_kept, made.pictures_detail) == (2, "bay1: 2 of 3 pictures of moved: why")
    assert noted(made, "bay1") == [
        ("pictures_not_kept", "8 of 9 pictures of stop_raised: why"),
        ("pictures_not_kept", "2 of 3 pictures of moved: why"),
    ]


@pytest.mark.parametrize("link", [PlcLink.UNUSED, PlcLink.ALIVE])
@in_virtual_time
async def test_a_truck_that_leaves_where_no_plc_releases_any_is_no_incident(link: PlcLink) -> None:
    """Else ordinary departures would use up what is reserved for the truck that rolls away."""
    made = service()
    state = fusion.initial("bay1", 0)
    record = made.of_bay("bay1")
    assert record is not None
    record(
        None,
        replace(state, plc=replace(state.plc, link=link)),
        [Event(EventKind.MOVED, "bay1", 5, state)],
        lambda: None,
    )
    (wanted,) = made._wanted
    assert matters([wanted.why]) == (link is PlcLink.ALIVE)
