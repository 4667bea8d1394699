"""The robust method on the tuning page: its stages as panels, and remarks on tried settings. Pure."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.config import VisionConfig
from gateway.core.detection import Detection, Ellipse
from gateway.vision.detect.geometry import same_place
from gateway.vision.detect.method import Panel, Remark
from gateway.vision.detect.robust.conic import outline
from gateway.vision.detect.robust.marker_colour import marker_of
from gateway.vision.detect.robust.method import REJECTIONS
from gateway.vision.detect.robust.redness import redness
from gateway.vision.pixels import Image
from gateway.vision.view.drawing import CENTRE, REFUSED, RIM, WHITE, curve, ring, scaled, to_scale, width_of
from gateway.vision.view.overlay import Rectangle, annotated, label, rim_of

FULL_REDNESS = 1.5  # log units shown as white
RAYS = 120  # on which the rim is shown
_AROUND = 1.35  # of the semi-major axis: what the rim's panel shows
_REACH = 0.25  # of the semi-minor axis: how far along a ray an edge is searched for
_STEP = 0.25  # of a pixel
_CLEAR = 0.3  # of the median fall of redness: less is not an edge
SURE = 0.3  # of a confidence gate: below, even odds pass


@dataclass(frozen=True, slots=True)
class Edges:
    """Where red less green falls steepest across a rim, by ray. `points` (n, 2): u, v px; `off_px`: from the rim."""

    points: NDArray[np.float64]
    off_px: NDArray[np.float64]


def panels(image: Image, params: VisionConfig, found: Detection, scale: float) -> tuple[Panel, ...]:
    seen = np.asarray(marker_of(params.marker_colour).seen(image), np.uint8)
    grey = np.clip(redness(seen) * (255 / FULL_REDNESS), 0, 255).astype(np.uint8)
    refused = sorted({rejection.why for rejection in found.rejected})
    why = "; ".join(f"{code}: {REJECTIONS[code]}" for code in refused) or "none refused"
    rim, caption = _rim_panel(image, seen, found, scale)
    fit = annotated(scaled(image, scale), replace(found, rejected=()), scale)
    return (
        Panel("redness", "Redness", f"log(R / G); white is {FULL_REDNESS:g} and more", scaled(grey, scale)),
        Panel("candidates", "Candidates", why, _candidates(image, found, scale)),
        Panel("rim", "Rim", caption, rim),
        Panel("fit", "Fit", _sure(found), fit),
    )


def _sure(found: Detection) -> str:
    if found.circle is None:
        return f"no marker; candidates: {found.candidates}"
    return f"confidence {found.confidence or 0:.2f}; candidates: {found.candidates}"


def _candidates(image: Image, found: Detection, scale: float) -> Image:
    """The picture, darker, with every reported candidate and the text of its result."""
    panel = scaled(image, scale) // 2
    wide = max(1, round(panel.shape[1] / 400))
    font_px = max(13, round(panel.shape[1] / 40))
    rows = [(rejection.circle, rejection.why, REFUSED) for rejection in found.rejected]
    if found.circle is not None:
        rows.insert(0, (found.circle, "taken", RIM))  # of all labels this one has room
    labels: list[Rectangle] = []
    for circle, word, colour in rows:
        centre = to_scale(np.array([circle.u_px, circle.v_px]), scale)
        radius = circle.radius_px * scale
        if not np.isfinite([*centre, radius]).all() or max(*np.abs(centre), radius) > 1e5:
            continue
        ring(panel, centre, max(1.0, radius), colour, wide)
        at = (centre[0] - width_of(word, font_px) / 2, centre[1] - radius - 4)
        label(panel, word, at, WHITE if colour is REFUSED else RIM, font_px, labels)
    return panel


def _rim_panel(image: Image, red: Image, found: Detection, scale: float) -> tuple[Image, str]:
    """The marker's surroundings, enlarged, with the fitted rim and the edges along rays across it.

    `red`: the picture in the order of channels in which the marker is red.
    """
    height, width = image.shape[:2]
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    if found.ellipse is None or found.circle is None:
        return scaled(image, scale), "no rim"
    seen = edges(red, found.ellipse)
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
    """For people to judge a fit by: a separate plain measurement, not the finer one of the fit."""
    reach = max(3.0, _REACH * ellipse.semi_minor_px)
    offsets = np.arange(-reach, reach + _STEP / 2, _STEP)
    angles = np.linspace(0, 2 * np.pi, RAYS, endpoint=False)
    u, v = outline(ellipse, angles)
    cosine, sine = math.cos(ellipse.angle_rad), math.sin(ellipse.angle_rad)
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
    inside_picture = ((at_u >= 0) & (at_u <= width - 1) & (at_v >= 0) & (at_v <= height - 1)).all(axis=1)
    inner = (peak > 0) & (peak < len(offsets) - 1)
    usual = float(np.median(top[inside_picture & inner])) if (inside_picture & inner).any() else 0.0
    kept = np.flatnonzero(inside_picture & inner & (top > _CLEAR * usual) & (top > 0))
    before, after = fall[kept, peak[kept] - 1], fall[kept, peak[kept] + 1]
    bend = np.maximum(2 * top[kept] - before - after, 1e-9)
    off = offsets[peak[kept]] + _STEP * np.clip(0.5 * (after - before) / bend, -0.5, 0.5)
    points = np.stack([u[kept] + off * n_u[kept], v[kept] + off * n_v[kept]], axis=1)
    return Edges(points, off)


def remarks(image: Image, tried: VisionConfig, found: Detection, reference: Detection) -> Iterator[Remark]:
    if tried.min_confidence < SURE:
        yield Remark(
            f"min_confidence: {tried.min_confidence:g} takes what is more likely no marker than one", "min_confidence"
        )
    marker = reference.circle
    if marker is None or (found.circle is not None and same_place(found.circle, marker)):
        return
    diagonal_px = math.hypot(*image.shape[:2])
    if marker.radius_px > tried.max_radius_share * diagonal_px:
        yield Remark(f"the marker is refused: R = {marker.radius_px:.0f} px is above the limit", "max_radius_share")
    elif marker.radius_px < tried.min_radius_share * diagonal_px:
        yield Remark(f"the marker is refused: R = {marker.radius_px:.0f} px is below the limit", "min_radius_share")
    else:
        refused = [rejection.why for rejection in found.rejected if same_place(rejection.circle, marker)]
        if not refused:
            yield Remark("the marker is refused: it was not among the best few candidates")
        else:
            key = "min_confidence" if refused[0] == "confidence" else ""
            yield Remark(f"the marker is refused: {REJECTIONS[refused[0]]}", key)
