"""Vision runs anew on the kept pictures: what was recorded of each frame against what is found in it now. IO.

The kept pictures are some of the frames, so each is searched by itself and completely. The recorded search followed
the marker from frame to frame and had the ranger's limits of its radius. So small differences are not a fault: within
TOLERANCE both are the same.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from gateway.config import GatewayConfig, VisionConfig
from gateway.core.detection import Circle
from gateway.core.readings import Quality, VisionReading
from gateway.errors import ConfigError, ProtocolError
from gateway.records import picture_search, recording
from gateway.records import sentences as say
from gateway.records.recording import MissingItem
from gateway.records.segment import Head, RecordedPicture
from gateway.vision.detect import registry
from gateway.vision.detect.geometry import distance_px

TOLERANCE_SHARE = 0.02  # of R
TOLERANCE_PX = 0.5
TOLERANCE = "centre and radius within 0.5 px + 2 % of R"
SEEN = Quality.GOOD


@dataclass(frozen=True, slots=True)
class FrameAgain:
    """One picture. `was`: None: of this frame no result is recorded. `now`: None: no marker is found in it now."""

    path: Path
    head: Head
    picture: RecordedPicture
    was: VisionReading | None
    now: Circle | None

    @property
    def off_px(self) -> float | None:
        """The larger of the differences of centre and radius; None: not seen both times."""
        if self.was is None or self.was.circle is None or self.now is None:
            return None
        then = self.was.circle
        return max(distance_px(then, self.now), abs(then.radius_px - self.now.radius_px))

    @property
    def same(self) -> bool:
        """Both within the tolerance, or no marker both times. A prediction is not a marker."""
        if self.was is None:
            return False
        if self.was.circle is None or self.now is None:
            return self.was.circle is None and self.now is None
        off_px = self.off_px
        return off_px is not None and off_px <= TOLERANCE_PX + TOLERANCE_SHARE * self.was.circle.radius_px


def again(
    folder: Path,
    readings: dict[tuple[int, int], VisionReading],
    other: Callable[[Head], VisionConfig] | None = None,
    advance: Callable[[], None] = lambda: None,
) -> Iterator[FrameAgain | MissingItem]:
    """Every kept picture of the folder whose frame is in `readings` or has none recorded, by the recorded settings or
    by `other`. Raises OSError, and ConfigError where `other` does."""
    for path in recording.pictures_in(folder):
        head = recording.head_in(path)
        advance()
        if head is None:
            yield MissingItem(say.HEAD_DAMAGED(path.name))
            continue
        try:
            params = (other or _recorded)(head)
        except ConfigError as error:
            if other is not None:
                raise
            yield MissingItem(say.PART_OF(path.name, error))
            continue
        search = registry.once(params.model_copy(update={"tracking": False}))
        for picture in recording.pictures(path):
            if isinstance(picture, MissingItem):
                yield picture
                continue
            try:
                image = picture_search.decoded(picture)
            except ProtocolError as error:
                yield MissingItem(say.PART_OF(path.name, error))
                continue
            was = readings.get((picture.head.frame_id, picture.head.t_ns))
            yield FrameAgain(path, head, picture, was, search(image, picture.head.t_ns).circle)


def _recorded(head: Head) -> VisionConfig:
    return vision_of(recording.config_of(head), head.bay)


def vision_of(settings: GatewayConfig, name: str) -> VisionConfig:
    """`[vision]` of that bay. Raises ConfigError."""
    for bay in settings.bays:
        if bay.name == name:
            return bay.vision
    raise ConfigError(f"no bay {name!r} in the configuration; there: {', '.join(b.name for b in settings.bays)}")
