"""The stages of a trial as pictures side by side: the paper's of Figure 3, or what the robust method looks at. Pure."""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.config import VisionConfig
from gateway.core.model import Detection, Ellipse
from gateway.vision.detect.paper import pipeline
from gateway.vision.detect.robust.redness import redness
from gateway.vision.detect.robust.rejections import REJECTION_MEANING
from gateway.vision.pixels import Image
from gateway.vision.view.drawing import CENTRE, INK, REFUSED, RIM, WHITE, curve, ring, scaled, to_scale, write
from gateway.vision.view.overlay import annotated, counted, rim_of

WIDTH_PX = 480  # of a panel, unless asked otherwise
LARGEST_PX = 1920
FULL_REDNESS = 1.5  # log units shown as white
RAYS = 120  # on which the rim is shown
_AROUND = 1.35  # of the semi-major axis: what the rim's panel shows
_REACH = 0.25  # of the semi-minor axis: how far along a ray an edge is looked for
_STEP = 0.25  # of a pixel
_CLEAR = 0.3  # of the median fall of redness: less is no edge


@dataclass(frozen=True, slots=True)
class Panel:
    """One picture. `name` is what its address ends with."""

    name: str
    title: str
    detail: str
    image: NDArray[np.uint8]  # BGR or grey
    lossless: bool  # masks: JPEG would blur what is to be looked at


@dataclass(frozen=True, slots=True)
class Edges:
    """Where red less green falls steepest across a rim, by ray. `points` (n, 2): u, v px; `off_px`: from the rim."""

    points: NDArray[np.float64]
    off_px: NDArray[np.float64]


def panels(image: Image, settings: VisionConfig, found: Detection, width_px: int = WIDTH_PX) -> tuple[Panel, ...]:
    """Of the method that `settings` name. `found`: what it made of this picture."""
    scale = _scale(image, width_px)
    return _paper(image, settings, scale) if settings.method == "paper" else _robust(image, found, scale)


def whole(image: Image, width_px: int) -> Panel:
    """The picture itself."""
    return Panel("picture", "Picture", "as the camera gave it", scaled(image, _scale(image, width_px)), False)


def _scale(image: Image, width_px: int) -> float:
    scale = min(width_px, LARGEST_PX) / image.shape[1]
    return float(math.floor(scale)) if scale > 1 else float(scale)  # enlarged, a pixel stays a square


def encoded(panel: Panel) -> tuple[bytes, str]:
    """A picture file and its media type."""
    suffix, kind = (".png", "image/png") if panel.lossless else (".jpg", "image/jpeg")
    options = [cv2.IMWRITE_PNG_COMPRESSION, 1] if panel.lossless else [cv2.IMWRITE_JPEG_QUALITY, 85]
    done, data = cv2.imencode(suffix, panel.image, options)
    if not done:
        raise ValueError(f"a panel of {panel.image.shape} cannot be encoded")
    return data.tobytes(), kind


def _paper(image: Image, settings: VisionConfig, scale: float) -> tuple[Panel, ...]:
    trace = pipeline.trace(image, settings)
    red, left = (int(np.count_nonzero(mask)) for mask in (trace.initial, trace.cleaned))
    fit = annotated(scaled(image, scale), trace.detection, scale)
    return (
        Panel("hsv", "HSV", "hue, saturation, value shown as blue, green, red", scaled(trace.hsv, scale), False),
        Panel(
            "mask", "Mask", f"the two red ranges: {red} px, {_percent(red, image)}", scaled(trace.initial, scale), True
        ),
        Panel("clean", "Cleaned mask", f"opening, then closing: {left} px", scaled(trace.cleaned, scale), True),
        Panel("fit", "Fit", _chosen(trace.detection), fit, False),
    )


def _chosen(found: Detection) -> str:
    number = counted(found.candidates, "contour")
    return f"no marker; {number} above S_min" if found.circle is None else f"largest valid of {number} above S_min"


def _robust(image: Image, found: Detection, scale: float) -> tuple[Panel, ...]:
    grey = np.clip(redness(image) * (255 / FULL_REDNESS), 0, 255).astype(np.uint8)
    refused = sorted({rejection.why for rejection in found.rejected})
    why = "; ".join(f"{code}: {REJECTION_MEANING[code]}" for code in refused) or "none refused"
    rim, told = _rim_panel(image, found, scale)
    fit = annotated(scaled(image, scale), replace(found, rejected=()), scale)
    return (
        Panel("redness", "Redness", f"log(R / G); white is {FULL_REDNESS:g} and more", scaled(grey, scale), False),
        Panel("candidates", "Candidates", why, _candidates(image, found, scale), False),
        Panel("rim", "Rim", told, rim, False),
        Panel("fit", "Fit", _sure(found), fit, False),
    )


def _sure(found: Detection) -> str:
    if found.circle is None:
        return f"no marker among {counted(found.candidates, 'candidate')}"
    return f"one of {counted(found.candidates, 'candidate')}; confidence {found.confidence or 0:.2f}"


def _candidates(image: Image, found: Detection, scale: float) -> Image:
    """The picture, darker, with every candidate that is told and the word for what became of it."""
    panel = scaled(image, scale) // 2
    wide = max(1, round(panel.shape[1] / 400))
    font_px = max(13, round(panel.shape[1] / 40))
    rows = [(rejection.circle, rejection.why, REFUSED) for rejection in found.rejected]
    if found.circle is not None:
        rows.append((found.circle, "taken", RIM))
    for circle, word, colour in rows:
        centre = to_scale(np.array([circle.u_px, circle.v_px]), scale)
        radius = circle.radius_px * scale
        if not np.isfinite([*centre, radius]).all() or max(*np.abs(centre), radius) > 1e5:
            continue
        ring(panel, centre, max(1.0, radius), colour, wide)
        at = (
            round(min(max(2.0, centre[0] - 0.35 * font_px * len(word)), panel.shape[1] - 0.6 * font_px * len(word))),
            round(min(max(float(font_px), centre[1] - radius - 4), panel.shape[0] - 3.0)),
        )
        write(panel, word, (at[0] + 1, at[1] + 1), INK, font_px)
        write(panel, word, at, WHITE if colour is REFUSED else RIM, font_px)
    return panel


def _rim_panel(image: Image, found: Detection, scale: float) -> tuple[Image, str]:
    """The marker's surroundings, enlarged, with the fitted rim and the edges along rays across it."""
    height, width = image.shape[:2]
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    if found.ellipse is None or found.circle is None:
        return scaled(image, scale), "no rim"
    seen = edges(image, found.ellipse)
    half_v = _AROUND * found.ellipse.semi_major_px
    half_u = half_v * width / height
    left, top = found.ellipse.u_px - half_u, found.ellipse.v_px - half_v
    zoom = size[0] / (2 * half_u)
    # From a panel's pixel to the picture's, by centres.
    matrix = np.array([[1 / zoom, 0, left + 0.5 / zoom], [0, 1 / zoom, top + 0.5 / zoom]])
    panel = np.asarray(cv2.warpAffine(image, matrix, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP), np.uint8)
    curve(panel, (rim_of(found.ellipse) - (left, top)) * zoom - 0.5, RIM, 1)
    for point in (seen.points - (left, top)) * zoom - 0.5:
        ring(panel, point, 2.5, CENTRE, 1)
    if not len(seen.points):
        return panel, "no edge of red along it"
    scatter = float(np.median(np.abs(seen.off_px)))
    return panel, f"edges of red on {len(seen.points)} of {RAYS} rays; median {scatter:.2f} px from the fit"


def edges(image: Image, ellipse: Ellipse) -> Edges:
    """For people to judge a fit by: a plain measurement of its own, not the finer one that the fit was made from."""
    reach = max(3.0, _REACH * ellipse.semi_minor_px)
    offsets = np.arange(-reach, reach + _STEP / 2, _STEP)
    angles = np.linspace(0, 2 * np.pi, RAYS, endpoint=False)
    cosine, sine = math.cos(ellipse.angle_rad), math.sin(ellipse.angle_rad)
    along, across = ellipse.semi_major_px * np.cos(angles), ellipse.semi_minor_px * np.sin(angles)
    u = ellipse.u_px + along * cosine - across * sine
    v = ellipse.v_px + along * sine + across * cosine
    # The normal of an ellipse: axes swapped.
    n_along, n_across = ellipse.semi_minor_px * np.cos(angles), ellipse.semi_major_px * np.sin(angles)
    length = np.hypot(n_along, n_across)
    n_u, n_v = (n_along * cosine - n_across * sine) / length, (n_along * sine + n_across * cosine) / length
    at_u, at_v = u[:, None] + offsets * n_u[:, None], v[:, None] + offsets * n_v[:, None]
    plane = image[..., 2].astype(np.float32) - image[..., 1]  # not its logarithm, which steps a little outside
    profiles = np.asarray(cv2.remap(plane, at_u.astype(np.float32), at_v.astype(np.float32), cv2.INTER_LINEAR))
    smooth = np.asarray(cv2.GaussianBlur(profiles, (0, 0), sigmaX=1.0 / _STEP, sigmaY=0.01))
    fall = -np.gradient(smooth, axis=1)
    peak = fall.argmax(axis=1)
    top = fall[np.arange(RAYS), peak]
    height, width = image.shape[:2]
    whole = ((at_u >= 0) & (at_u <= width - 1) & (at_v >= 0) & (at_v <= height - 1)).all(axis=1)
    inner = (peak > 0) & (peak < len(offsets) - 1)
    usual = float(np.median(top[whole & inner])) if (whole & inner).any() else 0.0
    kept = np.flatnonzero(whole & inner & (top > _CLEAR * usual) & (top > 0))
    before, after = fall[kept, peak[kept] - 1], fall[kept, peak[kept] + 1]
    bend = np.maximum(2 * top[kept] - before - after, 1e-9)
    off = offsets[peak[kept]] + _STEP * np.clip(0.5 * (after - before) / bend, -0.5, 0.5)
    points = np.stack([u[kept] + off * n_u[kept], v[kept] + off * n_v[kept]], axis=1)
    return Edges(points, off)


def _percent(count: int, image: Image) -> str:
    return f"{100 * count / (image.shape[0] * image.shape[1]):.1f} %"
