"""The panels of a trial: the pictures of its method's stages side by side. Pure."""

import math

import cv2

from gateway.config import VisionConfig
from gateway.core.detection import Detection
from gateway.vision.detect import registry
from gateway.vision.detect.method import Panel
from gateway.vision.pixels import Image
from gateway.vision.view.drawing import scaled
from gateway.web.server.pictures import picture_file

WIDTH_PX = 480  # of a panel, unless requested otherwise
LARGEST_PX = 1920


def panels(image: Image, settings: VisionConfig, found: Detection, width_px: int = WIDTH_PX) -> tuple[Panel, ...]:
    """Of the method that `settings` name. `found`: what it made of this picture."""
    return registry.method(settings.method).panels(image, settings, found, _scale(image, width_px))


def full_frame(image: Image, width_px: int) -> Panel:
    """The picture itself."""
    return Panel("picture", "Picture", "as the camera gave it", scaled(image, _scale(image, width_px)))


def _scale(image: Image, width_px: int) -> float:
    scale = min(width_px, LARGEST_PX) / image.shape[1]
    return float(math.floor(scale)) if scale > 1 else float(scale)  # enlarged, a pixel stays a square


def encoded(panel: Panel) -> tuple[bytes, str]:
    """A picture file and its media type."""
    if panel.lossless:
        return picture_file(panel.image, "png", cv2.IMWRITE_PNG_COMPRESSION, 1), "image/png"
    return picture_file(panel.image, "jpg", cv2.IMWRITE_JPEG_QUALITY, 85), "image/jpeg"
