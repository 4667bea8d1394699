"""Is a picture new? A dead encoder or driver can repeat one picture for ever, each time with a fresh stamp. Pure.

A real sensor has noise, so two frames of it are never equal to the last bit. Frames that are equal for longer than
`camera.frozen_s` are therefore one frame: an old good-looking value, which is the worst a camera can say.
"""

import zlib
from enum import Enum, auto

from gateway.vision.pixels import Image

ROWS = 16  # every so-manieth row is looked at: 0.07 ms at 1080p
NS_PER_S = 1_000_000_000


class Look(Enum):
    LIVE = auto()
    UNPROVEN = auto()  # nothing has changed since the source was opened: not to be shown yet
    FROZEN = auto()


class Stillness:
    """One opened source. `frozen_s` = 0 takes every frame for live."""

    def __init__(self, frozen_s: float) -> None:
        self._frozen_ns = round(frozen_s * NS_PER_S)
        self._print: int | None = None
        self._since_ns = 0
        self._changed = False

    def look(self, image: Image, t_ns: int) -> Look:
        """The verdict on the frame of `t_ns`. A source opened again must change once before it is believed."""
        if not self._frozen_ns:
            return Look.LIVE
        fingerprint = zlib.crc32(image[::ROWS].tobytes())
        if fingerprint != self._print:
            self._changed = self._changed or self._print is not None
            self._print, self._since_ns = fingerprint, t_ns
        elif t_ns - self._since_ns > self._frozen_ns:
            return Look.FROZEN
        return Look.LIVE if self._changed else Look.UNPROVEN
