"""The configuration's requirements of every frame, applied by `checks`. Without NumPy: the main process sends them."""

import math
from dataclasses import dataclass, field

from gateway.vision.source.framing import Framing, SizePx


@dataclass(frozen=True, slots=True)
class FrameRules:
    """The configuration's requirements of every frame; None: any size, as long as it stays the same. Sizes are those
    of the delivered picture, but for `lens_px` and `max_megapixels`, which are of the part that is used."""

    width_px: int | None = None
    height_px: int | None = None
    lens_px: SizePx | None = None  # the picture size that the intrinsics hold for
    frozen_s: float = 2.0  # 0: equal pictures are new ones
    repeats_age: bool = True
    max_megapixels: float = math.inf
    framing: Framing = field(default_factory=Framing)
