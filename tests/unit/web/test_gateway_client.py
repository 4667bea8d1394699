"""The gateway client: pulls as often as its viewers need, keeps every event, notices a silent main process."""

import asyncio
from dataclasses import replace

import pytest

from gateway.config import VisionConfig
from gateway.core.events import EventKind
from gateway.core.plc import Writer
from gateway.core.state import FunctionCheck
from gateway.errors import LinkError
from gateway.web.ipc.messages import (
    MAX_EVENTS,
    MAX_STATES,
    ApplySettings,
    MarkMoment,
    ReleaseRanger,
    SetFunctionCheck,
    StateRequest,
)
from gateway.web.server.gateway_client import RefusedError
from tests.unit.web.gateway_client import plant
from tests.virtual_time import in_virtual_time

ANNA = Writer("127.0.0.1", "anna", "technician")


@in_virtual_time
async def test_without_viewers_the_main_process_is_polled_once_a_second() -> None:
    async with plant() as made:
        await asyncio.sleep(10.05)
        assert len(made.requests) == 11
        assert made.client.report("bay1") is not None


@in_virtual_time
async def test_a_viewer_is_served_at_once_and_ten_times_a_second_until_the_last_one_leaves() -> None:
    async with plant() as made:
        await asyncio.sleep(2.5)
        before = len(made.requests)
        with made.client.watching("bay1"), made.client.watching("bay1"):
            report = await made.client.newer("bay1", made.client.answers, 0.05)
            assert report is not None
            await asyncio.sleep(2.0)
        assert 20 <= len(made.requests) - before <= 22  # however many look
        await asyncio.sleep(0.2)
        before = len(made.requests)
        await asyncio.sleep(5.0)
        assert 5 <= len(made.requests) - before <= 6


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_of_many_bays_those_with_a_viewer_are_always_fresh_and_none_is_forgotten() -> None:
    async with plant(bays=64) as made:
        with made.client.watching(*made.client.bays, urgent=False), made.client.watching("bay40"):
            await asyncio.sleep(5.0)
            now_ns = made.client.clock.now_ns()
            ages_s = {}
            for bay in made.client.bays:
                report = made.client.report(bay)
                assert report is not None, bay
                ages_s[bay] = (now_ns - report.now_ns) / 1e9
            assert ages_s["bay40"] <= 0.11
            assert max(ages_s.values()) <= 1.4  # 64 bays, five with each answer, ten answers a second
    assert all(len(ask.bays) <= MAX_STATES for ask in made.requests)


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_as_many_displays_as_bays_are_all_in_time() -> None:
    async with plant(bays=64) as made:
        with made.client.watching(*made.client.bays):
            await asyncio.sleep(2.0)
            now_ns = made.client.clock.now_ns()
            for bay in made.client.bays:
                report = made.client.report(bay)
                assert report is not None
                assert (now_ns - report.now_ns) / 1e9 <= 0.25, bay  # a display shows STOP after 0.5 s


@in_virtual_time
async def test_events_come_once_in_order_and_those_from_before_the_first_visitor_too() -> None:
    async with plant() as made:
        for _ in range(30):
            made.controls["bay1"].check_function(FunctionCheck.MAY_MOVE_OFF)
            made.controls["bay1"].check_function(FunctionCheck.OFF)
        await asyncio.sleep(0.0)
        for _ in range(100):
            await asyncio.sleep(0.0)
        numbers = [row.number for row in made.client.events]
        assert numbers == list(range(1, 62))  # the start and sixty
        assert made.client.events_missed == 0
        assert [row.event.kind for row in made.client.events][:2] == [
            EventKind.START,
            EventKind.FUNCTION_CHECK_BEGUN,
        ]


@in_virtual_time
async def test_more_events_than_are_kept_are_missed_and_counted() -> None:
    async with plant(keep=False) as made:
        for _ in range(600):
            made.controls["bay1"].check_function(FunctionCheck.MAY_MOVE_OFF)
            made.controls["bay1"].check_function(FunctionCheck.OFF)
        first = made.handler.answer(StateRequest(1, ("bay1",), after=1))
        assert [row.number for row in first.events] == [202, 203, 204, 205]  # 1201 in all, the newest 1000 are kept
        assert first.newest_event == 1201
        assert len(first.events) == MAX_EVENTS


@in_virtual_time
async def test_a_new_alarm_comes_with_the_next_answer_and_no_links_where_none_has_changed() -> None:
    async with plant() as made:
        with made.client.watching("bay1"):
            await asyncio.sleep(1.0)
            made.conditions = replace(made.conditions, crashes=1, crashed="mqtt.deliver: KeyError")
            made.monitor.scan(made.conditions)
            await asyncio.sleep(0.11)
            assert [alarm.kind for alarm in made.client.links.alarms.alarms] == ["task_crashed"]
            known = made.client.links.alarms.newest_change
    assert made.handler.answer(StateRequest(1, ("bay1",), links=False, alarm_change=known)).links is None
    assert made.handler.answer(StateRequest(1, ("bay1",), links=False, alarm_change=known - 1)).links is not None


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_a_hung_main_process_is_noticed_and_waited_for() -> None:
    async with plant() as made:
        await asyncio.sleep(2.5)
        made.hang()
        with made.client.watching("bay1"):
            await asyncio.sleep(1.9)
            before = made.client.silent
            await asyncio.sleep(0.3)
            assert (before, made.client.silent) == (False, True)
            before_s = asyncio.get_running_loop().time()
            with pytest.raises(LinkError, match="does not answer"):
                await made.client.command(SetFunctionCheck("bay1", FunctionCheck.MAY_MOVE_OFF), ANNA)
            await made.client.fresh("bay1", anew=True)
            assert asyncio.get_running_loop().time() == before_s
            await asyncio.sleep(600.0)
            made.go_on()
            report = await made.client.newer("bay1", made.client.answers, 0.05)
            assert (report is not None, made.client.silent) == (True, False)
        assert made.hub.state("bay1").function_check is FunctionCheck.OFF  # what was refused is not done later


@in_virtual_time
async def test_a_function_check_is_executed_and_reported_with_the_name() -> None:
    async with plant() as made:
        made.loading()
        assert made.hub.state("bay1").may_move
        await made.client.command(SetFunctionCheck("bay1", FunctionCheck.MAY_MOVE_OFF), ANNA)
        assert made.hub.state("bay1").function_check is FunctionCheck.MAY_MOVE_OFF
        assert not made.hub.state("bay1").may_move
        await asyncio.sleep(1.1)
        events = [row.event for row in made.client.events if row.event.kind is EventKind.FUNCTION_CHECK_BEGUN]
        assert [event.detail for event in events] == ["127.0.0.1 (anna, role technician)"]


@in_virtual_time
async def test_a_moment_is_marked_with_name_and_note() -> None:
    async with plant() as made:
        made.loading()
        await made.client.command(MarkMoment("bay1", "driver complains"), ANNA)
        await made.client.command(MarkMoment("bay1", ""), ANNA)
        await asyncio.sleep(1.1)
        marks = [row.event.detail for row in made.client.events if row.event.kind is EventKind.OPERATOR_MARK]
        assert marks == ["127.0.0.1 (anna, role technician): driver complains", "127.0.0.1 (anna, role technician)"]


@in_virtual_time
async def test_settings_go_live_only_while_a_function_check_is_on() -> None:
    async with plant() as made:
        wished = VisionConfig(method="paper", min_area_px2=250.0)
        with pytest.raises(RefusedError, match="function check first"):
            await made.client.command(ApplySettings("bay1", wished), ANNA)
        assert made.vision["bay1"].settings == VisionConfig()
        await made.client.command(SetFunctionCheck("bay1", FunctionCheck.MAY_MOVE_KEPT), ANNA)
        await made.client.command(ApplySettings("bay1", wished), ANNA)
        assert made.vision["bay1"].settings == wished
        made.vision["bay1"].refuses = "vision.workers can't change while the gateway runs"
        with pytest.raises(RefusedError, match="can't change"):
            await made.client.command(ApplySettings("bay1", VisionConfig()), ANNA)
        await asyncio.sleep(1.1)
        events = [row.event.detail for row in made.client.events if row.event.kind is EventKind.SETTINGS_CHANGED]
        assert events == ["127.0.0.1 (anna, role technician): method: robust -> paper, min_area_px2: 100.0 -> 250.0"]


@in_virtual_time
async def test_a_ranger_is_released_only_while_a_function_check_is_on() -> None:
    async with plant() as made:
        first, second = made.rangers["bay1"]
        order = ReleaseRanger("bay1", second.config.port)
        with pytest.raises(RefusedError, match="begin a function check first"):
            await made.client.command(order, ANNA)
        await made.client.command(SetFunctionCheck("bay1", FunctionCheck.MAY_MOVE_OFF), ANNA)
        with pytest.raises(RefusedError, match="no ranger of this bay has the port /dev/ttyS9"):
            await made.client.command(ReleaseRanger("bay1", "/dev/ttyS9"), ANNA)
        assert (first.released_s, second.released_s) == (0, 0)
        await made.client.command(order, ANNA)
        assert (first.released_s, second.released_s) == (0, 15)


@in_virtual_time
async def test_an_order_for_no_bay_is_refused() -> None:
    async with plant() as made:
        with pytest.raises(RefusedError, match="no bay 'bay7'"):
            await made.client.command(SetFunctionCheck("bay7", FunctionCheck.MAY_MOVE_OFF), ANNA)
