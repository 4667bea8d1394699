"""What the latency benchmark runs in the gateway's vision process: frames in memory as a source, and the baseline."""

import mmap
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gateway.clock import Clock
from gateway.config import VisionConfig
from gateway.core.readings import AgeProof
from gateway.durations import NS_PER_S
from gateway.vision.detect.method import Detector, NowNs
from gateway.vision.detect.paper import pipeline
from gateway.vision.source.contract import Frame

LONGEST = 100_000  # frames in the log


class Log:
    """When each frame was in the vision process's memory, written by its source. A file, mapped."""

    def __init__(self, path: Path) -> None:
        with path.open("r+b") as file:
            self._memory = mmap.mmap(file.fileno(), 0)
        self.times = np.frombuffer(self._memory, np.int64)


@dataclass(frozen=True, slots=True)
class ReplaySpec:
    """Frames of a file in memory, one every period, as a camera gives them."""

    frames: str
    log: str
    fps: float
    label: str = "frames in memory"

    def open(self, clock: Clock) -> "Replay":
        return Replay(self, clock)


class Replay:
    lossless = False
    may_repeat = True
    finite = False

    def __init__(self, spec: ReplaySpec, clock: Clock) -> None:
        self._frames = np.load(spec.frames)
        self._clock = clock
        self._period_ns = round(NS_PER_S / spec.fps)
        self._log = Log(Path(spec.log))
        self._n = 0
        self._due_ns = clock.now_ns() + self._period_ns

    def read(self) -> Frame:
        self._clock.block(max(0, self._due_ns - self._clock.now_ns()) / NS_PER_S)
        self._due_ns += self._period_ns
        image = self._frames[self._n % len(self._frames)]
        self._n += 1
        now_ns = self._clock.now_ns()
        self._log.times[self._n] = now_ns
        return Frame(image, now_ns, age_proof=AgeProof.OWN_CLOCK)

    def close(self) -> None:
        pass


def plain(params: VisionConfig, now_ns: NowNs) -> Detector:
    """The detector that a vision process builds for the baseline."""
    return lambda image, t_ns=0: pipeline.detect(image, params, now_ns)
