"""The pixels of examples by what they belong to: marker, surroundings, background. Pure.

Colours are those that the thresholds see: after the Gaussian, on OpenCV's HSV scale. Hue is signed about red: 0 is red,
positive towards orange and yellow, negative towards violet, so that Table I's two ranges become one.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.config import VisionConfig
from gateway.core.detection import Circle
from gateway.vision.detect.paper import stages
from gateway.vision.pixels import Image

INSIDE = 0.85  # of R: the blur smears the rim
RING = (1.2, 2.5)  # of R: what the marker would merge with
MOST = 6000  # pixels kept of each class of one example, evenly spread

HsvColours = NDArray[np.int16]  # (n, 3): signed hue -90..89, S and V 0..255


@dataclass(frozen=True, slots=True)
class Example:
    """One picture with its marker; None: a picture without one."""

    name: str
    circle: Circle | None
    marker: HsvColours
    ring: HsvColours
    far: HsvColours
    marker_px: int  # how many pixels the classes have in truth
    far_px: int

    @property
    def marked(self) -> bool:
        return self.circle is not None and len(self.marker) > 0


def example(name: str, image: Image, circle: Circle | None, params: VisionConfig) -> Example:
    """`circle`: the marker, radius that of its smaller semi-axis if it is tilted. Large pictures are thinned out."""
    hsv = stages.bgr_to_hsv(stages.gaussian(image, params.gaussian_kernel_px, params.gaussian_sigma_px))
    height, width = hsv.shape[:2]
    if circle is None:
        none = np.empty((0, 3), np.int16)
        return Example(name, None, none, none, _some(hsv.reshape(-1, 3)), 0, height * width)
    v, u = np.ogrid[0:height, 0:width]
    away2 = (u - circle.u_px) ** 2 + (v - circle.v_px) ** 2
    r2 = circle.radius_px**2
    inside = away2 <= INSIDE**2 * r2
    ring = (away2 >= RING[0] ** 2 * r2) & (away2 <= RING[1] ** 2 * r2)
    far = away2 > RING[1] ** 2 * r2
    return Example(
        name=name,
        circle=circle,
        marker=_some(hsv[inside]),
        ring=_some(hsv[ring]),
        far=_some(hsv[far]),
        marker_px=int(np.count_nonzero(away2 <= r2)),
        far_px=int(np.count_nonzero(far)),
    )


def disc(image: NDArray[np.uint8], circle: Circle, share: float = 1.0) -> NDArray[np.bool_]:
    """(H, W): the pixels within `share` of the circle's radius."""
    v, u = np.ogrid[0 : image.shape[0], 0 : image.shape[1]]
    away2 = (u - circle.u_px) ** 2 + (v - circle.v_px) ** 2
    return np.asarray(away2 <= (share * circle.radius_px) ** 2, np.bool_)


def _some(hsv: NDArray[np.uint8]) -> HsvColours:
    step = max(1, -(-len(hsv) // MOST))
    colours = hsv[::step].astype(np.int16)
    colours[:, 0] = (colours[:, 0] + 90) % 180 - 90
    return colours
