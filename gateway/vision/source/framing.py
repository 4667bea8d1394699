"""Which part of a delivered picture is used, and how it is turned: `camera.crop` and `camera.rotation_deg`.

Everything behind it (u, v, R, aim point, intrinsics, ring, records, pages) speaks of the result. A crop is a view; a
rotation is one copy.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, cast

from gateway.config import CameraConfig
from gateway.errors import LinkError
from gateway.vision.source.contract import Frame

if TYPE_CHECKING:
    from gateway.vision.pixels import AnyImage

SizePx = tuple[int, int]
"""Width and height, px."""


@dataclass(frozen=True, slots=True)
class Framing:
    """`crop`: x, y, width and height in the delivered picture, px; None: all of it. `rotation_deg`: clockwise."""

    crop: tuple[int, int, int, int] | None = None
    rotation_deg: int = 0

    @staticmethod
    def of(camera: CameraConfig) -> "Framing":
        part = camera.crop
        crop = None if part is None else (part.x_px, part.y_px, part.width_px, part.height_px)
        return Framing(crop, camera.rotation_deg)

    def size_px(self, delivered_px: SizePx) -> SizePx:
        """Of what is used of a picture of this size. Raises LinkError where the crop leaves it."""
        size = delivered_px
        if self.crop is not None:
            x, y, width, height = self.crop
            if x + width > size[0] or y + height > size[1]:
                raise LinkError(
                    f"camera.crop needs {x + width} x {y + height} px: {width} x {height} from ({x}, {y}) on; "
                    f"its frames are {size[0]} x {size[1]} px"
                )
            size = width, height
        return size[::-1] if self.rotation_deg % 180 else size

    def delivered(self, u_px: float, v_px: float, delivered_px: SizePx) -> tuple[float, float]:
        """Where a point of what is used lies in the delivered picture. Raises LinkError as `size_px`."""
        width, height = self.size_px(delivered_px)
        for _ in range(self.rotation_deg // 90):
            u_px, v_px, width, height = v_px, width - 1 - u_px, height, width
        left, top = (0, 0) if self.crop is None else self.crop[:2]
        return u_px + left, v_px + top

    def used(self, frame: Frame) -> Frame:
        """What is used of a frame whose size has been checked."""
        pixels = frame.pixels
        if self.crop is not None:
            x, y, width, height = self.crop
            pixels = pixels[y : y + height, x : x + width]
        if self.rotation_deg:
            import cv2  # noqa: PLC0415 - OpenCV stays out of the main process

            pixels = cast("AnyImage", cv2.rotate(pixels, self.rotation_deg // 90 - 1))  # ROTATE_90_CLOCKWISE is 0
        return replace(frame, pixels=pixels)
