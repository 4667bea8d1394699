"""What was found in a picture, drawn into it: rim, centre, radius, numbers, and what was refused and why. Pure."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gateway.core.detection import Circle, Detection, Ellipse
from gateway.vision.pixels import Image
from gateway.vision.view.drawing import (
    CENTRE,
    INK,
    REFUSED,
    RIM,
    WHITE,
    Colour,
    box,
    curve,
    panel_scale,
    ring,
    scaled,
    stroke,
    to_scale,
    width_of,
    write,
)

Rectangle = tuple[int, int, int, int]  # of a label: x, base line, width, height

_ANGLES = np.linspace(0, 2 * np.pi, 180, endpoint=False)
_UPWARDS = np.array([math.cos(math.pi / 6), -math.sin(math.pi / 6)])  # of the radius line
_DASHES = 24  # of a predicted circle


def overlay(image: Image, found: Detection) -> Image:
    """A copy with everything in it that the detection reports; a small picture is enlarged by an integer factor."""
    scale = panel_scale(image)
    return annotated(scaled(image, scale), found, scale)


def annotated(panel: Image, found: Detection, scale: float) -> Image:
    """Draws into `panel`, the picture `scale` times as large, and returns it."""
    height, width = panel.shape[:2]
    wide = max(1, round(max(height, width) / 500))
    font_px = max(14, round(max(height, width) / 38))
    labels: list[Rectangle] = []
    for rejection in found.rejected:
        _refused(panel, rejection.circle, rejection.why, scale, wide, font_px, labels)
    if found.predicted is not None:
        _dashed(panel, found.predicted, scale, wide)
    if found.circle is None:
        state = "coasted: predicted, not measured" if found.predicted is not None else "no marker"
        return box(panel, (0, 0), (f"{state} ({counted(found.candidates, 'candidate')})",), font_px)
    centre = to_scale(np.array([found.circle.u_px, found.circle.v_px]), scale)
    radius = found.circle.radius_px * scale
    arm = max(6.0, 0.12 * radius)
    for colour, more in ((INK, 2), (RIM, 0)):
        if found.ellipse is None:
            ring(panel, centre, radius, colour, wide + more)
        else:
            curve(panel, to_scale(rim_of(found.ellipse), scale), colour, wide + more)
    for colour, more in ((INK, 2), (CENTRE, 0)):
        for step in (np.array([arm, 0]), np.array([0, arm])):
            stroke(panel, centre - step, centre + step, colour, wide + more)
        stroke(panel, centre, centre + radius * _towards(found.ellipse), colour, wide + more)
    corner = (int(centre[0] < width / 2), int(centre[1] < height / 2))  # the one farthest from the marker
    return box(panel, corner, _numbers(found, found.circle), font_px)


def rim_of(ellipse: Ellipse) -> NDArray[np.float64]:
    """(180, 2) points (u, v) px on the ellipse."""
    cosine, sine = math.cos(ellipse.angle_rad), math.sin(ellipse.angle_rad)
    along, across = ellipse.semi_major_px * np.cos(_ANGLES), ellipse.semi_minor_px * np.sin(_ANGLES)
    u = ellipse.u_px + along * cosine - across * sine
    v = ellipse.v_px + along * sine + across * cosine
    return np.stack([u, v], axis=1)


def counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _numbers(found: Detection, circle: Circle) -> tuple[str, ...]:
    lines = [f"u {circle.u_px:.2f}  v {circle.v_px:.2f} px", f"R {circle.radius_px:.2f} px"]
    if found.ellipse is None:
        lines.append(f"circularity {found.circularity:.3f}  fill {found.fill:.3f}")
    else:
        lines.append(f"minor {found.ellipse.semi_minor_px:.2f} px  tilt {found.ellipse.tilt_deg:.0f} deg")
    if found.confidence is not None and found.visible is not None:
        lines.append(f"confidence {found.confidence:.2f}  seen {100 * found.visible:.0f} %")
    return tuple(lines)


def _towards(ellipse: Ellipse | None) -> NDArray[np.float64]:
    """R is the semi-major axis: the radius line ends on the rim."""
    if ellipse is None or ellipse.semi_major_px - ellipse.semi_minor_px < 1:
        return _UPWARDS
    return np.array([math.cos(ellipse.angle_rad), math.sin(ellipse.angle_rad)])


def _refused(
    panel: Image, circle: Circle, why: str, scale: float, wide: int, font_px: int, labels: list[Rectangle]
) -> None:
    """`labels`: where others are written already; this one is added, or left out where there is no room for it."""
    centre = to_scale(np.array([circle.u_px, circle.v_px]), scale)
    if not np.isfinite([*centre, circle.radius_px]).all() or np.abs(centre).max() > 1e5:
        return
    radius = min(1e5, max(0.0, circle.radius_px * scale))
    ring(panel, centre, radius, REFUSED, wide)
    label(panel, why, (centre[0] - 0.7 * radius, centre[1] - 0.7 * radius), WHITE, max(12, font_px - 4), labels)


def label(
    panel: Image, words: str, at: tuple[float, float], colour: Colour, font_px: int, labels: list[Rectangle]
) -> None:
    """Words that begin at `at`, or near it where `labels` are; they are added to these. Without room: left out."""
    size = (width_of(words, font_px), round(1.3 * font_px))
    x = round(min(max(0.0, at[0]), max(0.0, panel.shape[1] - 1.0 - size[0])))
    y = round(min(max(float(font_px), at[1]), panel.shape[0] - 2.0))
    place = free_place((x, y), size, panel.shape[0] - 2, labels)
    if place is None:
        return
    labels.append((x, place, *size))
    write(panel, words, (x + 1, place + 1), INK, font_px)
    write(panel, words, (x, place), colour, font_px)


def free_place(at: tuple[int, int], size: tuple[int, int], bottom: int, labels: Sequence[Rectangle]) -> int | None:
    """The base line nearest to `at` on which a label of that size covers no other; None: nowhere."""
    x, y = at
    width, height = size
    for step in range(2 * len(labels) + 1):
        line = y + height * ((step + 1) // 2) * (1 if step % 2 else -1)
        free = all(x >= ox + w or ox >= x + width or abs(line - oy) >= max(height, h) for ox, oy, w, h in labels)
        if free and height <= line + 2 and line <= bottom:
            return line
    return None


def _dashed(panel: Image, circle: Circle, scale: float, wide: int) -> None:
    turns = np.linspace(0, 2 * np.pi, 2 * _DASHES, endpoint=False)
    rim = np.stack([circle.u_px + circle.radius_px * np.cos(turns), circle.v_px + circle.radius_px * np.sin(turns)], 1)
    points = to_scale(rim, scale)
    for n in range(0, 2 * _DASHES, 2):
        stroke(panel, points[n], points[n + 1], WHITE, wide)
