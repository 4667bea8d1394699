"""What one frame of the live picture shows of the board, and the view that is taken of it. Pure.

A view is kept as a grey PNG: the board is searched in grey, so `gateway calibrate` finds the very same points in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2

from gateway.config import Intrinsics
from gateway.vision.offline.calibration import boards
from gateway.vision.offline.calibration.boards import Board, Points
from gateway.vision.offline.calibration.selection import HOLD_S, Stillness, ViewVerdict, worth
from gateway.vision.transport.ring import Snapshot
from gateway.web.server.pictures import picture_file

_COMPRESSION = 1  # quick, and a tenth larger than it could be


@dataclass(frozen=True, slots=True)
class Examined:
    """`points`: where the board is now, for people; `view`: its points as they are calibrated with, and its PNG; None:
    not taken."""

    verdict: ViewVerdict
    points: Points | None
    held_s: float
    view: tuple[Points, bytes] | None = None


def examine(
    board: Board,
    frame: Snapshot,
    taken: Sequence[Points],
    lens: Intrinsics | None,
    stillness: Stillness,
    *,
    by_hand: bool = False,
) -> Examined:
    """`by_hand`: taken wherever the board is found, still and different or not. Raises UnencodableError."""
    seen = boards.look(board, frame.image)
    size_px = frame.image.shape[1], frame.image.shape[0]
    held_s = stillness.held_s(board, seen, size_px, frame.t_capture_ns)
    if seen is None:
        return Examined(ViewVerdict.NOT_FOUND, None, 0.0)
    verdict = worth(board, seen, boards.grey_of(frame.image), taken, lens)
    if not by_hand:
        if verdict is not ViewVerdict.TAKEN:
            return Examined(verdict, seen, held_s)
        if held_s < HOLD_S:
            return Examined(ViewVerdict.MOVING, seen, held_s)
    points = boards.find(board, frame.image, thorough=False)
    if points is None:
        return Examined(ViewVerdict.NOT_FOUND, seen, held_s)
    png = picture_file(boards.grey_of(frame.image), "png", cv2.IMWRITE_PNG_COMPRESSION, _COMPRESSION)
    return Examined(ViewVerdict.TAKEN, points, held_s, (points, png))
