"""The interface of every source of frames. `specs` finds the one of `camera.url`.

A source lives in the capture thread of the vision process: it may block, and when it hangs, the process is replaced.
All frames are checked there (`checks`): their size, and that the picture is new.
"""

from dataclasses import dataclass, field
from enum import Enum, auto
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from gateway.clock import Clock
from gateway.core.readings import AgeProof
from gateway.vision.exposure.settings import Exposure, ExposureLimits, ExposureRules
from gateway.vision.source.v4l2_controls import CameraControls

if TYPE_CHECKING:
    from gateway.vision.pixels import AnyImage, Image


@dataclass(frozen=True, slots=True)
class Frame:
    """One picture and the time it was taken, as far as its source reports it. The source never writes it again: it is
    processed in place while further ones are read."""

    pixels: "AnyImage"  # (H, W, 3), BGR; the data type says what is white: uint8, or uint16 of more than 8 bits
    t_capture_ns: int
    # Frames since the one before that were lost on their way, or could not be decoded and were skipped.
    damaged: int = field(default=0, kw_only=True)
    # What shows that it was not taken earlier. A source that can't know leaves it: `camera.unproven_age` decides then.
    age_proof: AgeProof = field(default=AgeProof.UNPROVEN, kw_only=True)

    @property
    def image(self) -> "Image":
        """In 8 bits; made anew of more of them."""
        from gateway.vision.pixels import bgr8  # noqa: PLC0415 - NumPy stays out of the main process

        return bgr8(self.pixels)


class ExposureControls(Protocol):
    """A camera's exposure time and gain. Used in the capture thread only."""

    @property
    def limits(self) -> ExposureLimits: ...

    @property
    def controls_gain(self) -> bool:
        """False: its gain is unknown, and stays what it is."""

    @property
    def now(self) -> Exposure:
        """What it was set to last, or was found at."""

    def set(self, exposure: Exposure) -> Exposure:
        """Returns what it is set to now: a driver may round. Raises LinkError where the camera refuses."""


class Source(Protocol):
    """An opened source of frames. To be subclassed: the defaults are those of a camera."""

    lossless: bool = False
    """True: every frame is wanted, so wait for the detector (files as fast as possible). False: newest frame wins."""
    may_repeat: bool = False
    """True: equal pictures are new ones all the same (files, drawings). False: a sensor's noise makes them differ."""
    finite: bool = False
    """True: it ends, and is not opened again: the same pictures would look like new ones."""

    def read(self) -> Frame:
        """The next frame; blocks until there is one. Raises LinkError when the source ended or was lost."""

    def close(self) -> None:
        """Release the device; may be called more than once. For a process that continues: the vision process ends."""


@runtime_checkable
class ExposureControlled(Protocol):
    """A Source whose exposure can be set: `camera.exposure = "marker"`."""

    def exposure_controls(self, rules: ExposureRules) -> ExposureControls | None:
        """Switch the camera's own automatic exposure off; called once, after opening. None: it has no exposure time
        that can be set. Raises LinkError where the camera refuses."""


@runtime_checkable
class Controlled(Protocol):
    """A Source whose controls can be read and tried: `[camera.controls]`."""

    def controls(self) -> CameraControls:
        """Used in the capture thread only. Raises LinkError where there are none now."""


class Needs(Enum):
    """What a source needs of its process while it is open; all else is refused by the kernel (`processes/seccomp`)."""

    FILES = auto()  # to read files, or nothing
    DEVICE = auto()  # nothing but what `open` has opened: the rest is refused after it, before the first frame is read
    CONNECTIONS = auto()  # to open connections, and to read files


class SourceSpec(Protocol):
    """What is sent to the vision process instead of a source: a small dataclass that opens one there. Its
    fields are data: numbers, texts, settings, and records of these. With a class attribute `needs` (`Needs`) the
    process gives up all other rights; without it keeps them."""

    @property
    def label(self) -> str:
        """For messages: no passwords in it."""

    def open(self, clock: Clock) -> Source:
        """Open the source. Raises LinkError where it cannot be had, ConfigError where it never could."""
