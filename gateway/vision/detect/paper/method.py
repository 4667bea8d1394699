"""The paper's method as the rest of the gateway sees it."""

from gateway.config.sections.vision import keys_of
from gateway.registry import imported
from gateway.vision.detect.method import Method, MethodStage

STAGES = (
    MethodStage("gaussian", "Gaussian blur", "1"),
    MethodStage("hsv", "BGR to HSV", "2, 3"),
    MethodStage("threshold", "the two red ranges", "4"),
    MethodStage("opening", "erosion, then dilation", "5-7"),
    MethodStage("closing", "dilation, then erosion", "5-7"),
    MethodStage("contours", "outer borders of the connected components"),
    MethodStage("select", "the largest that is valid", "8, 9"),
    MethodStage("circle", "minimum enclosing circle", "10"),
    MethodStage("normalise", "from the centre to a direction, where intrinsics are given", "11"),
)
"""In order."""

EXACT_STAGES = (
    MethodStage("scan", "where red can survive the opening: a grid of points", "1-7"),
    MethodStage("look", "the plain stages, in windows round what was found", "1-8"),
)
"""The exact search's; they replace all up to `contours`."""

TRACKED_STAGES = (
    MethodStage("window", "the plain stages, in a window round the marker's expected place", "1-8"),
    MethodStage("rescan", "an eighth of the grid: has anything red appeared elsewhere?", "1-7"),
)
"""The exact tracker's; a frame searched in full has the stages of the search after `window`, or after both."""

METHOD = Method(
    name="paper",
    detector=imported("gateway.vision.detect.paper.exact.tracker:detector"),
    search=imported("gateway.vision.detect.paper.exact.tracker:tracked"),
    once=imported("gateway.vision.detect.paper.pipeline:detector"),
    stages=STAGES,
    keys=keys_of("paper"),
    panels=imported("gateway.vision.detect.paper.tuning_view:panels"),
    figures=imported("gateway.vision.view.figures:of_picture"),
    remarks=imported("gateway.vision.detect.paper.tuning_view:remarks"),
)
