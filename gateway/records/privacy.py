"""Pictures without what is nobody's business: coarse squares outside the region that matters. Pure."""

import cv2
import numpy as np

from gateway.vision.pixels import Image

SQUARE_PX = 24  # a face or a number plate some metres away is smaller, or not much larger
Region = tuple[int, int, int, int]  # left, top, width, height, px


def blurred_outside(image: Image, region: Region) -> Image:
    """A copy whose pixels outside `region` are the means of squares of SQUARE_PX; inside they are as they were.

    What was there can't be computed back. A region beyond the picture is cut to it.
    """
    height, width = image.shape[:2]
    coarse = (max(1, -(-width // SQUARE_PX)), max(1, -(-height // SQUARE_PX)))
    means = cv2.resize(image, coarse, interpolation=cv2.INTER_AREA)
    out = np.asarray(cv2.resize(means, (width, height), interpolation=cv2.INTER_NEAREST), dtype=image.dtype)
    left, top, wide, high = region
    rows, columns = slice(max(0, top), max(0, top + high)), slice(max(0, left), max(0, left + wide))
    out[rows, columns] = image[rows, columns]
    return out
