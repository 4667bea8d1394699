"""The picture of a calibration: every point with its residual, over how well the frame is covered. Pure."""

from collections.abc import Sequence

import numpy as np

from gateway.vision.offline.calibration.solve import CELLS, Calibration
from gateway.vision.offline.reports.chart import COLOURS, Chart, ChartAxis

_WIDTH = 940
_ARROW_PX = 26.0  # on the page, of a large residual


def frame_map(found: Calibration) -> str:
    """SVG: cells shaded by the number of points in them, points coloured by view, residuals as lines, magnified."""
    width, height = found.size_px
    scale = _WIDTH / width
    magnified = magnification(found)
    across, down = CELLS
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" class="chart" viewBox="-2 -2 {_WIDTH + 4} {height * scale + 34:.0f}"'
        f' width="{_WIDTH}" role="img" aria-label="coverage and residuals" font-family="sans-serif" font-size="13">'
        '<rect x="-2" y="-2" width="100%" height="100%" fill="#fff"/>'
    ]
    most = max(1, int(found.coverage.max()))
    for row in range(down):
        for column in range(across):
            count = int(found.coverage[row, column])
            x, y = column * _WIDTH / across, row * height * scale / down
            look = f'fill="#0072b2" fill-opacity="{0.06 + 0.24 * count / most:.2f}"' if count else 'fill="#fbe9e7"'
            parts.append(
                f'<rect x="{x:.1f}" y="{y:.1f}" width="{_WIDTH / across:.1f}" height="{height * scale / down:.1f}"'
                f' {look} stroke="#fff"><title>{count} points</title></rect>'
            )
    for n, view in enumerate(found.views):
        colour = COLOURS[n % len(COLOURS)]
        lines, dots = [], []
        for point, residual in zip(view.points, view.residuals, strict=True):
            x, y = (point + 0.5) * scale
            dx, dy = residual * magnified * scale
            lines.append(f"M{x:.1f} {y:.1f}l{dx:.1f} {dy:.1f}")
            dots.append(f"M{x:.1f} {y:.1f}h.01")
        title = f"<title>view {n + 1}, rms {view.rms_px:.3f} px</title>"
        parts.append(
            f'<path d="{"".join(dots)}" stroke="{colour}" stroke-width="4" stroke-linecap="round">{title}</path>'
        )
        parts.append(f'<path d="{"".join(lines)}" stroke="{colour}" stroke-width="1.1" fill="none"/>')
    cx, cy = (found.lens.cx + 0.5) * scale, (found.lens.cy + 0.5) * scale
    parts.append(f'<path d="M{cx - 9:.1f} {cy:.1f}h18M{cx:.1f} {cy - 9:.1f}v18" stroke="#111" stroke-width="2"/>')
    parts.append(f'<rect width="{_WIDTH}" height="{height * scale:.1f}" fill="none" stroke="#333"/>')
    words = f"residuals {magnified:g} times enlarged; cross: principal point; pink: the board was never seen there"
    parts.append(f'<text x="0" y="{height * scale + 22:.0f}" fill="#333">{words}</text></svg>')
    return "".join(parts)


def magnification(found: Calibration) -> float:
    """A round factor that makes a large residual (95 % are smaller) a line that can be seen."""
    lengths = np.concatenate([np.hypot(*view.residuals.T) for view in found.views])
    large = max(float(np.percentile(lengths, 95)), 1e-6) * _WIDTH / found.size_px[0]
    wanted = _ARROW_PX / large
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(max(1.0, power * max(m for m in (1, 2, 5) if m * power <= wanted * (1 + 1e-9))))


def residual_cloud(found: Calibration) -> str:
    """SVG: all residuals; a round cloud about 0 is noise, a streak is blur or a moving board."""
    reach = max(0.05, 1.1 * float(np.percentile(np.abs(np.concatenate([v.residuals for v in found.views])), 99.5)))
    chart = Chart(
        ChartAxis("residual along u, px", -reach, reach), ChartAxis("along v, px", -reach, reach), width=440, height=400
    )
    chart.rule(x=0)
    chart.rule(y=0)
    for n, view in enumerate(found.views):
        chart.points([(float(u), float(v)) for u, v in view.residuals], n)
    return chart.svg()


def by_view(found: Calibration) -> str:
    """SVG: rms of each view."""
    values = [view.rms_px for view in found.views]
    chart = Chart(
        ChartAxis("view", 0.5, len(values) + 0.5),
        ChartAxis("rms, px", 0, max(values) * 1.15 + 1e-9),
        width=440,
        height=400,
    )
    for n, value in enumerate(values, start=1):
        chart.bars([n - 0.4, n + 0.4], [value], 0)
    chart.rule(y=found.rms_px)
    return chart.svg()


def coverage_text(found: Calibration) -> Sequence[str]:
    """The coverage map as lines of characters, for a terminal."""
    most = max(1, int(found.coverage.max()))
    shades = " ░▒▓█"
    return [
        "".join(2 * (shades[min(4, 1 + int(3.99 * count / most))] if count else "·") for count in row)
        for row in found.coverage
    ]
