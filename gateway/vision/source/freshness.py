"""Is a picture new? A dead sensor, encoder or driver repeats one picture endlessly, each with a fresh stamp. Pure.

A real sensor has noise: no part of two frames of it is equal to the last bit. What is equal was taken at the same
moment. The picture is compared in tiles, for a clock that is burnt into a dead picture continues: a place in it (the
marker, or all of it) is as new as the moment since which at least half of its tiles have changed.

It is compared with the last frame and with that earlier one that has the most tiles in common with it: an encoder that
varies its quality, and a film in a loop, show other pictures in between. Tiles that are equal to those of different
frames do not count together: a few values of each tile come again by chance in a compressed live picture.
"""

from enum import Enum, auto
from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from gateway.core.detection import Circle
from gateway.durations import NS_PER_S
from gateway.vision.pixels import AnyImage

TILES = (12, 16)  # rows and columns of tiles
ROWS = 5  # of pixels that are compared in each tile
MEMORY = 256  # frames: 10 s at 25 frames a second
PROOFS = 5  # frames that must be new before a source is believed: a dead picture encoded anew has some, too

Samples = NDArray[np.uint8] | NDArray[np.uint16]
Hashes = NDArray[np.uint32]
Changes = NDArray[np.int64]
"""(12, 16): the capture time of the frame in which each tile last changed, ns."""


class Freshness(Enum):
    LIVE = auto()
    UNPROVEN = auto()  # too few frames were new since the source was opened: not to be shown yet
    FROZEN = auto()


class FrozenFrameDetector:
    """One opened source, whose frames are in order and have one size. `frozen_s`: unchanged for this time is frozen."""

    def __init__(self, frozen_s: float) -> None:
        self._frozen_ns = round(frozen_s * NS_PER_S)
        self._seen = np.zeros((TILES[0] * TILES[1], MEMORY), np.uint32)  # hashes of the newest frames' tiles
        self._frames = 0
        self._proofs = 0  # frames that were new, up to PROOFS
        self.changed_ns: Changes = np.zeros(TILES, np.int64)

    def judge(self, image: AnyImage, t_ns: int) -> Freshness:
        """The verdict on the frame of `t_ns`; afterwards `changed_ns` holds for this frame.

        A source opened again must be new in PROOFS frames before it is believed.
        """
        sample = _sampled(image)
        tiles = _hashed(sample)
        same = np.equal(self._seen[:, : self._frames], tiles.reshape(-1, 1))
        last = (self._frames - 1) % MEMORY
        self._seen[:, self._frames % MEMORY] = tiles.ravel()
        self._frames += 1
        if self._frames == 1:
            self.changed_ns = np.full(TILES, t_ns, np.int64)
            return Freshness.UNPROVEN
        likest = same.sum(axis=0, dtype=np.uint8).argmax()
        changed = ~(same[:, likest] | same[:, last]).reshape(TILES)
        if 2 * np.count_nonzero(changed) < changed.size:
            changed = _with_flat(changed, sample, image.shape[1])
        self.changed_ns = np.where(changed, t_ns, self.changed_ns)
        seen_ns = _half_changed_ns(self.changed_ns)
        self._proofs = min(PROOFS, self._proofs + (seen_ns == t_ns))
        if t_ns - seen_ns > self._frozen_ns:
            return Freshness.FROZEN
        return Freshness.LIVE if self._proofs == PROOFS else Freshness.UNPROVEN


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


def _hashed(sample: Samples) -> Hashes:
    """(12, 16): a number for each tile, other than that of another content; tiles begin at whole words."""
    content = sample.view(np.uint8)
    if over := content.shape[1] % np.uint32().nbytes:
        content = np.pad(content, ((0, 0), (0, np.uint32().nbytes - over)))
    words = content.view(np.uint32)
    mixed = (words * _weights(words.shape[1])).reshape(TILES[0], ROWS, -1)
    by_row = np.add.reduce(mixed, axis=1, dtype=np.uint32)
    return np.asarray(np.add.reduceat(by_row, _edges(words.shape[1], TILES[1]), axis=1, dtype=np.uint32))


@lru_cache(maxsize=4)
def _weights(words: int) -> Hashes:
    """(12 * ROWS, words): odd numbers, other ones in each row."""
    count = TILES[0] * ROWS
    odd = np.random.default_rng(0).integers(2**32, size=words + count - 1, dtype=np.uint32) | np.uint32(1)
    return sliding_window_view(odd, words)


def _edges(length: int, parts: int) -> NDArray[np.intp]:
    """Where each of the parts begins."""
    return np.arange(parts) * length // parts


def _distance(place: float, begins: NDArray[np.intp], length: int) -> NDArray[np.float64]:
    """From a place to each part, 0 within it."""
    ends = np.append(begins[1:], length)
    return np.asarray(np.maximum(0.0, np.maximum(begins - place, place - ends)), np.float64)
