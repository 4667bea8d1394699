"""The paper's method as the rest of the gateway sees it."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from gateway.config import VisionConfig
from gateway.config.sections.vision import keys_of
from gateway.core.model import Detection
from gateway.vision.detect.method import Detector, Method, NowNs, Panel, Remark, Search, Stage

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from gateway.vision.pixels import Image

STAGES = (
    Stage("gaussian", "Gaussian blur", "1"),
    Stage("hsv", "BGR to HSV", "2, 3"),
    Stage("threshold", "the two red ranges", "4"),
    Stage("opening", "erosion, then dilation", "5-7"),
    Stage("closing", "dilation, then erosion", "5-7"),
    Stage("contours", "outer borders of the connected components"),
    Stage("select", "the largest that is valid", "8, 9"),
    Stage("circle", "minimum enclosing circle", "10"),
    Stage("normalise", "from the centre to a direction, where intrinsics are given", "11"),
)
"""In order."""

EXACT_STAGES = (
    Stage("scan", "where red can survive the opening: a grid of points", "1-7"),
    Stage("look", "the plain stages, in windows round what was found", "1-8"),
)
"""The exact search's; they replace all up to `contours`."""

TRACKED_STAGES = (
    Stage("window", "the plain stages, in a window round the marker's expected place", "1-8"),
    Stage("rescan", "an eighth of the grid: has anything red come elsewhere?", "1-7"),
)
"""The exact tracker's; a frame searched in full has the stages of the search after `window`, or after both."""


def _detector(params: VisionConfig, now_ns: NowNs) -> Detector:
    """On whole frames: by the shortcuts that change no bit, where they hold."""
    from gateway.vision.detect.paper.exact import search

    return search.of(params, now_ns) if search.ExactSearch.knows(params) else _once(params, now_ns)


def _once(params: VisionConfig, now_ns: NowNs) -> Detector:
    from gateway.vision.detect.paper import pipeline

    return lambda image, t_ns=0: pipeline.detect(image, params, now_ns)


def _search(params: VisionConfig, now_ns: NowNs) -> Search:
    from gateway.vision.detect.paper.exact import tracker
    from gateway.vision.detect.paper.exact.search import ExactSearch

    near = tracker.of(params, now_ns) if ExactSearch.knows(params) else _once(params, now_ns)
    return lambda image, t_ns, *_: near(image, t_ns)


def _panels(image: "Image", params: VisionConfig, found: Detection, scale: float) -> tuple[Panel, ...]:
    from gateway.vision.detect.paper import tuning_view

    return tuning_view.panels(image, params, scale)


def _remarks(image: "Image", params: VisionConfig, found: Detection, reference: Detection) -> Iterable[Remark]:
    from gateway.vision.detect.paper import tuning_view

    return tuning_view.remarks(image, params, found, reference)


def figures(image: "Image", params: VisionConfig, found: Detection) -> Mapping[str, "NDArray[Any]"]:
    """The paper's Figures 3 and 4."""
    from gateway.vision.detect.paper import pipeline
    from gateway.vision.view.figures import figure3, figure4

    trace = pipeline.trace(image, params)
    return figure3(trace) | figure4(trace)


METHOD = Method(
    name="paper",
    detector=_detector,
    search=_search,
    once=_once,
    stages=STAGES,
    keys=keys_of("paper"),
    panels=_panels,
    figures=figures,
    remarks=_remarks,
)
