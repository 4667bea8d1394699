"""Frames in shared memory, for display: the vision process writes, viewers copy.

The memory is anonymous (memfd): it has no name, so nothing can be left behind, and the kernel frees it with the last
process that holds it, however that process ended. It is sparse: sized for the largest frame allowed, but only pages
that were written exist.

Page 0 holds the vision process's progress (`progress`). Every slot begins with a header of int64 (generation, height,
width, number and capture time of the frame) on a separate page; the pixels, (height, width, 3) uint8, follow. The
generation is odd while the slot is being written and even when it is complete (a seqlock); it never repeats. A viewer
holds no slot: it copies, and the generation shows whether the copy is of one frame.

A copy costs 0.9 ms at 1080p, so frames are written only while there is a viewer: each `snapshot` requests them for
`REQUEST_NS`, by an eventfd that the viewer holds. Without a request one frame a second is written: the first view of a
bay shows a picture at once, and that of a lost camera its last one.
"""

import mmap
import os
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from gateway.durations import NS_PER_S
from gateway.vision.pixels import Image
from gateway.vision.transport.ring_spec import PAGE, SLOTS, RingSpec

GENERATION, HEIGHT, WIDTH, SEQ, T_CAPTURE_NS = range(5)
HEADER_FIELDS = 5
REQUEST_NS = 3 * NS_PER_S
UNREQUESTED_PERIOD_NS = NS_PER_S


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A copy of a frame, for display."""

    image: Image
    seq: int
    t_capture_ns: int


class Ring:
    """One process's view of the memory. A reader's is read-only, and so is its descriptor: an intruder in
    the web process can't write into a frame."""

    def __init__(self, spec: RingSpec, *, writable: bool) -> None:
        self._spec = spec
        access = mmap.ACCESS_WRITE if writable else mmap.ACCESS_READ
        self._memory = mmap.mmap(spec.fd, spec.size_bytes, access=access)
        self._headers = tuple(
            np.frombuffer(self._memory, np.int64, HEADER_FIELDS, spec.offset(slot)) for slot in range(SLOTS)
        )
        self._next = 0
        self._requests = bytearray(8)
        self._requested_until_ns = 0
        self._written_ns = -UNREQUESTED_PERIOD_NS

    # The vision process.

    def due(self, now_ns: int) -> bool:
        """Whether the frame at hand is to be written: there is a viewer, or the last one was written a second ago."""
        if self._requested():
            self._requested_until_ns = now_ns + REQUEST_NS
        return now_ns < self._requested_until_ns or now_ns - self._written_ns >= UNREQUESTED_PERIOD_NS

    def _requested(self) -> bool:
        """Never waits, not even if an intruder in a web process has made the eventfd blocking."""
        try:
            return os.preadv(self._spec.request_fd, (self._requests,), -1, os.RWF_NOWAIT) > 0
        except BlockingIOError:
            return False
        except OSError:  # a kernel before 5.8: every frame is written
            return True

    def write(self, image: Image, seq: int, t_capture_ns: int, now_ns: int = 0) -> None:
        """Copy one frame, of at most `max_megapixels`, over the oldest one."""
        slot, self._next = self._next, (self._next + 1) % SLOTS
        height, width = image.shape[:2]
        header = self._headers[slot]
        generation = (int(header[GENERATION]) | 1) + 2  # odd, and new even if the last writer died half way
        header[GENERATION] = generation
        header[HEIGHT:HEADER_FIELDS] = (height, width, seq, t_capture_ns)
        np.copyto(self._pixels(slot, height, width), image)
        header[GENERATION] = generation + 1
        self._written_ns = now_ns

    # Viewers.

    def snapshot(self, seq: int | None = None, *, request: bool = True) -> Snapshot | None:
        """A copy of frame `seq`, or of the newest; None where it is not (or no longer) completely in the memory.

        Requests the next frames, too, unless told otherwise.
        """
        if request:
            with suppress(BlockingIOError):  # there are 2**64 unread requests
                os.eventfd_write(self._spec.request_fd, 1)
        complete = []
        for slot in range(SLOTS):
            header = self._headers[slot].tolist()
            if header[GENERATION] and not header[GENERATION] % 2 and (seq is None or header[SEQ] == seq):
                complete.append((header[T_CAPTURE_NS], slot, header))
        for t_capture_ns, slot, header in sorted(complete, reverse=True):
            height, width = header[HEIGHT], header[WIDTH]
            if min(height, width) <= 0 or height * width > round(self._spec.max_megapixels * 1e6):
                continue  # read while it was written: half of an old size, half of a new one; or nonsense
            image = self._pixels(slot, height, width).copy()
            if int(self._headers[slot][GENERATION]) == header[GENERATION]:
                return Snapshot(image, header[SEQ], t_capture_ns)
        return None

    def _pixels(self, slot: int, height: int, width: int) -> Image:
        flat = np.frombuffer(self._memory, np.uint8, height * width * 3, self._spec.offset(slot) + PAGE)
        return flat.reshape(height, width, 3)
