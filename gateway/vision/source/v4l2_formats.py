"""What a V4L2 camera can give: pixel formats, sizes and rates, by the kernel's own calls. IO.

Nothing is set and no stream is started, so a camera that another program uses answers, too. After linux/videodev2.h.
"""

import errno
import fcntl
import os
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass

QUERYCAP, ENUM_FMT = 0x80685600, 0xC0405602
ENUM_FRAMESIZES, ENUM_FRAMEINTERVALS = 0xC02C564A, 0xC034564B
CAPABILITY = struct.Struct("=16s32s32sIII12x")
FORMAT = struct.Struct("=III32sI16x")
SIZE_BYTES, INTERVAL_BYTES = 44, 52  # v4l2_frmsizeenum, v4l2_frmivalenum
VIDEO_CAPTURE, VIDEO_CAPTURE_MPLANE, DEVICE_CAPS = 0x1, 0x1000, 0x80000000
DISCRETE = 1  # of sizes and intervals; else there is a range of them
MAX_FORMATS, MAX_SIZES, MAX_RATES = 16, 32, 16  # of one camera; a driver that never ends its list is cut
NOT_MORE = (errno.EINVAL, errno.ENOTTY)

Ioctl = Callable[[int, int, bytearray], object]


@dataclass(frozen=True, slots=True)
class Mode:
    """One size in one pixel format. `rates_hz`: the fastest first; empty: the driver does not say."""

    pixel_format: str  # FourCC, as MJPG
    width_px: int
    height_px: int
    rates_hz: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Capabilities:
    """Of one node. `modes` is empty where it gives no pictures: the second node of a USB camera gives metadata."""

    card: str
    gives_pictures: bool
    modes: tuple[Mode, ...] = ()


def capabilities(path: str, ioctl: Ioctl = fcntl.ioctl) -> Capabilities:
    """Raises OSError where the node can't be opened or is not a V4L2 device. A driver that hangs does not return."""
    fd = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        record = bytearray(CAPABILITY.size)
        ioctl(fd, QUERYCAP, record)
        _, card, _, _, all_caps, node_caps = CAPABILITY.unpack(record)
        caps = node_caps if all_caps & DEVICE_CAPS else all_caps
        name = card.partition(b"\0")[0].decode(errors="replace")
        if not caps & (VIDEO_CAPTURE | VIDEO_CAPTURE_MPLANE):
            return Capabilities(name, gives_pictures=False)
        kind = 1 if caps & VIDEO_CAPTURE else 9  # V4L2_BUF_TYPE_VIDEO_CAPTURE, _MPLANE
        return Capabilities(name, gives_pictures=True, modes=tuple(_modes(fd, kind, ioctl)))
    finally:
        os.close(fd)


def _modes(fd: int, kind: int, ioctl: Ioctl) -> Iterator[Mode]:
    for row in _rows(fd, ENUM_FMT, FORMAT.size, MAX_FORMATS, ioctl, lambda n: struct.pack("=II", n, kind)):
        fourcc = FORMAT.unpack(row)[4]
        name = struct.pack("=I", fourcc & 0x7FFFFFFF).decode("ascii", errors="replace").rstrip()
        for width, height in _sizes(fd, fourcc, ioctl):
            yield Mode(name, width, height, tuple(_rates_hz(fd, fourcc, width, height, ioctl)))


def _sizes(fd: int, fourcc: int, ioctl: Ioctl) -> Iterator[tuple[int, int]]:
    """Of a range, the largest."""
    for row in _rows(fd, ENUM_FRAMESIZES, SIZE_BYTES, MAX_SIZES, ioctl, lambda n: struct.pack("=II", n, fourcc)):
        kind, *numbers = struct.unpack_from("=7I", row, 8)
        if kind == DISCRETE:
            yield numbers[0], numbers[1]
        else:  # min_width, max_width, step_width, min_height, max_height, step_height
            yield numbers[1], numbers[4]
            return


def _rates_hz(fd: int, fourcc: int, width: int, height: int, ioctl: Ioctl) -> list[float]:
    """Of a range, the fastest."""
    found: set[float] = set()
    begin = struct.pack("=III", fourcc, width, height)
    for row in _rows(fd, ENUM_FRAMEINTERVALS, INTERVAL_BYTES, MAX_RATES, ioctl, lambda n: struct.pack("=I", n) + begin):
        kind, numerator, denominator = struct.unpack_from("=3I", row, 16)
        if numerator:
            found.add(round(denominator / numerator, 2))
        if kind != DISCRETE:
            break
    return sorted(found, reverse=True)


def _rows(
    fd: int, request: int, size: int, most: int, ioctl: Ioctl, head: Callable[[int], bytes]
) -> Iterator[bytearray]:
    """An enumeration: by index, until the driver has no more."""
    for n in range(most):
        record = bytearray(head(n).ljust(size, b"\0"))
        try:
            ioctl(fd, request, record)
        except OSError as error:
            if error.errno in NOT_MORE:
                return
            raise
        yield record
