"""A camera type from outside the package: a noisy red disc, `pattern://FRAMES`, which repeats its picture after so many
frames as a dead encoder does. See tests/e2e/test_outside_camera.py and docs/extending.md."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gateway.clock import Clock
from gateway.config import CameraConfig
from gateway.core.readings import AgeProof
from gateway.errors import ConfigError
from gateway.vision.source.contract import Frame, Source


@dataclass(frozen=True, slots=True)
class PatternSpec:
    frames: int
    width_px: int
    height_px: int

    @property
    def label(self) -> str:
        return "pattern"

    def open(self, clock: Clock) -> Source:
        return Pattern(self, clock)


class Pattern(Source):
    def __init__(self, spec: PatternSpec, clock: Clock) -> None:
        self._spec = spec
        self._clock = clock
        self._given = 0

    def read(self) -> Frame:
        self._clock.block(0.02)
        self._given = min(self._given + 1, self._spec.frames)
        noise = np.random.default_rng(self._given)
        v, u = np.mgrid[: self._spec.height_px, : self._spec.width_px]
        disc = (u - 80) ** 2 + (v - 60) ** 2 < 30**2
        picture = np.where(disc[..., None], (30, 30, 200), (120, 120, 120)) + noise.normal(0, 2, (*disc.shape, 3))
        return Frame(np.clip(picture, 0, 255).astype(np.uint8), self._clock.now_ns(), age_proof=AgeProof.OWN_CLOCK)

    def close(self) -> None:
        pass


def spec(config: CameraConfig) -> PatternSpec:
    frames = config.url.partition("://")[2]
    if not frames.isdigit():
        raise ConfigError("camera.url: pattern:// needs a number of frames")
    return PatternSpec(int(frames), config.width_px or 160, config.height_px or 120)


def install(folder: Path) -> None:
    """What installing its distribution would leave in `folder`, which must come into `sys.path`."""
    info = folder / "pattern_camera-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: pattern-camera\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[gateway.cameras]\npattern = {__name__}:spec\n")
