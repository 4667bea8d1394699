"""Why a candidate was looked at and not taken: the one table of codes."""

REJECTION_MEANING: dict[str, str] = {
    "radius": "smaller or larger than the radius limits",
    "rim": "no closed curve fits the edges round it",
    "coverage": "too little of the rim that lies in the picture shows an edge",
    "visible": "too little of the rim lies in the picture and shows an edge",
    "contrast": "not redder inside than outside by more than the noise and the texture there",
    "fill": "too little of the inside is red: a ring, an arc or a letter",
    "colour": "the inside is not red: blue, green, yellow or grey",
    "shape": "too flat for a disc that faces the camera",
    "weaker": "a red disc, but another one in this picture has more evidence",
}
"""`Rejection.why` -> meaning."""
