"""The camera's settings judged by a picture: exposure, noise, blur, white balance. Pure."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.core.detection import Circle
from gateway.vision.offline.tuning.samples import INSIDE, disc
from gateway.vision.pixels import Image

CLIPPED = 250
RAYS = 64
SECTORS = 8  # of the half turn in which an edge may be blurred
_REACH = (0.6, 1.4)  # of R: where a ray begins and ends


@dataclass(frozen=True, slots=True)
class PictureLight:
    """Figures of one picture; None: cannot be measured in it."""

    clipped: float  # share of the full frame that is clipped in all channels
    marker_clipped: float | None  # share of the marker whose red channel is clipped
    marker_v: float | None  # median of the marker's largest channel, 0 to 255
    marker_s: float | None  # median of its saturation
    noise: float  # standard deviation, grey levels
    edge_px: float | None  # 10 to 90 % width of the rim, the sharpest direction
    smear_px: float | None  # length of a motion blur that explains where the rim is wider; 0: none does
    smear_deg: float | None  # direction of it: 0 along u, 90 along v
    warmth: float | None  # red over blue of what should be grey; 1: neutral


def measure(image: Image, circle: Circle | None) -> PictureLight:
    """`image` as the camera gave it, not blurred."""
    clipped = float((image.min(axis=2) >= CLIPPED).mean())
    marker = image[disc(image, circle, INSIDE)] if circle else np.empty((0, 3), np.uint8)
    edge_px, smear_px, smear_deg = _edges(image, circle) if circle else (None, None, None)
    seen = len(marker) > 0
    top = marker.max(axis=1) if seen else None
    low = marker.min(axis=1) if seen else None
    saturation = None
    if top is not None and low is not None:
        saturation = float(np.median(255.0 * (top.astype(float) - low) / np.maximum(top, 1)))
    return PictureLight(
        clipped=clipped,
        marker_clipped=float((marker[:, 2] >= CLIPPED).mean()) if seen else None,
        marker_v=float(np.median(top)) if top is not None else None,
        marker_s=saturation,
        noise=noise(image),
        edge_px=edge_px,
        smear_px=smear_px,
        smear_deg=smear_deg,
        warmth=_warmth(image),
    )


def noise(image: Image) -> float:
    """Of a single pixel, from the response of a kernel that slopes and edges hardly touch (Immerkaer), by its median:
    texture in less than half of the picture does not count."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32)
    if min(grey.shape) < 8:
        return 0.0
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    response = np.abs(cv2.filter2D(grey, cv2.CV_32F, kernel)[1:-1, 1:-1])
    used = (grey[1:-1, 1:-1] > 4) & (grey[1:-1, 1:-1] < CLIPPED)  # where it is clipped there is no noise to see
    if np.count_nonzero(used) < 100:
        return 0.0
    grey_sigma = float(np.median(response[used])) / 0.6745 / 6
    return grey_sigma / math.sqrt(0.299**2 + 0.587**2 + 0.114**2)  # grey averages the channels' own noise


def advice(lights: Sequence[PictureLight]) -> list[str]:
    """Changes to make at the camera, as text, the most harmful first; one line where nothing is to be changed."""
    advice = []
    clipped = _middle(light.marker_clipped for light in lights)
    v = _middle(light.marker_v for light in lights)
    if clipped is not None and clipped > 0.05:
        advice.append(
            f"over-exposed: the red channel is clipped in {100 * clipped:.0f} % of the marker, its colour is lost "
            "there; shorten the exposure or lower the gain until the marker's red is about 200"
        )
    elif v is not None and v < 70:
        advice.append(
            f"too dark: the marker's brightest channel is {v:.0f} of 255; more light, or a longer exposure by "
            f"{math.log2(150 / max(v, 1)):.1f} stops if motion allows"
        )
    white = _middle(light.clipped for light in lights)
    if white is not None and white > 0.05:
        advice.append(
            f"{100 * white:.0f} % of the picture is clipped to white: expose for the marker, shade lamp or sky"
        )
    s = _middle(light.marker_s for light in lights)
    if s is not None and s < 80:
        advice.append(
            f"pale: the marker's saturation is {s:.0f} of 255; haze, dust on lens or marker, glare, or old paint"
        )
    grain = _middle(light.noise for light in lights)
    if grain is not None and grain > 6:
        advice.append(f"noisy: {grain:.0f} grey levels; lower the gain and give more light")
    smears = [light for light in lights if light.smear_px is not None and light.smear_px > 2]
    if len(smears) * 2 > sum(light.smear_px is not None for light in lights):
        smear = _middle(light.smear_px for light in smears) or 0.0
        turns = [math.radians(2 * (light.smear_deg or 0.0)) for light in smears]  # 179 degrees are next to 0
        along = math.degrees(math.atan2(sum(map(math.sin, turns)), sum(map(math.cos, turns))) / 2) % 180
        advice.append(
            f"motion blur: about {smear:.0f} px, along {along:.0f} degrees (0: level); an exposure of "
            f"1/{smear:.0f} of today's would leave 1 px"
        )
    edge = _middle(light.edge_px for light in lights)
    if edge is not None and edge > 5:
        advice.append(f"out of focus: the rim is {edge:.0f} px wide in its sharpest direction; 2 to 4 is sharp")
    warmth = _middle(light.warmth for light in lights)
    if warmth is not None and not 0.8 <= warmth <= 1.25:
        advice.append(
            f"colour cast: red over blue is {warmth:.2f} in what should be grey (above 1: warm, below: cold); set the "
            "white balance on grey concrete in the working light and lock it: an automatic one follows the truck"
        )
    return advice or ["exposure, noise, focus and white balance are fine in these pictures"]


def _edges(image: Image, circle: Circle) -> tuple[float | None, float | None, float | None]:
    """Width of the rim by direction, from redness along rays. All None: the rim does not stand out."""
    redness = image[:, :, 2].astype(np.float32) - image[:, :, :2].mean(axis=2)
    angles = 2 * np.pi * np.arange(RAYS) / RAYS
    steps = max(24, round(4 * (_REACH[1] - _REACH[0]) * circle.radius_px))  # four a pixel
    radius = np.linspace(*_REACH, steps) * circle.radius_px
    u = circle.u_px + np.outer(np.cos(angles), radius)
    v = circle.v_px + np.outer(np.sin(angles), radius)
    inside = (u > 0) & (v > 0) & (u < image.shape[1] - 1) & (v < image.shape[0] - 1)
    profiles = cv2.remap(redness, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR)
    step_px = float(radius[1] - radius[0])
    by_ray: list[float | None] = []
    for profile, complete in zip(np.asarray(profiles), inside.all(axis=1), strict=True):
        by_ray.append(_width(profile, step_px) if complete else None)
    # Motion and focus blur both ends of a diameter; a shadow on a ball, one. So the sharper end counts.
    half = RAYS // 2
    spans = [[w for w in (by_ray[n], by_ray[n + half]) if w is not None] for n in range(half)]
    each = half // SECTORS
    widths = [[min(span) for span in spans[n * each : (n + 1) * each] if span] for n in range(SECTORS)]
    if not all(widths):
        return None, None, None
    squares = np.array([float(np.median(found)) for found in widths]) ** 2
    # A smear of L along phi: width^2 = sharp^2 + (L cos(angle - phi))^2, linear in cos and sin of twice the angle.
    centres = np.pi * (np.arange(SECTORS) + 0.5 - 0.5 / each) / SECTORS
    terms = np.column_stack((np.ones(SECTORS), np.cos(2 * centres), np.sin(2 * centres)))
    fit = np.linalg.lstsq(terms, squares, rcond=None)[0]
    left = squares - terms @ fit
    _, c, d = (float(value) for value in fit)
    spread = float(((squares - squares.mean()) ** 2).sum())
    follows = spread > 0 and float((left**2).sum()) < 0.4 * spread
    smear_px = math.sqrt(2 * math.hypot(c, d)) / 0.8 if follows else 0.0  # a box of L rises from 10 to 90 % in 0.8 L
    return float(np.sqrt(squares.min())), smear_px, math.degrees(math.atan2(d, c) / 2) % 180


def _width(profile: NDArray[np.float32], step_px: float) -> float | None:
    """10 to 90 % width of a falling edge, px; None: no clear one."""
    tail = max(3, len(profile) // 6)
    top, floor = float(np.median(profile[:tail])), float(np.median(profile[-tail:]))
    if top - floor < 25:
        return None
    level = (profile - floor) / (top - floor)
    falls = np.flatnonzero((level[:-1] >= 0.5) & (level[1:] < 0.5))
    if len(falls) != 1:
        return None  # several edges, or none
    at = int(falls[0])
    above = np.flatnonzero(level[: at + 1] >= 0.9)
    below = np.flatnonzero(level[at:] <= 0.1)
    if not len(above) or not len(below):
        return None
    return float((at + below[0] - above[-1]) * step_px)


def _warmth(image: Image) -> float | None:
    """Red over blue of pixels that are nearly grey; None: there are too few."""
    top, low = image.max(axis=2).astype(np.int16), image.min(axis=2).astype(np.int16)
    # Under a cast grey itself gains saturation, so the limit is generous.
    grey = (255 * (top - low) <= 110 * top) & (top > 50) & (top < CLIPPED)
    if grey.mean() < 0.02:
        return None
    blue, _, red = (float(np.median(image[:, :, channel][grey])) for channel in range(3))
    return red / max(blue, 1.0)


def _middle(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None
