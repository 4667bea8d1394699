"""Exposure time and gain such that the marker's pixels stay inside the range. Pure: no camera, no clock.

- **The marker in sight:** the 90th percentile of its brightest channel is brought to `MARKER_LEVEL`. Steps are in the
  logarithm and 0.7 of what is missing, so that a camera whose brightness does not grow in proportion (a gamma curve, a
  gain of another scale) settles as well. Within `DEAD_BAND` nothing is changed. Where it is clipped the level is
  unknown: the more pixels are, the larger the step. Highlights on less than a tenth of the disc do not count. After a
  step that made it darker the light may still be rising: a marker that is a little too dark can wait. A brighter step
  needs 0.3 s that were too dark, and is measured by the brightest frame of 0.7 s, or by the crest of a slower beat
  (`ripple`), so that the exposure does not follow lamps that flicker on the mains.
- **The marker just lost:** it may be clipped or black, so the place where it was is kept from both; nothing else is
  changed, for it may be covered.
- **No marker:** the median of the bay is brought to what it had while the marker was well exposed, so that nothing
  changes when a truck leaves; it is darker rather than brighter, for a dark marker is found and a white one is not.
- **A change takes effect some frames later:** the first `SETTLE_FRAMES` frames taken after it are not acted on.
- **A camera that does not obey** is left alone: see `effect`.
"""

import math
from collections import deque

from gateway.core.readings import ExposureState
from gateway.vision.exposure.effect import TELLING, EffectJudge
from gateway.vision.exposure.light import CLIPPED, FrameLight, RegionLight
from gateway.vision.exposure.ripple import Ripple
from gateway.vision.exposure.settings import Exposure, ExposureLimits

SETTLE_FRAMES = 3
MARKER_LEVEL, BAY_LEVEL = 190.0, 60.0  # grey levels to be reached
BAY_LEVELS = (25.0, 80.0)  # what may be learned for the bay
DEAD_BAND, BAY_BAND = math.log(1.2), math.log(1.6)
SHARE = 0.7  # of what is missing, a step
MOST_UP, MOST_DOWN = 4.0, 8.0  # factors of one step
RISING_NS, RISING_LEVEL = 700_000_000, 40.0  # after a darker step none brighter for this time, unless it is below this
BRIGHTER_NS = 300_000_000  # for this time the frames must have been too dark
FLICKER_NS = 700_000_000  # a beat of lamp and frames that is faster needs not be known to be borne
LOST_DARK = 25.0  # grey level at the place of a marker that is not found any more


class _Recent:
    """Levels of one region in the settled frames since the last change, of FLICKER_NS at most; and its ripple."""

    def __init__(self) -> None:
        self._levels: deque[tuple[int, float]] = deque()
        self._ripple = Ripple()

    def changed(self) -> None:
        self._levels.clear()
        self._ripple.changed()

    @property
    def span_ns(self) -> int:
        return self._levels[-1][0] - self._levels[0][0] if self._levels else 0

    def brightest(self, level: float, t_ns: int) -> float:
        """Of these, the newest frame, which is of `t_ns`, and the next crest of a beat."""
        self._levels.append((t_ns, level))
        while not 0 <= t_ns - self._levels[0][0] < FLICKER_NS:
            self._levels.popleft()
        return max(self._ripple.crest(max(level, 1.0), t_ns), *(level for _, level in self._levels))


class ExposureController:
    """Of one opened camera. `captured` reports every frame in order, `step` the light in some of them."""

    def __init__(self, limits: ExposureLimits, now: Exposure) -> None:
        """`now`: what the camera is set to."""
        self._limits = limits
        self._now = self._asked = now
        self._set_ns = 0
        self._unsettled = 0  # frames taken after the last change that are still to be left out
        self._first_seq = 0  # the first frame that shows the last change
        self._darker_ns: int | None = None  # frame that led to the last darker step
        self._marker, self._bay = _Recent(), _Recent()
        self._bay_level = BAY_LEVEL
        self._effect = EffectJudge(limits)
        self.state = ExposureState.CONTROLLED

    @property
    def now(self) -> Exposure:
        """What the camera is set to."""
        return self._now

    def captured(self, seq: int, t_ns: int) -> None:
        """A frame taken at `t_ns` has arrived, looked at or not."""
        if self._unsettled and t_ns > self._set_ns:
            self._unsettled -= 1
            self._first_seq = seq + 1

    def step(self, light: FrameLight) -> Exposure | None:
        """What to set now; None: leave it. What was set is reported by `applied`."""
        if self._unsettled or light.seq < self._first_seq:
            return None
        ignored = self._effect.judged(light, self._now)
        if ignored is not None:
            wanted = ignored.setting
            self.state = ExposureState.IGNORED if ignored.certain else self.state
        else:
            wanted = self._wanted(light)
        if wanted in (self._now, self._asked):  # a camera that rounds is not asked for the same again
            return None
        self._asked = wanted
        return wanted

    def applied(self, exposure: Exposure, light: FrameLight, now_ns: int) -> None:
        """The camera has been set to this, because of this light. It may differ from what was to be set."""
        self._effect.changed(self._now, exposure, light)
        if exposure.amount < self._now.amount:
            self._darker_ns = light.t_ns
        for recent in (self._marker, self._bay):
            recent.changed()
        self._now, self._set_ns, self._unsettled = exposure, now_ns, SETTLE_FRAMES

    def refused(self) -> None:
        """What `step` returned last could not be set: it may be asked for again."""
        self._asked = self._now

    def _wanted(self, light: FrameLight) -> Exposure:
        if light.marker is not None and light.seen:
            self._learn(light.bay, light.marker)
            return self._towards(light.marker, MARKER_LEVEL, DEAD_BAND, light.t_ns, self._marker)
        if light.marker is None:
            return self._towards(light.bay, self._bay_level, BAY_BAND, light.t_ns, self._bay)
        if light.marker.level >= CLIPPED or light.marker.level < LOST_DARK:
            return self._towards(light.marker, MARKER_LEVEL, DEAD_BAND, light.t_ns, self._marker)
        return self._now

    def _towards(self, light: RegionLight, level: float, band: float, t_ns: int, recent: "_Recent") -> Exposure:
        clipped = light.level >= CLIPPED
        brightest = recent.brightest(light.level, t_ns)
        missing = math.log(level / max(light.level, 1.0))
        if missing > 0 and light.level >= RISING_LEVEL:
            missing = max(0.0, math.log(level / brightest))
        self.state = ExposureState.CONTROLLED
        if clipped:
            step = min(SHARE * missing, -math.log(2) * (1 + 2 * light.clipped))
        elif abs(missing) <= band:
            self._effect.reached()
            return self._now
        elif missing > 0 and light.level >= RISING_LEVEL and (self._rising(t_ns) or recent.span_ns < BRIGHTER_NS):
            return self._now
        else:
            step = SHARE * missing
        step = min(max(step, -math.log(MOST_DOWN)), math.log(MOST_UP))
        wanted = self._limits.setting(self._now.amount * math.exp(step))
        if clipped and wanted.amount >= self._now.amount:
            wanted = self._limits.below(self._now)
        if wanted == self._now == self._limits.setting(0.0 if step < 0 else math.inf):
            self.state = ExposureState.TOO_BRIGHT if step < 0 else ExposureState.TOO_DARK
        return wanted

    def _rising(self, t_ns: int) -> bool:
        """The light may still be rising."""
        return self._darker_ns is not None and 0 <= t_ns - self._darker_ns < RISING_NS

    def _learn(self, bay: RegionLight, marker: RegionLight) -> None:
        """The bay's level while the marker is well exposed."""
        if LOST_DARK <= marker.level < CLIPPED and TELLING[0] <= bay.level <= TELLING[1]:
            least, most = BAY_LEVELS
            self._bay_level = min(max(bay.level * MARKER_LEVEL / marker.level, least), most)
