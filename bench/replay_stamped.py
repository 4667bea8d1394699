"""What `bench.frame_stamps` runs in the vision process: frames in memory, each stamped at every step."""

import gc
import os
import resource
import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.replay import LONGEST, Replay, ReplaySpec
from gateway.clock import Clock
from gateway.processes.channel import Channel
from gateway.vision.process import vision_process
from gateway.vision.source.contract import Frame
from gateway.vision.transport.messages import FrameResult

STEPS = (
    "captured", "checked", "taken", "detected", "packed", "sent", "woken", "decoded", "monitored", "fused", "image set",
)  # fmt: skip
COUNTS = ("collections", "page faults", "waited ns", "ticks")
VISION_STEPS = STEPS[:6]
FIELDS = (*VISION_STEPS, *(f"vision {name}" for name in COUNTS[:3]))  # in the log of the vision process


class Counted:
    """Of the thread that first asks: what is not its own work. Differences count."""

    def __init__(self) -> None:
        self.collections = 0
        gc.callbacks.append(self._collected)
        self._schedstat = -1

    def _collected(self, phase: str, _: dict[str, int]) -> None:
        self.collections += phase == "start"

    def now(self) -> tuple[int, int, int]:
        if self._schedstat < 0:
            self._schedstat = os.open(f"/proc/self/task/{threading.get_native_id()}/schedstat", os.O_RDONLY)
        waited_ns = int(os.pread(self._schedstat, 100, 0).split()[1])
        return self.collections, resource.getrusage(resource.RUSAGE_THREAD).ru_minflt, waited_ns


@dataclass(frozen=True, slots=True)
class StampedSpec(ReplaySpec):
    """As `ReplaySpec`, in a vision process that stamps what it does."""

    def open(self, clock: Clock) -> "Stamped":
        return Stamped(self, clock)


class Stamped(Replay):
    def __init__(self, spec: ReplaySpec, clock: Clock) -> None:
        super().__init__(spec, clock)
        self._stamps = self._log.times[LONGEST:].reshape(LONGEST, len(FIELDS))
        _stamp_vision(self._stamps, clock.now_ns)

    def read(self) -> Frame:
        frame = super().read()
        self._stamps[self._n, 0] = frame.t_capture_ns
        return frame


def _stamp_vision(stamps: NDArray[np.int64], now_ns: Callable[[], int]) -> None:
    """In the vision process, before its first frame."""
    put, take = vision_process.NewestFrame.put, vision_process.NewestFrame.take
    detected, packed, send = vision_process.detected, Channel._packed, Channel.send
    counted = Counted()
    begun = [(0, 0, 0)]

    def put_(self: vision_process.NewestFrame, frame: vision_process.CheckedFrame, *, wait: bool) -> None:
        stamps[frame.seq, 1] = now_ns()
        put(self, frame, wait=wait)

    def take_(self: vision_process.NewestFrame, seconds: float) -> vision_process.CheckedFrame | None:
        begun[:] = [counted.now()]
        frame = take(self, seconds)
        if frame is not None:
            stamps[frame.seq, 2] = now_ns()
        return frame

    def detected_(detect, sums, frame, recent):  # type: ignore[no-untyped-def]
        found = detected(detect, sums, frame, recent)
        stamps[frame.seq, 3] = now_ns()
        return found

    def packed_(self, message):  # type: ignore[no-untyped-def]
        data = packed(self, message)
        if isinstance(message, FrameResult):
            stamps[message.seq, 4] = now_ns()
        return data

    def send_(self, message):  # type: ignore[no-untyped-def]
        send(self, message)
        if isinstance(message, FrameResult):
            stamps[message.seq, 5] = now_ns()
            stamps[message.seq, 6:9] = np.subtract(counted.now(), begun[0])

    vision_process.NewestFrame.put, vision_process.NewestFrame.take = put_, take_  # type: ignore[method-assign]
    vision_process.detected = detected_
    Channel._packed, Channel.send = packed_, send_  # type: ignore[method-assign]
