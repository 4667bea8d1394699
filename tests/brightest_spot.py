"""A detection method from outside the package: the brightest spot. See test_outside_method.py and docs/extending.md."""

from pathlib import Path

import numpy as np

from gateway.config import VisionConfig
from gateway.core.detection import Circle, Detection, Rejection
from gateway.vision.detect.method import Detector, Method, MethodStage, NowNs, Panel, Remark, Search
from gateway.vision.detect.stage_timer import StageTimer
from gateway.vision.pixels import Image

DARK = 200  # grey levels


def find(image: Image, params: VisionConfig, now_ns: NowNs) -> Detection:
    timer = StageTimer(now_ns)
    grey = image.max(axis=2)
    v, u = np.unravel_index(int(grey.argmax()), grey.shape)
    spot = Circle(float(u), float(v), 5.0)
    timer.ended("brightest")
    if grey[v, u] < DARK or params.min_confidence > 0.9:
        return Detection(None, candidates=1, rejected=(Rejection(spot, "dark"),), stage_ns=timer.stage_ns)
    return Detection(spot, candidates=1, confidence=0.9, stage_ns=timer.stage_ns)


def detector(params: VisionConfig, now_ns: NowNs) -> Detector:
    return lambda image, t_ns=0: find(image, params, now_ns)


def search(params: VisionConfig, now_ns: NowNs) -> Search:
    return lambda image, t_ns, expected, radii_px: find(image, params, now_ns)


METHOD = Method(
    name="brightest-spot",
    detector=detector,
    search=search,
    stages=(MethodStage("brightest", "the pixel with the largest channel"),),
    rejections={"dark": "no pixel is bright enough"},
    keys=("min_confidence",),
    panels=lambda image, params, found, scale: (Panel("grey", "Grey", "the largest channel", image.max(axis=2)),),
    remarks=lambda image, params, found, reference: (Remark("a remark of its own", "min_confidence"),),
)


def install(folder: Path) -> str:
    """What installing its distribution would leave in `folder`, which must come into `sys.path`; returns its name."""
    info = folder / "brightest_spot-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: brightest-spot\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[gateway.detection_methods]\n{METHOD.name} = {__name__}:METHOD\n")
    return METHOD.name
