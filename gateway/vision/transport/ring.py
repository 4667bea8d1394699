"""The ring: frames in memory that the camera process writes and the vision processes look at in place.

The memory is anonymous (memfd): it has no name, so nothing can be left behind, and the kernel frees it with the last
process that holds it, however that process ended. It is sparse: sized for the largest frame allowed, but only pages
that were written exist.

Every slot begins with a header of int64 (generation, height, width, number and capture time of the frame, and when each
tile of it last changed) on a page of its own; the pixels, (height, width, 3) uint8, follow. The generation is odd while
the slot is being written and even when it is whole (a seqlock); it never repeats. Slots are handed over by messages and
given back by messages, so in normal running no slot is written while a detector looks at it; the generation proves it,
or tells that a result must be thrown away. A viewer (`snapshot`) holds no slot and asks nobody: it copies, and the
generation tells whether to keep it.
"""

import fcntl
import mmap
import os
import stat
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.errors import LinkError
from gateway.vision.pixels import Image
from gateway.vision.source.freshness import TILES, Changes

PAGE = mmap.PAGESIZE
GENERATION, HEIGHT, WIDTH, SEQ, T_CAPTURE_NS = range(5)
HEADER_FIELDS = 5
CHANGED_NS = slice(HEADER_FIELDS, HEADER_FIELDS + TILES[0] * TILES[1])


@dataclass(frozen=True, slots=True)
class RingSpec:
    """All that a process needs to attach, given that it inherited the descriptor."""

    fd: int
    slots: int
    max_megapixels: float

    @property
    def slot_bytes(self) -> int:
        """Header page and pixels, in whole pages."""
        pixels = round(self.max_megapixels * 1e6)
        return PAGE + -(-pixels * 3 // PAGE) * PAGE

    @property
    def size_bytes(self) -> int:
        return self.slots * self.slot_bytes


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A copy of a frame, for people to look at."""

    image: Image
    seq: int
    t_capture_ns: int


def create(slots: int, max_megapixels: float) -> RingSpec:
    """New anonymous memory; the caller closes `fd`. Its size is sealed, so no process can shrink it under another.

    Who writes is given this descriptor: its mode lets nobody open the memory for writing by another way.
    """
    fd = os.memfd_create("gateway-frames", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    spec = RingSpec(fd, slots, max_megapixels)
    os.ftruncate(fd, spec.size_bytes)
    fcntl.fcntl(fd, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL)
    os.fchmod(fd, stat.S_IRUSR)
    return spec


def reader(spec: RingSpec) -> RingSpec:
    """The same memory behind a descriptor of its own that can't be mapped for writing; the caller closes `fd`."""
    fd = os.open(f"/proc/self/fd/{spec.fd}", os.O_RDONLY | os.O_CLOEXEC)
    return RingSpec(fd, spec.slots, spec.max_megapixels)


class Ring:
    """One process's view of the memory. A reader's is read-only, and so is its descriptor: no detector, and nobody who
    has got hold of a web process, can scribble over a frame."""

    def __init__(self, spec: RingSpec, *, writable: bool) -> None:
        self._spec = spec
        access = mmap.ACCESS_WRITE if writable else mmap.ACCESS_READ
        self._memory = mmap.mmap(spec.fd, spec.size_bytes, access=access)
        self._headers = tuple(
            np.frombuffer(self._memory, np.int64, CHANGED_NS.stop, slot * spec.slot_bytes) for slot in range(spec.slots)
        )
        self._pictures: dict[int, Image] = {}  # by slot, of the size that it had the last time

    def write(
        self, slot: int, image: Image, seq: int = 0, t_capture_ns: int = 0, changed_ns: Changes | None = None
    ) -> int:
        """Copy one frame into a slot; returns its generation. Raises LinkError for a frame that is too large."""
        height, width = image.shape[:2]
        if height * width > round(self._spec.max_megapixels * 1e6):
            raise LinkError(
                f"frame of {width} x {height} = {height * width / 1e6:.1f} megapixels, "
                f"more than camera.max_megapixels = {self._spec.max_megapixels:g}"
            )
        header = self._header(slot)
        generation = (int(header[GENERATION]) | 1) + 2  # odd, and new even if the last writer died half way
        header[GENERATION] = generation
        header[HEIGHT:HEADER_FIELDS] = (height, width, seq, t_capture_ns)
        header[CHANGED_NS] = t_capture_ns if changed_ns is None else changed_ns.ravel()
        np.copyto(self._pixels(slot, height, width), image)
        header[GENERATION] = generation + 1
        return generation + 1

    def view(self, slot: int, generation: int) -> Image | None:
        """The frame in place, read-only; None if the slot does not hold this generation whole (any more)."""
        header = self._header(slot)
        height, width = int(header[HEIGHT]), int(header[WIDTH])
        return self._pixels(slot, height, width) if self.holds(slot, generation) else None

    def holds(self, slot: int, generation: int) -> bool:
        """Whether the slot (still) holds this generation whole. True after the work: the work saw one frame only."""
        return int(self._header(slot)[GENERATION]) == generation

    def changed_ns(self, slot: int) -> Changes:
        """A copy of what was written with the frame. As of `view`: ask afterwards whether the slot still holds it."""
        return self._header(slot)[CHANGED_NS].reshape(TILES).copy()

    def newest_px(self) -> tuple[int, int] | None:
        """Width and height of the newest frame; None: nothing was ever written. For the writer."""
        whole = [h for h in self._headers if h[GENERATION] and not h[GENERATION] % 2]
        newest = max(whole, key=lambda header: int(header[SEQ]), default=None)
        return None if newest is None else (int(newest[WIDTH]), int(newest[HEIGHT]))

    def snapshot(self, seq: int | None = None) -> Snapshot | None:
        """A copy of frame `seq`, or of the newest; None where it is not (or no longer) in the memory whole."""
        whole = []
        for slot in range(self._spec.slots):
            header = self._header(slot)[:HEADER_FIELDS].tolist()
            if header[GENERATION] and not header[GENERATION] % 2 and (seq is None or header[SEQ] == seq):
                whole.append((header[T_CAPTURE_NS], slot, header))
        for t_capture_ns, slot, header in sorted(whole, reverse=True):
            if header[HEIGHT] * header[WIDTH] > round(self._spec.max_megapixels * 1e6):
                continue  # read while it was written: half of an old size, half of a new one
            image = self._pixels(slot, header[HEIGHT], header[WIDTH]).copy()
            if self.holds(slot, header[GENERATION]):
                return Snapshot(image, header[SEQ], t_capture_ns)
        return None

    def _header(self, slot: int) -> NDArray[np.int64]:
        if not 0 <= slot < self._spec.slots:
            raise IndexError(f"slot {slot} of {self._spec.slots}")
        return self._headers[slot]

    def _pixels(self, slot: int, height: int, width: int) -> Image:
        known = self._pictures.get(slot)
        if known is not None and known.shape == (height, width, 3):
            return known
        flat = np.frombuffer(self._memory, np.uint8, height * width * 3, slot * self._spec.slot_bytes + PAGE)
        self._pictures[slot] = flat.reshape(height, width, 3)
        return self._pictures[slot]
