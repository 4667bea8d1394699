"""The teach-in's addresses against a real main process's side: a minute is measured, and what ends it early."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from gateway.config import BayConfig, FusionConfig, GatewayConfig, ModbusConfig, RecipeConfig, RecipeFusion, load
from gateway.core.detection import Circle
from gateway.core.plc import PlcWrite, Writer, WriteVerdict
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import FusionMemory, StateVector
from gateway.web.tuning import teach_in
from tests.unit.web.gateway_client import Plant, plant
from tests.unit.web.programs import ApiClient, api_client
from tests.virtual_time import in_virtual_time

PATH = "/api/bays/bay1/teach-in"
WIDTH, HEIGHT = 320, 240
PLC = Writer("10.0.0.2")
BAY = BayConfig(name="bay1", fusion=FusionConfig(decision="plain", recovery_s=0))


@dataclass
class Truck:
    """Stands in the bay, as both sensors see it 20 times a second; None: that sensor has no value."""

    made: Plant
    client: ApiClient
    circle: Circle | None = field(default_factory=lambda: Circle(160, 120, 90.0))
    distance_mm: float | None = 600.0

    async def stand(self, seconds: float) -> None:
        clock = self.made.client.clock
        for n in range(round(20 * seconds)):
            now_ns = clock.now_ns()
            seen = None if self.circle is None else Circle(160, 120, self.circle.radius_px + 0.2 * (n % 3 - 1))
            quality = Quality.NO_TARGET if seen is None else Quality.GOOD
            self.made.controls["bay1"].on_reading(VisionReading(now_ns, quality, seen, frame_id=n))
            heard = Quality.NO_ECHO if self.distance_mm is None else Quality.GOOD
            self.made.controls["bay1"].on_reading(RangeReading(now_ns, heard, self.distance_mm, seq=n))
            await clock.sleep(0.05)

    async def view(self) -> Any:
        return (await self.client.get(PATH)).json

    async def start(self, **body: object) -> Any:
        reply = await self.client.post(PATH, body)
        assert reply.status == 200, reply.text
        return reply.json

    async def refused(self, **body: object) -> str:
        reply = await self.client.post(PATH, body)
        assert (reply.status, reply.json["error"]) == (409, "refused")
        return str(reply.json["detail"])


@asynccontextmanager
async def truck(source: Path | None = None) -> AsyncIterator[Truck]:
    writes = {"writes": True, "plc_addresses": ["10.0.0.2"], "handshake": {"heartbeat_required": False}}
    recipe = RecipeConfig(id=3, name="other", fusion=RecipeFusion(radius_threshold_px=200.0))
    config = GatewayConfig(
        bays=(BAY, BayConfig(name="bay2", unit_id=2)), recipes=(recipe,), modbus=ModbusConfig.model_validate(writes)
    )
    async with plant(config=config, source=str(source or "")) as made:
        frame = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        made.rings["bay1"].write(frame, 1, made.client.clock.now_ns())
        yield Truck(made, api_client(made))


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_a_minute_of_a_standing_truck_becomes_changes() -> None:
    async with truck() as it:
        assert (await it.view())["phase"] == "none"
        await it.stand(2)
        begun = await it.start()
        assert (begun["phase"], begun["seconds"], begun["who"], begun["result"]) == ("measuring", 60, "anna", None)
        await it.stand(30)
        half = await it.view()
        assert half["phase"] == "measuring"
        assert half["elapsed_s"] == pytest.approx(30, abs=0.5)
        assert half["spreads"]["radius_px"]["count"] == pytest.approx(300, abs=6)
        assert half["spreads"]["radius_px"]["median"] == 90.0
        await it.stand(31)
        done = await it.view()
        assert (done["phase"], done["elapsed_s"]) == ("done", 60)
        assert done["spreads"]["distance_mm"]["count"] == pytest.approx(600, abs=12)
        result = done["result"]
        assert result["refusals"] == []
        assert result["changes"] == [
            {"path": ["bays", "bay1", "fusion", "radius_threshold_px"], "value": 87.9},  # 4 * 0.297 + 0.9 px
            {"path": ["bays", "bay1", "fusion", "distance_threshold_mm"], "value": 635.0},  # 4 * 1.2 + 30 mm
            {"path": ["bays", "bay1", "guidance", "aim_u_px"], "value": 160.0},
            {"path": ["bays", "bay1", "guidance", "aim_v_px"], "value": 120.0},
        ]
        assert [value["key"] for value in result["values"]][-1] == "guidance.tolerance_px"
        assert "fusion.radius_threshold_px = 87.9\n" in result["toml"]
        points = done["points"]
        assert len(points["t_s"]) == len(points["radius_px"]) == len(points["distance_mm"]) == pytest.approx(300, abs=6)
        assert (points["t_s"][0], points["t_s"][-1]) == (pytest.approx(0, abs=0.2), pytest.approx(60, abs=0.5))
        assert it.made.client.watchers == 0  # nobody is served at the quick pace any more


@pytest.mark.one_interpreter
@in_virtual_time
async def test_one_at_a_time_for_each_bay_and_it_can_be_cancelled() -> None:
    async with truck() as it:
        await it.stand(1)
        await it.start(seconds=20)
        await it.stand(1)
        assert "this bay is being taught already, wait or cancel that: anna" in await it.refused()
        cancelled = await it.client.call("DELETE", PATH)
        assert (cancelled.json["phase"], cancelled.json["result"]) == ("none", None)
        assert it.made.client.watchers == 0
        await it.stand(1)
        await it.start(seconds=20)
        await it.stand(21)
        assert (await it.view())["phase"] == "done"
        await it.start(seconds=20)  # the result before is replaced
        assert (await it.view())["phase"] == "measuring"


@in_virtual_time
async def test_it_does_not_begin_without_good_sensors_or_while_the_truck_moves() -> None:
    async with truck() as it:
        assert "camera: nothing received since the start" in await it.refused()
        it.circle = None
        await it.stand(1)
        assert "camera: the frame is fine, but no marker is in it" in await it.refused()
        it.circle, it.distance_mm = Circle(160, 120, 90), None
        await it.stand(1)
        assert "ranger: the ranger heard no echo" in await it.refused()
        for distance_mm in range(900, 600, -10):
            it.distance_mm = distance_mm
            await it.stand(0.05)
        assert "the truck is moving, 200 mm/s" in await it.refused()


FILE = """\
# The plant's file.
[fusion]
decision = "plain"        # the paper's
recovery_s = 0

[[bays]]
name = "bay1"
unit_id = 1

[[bays]]
name = "bay2"
unit_id = 2
camera.url = "1"
ranger.port = "/dev/ttyACM1"
"""


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_the_changes_are_saved_by_the_settings_addresses(tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    path.write_text(FILE)
    async with truck(path) as it:
        await it.stand(1)
        await it.start(seconds=20)
        await it.stand(21)
        changes = (await it.view())["result"]["changes"]
        digest = (await it.client.get("/api/setup/settings")).json["digest"]
        body = {"digest": digest, "changes": changes}
        shown = (await it.client.post("/api/setup/preview", body)).json
        assert "+fusion.radius_threshold_px = 87.9" in shown["diff"]
        assert (shown["faults"], shown["live"]) == ([], [])
        assert any("bay1.fusion.radius_threshold_px" in line for line in shown["restart"])
        assert path.read_text() == FILE
        assert (await it.client.post("/api/setup/save", body)).status == 200
    first, second = load(path).bays
    assert (first.fusion.radius_threshold_px, first.fusion.distance_threshold_mm) == (87.9, 635.0)
    assert (first.guidance.aim_u_px, first.guidance.aim_v_px) == (160.0, 120.0)
    assert (second.fusion.radius_threshold_px, second.guidance.aim_u_px) == (180.0, None)
    assert "# the paper's" in path.read_text()


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_with_a_recipe_in_force_its_keys_are_taught() -> None:
    async with truck() as it:
        await it.stand(2)
        control = it.made.controls["bay1"]
        assert control.on_write(PlcWrite(PLC, heartbeat=1, recipe=3)) is WriteVerdict.TAKEN
        await it.stand(1)
        await it.start(seconds=20)
        await it.stand(21)
        result = (await it.view())["result"]
        assert result["recipe"] == 3
        assert result["changes"][0] == {"path": ["recipes", "3", "fusion", "radius_threshold_px"], "value": 87.9}
        assert [value["old"] for value in result["values"]][:2] == [200.0, 300.0]
        assert result["toml"].startswith("id = 3  # of [[recipes]]\nfusion.radius_threshold_px = 87.9\n")
        await it.start(seconds=20)
        await it.stand(1)
        control.on_write(PlcWrite(PLC, recipe=0))
        await it.stand(1)
        assert (await it.view())["why"] == "the PLC has selected another recipe"


FAR_MAGENTA = (150, 30, 200)  # BGR; its hue is -42.4 degrees: red ends at -46
OFFERED = {"path": ["bays", "bay1", "vision", "marker_colour"], "value": "#c81e96"}


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_a_colour_more_than_half_way_to_the_gate_is_offered_with_the_thresholds() -> None:
    async with truck() as it:
        await it.stand(1)
        rows: list[Any] = []
        for bgr in (FAR_MAGENTA, (119, 30, 200), (45, 35, 190), (140, 140, 140)):
            frame = np.full((HEIGHT, WIDTH, 3), 120, np.uint8)
            cv2.circle(frame, (160, 120), 90, bgr, -1)
            it.made.rings["bay1"].write(frame, 2 + len(rows), it.made.client.clock.now_ns())
            await it.start(seconds=20)
            await it.stand(21)
            result = (await it.view())["result"]
            rows.append([value for value in result["values"] if value["key"] == "vision.marker_colour"])
            assert (OFFERED in result["changes"]) == bool(rows[-1])
            assert len(result["changes"]) == 4 + len(rows[-1])
        why = "seen here 81 % of the way from the marker's colour to the limit"
        assert rows == [[{"key": "vision.marker_colour", "value": "#c81e96", "old": None, "why": why}], [], [], []]


@pytest.mark.parametrize(("background", "covered"), [(FAR_MAGENTA, True), ((200, 60, 30), False)])
@pytest.mark.one_interpreter
@in_virtual_time
async def test_the_colour_of_something_else_in_the_markers_place_is_not_offered(
    background: tuple[int, int, int], covered: bool
) -> None:
    async with truck() as it:
        await it.stand(1)
        frame = np.full((HEIGHT, WIDTH, 3), background, np.uint8)
        it.made.rings["bay1"].write(frame, 2, it.made.client.clock.now_ns())
        await it.start(seconds=20)
        await it.stand(19.5)
        it.circle = None if covered else it.circle
        await it.stand(1)
        view = await it.view()
        assert (view["phase"], len(view["result"]["changes"])) == ("done", 4)


def test_it_does_not_begin_with_a_contradiction() -> None:
    good = StateVector(
        "bay1", vision=VisionReading(0, Quality.GOOD, Circle(1, 2, 3)), range=RangeReading(0, Quality.GOOD, 600.0)
    )
    assert teach_in.why_not(good, BAY) == ""
    contradicting = replace(good, memory=FusionMemory(disagree=True))
    assert "contradict each other" in teach_in.why_not(contradicting, BAY)


@pytest.mark.one_interpreter
@in_virtual_time
async def test_a_marker_that_is_covered_ends_it() -> None:
    async with truck() as it:
        await it.stand(1)
        await it.start()
        await it.stand(10)
        it.circle = None
        await it.stand(6)
        failed = await it.view()
        assert (failed["phase"], failed["result"]) == ("failed", None)
        assert failed["why"] == "no R or Z for 5 s: camera: the frame is fine, but no marker is in it"
        assert it.made.client.watchers == 0


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_a_gateway_that_reports_nothing_ends_it_and_results_are_forgotten(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert teach_in.KEPT_S == 900
    monkeypatch.setattr(teach_in, "KEPT_S", 9.0)
    async with truck() as it:
        await it.stand(1)
        await it.start(seconds=20)
        it.made.client.listeners.clear()
        await it.stand(29)
        assert (await it.view())["phase"] == "measuring"
        await it.stand(2)
        assert (await it.view())["why"] == "the gateway has reported nothing for too long"
        await it.stand(8)
        assert (await it.view())["phase"] == "failed"
        await it.stand(2)
        assert (await it.view())["phase"] == "none"


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_what_was_measured_may_be_refused() -> None:
    async with truck() as it:
        it.circle = Circle(160, 120, 125.0)  # 250 px across, in a picture of 240 px
        await it.stand(1)
        await it.start(seconds=20)
        await it.stand(21)
        result = (await it.view())["result"]
        assert "does not fit into the picture" in result["refusals"][0]
        assert (result["values"], result["changes"], result["toml"]) == ([], [], "")


@pytest.mark.parametrize("body", [{"seconds": 5}, {"seconds": 1e9}, {"seconds": "60"}, {"bay": "bay2"}])
@in_virtual_time
async def test_wrong_bodies_are_refused(body: dict[str, Any]) -> None:
    async with truck() as it:
        assert (await it.client.post(PATH, body)).status == 400
        assert (await it.client.post("/api/bays/bay9/teach-in", {})).status == 404
