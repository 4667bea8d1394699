"""What the dispatcher wants done; the shell carries it out. A token names one process, never used twice."""

from dataclasses import dataclass

from gateway.core.model import VisionReading
from gateway.vision.transport.messages import FrameRef


@dataclass(frozen=True, slots=True)
class StartCamera:
    token: int
    first_seq: int
    slots: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class StartWorker:
    token: int


@dataclass(frozen=True, slots=True)
class Kill:
    """End this process; report `gone` when it is."""

    token: int
    why: str


@dataclass(frozen=True, slots=True)
class Assign:
    token: int
    frame: FrameRef


@dataclass(frozen=True, slots=True)
class Return:
    """Give a slot back to the camera."""

    token: int
    slot: int


@dataclass(frozen=True, slots=True)
class Offer:
    """Tell the camera that its next frame may go straight to this worker."""

    token: int
    worker: int


@dataclass(frozen=True, slots=True)
class Emit:
    reading: VisionReading


@dataclass(frozen=True, slots=True)
class GiveUp:
    """Only the operator can mend this."""

    why: str


Action = StartCamera | StartWorker | Kill | Assign | Return | Offer | Emit | GiveUp
