"""`gige://` and `usb3://`: a GigE Vision or USB3 Vision camera by its address or serial number. Pure, without OpenCV.

Pixel formats have the names of GenICam's Pixel Format Naming Convention, and the older ones of GigE Vision 1.
"""

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from gateway.clock import Clock
from gateway.errors import ConfigError, SettingError
from gateway.vision.source.contract import Needs, Source
from gateway.vision.source.raw_format import RawFormat
from gateway.vision.source.v4l2_controls import ControlSetting, settings_of

if TYPE_CHECKING:
    from gateway.config import CameraConfig

MOSAICS = {"Mono": "", "BayerRG": "RGGB", "BayerGR": "GRBG", "BayerGB": "GBRG", "BayerBG": "BGGR"}
COLOURS = {
    **dict.fromkeys(("BGR8", "BGR8Packed"), "BGR"),
    **dict.fromkeys(("RGB8", "RGB8Packed"), "RGB"),
    **dict.fromkeys(("YUV422_8", "YUV422_YUYV_Packed"), "YUYV"),
    **dict.fromkeys(("YUV422_8_UYVY", "YUV422Packed"), "UYVY"),
}
"""Formats of 8 bits that need no mosaic filled in: the order of their bytes."""


@dataclass(frozen=True, slots=True)
class SampleFormat:
    """One sample a pixel. `packing`: "": each of more than 8 bits in two bytes; "p": the least bits first, without
    gaps; "Packed": GigE Vision's, two samples in three bytes, the least bits of both in the middle one."""

    mosaic: str  # as of `RawFormat`
    bits: int
    packing: str


def sample_format(name: str) -> SampleFormat | None:
    """None: it is none of one sample a pixel that is understood."""
    found = re.fullmatch(f"({'|'.join(MOSAICS)})(?:(8|16)|(10|12)(p|Packed)?)", name)
    if found is None:
        return None
    kind, whole, odd, packing = found.groups()
    return SampleFormat(MOSAICS[kind], int(whole or odd), packing or "")


AS_IT_IS = RawFormat("", "")


@dataclass(frozen=True, slots=True)
class GigeSpec:
    """`name`: address, serial number or another identifier of Aravis. None: the camera's own is kept."""

    needs: ClassVar[Needs] = Needs.DEVICE
    scheme: str
    name: str
    pixel_format: str | None = None
    packet_size_bytes: int | None = None  # None: negotiated
    offset_px: tuple[int, int] = (0, 0)
    width_px: int | None = None
    height_px: int | None = None
    fps: float | None = None
    by_arrival: bool = False  # else by the camera's clock
    late_s: float = 1.0
    raw: RawFormat = AS_IT_IS  # its black level and gains, for samples of more than 8 bits
    controls: tuple[ControlSetting, ...] = ()

    @property
    def label(self) -> str:
        return f"{self.scheme}://{self.name}"

    def open(self, clock: Clock) -> Source:
        from gateway.vision.source.gige_source import open_gige  # noqa: PLC0415 - OpenCV stays out of the main process

        return open_gige(self, clock)


def gige_spec(config: "CameraConfig") -> GigeSpec:
    """Raises ConfigError."""
    scheme, _, name = config.url.strip().partition("://")
    if not re.fullmatch(r"[\w.: -]{1,100}", name := name.removesuffix("/")):
        raise ConfigError(f"camera.url: {scheme}:// needs the camera's address or serial number")
    if config.username or config.password_file:
        raise SettingError("camera.username", "only a stream (rtsp://, http://) has users")
    gige = config.gige
    if gige.pixel_format not in (None, *COLOURS) and sample_format(gige.pixel_format or "") is None:
        known = "Mono, BayerRG, BayerGR, BayerGB or BayerBG with 8, 10, 10p, 10Packed, 12, 12p, 12Packed or 16"
        raise SettingError("camera.gige.pixel_format", f"known are {known}, and {', '.join(COLOURS)}")
    return GigeSpec(
        scheme.lower(),
        name,
        gige.pixel_format,
        gige.packet_size_bytes,
        (gige.offset_x_px, gige.offset_y_px),
        config.width_px,
        config.height_px,
        config.fps,
        by_arrival=config.frame_time == "arrival",
        late_s=config.deadline_s,
        raw=RawFormat("", "", config.raw.black_level, config.raw.red_gain, config.raw.blue_gain),
        controls=settings_of(config.controls),
    )
