"""The controls of a V4L2 device, by the kernel's own calls: OpenCV passes raw values and no limits. IO.

A second handle on the device: controls are the device's, and setting them disturbs no stream. After linux/videodev2.h
and linux/v4l2-controls.h.
"""

import fcntl
import os
import struct
from dataclasses import dataclass

QUERYCTRL, G_CTRL, S_CTRL = 0xC0445624, 0xC008561B, 0xC008561C
QUERY, CONTROL = struct.Struct("=II32siiiiI8x"), struct.Struct("=Ii")
EXPOSURE_AUTO, EXPOSURE_ABSOLUTE, EXPOSURE_AUTO_PRIORITY = 0x9A0901, 0x9A0902, 0x9A0903
FOCUS_ABSOLUTE, FOCUS_AUTO, ZOOM_ABSOLUTE = 0x9A090A, 0x9A090C, 0x9A090D
BRIGHTNESS, CONTRAST, SATURATION, AUTO_WHITE_BALANCE = 0x980900, 0x980901, 0x980902, 0x98090C
GAMMA, AUTOGAIN, GAIN, POWER_LINE_FREQUENCY = 0x980910, 0x980912, 0x980913, 0x980918
WHITE_BALANCE_TEMPERATURE, SHARPNESS, BACKLIGHT_COMPENSATION = 0x98091A, 0x98091B, 0x98091C
MANUAL = 1  # of EXPOSURE_AUTO
DISABLED, READ_ONLY = 0x1, 0x4  # flags


@dataclass(frozen=True, slots=True)
class Range:
    """Of one control, in the driver's units."""

    least: int
    most: int
    step: int
    default: int = 0


class V4l2Device:
    """The controls of one device. Every call raises OSError where the driver refuses."""

    def __init__(self, path: str, fd: int | None = None) -> None:
        """`fd`: of the device, which is open already; it is this object's from now on."""
        self._fd = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC) if fd is None else fd

    def range_of(self, control: int) -> Range | None:
        """None: there is no such control, or it can't be set."""
        record = bytearray(QUERY.pack(control, 0, b"", 0, 0, 0, 0, 0))
        try:
            fcntl.ioctl(self._fd, QUERYCTRL, record)
        except OSError:
            return None
        _, _, _, least, most, step, default, flags = QUERY.unpack(record)
        if flags & (DISABLED | READ_ONLY) or most < least:
            return None
        return Range(least, most, max(1, step), default)

    def get(self, control: int) -> int:
        record = bytearray(CONTROL.pack(control, 0))
        fcntl.ioctl(self._fd, G_CTRL, record)
        return int(CONTROL.unpack(record)[1])

    def set(self, control: int, value: int) -> int:
        """Returns what it is now: a driver may round."""
        fcntl.ioctl(self._fd, S_CTRL, bytearray(CONTROL.pack(control, value)))
        return self.get(control)

    def again(self) -> "V4l2Device":
        """The same device, to be closed by itself; also where this process may open none any more."""
        return V4l2Device("", os.dup(self._fd))

    def close(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
        self._fd = -1


def device_path(device: int | str) -> str:
    """Of a camera's index; a path as it is."""
    return f"/dev/video{device}" if isinstance(device, int) else device
