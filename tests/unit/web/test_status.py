"""What the main process gathers for pages and alarms, and what its processes use of the machine."""

import asyncio
import os
import random
import string
import subprocess
import sys
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import psutil
import pytest
from msgspec import structs

from gateway.alarms.bay_alarms import BAY_ALARMS
from gateway.alarms.engine import MAX_ALARM_DETAIL_CHARS
from gateway.alarms.gateway_alarms import GATEWAY_ALARMS
from gateway.alarms.monitor import REPORTED_CHANGES
from gateway.alarms.records import MAX_NOTE, AlarmChange, AlarmSummary
from gateway.alarms.states import AlarmEvent, AlarmState
from gateway.clock import SystemClock
from gateway.config import BayConfig, GatewayConfig, ModbusConfig, MqttConfig, OpcuaConfig
from gateway.core.readings import Quality, VisionReading
from gateway.core.state import FunctionCheck, Reason, StateVector, Visit
from gateway.hub import Hub
from gateway.processes.codec import MAX_MESSAGE_BYTES, Codec
from gateway.sinks.contract import LinkStatus, Sink
from gateway.sinks.mqtt.publisher import MqttPublisher
from gateway.supervisor import TaskRecord
from gateway.web.host.status import MAX_ALARMS, MAX_ERROR, PLC_QUIET_S, StatusCollector, in_words
from gateway.web.ipc.messages import (
    BOUNDS_S,
    MAX_STATES,
    TO_WEB,
    Histogram,
    OpcuaNow,
    StateReply,
    StateRequest,
    TaskStatus,
    WebSetup,
)
from gateway.web.server.process_usage import ProcessUsage, by_name, process_usage
from tests.sink_context import sink_context
from tests.unit.web.gateway_client import plant
from tests.unit.web.links import full, mqtt, server, sparkplug
from tests.virtual_time import in_virtual_time


def parts(*, plc: str = "", **changes: Any) -> StatusCollector:
    config = GatewayConfig(modbus=ModbusConfig(plc_addresses=(plc,) if plc else ()))
    return StatusCollector(config, Hub(["bay1"]), **changes)


def sinks(*links: LinkStatus) -> list[Sink]:
    return [cast(Sink, SimpleNamespace(link=link)) for link in links]


class TestConditions:
    def test_what_is_not_configured_has_no_condition(self) -> None:
        conditions = parts().conditions()
        assert (conditions.sinks_connected, conditions.plc_reads) == ({}, None)

    @pytest.mark.parametrize(
        ("quiet_s", "reads"), [(None, False), (0.0, True), (PLC_QUIET_S - 0.1, True), (PLC_QUIET_S, False)]
    )
    def test_a_plc_reads_while_it_was_answered_lately(self, quiet_s: float | None, reads: bool) -> None:
        servers = (replace(server(), plc_quiet_s=quiet_s), replace(server(tls=True), plc_quiet_s=None))
        assert parts(plc="10.0.0.1", modbus=lambda: servers).conditions().plc_reads is reads
        assert parts(modbus=lambda: servers).conditions().plc_reads is None

    def test_losses_of_all_queues_are_counted(self) -> None:
        made = parts(sinks=sinks(mqtt(), sparkplug()))
        assert made.conditions().events_lost == 7
        assert made.conditions().sinks_connected == {"mqtt": True, "sparkplug": True}
        made.sinks = sinks(mqtt(), sparkplug(born=False))
        assert made.conditions().sinks_connected == {"mqtt": True, "sparkplug": False}

    def test_a_store_that_fails_is_named(self) -> None:
        assert parts(sinks=sinks(mqtt(ok=False))).conditions().store_fault == "disk full"
        assert parts(sinks=sinks(mqtt())).conditions().store_fault == ""

    def test_crashes_are_summed_and_named(self) -> None:
        tasks = {"a": TaskRecord(starts=3, crashes=2, last_error="KeyError()"), "b": TaskRecord(link_errors=9)}
        conditions = parts(tasks=tasks).conditions()
        assert (conditions.crashes, conditions.crashed) == (2, "a: KeyError()")


@in_virtual_time
async def test_links_hold_what_the_parts_say_and_no_password() -> None:
    async with plant() as made:
        config = MqttConfig(url="mqtt://anna:secret@broker")
        publisher = MqttPublisher(sink_context(config, made.hub, made.client.clock))
        tasks = {"bay1.control": TaskRecord(starts=1, running=True, last_error="x" * 900)}
        opcua = OpcuaNow(4840, 2, 0, 0, 0)
        gathered = parts(sinks=[publisher], tasks=tasks, modbus=lambda: (server(),), opcua=lambda: opcua)
        links = gathered.system_status(made.monitor)
        assert links.sinks == (publisher.link,)
        assert links.sinks[0].peer == "mqtt://broker:1883"
        assert "secret" not in repr(links)
        assert (links.tasks[0].name, links.tasks[0].running, len(links.tasks[0].last_error)) == (
            "bay1.control", True, MAX_ERROR,
        )  # fmt: skip
        assert (links.modbus, links.opcua) == ((server(),), opcua)
        assert sum(count for _, count in links.alarms.counts) == len(BAY_ALARMS) + len(GATEWAY_ALARMS)


def test_the_opc_ua_server_stands_in_the_line_for_the_service_manager() -> None:
    config = GatewayConfig(opcua=OpcuaConfig(without_security=True))
    collector = StatusCollector(config, Hub(["bay1"]))
    assert "; OPC UA not open yet; bay1: " in collector.summary(0)
    collector.opcua = lambda: OpcuaNow(4840, 2, 0, 0, 0)
    assert "; OPC UA on port 4840, sessions: 2; bay1: " in collector.summary(0)
    assert "OPC UA" not in parts().summary(0)


@pytest.mark.parametrize(
    ("state", "said"),
    [
        (StateVector("b", stop=False, may_move=True, reason=Reason.NONE), "may move"),
        (StateVector("b", reason=Reason.NO_ECHO), "stop, reason no_echo"),
        (StateVector("b", reason=Reason.TARGET_REACHED, visit=Visit(in_place=True)), "in place"),
        (StateVector("b", stop=False, reason=Reason.NONE), "no stop, may_move withheld"),
    ],
)
@pytest.mark.parametrize("check", FunctionCheck)
def test_a_bays_line_for_the_service_manager_is_what_the_plc_is_told(
    state: StateVector, said: str, check: FunctionCheck
) -> None:
    """`systemctl status` said "stop, reason none" of a bay without a stop, under a function check."""
    if said.endswith("withheld"):
        more = " by the function check" if check is FunctionCheck.MAY_MOVE_OFF else ""
    else:
        more = ", function check" if check is not FunctionCheck.OFF else ""
    assert in_words(replace(state, function_check=check)) == said + more


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_with_everything_broken_at_once_it_still_fits_into_one_message() -> None:
    chance = random.Random(1)

    def words(length: int) -> str:
        return "".join(chance.choices(string.ascii_lowercase + " ", k=length))

    async with plant(bays=64) as made:
        track = tuple((5_000_000_000 + n * 60_000_000, 812.4 + n) for n in range(16))
        stages = tuple((f"stage {n}", 123_456 + n) for n in range(12))
        for name in made.client.bays:
            made.loading(name, stage_ns=stages, detail=words(500))
            state = made.hub.state(name)
            made.hub.publish(replace(state, memory=replace(state.memory, track=track), seq=state.seq + 1))
        answer = made.handler.answer(StateRequest(1, made.client.bays))
        assert len(answer.bays) == MAX_STATES
        for control in made.controls.values():
            control.on_reading(VisionReading(made.client.clock.now_ns(), Quality.LINK_DOWN, detail="x"))
        await asyncio.sleep(8)
        alarms = made.monitor.summary(MAX_ALARMS)
        assert len(alarms.alarms) == 100
        alarms = replace(
            alarms,
            alarms=tuple(replace(a, detail=words(MAX_ALARM_DETAIL_CHARS), note=words(MAX_NOTE)) for a in alarms.alarms),
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
            changes=tuple(
                replace(change, number=n, detail=words(MAX_ALARM_DETAIL_CHARS)) for n in range(REPORTED_CHANGES)
            ),
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
        packed = Codec.packed(structs.replace(answer, links=links))
        assert len(packed) < MAX_MESSAGE_BYTES, len(packed)
        again: StateReply = TO_WEB.unpacked(packed)
        assert again.links == links
        assert again.links is not None
        assert isinstance(again.links.alarms, AlarmSummary)
    bays = tuple(BayConfig(name=f"bay{n}", unit_id=n) for n in range(1, 65))
    assert len(Codec.packed(WebSetup(GatewayConfig(bays=bays), SystemClock(), {}))) < MAX_MESSAGE_BYTES / 2


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

    def test_processes_of_one_name_are_summed_and_those_that_go_are_left_out(self) -> None:
        class Process:
            def __init__(self, name: str, cpu_s: float, memory_bytes: int, gone: bool = False) -> None:
                self.name = lambda: name
                self.cpu_times = lambda: SimpleNamespace(user=cpu_s - 0.5, system=0.5, children_user=99.0)
                self.memory_info = lambda: SimpleNamespace(rss=memory_bytes)
                self.gone = gone

            def oneshot(self) -> AbstractContextManager[None]:
                if self.gone:
                    raise psutil.NoSuchProcess(13)
                return nullcontext()

        rows: tuple[Any, ...] = (
            ("main", Process("gateway", 1.0, 4096)),
            (None, Process("gw-worker (1) x", 2.0, 40960)),
            (None, Process("gw-worker (1) x", 3.0, 81920)),
            (None, Process("gone", 1.0, 1, gone=True)),
        )
        assert by_name(*rows) == (
            ProcessUsage("main", 1, 1.0, 4096),
            ProcessUsage("gw-worker (1) x", 2, 5.0, 122880),
        )
        assert process_usage(2**22 + 1) == ()  # no such process: the kernel's highest number is 2**22
