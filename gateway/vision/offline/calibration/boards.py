"""Calibration boards: what they are, where their points are on the board, and finding them in a picture. Pure."""

import re
from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.errors import ConfigError
from gateway.vision.pixels import Image

Points = NDArray[np.float32]  # (n, 2), px; pixel centres at integers
Grey = NDArray[np.uint8]  # (H, W)
LEAST_POINTS, MOST_POINTS = 3, 100  # a side
LEAST_MM, MOST_MM = 0.1, 10_000.0
SEARCH_PX = 800  # longer side of the picture in which a checkerboard is searched first
_SUBPIX_END = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-5)


class CalibrationBoardKind(StrEnum):
    CHECKERBOARD = "checkerboard"
    CIRCLES = "circles"
    ASYMMETRIC = "asymmetric-circles"


_WORDS = {
    CalibrationBoardKind.CHECKERBOARD: ("checkerboard", "inner corners"),
    CalibrationBoardKind.CIRCLES: ("grid", "circles"),
    CalibrationBoardKind.ASYMMETRIC: ("asymmetric grid", "circles"),
}


@dataclass(frozen=True, slots=True)
class Board:
    """`columns` x `rows` points. `pitch_mm`: side of a square; distance of neighbours in a symmetric grid; in an
    asymmetric one the distance from row to row, half of that between neighbours in a row."""

    kind: CalibrationBoardKind
    columns: int
    rows: int
    pitch_mm: float

    @property
    def points_mm(self) -> NDArray[np.float32]:
        """(n, 3), z = 0, in the order in which `find` gives them."""
        column, row = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        x = 2 * column + row % 2 if self.kind is CalibrationBoardKind.ASYMMETRIC else column
        points = np.stack((x.ravel(), row.ravel(), np.zeros(self.columns * self.rows)), axis=1)
        return np.asarray(points * self.pitch_mm, np.float32)

    @property
    def spec(self) -> str:
        """As `parse` reads it."""
        return f"{self.kind}:{self.columns}x{self.rows}:{self.pitch_mm:g}mm"

    def __str__(self) -> str:
        name, points = _WORDS[self.kind]
        return f"{name} of {self.columns} x {self.rows} {points}, {self.pitch_mm:g} mm"


_SPEC = re.compile(r"([a-z-]+):(\d{1,4})x(\d{1,4}):(\d+(?:\.\d+)?)(mm|cm|m)?")
_UNIT_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, None: 1.0}


def parse(text: str) -> Board:
    """`checkerboard:9x6:25mm`, `circles:7x5:30mm`, `asymmetric-circles:4x11:20mm`. Raises ConfigError."""
    match = _SPEC.fullmatch(text.strip().lower())
    if match is None:
        raise ConfigError(
            f"--board {text}: expected KIND:COLUMNSxROWS:SIZE, as checkerboard:9x6:25mm (inner corners, not squares), "
            "circles:7x5:30mm or asymmetric-circles:4x11:20mm"
        )
    name, columns, rows, size, unit = match.groups()
    if name not in list(CalibrationBoardKind):
        raise ConfigError(f"--board {text}: there is no board {name}; there is: {', '.join(CalibrationBoardKind)}")
    pitch_mm = float(size) * _UNIT_MM[unit]
    if not (LEAST_POINTS <= int(columns) <= MOST_POINTS and LEAST_POINTS <= int(rows) <= MOST_POINTS):
        raise ConfigError(f"--board {text}: 3 to 100 points a side; {columns} x {rows} were given")
    if not LEAST_MM <= pitch_mm <= MOST_MM:
        raise ConfigError(f"--board {text}: the size must be 0.1 mm to 10 m")
    return Board(CalibrationBoardKind(name), int(columns), int(rows), pitch_mm)


def find(board: Board, image: Image, *, thorough: bool = True) -> Points | None:
    """All points of the board to sub-pixel, in the order of `points_mm`; None: not all of them are seen.

    Not `thorough`: only what `look` finds, which is quick on any picture. What is found so is what a thorough search
    finds, too, number for number.
    """
    grey = grey_of(image)
    if not thorough and _looked(board, grey) is None:
        return None
    if board.kind is CalibrationBoardKind.CHECKERBOARD:
        return _corners(board, grey, thorough=thorough)
    return _circles(board, grey, thorough=thorough)


def look(board: Board, image: Image) -> Points | None:
    """The same to a pixel of a picture of at most SEARCH_PX, in px of this one: for a picture that is being watched."""
    return _looked(board, grey_of(image))


def spacing_px(board: Board, points: Points) -> float:
    """The smallest distance between neighbours of a row or a column."""
    grid = points.reshape(board.rows, board.columns, 2)
    return min(float(np.linalg.norm(np.diff(grid, axis=axis), axis=2).min()) for axis in (0, 1))


def grey_of(image: Image) -> Grey:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def _smaller(grey: Grey) -> Grey:
    """At most SEARCH_PX wide and high."""
    scale = max(grey.shape) / SEARCH_PX
    if scale <= 1:
        return grey
    size = max(1, round(grey.shape[1] / scale)), max(1, round(grey.shape[0] / scale))
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)


def _looked(board: Board, grey: Grey) -> Points | None:
    small = _smaller(grey)
    if board.kind is CalibrationBoardKind.CHECKERBOARD:
        found = _older(board, small)  # the quickest, with a board and without
        points = _newer(board, small) if found is None else found
    else:
        points = _circles(board, small, thorough=False)
    if points is None or small is grey:
        return points
    factor = np.array([grey.shape[1] / small.shape[1], grey.shape[0] / small.shape[0]])
    return np.asarray((points + 0.5) * factor - 0.5, np.float32)


def other_size(board: Board, image: Image) -> tuple[int, int] | None:
    """Columns and rows of a checkerboard of another size in the picture, for a hint; None: none is seen."""
    if board.kind is not CalibrationBoardKind.CHECKERBOARD:
        return None
    grey = _smaller(grey_of(image))
    flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, _, meta = cv2.findChessboardCornersSBWithMeta(grey, (3, 3), flags)
    if not found:
        return None
    short, long = sorted(meta.shape[:2])
    if (short, long) == tuple(sorted((board.columns, board.rows))):
        return None
    return (long, short) if board.columns >= board.rows else (short, long)


def _corners(board: Board, grey: Grey, *, thorough: bool) -> Points | None:
    """Found in a smaller picture, refined in this one. Thoroughly: the newer finder first; the older one copes with a
    narrow white margin, which the newer one does not."""
    points = _looked(board, grey)
    if points is None and thorough:
        points = _newer(board, grey)
        if points is None:
            points = _newer(board, grey, cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_NORMALIZE_IMAGE)
        if points is None:
            points = _older(board, grey)
    return None if points is None else _refined(board, grey, points)


def _newer(board: Board, grey: Grey, flags: int = 0) -> Points | None:
    found, corners = cv2.findChessboardCornersSB(grey, (board.columns, board.rows), flags=flags)
    return _points(board, corners) if found else None


def _older(board: Board, grey: Grey) -> Points | None:
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
    found, corners = cv2.findChessboardCorners(grey, (board.columns, board.rows), flags=flags)
    return _points(board, corners) if found else None


def _refined(board: Board, grey: Grey, points: Points) -> Points | None:
    """The finders' own places are off by 0.1 to 0.2 px rms on drawn boards; the saddle points of a slightly blurred
    picture by 0.03."""
    # A window that reaches the next corner would be pulled to it.
    half = int(np.clip(spacing_px(board, points) / 3, 2, 15))
    soft = cv2.GaussianBlur(grey, (0, 0), 1.0)
    return _points(board, cv2.cornerSubPix(soft, points.reshape(-1, 1, 2), (half, half), (-1, -1), _SUBPIX_END))


def _circles(board: Board, grey: Grey, *, thorough: bool) -> Points | None:
    kind = (
        cv2.CALIB_CB_ASYMMETRIC_GRID if board.kind is CalibrationBoardKind.ASYMMETRIC else cv2.CALIB_CB_SYMMETRIC_GRID
    )
    blobs = _blob_finder(grey.size / (board.columns * board.rows))
    ways = (kind, kind | cv2.CALIB_CB_CLUSTERING) if thorough else (kind,)  # clusters of noise take their time
    for flags in ways:
        for picture in (grey, np.asarray(255 - grey, np.uint8)):  # dark circles on light, then light ones on dark
            found, centres = cv2.findCirclesGrid(picture, (board.columns, board.rows), flags=flags, blobDetector=blobs)
            if found:
                return _points(board, centres)
    return None


def _blob_finder(cell_px2: float) -> cv2.SimpleBlobDetector:
    """For circles up to the size they can have in the picture: the built-in limit is 5000 px^2."""
    params = cv2.SimpleBlobDetector.Params()
    params.minArea, params.maxArea = 20.0, max(200.0, cell_px2)
    params.minDistBetweenBlobs = 4.0
    params.filterByConvexity, params.minConvexity = True, 0.9
    params.filterByInertia, params.minInertiaRatio = True, 0.15  # tilt makes ellipses
    params.filterByCircularity = False
    return cv2.SimpleBlobDetector.create(params)


def _points(board: Board, found: object) -> Points | None:
    points = np.asarray(found, np.float32).reshape(-1, 2)
    return points if len(points) == board.columns * board.rows and np.isfinite(points).all() else None
