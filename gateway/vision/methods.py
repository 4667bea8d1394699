"""The detection methods by name: what `vision.method` and `vision.tracking` ask for, ready to be called."""

from gateway.config import VisionConfig
from gateway.vision import pipeline
from gateway.vision.follow import Follower
from gateway.vision.pipeline import Detector, NowNs


def detector(params: VisionConfig, now_ns: NowNs = lambda: 0) -> Detector:
    """To be called picture by picture, in order: with tracking it keeps state between them. `now_ns` times stages."""
    match params.method:
        case "paper":
            if not params.tracking:
                return lambda image, t_ns=0: pipeline.detect(image, params, now_ns)
            return Follower(lambda image, t_ns, _: pipeline.detect(image, params, now_ns), params.coast_s)
        case "robust":
            raise NotImplementedError
