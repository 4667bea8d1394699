"""From a frame in memory to the register that a PLC would read: p50 and p99, while the other cores are busy.

    python -m bench.frame_to_register                     1080p, 30 frames a second, all ways
    python -m bench.frame_to_register --idle              without the busy cores
    python -m bench.frame_to_register --markdown          a table for bench/reports/performance.md

The ways:
- gateway: the real path. The clock starts when a frame is in the memory of the vision process. Capture thread ->
  detector -> main process -> fusion -> register image. With the paper's method tracked, in full search, and the plain
  OpenCV pipeline.
- thread: the plain pipeline in a thread of the main process, which gets the frame by reference.
- pickled pool: the plain pipeline in a process of `concurrent.futures`, which gets the frame pickled.

In every way the main process does the same: fusion with its tick every 20 ms, and the whole register image encoded for
each result. The clock stops when the words are complete. What the source itself takes (decoding) is not counted.
"""

import argparse
import asyncio
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from rich.progress import track

from bench.replay import LONGEST, Log, ReplaySpec
from bench.speed_scenes import SIZES, approach, back_and_forth
from bench.vision_speed import machine
from gateway import event_loop
from gateway.bay import BayControl
from gateway.clock import SystemClock
from gateway.config import BayConfig, CameraConfig, VisionConfig
from gateway.core.detection import Detection
from gateway.core.readings import Quality, VisionReading
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.hub import Hub
from gateway.modbus.protocol.answers import ReadImage
from gateway.modbus.registers.bay_unit import image_of
from gateway.modbus.registers.register_map import decode
from gateway.vision.detect.paper import pipeline
from gateway.vision.pixels import Image
from gateway.vision.process.vision_service import VisionService
from gateway.vision.transport.messages import DetectorSpec

WARM_UP = 15  # frames
# Until the parent is gone.
BURN = """import os
parent = os.getppid()
while os.getppid() == parent:
    sum(range(100_000))
"""
PAPER = VisionConfig(method="paper", tracking=False)


@dataclass(slots=True)
class Registers:
    """The main process's part: fusion, and the register image of every result."""

    clock: SystemClock
    ready_ns: dict[int, int] = field(default_factory=dict)  # by frame
    own_ns: list[int] = field(default_factory=list)  # fusion and encoding
    vision_ns: list[int] = field(default_factory=list)  # the stages
    bay: BayConfig = field(default_factory=BayConfig)
    control: BayControl = field(init=False)
    image: ReadImage = field(init=False)

    def __post_init__(self) -> None:
        self.control = BayControl(self.bay, Hub([self.bay.name]), self.clock)
        self.image = image_of(self.control.state, "big", self.clock)

    def on_vision(self, reading: VisionReading) -> None:
        began_ns = self.clock.now_ns()
        self.control.on_reading(reading)
        words = self.image()
        ended_ns = self.clock.now_ns()
        if not reading.frame_id:
            return
        if reading.quality is not Quality.GOOD:
            raise SystemExit(f"frame {reading.frame_id}: {reading.quality.name} {reading.detail}")
        if len(self.ready_ns) == WARM_UP:
            told = decode(words)
            assert told["frame_id"] == reading.frame_id, told
        self.ready_ns[reading.frame_id] = ended_ns
        self.own_ns.append(ended_ns - began_ns)
        self.vision_ns.append(sum(ns for _, ns in reading.stage_ns))


@dataclass(frozen=True, slots=True)
class Result:
    way: str
    total_ns: list[int]
    vision_ns: list[int]
    own_ns: list[int]


async def gateway_way(way: str, detector: DetectorSpec, work: "Work") -> Result:
    clock = SystemClock()
    registers = Registers(clock)
    log_path = work.folder / "log"
    log_path.write_bytes(bytes(LONGEST * 8))
    log = Log(log_path)
    spec = ReplaySpec(str(work.frames_file), str(log_path), work.fps)
    service = VisionService(
        "bay1", spec, CameraConfig(max_megapixels=8), detector.vision, clock, registers.on_vision, detector=detector
    )
    await _run_until(work.enough(registers), service.run(), registers.control.run())
    seqs = sorted(registers.ready_ns)[WARM_UP:]
    total = [int(registers.ready_ns[seq] - log.times[seq]) for seq in seqs]
    return Result(way, total, registers.vision_ns[WARM_UP:], registers.own_ns[WARM_UP:])


async def executor_way(way: str, executor: Executor, work: "Work") -> Result:
    """A feeder hands one frame after the other to an executor, as a simple program would."""
    clock = SystemClock()
    registers = Registers(clock)
    began: dict[int, int] = {}
    frames = np.load(work.frames_file)

    async def feed() -> None:
        running = asyncio.get_running_loop()
        due_ns, n = clock.now_ns(), 0
        while True:
            due_ns += round(NS_PER_S / work.fps)
            await clock.sleep(max(0, due_ns - clock.now_ns()) / NS_PER_S)
            n += 1
            began[n] = clock.now_ns()
            found: Detection = await running.run_in_executor(executor, look, frames[n % len(frames)])
            quality = Quality.NO_TARGET if found.circle is None else Quality.GOOD
            registers.on_vision(VisionReading(began[n], quality, found.circle, frame_id=n, stage_ns=found.stage_ns))

    await _run_until(work.enough(registers), feed(), registers.control.run())
    seqs = sorted(registers.ready_ns)[WARM_UP:]
    total = [registers.ready_ns[seq] - began[seq] for seq in seqs]
    return Result(way, total, registers.vision_ns[WARM_UP:], registers.own_ns[WARM_UP:])


def look(image: Image) -> Detection:
    cv2.setNumThreads(1)
    return pipeline.detect(image, PAPER, time.monotonic_ns)


async def _run_until(done: Awaitable[None], *tasks: Awaitable[None]) -> None:
    running = [asyncio.ensure_future(task) for task in tasks]
    try:
        finished, _ = await asyncio.wait(
            [asyncio.ensure_future(done), *running],
            return_when=asyncio.FIRST_COMPLETED,
        )
        for task in finished:
            task.result()
    finally:
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)


@dataclass(frozen=True, slots=True)
class Work:
    """What all ways have in common."""

    folder: Path
    frames_file: Path
    fps: float
    count: int

    async def enough(self, registers: Registers) -> None:
        """Until so many results are there; whoever counts them must not slow down what is timed."""
        while len(registers.ready_ns) < self.count + WARM_UP:  # noqa: ASYNC110
            await asyncio.sleep(0.05)


def ways(work: Work) -> dict[str, Callable[[], Awaitable[Result]]]:
    tracked = PAPER.model_copy(update={"tracking": True})

    def gateway(name: str, spec: DetectorSpec) -> Callable[[], Awaitable[Result]]:
        return lambda: gateway_way(name, spec, work)

    async def threaded() -> Result:
        with ThreadPoolExecutor(1) as pool:
            return await executor_way("thread, plain", pool, work)

    async def pickled() -> Result:
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
            return await executor_way("pickled pool, plain", pool, work)

    return {
        "gateway, exact tracked": gateway("gateway, exact tracked", DetectorSpec(tracked)),
        "gateway, exact full": gateway("gateway, exact full", DetectorSpec(PAPER)),
        "gateway, plain": gateway("gateway, plain", DetectorSpec(PAPER, "bench.replay:plain")),
        "thread, plain": threaded,
        "pickled pool, plain": pickled,
    }


def table_of(results: list[Result], markdown: bool) -> str:
    thread = next((r for r in results if r.way.startswith("thread")), None)
    head = (
        "way",
        "p50 ms",
        "p99 ms",
        "vision p50",
        "fusion and image p50",
        "the rest p50",
        "p50 x",
        "p99 x",
    )
    rows = []
    for r in results:
        p50, p99 = _ms(r.total_ns, 50), _ms(r.total_ns, 99)
        vision, own = _ms(r.vision_ns, 50), _ms(r.own_ns, 50)
        against = (
            ("", "")
            if thread is None
            else (f"{_ms(thread.total_ns, 50) / p50:.1f}", f"{_ms(thread.total_ns, 99) / p99:.1f}")
        )
        rows.append(
            (
                r.way,
                f"{p50:.3f}",
                f"{p99:.3f}",
                f"{vision:.3f}",
                f"{own:.3f}",
                f"{p50 - vision - own:.3f}",
                *against,
            )
        )
    if markdown:
        lines = ["| " + " | ".join(head) + " |", "|---|" + "---:|" * (len(head) - 1)]
        return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])
    widths = [max(len(row[n]) for row in (head, *rows)) for n in range(len(head))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in (head, *rows)]
    return "\n".join(lines)


def _ms(times_ns: list[int], percent: float) -> float:
    return float(np.percentile(times_ns, percent)) / NS_PER_MS


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", choices=SIZES, default="1080p")
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--frames", type=int, default=300, help="frames for each way and repeat (default 300)")
    parser.add_argument("--repeats", type=int, default=2, help="times over all ways, in turn (default 2)")
    parser.add_argument("--idle", action="store_true", help="keep no other core busy")
    parser.add_argument("--ways", nargs="+", help="only these, by how their names begin")
    parser.add_argument("--markdown", action="store_true", help="a Markdown table")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    burners = 0 if args.idle else max(1, (os.cpu_count() or 2) - 1)
    burn = [subprocess.Popen([sys.executable, "-c", BURN]) for _ in range(burners)]
    try:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            np.save(folder / "frames.npy", np.stack(back_and_forth(approach(*SIZES[args.size], 6))))
            work = Work(folder, folder / "frames.npy", args.fps, args.frames)
            chosen = {k: w for k, w in ways(work).items() if not args.ways or k.startswith(tuple(args.ways))}
            results: dict[str, Result] = {}
            turns = [way for _ in range(args.repeats) for way in chosen]
            for way in track(turns, "measuring", disable=not sys.stderr.isatty()):
                new = event_loop.run(_awaited(chosen[way]))
                old = results.get(way)
                results[way] = new if old is None else _joined(old, new)
    finally:
        for process in burn:
            process.kill()
            process.wait()
    print(machine())
    count = args.frames * args.repeats
    print(f"{args.size}, {args.fps:g} frames a second, {count} frames, {burners} busy process(es) beside")
    print()
    print(table_of(list(results.values()), args.markdown))


async def _awaited(way: Callable[[], Awaitable[Result]]) -> Result:
    return await way()


def _joined(a: Result, b: Result) -> Result:
    return Result(a.way, a.total_ns + b.total_ns, a.vision_ns + b.vision_ns, a.own_ns + b.own_ns)


if __name__ == "__main__":
    main()
