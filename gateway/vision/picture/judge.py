"""When is a picture dark, over-exposed, flat, blurred, dusty or shifted? By limits, for most of some time. Pure.

A truck that passes, a cloud of dust while loading, a lamp that is switched off and on: no reason to service a camera.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from gateway.config import PictureConfig
from gateway.core.readings import PictureFault, PictureHealth
from gateway.durations import NS_PER_S

CLEARS = 0.1  # beyond its limit by this share of it, on the good side, a fault ends
SET, CLEAR = 0.7, 0.3  # of the time, with an exponential memory
LONGEST_STEP_S = 2.0  # a gap in the pictures is not a time in which anything was seen

Beyond = Callable[[PictureHealth, PictureConfig], float | None]
"""The value over its limit; 1: at the limit, more is worse. None: unknown, or switched off."""


@dataclass(frozen=True, slots=True)
class _Rule:
    beyond: Beyond
    lasting_s: Callable[[PictureConfig], float]


def _above(value: float | None, limit: float) -> float | None:
    return None if value is None or not limit else value / limit


def _below(value: float | None, limit: float) -> float | None:
    return None if value is None or not limit else limit / max(value, 1e-6)


def _exposed(health: PictureHealth, limits: PictureConfig) -> bool:
    """In a picture that is dark or burnt out nothing else can be judged."""
    burnt = bool(limits.clipped_max) and health.clipped > limits.clipped_max
    return health.brightness >= limits.brightness_min and not burnt


def _seeing(health: PictureHealth, limits: PictureConfig) -> bool:
    """Nor can it if the camera is covered."""
    return _exposed(health, limits) and health.contrast >= limits.contrast_min


RULES: dict[PictureFault, _Rule] = {
    PictureFault.DARK: _Rule(lambda h, c: _below(h.brightness, c.brightness_min), lambda c: c.blind_s),
    PictureFault.BRIGHT: _Rule(lambda h, c: _above(h.clipped, c.clipped_max), lambda c: c.blind_s),
    PictureFault.FLAT: _Rule(
        lambda h, c: _below(h.contrast, c.contrast_min) if _exposed(h, c) else None, lambda c: c.blind_s
    ),
    PictureFault.BLURRED: _Rule(
        lambda h, c: _below(h.sharpness, c.sharpness_min) if _seeing(h, c) else None, lambda c: c.lasting_s
    ),
    PictureFault.DUSTY: _Rule(lambda h, c: _above(h.veil, c.veil_max) if _seeing(h, c) else None, lambda c: c.dusty_s),
    PictureFault.SHIFTED: _Rule(lambda h, c: _above(h.shift_px, c.shift_max_px), lambda c: c.lasting_s),
}


class PictureJudge:
    """Of one camera; measurements are in order of their capture times."""

    def __init__(self, limits: PictureConfig) -> None:
        self._limits = limits
        self._shares = dict.fromkeys(PictureFault, 0.0)  # of the last while that was beyond the limit
        self._seen_ns = dict.fromkeys(PictureFault, 0)  # when it could be judged last
        self._status = 0

    def judged(self, measured: PictureHealth, t_ns: int) -> PictureHealth:
        """The same with its status, as of capture time `t_ns`, and with the configured `veil_proven`."""
        for fault, rule in RULES.items():
            beyond = rule.beyond(measured, self._limits)
            if beyond is None:
                continue
            step_s = min(max(0, t_ns - self._seen_ns[fault]) / NS_PER_S, LONGEST_STEP_S)
            self._seen_ns[fault] = t_ns
            holds = bool(self._status >> fault & 1)
            bad = beyond > (1 - CLEARS if holds else 1)
            # With this memory, what holds all the time is set after `lasting_s`, and cleared likewise.
            kept = math.exp(-step_s * -math.log(1 - SET) / rule.lasting_s(self._limits))
            share = self._shares[fault] = kept * self._shares[fault] + (1 - kept) * bad
            if share >= SET if not holds else share <= CLEAR:
                self._status ^= 1 << fault
        return replace(measured, status=self._status, veil_proven=self._limits.veil_proven)
