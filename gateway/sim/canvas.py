"""Drawing in millimetres on a texture, and smooth noise: the tools that the simulator's surfaces are painted with."""

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.vision.pixels import Image

Plane = NDArray[np.float32]  # (H, W)
Colour = tuple[int, int, int]  # BGR
Point = tuple[float, float]  # mm
Spine = tuple[tuple[float, float, float], ...]  # x, y, half width, mm

SHIFT = 4  # fractional bits of OpenCV's drawing coordinates


def u8(array: object) -> Image:
    """OpenCV's stubs return any array; ours are 8 bit here."""
    return np.asarray(array, dtype=np.uint8)


def clouds(chance: np.random.Generator, shape: tuple[int, int], cells: tuple[int, int]) -> Plane:
    """Smooth noise of mean 0 and standard deviation about 1; `cells` (down, across) sets its coarseness."""
    small = chance.standard_normal((max(2, cells[0]), max(2, cells[1])), dtype=np.float32)
    return np.asarray(cv2.resize(small, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC), dtype=np.float32)


class Canvas:
    """Draws in mm on a texture, anti-aliased."""

    def __init__(self, image: Image, scale: float, left_mm: float, top_mm: float) -> None:
        self.image = np.ascontiguousarray(image)
        self.scale, self.left, self.top = scale, left_mm, top_mm

    def px(self, x: float, y: float) -> tuple[int, int]:
        """OpenCV's fixed-point coordinates of a point in mm."""
        one = 1 << SHIFT
        return (
            round(((x - self.left) * self.scale - 0.5) * one),
            round(((y - self.top) * self.scale - 0.5) * one),
        )

    def disc(self, at: Point, radius: float, colour: Colour, *, ring: float = 0.0) -> None:
        """Filled, or a ring of that width (mm) whose middle lies on the radius."""
        width = -1 if ring <= 0 else max(1, round(ring * self.scale))
        size = round(radius * self.scale * (1 << SHIFT))
        cv2.circle(self.image, self.px(*at), size, colour, width, cv2.LINE_AA, SHIFT)

    def polygon(self, points: list[Point], colour: Colour) -> None:
        corners = np.array([self.px(*p) for p in points], dtype=np.int32)
        cv2.fillPoly(self.image, [corners], colour, cv2.LINE_AA, SHIFT)

    def box(self, left: float, top: float, width: float, height: float, colour: Colour) -> None:
        right, bottom = left + width, top + height
        self.polygon([(left, top), (right, top), (right, bottom), (left, bottom)], colour)

    def line(self, points: list[Point], width: float, colour: Colour) -> None:
        corners = np.array([self.px(*p) for p in points], dtype=np.int32)
        thick = max(1, round(width * self.scale))
        cv2.polylines(self.image, [corners], False, colour, thick, cv2.LINE_AA, SHIFT)

    def text(self, words: str, at: Point, height: float, colour: Colour) -> None:
        x, y = self.px(*at)
        size = height * self.scale / 22
        where = (x >> SHIFT, y >> SHIFT)
        cv2.putText(
            self.image, words, where, cv2.FONT_HERSHEY_DUPLEX, size, colour, max(1, round(3 * size)), cv2.LINE_AA
        )

    def shade(self, at: Point, radius: float, strength: float, blur: float) -> None:
        """A soft round shadow: what protrudes from the surface darkens it."""
        reach = radius + 2 * blur
        x0, y0 = self.px(at[0] - reach, at[1] - reach)
        x1, y1 = self.px(at[0] + reach, at[1] + reach)
        height, width = self.image.shape[:2]
        left, top = max(0, x0 >> SHIFT), max(0, y0 >> SHIFT)
        right, bottom = min(width, x1 >> SHIFT), min(height, y1 >> SHIFT)
        if left >= right or top >= bottom:
            return
        ys, xs = np.mgrid[top:bottom, left:right].astype(np.float32)
        away = np.hypot((xs + 0.5) / self.scale + self.left - at[0], (ys + 0.5) / self.scale + self.top - at[1])
        dark = 1 - strength / (1 + np.exp((away - radius) / (blur / 3)))
        part = self.image[top:bottom, left:right]
        part[:] = (part * dark[..., None]).astype(np.uint8)

    def run(self, spine: Spine, colour: Colour) -> None:
        """A rust run: strands that part and fade on their way down, soft at the edges."""
        xs, ys, widths = zip(*spine, strict=True)
        reach = 2.5 * max(widths)
        x0, y0 = (v >> SHIFT for v in self.px(min(xs) - reach, min(ys) - reach))
        x1, y1 = (v >> SHIFT for v in self.px(max(xs) + reach, max(ys) + reach))
        height, width = self.image.shape[:2]
        left, top, right, bottom = max(0, x0), max(0, y0), min(width, x1), min(height, y1)
        if left >= right or top >= bottom:
            return
        mask = Canvas(np.zeros((bottom - top, right - left, 3), dtype=np.uint8), self.scale, 0, 0)
        mask.left, mask.top = self.left + left / self.scale, self.top + top / self.scale
        for strand in (-0.55, 0.1, 0.6):
            last = len(spine) - 1 - round(abs(strand) * 12)
            for k, (x, y, w) in enumerate(spine[:last]):
                deep = round(235 * (1 - 0.75 * k / len(spine)))
                ahead = spine[k + 1]
                mask.line([(x + strand * w, y), (ahead[0] + strand * ahead[2], ahead[1])], 0.7 * w, (deep,) * 3)
        soft = cv2.GaussianBlur(mask.image[..., 0], (0, 0), 1.3 * self.scale)
        share = np.asarray(soft, dtype=np.float32)[..., None] / 255
        part = self.image[top:bottom, left:right]
        part[:] = (part * (1 - share) + np.array(colour, dtype=np.float32) * share).astype(np.uint8)

    def tint(self, amount: Plane, colour: Colour, chance: np.random.Generator) -> None:
        """Blend a mottled colour in by a map of shares that covers this canvas at any resolution."""
        height, width = self.image.shape[:2]
        share = np.clip(cv2.resize(amount, (width, height), interpolation=cv2.INTER_CUBIC), 0, 1)[..., None]
        mottle = 1 + 0.10 * clouds(chance, (height, width), (height // 5, width // 5))[..., None]
        tone = np.array(colour, dtype=np.float32) * mottle
        self.image = np.clip(self.image * (1 - share) + tone * share, 0, 255).astype(np.uint8)

    def grain(self, deviation: float, chance: np.random.Generator) -> None:
        """Fine grey grain: sand, orange peel, grime below the resolution."""
        tile = chance.standard_normal((256, 256), dtype=np.float32) * deviation
        height, width = self.image.shape[:2]
        noise = np.tile(tile, (height // 256 + 1, width // 256 + 1))[:height, :width, None]
        self.image = np.clip(self.image + noise, 0, 255).astype(np.uint8)
