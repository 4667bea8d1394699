"""The detection methods by name: what `vision.method` and `vision.tracking` ask for, ready to be called."""

from gateway.config import VisionConfig
from gateway.vision import pipeline
from gateway.vision.follow import Follower
from gateway.vision.near import NearSearch
from gateway.vision.pipeline import Detector, NowNs
from gateway.vision.robust import detect as robust


def detector(params: VisionConfig, now_ns: NowNs = lambda: 0) -> Detector:
    """To be called picture by picture, in order: with tracking it keeps state between them. `now_ns` times stages."""
    match params.method, params.tracking:
        case "paper", False:
            return lambda image, t_ns=0: pipeline.detect(image, params, now_ns)
        case "paper", _:
            return Follower(lambda image, t_ns, _: pipeline.detect(image, params, now_ns), params.coast_s)
        case _, False:
            return lambda image, t_ns=0: robust.detect(image, params, now_ns)
        case _:
            return Follower(NearSearch(params, now_ns), params.coast_s)
