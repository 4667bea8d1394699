"""What every frame of any source must pass before it is used: its size, its framing, and that it is new.

Thresholds, aim point and intrinsics are pixels of one picture size: at half of it R is half as large, and D never 1.
"""

from dataclasses import dataclass

import numpy as np

from gateway.errors import LinkError
from gateway.vision.source.contract import Frame
from gateway.vision.source.frame_rules import FrameRules
from gateway.vision.source.framing import SizePx
from gateway.vision.source.freshness import TILES, Changes, Freshness, FrozenFrameDetector


@dataclass(frozen=True, slots=True)
class PassedFrame:
    """`used`: the part of the frame that is used, turned. `changed_ns`: when each tile of it last changed."""

    used: Frame
    changed_ns: Changes


class FrameChecks:
    """One opened source. `in_force_px`: the size of the frames before it was opened; None: this is the first time."""

    def __init__(self, label: str, rules: FrameRules, in_force_px: SizePx | None, *, may_repeat: bool) -> None:
        self._label = label
        self._rules = rules
        self._in_force_px = in_force_px
        self._size_px: SizePx | None = None  # of this opening
        self._frozen = None if may_repeat or not rules.frozen_s else FrozenFrameDetector(rules.frozen_s)

    def passed(self, frame: Frame) -> PassedFrame | None:
        """What is used of a delivered frame; None: not to be shown yet. Raises LinkError."""
        height, width = frame.pixels.shape[:2]
        self._check_size((width, height))
        frame = self._rules.framing.used(frame)
        if self._frozen is not None:
            match self._frozen.judge(frame.pixels, frame.t_capture_ns):
                case Freshness.UNPROVEN:
                    return None
                case Freshness.FROZEN:
                    frozen_s = self._rules.frozen_s
                    raise LinkError(f"{self._label}: frozen: the picture has not changed for {frozen_s:g} s")
            if self._rules.repeats_age:
                return PassedFrame(frame, self._frozen.changed_ns)
        return PassedFrame(frame, np.full(TILES, frame.t_capture_ns, np.int64))

    def _check_size(self, size_px: SizePx) -> None:
        if size_px == self._size_px:
            return
        rules = self._rules
        if size_px != (rules.width_px or size_px[0], rules.height_px or size_px[1]):
            self._wrong(size_px, f"camera.width_px and height_px require {_px(rules.width_px, rules.height_px)}")
        try:
            used_px = rules.framing.size_px(size_px)
        except LinkError as error:
            raise LinkError(f"{self._label}: {error}") from None
        if rules.lens_px is not None and used_px != rules.lens_px:
            after = "" if used_px == size_px else f", {_px(*used_px)} after crop and rotation"
            self._wrong(size_px, f"vision.intrinsics hold for {_px(*rules.lens_px)}", after)
        if (before_px := self._size_px or self._in_force_px) not in (None, size_px):
            self._wrong(size_px, f"they were {_px(*before_px)}: set camera.width_px and height_px to the right size")
        if (megapixels := used_px[0] * used_px[1] / 1e6) > rules.max_megapixels:
            raise LinkError(
                f"frame of {used_px[0]} x {used_px[1]} = {megapixels:.1f} megapixels, "
                f"more than camera.max_megapixels = {rules.max_megapixels:g}"
            )
        self._size_px = size_px

    def _wrong(self, size_px: SizePx, why: str, after: str = "") -> None:
        raise LinkError(f"{self._label}: its frames are {_px(*size_px)}{after}; {why}")


def _px(width: int | None, height: int | None) -> str:
    return f"{width or 'any'} x {height or 'any'} px"
