"""Points on a board and where they are seen -> intrinsics, their uncertainty, and warnings. Pure."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.config import Intrinsics
from gateway.errors import ConfigError
from gateway.vision.offline.calibration.boards import Board, Points

FEWEST_VIEWS = 3  # a plane seen once or twice does not fix focal length, centre and distortion
GOOD_VIEWS = 10
TILTED_DEG = 15.0
FRONTAL_DEG = 8.0  # if no view is tilted by more, any focal length fits nearly as well, and sigma does not show it
UNKNOWN = 0.1  # a focal length with a larger standard deviation is not known
CELLS = (8, 6)  # of the coverage map, across and down
COVERED = 0.6  # the least share of them with points in them
DISTORTIONS = {
    0: cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST,
    4: cv2.CALIB_FIX_K3,
    5: 0,
    8: cv2.CALIB_RATIONAL_MODEL,
}
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_END = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)


@dataclass(frozen=True, slots=True)
class BoardView:
    """The board's points in one picture."""

    name: str
    points: Points


@dataclass(frozen=True, slots=True)
class ViewFit:
    """One view and what the solved camera makes of it."""

    name: str
    points: NDArray[np.float64]  # (n, 2), px, as seen
    residuals: NDArray[np.float64]  # (n, 2), px: seen - projected
    tilt_deg: float  # between the board's normal and the optical axis
    distance_mm: float  # from the camera to the board's middle

    @property
    def rms_px(self) -> float:
        """Root mean square of the residuals' lengths."""
        return float(np.sqrt((self.residuals**2).sum(axis=1).mean()))

    @property
    def largest_px(self) -> float:
        return float(np.hypot(*self.residuals.T).max())


@dataclass(frozen=True, slots=True)
class Calibration:
    size_px: tuple[int, int]
    lens: Intrinsics
    sigma: tuple[tuple[str, float], ...]  # one standard deviation of each parameter, by name
    rms_px: float  # over all points used
    views: tuple[ViewFit, ...]
    rejected: tuple[tuple[str, float], ...]  # views left out, with their rms
    coverage: NDArray[np.int64]  # (rows, columns) of CELLS: points in each cell of the frame
    warnings: tuple[str, ...]


def calibrate(
    board: Board, views: Sequence[BoardView], size_px: tuple[int, int], coefficients: int | None = None
) -> Calibration:
    """`coefficients` of distortion: 0, 4, 5 or 8; None: 5, or 4 where k3 cannot be distinguished from 0.

    Views that fit far worse than the others are left out, one at a time, the worst first. Raises ConfigError where
    there are too few, where no camera fits, and where the views leave the focal length open: a precise-looking number
    that may be off by a factor would be worse than none.
    """
    kept = list(views)
    _enough(len(kept))
    rejected: list[tuple[str, float]] = []
    chosen = 5 if coefficients is None else coefficients
    solved = _solve(board, kept, size_px, DISTORTIONS[chosen])
    while (outlier := _outlier(solved.fits)) is not None and len(kept) > FEWEST_VIEWS:
        rejected.append((kept[outlier].name, solved.fits[outlier].rms_px))
        del kept[outlier]
        solved = _solve(board, kept, size_px, DISTORTIONS[chosen])
    if coefficients is None and abs(solved.values[8]) < 3 * solved.sigmas[8]:
        chosen = 4
        solved = _solve(board, kept, size_px, DISTORTIONS[4])
    _determined(solved)
    lens = _lens(solved.values, chosen)
    covered = coverage([fit.points for fit in solved.fits], size_px)
    sigma = tuple(zip(NAMES[: 4 + chosen], solved.sigmas, strict=False))
    return Calibration(
        size_px=size_px,
        lens=lens,
        sigma=sigma,
        rms_px=solved.rms_px,
        views=tuple(solved.fits),
        rejected=tuple(rejected),
        coverage=covered,
        warnings=tuple(_warnings(lens, dict(sigma), solved, rejected, covered, size_px)),
    )


@dataclass(frozen=True, slots=True)
class _Solved:
    rms_px: float
    values: list[float]  # fx, fy, cx, cy, then distortion in OpenCV's order
    sigmas: list[float]
    fits: list[ViewFit]


def _enough(count: int) -> None:
    if count < FEWEST_VIEWS:
        raise ConfigError(  # whole sentences: the page translates them
            f"{count} picture shows the whole board; at least {FEWEST_VIEWS} are needed, from different angles, and "
            f"{GOOD_VIEWS} or more are good"
            if count == 1
            else f"{count} pictures show the whole board; at least {FEWEST_VIEWS} are needed, from different angles, "
            f"and {GOOD_VIEWS} or more are good"
        )


def _determined(solved: "_Solved") -> None:
    steepest = max(fit.tilt_deg for fit in solved.fits)
    if steepest < FRONTAL_DEG:
        raise ConfigError(
            f"the board was seen only from the front (steepest view {steepest:.0f} degrees): the focal length can't "
            "be determined from that; tilt the board by 20 to 45 degrees, left, right, up and down"
        )
    for name, value, sigma in zip(NAMES[:2], solved.values, solved.sigmas, strict=False):
        if sigma > UNKNOWN * value:
            raise ConfigError(
                f"{name} is {value:.0f} px, give or take {sigma:.0f}: these pictures are too few or too alike"
            )


def _solve(board: Board, views: Sequence[BoardView], size_px: tuple[int, int], flags: int) -> _Solved:
    target = board.points_mm
    guess: Any = None  # the stubs miss that both matrices may be left to the solver
    try:
        rms, matrix, distortion, turns, shifts, sigmas, _, _ = cv2.calibrateCameraExtended(
            [target] * len(views), [view.points for view in views], size_px, guess, guess, flags=flags, criteria=_END
        )
    except cv2.error as error:
        raise ConfigError(f"no camera fits these pictures: {' '.join(str(error).split())}") from error
    fits = [
        _fit(view, target, np.asarray(turn), np.asarray(shift), matrix, distortion)
        for view, turn, shift in zip(views, turns, shifts, strict=True)
    ]
    values = [float(x) for x in (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *np.ravel(distortion))]
    spread = [float(x) for x in np.ravel(sigmas)]
    largest = 20 * max(size_px)
    if not np.isfinite([*values, rms]).all() or not (0 < values[0] < largest and 0 < values[1] < largest):
        raise ConfigError(
            "no camera fits these pictures: is the board's size right, and is it seen from several angles?"
        )
    return _Solved(float(rms), values, spread, fits)


def _fit(
    view: BoardView, target: NDArray[Any], turn: NDArray[Any], shift: NDArray[Any], matrix: Any, distortion: Any
) -> ViewFit:
    projected, _ = cv2.projectPoints(target, turn, shift, matrix, distortion)
    rotation, _ = cv2.Rodrigues(turn)
    middle = rotation @ target.mean(axis=0).reshape(3, 1) + shift.reshape(3, 1)
    points = view.points.astype(np.float64)
    return ViewFit(
        name=view.name,
        points=points,
        residuals=points - np.asarray(projected, np.float64).reshape(-1, 2),
        tilt_deg=math.degrees(math.acos(min(1.0, abs(float(rotation[2, 2]))))),
        distance_mm=float(np.linalg.norm(middle)),
    )


def _lens(values: Sequence[float], coefficients: int) -> Intrinsics:
    fx, fy, cx, cy = values[:4]
    return Intrinsics(fx=fx, fy=fy, cx=cx, cy=cy, distortion=tuple(values[4 : 4 + coefficients]))


def _outlier(fits: Sequence[ViewFit]) -> int | None:
    """The view that fits worst, if by far: three times the median and clearly beyond the spread of the others."""
    rms = np.array([fit.rms_px for fit in fits])
    middle = float(np.median(rms))
    spread = 1.4826 * float(np.median(np.abs(rms - middle)))
    worst = int(np.argmax(rms))
    return worst if rms[worst] > max(3 * middle, middle + 6 * spread, 0.15) else None


def coverage(views: Sequence[NDArray[Any]], size_px: tuple[int, int]) -> NDArray[np.int64]:
    """(rows, columns) of CELLS: how many of the views' points, (n, 2) px each, lie in each cell of the frame."""
    points = np.concatenate([np.empty((0, 2)), *views])
    across, down = CELLS
    edges = (np.linspace(-0.5, size_px[1] - 0.5, down + 1), np.linspace(-0.5, size_px[0] - 0.5, across + 1))
    counts, _, _ = np.histogram2d(points[:, 1], points[:, 0], bins=edges)
    return np.asarray(counts, np.int64)


def _warnings(
    lens: Intrinsics,
    sigma: dict[str, float],
    solved: _Solved,
    rejected: Sequence[tuple[str, float]],
    coverage: NDArray[np.int64],
    size_px: tuple[int, int],
) -> list[str]:
    found: list[str] = []
    if len(solved.fits) < GOOD_VIEWS:
        found.append(f"only {len(solved.fits)} views: take {GOOD_VIEWS} or more, near and far, tilted each way")
    tilted = sum(fit.tilt_deg >= TILTED_DEG for fit in solved.fits)
    if tilted < FEWEST_VIEWS:
        found.append(
            f"{tilted} views are tilted by {TILTED_DEG:g} degrees or more: seen only from the front, a short focal "
            "length near by looks as a long one far away; tilt the board by 20 to 45 degrees, left, right, up and down"
        )
    covered = float((coverage > 0).mean())
    if covered < COVERED:
        found.append(f"the board was seen in {100 * covered:.0f} % of the frame: the distortion elsewhere is a guess")
    if solved.rms_px > 1.0:
        found.append(
            f"reprojection error of {solved.rms_px:.2f} px: below 0.5 is usual; is the board flat, the lens fixed (no "
            "autofocus), the picture sharp, and the board's size right?"
        )
    for name in ("fx", "fy"):
        share = sigma[name] / getattr(lens, name)
        if share > 0.005:
            found.append(f"{name} is uncertain by {100 * share:.1f} % (one standard deviation): more and steeper views")
    if abs(lens.fx / lens.fy - 1) > 0.02:
        found.append(
            f"fx and fy differ by {100 * abs(lens.fx / lens.fy - 1):.1f} %: square pixels have none; wrong board?"
        )
    away = math.hypot(lens.cx - (size_px[0] - 1) / 2, lens.cy - (size_px[1] - 1) / 2)
    if away > 0.1 * max(size_px):
        found.append(f"the principal point lies {away:.0f} px from the middle: were the pictures cropped or turned?")
    found += [f"left out, it fits far worse than the others (rms {rms:.2f} px): {name}" for name, rms in rejected]
    return found
