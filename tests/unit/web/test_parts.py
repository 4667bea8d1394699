"""What the main process gathers for pages and alarms, and what its processes use of the machine."""

import asyncio
import os
import random
import string
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from msgspec import structs

from gateway.alarms.engine import MAX_DETAIL
from gateway.alarms.monitor import REPORTED_CHANGES
from gateway.alarms.records import MAX_NOTE, AlarmChange, AlarmSummary
from gateway.alarms.states import AlarmEvent, AlarmState
from gateway.alarms.table import BAY_ALARMS, GATEWAY_ALARMS
from gateway.config import GatewayConfig, ModbusConfig, MqttConfig
from gateway.core.model import Quality, VisionReading
from gateway.hub import Hub
from gateway.processes.codec import MAX_MESSAGE_BYTES, Codec
from gateway.sinks.mqtt.messages import DeliveryPayload
from gateway.sinks.sparkplug.node import SparkplugNow
from gateway.supervisor import TaskRecord
from gateway.web.host.latencies import BOUNDS_S, Histogram
from gateway.web.host.parts import MAX_ALARMS, MAX_ERROR, PLC_QUIET_S, StatusCollector
from gateway.web.host.process_usage import process_usage
from gateway.web.ipc.messages import TO_WEB, StateReply, StateRequest, TaskStatus
from tests.unit.web.gateway_client import plant
from tests.unit.web.links import full, server, store
from tests.virtual_time import run


def parts(*, plc: str = "", mqtt: bool = False, **changes: Any) -> StatusCollector:
    config = GatewayConfig(
        modbus=ModbusConfig(plc_addresses=(plc,) if plc else ()),
        mqtt=MqttConfig(url="mqtt://anna:secret@broker") if mqtt else None,
    )
    return StatusCollector(config, Hub(["bay1"]), **changes)


def voice(**changes: Any) -> Any:
    delivery = DeliveryPayload(published=1, failed=0, reconnects=0, dropped=0, queued=0, store=None)
    return cast(Any, SimpleNamespace(connected=True, stats=delivery.model_copy(update=changes)))


class TestSigns:
    def test_what_is_not_configured_gives_no_sign(self) -> None:
        conditions = parts().conditions()
        assert (conditions.broker_connected, conditions.sparkplug_connected, conditions.plc_reads) == (None, None, None)

    @pytest.mark.parametrize(
        ("quiet_s", "reads"), [(None, False), (0.0, True), (PLC_QUIET_S - 0.1, True), (PLC_QUIET_S, False)]
    )
    def test_a_plc_reads_while_it_was_answered_lately(self, quiet_s: float | None, reads: bool) -> None:
        told = (replace(server(), plc_quiet_s=quiet_s), replace(server(tls=True), plc_quiet_s=None))
        assert parts(plc="10.0.0.1", modbus=lambda: told).conditions().plc_reads is reads
        assert parts(modbus=lambda: told).conditions().plc_reads is None

    def test_losses_of_all_queues_are_counted(self) -> None:
        session = SparkplugNow(True, True, 1, 0, 0, 0, history_dropped=4, history_waiting=0)
        made = parts(mqtt=True, publisher=voice(dropped=3), sparkplug=cast(Any, SimpleNamespace(now=session)))
        assert made.conditions().events_lost == 7
        assert made.conditions().sparkplug_connected is True
        waiting = replace(session, born=False)
        made.sparkplug = cast(Any, SimpleNamespace(now=waiting))
        assert made.conditions().sparkplug_connected is False

    def test_a_store_that_fails_is_named(self) -> None:
        assert parts(mqtt=True, publisher=voice(store=store(ok=False))).conditions().store_fault == "disk full"
        assert parts(mqtt=True, publisher=voice(store=store())).conditions().store_fault == ""

    def test_crashes_are_summed_and_told_by_name(self) -> None:
        tasks = {"a": TaskRecord(starts=3, crashes=2, last_error="KeyError()"), "b": TaskRecord(link_errors=9)}
        conditions = parts(tasks=tasks).conditions()
        assert (conditions.crashes, conditions.crashed) == (2, "a: KeyError()")


def test_links_hold_what_the_parts_say_and_no_password() -> None:
    async def scene() -> None:
        async with plant() as made:
            tasks = {"bay1.control": TaskRecord(starts=1, running=True, last_error="x" * 900)}
            gathered = parts(mqtt=True, publisher=voice(), tasks=tasks, modbus=lambda: (server(),))
            links = gathered.system_status(made.monitor)
            assert links.broker == "mqtt://anna:***@broker" or "secret" not in str(links.broker)
            assert "secret" not in repr(links)
            assert (links.tasks[0].name, links.tasks[0].running, len(links.tasks[0].last_error)) == (
                "bay1.control", True, MAX_ERROR,
            )  # fmt: skip
            assert (links.modbus, links.broker_connected) == ((server(),), True)
            assert sum(count for _, count in links.alarms.counts) == len(BAY_ALARMS) + len(GATEWAY_ALARMS)

    run(scene())


def test_frames_are_timed_only_for_pages() -> None:
    for enabled in (False, True):
        made = parts()
        made.config = made.config.model_copy(update={"hmi": made.config.hmi.model_copy(update={"enabled": enabled})})
        passed: list[VisionReading] = []
        made.observing("bay1", passed.append)(VisionReading(0, Quality.NO_TARGET, stage_ns=(("hsv", 5),)))
        assert (len(passed), bool(made.latencies.histograms())) == (1, enabled)


def test_with_everything_broken_at_once_it_still_fits_into_one_message() -> None:
    chance = random.Random(1)

    def words(length: int) -> str:
        return "".join(chance.choices(string.ascii_lowercase + " ", k=length))

    async def scene() -> None:
        async with plant(bays=64) as made:
            for bay in made.client.bays:
                made.controls[bay].on_vision(VisionReading(made.client.clock.now_ns(), Quality.LINK_DOWN, detail="x"))
            await asyncio.sleep(8)
            alarms = made.monitor.summary(MAX_ALARMS)
            assert len(alarms.alarms) == 100
            alarms = replace(
                alarms, alarms=tuple(replace(a, detail=words(MAX_DETAIL), note=words(MAX_NOTE)) for a in alarms.alarms)
            )
            change = AlarmChange(
                1,
                2,
                "bay1.camera_down",
                "camera_down",
                "bay1",
                AlarmEvent.OCCURS,
                AlarmState.NORMAL,
                AlarmState.SHELVED,
            )
            links = full(
                alarms=alarms,
                changes=tuple(replace(change, number=n, detail=words(MAX_DETAIL)) for n in range(REPORTED_CHANGES)),
                tasks=tuple(
                    TaskStatus(
                        f"bay{n}.{part}",
                        False,
                        5,
                        4,
                        0,
                        f"camera 10.0.{n}.3: {words(20)} connection refused by the camera",
                    )
                    for n in range(64)
                    for part in ("vision", "ranger", "control")
                ),
                latencies=tuple(
                    Histogram(
                        f"bay{n}", f"stage {m}", tuple(chance.randrange(10**6) for _ in range(len(BOUNDS_S) + 1)), 1.5
                    )
                    for n in range(64)
                    for m in range(9)
                ),
            )
            made.links = links
            answer = made.feed.answer(StateRequest(1, made.client.bays))
            packed = Codec.packed(structs.replace(answer, links=links))
            assert len(packed) < MAX_MESSAGE_BYTES, len(packed)
            again: StateReply = TO_WEB.unpacked(packed)
            assert again.links == links
            assert again.links is not None
            assert isinstance(again.links.alarms, AlarmSummary)

    run(scene())


class TestProcesses:
    def test_ourselves_and_our_children(self) -> None:
        child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
        try:
            found = {one.name: one for one in process_usage(os.getpid())}
            assert found["main"].cpu_s > 0.05
            assert found["main"].memory_bytes > 10 << 20
            assert sum(one.processes for one in found.values()) >= 2
        finally:
            child.communicate(b"\\n")

    def test_names_with_anything_in_them_and_processes_that_go(self, tmp_path: Path) -> None:
        def process(pid: int, comm: str, utime: int, rss: int) -> None:
            (tmp_path / str(pid)).mkdir(exist_ok=True)
            fields = ["S", "1", *["0"] * 9, str(utime), "0", *["0"] * 8, str(rss), "0"]
            (tmp_path / str(pid) / "stat").write_text(f"{pid} ({comm}) {' '.join(fields)}\\n")

        tick, page = os.sysconf("SC_CLK_TCK"), os.sysconf("SC_PAGE_SIZE")
        process(10, "gateway", tick, 1)
        (tmp_path / "10" / "task" / "10").mkdir(parents=True)
        (tmp_path / "10" / "task" / "10" / "children").write_text("11 12 13 ")
        process(11, "gw-worker (1) x", 2 * tick, 10)
        process(12, "gw-worker (1) x", 3 * tick, 20)
        main, workers = process_usage(10, tmp_path)  # 13 is gone
        assert (main.name, main.processes, main.cpu_s, main.memory_bytes) == ("main", 1, 1.0, page)
        assert (workers.name, workers.processes, workers.cpu_s, workers.memory_bytes) == (
            "gw-worker (1) x", 2, 5.0, 30 * page,
        )  # fmt: skip
        assert process_usage(99, tmp_path) == ()
