"""The detection methods by name: those of `vision.method` and `vision.tracking`, ready to be called."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast

from gateway.config import VisionConfig
from gateway.config.sections.vision import DETECTION_METHODS
from gateway.core.detection import Detection
from gateway.vision.detect.method import Detector, Method, NowNs

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from gateway.vision.pixels import AnyImage, Image


def method(name: str) -> Method:
    """Raises ConfigError for a name that no method has."""
    return cast(Method, DETECTION_METHODS.load(name))


def methods() -> tuple[Method, ...]:
    return tuple(method(name) for name in DETECTION_METHODS.names())


def detector(params: VisionConfig, now_ns: NowNs = lambda: 0) -> Detector:
    """To be called frame by frame, in order: with tracking it keeps state between them. `now_ns` times the stages."""
    made = method(params.method)
    if params.tracking:
        from gateway.vision.track.follower import Follower  # noqa: PLC0415 - NumPy stays out of the main process

        return Follower(made.search(params, now_ns), params.coast_s)
    return made.detector(params, now_ns)


def once(params: VisionConfig, now_ns: NowNs = lambda: 0) -> Detector:
    """For a single frame: without tracking, and without what would be prepared for further frames."""
    made = method(params.method)
    return (made.once or made.detector)(params, now_ns)


def given(params: VisionConfig, pixels: "AnyImage") -> "Image":
    """What the method is given of a picture: all its bits where it takes more than 8."""
    from gateway.vision.pixels import bgr8  # noqa: PLC0415

    return cast("Image", pixels) if method(params.method).deep else bgr8(pixels)


def rejection_meanings() -> dict[str, str]:
    """`Rejection.why` -> meaning, of every method."""
    return {code: meaning for made in methods() for code, meaning in made.rejections.items()}


def stage_pictures(params: VisionConfig, image: "Image", found: Detection) -> Mapping[str, "NDArray[Any]"]:
    """By name: the method's figures of a frame, or its panels where it has none."""
    made = method(params.method)
    if made.figures is not None:
        return made.figures(image, params, found)
    return {panel.name: panel.image for panel in made.panels(image, params, found, 1.0)}
