"""What the main process and its children say to each other: one job at the start, then small messages.

A frame is never among them: messages carry the number of its slot in the shared memory. How they become bytes stands
in `gateway/processes/codec.py`; a field that is added here, or to a record in here, travels by itself.
"""

from dataclasses import is_dataclass
from importlib import import_module
from typing import cast

from msgspec import Struct

from gateway.clock import SystemClock
from gateway.core.model import Detection, PictureHealth
from gateway.errors import ProtocolError
from gateway.processes.codec import Codec, Message, record_of, record_packed
from gateway.processes.notices import Failed
from gateway.vision.source.checks import FrameRules
from gateway.vision.source.contract import SourceSpec
from gateway.vision.transport.ring import RingSpec


class SourceRecord(Struct, frozen=True, array_like=True):
    """A `SourceSpec`, whose type the main process need not know: `module:Class`, and its fields.

    Only a job from the main process holds one. What comes from a child can name no type.
    """

    kind: str
    fields: bytes

    @staticmethod
    def of(spec: SourceSpec) -> "SourceRecord":
        kind = type(spec)
        return SourceRecord(f"{kind.__module__}:{kind.__qualname__}", record_packed(spec))

    def spec(self) -> SourceSpec:
        """Raises ProtocolError."""
        module, _, name = self.kind.partition(":")
        kind = getattr(import_module(module), name, None)
        if not (isinstance(kind, type) and is_dataclass(kind)):
            raise ProtocolError(f"{self.kind} is no record of a source")
        return cast("SourceSpec", record_of(kind, self.fields))


class CameraJob(Message, frozen=True):
    """Open the source and write its frames, numbered from `first_seq`, into the free slots."""

    source: SourceRecord
    clock: SystemClock
    ring: RingSpec
    first_seq: int
    slots: tuple[int, ...]
    rules: FrameRules


class FrameRef(Struct, frozen=True, array_like=True):
    """A frame in the shared memory."""

    slot: int
    generation: int
    seq: int
    t_capture_ns: int


# To the children.


class Look(Message, frozen=True):
    """To a worker: look at this frame."""

    frame: FrameRef


class GiveBack(Message, frozen=True):
    """To the camera: this slot may be written again."""

    slot: int


class Straight(Message, frozen=True):
    """To the camera: its next frame may go straight to this worker, whose inbox comes with it as a descriptor."""

    worker: int


# From the children.


class Opened(Message, frozen=True):
    """The camera process has its source."""

    lossless: bool
    finite: bool = False


class Captured(Message, frozen=True):
    """A frame is whole. `skipped`: frames that found no free slot since the source was opened."""

    frame: FrameRef
    skipped: int


class Handed(Message, frozen=True):
    """As `Captured`, of a frame that goes straight to `worker`, at `then_ns`. A note: it wakes nobody, and is always
    written before the worker can know of the frame."""

    frame: FrameRef
    skipped: int
    worker: int
    then_ns: int


class Ready(Message, frozen=True):
    """A vision process has its detector."""


class Looked(Message, frozen=True):
    """A result. None: there is no result, since the slot changed under the work, or a newer frame came first."""

    seq: int
    detection: Detection | None
    seen_ns: int = 0  # since when what was found has been in the picture unchanged, to the last bit
    picture: PictureHealth | None = None  # measured in this frame; not judged yet


FromChild = Opened | Captured | Handed | Ready | Looked
FROM_CHILDREN = Codec(FromChild | Failed)
