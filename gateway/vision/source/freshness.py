"""Is a picture new? A dead encoder or driver can repeat one picture endlessly, each time with a fresh stamp. Pure.

A real sensor has noise: no part of two frames of it is equal to the last bit. What is equal was taken at the same
moment, so it is as old as its first sight. The picture is compared in tiles, for a clock that is burnt into a dead
picture continues: a place in it (the marker, or all of it) is as new as the moment since which at least half of its
tiles have changed.
"""

from enum import Enum, auto
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gateway.core.detection import Circle
from gateway.durations import NS_PER_S
from gateway.vision.pixels import AnyImage

TILES = (12, 16)  # rows and columns of tiles
ROWS = 5  # of pixels that are compared in each tile: 0.02 ms at VGA, 0.04 ms at 1080p

Samples = NDArray[np.uint8] | NDArray[np.uint16]
Changes = NDArray[np.int64]
"""(12, 16): the capture time of the frame in which each tile last changed, ns."""


class Freshness(Enum):
    LIVE = auto()
    UNPROVEN = auto()  # nothing has changed since the source was opened: not to be shown yet
    FROZEN = auto()


class FrozenFrameDetector:
    """One opened source, whose frames are in order and have one size. `frozen_s`: unchanged for this time is frozen.

    It keeps the newest frame, which its source does not write into.
    """

    def __init__(self, frozen_s: float) -> None:
        self._frozen_ns = round(frozen_s * NS_PER_S)
        self._last: AnyImage | None = None
        self._sparse: Samples | None = None  # one row of each row of tiles of it, (12, 3 * width)
        self._first_ns = 0
        self.changed_ns: Changes = np.zeros(TILES, np.int64)

    def judge(self, image: AnyImage, t_ns: int) -> Freshness:
        """The verdict on the frame of `t_ns`; afterwards `changed_ns` holds for this frame.

        A source opened again must change once before it is believed.
        """
        height, width = image.shape[:2]
        last, sparse_before, self._last = self._last, self._sparse, image
        self._sparse = sparse = image.reshape(height, -1)[_middles(height)]
        if last is None or sparse_before is None:
            self._first_ns = t_ns
            self.changed_ns = np.full(TILES, t_ns, np.int64)
            return Freshness.UNPROVEN
        # A live picture changes everywhere, and one row of each tile shows it, nearly always.
        if np.bitwise_or.reduceat(sparse ^ sparse_before, _columns(width), axis=1).all():
            self.changed_ns, seen_ns = np.full(TILES, t_ns, np.int64), t_ns
        else:
            sample = _sampled(image)
            changed = _by_tile(np.bitwise_or, sample ^ _sampled(last), _columns(width)) != 0
            if 2 * np.count_nonzero(changed) < changed.size:
                changed = _with_flat(changed, sample, width)
            self.changed_ns = np.where(changed, t_ns, self.changed_ns)
            seen_ns = _half_changed_ns(self.changed_ns)
        if t_ns - seen_ns > self._frozen_ns:
            return Freshness.FROZEN
        return Freshness.UNPROVEN if seen_ns == self._first_ns else Freshness.LIVE


def unchanged_since_ns(changed_ns: Changes, width_px: int, height_px: int, circle: Circle | None) -> int:
    """How new what was found is: by the tiles that the disc touches, or by all of them where there is none."""
    one_ns = int(changed_ns[0, 0])
    if np.equal(changed_ns, one_ns).all():
        return one_ns  # as the rest would find
    if circle is None:
        return _half_changed_ns(changed_ns)
    du = _distance(circle.u_px, _edges(width_px, TILES[1]), width_px)
    dv = _distance(circle.v_px, _edges(height_px, TILES[0]), height_px)
    distance: NDArray[np.float64] = np.hypot(dv[:, None], du[None, :])
    touched = np.less_equal(distance, circle.radius_px)
    if not touched.any():  # beyond the picture's edge
        touched = np.equal(distance, distance.min())
    return _half_changed_ns(changed_ns[touched])


def _half_changed_ns(changed_ns: Changes) -> int:
    """The latest moment since which at least half of these tiles have changed."""
    place = changed_ns.size // 2
    return int(np.partition(changed_ns, place, axis=None)[place])


def _with_flat(changed: NDArray[np.bool_], sample: Samples, width: int) -> NDArray[np.bool_]:
    """A tile of one colour (clipped at black or white) has no noise, so it has no result: it follows the rest."""
    pixels = sample.reshape(len(sample), width, 3)
    columns = _edges(width, TILES[1])
    darkest, brightest = (_by_tile(ufunc, pixels, columns) for ufunc in (np.minimum, np.maximum))
    flat = np.equal(darkest, brightest).all(axis=-1) & ~changed
    telling = changed.size - int(np.count_nonzero(flat))
    return changed | flat if 2 * int(np.count_nonzero(changed)) >= max(1, telling) else changed


def _by_tile(ufunc: np.ufunc, sample: Samples, columns: NDArray[np.intp]) -> Samples:
    """`ufunc` over the sampled rows and the columns of each tile."""
    rows = ufunc.reduce(sample.reshape(TILES[0], ROWS, *sample.shape[1:]), axis=1)
    return np.asarray(ufunc.reduceat(rows, columns, axis=1))


def _sampled(image: AnyImage) -> Samples:
    """(12 * ROWS, 3 * width): the rows that are compared."""
    height = image.shape[0]
    return image.reshape(height, -1).take(_edges(height, TILES[0] * ROWS), axis=0)


@lru_cache(maxsize=4)
def _middles(height: int) -> NDArray[np.intp]:
    """One of the rows that are compared of each row of tiles."""
    return _edges(height, TILES[0] * ROWS)[ROWS // 2 :: ROWS]


@lru_cache(maxsize=4)
def _columns(width: int) -> NDArray[np.intp]:
    """Where the columns of tiles begin in a row of samples."""
    return 3 * _edges(width, TILES[1])


def _edges(length: int, parts: int) -> NDArray[np.intp]:
    """Where each of the parts begins."""
    return np.arange(parts) * length // parts


def _distance(place: float, begins: NDArray[np.intp], length: int) -> NDArray[np.float64]:
    """From a place to each part, 0 within it."""
    ends = np.append(begins[1:], length)
    return np.asarray(np.maximum(0.0, np.maximum(begins - place, place - ends)), np.float64)
