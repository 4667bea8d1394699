"""What a detection method is to the rest of the gateway: one record. Docs: extending.md.

The record itself is light: the main process and `gateway check` load it, too. What needs OpenCV is `imported` when it
is called.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

from gateway.config import VisionConfig
from gateway.config.sections.vision import DETECTION_METHODS, keys_of
from gateway.core.detection import Detection
from gateway.registry import imported  # noqa: F401 - methods of other distributions take it from here
from gateway.vision.detect.radii import MarkerRadii

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from gateway.vision.pixels import Image, Pixels
    from gateway.vision.track.kalman_filter import Prediction

NowNs = Callable[[], int]


class Detector(Protocol):
    """Called frame by frame, in order: it may keep state between them."""

    def __call__(self, image: "Image", t_ns: int = 0) -> Detection:
        """`t_ns`: when the frame was captured, monotonic; a detector that follows the marker's motion needs it."""
        ...


class TimedPicture(NamedTuple):
    picture: "Pixels"
    t_ns: int  # when it was captured


@runtime_checkable
class Summing(Protocol):
    """A Detector, or a Search, that sums frames where one alone shows no marker."""

    def recent(self, frames: Sequence[TimedPicture]) -> None:
        """Before each call: the newest frames, oldest first, the last of them the one of the call."""
        ...

    def keeps(self, t_ns: int) -> int:
        """After a call: so many frames it may want before the next one; 1: only that itself."""
        ...


@runtime_checkable
class RadiusLimited(Protocol):
    """A Detector that uses the radii that the ranger's distance allows."""

    def expect(self, radii: MarkerRadii) -> None:
        """From the next frame on."""
        ...


class Search(Protocol):
    """Looks for the marker in one frame, for a `Follower`."""

    def __call__(
        self, image: "Image", t_ns: int, expected: "Prediction | None", radii_px: tuple[float, float] | None
    ) -> Detection:
        """`expected`: the predicted marker, None without a track. A hint where to search first, not what to find.

        It may be a poor one: see `Prediction.useful`. `radii_px`: the marker's radius lies between these; None:
        unknown.
        """
        ...


class MethodStage(NamedTuple):
    """A step of the method, timed in every frame."""

    name: str  # in `Detection.stage_ns`
    meaning: str
    equation: str = ""  # of the paper


@dataclass(frozen=True, slots=True)
class Panel:
    """One picture of the tuning page. `name` is what its address ends with."""

    name: str
    title: str
    detail: str
    image: "NDArray[Any]"  # BGR or grey, uint8
    lossless: bool = False  # masks: JPEG would blur them


@dataclass(frozen=True, slots=True)
class Remark:
    """On tried settings. `key`: the control that it belongs to; empty: to all of them."""

    text: str
    key: str = ""
    warning: bool = True


def _nothing_needed(params: VisionConfig) -> None:
    pass


def _no_panels(image: "Image", params: VisionConfig, found: Detection, scale: float) -> tuple[Panel, ...]:
    return ()


def _no_remarks(image: "Image", params: VisionConfig, found: Detection, reference: Detection) -> tuple[Remark, ...]:
    return ()


@dataclass(frozen=True, kw_only=True)
class Method:
    """A detection method. Found by `vision.method` through `detect/registry`."""

    name: str
    detector: Callable[[VisionConfig, NowNs], Detector]
    """Full frames, each by itself: `vision.tracking = false`."""
    search: Callable[[VisionConfig, NowNs], Search]
    """Frame after frame: what a `Follower` calls with its prediction."""
    once: Callable[[VisionConfig, NowNs], Detector] | None = None
    """As `detector`, with the same result, for a single frame: nothing is prepared for further ones."""
    check: Callable[[VisionConfig], None] = _nothing_needed
    """Before anything starts. Raises ConfigError where the settings need a file of the method that is not usable."""
    stages: tuple[MethodStage, ...]
    rejections: Mapping[str, str] = field(default_factory=dict)
    """`Rejection.why` -> meaning."""
    keys: tuple[str, ...] = ()
    """Of `[vision]`, beyond those that every method has."""
    uses_radius_limits: bool = False
    """It restricts the search to the radii that the ranger's distance allows."""
    deep: bool = False
    """It takes `Pixels`, so pictures with more than 8 bits, too; any other is given their 8-bit view."""
    corrects_tilt: bool = False
    """With intrinsics it reports the projected centre of a tilted disc, not the centre of its ellipse."""
    panels: Callable[["Image", VisionConfig, Detection, float], tuple[Panel, ...]] = _no_panels
    """Of an image, its settings and result, scaled: for the tuning page."""
    figures: Callable[["Image", VisionConfig, Detection], Mapping[str, "NDArray[Any]"]] | None = None
    """By name, for `gateway detect --stages`; without: the panels."""
    remarks: Callable[["Image", VisionConfig, Detection, Detection], Iterable[Remark]] = _no_remarks
    """On an image, tried settings, their result and the reference method's: for the tuning page."""

    def without_effect(self, params: VisionConfig) -> tuple[str, ...]:
        """The keys that were set and belong to another method: they have no effect."""
        others = {key for name in DETECTION_METHODS.names() for key in keys_of(name)} - {*self.keys}
        return tuple(key for key in VisionConfig.model_fields if key in params.model_fields_set and key in others)
