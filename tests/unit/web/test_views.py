"""What moves on the pages is what its description says, whatever is known."""

import asyncio
import json
from dataclasses import replace
from typing import Any

from gateway.config import parse
from gateway.core.detection import Circle, Ellipse, Tracking
from gateway.core.plc import PlcWrite, Writer
from gateway.core.readings import Quality, VisionReading
from gateway.web.ipc.messages import SystemStatus
from gateway.web.server import views
from tests.unit.web import programs
from tests.unit.web.gateway_client import plant
from tests.unit.web.links import full
from tests.unit.web.programs import COMPONENTS
from tests.virtual_time import in_virtual_time


def fits(text: str, model: str) -> Any:
    """As described, with no field that the description does not have."""
    view = programs.fits(text, model)
    assert set(view) == set(COMPONENTS["schemas"][model]["properties"])
    return view


STAGES = (("hsv", 1_250_000), ("fit", 400_000))


@in_virtual_time
async def test_the_live_view_of_some_bays() -> None:
    async with plant(bays=3) as made:
        made.links = full()
        await asyncio.sleep(1.2)
        made.loading("bay2", stage_ns=STAGES)
        await made.client.update_links()
        view = fits(views.live_json(made.client, ("bay2", "bay3")), "LiveView")
        assert [bay["bay"] for bay in view["bays"]] == ["bay2", "bay3"]
        first = view["bays"][0]
        assert first["stage_ms"] == {"hsv": 1.25, "fit": 0.4}
        assert first["state"]["guidance"]["name"] == "FORWARD"
        assert first["deadlines"] == {"vision_ms": 300.0, "range_ms": 400.0, "plc_ms": None}
        assert view["links"]["mqtt"]["queued"] == 7
        assert view["links"]["modbus"][0]["refused"] == {"idle": 2}
        assert view["links"]["modbus"][0]["peers"][0]["quiet_ms"] == 250
        assert [task["name"] for task in view["links"]["tasks"]] == ["mqtt.deliver"]  # the one that began anew
        assert 0 <= view["links"]["age_ms"] < 200
        assert view["events_newest"] == made.client.newest_event


@in_virtual_time
async def test_a_page_knows_a_relay_that_is_not_reported() -> None:
    async with plant(keep=False) as made:
        for used in (False, True):
            bay = parse({"ranger": {"hcsr04": {"relay": used}}}).bays[0]
            assert views.bay_view(made.client, bay).relay is used


@in_virtual_time
async def test_a_page_knows_whether_the_pose_is_configured() -> None:
    """By the lens and the marker's size, of which the cross-check's is one."""
    lens, check = (
        {"intrinsics": {"fx": 6e2, "fy": 6e2, "cx": 3e2, "cy": 2e2}},
        {"focal_px": 6e2, "marker_radius_mm": 90},
    )
    async with plant(keep=False) as made:
        for sections, placed in (
            ({"vision": lens}, False),
            ({"guidance": {"marker_radius_mm": 90}}, False),
            ({"vision": lens, "guidance": {"marker_radius_mm": 90}}, True),
            ({"vision": lens, "fusion": {"cross_check": check}}, True),
        ):
            assert views.bay_view(made.client, parse(sections).bays[0]).pose is placed, sections


@in_virtual_time
async def test_the_live_view_of_the_alarms_is_that_of_the_operator_s_page() -> None:
    async with plant() as made:
        made.conditions = replace(made.conditions, crashes=1, crashed="mqtt.deliver: KeyError")
        made.monitor.scan(made.conditions)
        await asyncio.sleep(1.2)
        view = fits(views.alarms_json(made.client, made.client.bays), "AlarmsLiveView")
        assert view["alarms"]["first"]["title"] == "Software fault"
        assert view["alarms"] == fits(views.live_json(made.client, ("bay1",)), "LiveView")["alarms"]


@in_virtual_time
async def test_ages_grow_while_the_main_process_is_silent() -> None:
    async with plant() as made:
        await asyncio.sleep(1.2)
        made.hang()
        await asyncio.sleep(3)
        live = fits(views.live_json(made.client, ("bay1",)), "LiveView")
        driver = fits(views.driver_json(made.client, ("bay1",)), "DriverView")
        assert live["bays"][0]["age_ms"] >= 3000
        assert driver["age_ms"] >= 3000
        assert live["links"]["age_ms"] >= 3000
        assert fits(views.alarms_json(made.client, made.client.bays), "AlarmsLiveView")["alarms"] is None
        made.go_on()


@in_virtual_time
async def test_before_anything_is_known() -> None:
    async with plant(keep=False) as made:
        live = fits(views.live_json(made.client, ("bay1",)), "LiveView")
        assert (live["bays"][0]["state"], live["bays"][0]["age_ms"]) == (None, None)
        assert live["links"]["age_ms"] is None
        assert made.client.links == SystemStatus()
        driver = fits(views.driver_json(made.client, ("bay1",)), "DriverView")
        assert (driver["code"], driver["stop"], driver["age_ms"]) == ("FAULT", True, None)


@in_virtual_time
async def test_the_driver_s_display_shows_what_the_plc_reads() -> None:
    async with plant() as made:
        await asyncio.sleep(1.2)
        made.loading()
        await made.client.update_links()
        view = fits(views.driver_json(made.client, ("bay1",)), "DriverView")
        guidance = made.hub.state("bay1").guidance
        assert (view["code"], view["to_go_mm"]) == (guidance.code.name, guidance.to_go_mm)
        assert view["stop"] is made.hub.state("bay1").stop is False


@in_virtual_time
async def test_the_recipe_that_the_plc_has_selected_chooses_the_driver_s_language() -> None:
    recipes = [{"id": 5, "name": "short truck", "language": "tr"}, {"id": 6, "name": "long truck"}]
    modbus = {"writes": True, "plc_addresses": ["10.0.0.0/24"]}
    config = parse(
        {"bays": [{"name": "bay1", "title": "Verladung 3 Süd", "unit_id": 1}], "recipes": recipes, "modbus": modbus}
    )
    async with plant(config=config) as made:
        languages = []
        for recipe in (0, 5, 6):
            made.controls["bay1"].on_write(PlcWrite(Writer("10.0.0.1"), recipe=recipe))
            await asyncio.sleep(1.2)
            assert made.hub.state("bay1").plc.recipe == recipe
            languages.append(fits(views.driver_json(made.client, ("bay1",)), "DriverView")["language"])
        assert languages == [None, "tr", None]
        assert fits(views.driver_json(made.client, ("bay1",)), "DriverView")["title"] == "Verladung 3 Süd"
        assert fits(views.live_json(made.client, ("bay1",)), "LiveView")["bays"][0]["title"] == "Verladung 3 Süd"


def test_a_frame_fits_into_a_header() -> None:
    report = VisionReading(
        1, Quality.GOOD, Circle(1.5, 2.5, 3.5), frame_id=9, ellipse=Ellipse(1.5, 2.5, 3.5, 3.0, 0.7), confidence=0.9
    )
    hidden = VisionReading(1, Quality.COASTED, frame_id=10, tracking=Tracking.COASTED, predicted=Circle(4.0, 5.0, 6.0))
    for reading in (report, hidden, VisionReading(1, Quality.WAITING)):
        text = views.frame_json(reading)
        assert text.isascii()
        assert text.isprintable()
        fits(text, "FrameView")
    assert json.loads(views.frame_json(report))["ellipse"]["semi_minor_px"] == 3.0
    view = json.loads(views.frame_json(hidden))
    assert (view["circle"], view["predicted"]) == (None, {"u": 4.0, "v": 5.0, "radius_px": 6.0})
