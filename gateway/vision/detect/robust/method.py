"""The robust method as the rest of the gateway sees it."""

from gateway.config.sections.vision import keys_of
from gateway.registry import imported
from gateway.vision.detect.method import Method, MethodStage

STAGES = (
    MethodStage(
        "expected",
        "with a window and a prediction: the rim there, its evidence and the gates; if it passes, the only stage",
    ),
    MethodStage("pyramid", "the picture reduced to a half, a quarter, ..."),
    MethodStage(
        "candidates",
        "votes of redness edges for centres, octave by octave; red blobs at several thresholds; a net's proposals, "
        "where `vision.proposals` names it",
    ),
    MethodStage("evidence", "rays from each candidate: rim by consensus, coverage, leak, contrast, fill"),
    MethodStage("rim", "the best few at full resolution: ellipse to sub-pixel, evidence on it"),
    MethodStage("decision", "gates, confidence, the best one"),
    MethodStage("veil", "in thick dust, unless a sure marker stands in clear air: all of it again, less the veil"),
    MethodStage("normalise", "the tilted disc's own centre and equation 11, where intrinsics are given"),
)
"""In order."""

REJECTIONS: dict[str, str] = {
    "rim": "no closed curve fits the edges round it",
    "radius": "smaller or larger than the radius limits",
    "shape": "too flat for a disc that faces the camera, or with straight sides and corners",
    "contrast": "not redder inside than outside by more than the noise and the texture there",
    "surroundings": "what lies round it is nearly as red: a stain or a reflection on a red ground",
    "colour": "another colour than the marker's, or too pale: orange, rust, skin, pink, grey",
    "coverage": "too little of the rim that lies in the picture is redder inside than outside",
    "leak": "the red continues outside the rim: a part of a larger red thing",
    "visible": "too little of the complete rim lies in the picture and shows an edge",
    "fill": "too little of the inside is red: an arc, a letter, a half of something",
    "hollow": "not red round the centre: a ring, a letter",
    "support": "too few edges lie on the rim",
    "blur": "a glow, not a disc: no rim that is sharp for its size",
    "confidence": "passes every gate, but too narrowly in too many: not round, not clear, not complete",
    "size": "a red disc, but at the ranger's distance the marker is larger or smaller",
    "weaker": "a red disc, but another one in this picture is larger or has much more evidence",
    "ambiguous": "a red disc, but another one is at least as large, and nothing tells which of them is the marker",
    "moved": "found in the mean of the newest frames, but it did not stand still in all of them",
    "jump": "with tracking: a red disc where the tracked marker cannot be, or of another size; not confirmed yet",
}
"""`Rejection.why` -> meaning."""

METHOD = Method(
    name="robust",
    detector=imported("gateway.vision.detect.robust.detect:FullFrameDetector"),
    search=imported("gateway.vision.detect.robust.frame_sum:search"),
    check=imported("gateway.vision.detect.robust.proposer_file:check"),
    stages=STAGES,
    rejections=REJECTIONS,
    keys=keys_of("robust"),
    uses_radius_limits=True,
    deep=True,
    corrects_tilt=True,
    panels=imported("gateway.vision.detect.robust.tuning_view:panels"),
    remarks=imported("gateway.vision.detect.robust.tuning_view:remarks"),
)
