"""Where the time from a frame to the register image goes, frame by frame, and what made the slowest 1 % slow.

    python -m bench.frame_stamps                      1080p, 30 frames a second, paper's method tracked
    chrt -f 10 python -m bench.frame_stamps           at real-time priority, as the installed unit runs
    python -m bench.frame_stamps --method robust --frames 2000

Each frame is stamped at every step of both processes. What else happened to it is counted, too: garbage collections,
page faults, waiting for a CPU (schedstat), ticks of the control task in between.
"""

import argparse
import itertools
import os
import tempfile
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.frame_to_register import PAPER, WARM_UP, Registers, Work, _run_until
from bench.replay import LONGEST, Log
from bench.replay_stamped import COUNTS, FIELDS, STEPS, Counted, StampedSpec
from bench.speed_scenes import SIZES, approach, back_and_forth
from bench.vision_speed import machine
from gateway import event_loop
from gateway.bay import BayControl
from gateway.clock import SystemClock
from gateway.config import CameraConfig, VisionConfig
from gateway.core.readings import VisionReading
from gateway.core.state import Tick
from gateway.vision.process.monitor import ProcessMonitor
from gateway.vision.process.vision_service import VisionService
from gateway.vision.transport.messages import DetectorSpec


class StampedRegisters(Registers):
    """As `Registers`, in a main process that stamps what it does."""

    def stamp(self, service: VisionService) -> None:
        clock, self.counted = self.clock, Counted()
        self.rows: dict[int, tuple[int, ...]] = {}
        self.woken = self.decoded = 0
        self.before = self.counted.now()
        self.ticks_ns: list[int] = []
        arrived, result, step = service._arrived, ProcessMonitor.result, BayControl._step

        def arrived_() -> None:
            self.woken, self.before = clock.now_ns(), self.counted.now()
            arrived()

        def result_(monitor, token, found, now_ns):  # type: ignore[no-untyped-def]
            self.decoded = clock.now_ns()
            result(monitor, token, found, now_ns)

        def step_(control, observation, by=None):  # type: ignore[no-untyped-def]
            if isinstance(observation, Tick):
                self.ticks_ns.append(clock.now_ns())
            step(control, observation, by)

        service._arrived = arrived_  # type: ignore[method-assign]
        ProcessMonitor.result, BayControl._step = result_, step_  # type: ignore[method-assign]

    def on_vision(self, reading: VisionReading) -> None:
        began_ns = self.clock.now_ns()
        self.control.on_reading(reading)
        fused_ns = self.clock.now_ns()
        self.image()
        ended_ns = self.clock.now_ns()
        counts = np.subtract(self.counted.now(), self.before)
        if reading.frame_id:
            self.ready_ns[reading.frame_id] = ended_ns
            self.rows[reading.frame_id] = (self.woken, self.decoded, began_ns, fused_ns, ended_ns, *counts)


async def stamped(vision: VisionConfig, work: Work) -> NDArray[np.int64]:
    """(frames, STEPS and COUNTS): stamps and counts, ns."""
    registers = StampedRegisters(SystemClock())
    log_path = work.folder / "log"
    log_path.write_bytes(bytes(LONGEST * 8 * (1 + len(FIELDS))))
    spec = StampedSpec(str(work.frames_file), str(log_path), work.fps)
    service = VisionService(
        "bay1", spec, CameraConfig(max_megapixels=8), vision, registers.clock, registers.on_vision,
        detector=DetectorSpec(vision),
    )  # fmt: skip
    registers.stamp(service)
    await _run_until(work.enough(registers), service.run(), registers.control.run())
    log = Log(log_path).times[LONGEST:].reshape(LONGEST, len(FIELDS))
    ticks = np.array(registers.ticks_ns)
    found = []
    for seq in sorted(registers.rows)[WARM_UP:]:
        main = registers.rows[seq]
        own = log[seq]
        between = int(np.count_nonzero((ticks >= own[0]) & (ticks < main[4])))
        found.append((*own[:6], *main[:5], *np.add(own[6:9], main[5:8]), between))
    return np.array(found, np.int64)


def table_of(rows: NDArray[np.int64]) -> str:
    stamps = rows[:, : len(STEPS)] / 1e6
    steps = np.column_stack([np.diff(stamps, axis=1), stamps[:, -1] - stamps[:, 0]])
    total = steps[:, -1]
    slow = total >= np.percentile(total, 99)
    lines = ["| step, ms | p50 | p95 | p99 | p50 of the slowest 1 % | frames of these in which it lost most |"]
    lines.append("|---|---:|---:|---:|---:|---:|")
    excess = steps[slow, :-1] - np.median(steps[:, :-1], axis=0)
    worst = np.bincount(excess.argmax(axis=1), minlength=len(STEPS))
    for n, name in enumerate([f"{a} to {b}" for a, b in itertools.pairwise(STEPS)] + ["total"]):
        p50, p95, p99 = np.percentile(steps[:, n], [50, 95, 99])
        most = "" if name == "total" else str(worst[n])
        lines.append(f"| {name} | {p50:.3f} | {p95:.3f} | {p99:.3f} | {np.median(steps[slow, n]):.3f} | {most} |")
    lines += ["", "| beside it | all frames | slowest 1 % |", "|---|---:|---:|"]
    for n, name in enumerate(COUNTS, len(STEPS)):
        lines.append(f"| {name}, mean | {rows[:, n].mean():.2f} | {rows[slow, n].mean():.2f} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", choices=SIZES, default="1080p")
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--method", choices=("paper", "robust"), default="paper")
    parser.add_argument("--save", type=Path, help="the stamps themselves, ns: a .npy file")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    tracked = PAPER.model_copy(update={"tracking": True, "method": args.method})
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        np.save(folder / "frames.npy", np.stack(back_and_forth(approach(*SIZES[args.size], 6))))
        work = Work(folder, folder / "frames.npy", args.fps, args.frames)
        rows = event_loop.run(stamped(tracked, work))
    print(machine(), f"load {os.getloadavg()[0]:.1f}")
    print(table_of(rows))
    if args.save:
        np.save(args.save, rows)


if __name__ == "__main__":
    main()
