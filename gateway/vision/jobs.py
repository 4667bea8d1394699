"""What the main process and its children say to each other: one job at the start, then small messages.

A frame is never among them: messages carry the number of its slot in the shared memory. How they become bytes stands
in `wire`.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, cast

from gateway.clock import Clock
from gateway.model import Detection
from gateway.vision.shm import RingSpec
from gateway.vision.sources import SourceSpec

if TYPE_CHECKING:  # the main process need not load OpenCV, the camera process not the configuration's checker
    from gateway.config import VisionConfig
    from gateway.vision.pipeline import Detector, NowNs


@dataclass(frozen=True, slots=True)
class DetectorSpec:
    """Which detector a vision process builds: `module:function`, called once with the parameters and the clock."""

    vision: "VisionConfig"
    factory: str = "gateway.vision.methods:detector"

    def build(self, now_ns: "NowNs") -> "Detector":
        """`now_ns` times the stages."""
        module, _, name = self.factory.partition(":")
        return cast("Detector", getattr(import_module(module), name)(self.vision, now_ns))


@dataclass(frozen=True, slots=True)
class CameraJob:
    """Open the source and write its frames, numbered from `first_seq`, into the free slots."""

    spec: SourceSpec
    clock: Clock
    ring: RingSpec
    first_seq: int
    slots: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class WorkerJob:
    """Look at frames in place."""

    detector: DetectorSpec
    clock: Clock
    ring: RingSpec


@dataclass(frozen=True, slots=True)
class FrameRef:
    """A frame in the shared memory."""

    slot: int
    generation: int
    seq: int
    t_capture_ns: int


# To the children.


@dataclass(frozen=True, slots=True)
class Look:
    """To a worker: look at this frame."""

    frame: FrameRef


@dataclass(frozen=True, slots=True)
class GiveBack:
    """To the camera: this slot may be written again."""

    slot: int


@dataclass(frozen=True, slots=True)
class Straight:
    """To the camera: its next frame may go straight to this worker, whose inbox comes with it as a descriptor."""

    worker: int


# From the children.


@dataclass(frozen=True, slots=True)
class Opened:
    """The camera process has its source."""

    lossless: bool


@dataclass(frozen=True, slots=True)
class Captured:
    """A frame is whole. `skipped`: frames that found no free slot since the source was opened."""

    frame: FrameRef
    skipped: int


@dataclass(frozen=True, slots=True)
class Handed:
    """As `Captured`, of a frame that goes straight to `worker`, at `then_ns`. A note: it wakes nobody, and is always
    written before the worker can know of the frame."""

    frame: FrameRef
    skipped: int
    worker: int
    then_ns: int


@dataclass(frozen=True, slots=True)
class Ready:
    """A vision process has its detector."""


@dataclass(frozen=True, slots=True)
class Looked:
    """A result. None: there is no result, since the slot changed under the work, or a newer frame came first."""

    seq: int
    detection: Detection | None


ToChild = CameraJob | WorkerJob | Look | GiveBack | Straight
FromChild = Opened | Captured | Handed | Ready | Looked
