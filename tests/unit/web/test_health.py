"""/healthz: a restart is asked for only where it may help."""

import asyncio
from collections.abc import Callable
from dataclasses import replace

import pytest

from gateway.config import GatewayConfig, ModbusConfig
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import FusionMemory, Tick
from gateway.sinks.contract import StoreStatus
from gateway.web.ipc.messages import SystemStatus, TaskStatus
from gateway.web.server.health import health, status_code
from gateway.web.server.models import HealthView
from tests.unit.web.gateway_client import Plant, plant
from tests.unit.web.links import full, historian, mqtt, sparkplug
from tests.unit.web.programs import api_client
from tests.virtual_time import in_virtual_time


async def judged(
    made: Plant, happens: Callable[[Plant], object] = lambda _: None, *, verbose: bool = False
) -> HealthView:
    made.links = made.links if made.links != SystemStatus() else full()
    await asyncio.sleep(1.2)
    made.loading()
    happens(made)
    await made.client.update_links()
    return health(made.client, verbose=verbose)


def faults(view: HealthView) -> list[tuple[str, str]]:
    return [(reason.part, reason.status) for reason in view.reasons]


@in_virtual_time
async def test_all_is_well() -> None:
    async with plant() as made:
        view = await judged(made, verbose=True)
        assert (view.status, view.reasons, status_code(view)) == ("ok", (), 200)
        assert view.parts is not None
        assert {part.part for part in view.parts} >= {
            "main", "bay1.control", "bay1.vision", "bay1.range", "modbus", "modbus_tls", "mqtt", "event_store",
            "sparkplug", "historian", "task bay1.control",
        }  # fmt: skip
        assert all(part.status == "ok" for part in view.parts)


@pytest.mark.parametrize(
    ("sensor", "quality", "broken"),
    [
        *(("vision", quality, True) for quality in (Quality.LINK_DOWN, Quality.PROCESS_FAULT)),
        *(("range", quality, True) for quality in (Quality.LINK_DOWN, Quality.STUCK, Quality.WRONG_VERSION)),
        *(("range", quality, False) for quality in (Quality.NO_ECHO, Quality.TOO_FAR, Quality.UNSTABLE)),
    ],
)
@in_virtual_time
async def test_a_broken_sensor_is_degraded_and_an_empty_bay_is_not(sensor: str, quality: Quality, broken: bool) -> None:
    def happens(made: Plant) -> None:
        now_ns = made.client.clock.now_ns() + 1
        if sensor == "vision":
            made.controls["bay1"].on_reading(VisionReading(now_ns, quality, detail="rtsp://10.0.0.3/secret"))
        else:
            made.controls["bay1"].on_reading(RangeReading(now_ns, quality, detail="rtsp://10.0.0.3/secret"))

    async with plant() as made:
        view = await judged(made, happens, verbose=True)
        assert (view.status, status_code(view)) == ("degraded" if broken else "ok", 200)
        assert faults(view) == ([(f"bay1.{sensor}", "degraded")] if broken else [])
        assert "rtsp" not in view.model_dump_json()  # no login is needed to read it


@in_virtual_time
async def test_a_control_task_that_does_not_tick_fails() -> None:
    async with plant() as made:
        made.links = full()
        await asyncio.sleep(1.2)
        made.loading()
        control = made.controls["bay1"]
        step = control._step
        control._step = lambda seen, *more, **named: None if isinstance(seen, Tick) else step(seen, *more, **named)  # type: ignore[method-assign]
        await asyncio.sleep(2)
        view = health(made.client)
        assert (view.status, status_code(view)) == ("failing", 503)
        assert faults(view) == [("bay1.control", "failing")]
        answer = await api_client(made).get("/healthz")
        assert (answer.status, answer.json["status"], answer.json["parts"]) == (503, "failing", None)


@in_virtual_time
async def test_a_silent_main_process_fails() -> None:
    async with plant(keep=False) as made:
        assert faults(health(made.client))[0] == ("main", "failing")
    async with plant() as made:
        await judged(made)
        made.hang()
        await asyncio.sleep(3.5)
        view = health(made.client)
        assert view.status == "failing"
        assert ("main", "failing") in faults(view)
        assert ("bay1.control", "failing") in faults(view)
        made.go_on()


@pytest.mark.parametrize("since_s", [0.0, 0.9, 30.0])
@in_virtual_time
async def test_a_main_process_that_hangs_fails_in_time_and_is_well_as_soon_as_it_goes_on(since_s: float) -> None:
    async with plant() as made:
        await judged(made)
        made.hang()
        await asyncio.sleep(since_s)
        now_s = asyncio.get_running_loop().time
        asked_s = now_s()
        answer = await api_client(made).get("/healthz")
        assert (answer.status, now_s() - asked_s <= 2.5) == (503, True)
        reasons = {reason["part"]: reason["text"] for reason in answer.json["reasons"]}
        assert reasons["main"] == "the main process has not answered for 2 s"
        made.go_on()
        await asyncio.sleep(0.2)
        made.loading()
        asked_s = now_s()
        assert (await api_client(made).get("/healthz")).json == {"status": "ok", "reasons": [], "parts": None}
        assert now_s() - asked_s <= 0.2


@pytest.mark.parametrize(
    ("links", "expected"),
    [
        (full(modbus=()), [("modbus", "failing")]),
        (full(sinks=(mqtt(connected=False), sparkplug())), [("mqtt", "degraded")]),
        (full(sinks=(mqtt(ok=False), sparkplug())), [("event_store", "degraded")]),
        (
            full(sinks=(mqtt(), replace(historian(), store=StoreStatus("full", 1, 0, 3)))),
            [("historian.event_store", "degraded")],
        ),
        (full(sinks=(mqtt(), sparkplug(born=False))), [("sparkplug", "degraded")]),
        (full(sinks=(replace(historian(), connected=False),)), [("historian", "degraded")]),
        (full(tasks=(TaskStatus("bay1.vision", False, 2, 1, 0, "lost"),)), [("task bay1.vision", "degraded")]),
        (full(tasks=(TaskStatus("bay1.control", False, 2, 0, 1, "KeyError()"),)), [("task bay1.control", "failing")]),
        (full(tasks=(TaskStatus("trials", False, 1, 0, 0, ""),)), []),  # it has done its work
    ],
)
@in_virtual_time
async def test_links(links: SystemStatus, expected: list[tuple[str, str]]) -> None:
    async with plant() as made:
        made.links = links
        view = await judged(made)
        assert faults(view) == expected
        assert view.status == (expected[0][1] if expected else "ok")


@in_virtual_time
async def test_disagreement_wear_and_a_lost_plc_are_degraded() -> None:
    async with plant(config=GatewayConfig(modbus=ModbusConfig(writes=True, plc_addresses=("10.0.0.9",)))) as made:
        await asyncio.sleep(3)  # no heartbeat came
        state = made.hub.state("bay1")

        def happens(made: Plant) -> None:
            memory = FusionMemory(disagree=True, restarts=1, restarted_ns=state.t_ns)
            made.hub.publish(replace(made.hub.state("bay1"), memory=memory))

        view = await judged(made, happens)
        assert faults(view) == [(f"bay1.{part}", "degraded") for part in ("cross_check", "plc", "maintenance")]


@in_virtual_time
async def test_verbose_is_asked_for_by_name() -> None:
    async with plant() as made:
        await judged(made)
        assert (await api_client(made).get("/healthz")).json["parts"] is None
        assert len((await api_client(made).get("/healthz?verbose")).json["parts"]) > 8
