"""`[camera]` and `[vision]`: the source of frames, and how the marker is found in them. Pure."""

from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from gateway.config.sections.camera_controls import ControlsConfig
from gateway.config.sections.common import Reconnect
from gateway.config.strict import forms
from gateway.config.strict.errors import FieldError
from gateway.config.strict.section import NameIn, Section
from gateway.registry import Registry

DETECTION_METHODS = Registry(
    "detection method",
    "gateway.detection_methods",
    {
        "robust": "gateway.vision.detect.robust.method:METHOD",
        "paper": "gateway.vision.detect.paper.method:METHOD",
    },
)
"""By name the `Method` that finds the marker. A key whose description begins with such a name is that method's own."""

Hsv = tuple[
    Annotated[int, Field(ge=0, le=180, strict=True)],
    Annotated[int, Field(ge=0, le=255, strict=True)],
    Annotated[int, Field(ge=0, le=255, strict=True)],
]
LEAST_LEVEL, LEAST_SATURATION = 30, 0.25  # of a marker's colour
GainDb = Annotated[float, Field(ge=-20, le=80, strict=True)]
Proposals = Literal["classical", "learned", "both"]
Mosaic = Literal["RGGB", "GRBG", "GBRG", "BGGR"]
# fmt: off
RawFormatName = Literal[
    "Y10", "Y12", "Y16",
    "SRGGB10", "SGRBG10", "SGBRG10", "SBGGR10", "SRGGB12", "SGRBG12", "SGBRG12", "SBGGR12",
    "SRGGB16", "SGRBG16", "SGBRG16", "SBGGR16",
    "SRGGB10P", "SGRBG10P", "SGBRG10P", "SBGGR10P", "SRGGB12P", "SGRBG12P", "SGBRG12P", "SBGGR12P",
]
# fmt: on
Cpus = Annotated[tuple[Annotated[int, Field(ge=0, strict=True)], ...], Field(min_length=1)]


class Intrinsics(Section):
    """Pinhole intrinsics, px, with Brown-Conrady distortion; equation 11."""

    fx: float = Field(gt=0, le=100_000, description="focal length along u, px")
    fy: float = Field(gt=0, le=100_000, description="focal length along v, px")
    cx: float = Field(ge=-10_000, le=100_000, description="principal point, u, px")
    cy: float = Field(ge=-10_000, le=100_000, description="principal point, v, px")
    width_px: int | None = Field(
        None, ge=16, le=16384, description="width of the pictures that these numbers hold for; checked where given"
    )
    height_px: int | None = Field(None, ge=16, le=16384, description="their height")
    distortion: tuple[Annotated[float, Field(strict=True)], ...] = Field(
        (), max_length=14, description="k1, k2, p1, p2[, k3, ...] as in OpenCV"
    )

    @field_validator("distortion")
    @classmethod
    def _known_length(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if len(value) not in (0, 4, 5, 8, 12, 14):
            raise ValueError("distortion takes 0, 4, 5, 8, 12 or 14 coefficients")
        return value

    @model_validator(mode="after")
    def _whole_size(self) -> Self:
        if (self.width_px is None) != (self.height_px is None):
            missing, given = ("width_px", "height_px") if self.width_px is None else ("height_px", "width_px")
            raise FieldError(f"{given} is set, so {missing} must be, too", given)
        return self


class PictureConfig(Section):
    """When picture or marker need maintenance: part of NE 107 and alarms, and never of the decision."""

    brightness_min: float = Field(0.04, ge=0, lt=1, description="mean grey level, share of white; 0: off")
    clipped_max: float = Field(0.6, ge=0, lt=1, description="share of the pixels that are burnt out; 0: off")
    contrast_min: float = Field(
        0.05, ge=0, lt=1, description="from the 5th to the 95th percentile of the grey levels; 0: off"
    )
    sharpness_min: float = Field(
        0.24, ge=0, lt=1, description="of the strongest edges: 0.6 in focus, 0.3 blurred by 2 px, 0.2 by 4 px; 0: off"
    )
    veil_max: float = Field(0.65, ge=0, lt=1, description="share of dust or haze over the picture; 0: off")
    veil_proven: float | None = Field(
        None,
        gt=0,
        le=1,
        description="veil up to which this bay's pictures were shown to be reliable (gateway evaluate --stress); shown "
        "beside the present veil",
    )
    shift_max_px: float = Field(8.0, ge=0, le=1000, description="how far the fixed background may move; 0: off")
    blind_s: float = Field(
        5.0, ge=1, le=3600, description="dark, over-exposed or flat for this time: a fault, and cleared likewise"
    )
    lasting_s: float = Field(60.0, ge=1, le=3600, description="the same for blurred and shifted")
    dusty_s: float = Field(
        900.0, ge=1, le=86_400, description="the same for dusty; a cloud while loading is not counted"
    )
    rim_visible_min: float = Field(
        0.7, ge=0, lt=1, description="share of the marker's rim that is seen, median of the newest visits; 0: off"
    )
    rim_contrast_min: float = Field(
        0.5,
        ge=0,
        le=2,
        description="fall of redness across the rim, log units, likewise: 1 to 1.5 of good paint, none is found below "
        "0.15; 0: off",
    )
    rim_forecast_days: float = Field(
        7.0, ge=0, le=60, description="an alarm, too, where one of both falls below its limit within this time; 0: off"
    )


class RawConfig(Section):
    """Samples of more than 8 bits, and what makes colours of them."""

    format: RawFormatName | None = Field(
        None,
        description="/dev/video*: V4L2's name of the sample format to be asked for, as `v4l2-ctl --list-formats` gives "
        "it; default: the driver's own colours of 8 bits",
    )
    bayer: Mosaic | None = Field(
        None,
        description="colours of the first two pixels of the first two rows, where a colour camera calls its samples "
        "Y10, Y12 or Y16; without it these are grey, in which no red is found",
    )
    black_level: int = Field(0, ge=0, le=32767, description="sample of a covered lens, in the format's units")
    red_gain: float = Field(1.0, ge=0.1, le=10, description="of red against green, so that grey things are grey")
    blue_gain: float = Field(1.0, ge=0.1, le=10, description="of blue, likewise")

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.format is None:
            return self
        if self.bayer is not None and not self.format.startswith("Y"):
            raise FieldError(f"{self.format} already says it", "bayer")
        if self.black_level >= 1 << int(self.format.removesuffix("P")[-2:]) - 1:
            raise FieldError(f"at least half of white in {self.format}", "black_level")
        return self


class GigeConfig(Section):
    """Of a GigE Vision or USB Vision camera. A key that is absent leaves it as it is."""

    pixel_format: str | None = Field(
        None, min_length=1, max_length=40, description="GenICam's name, as in the camera's data sheet"
    )
    packet_size_bytes: int | None = Field(
        None, ge=220, le=16_000, description="gige://: default: the largest that the network carries, tried at opening"
    )
    offset_x_px: int = Field(
        0, ge=0, le=65_535, description="of the region that the camera sends, which is width_px x height_px large"
    )
    offset_y_px: int = Field(0, ge=0, le=65_535, description="likewise")


class CropConfig(Section):
    """The part of the picture that is used, px of the picture as it is delivered, before the rotation."""

    x_px: int = Field(ge=0, le=16384, description="left edge: columns that are cut off at the left")
    y_px: int = Field(ge=0, le=16384, description="upper edge: rows that are cut off at the top")
    width_px: int = Field(ge=16, le=16384, description="width of the part")
    height_px: int = Field(ge=16, le=16384, description="height of the part")


class BeaconConfig(Section):
    """Where an LED of the ranger's board is seen, whose code proves that the pictures are of the present."""

    u_px: float = Field(ge=0, le=16384, description="centre of the LED, px from the left, after crop and rotation")
    v_px: float = Field(ge=0, le=16384, description="px from the top")
    radius_px: float = Field(
        4.0, ge=1, le=200, description="as far as its light reaches; twice as far around is compared"
    )
    tolerance_ms: float = Field(
        250.0, ge=20, le=1000, description="the pictures may be so much older than the camera says; else stop is on"
    )


class CameraConfig(Section):
    url: str = Field(
        "0",
        min_length=1,
        description="camera index, /dev/video*, gige:// or usb3:// camera, video file, image folder, "
        "rtsp:// or http:// stream",
    )
    username: str | None = Field(None, min_length=1, max_length=1000, description="of a stream, instead of in the url")
    password_file: str | None = Field(None, min_length=1, description="file whose one line is the stream's password")
    width_px: int | None = Field(
        None,
        ge=16,
        le=16384,
        description="width of the pictures as delivered, before crop and rotation: requested from cameras, required of "
        "any source; default: the first frame's",
    )
    height_px: int | None = Field(None, ge=16, le=16384, description="height of the pictures, likewise")
    rotation_deg: int = Field(
        0,
        ge=0,
        le=270,
        multiple_of=90,
        description="the picture is turned clockwise: 0, 90, 180 or 270; after the crop",
    )
    fps: float | None = Field(None, ge=0.1, le=1000, description="requested from a camera; pace of an image folder")
    pace: Literal["realtime", "fast"] = Field(
        "realtime", description="files: at their own pace, or every frame as fast as vision can"
    )
    loop: bool = Field(
        False,
        description="files: begin again at the end; default: the end is a lost source until the gateway starts again",
    )
    deadline_s: float = Field(1.0, ge=0.05, le=60, description="no frame for this time: the source has stalled")
    frozen_s: float = Field(
        2.0,
        ge=0,
        le=60,
        description="cameras and streams: a picture that repeats itself for this time is a lost source; "
        "until then it only ages; "
        "0: equal pictures are not checked for",
    )
    repeats_age: bool = Field(
        True,
        description="cameras and streams: a picture equal to the one before keeps that one's time, so that it ages; "
        "false: for an encoder that repeats a still scene",
    )
    frame_time: Literal["auto", "arrival", "presentation"] = Field(
        "auto",
        description="what stamps a frame; auto: a camera's buffer time, the times that an RTSP stream or the parts of "
        "an HTTP stream carry, the arrival of any other; presentation: also other HTTP streams, where they carry true "
        "times",
    )
    clock: Literal["free", "synchronised"] = Field(
        "free",
        description="clock of an RTSP or HTTP camera that sends times; synchronised: it and the gateway's are set by "
        "NTP, so that a constant delay of its frames is seen, too",
    )
    unproven_age: Literal["refuse", "accept"] | None = Field(
        None,
        description="frames of which nothing proves how old they are; refuse: stop is on, as with stale ones; "
        "accept: they count from their arrival, with a warning (the default, but for what comes over a network, "
        "from GenICam or from GStreamer)",
    )
    exposure: Literal["camera", "marker"] = Field(
        "camera",
        description="who sets exposure time and gain; camera: the camera, as it is set up; "
        "marker: the gateway, so that the marker is neither clipped nor dark; needs a camera that can be set",
    )
    exposure_max_ms: float = Field(
        8.0, ge=0.1, le=1000, description='longest exposure time with `exposure = "marker"`: limits the motion blur'
    )
    gain_range_db: tuple[GainDb, GainDb] | None = Field(
        None,
        description="/dev/video*, gige://, usb3://: what the least and greatest gain amount to, dB, from the data "
        "sheet or measured; default: the gain is not controlled",
    )
    open_deadline_s: float = Field(10.0, ge=0.5, le=120, description="opening a source may take this long")
    max_megapixels: float = Field(25.0, ge=0.01, le=100, description="a larger frame is refused")
    confined: bool = Field(
        True,
        description="the vision process gives up every right that its source does not need; "
        "false: only for a driver or method that can't do with so little",
    )
    affinity: Cpus | None = Field(None, description="CPUs the capture thread of the vision process may use")
    reconnect: Reconnect = Field(default_factory=Reconnect)
    picture: PictureConfig = Field(default_factory=PictureConfig)
    raw: RawConfig = Field(default_factory=RawConfig)
    gige: GigeConfig = Field(default_factory=GigeConfig)
    crop: CropConfig | None = Field(None, description="only this part of the picture is used")
    controls: ControlsConfig = Field(default_factory=ControlsConfig)
    beacon: BeaconConfig | None = Field(
        None, description="an LED that proves the pictures; needs the beacon of the ranger (docs/beacon.md)"
    )

    @property
    def scheme(self) -> str:
        """Of `url`; where it has none, the whole of it."""
        return self.url.strip().partition("://")[0].lower()

    @property
    def streams(self) -> bool:
        """Its frames arrive over the network, by RTSP or HTTP."""
        return self.scheme in ("rtsp", "rtsps", "http", "https")

    @property
    def refuses_unproven_age(self) -> bool:
        by_default = self.streams or self.scheme in ("gige", "usb3", "gst")
        return self.unproven_age == "refuse" or (self.unproven_age is None and by_default)

    @property
    def picture_px(self) -> tuple[int | None, int | None]:
        """Width and height of the pictures that are used, after crop and rotation; None: not known before the first."""
        part = self.crop or self
        size = part.width_px, part.height_px
        return size[::-1] if self.rotation_deg % 180 else size

    @model_validator(mode="after")
    def _inside(self) -> Self:
        crop = self.crop
        for key, begin, length, whole in (
            ()
            if crop is None
            else (
                ("width_px", crop.x_px, crop.width_px, self.width_px),
                ("height_px", crop.y_px, crop.height_px, self.height_px),
            )
        ):
            if whole is not None and begin + length > whole:
                raise FieldError(f"it ends at {begin + length} px: camera.{key} is {whole}", "crop", key)
        return self

    @property
    def owned_controls(self) -> tuple[str, ...]:
        """The keys of `[camera.controls]` that `exposure = "marker"` sets itself; also of gain, if controlled."""
        if self.exposure != "marker":
            return ()
        own = ("auto_exposure", "exposure_dynamic_framerate", "exposure_time_absolute")
        return own if self.gain_range_db is None else (*own, "gain_automatic", "gain")

    @model_validator(mode="after")
    def _one_hand(self) -> Self:
        for key in self.owned_controls:
            if getattr(self.controls, key) is not None:
                raise FieldError('camera.exposure = "marker" sets it', "controls", key)
        return self

    @model_validator(mode="after")
    def _raw_has_effect(self) -> Self:
        if self.raw.format is None:
            without = ("bayer",) if self.gige.pixel_format else ("bayer", "black_level", "red_gain", "blue_gain")
            if given := [key for key in without if key in self.raw.model_fields_set]:
                raise FieldError("has no effect without format", "raw", given[0])
        return self

    @model_validator(mode="after")
    def _gains(self) -> Self:
        if self.gain_range_db is not None and self.gain_range_db[0] >= self.gain_range_db[1]:
            raise FieldError("the first must be less than the second", "gain_range_db")
        return self


class VisionConfig(Section):
    """Method, tracking and the parameters of both methods; those of the paper's are its Table I."""

    method: Annotated[str, NameIn(DETECTION_METHODS)] = Field(
        "robust", description="how the marker is found in a picture"
    )
    tracking: bool = Field(
        True,
        description="follow the marker from frame to frame: the same results, sooner; and report how each was obtained",
    )
    coast_s: float = Field(
        0.3,
        ge=0,
        le=10,
        description="a followed marker that is not seen is predicted for this time, then lost; stop is on",
    )
    gaussian_kernel_px: int = Field(5, ge=1, le=31, description="paper: side of the Gaussian kernel, odd; 1: off")
    gaussian_sigma_px: float = Field(0.0, ge=0, le=20, description="paper: 0: derived from the kernel, as OpenCV does")
    red_low_1: Hsv = Field((0, 43, 46), description="paper: threshold 1, lower corner (H 0-180, S, V 0-255)")
    red_high_1: Hsv = Field((10, 255, 255), description="paper: threshold 1, upper corner")
    red_low_2: Hsv = Field((156, 43, 46), description="paper: threshold 2, lower corner")
    red_high_2: Hsv = Field((180, 255, 255), description="paper: threshold 2, upper corner")
    morph_kernel_px: int = Field(3, ge=1, le=31, description="paper: side of the square structuring element, odd")
    morph_iterations: int = Field(2, ge=0, le=10, description="paper: of opening, then of closing; 0: off")
    min_area_px2: float = Field(100.0, ge=0, le=1e8, description="paper: S_min of equation 9")
    min_circularity: float = Field(0.0, ge=0, le=1, description="paper: 4 pi area / perimeter^2 at least; 0: off")
    min_fill: float = Field(0.0, ge=0, le=1, description="paper: area / enclosing circle's area at least; 0: off")
    min_radius_share: float = Field(
        0.012, ge=0.002, le=1, description="robust: smallest radius, as a share of the picture's diagonal"
    )
    max_radius_share: float = Field(0.5, ge=0.002, le=1, description="robust: largest radius, likewise")
    min_confidence: float = Field(
        0.5, ge=0, le=1, description="robust: what is less sure to be a red disc is no marker"
    )
    marker_colour: str | None = Field(
        None,
        pattern=forms.COLOUR,
        description="robust: the marker's colour as it is in pictures, a # and the hex digits of red, green and blue; "
        "without it the paper's red",
    )
    sum_frames: int = Field(
        1,
        ge=1,
        le=8,
        description="robust, with tracking: behind thick dust so many frames, of at most 0.12 s, are summed where one "
        "alone shows no marker; 1: off",
    )
    proposals: Proposals = Field(
        "classical",
        description="robust: what names the places that are measured; classical: edges and blobs of red; "
        "learned: a small net; both: the net's first",
    )
    intrinsics: Intrinsics | None = Field(None, description="for equation 11")
    workers: int = Field(1, ge=1, le=16, description="threads that OpenCV may use in the bay's vision process")
    affinity: Cpus | None = Field(None, description="CPUs the vision process may use")
    deadline_s: float = Field(
        2.0, ge=0.01, le=60, description="a frame may take this long, then the process is replaced"
    )

    @field_validator("gaussian_kernel_px", "morph_kernel_px")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            raise ValueError("must be odd")
        return value

    @field_validator("marker_colour")
    @classmethod
    def _with_a_hue(cls, value: str | None) -> str | None:
        if value is None:
            return None
        most, least = max(levels := bytes.fromhex(value[1:])), min(levels)
        if most < LEAST_LEVEL or most - least < LEAST_SATURATION * most:
            raise ValueError("is nearly black, grey or white: it has no hue to tell the marker by")
        return value.lower()

    @model_validator(mode="after")
    def _radii(self) -> Self:
        if self.min_radius_share > self.max_radius_share:
            raise FieldError(f"lies above max_radius_share, {self.max_radius_share:g}", "min_radius_share")
        return self

    @model_validator(mode="after")
    def _corners(self) -> Self:
        for n, low, high in ((1, self.red_low_1, self.red_high_1), (2, self.red_low_2, self.red_high_2)):
            for axis, lo, hi in zip("HSV", low, high, strict=True):
                if lo > hi:
                    raise FieldError(f"{axis} = {lo} lies above red_high_{n}'s {axis} = {hi}", f"red_low_{n}")
        return self


def keys_of(method: str) -> tuple[str, ...]:
    """The keys of `[vision]` that are this method's own."""
    fields = VisionConfig.model_fields
    return tuple(key for key in fields if (fields[key].description or "").startswith(f"{method}: "))
