"""The status file: what `gateway update` of another version reads."""

import asyncio
import json
import os
from pathlib import Path

import pytest

from gateway.alarms.definition import GatewayConditions
from gateway.config import GatewayConfig
from gateway.core.state import VisitPhase
from gateway.errors import LinkError
from gateway.hub import Hub
from gateway.status_file import NAME, BayNow, ModbusClient, ModbusPort, Status, StatusFile, read
from gateway.systemd import runtime_directory
from gateway.values.gateway_values import GatewayFacts
from gateway.web.host.status import StatusCollector
from tests.unit.web.gateway_client import plant
from tests.unit.web.links import server
from tests.virtual_time import LoopClock, in_virtual_time


@pytest.mark.parametrize(
    ("value", "folder"), [(None, None), ("", None), ("/run/a", Path("/run/a")), ("/run/a:/run/b", Path("/run/a"))]
)
def test_the_runtime_directory(monkeypatch: pytest.MonkeyPatch, value: str | None, folder: Path | None) -> None:
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    if value is not None:
        monkeypatch.setenv("RUNTIME_DIRECTORY", value)
    assert runtime_directory() == folder


@in_virtual_time
async def test_it_is_replaced_each_second_and_removed_at_the_end(tmp_path: Path) -> None:
    clock, count = LoopClock(), 0

    def status() -> Status:
        nonlocal count
        count += 1
        return Status(version="1.2.3", pid=7, t_ns=clock.now_ns(), alarms={"bay1.camera_down": f"look {count}"})

    task = asyncio.create_task(StatusFile(tmp_path, status, clock).run())
    await clock.sleep(2.5)
    assert read(tmp_path / NAME).alarms == {"bay1.camera_down": "look 3"}
    assert os.listdir(tmp_path) == [NAME]
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    assert os.listdir(tmp_path) == [], "an old status must not look like one of now"


@in_virtual_time
async def test_a_folder_that_cannot_be_written_is_a_lost_link(tmp_path: Path) -> None:
    nowhere = StatusFile(tmp_path / "missing", lambda: Status(version="1", pid=1, t_ns=0), LoopClock())
    with pytest.raises(LinkError, match=r"missing/status\.json: No such file"):
        await nowhere.run()


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (None, "No such file"),
        ("", "not a status that this version understands"),
        ('{"version": 3, "pid": 1, "t_ns": 1}', "Expected `str`"),
        ('{"format": 2, "version": "9", "pid": 1, "t_ns": 1}', "format 2, and this version reads 1"),
    ],
)
def test_what_is_not_understood_is_refused(tmp_path: Path, text: str | None, why: str) -> None:
    if text is not None:
        (tmp_path / NAME).write_text(text)
    with pytest.raises(LinkError, match=why):
        read(tmp_path / NAME)


def test_a_pipe_a_link_or_a_folder_in_its_place_holds_nobody_up(tmp_path: Path) -> None:
    path = tmp_path / NAME
    os.mkfifo(path)
    with pytest.raises(LinkError, match="not a regular file"):
        read(path)
    path.unlink()
    path.symlink_to("/etc/shadow")
    with pytest.raises(LinkError, match="Too many levels of symbolic links"):
        read(path)


def test_fields_of_a_later_version_are_ignored_and_missing_ones_have_their_default(tmp_path: Path) -> None:
    later = {"format": 1, "version": "9.0", "pid": 4, "t_ns": 5, "colour": 1, "bays": {"a": {"phase": "empty", "x": 1}}}
    (tmp_path / NAME).write_text(json.dumps(later))
    assert read(tmp_path / NAME) == Status(version="9.0", pid=4, t_ns=5, bays={"a": BayNow(phase="empty")})


@in_virtual_time
async def test_what_a_gateway_writes_of_itself() -> None:
    async with plant() as made:
        clock = made.client.clock
        made.loading()
        made.monitor.scan(made.conditions)
        await clock.sleep(0.1)
        facts = GatewayFacts(in_force="ab", reviewed="cd")
        collector = StatusCollector(
            GatewayConfig(), made.hub, boot="b1", modbus=lambda: (server(),), facts=lambda: facts
        )
        status = collector.status(made.monitor, clock.now_ns())
        state = made.hub.state("bay1")
        bay = status.bays["bay1"]
        assert bay == BayNow(
            unit_id=1,
            heartbeat=state.heartbeat,
            vision="good",
            vision_ns=state.vision.t_ns,
            range="good",
            range_ns=state.range.t_ns,
            phase=state.visit.phase.name.lower(),
            stop=state.stop,
            function_check="off",
        )
        assert bay.phase in {phase.name.lower() for phase in VisitPhase}
        assert status.modbus == (
            ModbusPort(
                host="127.0.0.1",
                port=502,
                requests=1000,
                clients=(ModbusClient(address="10.0.0.1", is_plc=True, quiet_s=0.25),),
            ),
        )
        assert (status.version, status.alarms, status.t_ns) == ("0.1.0", {}, clock.now_ns())
        assert (status.boot, status.in_force, status.reviewed, status.high) == ("b1", "ab", "cd", ())


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_alarms_with_an_active_cause_and_latched_ones_are_in_it() -> None:
    async with plant() as made:
        collector, monitor = StatusCollector(GatewayConfig(), Hub(["bay1"])), made.monitor

        def alarms() -> dict[str, str]:
            return collector.status(monitor, made.client.clock.now_ns()).alarms

        made.conditions = GatewayConditions(bay_file_damaged="bay1: cut off")
        monitor.scan(made.conditions)
        assert alarms()["bay_file_damaged"] == "bay1: cut off"
        made.conditions = GatewayConditions(crashes=1, crashed="bay1.vision: KeyError()")
        monitor.scan(made.conditions)
        made.conditions = GatewayConditions(crashes=1)
        for _ in range(90):
            await made.client.clock.sleep(1)
            monitor.scan(made.conditions)
        found = alarms()
        assert "bay_file_damaged" not in found, "it returned to normal, and waits only for its acknowledgement"
        assert found["task_crashed"] == "bay1.vision: KeyError()", "latched"
