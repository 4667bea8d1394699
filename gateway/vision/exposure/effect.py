"""Does a camera obey its exposure settings? Judged by the bay's brightness, before and after each change. Pure.

Changes that show no effect for some seconds: the settings return to where that began. If that shows no effect either,
the camera counts as not obeying, and is left as it is; one change in ten seconds tries whether it obeys again. Light
that rises as fast as the exposure is lowered looks the same, for as long as it does: the return shows the difference.
"""

import math
from dataclasses import dataclass

from gateway.durations import NS_PER_S
from gateway.vision.exposure.light import FrameLight
from gateway.vision.exposure.settings import Exposure, ExposureLimits

TELLING = (12.0, 240.0)  # grey levels of the bay at which an effect can be judged
OBEYED, IGNORED = 0.3, 0.1  # share of the effect that was to be expected
LEAST_ASKED, LEAST_NS = math.log(4), 5 * NS_PER_S  # of a run of changes without effect
RETRY_NS = 10 * NS_PER_S
RETRY_FACTOR = 2.0
MIDDLE_LEVEL = 60.0  # grey level of the bay above which a try makes it darker


@dataclass(frozen=True, slots=True)
class Ignored:
    """What to set on a camera that seems not to obey. `certain`: the return has had no effect either."""

    setting: Exposure
    certain: bool


@dataclass(slots=True)
class _Run:
    """Changes without effect."""

    before: Exposure
    since_ns: int
    asked: float = 0.0  # sum of the logarithms, absolute
    seen: float = 0.0  # of the bay's level, counted in the direction that was asked for

    def without_effect(self, t_ns: int) -> bool:
        return self.asked >= LEAST_ASKED and self.seen <= IGNORED * self.asked and t_ns - self.since_ns >= LEAST_NS


class EffectJudge:
    """Of one opened camera."""

    def __init__(self, limits: ExposureLimits) -> None:
        self._limits = limits
        self._last: tuple[float, float] | None = None  # the bay's level before the last change, and its logarithm
        self._run: _Run | None = None
        self._home: Exposure | None = None  # where changes stopped to have an effect; None: the camera obeys
        self._away = False  # the settings are to return there
        self._certain = False
        self._retry_ns = 0

    def changed(self, before: Exposure, after: Exposure, light: FrameLight) -> None:
        """The camera was set from one to the other, because of this light."""
        asked = math.log(after.amount / before.amount)
        self._last = (light.bay.level, asked) if _telling(light) and asked else None
        if self._last is None:
            self._run = None
        elif self._run is None:
            self._run = _Run(before, light.t_ns)

    def reached(self) -> None:
        """The light is where it is to be."""
        self._run = None

    def judged(self, light: FrameLight, now: Exposure) -> Ignored | None:
        """After the first frame that shows the last change, and all later ones; None: the camera obeys."""
        self._take_effect(light)
        run = self._run
        if self._home is None and run is not None and run.without_effect(light.t_ns):
            self._home, self._away, self._certain = run.before, True, False
        if self._home is None:
            return None
        if not _telling(light):  # nothing can be judged: control it as if it obeyed
            self._home = self._run = None
            return None
        if self._away and now != self._home:
            self._away = False
            self._retry_ns = light.t_ns + RETRY_NS
            return Ignored(self._home, self._certain)
        self._away, self._certain = False, True
        if light.t_ns < self._retry_ns:
            return Ignored(now, certain=True)
        self._away, self._retry_ns = True, light.t_ns + RETRY_NS
        return Ignored(self._tried(now, light), certain=True)

    def _take_effect(self, light: FrameLight) -> None:
        if self._last is None:
            return
        (before, asked), self._last = self._last, None
        seen = math.log(max(light.bay.level, 1.0) / before) * math.copysign(1, asked)
        if seen >= OBEYED * abs(asked):
            self._home = self._run = None
        elif self._run is not None:
            self._run.asked += abs(asked)
            self._run.seen += seen

    def _tried(self, now: Exposure, light: FrameLight) -> Exposure:
        factor = 1 / RETRY_FACTOR if light.bay.level > MIDDLE_LEVEL else RETRY_FACTOR
        tried = self._limits.setting(now.amount * factor)
        return tried if tried != now else self._limits.setting(now.amount / factor)


def _telling(light: FrameLight) -> bool:
    return TELLING[0] <= light.bay.level <= TELLING[1]
