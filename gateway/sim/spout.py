"""The loading spout and the red lamp on it: they hang in the bay before the truck, and do not move with it. Pure.

The spout is a grey telescopic tube that moves down from above the picture; 1 down is all the way. The lamp is a round
red light in front of it, about as red as the marker and a tenth of its size: what a camera may confuse with it.
"""

import cv2
import numpy as np

from gateway.sim.canvas import u8
from gateway.sim.scenario import Scenario
from gateway.sim.world import SPOUT_MM, Truth, spout_box
from gateway.vision.pixels import Image

RING_PX = 46  # height of one section of the tube
LIP_PX = 14  # the rim at its lower end
LAMP_MM = (30.0, -20.0)  # from the axis to the right and down
LAMP_RADIUS_MM = 6.6  # 20 px with the default camera
LAMP_COLOUR = (48, 44, 236)  # BGR, lit
LAMP_CORE = (120, 110, 255)


class Spout:
    """The painted tube of one scenario's camera."""

    def __init__(self, scenario: Scenario) -> None:
        self._camera = scenario.camera
        left, right, _ = spout_box(self._camera, 0.0)
        self._left, self._right = max(0, round(left)), min(self._camera.width_px, round(right))
        self._tube = _tube(self._camera.height_px, round(left), round(right))[:, self._left - round(left) :]

    def draw(self, image: Image, truth: Truth) -> None:
        """Drawn over the truck; dust, light and noise are applied afterwards."""
        if truth.spout > 0 and self._right > self._left:
            edge = min(self._camera.height_px, round(truth.spout * self._camera.height_px))
            width = self._right - self._left
            image[:edge, self._left : self._right] = self._tube[self._camera.height_px - edge :, :width]
        if truth.lamp:
            self._lamp(image)

    def _lamp(self, image: Image) -> None:
        cx, cy = self._camera.centre_px
        scale = self._camera.focal_px / (SPOUT_MM + self._camera.offset_mm)
        at = (round((cx + scale * LAMP_MM[0]) * 16), round((cy + scale * LAMP_MM[1]) * 16))
        radius = round(scale * LAMP_RADIUS_MM * 16)
        cv2.circle(image, at, radius, LAMP_COLOUR, -1, cv2.LINE_AA, 4)
        cv2.circle(image, at, radius // 3, LAMP_CORE, -1, cv2.LINE_AA, 4)


def _tube(height: int, left: int, right: int) -> Image:
    """Its lowest row is the lower end: a cylinder lit from the upper left, in sections, with a dark lip. All grey."""
    across = np.linspace(-1, 1, right - left, dtype=np.float32)[None, :]
    up = np.arange(height, 0, -1, dtype=np.float32)[:, None]  # px above the lower end
    body = 60 + 110 * np.sqrt(np.clip(1 - across * across, 0, 1)) * (1 - 0.35 * across)
    ring = up % RING_PX / RING_PX
    shade = 1 - 0.28 * np.exp(-ring * 9) + 0.10 * np.exp(-((ring - 0.3) ** 2) * 90)
    tone = body * shade * np.where(up <= LIP_PX, 0.45, 1.0)
    return u8(np.repeat(np.clip(tone, 0, 255).astype(np.uint8)[..., None], 3, axis=2))
