"""How far is a disc from the marker's colour? By its hue and its chroma, whatever the light. Pure.

Light and shade scale all channels, dust adds the same to all: neither changes the hue. Chroma is redness relative to
what dust leaves of that of paint. A cast of the light is not taken off: a bluish picture may be a blue truck, and then
grey would become red. Nor is the cast that the fixed scene shows: it may lie in shade or in a low sun while the truck
does not, and then grey would become orange, and rust red.
"""

import colorsys
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol, cast

import numpy as np

from gateway.vision.detect.robust.constants import FULL_VEIL
from gateway.vision.detect.robust.evidence import Evidence
from gateway.vision.detect.robust.redness import DARK
from gateway.vision.detect.robust.veil import contrast_left
from gateway.vision.pixels import Pixels

PALE, FULL_REDNESS = 0.12, 0.3  # log units in clear air: not the marker below, and as red as needed from
LEAST_SATURATION, SATURATED = 0.12, 0.2  # the same, less the haze
NOISE, TINT = 1.0, 0.02  # grey levels, and of the veil's light: the channels' differences may be off by so much
BRIGHTEST, MOST_BLUE = 250.0, 1.0  # grey level that may be a clipped one; log(B / G), of over-exposed light red
CLIPPED_DEG = 1.5  # so much less towards yellow is the hue where the red is clipped
BROWN, BROWN_CONTRAST = 0.18, 0.9  # (G - B) / (R - B): paint 0.15 at most, rust 0.2 to 0.35; log units
VEILED_BROWN = -0.06  # so much more behind a full veil, whose tint is not known exactly
NEAR_DEG, FARTHEST_DEG = 8.0, 14.0  # from a taught hue: nothing is amiss; as far as can be
MOST_RED_DEG = 20.0
SEXTANT_DEG = 60.0  # of hue, from one pure colour to the next


@dataclass(frozen=True, slots=True)
class MarkerColour:
    """Hues, degrees, red 0, yellow 60: nothing is amiss between the inner two, and beyond the outer it is another."""

    hues_deg: tuple[float, float, float, float] = (-46.0, -25.0, 10.0, 13.5)
    order: tuple[int, int, int] | None = None  # of the channels, so that the marker is red in them; None: BGR
    brown: bool = False  # rust and wood may be the marker

    def seen(self, image: Pixels) -> Pixels:
        """The picture in the order of channels in which the marker is red."""
        return image if self.order is None else cast("Pixels", np.ascontiguousarray(image[..., self.order]))


PAPER_RED = MarkerColour()


class Lit(Protocol):
    """A surface as it is seen: `Evidence`, or any patch of a picture. Channels are those of `MarkerColour.seen`."""

    @property
    def colour(self) -> tuple[float, float, float]: ...
    @property
    def redness(self) -> float: ...
    @property
    def haze(self) -> float: ...
    @property
    def veil(self) -> float: ...


@lru_cache(maxsize=8)
def marker_of(text: str | None) -> MarkerColour:
    """Of `vision.marker_colour`. The greatest channel takes red's place and the least one green's, except near red."""
    if text is None:
        return PAPER_RED
    bgr = bytes.fromhex(text[1:])[::-1]
    hue_deg = hue(*bgr)
    order = None
    if not -SEXTANT_DEG <= hue_deg <= MOST_RED_DEG:
        least, middle, most = sorted(range(3), key=lambda channel: bgr[channel])
        order = middle, least, most
        hue_deg = hue(bgr[middle], bgr[least], bgr[most])
    hues_deg = hue_deg - FARTHEST_DEG, hue_deg - NEAR_DEG, hue_deg + NEAR_DEG, hue_deg + FARTHEST_DEG
    return MarkerColour(hues_deg, order, brown=order is not None or hue_deg > NEAR_DEG)


def paint_left(found: Lit) -> float:
    """1 in clear air: how much of the redness of paint, and of its contrast, the dust leaves."""
    return (1 - found.haze) * contrast_left(found.veil)


def distance(found: Lit, marker: MarkerColour) -> float:
    """0: of the marker's colour; 1: as far from it as can be; more: another colour."""
    pale = (FULL_REDNESS - found.redness / paint_left(found)) / (FULL_REDNESS - PALE)
    if pale <= 1:  # of dark paint redness says little (`redness.DARK`): its saturation may say more for it
        spread, most = max(found.colour) - min(found.colour), max(found.colour) - FULL_VEIL * found.haze
        grey = (SATURATED - spread / max(most, spread, 1.0)) / (SATURATED - LEAST_SATURATION)
        pale = min(pale, grey)
    return max(0.0, pale, _off_hue(found, marker))


def _off_hue(found: Lit, marker: MarkerColour) -> float:
    blue, green, red = found.colour
    clipped = red >= BRIGHTEST
    spread = max(blue, green, red) - min(blue, green, red)
    if spread < 1:
        return math.inf
    hue_deg = hue(blue, green, red)
    unsure_deg = SEXTANT_DEG * (NOISE + TINT * FULL_VEIL * max(found.haze, found.veil)) / spread
    least, low, high, most = marker.hues_deg
    if hue_deg < low:
        if clipped and math.log((blue + DARK) / (green + DARK)) <= MOST_BLUE:
            return 0.0
        return (low - hue_deg - unsure_deg) / (low - least)
    return (hue_deg - high - unsure_deg - CLIPPED_DEG * clipped) / (most - high)


def hue(blue: float, green: float, red: float) -> float:
    """HSV's, degrees, -180 to 180: 0 is red, 60 yellow, -60 magenta."""
    return (360 * colorsys.rgb_to_hsv(red, green, blue)[0] + 180) % 360 - 180


def not_brown(found: Evidence, marker: MarkerColour) -> bool:
    """Rust and wood lie between red and orange, and their redness is weak; the hue is the same through any veil."""
    blue, green, red = found.colour
    lean = (green - blue) / max(red - blue, 1.0)
    strong = found.contrast >= BROWN_CONTRAST * (1 - found.haze) / (1 - found.veil)
    return marker.brown or strong or lean <= BROWN + VEILED_BROWN * found.veil
