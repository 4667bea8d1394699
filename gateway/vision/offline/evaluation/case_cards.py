"""One picture with its truth and its answer drawn over it, as a card of the report. Pure.

The picture is a small JPEG; everything drawn is vector, so that it stays sharp on paper. Truth: blue, solid. Answer:
yellow, dashed. Refused candidates: white, dotted. All with a dark line beneath, to be seen on anything.
"""

import math
from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from gateway.core.detection import Circle, Rejection
from gateway.vision.detect.geometry import distance_px
from gateway.vision.offline.evaluation.scoring import Closeness, ScoredPicture
from gateway.vision.offline.reports.page import embed, plain
from gateway.vision.pixels import Image

VIEW_W, VIEW_H = 660, 440  # of the drawn part; shown at about half of it
TRUTH, ANSWER, REFUSED = "#35b5ff", "#ffe14d", "#ffffff"
_LOOK = {Closeness.CLOSE: "good", Closeness.CLEAR: "good", Closeness.LOOSE: "warn"}
_MOST_REFUSED = 3


def card(outcome: ScoredPicture, image: Image, reasons: Mapping[str, str]) -> str:
    """HTML of one case. `reasons` explains the codes of rejections."""
    refused = refused_near(outcome)
    box = frame(outcome, image.shape[1], image.shape[0])
    marks = [f'<span class="mark {_LOOK.get(outcome.verdict, "bad")}">{outcome.verdict}</span>']
    if outcome.label.group:
        marks.append(f'<span class="mark plain">{plain(outcome.label.group)}</span>')
    lines = "".join(f"<div>{line}</div>" for line in caption(outcome))
    whys = "".join(
        f"<li>refused at ({r.circle.u_px:.0f}, {r.circle.v_px:.0f}), R {r.circle.radius_px:.0f}: "
        f"{plain(reasons.get(r.why, r.why))}</li>"
        for r in refused
    )
    listed = f"<ul>{whys}</ul>" if whys else ""
    return (
        f'<div class="case">{drawn(outcome, image, box, refused)}<div class="text">'
        f'<span class="file">{plain(outcome.label.file)}</span>{"".join(marks)}{lines}{listed}</div></div>'
    )


def caption(outcome: ScoredPicture) -> list[str]:
    """The caption: what is true, what was answered, how far off."""
    truth, circle = outcome.label.circle, outcome.detection.circle
    lines = ["truth: no marker here"]
    if truth is not None:
        lines = [f"truth ({truth.u_px:.1f}, {truth.v_px:.1f}), R {truth.radius_px:.1f} px"]
    if circle is not None:
        confidence = outcome.detection.confidence
        sure = "" if confidence is None else f", confidence {confidence:.2f}"
        lines.append(f"answer ({circle.u_px:.1f}, {circle.v_px:.1f}), R {circle.radius_px:.1f} px{sure}")
    elif outcome.detection.predicted is not None:
        lines.append("no answer: the place is only predicted")
    else:
        lines.append("no answer")
    if outcome.centre_px is not None and outcome.radius_share is not None and truth is not None:
        share = 100 * outcome.centre_px / truth.radius_px
        off = f"centre {outcome.centre_px:.2f} px ({share:.1f} % of R), radius {100 * outcome.radius_share:+.1f} %"
        tol_px = outcome.label.tol_px
        vague = f"; the label itself: ± {tol_px:g} px" if tol_px else ""
        lines.append(f"off by: {off}{vague}")
    return lines


def refused_near(outcome: ScoredPicture) -> tuple[Rejection, ...]:
    """Candidates that overlap the truth (anywhere, where there is none), the nearest first."""
    truth = outcome.label.circle
    if truth is None:
        return outcome.detection.rejected[:_MOST_REFUSED]
    away = [(distance_px(refused.circle, truth), refused) for refused in outcome.detection.rejected]
    near = [(px, refused) for px, refused in away if px < truth.radius_px + refused.circle.radius_px]
    return tuple(refused for _, refused in sorted(near, key=lambda entry: entry[0])[:_MOST_REFUSED])


Box = tuple[float, float, float, float]  # x, y, width, height in picture coordinates (corner of the first pixel: 0)


def frame(outcome: ScoredPicture, width: int, height: int) -> Box:
    """The part of the picture to show: truth and answer with room around them, in the card's shape."""
    circles = [circle for circle in (outcome.label.circle, outcome.detection.circle) if circle is not None]
    if not circles:
        return 0.0, 0.0, float(width), float(height)
    room = 1.6 * max(circle.radius_px for circle in circles)
    x0 = max(0.0, min(c.u_px for c in circles) - room)
    x1 = min(float(width), max(c.u_px for c in circles) + room)
    y0 = max(0.0, min(c.v_px for c in circles) - room)
    y1 = min(float(height), max(c.v_px for c in circles) + room)
    middle_x, middle_y = (x0 + x1) / 2, (y0 + y1) / 2
    wide = max(x1 - x0, (y1 - y0) * VIEW_W / VIEW_H, 40.0)
    wide, high = min(wide, float(width)), min(wide * VIEW_H / VIEW_W, float(height))
    x = min(max(0.0, middle_x - wide / 2), width - wide)
    y = min(max(0.0, middle_y - high / 2), height - high)
    return x, y, wide, high


def drawn(outcome: ScoredPicture, image: Image, box: Box, refused: Sequence[Rejection]) -> str:
    """The cut-out as a JPEG with everything drawn over it, one SVG."""
    height, width = image.shape[:2]
    x0, y0 = math.floor(box[0]), math.floor(box[1])
    x1, y1 = min(width, math.ceil(box[0] + box[2])), min(height, math.ceil(box[1] + box[3]))
    part = np.ascontiguousarray(image[y0:y1, x0:x1])
    scale = min(VIEW_W / part.shape[1], VIEW_H / part.shape[0])
    wide, high = part.shape[1] * scale, part.shape[0] * scale
    small = part
    if scale < 1:
        size = (max(1, round(wide)), max(1, round(high)))
        small = np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), np.uint8)

    def circle(c: Circle, a: float, b: float, angle_rad: float, stroke: str, dash: str, width_px: float) -> str:
        x, y = (c.u_px + 0.5 - x0) * scale, (c.v_px + 0.5 - y0) * scale
        turn = f' transform="rotate({math.degrees(angle_rad):.1f} {x:.1f} {y:.1f})"' if a != b else ""
        shape = f'cx="{x:.2f}" cy="{y:.2f}" rx="{a * scale:.2f}" ry="{b * scale:.2f}" fill="none"{turn}'
        cross = f"M{x - 6:.1f} {y:.1f}h12M{x:.1f} {y - 6:.1f}v12"
        return (
            f'<ellipse {shape} stroke="#000" stroke-opacity=".35" stroke-width="{width_px + 1.6}"/>'
            f'<ellipse {shape} stroke="{stroke}" stroke-width="{width_px}" stroke-dasharray="{dash}"/>'
            f'<path d="{cross}" stroke="#000" stroke-opacity=".6" stroke-width="3.6"/>'
            f'<path d="{cross}" stroke="{stroke}" stroke-width="1.6"/>'
        )

    parts = [
        f'<svg viewBox="0 0 {wide:.1f} {max(high, 0.5 * wide):.1f}" preserveAspectRatio="xMidYMid meet" role="img"'
        f' aria-label="{plain(outcome.label.file)}">',
        f'<image href="{embed(small)}" width="{wide:.1f}" height="{high:.1f}" preserveAspectRatio="none"'
        f' style="image-rendering:{"pixelated" if scale > 3 else "auto"}"/>',
    ]
    for rejection in refused:
        r = rejection.circle.radius_px
        parts.append(circle(rejection.circle, r, r, 0.0, REFUSED, "2 5", 1.5))
    truth, answer, rim = outcome.label.circle, outcome.detection.circle, outcome.detection.ellipse
    if truth is not None:
        parts.append(circle(truth, truth.radius_px, truth.radius_px, 0, TRUTH, "", 2.2))
    if answer is not None:
        a, b = (rim.semi_major_px, rim.semi_minor_px) if rim else (answer.radius_px, answer.radius_px)
        parts.append(circle(answer, a, b, rim.angle_rad if rim else 0.0, ANSWER, "9 5", 2.2))
    return "".join([*parts, "</svg>"])
