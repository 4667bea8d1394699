"""The paper's stages in a window of a picture, with nothing made up at the window's own edges. Pure."""

import cv2
import numpy as np

from gateway.config import VisionConfig
from gateway.vision.detect.paper import stages
from gateway.vision.detect.paper.exact.geometry import Box, Opening
from gateway.vision.detect.paper.exact.kernel import Kernel
from gateway.vision.detect.paper.stages import Contour, Mask
from gateway.vision.pixels import Image

LARGEST_SIDE_PX = 31  # the closing's 61 px still fit the kernel's words of 64


class WindowStages:
    """For one set of parameters. With the kernel, equations 1 to 4 are one compiled loop."""

    def __init__(self, params: VisionConfig, opening: Opening, kernel: Kernel | None) -> None:
        self._params = params
        self._opening = opening
        self._kernel = kernel

    def red(self, image: Image, window: Box) -> Mask:
        """M_0 in the window: exact up to its edges, since the blur may look beyond them."""
        if self._kernel is not None:
            return self._kernel.mask(image, window)
        height, width = image.shape[:2]
        seen = window.grown(self._params.gaussian_kernel_px // 2, width, height)
        part = image[seen.y0 : seen.y1, seen.x0 : seen.x1]
        blurred = stages.gaussian(part, self._params.gaussian_kernel_px, self._params.gaussian_sigma_px)
        inner = blurred[window.y0 - seen.y0 : window.y1 - seen.y0, window.x0 - seen.x0 : window.x1 - seen.x0]
        return stages.red(inner, self._params)

    def cleaned(self, image: Image, window: Box) -> Mask:
        """M_c in the window: exact for components as far inside as `geometry` requires."""
        if self._kernel is not None and self._opening.side_px <= LARGEST_SIDE_PX:
            return self._kernel.cleaned(image, window, self._opening.side_px)
        how = (self._params.morph_kernel_px, self._params.morph_iterations)
        eroded = stages.erode(self.red(image, window), *how)
        self._clear_edges(eroded, window, image.shape[1], image.shape[0])
        return stages.closing(stages.dilate(eroded, *how), *how)

    def contours(self, image: Image, window: Box, min_area_px2: float) -> list[Contour]:
        """As `stages.contours`, in the picture's coordinates; only those of more than `min_area_px2`."""
        mask = self.cleaned(image, window)
        found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE, offset=(window.x0, window.y0))
        return [np.asarray(contour, np.int32) for contour in found if cv2.contourArea(contour) > min_area_px2]

    def _clear_edges(self, eroded: Mask, window: Box, width: int, height: int) -> None:
        """A square that reaches over the window's own edge is not known to be red: in place."""
        r = self._opening.reach_px
        if window.x0 > 0:
            eroded[:, :r] = 0
        if window.y0 > 0:
            eroded[:r] = 0
        if window.x1 < width:
            eroded[:, -r:] = 0
        if window.y1 < height:
            eroded[-r:] = 0


def extent(contour: Contour) -> Box:
    """The box round all its pixels."""
    x, y, width, height = (int(value) for value in cv2.boundingRect(contour))
    return Box(x, y, x + width, y + height)
