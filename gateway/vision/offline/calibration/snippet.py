"""Solved intrinsics in the words of the configuration. Pure."""

from gateway.vision.offline.calibration.boards import Board
from gateway.vision.offline.calibration.solve import Calibration


def toml(board: Board, found: Calibration, marker_radius_mm: float | None = None) -> str:
    """`[vision.intrinsics]`, and with the marker's radius `[fusion.cross_check]`, to paste into a configuration."""
    width, height = found.size_px
    lens = found.lens
    sigma = dict(found.sigma)
    numbers = ", ".join(f"{value:.8g}" for value in lens.distortion)
    lines = [
        f"# {board}: {len(found.views)} views; {width} x {height} px; rms {found.rms_px:.3f} px",
        "# Holds for this camera, lens, focus, zoom and picture size; another size is refused.",
        "[vision.intrinsics]",
        f"width_px = {width}",
        f"height_px = {height}",
        *(f"{name} = {getattr(lens, name):<12.7g} # +- {sigma[name]:.2g}" for name in ("fx", "fy", "cx", "cy")),
        f"distortion = [{numbers}]",
    ]
    if marker_radius_mm is not None:
        lines += [
            "",
            "# Z_vision = focal_px * marker_radius_mm / R, compared with the ranger's Z",
            "[fusion.cross_check]",
            f"focal_px = {focal_px(found):.7g}",
            f"marker_radius_mm = {marker_radius_mm:g}",
        ]
    return "\n".join(lines) + "\n"


def focal_px(found: Calibration) -> float:
    """The one focal length that Z_vision = f r / R takes: the mean of fx and fy."""
    return (found.lens.fx + found.lens.fy) / 2
