"""What the main process and a vision process send each other: one job at the start, then one message a frame.

A frame is never among them. The encoding is in `gateway/processes/codec.py`; a field that is added here, or to a
record in here, is sent automatically.
"""

from dataclasses import is_dataclass
from importlib import import_module
from typing import TYPE_CHECKING, cast

from msgspec import Struct
from msgspec import field as message_field

from gateway.clock import SystemClock
from gateway.config import BeaconConfig, VisionConfig
from gateway.core.detection import Detection
from gateway.core.readings import AgeProof, CameraExposure, PictureHealth
from gateway.errors import ProtocolError
from gateway.processes.channel import Failed
from gateway.processes.codec import Codec, Message, record_of, record_packed
from gateway.vision.detect.radii import MarkerRadii
from gateway.vision.exposure.settings import ExposureRules
from gateway.vision.source.contract import Needs, SourceSpec
from gateway.vision.source.frame_rules import FrameRules
from gateway.vision.source.v4l2_controls import ControlSetting, OfferedControl
from gateway.vision.transport.ring_spec import RingSpec

if TYPE_CHECKING:  # the main process need not load OpenCV
    from gateway.vision.detect.method import Detector, NowNs


class SourceRecord(Struct, frozen=True, array_like=True):
    """A `SourceSpec`, whose type the main process need not have: `module:Class`, and its fields.

    Only a job from the main process holds one. A message of a child can name no type.
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


class DetectorSpec(Struct, frozen=True, array_like=True):
    """Which detector a vision process builds: `module:function`, called once with the parameters and the clock."""

    vision: VisionConfig
    factory: str = "gateway.vision.detect.registry:detector"

    def build(self, now_ns: "NowNs") -> "Detector":
        """`now_ns` times the stages."""
        module, _, name = self.factory.partition(":")
        return cast("Detector", getattr(import_module(module), name)(self.vision, now_ns))


class VisionJob(Message, frozen=True):
    """Open the source, number its frames from `first_seq` on, and report what the detector finds in them."""

    token: int  # of this process, for its notes
    source: SourceRecord
    detector: DetectorSpec
    clock: SystemClock
    ring: RingSpec
    rules: FrameRules
    first_seq: int
    discard: int = 0  # frames at the beginning of a film that an earlier process has processed
    camera_affinity: tuple[int, ...] | None = None  # of the capture thread
    detector_beat_s: float = 0.25  # the detector's thread notes that it runs at least so often
    exposure: ExposureRules | None = None  # None: left to the camera
    needs: Needs | None = None  # of the source; None: the process keeps its rights
    beacon: BeaconConfig | None = None


class ControlsRequest(Message, frozen=True):
    """Set these over those of the file, complete; empty: as the file has it. `found`: what an earlier process found,
    to be put back. Answered by a `ControlsReport` of this number."""

    number: int = 0
    tried: tuple[ControlSetting, ...] = ()
    found: dict[str, int] = message_field(default_factory=dict)


class TemplateJob(Message, frozen=True):
    """For the template of the vision processes: what they will need."""

    detectors: tuple[DetectorSpec, ...]
    sources: tuple[str, ...]  # modules


# From the vision process.


class Ready(Message, frozen=True):
    """It has its detector, and opens the source."""


class Opened(Message, frozen=True):
    """The source has given its first frame."""

    lossless: bool
    finite: bool = False


class SourceLost(Message, frozen=True):
    """The source has ended, was lost, or cannot be opened. `config`: only the operator can change that."""

    why: str
    config: bool = False


class FrameResult(Message, frozen=True):
    """What the detector has found in a frame."""

    seq: int
    t_capture_ns: int
    detection: Detection
    unchanged_since_ns: int = 0  # what was found is as old: unchanged since, to the last bit, or of frames summed since
    picture: PictureHealth | None = None  # measured in the frame before; not judged yet
    exposure: CameraExposure | None = None  # None: left to the camera
    age_proof: AgeProof = AgeProof.UNPROVEN  # of t_capture_ns
    beacon_level: float | None = None  # of the newest frame; None: no beacon, or its place is not in the picture


class ControlsReport(Message, frozen=True):
    """The controls of the camera as they are now; none: it has none. `found`: what is to be put back when nothing is
    tried any more. `fault`: what the camera refuses; empty: nothing."""

    offered: tuple[OfferedControl, ...]
    number: int = 0
    found: dict[str, int] = message_field(default_factory=dict)
    fault: str = ""


FromVision = Ready | Opened | SourceLost | FrameResult | ControlsReport
FROM_VISION = Codec(FromVision | Failed)
ToVision = VisionJob | MarkerRadii | ControlsRequest
TO_VISION = Codec(ToVision, compressed=True)
