"""A small net that proposes where a red disc might be. It only proposes: the rim evidence and the gates judge. Pure.

The net (proposer.onnx) was trained by `training.proposer` on generated pictures. It sees the picture reduced to WIDTH x
HEIGHT, in colours from which a veil and the light are divided out, and gives for every cell of CELL x CELL px how
sure it is that a disc's centre lies there, where in the cell, and the radius.
"""

from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.config import VisionConfig
from gateway.errors import ConfigError
from gateway.vision.detect.robust import proposer_file
from gateway.vision.detect.robust.candidates import Seed
from gateway.vision.detect.robust.redness import DARK, Plane, PyramidLevel

WIDTH, HEIGHT, CELL = 160, 128, 4  # px of the net's picture
CHANNELS = 6
AROUND = 41  # px, side of the square that a pixel is compared with
LEAST_SPREAD = 1.0  # grey levels: less contrast in that square is noise
SMALLEST_SIDE = 8  # px of a picture or window that is worth it
PROPOSED = 8  # at most
LEAST = 0.1  # how sure the net must be
RADIUS_PX = 8.0  # of the net's picture: where the logarithm of a radius is 0


class Proposer:
    """Seeds from a picture. Not for two threads at once: the net keeps its intermediate results."""

    def __init__(self, net: cv2.dnn.Net) -> None:
        self._net = net

    def __call__(self, levels: Sequence[PyramidLevel]) -> list[Seed]:
        """The surest first; `levels`: the picture's pyramid, finest first."""
        level = _suitable(levels)
        height, width = level.bgr.shape[:2]
        if min(height, width) < SMALLEST_SIDE:
            return []
        picture = reduced(level)
        return [
            Seed(
                level.to_full((seed.u_px + 0.5) * width / picture.shape[1] - 0.5),
                level.to_full((seed.v_px + 0.5) * height / picture.shape[0] - 0.5),
                seed.radius_px * width / picture.shape[1] * level.factor,
                seed.weight,
            )
            for seed in peaks(self.maps(blob(inputs(picture))), picture.shape[:2])
        ]

    def maps(self, x: NDArray[np.float32]) -> Plane:
        """(1, CHANNELS, HEIGHT, WIDTH) to (4, rows, columns) of cells.

        How sure the net is of a centre, 0 to 1; its place from the cell's middle, cells; the radius, log of RADIUS_PX.
        """
        self._net.setInput(x)
        answer: Plane = np.asarray(self._net.forward(), np.float32)[0]
        return answer


@lru_cache(maxsize=1)
def shipped() -> Proposer:
    """The shipped net, read once in a process. Raises ConfigError if its file is missing or damaged."""
    return made(proposer_file.read())


def prepare(params: VisionConfig) -> None:
    """Before the first frame, where the settings need the net. Raises as `shipped`."""
    if params.proposals != "classical":
        shipped()


def made(data: bytes) -> Proposer:
    """Of an ONNX file. Raises ConfigError for what OpenCV cannot use."""
    try:
        return Proposer(cv2.dnn.readNetFromONNX(np.frombuffer(data, np.uint8)))
    except cv2.error as error:
        raise ConfigError(proposer_file.unusable(proposer_file.PATH, f"cannot be used: {error.err}")) from error


def _suitable(levels: Sequence[PyramidLevel]) -> PyramidLevel:
    """The coarsest level of at least twice the net's picture: the rest of the reduction is in float."""
    large = [level for level in levels if level.bgr.shape[1] >= 2 * WIDTH or level.bgr.shape[0] >= 2 * HEIGHT]
    return large[-1] if large else levels[0]


def reduced(level: PyramidLevel) -> Plane:
    """(h, w, 3) float32 BGR, 0 to 255: the picture at its own shape, as large as WIDTH x HEIGHT allows."""
    height, width = level.bgr.shape[:2]
    scale = min(WIDTH / width, HEIGHT / height)
    size = max(1, round(width * scale)), max(1, round(height * scale))
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(level.bgr.astype(np.float32), size, interpolation=how), np.float32)


def inputs(picture: Plane) -> Plane:
    """(h, w, 3) BGR to (CHANNELS, h, w) float32.

    Brightness, red against green and green against blue, each less its mean in the square round the pixel, by the
    spread there: a veil and the light change all of these by the same factor. Then the logarithms of R/G and G/B, which
    tell paint from wood in clear air, and the brightness.
    """
    blue, green, red = (np.ascontiguousarray(picture[..., channel]) for channel in range(3))
    planes = [(blue + green + red) / 3, red - green, green - blue]
    side = (AROUND, AROUND)
    lasting = [np.asarray(cv2.blur(plane, side, borderType=cv2.BORDER_REFLECT), np.float32) for plane in planes]
    apart = [plane - mean for plane, mean in zip(planes, lasting, strict=True)]
    light, red_green, green_blue = apart
    power = light * light + red_green * red_green + green_blue * green_blue
    # The filter's running sums leave a little less than nothing on even ground.
    square = np.maximum(np.asarray(cv2.blur(power, side, borderType=cv2.BORDER_REFLECT), np.float32), 0)
    share = 1 / (np.sqrt(square) + np.float32(LEAST_SPREAD))
    logs = np.log(picture + np.float32(DARK))
    return np.stack(
        [
            *(np.clip(plane * share, -4, 4) for plane in apart),
            logs[..., 2] - logs[..., 1],
            logs[..., 1] - logs[..., 0],
            planes[0] / 128 - 1,
        ]
    ).astype(np.float32)


def blob(channels: Plane) -> NDArray[np.float32]:
    """(1, CHANNELS, HEIGHT, WIDTH): 0 where there is no picture."""
    full = np.zeros((1, CHANNELS, HEIGHT, WIDTH), np.float32)
    full[0, :, : channels.shape[1], : channels.shape[2]] = channels
    return full


def peaks(maps: Plane, shape: tuple[int, ...]) -> list[Seed]:
    """Seeds in px of the net's picture, of which (h, w) `shape` is used; `maps` as in `Proposer`.

    Place and radius are the mean of what the cells in 3 x 3 round the peak say, each as sure as it is.
    """
    sure = maps[0]
    top = (sure >= LEAST) & (sure >= np.asarray(cv2.dilate(sure, np.ones((3, 3), np.uint8))))
    surest = np.argwhere(top)[np.argsort(-sure[top], kind="stable")[:PROPOSED]]
    said = np.concatenate([np.indices(sure.shape)[::-1] + 0.5 + maps[1:3], np.clip(maps[3:], -3, 3)])
    seeds = []
    for row, column in surest:
        near = slice(max(0, row - 1), row + 2), slice(max(0, column - 1), column + 2)
        x, y, size = (np.einsum("kij,ij->k", said[:, *near], sure[near]) / sure[near].sum()).tolist()
        u, v, radius = x * CELL - 0.5, y * CELL - 0.5, RADIUS_PX * float(np.exp(size))
        if -radius < u < shape[1] + radius and -radius < v < shape[0] + radius:
            seeds.append(Seed(u, v, radius, float(sure[row, column])))
    return seeds
