"""Why a candidate was looked at and not taken: the one table of codes."""

REJECTION_MEANING: dict[str, str] = {
    "rim": "no closed curve fits the edges round it",
    "radius": "smaller or larger than the radius limits",
    "shape": "too flat for a disc that faces the camera",
    "contrast": "not redder inside than outside by more than the noise and the texture there",
    "surroundings": "what lies round it is nearly as red: a stain or a reflection on a red ground",
    "colour": "the inside is not red: blue, green, yellow or grey",
    "brown": "a weak red that leans to orange: rust, wood",
    "coverage": "too little of the rim that lies in the picture is redder inside than outside",
    "leak": "the red goes on outside the rim: a part of a larger red thing",
    "visible": "too little of the whole rim lies in the picture and shows an edge",
    "fill": "too little of the inside is red: an arc, a letter, a half of something",
    "hollow": "not red round the centre: a ring, the letter O",
    "support": "too few edges lie on the rim",
    "blur": "a glow, not a disc: no rim that is sharp for its size",
    "confidence": "passes every gate, but too narrowly in too many: not round, not clear, not whole",
    "size": "a red disc, but at the ranger's distance the marker is larger or smaller",
    "weaker": "a red disc, but another one in this picture has more evidence",
    "jump": "with tracking: a red disc where the marker that is followed can't be, or of another size; on trial",
}
"""`Rejection.why` -> meaning."""
