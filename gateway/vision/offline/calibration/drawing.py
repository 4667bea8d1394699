"""A calibration board to print. Pure."""

from gateway.vision.offline.calibration.boards import Board, CalibrationBoardKind

RADIUS = {CalibrationBoardKind.CIRCLES: 0.3, CalibrationBoardKind.ASYMMETRIC: 0.5}  # of a circle, in pitches
SCALE_MM = 100.0  # of the line by which a print is checked
_TEXT_MM = 4.0


def svg(board: Board) -> str:
    """SVG in true size, with a light rim of one pitch and more: to be printed at 100 %."""
    pitch, points = board.pitch_mm, board.points_mm[:, :2]
    reach = (
        pitch if board.kind is CalibrationBoardKind.CHECKERBOARD else RADIUS[board.kind] * pitch
    )  # dark beyond the outer points
    left, top = (float(value) - reach - pitch for value in points.min(axis=0))
    width, height = (float(value) + 2 * (reach + pitch) for value in points.max(axis=0) - points.min(axis=0))
    foot = 3 * _TEXT_MM
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height + foot:g}mm"'
        f' viewBox="{left:g} {top:g} {width:g} {height + foot:g}">',
        f'<rect x="{left:g}" y="{top:g}" width="{width:g}" height="{height + foot:g}" fill="#fff"/>',
    ]
    if board.kind is CalibrationBoardKind.CHECKERBOARD:
        for row in range(-1, board.rows):
            for column in range(-1, board.columns):
                if (row + column) % 2 == 0:
                    place = f'x="{column * pitch:g}" y="{row * pitch:g}"'
                    parts.append(f'<rect {place} width="{pitch:g}" height="{pitch:g}" fill="#000"/>')
    else:
        radius = RADIUS[board.kind] * pitch
        parts += [f'<circle cx="{x:g}" cy="{y:g}" r="{radius:g}" fill="#000"/>' for x, y in points.tolist()]
    y_mm = top + height + _TEXT_MM / 2
    text = str(board)
    if width > SCALE_MM + 2 * _TEXT_MM:
        x_mm = left + _TEXT_MM
        line = f"M{x_mm:g} {y_mm - 1.5:g}v3m0-1.5h{SCALE_MM:g}m0-1.5v3"
        parts.append(f'<path d="{line}" stroke="#000" stroke-width="0.3"/>')
        text += f"; print at 100 %: the line is {SCALE_MM:g} mm long"
    place = f'x="{left + _TEXT_MM:g}" y="{y_mm + 1.5 * _TEXT_MM:g}"'
    parts.append(f'<text {place} font-family="sans-serif" font-size="{_TEXT_MM:g}">{text}</text></svg>')
    return "".join(parts)
