"""The detection methods by name: what `vision.method` and `vision.tracking` ask for, ready to be called."""

from gateway.config import VisionConfig
from gateway.core.model import Detection
from gateway.vision.detect.paper import pipeline
from gateway.vision.detect.paper.exact import search, tracker
from gateway.vision.detect.paper.exact.search import ExactSearch
from gateway.vision.detect.paper.pipeline import Detector, NowNs
from gateway.vision.detect.radii import WITHDRAWN, MarkerRadii
from gateway.vision.detect.robust import detect as robust
from gateway.vision.detect.robust.roi_search import NearSearch
from gateway.vision.pixels import Image
from gateway.vision.track.follower import Follower


def detector(params: VisionConfig, now_ns: NowNs = lambda: 0) -> Detector:
    """To be called picture by picture, in order: with tracking it keeps state between them. `now_ns` times stages."""
    match params.method, params.tracking:
        case "paper", False:
            return _paper(params, now_ns)
        case "paper", _:
            near = tracker.of(params, now_ns) if ExactSearch.knows(params) else _paper(params, now_ns)
            return Follower(lambda image, t_ns, *_: near(image, t_ns), params.coast_s)
        case _, False:
            return Robust(params, now_ns)
        case _:
            return Follower(NearSearch(params, now_ns), params.coast_s)


class Robust:
    """The robust method without tracking: each picture by itself."""

    def __init__(self, params: VisionConfig, now_ns: NowNs) -> None:
        self._params = params
        self._now_ns = now_ns
        self._radii = WITHDRAWN

    def expect(self, radii: MarkerRadii) -> None:
        self._radii = radii

    def __call__(self, image: Image, t_ns: int = 0) -> Detection:
        return robust.detect(image, self._params, self._now_ns, radii_px=self._radii.at(t_ns))


def _paper(params: VisionConfig, now_ns: NowNs) -> Detector:
    """The paper's method on whole pictures: by the shortcuts that change no bit, where they hold."""
    if ExactSearch.knows(params):
        return search.of(params, now_ns)
    return lambda image, t_ns=0: pipeline.detect(image, params, now_ns)
