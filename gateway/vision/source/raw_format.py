"""Which samples of more than 8 bits a V4L2 camera is asked for: `[camera.raw]`. Pure, and without OpenCV.

The four characters are those of linux/videodev2.h.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gateway.config import CameraConfig

# fmt: off
FOURCC = {
    "Y10": "Y10 ", "Y12": "Y12 ", "Y16": "Y16 ",
    "SRGGB10": "RG10", "SGRBG10": "BA10", "SGBRG10": "GB10", "SBGGR10": "BG10",
    "SRGGB12": "RG12", "SGRBG12": "BA12", "SGBRG12": "GB12", "SBGGR12": "BG12",
    "SRGGB16": "RG16", "SGRBG16": "GR16", "SGBRG16": "GB16", "SBGGR16": "BYR2",
    "SRGGB10P": "pRAA", "SGRBG10P": "pgAA", "SGBRG10P": "pGAA", "SBGGR10P": "pBAA",
    "SRGGB12P": "pRCC", "SGRBG12P": "pgCC", "SGBRG12P": "pGCC", "SBGGR12P": "pBCC",
}
"""`camera.raw.format` -> V4L2's four characters."""
# fmt: on


@dataclass(frozen=True, slots=True)
class RawFormat:
    """How a camera's samples become colours. `mosaic`: of the first two pixels in the first two rows; "": grey."""

    name: str
    mosaic: str
    black_level: int = 0  # in the format's own units
    red_gain: float = 1.0
    blue_gain: float = 1.0

    @property
    def bits(self) -> int:
        return int(self.name.removesuffix("P")[-2:])

    @property
    def packed(self) -> bool:
        return self.name.endswith("P")

    @property
    def fourcc(self) -> int:
        return sum(ord(letter) << 8 * n for n, letter in enumerate(FOURCC[self.name]))


def raw_format(config: "CameraConfig") -> RawFormat | None:
    """None: the driver's own colours of 8 bits."""
    raw = config.raw
    if raw.format is None:
        return None
    mosaic = raw.format[1:5] if raw.format.startswith("S") else raw.bayer or ""
    return RawFormat(raw.format, mosaic, raw.black_level, raw.red_gain, raw.blue_gain)
