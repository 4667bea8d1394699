"""The job of a vision process: which detector it builds. Apart from the other messages, for it loads the settings."""

from importlib import import_module
from typing import TYPE_CHECKING, cast

from msgspec import Struct

from gateway.clock import SystemClock
from gateway.config import VisionConfig
from gateway.processes.codec import Message
from gateway.vision.transport.ring import RingSpec

if TYPE_CHECKING:  # the main process need not load OpenCV
    from gateway.vision.detect.method import Detector, NowNs


class DetectorSpec(Struct, frozen=True, array_like=True):
    """Which detector a vision process builds: `module:function`, called once with the parameters and the clock."""

    vision: VisionConfig
    factory: str = "gateway.vision.detect.registry:detector"

    def build(self, now_ns: "NowNs") -> "Detector":
        """`now_ns` times the stages."""
        module, _, name = self.factory.partition(":")
        return cast("Detector", getattr(import_module(module), name)(self.vision, now_ns))


class WorkerJob(Message, frozen=True):
    """Look at frames in place."""

    detector: DetectorSpec
    clock: SystemClock
    ring: RingSpec
