"""The rise and fall of light that returns, as of lamps whose flicker beats slowly with the frames. Pure.

Lamps on the mains flicker at 100 or 120 Hz. A camera at nearly a divisor of that (24.99 frames a second, 29.97) shows
a beat of seconds up to minutes, which is followed by no exposure: what is right at its crest is wrong at its trough.
A fall counts as part of the beat while the light has turned at such a depth before, and its crest is not overdue. A
lamp that is switched off is darker than the trough, or does not return.
"""

import math

from gateway.durations import NS_PER_S

TURN = math.log(1.1)  # a smaller change is no turn
DEEPEST = math.log(2.0)  # from crest to trough; 25 % of flicker is 1.67
DEEPER = math.log(1.25)  # than the trough before, of which the part that a change of the exposure covers is not seen
LONGEST_NS = 60 * NS_PER_S  # from one turn to the time at which the next but one is overdue
GAP_NS = NS_PER_S  # after this time without a frame nothing is known of the light between


class Ripple:
    """Of one region's settled levels. The light is a sum of logarithms from frame to frame, each at one exposure, so
    it goes on over changes of the exposure whatever the camera makes of them."""

    def __init__(self) -> None:
        self._level = self._light = 0.0  # the level of the frame before, 0: not to be compared; logarithm of the light
        self._extreme, self._extreme_ns, self._sign = 0.0, 0, 1  # of the present rise (1) or fall (-1)
        self._t_ns = 0
        self._turns: dict[int, tuple[float, int]] = {}  # the last crest (1) and the last trough (-1): light and time

    def changed(self) -> None:
        """The exposure changes: the next level is not to be compared with the last."""
        self._level = 0.0

    def crest(self, level: float, t_ns: int) -> float:
        """The level that the beat's next crest will have at this exposure; `level` itself where the light does not
        ripple, or has left the ripple. `level`: of the newest settled frame, 1 to 255."""
        if not 0 <= t_ns - self._t_ns <= GAP_NS:
            self._turns, self._level, self._extreme, self._extreme_ns = {}, 0.0, self._light, t_ns
        if self._level:
            self._light += math.log(level / self._level)
        self._level, self._t_ns = level, t_ns
        beyond = self._sign * (self._light - self._extreme)
        if beyond >= 0:
            self._extreme, self._extreme_ns = self._light, t_ns
        elif -beyond > TURN:
            self._turns[self._sign] = (self._extreme, self._extreme_ns)
            self._sign, self._extreme, self._extreme_ns = -self._sign, self._light, t_ns
        return level * math.exp(max(0.0, self._awaited(t_ns) - self._light))

    def _awaited(self, t_ns: int) -> float:
        """The light of the last crest, if it is to return; else that of now."""
        if len(self._turns) < 2:
            return self._light
        (crest, crest_ns), (trough, trough_ns) = self._turns[1], self._turns[-1]
        overdue_ns = min(2 * abs(crest_ns - trough_ns), LONGEST_NS)
        here = self._light >= trough - DEEPER and crest - trough <= DEEPEST
        return crest if here and t_ns - max(crest_ns, trough_ns) <= overdue_ns else self._light
