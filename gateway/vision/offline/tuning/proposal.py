"""What is proposed of examples: the gates of the paper's method, and the text for the configuration. Pure."""

import colorsys
import math
from collections.abc import Mapping, Sequence

import numpy as np

from gateway.vision.offline.evaluation.scoring import ScoredPicture
from gateway.vision.offline.tuning.samples import Example
from gateway.vision.offline.tuning.thresholds import Margin, Red

AREA_SHARE = 0.3  # of the smallest marker: half hidden, it still passes
SHAPE_SHARE = 0.9  # of the least round marker that was found
HIGHEST = 0.8  # a perfect disc has a circularity of 0.90; dirt and tilt take from it
FEWEST = 3  # markers found; fewer do not show how round others will be


def gates(found: Sequence[ScoredPicture]) -> dict[str, float]:
    """`min_area_px2`, and with enough markers found `min_circularity` and `min_fill`: what they leave room for."""
    radii = [o.label.major_px for o in found if o.label.major_px is not None]
    keys: dict[str, float] = {}
    if radii:
        keys["min_area_px2"] = _two_digits(AREA_SHARE * math.pi * min(radii) ** 2)
    on = [o.detection for o in found if o.on_target]
    if len(on) >= FEWEST:
        keys["min_circularity"] = _gate(min(detection.circularity for detection in on))
        keys["min_fill"] = _gate(min(detection.fill for detection in on))
    return keys


def _gate(least: float) -> float:
    return math.floor(20 * min(HIGHEST, SHAPE_SHARE * least)) / 20


def _two_digits(value: float) -> float:
    power = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(round(value / power) * power)


def robust(examples: Sequence[Example]) -> str:
    """The markers' colour, to paste where they are not red: the median of each one's pixels, and of these."""
    markers = [e.marker for e in examples if e.marked]
    turns = np.concatenate(markers)[:, 0] * (math.pi / 90)
    middle = round(math.atan2(np.sin(turns).sum(), np.cos(turns).sum()) * 90 / math.pi)
    cut = np.array([middle - 90, 0, 0])  # hue is cut open opposite to the markers' own, or a median would mix its ends
    h, s, v = np.median([np.median((m - cut) % (180, 256, 256), axis=0) for m in markers], axis=0) + cut
    colour = "".join(f"{round(255 * part):02x}" for part in colorsys.hsv_to_rgb(h % 180 / 180, s / 255, v / 255))
    return f'# For vision.method = "robust", unless the markers are red: marker_colour = "#{colour}"\n'


def toml(red: Red, margins: Sequence[Margin], gates: Mapping[str, float], examples: int) -> str:
    """`[vision]` to paste; each bound with the range in which it does as well."""
    room = {margin.name: f"{margin.low} to {margin.high} do as well" for margin in margins}
    keys = red.keys()
    high = {m.name: f"{180 - m.high} to {180 - m.low} do as well" for m in margins}["hue_low"]
    notes = {
        "red_low_1": f"S: {room['s_min']}; V: {room['v_min']}",
        "red_high_1": f"H: {room['hue_high']}",
        "red_low_2": f"H: {high}",
        "red_high_2": "",
    }
    lines = [
        f'# Proposed from {examples} marker{"" if examples == 1 else "s"}; for vision.method = "paper".',
        "[vision]",
    ]
    for key, value in keys.items():
        note = f"  # {notes[key]}" if notes[key] else ""
        lines.append(f"{key} = {list(value)}{note}")
    lines += [f"{key} = {value:g}" for key, value in gates.items()]
    return "\n".join(lines) + "\n"
