"""Where the marker should be now: a constant-velocity filter over [u, v, R], the paper's future work. Pure.

Three Kalman filters side by side, one for each of u, v and R, each with position x (px) and velocity w (px/s):

    x' = x + w dt,  w' = w;  process noise q (dt^3/3, dt^2/2; dt^2/2, dt), that of a white acceleration of density q

Everything scales with R: a truck that brakes at 30 cm changes the picture ten times as fast as one at 3 m. What the
model doesn't describe, the vibration of truck and camera from frame to frame, is counted as noise of the measurement.

The filter predicts and nothing else. What is reported as measured is the measured circle, never a filtered one. Times
are monotonic nanoseconds. A frame that is not newer than the track can be predicted, but does not update it; the
uncertainty grows with the interval in either direction. No input gives NaN or a negative variance.
"""

import math
from dataclasses import dataclass

from gateway.core.detection import Circle
from gateway.durations import NS_PER_S

GATE = 16.27  # squared Mahalanobis distance: 99.9 % of a chi-square with three degrees of freedom
JITTER_PX = 0.5  # standard deviation of a measurement against the model: this, and
JITTER_SHARE = 0.02  # so much of R: 2 mm of vibration on a marker of 90 mm
AGILITY = 3.0  # the velocity wanders by so many R (or REACH, if more) a second, over one second
REACH_PX = 30.0  # a small, far marker still moves with the shake of the camera
FIRST_SPEED = 3.0  # of a track that has just begun: standard deviation of its unknown velocity, R (or REACH) a second
FARTHEST_S = 10.0  # nothing is predicted over more than that
LARGEST_PX = 1e6  # a circle beyond is not a measurement
CONFIRMED_HITS = 3  # measurements that fit each other, before a prediction may be shown


@dataclass(frozen=True, slots=True)
class Axis:
    """One of u, v, R: position and velocity with their covariance."""

    x: float
    w: float
    xx: float
    xw: float
    ww: float

    def ahead(self, dt_s: float, q: float) -> "Axis":
        """`dt_s` may be negative: the motion is run backwards, and the uncertainty grows as if it were positive."""
        far = abs(dt_s)
        return Axis(
            x=self.x + self.w * dt_s,
            w=self.w,
            xx=max(0.0, self.xx + 2 * far * self.xw + far**2 * self.ww) + q * far**3 / 3,
            xw=self.xw + far * self.ww + q * far**2 / 2,
            ww=self.ww + q * far,
        )

    def corrected(self, measured: float, noise: float) -> "Axis":
        """`noise`: variance of the measurement, above 0."""
        total = self.xx + noise
        gain_x, gain_w = self.xx / total, self.xw / total
        off = measured - self.x
        return Axis(
            x=self.x + gain_x * off,
            w=self.w + gain_w * off,
            xx=self.xx * noise / total,
            xw=self.xw * noise / total,
            ww=max(0.0, self.ww - gain_w * self.xw),
        )


@dataclass(frozen=True, slots=True)
class Prediction:
    """Where the marker should be, and how surely: standard deviations of the prediction itself, px."""

    circle: Circle
    sd_centre_px: float
    sd_radius_px: float

    def distance2(self, found: Circle) -> float:
        """Squared Mahalanobis distance of a measured circle, the noise of a measurement included."""
        noise = _variance(max(self.circle.radius_px, found.radius_px))
        centre = (found.u_px - self.circle.u_px) ** 2 + (found.v_px - self.circle.v_px) ** 2
        radius = (found.radius_px - self.circle.radius_px) ** 2
        return centre / (self.sd_centre_px**2 + noise) + radius / (self.sd_radius_px**2 + noise)

    def admits(self, found: Circle) -> bool:
        """Is it the marker that was followed? Not, if it moved as it can't."""
        return self.distance2(found) <= GATE

    @property
    def reach_px(self) -> float:
        """The centre lies within so much of the predicted one, if it is admitted."""
        return math.sqrt(GATE * (self.sd_centre_px**2 + _variance(self.circle.radius_px)))

    @property
    def largest_px(self) -> float:
        """R is at most this, if it is admitted."""
        spread = math.sqrt(GATE * (self.sd_radius_px**2 + _variance(self.circle.radius_px)))
        return self.circle.radius_px + spread

    @property
    def useful(self) -> bool:
        """False when the marker may be anywhere by now: more than its own radius (or REACH) away."""
        return self.sd_centre_px <= self.near_px

    @property
    def near_px(self) -> float:
        """What is near the predicted centre, whatever the uncertainty: its own radius (or REACH)."""
        return _scale(self.circle.radius_px)


@dataclass(frozen=True, slots=True)
class Track:
    """One marker, followed. Replaced with every measurement."""

    t_ns: int  # of the last measurement
    u: Axis
    v: Axis
    r: Axis
    hits: int  # measurements in it

    @classmethod
    def started(cls, found: Circle, t_ns: int) -> "Track | None":
        """None for a circle that can't be one."""
        if not usable(found):
            return None
        noise, speed = _variance(found.radius_px), (FIRST_SPEED * _scale(found.radius_px)) ** 2
        u, v, r = (Axis(x, 0.0, noise, 0.0, speed) for x in (found.u_px, found.v_px, found.radius_px))
        return cls(t_ns, u, v, r, hits=1)

    def at(self, t_ns: int) -> Prediction | None:
        """None where the last measurement is too old for a prediction."""
        ahead = self._ahead(t_ns)
        if ahead is None:
            return None
        circle = Circle(ahead.u.x, ahead.v.x, max(0.0, ahead.r.x))
        if not usable(circle):
            return None
        return Prediction(circle, math.sqrt(max(ahead.u.xx, ahead.v.xx)), math.sqrt(ahead.r.xx))

    def updated(self, found: Circle, t_ns: int, visible: float | None = None) -> "Track":
        """The track with one measurement more; unchanged by one that is not newer, or no circle.

        `visible`: share of the rim that was seen; less rim, more noise.
        """
        ahead = self._ahead(t_ns) if t_ns > self.t_ns and usable(found) else None
        if ahead is None:
            return self
        noise = _variance(found.radius_px) / max(0.1, min(1.0, 1.0 if visible is None else visible))
        return Track(
            t_ns,
            ahead.u.corrected(found.u_px, noise),
            ahead.v.corrected(found.v_px, noise),
            ahead.r.corrected(found.radius_px, noise),
            self.hits + 1,
        )

    @property
    def confirmed(self) -> bool:
        return self.hits >= CONFIRMED_HITS

    def _ahead(self, t_ns: int) -> "Track | None":
        dt_s = (t_ns - self.t_ns) / NS_PER_S
        if not abs(dt_s) <= FARTHEST_S:
            return None
        q = (AGILITY * _scale(self.r.x)) ** 2
        return Track(t_ns, self.u.ahead(dt_s, q), self.v.ahead(dt_s, q), self.r.ahead(dt_s, q), self.hits)


def usable(circle: Circle) -> bool:
    numbers = (circle.u_px, circle.v_px, circle.radius_px)
    return all(-LARGEST_PX <= number <= LARGEST_PX for number in numbers) and circle.radius_px > 0  # NaN fails, too


def _scale(radius_px: float) -> float:
    return max(REACH_PX, radius_px)


def _variance(radius_px: float) -> float:
    return JITTER_PX**2 + (JITTER_SHARE * radius_px) ** 2
