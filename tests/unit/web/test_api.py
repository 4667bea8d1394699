"""What programs receive, and actions on alarms: over a real link from a real main process's side."""

import asyncio
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import jsonschema
import numpy as np
import pytest

from gateway.alarms.bay_alarms import BAY_ALARMS
from gateway.alarms.definition import Suppression
from gateway.config import BayConfig, FusionConfig, GatewayConfig, GuidanceConfig, ModbusConfig, RecipeConfig
from gateway.core.events import EventKind
from gateway.core.plc import PlcWrite, Writer, WriteVerdict
from gateway.core.readings import Quality, VisionReading
from gateway.core.state import FunctionCheck
from gateway.web.auth.access import Level
from gateway.web.auth.sessions import Caller
from gateway.web.server.api import MAX_NUMBER
from tests.unit.web.asgi import Answer
from tests.unit.web.gateway_client import Plant, plant
from tests.unit.web.programs import COMPONENTS, DOCUMENT, api_client, fits
from tests.virtual_time import in_virtual_time


def fitting(answer: Answer, model: str) -> Any:
    assert answer.status == 200, answer.body
    return fits(answer.body, model)


def wrong(answer: Answer, status: int, error: str) -> str:
    """The text, if it is a problem of this kind."""
    assert (answer.status, answer.json["error"]) == (status, error)
    assert answer.headers["content-type"] == "application/problem+json"
    jsonschema.validate(answer.json, COMPONENTS["schemas"]["Problem"])
    assert answer.json["status"] == status
    return str(answer.json["detail"])


async def kept_loading(made: Plant) -> None:
    while True:
        made.loading()
        await asyncio.sleep(0.05)


def lost(made: Plant, bay: str = "bay1") -> None:
    made.controls[bay].on_reading(VisionReading(made.client.clock.now_ns(), Quality.LINK_DOWN, detail="no such device"))


@in_virtual_time
async def test_state_of_all_bays_and_of_one() -> None:
    async with plant(bays=2) as made:
        client = api_client(made)
        await asyncio.sleep(1.2)
        made.loading()
        await made.client.update_links()
        both = fitting(await client.get("/api/state"), "BayView")
        assert [bay["bay"] for bay in both] == ["bay1", "bay2"]
        one = fitting(await client.get("/api/bays/bay1/state"), "BayView")
        assert (one["state"]["radius_px"], one["state"]["distance_mm"]) == (100.0, 900.0)
        assert one["state"]["may_move"] is True
        assert 0 <= one["age_ms"] < 1500
        assert (one["unit_id"], one["function_check"], one["method"]) == (1, "OFF", "robust")
        assert both[1]["state"]["reason"]["name"] == "STARTING"


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_of_many_bays_all_are_young() -> None:
    async with plant(bays=20) as made:
        for _ in range(2):
            view = fitting(await api_client(made).get("/api/state"), "BayView")
            assert len(view) == 20
            assert max(bay["age_ms"] for bay in view) < 1600
            await asyncio.sleep(5)


@in_virtual_time
async def test_thresholds_are_those_of_the_recipe_in_force() -> None:
    fusion = FusionConfig(decision="plain", radius_threshold_px=180, radius_hysteresis_px=4)
    bay = BayConfig(name="bay1", fusion=fusion, guidance=GuidanceConfig(aim_u_px=300.0))
    recipe = RecipeConfig.model_validate(
        {"id": 5, "name": "short truck", "fusion": {"radius_threshold_px": 140}, "guidance": {"aim_u_px": 320.0}}
    )
    modbus = ModbusConfig(writes=True, plc_addresses=("10.0.0.9",))
    config = GatewayConfig(bays=(bay,), recipes=(recipe,), modbus=modbus)

    async with plant(config=config) as made:
        before = fitting(await api_client(made).get("/api/bays/bay1/state"), "BayView")
        verdict = made.controls["bay1"].on_write(PlcWrite(Writer("10.0.0.1"), recipe=5))
        assert verdict is WriteVerdict.TAKEN
        await asyncio.sleep(2)
        after = fitting(await api_client(made).get("/api/bays/bay1/state"), "BayView")
        view = [(b["thresholds"]["radius_threshold_px"], b["aim"]["u_px"]) for b in (before, after)]
        assert view == [(180.0, 300.0), (140.0, 320.0)]
        assert (before["thresholds"]["recipe_name"], after["thresholds"]["recipe_name"]) == (None, "short truck")
        assert after["thresholds"]["radius_hysteresis_px"] == 4
        assert after["deadlines"]["plc_ms"] == 1000.0


@pytest.mark.parametrize("path", ["state", "events", "registers", "snapshot.jpg", "snapshot.png", "picture", "profile"])
@in_virtual_time
async def test_an_unknown_bay_is_404(path: str) -> None:
    async with plant() as made:
        assert "'bay9'" in wrong(await api_client(made).get(f"/api/bays/bay9/{path}"), 404, "bay")


@in_virtual_time
async def test_a_silent_main_process_is_reported() -> None:
    async with plant(keep=False) as made:
        client = api_client(made)
        assert fitting(await client.get("/api/bays/bay1/state"), "BayView")["state"] is None
        wrong(await client.get("/api/bays/bay1/registers"), 503, "not_known")
        wrong(await client.get("/api/bays/bay1/snapshot.jpg"), 503, "no_frame")
        assert (await client.get("/healthz")).status == 503


PLACES = {"{bay}": "bay1", "{alarm}": "broker_lost", "{number}": "1", "{frame}": "0", "{begun_ms}": "1"}
VALUES = {
    "mode": "may_move_off", "minutes": 5, "name": "a", "data": "AAAA", "vision": {}, "u_px": 1, "v_px": 1, "text": "",
    "digest": 64 * "0", "marker": None, "what": "begin", "controls": {}, "password": "Kran-7-unter-dem-Silo",
    "action": "check", "file": "package", "offset": 0, "size": 1,
}  # fmt: skip
SILENT_LIMIT_S = 12.0  # a trial's own limit; everything else is answered sooner


@pytest.mark.one_interpreter
@pytest.mark.parametrize(("method", "path"), [(m, path) for path, ways in DOCUMENT["paths"].items() for m in ways])
@in_virtual_time
async def test_no_address_fails_or_hangs_while_the_main_process_hangs(method: str, path: str, tmp_path: Path) -> None:
    body = DOCUMENT["paths"][path][method].get("requestBody")
    schema = {} if body is None else body["content"]["application/json"]["schema"]
    required = COMPONENTS["schemas"].get(schema.get("$ref", "").rpartition("/")[2], {}).get("required", ())
    sent = json.dumps({key: VALUES[key] for key in required}).encode()
    for place, value in PLACES.items():
        path = path.replace(place, value)
    (file := tmp_path / "gateway.toml").write_text('[[bays]]\nname = "bay1"\n')
    async with plant(source=str(file)) as made:
        await asyncio.sleep(1.2)
        made.loading()
        made.rings["bay1"].write(np.zeros((48, 64, 3), np.uint8), 7, made.client.clock.now_ns())
        await asyncio.sleep(1.2)
        made.hang()
        await asyncio.sleep(3.0)
        begun_s = asyncio.get_running_loop().time()
        answer = await api_client(made).call(method.upper(), path, sent)
        assert asyncio.get_running_loop().time() - begun_s <= SILENT_LIMIT_S
        assert answer.status != 500
        if answer.status >= 400 and path != "/healthz":
            assert answer.headers["content-type"] == "application/problem+json"
            if "does not answer" in answer.json["detail"]:
                assert (answer.status, answer.headers["retry-after"]) == (503, "1")


@in_virtual_time
async def test_events_are_listed_from_a_number_on() -> None:
    async with plant(bays=2) as made:
        client = api_client(made)
        for _ in range(3):
            lost(made, "bay2")
            await asyncio.sleep(1)
            made.loading("bay2")
            await asyncio.sleep(1)
        await asyncio.sleep(3)
        view = fitting(await client.get("/api/events"), "EventsView")
        numbers = [row["number"] for row in view["events"]]
        assert numbers == list(range(1, view["newest"] + 1))
        assert view["events"][0]["event"]["kind"] == "start"
        some = fitting(await client.get("/api/events?after=3&limit=2"), "EventsView")
        assert [row["number"] for row in some["events"]] == [4, 5]
        one = fitting(await client.get("/api/bays/bay1/events"), "EventsView")
        assert {row["event"]["bay"] for row in one["events"]} == {"bay1"}
        assert one["newest"] == view["newest"]
        kinds = [row["event"]["kind"] for row in view["events"] if row["event"]["bay"] == "bay2"]
        assert kinds.count(EventKind.SENSOR_FAULT) >= 3


@pytest.mark.parametrize(
    ("query", "expected"),
    [
        ("after=-1", "after = '-1': a whole number from 0"),
        ("after=1.5", "after"),
        ("after=x", "after"),
        ("after=", "after"),
        ("after=" + "9" * 30, "after"),
        (f"after={MAX_NUMBER + 1}", "after"),
        ("after=%D9%A1", "after"),
        ("limit=0", "limit = '0': a whole number from 1 to 1000"),
        ("limit=1001", "limit"),
    ],
)
@in_virtual_time
async def test_a_number_out_of_its_range_is_named(query: str, expected: str) -> None:
    async with plant() as made:
        for path in ("/api/events", "/api/bays/bay1/events"):
            assert wrong(await api_client(made).get(f"{path}?{query}"), 400, "query").startswith(expected)


@in_virtual_time
async def test_registers_are_the_words_that_a_plc_reads() -> None:
    async with plant() as made, asyncio.TaskGroup() as group:
        task = group.create_task(kept_loading(made))
        await asyncio.sleep(1.5)
        view = fitting(await api_client(made).get("/api/bays/bay1/registers"), "RegistersView")
        task.cancel()
        rows = {row["name"]: row for row in view["registers"]}
        report = made.client.report("bay1")
        assert report is not None
        image = report.now.image
        for row in view["registers"]:
            assert tuple(row["words"]) == tuple(image[row["address"] : row["address"] + len(row["words"])])
        assert (rows["distance"]["words"], rows["distance"]["value"], rows["distance"]["unit"]) == (
            [900],
            900,
            "mm",
        )
        assert (rows["radius"]["words"], rows["radius"]["value"], rows["radius"]["scale"]) == ([1000], 100.0, 0.1)
        assert (rows["vision_quality"]["value"], rows["vision_quality"]["text"]) == (0, "good")
        assert (rows["z_vision"]["words"], rows["z_vision"]["value"]) == ([0xFFFF], None)
        on = {bit["name"] for bit in rows["status"]["bits"] if bit["on"]}
        assert on == {"may_move", "vision_good", "range_good", "healthy"}
        assert rows["seq_begin"]["words"] == rows["seq_end"]["words"]
        assert view["word_order"] == "big"
        assert [name for name, row in rows.items() if row["writable"]] == [
            "plc_heartbeat", "plc_control", "recipe_select",
        ]  # fmt: skip


@pytest.mark.parametrize("ending", ["png", "jpg"])
@in_virtual_time
async def test_a_snapshot_is_the_newest_frame(ending: str) -> None:
    image = np.zeros((60, 80, 3), np.uint8)
    image[20:40, 30:50] = (30, 60, 200)

    async with plant() as made:
        captured_ns = made.client.clock.now_ns()
        made.rings["bay1"].write(np.zeros((60, 80, 3), np.uint8), 4, captured_ns - 50_000_000)
        made.rings["bay1"].write(image, 5, captured_ns)
        await asyncio.sleep(0.25)
        answer = await api_client(made).get(f"/api/bays/bay1/snapshot.{ending}")
        assert (answer.status, answer.headers["x-frame-id"]) == (200, "5")
        assert answer.headers["content-type"] == {"png": "image/png", "jpg": "image/jpeg"}[ending]
        assert 250 <= float(answer.headers["x-frame-age-ms"]) < 300
        shown = cv2.imdecode(np.frombuffer(answer.body, np.uint8), cv2.IMREAD_COLOR)
        assert shown is not None
        assert int(np.abs(shown.astype(int) - image.astype(int)).max()) <= (0 if ending == "png" else 110)
        assert np.abs(shown.astype(int) - image.astype(int)).mean() < (0.1 if ending == "png" else 3)


class TestAlarms:
    @in_virtual_time
    async def test_an_alarm_is_listed_and_acknowledged_by_name_and_changes_nothing_else(self) -> None:
        async with plant() as made:
            client = api_client(made)
            made.loading()
            await asyncio.sleep(0.1)
            lost(made)
            await asyncio.sleep(5)
            (alarm, *_) = fitting(await client.get("/api/alarms"), "AlarmsView")["alarms"]
            assert (alarm["id"], alarm["state"]) == ("bay1.camera_down", "unacknowledged")
            assert (alarm["priority"], alarm["detail"]) == ("high", "no such device")
            before = made.hub.state("bay1")
            answer = await client.post(
                "/api/alarms/bay1.camera_down/acknowledge", {"occurrence": 1, "note": "gone to look"}
            )
            view = fitting(answer, "AlarmsView")
            now = next(one for one in view["alarms"] if one["id"] == "bay1.camera_down")
            assert (now["state"], now["who"], now["note"]) == ("acknowledged", "anna", "gone to look")
            assert view["summary"]["by_bay"]["bay1"] == len([a for a in view["alarms"] if a["bay"] == "bay1"])
            assert view["summary"]["highest_by_bay"] == {"bay1": now["priority"]}
            change = view["changes"][-1]
            assert (change["cue"], change["after"], change["who"]) == ("acknowledge", "acknowledged", "anna")
            after = made.hub.state("bay1")
            assert (after.stop, after.may_move, after.reason) == (before.stop, before.may_move, before.reason)
            assert after.stop
            assert not after.may_move

    @in_virtual_time
    async def test_without_a_login_the_address_is_kept(self) -> None:
        async with plant() as made:
            client = api_client(made)
            client.caller = Caller("", Level.TECHNICIAN, "10.0.0.9", "token")
            lost(made)
            await asyncio.sleep(5)
            view = fitting(await client.post("/api/alarms/bay1.camera_down/acknowledge"), "AlarmsView")
            alarm = next(one for one in view["alarms"] if one["id"] == "bay1.camera_down")
            assert alarm["who"] == "10.0.0.9 (without login, role technician)"

    @pytest.mark.one_interpreter
    @in_virtual_time
    async def test_every_action_does_what_it_is_called(self) -> None:
        async with plant() as made:
            client = api_client(made)
            made.conditions = replace(made.conditions, crashes=1, crashed="mqtt.deliver: KeyError")
            await asyncio.sleep(2)

            def state() -> str:
                return next((a.state.value for a in made.client.links.alarms.alarms if a.id == "task_crashed"), "")

            states = []
            for action, body in (
                ("shelve", {"minutes": 5}), ("unshelve", None), ("remove", None), ("restore", None),
                ("acknowledge", None),
            ):  # fmt: skip
                fitting(await client.post(f"/api/alarms/task_crashed/{action}", body), "AlarmsView")
                states.append(state())
            assert states == ["shelved", "unacknowledged", "out_of_service", "unacknowledged", "acknowledged"]
            await asyncio.sleep(70)
            assert state() == "latched_acknowledged"
            fitting(await client.post("/api/alarms/task_crashed/reset"), "AlarmsView")
            assert state() == ""

    @in_virtual_time
    async def test_impossible_actions_are_refused_with_the_reason(self) -> None:
        async with plant() as made:
            client = api_client(made)
            await asyncio.sleep(1.2)
            base = "/api/alarms/bay1.camera_down"
            for name in (
                "nothing",
                "bay1",
                "camera_down",
                "bay9.camera_down",
                "bay1.broker_lost",
                "bay1.camera_down.x",
            ):
                assert repr(name) in wrong(await client.post(f"/api/alarms/{name}/acknowledge"), 404, "alarm")
            assert "not possible" in wrong(await client.post(f"{base}/acknowledge"), 409, "refused")
            assert wrong(await client.post(f"{base}/acknowledge", {"extra": 1}), 400, "body").startswith("extra: ")
            assert wrong(await client.post(f"{base}/acknowledge", {"note": "x" * 121}), 400, "body").startswith("note")
            assert wrong(await client.post(f"{base}/acknowledge", [1]), 400, "body").startswith("body")
            assert wrong(await client.post(f"{base}/shelve"), 400, "body").startswith("minutes")
            assert wrong(await client.post(f"{base}/shelve", {"minutes": 721}), 400, "body").startswith("minutes")
            for body in (b"{", b"null", b'{"note": "\\ud800"}', b"note=x", b"[" * 100_000):
                assert wrong(await client.call("POST", f"{base}/acknowledge", body), 400, "body").startswith("body")
            for content in ("text/plain", "application/x-www-form-urlencoded", "application/json"):  # all is JSON
                headers = {"Content-Type": content}
                answer = await client.call("POST", f"{base}/acknowledge", b'{"note": "x"}', headers)
                assert "not possible" in wrong(answer, 409, "refused")
            assert made.monitor.changes() == ()

    @in_virtual_time
    async def test_a_new_occurrence_is_not_acknowledged_unseen(self) -> None:
        async with plant() as made:
            lost(made)
            await asyncio.sleep(5)
            answer = await api_client(made).post("/api/alarms/bay1.camera_down/acknowledge", {"occurrence": 0})
            assert "occurred again" in wrong(answer, 409, "refused")


@in_virtual_time
async def test_a_function_check_suppresses_and_is_shown() -> None:
    async with plant() as made:
        made.controls["bay1"].check_function(FunctionCheck.MAY_MOVE_OFF)
        lost(made)
        await asyncio.sleep(2)
        summary = fitting(await api_client(made).get("/api/alarms"), "AlarmsView")["summary"]
        hidden = sum(Suppression.FUNCTION_CHECK in kind.suppressed_by for kind in BAY_ALARMS)
        assert (summary["suppressed"], summary["active"], summary["first"]) == (hidden, 0, None)
        assert (summary["function_checks"], summary["silent_sensors"]) == (1, 1)  # no alarm, and yet not all is well
        assert summary["age_ms"] < 1500
        one = fitting(await api_client(made).get("/api/bays/bay1/state"), "BayView")
        assert one["function_check"] == "MAY_MOVE_OFF"
