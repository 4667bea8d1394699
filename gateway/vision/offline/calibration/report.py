"""What a calibration gives to people: the text for the configuration, and the HTML report. Pure."""

from collections.abc import Sequence

from gateway.vision.offline.calibration import plots
from gateway.vision.offline.calibration.boards import Board
from gateway.vision.offline.calibration.solve import Calibration
from gateway.vision.offline.reports.page import figure, page, plain, table, tile
from gateway.vision.offline.reports.tables import ReportTable, Row


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


def html(board: Board, found: Calibration, snippet: str, facts: Sequence[str], without_board: Sequence[str]) -> str:
    """`snippet`: the TOML; `without_board`: names of pictures in which the board was not found."""
    lens, sigma = found.lens, dict(found.sigma)
    steepest = max(view.tilt_deg for view in found.views)
    tiles = [
        tile(f"{found.rms_px:.3f} px", "reprojection error, rms", "good" if found.rms_px <= 0.5 else "bad"),
        tile(str(len(found.views)), f"views used; {len(without_board)} without the board"),
        tile(f"{lens.fx:.1f} px", f"fx, ± {sigma['fx']:.2g}"),
        tile(f"{lens.fy:.1f} px", f"fy, ± {sigma['fy']:.2g}"),
        tile(f"{100 * (found.coverage > 0).mean():.0f} %", "of the frame covered"),
        tile(f"{steepest:.0f}°", "steepest view"),
    ]
    body = [f"<h1>Camera calibration, {found.size_px[0]} × {found.size_px[1]} px</h1>"]
    body += [f'<p class="soft">{plain(fact)}</p>' for fact in (str(board), *facts)]
    body.append(f'<h2>In short</h2><div class="tiles">{"".join(tiles)}</div>')
    if found.warnings:
        items = "".join(f"<li>{plain(warning)}</li>" for warning in found.warnings)
        body.append(f'<p><strong class="warn">Check this first:</strong></p><ul class="notes">{items}</ul>')
    body.append(f"<h2>For the configuration</h2><pre>{plain(snippet)}</pre>")
    body.append("<h2>Coverage and residuals</h2>")
    body.append(figure(plots.frame_map(found), "Every point used, coloured by view; darker cells hold more points."))
    charts = (
        figure(plots.residual_cloud(found), "All residuals. A round cloud about 0 is noise; a streak is motion blur."),
        figure(plots.by_view(found), "Reprojection error of each view; dotted: of all."),
    )
    body.append(f'<div class="charts">{"".join(charts)}</div>')
    body += [table(_parameters(found)), table(views(found, without_board))]
    return page("Camera calibration", body, "Made by gateway calibrate. Pixel centres lie at integers.")


def _parameters(found: Calibration) -> ReportTable:
    lens = found.lens
    values = (lens.fx, lens.fy, lens.cx, lens.cy, *lens.distortion)
    rows: list[Row] = [
        ("", [name, f"{value:.6g}", f"{sigma:.2g}", f"{100 * sigma / abs(value):.2g} %" if value else "–"])
        for (name, sigma), value in zip(found.sigma, values, strict=True)
    ]
    return ReportTable("Parameters", ("parameter", "value", "standard deviation", "share"), rows)


def views(found: Calibration, without_board: Sequence[str]) -> ReportTable:
    rows: list[Row] = []
    for n, view in enumerate(found.views, start=1):
        figures = (f"{view.rms_px:.3f}", f"{view.largest_px:.3f}", f"{view.tilt_deg:.0f}", f"{view.distance_mm:.0f}")
        rows.append(("", [str(n), (view.name, "left"), *figures]))
    rows += [("bad", ["", (name, "left"), f"{rms:.3f}", "left out", "", ""]) for name, rms in found.rejected]
    rows += [("faint", ["", (name, "left"), "no board", "", "", ""]) for name in without_board]
    return ReportTable("Views", ("", "picture", "rms px", "largest px", "tilt deg", "distance mm"), rows)
