"""`gst://<file>`: a camera through the system's GStreamer (MIPI CSI). The file's one line is the pipeline.

A pipeline can write files, run on the network and load plugins: whoever sets it runs a program. The pages can set any
key, so the pipeline stands in a file that they can't have written: one without a write permission.
"""

import shlex
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

from gateway.clock import Clock
from gateway.errors import ConfigError, SettingError
from gateway.passwords import one_line
from gateway.vision.source.contract import Needs, Source

if TYPE_CHECKING:
    from gateway.config import CameraConfig


@dataclass(frozen=True, slots=True)
class GstSpec:
    """`pipeline`: what stands behind gst-launch-1.0, without a sink. It may hold a password."""

    needs: ClassVar[Needs] = Needs.DEVICE
    file: str
    pipeline: tuple[str, ...] = field(repr=False)
    by_arrival: bool = False  # else by the buffers' time stamps
    late_s: float = 1.0

    @property
    def label(self) -> str:
        return f"gst://{self.file}"

    def open(self, clock: Clock) -> Source:
        from gateway.vision.source.gst_source import open_gst  # noqa: PLC0415 - OpenCV stays out of the main process

        return open_gst(self, clock)


def gst_spec(config: "CameraConfig") -> GstSpec:
    """Raises ConfigError."""
    file = config.url.strip().partition("://")[2]
    if not file.startswith("/"):
        raise ConfigError("camera.url: gst:// needs the path of a file that holds the pipeline, gst:///etc/...")
    if config.username or config.password_file:
        raise SettingError("camera.username", "only a stream (rtsp://, http://) has users")
    line = one_line("camera.url", file, read_only=True)
    try:
        pipeline = tuple(shlex.split(line))
    except ValueError as error:
        raise SettingError("camera.url", f"no pipeline: {error}", file) from error
    return GstSpec(file, pipeline, by_arrival=config.frame_time == "arrival", late_s=config.deadline_s)
