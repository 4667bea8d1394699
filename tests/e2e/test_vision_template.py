"""Vision processes forked from a template: as spawned ones in every respect, whatever happens to the template."""

import asyncio
import gc
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import psutil
import pytest

from gateway.clock import SystemClock
from gateway.config import CameraConfig, Reconnect, VisionConfig
from gateway.core.readings import Quality, VisionReading
from gateway.errors import LinkError
from gateway.processes import template
from gateway.processes.channel import Gone
from gateway.processes.start import Role
from gateway.processes.template import ProcessTemplate
from gateway.vision.detect.radii import MarkerRadii
from gateway.vision.process.vision_service import TEMPLATE_MODULE, VisionService, VisionSlot
from gateway.vision.transport.messages import FROM_VISION, DetectorSpec, TemplateJob
from tests.e2e.processes import survivors
from tests.e2e.vision_stand_ins import ShadesSpec

PATIENCE_S = 60.0
STAND_INS = "tests.e2e.vision_stand_ins"
FAST = Reconnect(min_s=0.05, max_s=0.1)


class Bay:
    """A service whose process is forked from `origin`, and what it has emitted."""

    def __init__(self, name: str, folder: Path, origin: ProcessTemplate, cpus: tuple[int, ...] | None = None) -> None:
        camera = CameraConfig(deadline_s=20.0, open_deadline_s=60.0, reconnect=FAST)
        vision = VisionConfig(deadline_s=20.0, affinity=cpus)
        source = ShadesSpec(str(folder / name), 1_000_000, ("",))
        detector = DetectorSpec(vision, f"{STAND_INS}:shade_reader")
        self.readings: list[VisionReading] = []
        self._news = asyncio.Event()
        self.service = VisionService(
            name, source, camera, vision, SystemClock(), self._emit, detector=detector, template=origin
        )
        self.name = name

    def _emit(self, reading: VisionReading) -> None:
        self.readings.append(reading)
        self._news.set()

    async def next(self, quality: Quality) -> VisionReading:
        """The first reading of that quality from now on."""
        seen = len(self.readings)
        async with asyncio.timeout(PATIENCE_S):
            while True:
                for reading in self.readings[seen:]:
                    if reading.quality is quality:
                        return reading
                seen = len(self.readings)
                self._news.clear()
                await self._news.wait()

    @property
    def process(self) -> psutil.Process:
        (found,) = named(f"gw-worker-{self.name}"[:15])
        return found


def named(name: str) -> list[psutil.Process]:
    """Our children of that name that run."""
    return [c for c in psutil.Process().children() if c.name() == name and c.status() != psutil.STATUS_ZOMBIE]


def made_for(*modules: str) -> ProcessTemplate:
    detector = DetectorSpec(VisionConfig(), f"{STAND_INS}:shade_reader")
    return ProcessTemplate(Role(TEMPLATE_MODULE, "gw-template", TemplateJob((detector,), (STAND_INS, *modules))))


@asynccontextmanager
async def running(*runs: Callable[[], Awaitable[None]]) -> AsyncIterator[None]:
    """A LinkError is followed by another start, as the supervisor does; afterwards nothing is left."""
    before = possessions()

    async def again_and_again(run: Callable[[], Awaitable[None]]) -> None:
        while True:
            with suppress(LinkError):
                await run()
            await asyncio.sleep(0.02)

    tasks = [asyncio.create_task(again_and_again(run)) for run in runs]
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    assert psutil.Process().children(recursive=True) == []
    assert possessions() == before


def possessions() -> tuple[int, int]:
    gc.collect()  # what tests before have left goes now, not in between
    return len(os.listdir("/proc/self/fd")), threading.active_count()


def play(story: Callable[[], Awaitable[None]]) -> None:
    async def main() -> None:
        await story()

    asyncio.run(main())


def started_by(process: psutil.Process) -> str:
    """`forked` from a template, or `spawned`: by its command line, which a fork keeps."""
    return "forked" if TEMPLATE_MODULE in process.cmdline() else "spawned"


def test_a_forked_process_is_the_gateways_own_child_with_only_the_descriptors_of_its_role(tmp_path: Path) -> None:
    async def story() -> None:
        origin = made_for()
        cpu = max(os.sched_getaffinity(0))
        bays = Bay("b1", tmp_path, origin, (cpu,)), Bay("b2", tmp_path, origin)
        async with running(origin.run, *(bay.service.run for bay in bays)):
            for bay in bays:
                await bay.next(Quality.GOOD)
            one, other = bays[0].process, bays[1].process
            assert [started_by(one), started_by(other)] == ["forked", "forked"]
            assert (one.ppid(), other.ppid()) == (os.getpid(), os.getpid())
            assert one.cpu_affinity() == [cpu]
            assert other.cpu_affinity() == sorted(os.sched_getaffinity(0))
            kinds = [descriptors(process) for process in (one, other)]
            # The viewers' requests, its ring and two maps of that, its channel.
            ring = ["memfd:gateway-frames (deleted)"] * 3
            assert kinds == [["anon_inode:[eventfd]", *ring, "socket"]] * 2
            (template_process,) = named("gw-template")
            assert descriptors(template_process) == ["socket"]
            assert template_process.num_threads() == 1

    play(story)


def descriptors(process: psutil.Process) -> list[str]:
    """What is open besides stdin, stdout, stderr and files on disk."""
    folder = Path(f"/proc/{process.pid}/fd")
    links = [os.readlink(fd) for fd in folder.iterdir() if int(fd.name) > 2]
    return sorted(link.split(":[")[0] if link.startswith("socket") else link.lstrip("/") for link in links)


@pytest.mark.failure_mode("V1")
def test_a_killed_process_is_replaced_by_another_fork_and_reaped(tmp_path: Path) -> None:
    async def story() -> None:
        origin = made_for()
        bay = Bay("b1", tmp_path, origin)
        async with running(origin.run, bay.service.run):
            await bay.next(Quality.GOOD)
            old = bay.process
            old.kill()
            fault = await bay.next(Quality.PROCESS_FAULT)
            assert fault.detail == "vision process was killed by SIGKILL"
            again = await bay.next(Quality.GOOD)
            assert (again.stats.restarts, again.stats.reopens) == (1, 0)
            assert started_by(bay.process) == "forked"
            assert not psutil.pid_exists(old.pid)

    play(story)


@pytest.mark.mostly_long
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_template_that_ends_affects_no_process_and_is_replaced(tmp_path: Path, number: int) -> None:
    async def story() -> None:
        origin = made_for()
        bay = Bay("b1", tmp_path, origin)
        async with running(origin.run, bay.service.run):
            await bay.next(Quality.GOOD)
            process, (old,) = bay.process, named("gw-template")
            old.send_signal(number)
            reading = await bay.next(Quality.GOOD)
            async with asyncio.timeout(PATIENCE_S):
                while not (new := named("gw-template")) or new == [old]:
                    reading = await bay.next(Quality.GOOD)
            assert bay.process == process
            process.kill()  # the next one comes from the new template, or is spawned while that is not there
            await bay.next(Quality.PROCESS_FAULT)
            reading = await bay.next(Quality.GOOD)
            assert (reading.stats.restarts, reading.stats.reopens) == (1, 0)

    play(story)


def test_a_template_that_is_stopped_is_replaced_when_a_process_is_asked_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(template, "ANSWER_S", 0.2)

    async def story() -> None:
        origin = made_for()
        bay = Bay("b1", tmp_path, origin)
        async with running(origin.run, bay.service.run):
            await bay.next(Quality.GOOD)
            process, (old,) = bay.process, named("gw-template")
            old.send_signal(signal.SIGSTOP)
            await bay.next(Quality.GOOD)
            assert bay.process == process
            process.kill()
            assert (await bay.next(Quality.PROCESS_FAULT)).detail == "vision process was killed by SIGKILL"
            assert (await bay.next(Quality.PROCESS_FAULT)).detail == "vision process could not be started"
            assert origin._answer_deadline.seconds == 0.4  # of the next; a template may be slow on a loaded machine
            await bay.next(Quality.GOOD)
            assert not psutil.pid_exists(old.pid)

    play(story)


@pytest.mark.mostly_long
@pytest.mark.parametrize("modules", [("no_such_module",), (f"{STAND_INS}_with_a_thread",)])
def test_where_no_template_can_be_made_processes_are_spawned(tmp_path: Path, modules: tuple[str, ...]) -> None:
    async def story() -> None:
        origin = made_for(*modules)
        bay = Bay("b1", tmp_path, origin)
        async with running(origin.run, bay.service.run):
            await bay.next(Quality.GOOD)
            assert started_by(bay.process) == "spawned"
            assert bay.readings[0].quality is Quality.GOOD  # and no fault before

    play(story)


def test_a_template_that_starts_slowly_is_neither_waited_for_nor_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def story() -> None:
        origin = made_for()
        monkeypatch.setattr(template, "READY_S", 0.0)  # its own deadline is 30 s
        bay = Bay("b1", tmp_path, origin)
        async with running(origin.run, bay.service.run):
            await bay.next(Quality.GOOD)
            assert started_by(bay.process) == "spawned"
            async with asyncio.timeout(PATIENCE_S):
                while not origin._ready:
                    await bay.next(Quality.GOOD)
            bay.process.kill()
            await bay.next(Quality.PROCESS_FAULT)
            await bay.next(Quality.GOOD)
            assert started_by(bay.process) == "forked"

    play(story)


def test_a_process_that_is_given_up_while_its_template_starts_is_reported_at_once_and_never_gets_its_job(
    tmp_path: Path,
) -> None:
    async def story() -> None:
        origin = made_for()
        received: list[object] = []
        bay = Bay("b1", tmp_path, origin)

        async def give_up() -> None:
            async with VisionSlot("b1", SystemClock(), FROM_VISION, template=origin) as slot:
                slot.start(Role("no_such_module", "gw-given-up", MarkerRadii(0.0, 0.0, 0)))
                slot.kill()
                received.extend(slot.messages())
            await bay.service.run()

        async with running(origin.run, give_up), asyncio.timeout(PATIENCE_S):
            await bay.next(Quality.GOOD)
            while {child.name() for child in psutil.Process().children()} != {"gw-template", "gw-worker-b1"}:
                await bay.next(Quality.GOOD)  # it was forked, and is about to be reaped
        assert received == [Gone("could not be started")]

    play(story)


def test_cancelled_at_any_moment_of_the_start_leaves_nothing(tmp_path: Path) -> None:
    async def story() -> None:
        for delay_s in (0, 0.02, 0.1, 0.3, 0.6):
            origin = made_for()
            bays = [Bay(f"b{n}", tmp_path, origin) for n in range(3)]
            async with running(origin.run, *(bay.service.run for bay in bays)):
                await asyncio.sleep(delay_s)

    play(story)


def test_what_a_template_has_forked_but_not_reported_is_ended_with_it(tmp_path: Path) -> None:
    """It is killed between the fork and its report: no process is left, not even a dead one."""
    template._inherit_orphans(True)
    try:
        subprocess.run([sys.executable, "-c", STRAYS], check=True)
        left = psutil.Process().children()
        assert {process.name() for process in left} == {"gw-stray"}
        kept, *_ = [process for process in left if process.status() != psutil.STATUS_ZOMBIE]
        template._end_strays("gw-stray", {kept.pid})
        assert psutil.Process().children() == [kept]
        template._end_strays("gw-stray", set())
        assert psutil.Process().children() == []
    finally:
        template._inherit_orphans(False)


STRAYS = """
import ctypes, os, signal
ctypes.CDLL(None).prctl(15, b"gw-stray", 0, 0, 0)
for _ in range(3):
    if not os.fork():
        if _:
            signal.pause()
        os._exit(0)
"""


MAIN = """
import asyncio, json, sys
from pathlib import Path
import psutil
from gateway.core.readings import Quality
from tests.e2e.test_vision_template import Bay, made_for

async def main():
    origin = made_for()
    bays = [Bay(f"b{n}", Path(sys.argv[1]), origin) for n in range(2)]
    tasks = [asyncio.create_task(run()) for run in (origin.run, *(bay.service.run for bay in bays))]
    for bay in bays:
        await bay.next(Quality.GOOD)
    print(json.dumps([child.pid for child in psutil.Process().children()]), flush=True)
    await asyncio.gather(*tasks)

asyncio.run(main())
"""


def test_all_of_them_end_with_the_gateway_even_if_it_is_killed(tmp_path: Path) -> None:
    command = [sys.executable, "-c", MAIN, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as gateway:
        assert gateway.stdout is not None
        family = [psutil.Process(pid) for pid in json.loads(gateway.stdout.readline())]
        assert sorted(process.name() for process in family) == ["gw-template", "gw-worker-b0", "gw-worker-b1"]
        for process in family[1:]:
            process.send_signal(signal.SIGSTOP)  # a hung process must end, too
        gateway.kill()
    assert survivors(family) == []
