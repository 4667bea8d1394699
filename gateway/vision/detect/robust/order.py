"""Order statistics of small arrays. Pure."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def quantile(values: NDArray[Any], share: float) -> float:
    """Without interpolation; 0 of nothing."""
    at = int(share * len(values))
    if not len(values):
        return 0.0
    return float(np.partition(values, at)[at])
