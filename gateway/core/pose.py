"""Where the marker's centre is against its taught place, in millimetres. Pure."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class MetricPose:
    """The marker's centre against its taught place, in the camera's axes: x to the picture's right, y downwards, z away
    from the camera (positive: still to go). `_sd_mm`: standard deviation of each."""

    x_mm: float
    y_mm: float
    z_mm: float
    x_sd_mm: float
    y_sd_mm: float
    z_sd_mm: float
