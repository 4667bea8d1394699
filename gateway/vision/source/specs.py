"""Which source `camera.url` names: a camera, a URL of a registered scheme, or a path.

The main process chooses, the vision process opens: OpenCV is loaded there and not here.
"""

import re
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, cast
from urllib.parse import quote, urlsplit

from gateway.clock import Clock
from gateway.config import ControlsConfig, GigeConfig
from gateway.errors import ConfigError, SettingError
from gateway.passwords import ESCAPED, one_line
from gateway.registry import Registry
from gateway.vision.exposure.settings import ExposureRules
from gateway.vision.source.contract import Needs, Source, SourceSpec
from gateway.vision.source.raw_format import RawFormat, raw_format
from gateway.vision.source.v4l2_controls import ControlSetting, settings_of

if TYPE_CHECKING:
    from gateway.config import CameraConfig

MACHINE_VISION = ("gige", "usb3")
LATE_S = 1.0  # unless configured
CAMERA_TYPES = Registry(
    "camera type",
    "gateway.cameras",
    dict.fromkeys(("rtsp", "rtsps", "http", "https"), "gateway.vision.source.specs:stream_spec")
    | dict.fromkeys(MACHINE_VISION, "gateway.vision.source.gige:gige_spec")
    | {"gst": "gateway.vision.source.gst:gst_spec"},
)
"""By the scheme of `camera.url`: a function from `CameraConfig` to a `SourceSpec`. Raises ConfigError."""
LOGIN_KEYS = "camera.username and camera.password_file"
FOLDER_FPS = 10.0  # pace of an image folder unless configured


@dataclass(frozen=True, slots=True)
class CameraSpec:
    """A V4L2 camera by index or device path; sizes and rate are requested, the driver may give others (`checks`)."""

    needs: ClassVar[Needs] = Needs.DEVICE
    device: int | str
    width_px: int | None = None
    height_px: int | None = None
    fps: float | None = None
    by_arrival: bool = False  # frames are stamped when they arrive; else with the driver's buffer time
    late_s: float = LATE_S
    raw: RawFormat | None = None  # None: the driver's own colours, 8 bits
    controls: tuple[ControlSetting, ...] = ()

    @property
    def label(self) -> str:
        return f"camera {self.device}"

    def open(self, clock: Clock) -> Source:
        from gateway.vision.source.capture import open_camera  # noqa: PLC0415 - OpenCV stays out of the main process

        return open_camera(self, clock)


@dataclass(frozen=True, slots=True)
class StreamSpec:
    """An RTSP or HTTP stream. The URL may hold a password: it is in no label, no repr and no command line."""

    needs: ClassVar[Needs] = Needs.CONNECTIONS
    url: str = field(repr=False)
    open_timeout_s: float
    read_timeout_s: float
    by_arrival: bool = False  # else by presentation time
    late_s: float = LATE_S
    stamped: bool = True  # the times that FFmpeg reads are the stream's own; parts of an HTTP stream have theirs
    synchronised: bool = False  # its clock is set by NTP

    @property
    def label(self) -> str:
        parts = urlsplit(self.url)
        return f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}{parts.path}"

    def open(self, clock: Clock) -> Source:
        from gateway.vision.source.streams import open_stream  # noqa: PLC0415 - as above

        return open_stream(self, clock)


@dataclass(frozen=True, slots=True)
class FileSpec:
    """A video, a picture or a folder of pictures; which of them is determined when it is opened, for it may appear and
    disappear."""

    needs: ClassVar[Needs] = Needs.FILES
    path: str
    fps: float = FOLDER_FPS
    fast: bool = False
    loop: bool = False

    @property
    def label(self) -> str:
        return self.path.encode(errors="backslashreplace").decode()  # a name need not be UTF-8, a message must

    def open(self, clock: Clock) -> Source:
        from gateway.vision.source.files import open_file  # noqa: PLC0415 - as above

        return open_file(self, clock)


def _with_login(config: "CameraConfig") -> str:
    """The URL of a stream with user and password in it, as FFmpeg takes them. Raises ConfigError."""
    url = config.url.strip()
    scheme = url.partition("://")[0]
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        raise ConfigError(f"camera.url: not a usable {scheme}:// address; {ESCAPED}, or use {LOGIN_KEYS}") from None
    behind = parts.path + parts.query + parts.fragment
    misread = "@" in behind and "@" not in parts.netloc and (port is not None or parts.fragment)
    if misread and config.username is None:
        raise ConfigError(f"camera.url: has @ behind the host; {ESCAPED} and @ elsewhere as %40, or use {LOGIN_KEYS}")
    if not host:
        raise ConfigError(f"camera.url: {scheme}:// needs a host")
    secret = None if config.password_file is None else one_line("camera.password_file", config.password_file)
    if config.username is None and secret is not None:
        raise SettingError("camera.username", "is missing; a password needs a user name")
    if config.username is None:
        return url
    if "@" in parts.netloc:
        raise SettingError("camera.username", "camera.url names a user, too; keep one of them")
    login = quote(config.username, safe="") + ("" if secret is None else f":{quote(secret, safe='')}")
    return url.replace("://", f"://{login}@", 1)


def check_exposure(config: "CameraConfig") -> None:
    """Raises ConfigError where the exposure is to be controlled and the source is none that could be."""
    stream = config.streams or config.scheme == "gst"
    if config.exposure == "marker" and (stream or names_file(config)):
        what = f"a stream ({config.scheme}://)" if stream else "a file"
        raise ConfigError(f'camera.exposure = "marker": {what} has no exposure time that the gateway could set')


def names_file(config: "CameraConfig") -> bool:
    """A film, a picture or a folder of them, and no camera."""
    url = config.url.strip()
    return "://" not in url and not re.fullmatch("[0-9]{1,9}", url) and not url.startswith("/dev/")


def exposure_rules(config: "CameraConfig") -> ExposureRules | None:
    """None: the exposure is left to the camera."""
    if config.exposure == "camera":
        return None
    return ExposureRules(1000 * config.exposure_max_ms, config.gain_range_db)


def with_controls(spec: Any, controls: tuple[ControlSetting, ...]) -> Any:
    """The same source, set so; one that has no controls as it is."""
    return replace(spec, controls=controls) if "controls" in {one.name for one in fields(spec)} else spec


def source_spec(config: "CameraConfig") -> SourceSpec:
    """The source of `camera.url`: camera index, /dev/..., stream URL, else a path.

    Raises ConfigError for a URL that can never work: an unknown scheme, a URL without a host, a pace slower than the
    deadline. Nothing is opened: a missing file or device is a LinkError later, for it may return.
    """
    url = config.url.strip()
    if config.fps is not None and config.pace == "realtime" and 1 / config.fps >= config.deadline_s:
        raise ConfigError(
            f"camera.fps = {config.fps:g} is one frame in {1 / config.fps:g} s, "
            f"but camera.deadline_s = {config.deadline_s:g} takes that for a stall"
        )
    if "\0" in url:
        raise ConfigError("camera.url: a NUL is part of no address and no path")
    if "://" not in url and (config.username or config.password_file):
        raise SettingError("camera.username", "only a stream (rtsp://, http://) has users")
    _check_file_keys(config)
    if config.gige != GigeConfig() and config.scheme not in MACHINE_VISION:
        raise ConfigError("camera.gige: only gige:// and usb3:// take it")
    by_arrival = config.frame_time == "arrival"
    if config.clock == "synchronised" and (by_arrival or not config.streams):
        raise ConfigError(
            "camera.clock: only the times of an rtsp:// or http:// stream show it, with another frame_time"
        )
    number = re.fullmatch("[0-9]{1,9}", url)  # a longer one is a path
    if number or url.startswith("/dev/"):
        device = int(url) if number else url
        return CameraSpec(
            device,
            config.width_px,
            config.height_px,
            config.fps,
            by_arrival=by_arrival,
            late_s=config.deadline_s,
            raw=raw_format(config),
            controls=settings_of(config.controls),
        )
    if config.raw.format is not None:
        raise ConfigError("camera.raw.format: only a camera of this machine (/dev/video*) can be asked for it")
    scheme, separator, _ = url.partition("://")
    if config.controls != ControlsConfig() and scheme.lower() not in MACHINE_VISION:
        raise ConfigError("camera.controls: only a camera of this machine (/dev/video*), gige:// and usb3:// has them")
    if separator:
        if scheme.lower() not in CAMERA_TYPES:
            known = ", ".join(CAMERA_TYPES.names())
            raise ConfigError(f"camera.url: scheme {scheme}:// is unknown; known: {known}, or a path")
        return cast("SourceSpec", CAMERA_TYPES.load(scheme.lower())(config))
    try:
        path = Path(url).expanduser()
    except RuntimeError as error:
        raise ConfigError(f"camera.url = {url}: there is no such user") from error
    return FileSpec(str(path), fps=config.fps or FOLDER_FPS, fast=config.pace == "fast", loop=config.loop)


def _check_file_keys(config: "CameraConfig") -> None:
    """Raises SettingError where a camera or a stream is told how to play a file."""
    own = config.streams or config.scheme in (*MACHINE_VISION, "gst")
    if names_file(config) or ("://" in config.url and not own):
        return  # a type of another distribution may read files, too
    for key, set_, value in (("loop", config.loop, "true"), ("pace", config.pace == "fast", '"fast"')):
        if set_:
            raise SettingError(f"camera.{key}", f"is {value}; only a film, a picture or a folder of them takes that")


def stream_spec(config: "CameraConfig") -> StreamSpec:
    """Of a stream's URL, which stays out of the messages: it may hold a password. Raises ConfigError."""
    url = _with_login(config)
    scheme = url.partition("://")[0]
    # FFmpeg gives up opening just before the deadline, because its reason is the better message. It must not give up
    # reading before the deadline: it then returns the frame it was holding back, which is old but looks new.
    return StreamSpec(
        url,
        open_timeout_s=0.9 * config.open_deadline_s,
        read_timeout_s=2 * config.deadline_s,
        by_arrival=config.frame_time == "arrival",
        late_s=config.deadline_s,
        stamped=config.frame_time == "presentation" or scheme.lower().startswith("rtsp"),
        synchronised=config.clock == "synchronised",
    )
