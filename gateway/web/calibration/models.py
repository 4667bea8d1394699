"""What the calibration page requests, and what it is answered. Pure."""

from typing import Any, Literal

from pydantic import Field

from gateway.explained import ExplainedStr
from gateway.vision.offline.calibration.boards import LEAST_MM, LEAST_POINTS, MOST_MM, MOST_POINTS, CalibrationBoardKind
from gateway.vision.offline.calibration.selection import Missing, ViewVerdict
from gateway.web.tuning.request_models import Body

BoardKind = Literal["checkerboard", "circles", "asymmetric-circles"]
assert set(CalibrationBoardKind) == set(BoardKind.__args__)  # type: ignore[attr-defined]


def _meanings(codes: type[ExplainedStr]) -> str:
    return "; ".join(f"`{code}`: {code.meaning}" for code in codes)


class BeginBody(Body):
    """Begin to calibrate a bay's camera with this board; its former views are lost."""

    kind: BoardKind = "checkerboard"
    columns: int = Field(9, ge=LEAST_POINTS, le=MOST_POINTS, description="inner corners or circles in a row")
    rows: int = Field(6, ge=LEAST_POINTS, le=MOST_POINTS)
    pitch_mm: float = Field(
        25.0, ge=LEAST_MM, le=MOST_MM, description="side of a square; distance of neighbouring circles, or of rows"
    )
    distortion: Literal["auto", "0", "4", "5", "8"] = Field("auto", description="coefficients")


class LookBody(Body):
    """Look at the live picture once."""

    after: int = Field(0, ge=0, description="number of the newest look that is known")
    width_px: int = Field(960, ge=160, le=1920, description="of the picture of this look")
    take: bool = Field(False, description="take this view even if the board is not still, or it is like another one")


class LookView(Body):
    """What was seen in one frame, and whether a view of it was taken."""

    number: int = Field(description="its picture is at look/{number}/picture for a moment")
    verdict: ViewVerdict = Field(description=_meanings(ViewVerdict))
    points: list[list[float]] = Field(description="u, v of each corner or circle, px of the frame; empty: not found")
    held_s: float = Field(description="the board has been held where it is for this time")
    hold_s: float = Field(description="it must be held for this time")
    width_px: int
    height_px: int
    frame_id: int | None = Field(description="null: there is no new frame")
    age_ms: float | None = Field(description="of the frame; of the one before where there is no new one")
    work_ms: float = Field(description="this look took this time")
    view: int | None = Field(description="number of the view that was taken")
    other_board: list[int] | None = Field(description="columns and rows of a checkerboard that is seen instead")
    revision: int = Field(description="of the session's views")


class ViewRow(Body):
    """A view that was taken."""

    number: int
    name: str = Field(description="of its file in views.zip")
    taken_ms: int = Field(description="Unix time")
    outline: list[list[float]] = Field(description="u, v of the board's four outer points, px, round")
    size_share: float = Field(description="of the picture that the board fills")
    right_deg: float = Field(description="tilt: positive: the right edge is farther away than the left one")
    bottom_deg: float = Field(description="positive: the lower edge is farther away")


class CalibrationView(Body):
    """The calibration that is under way for a bay."""

    phase: Literal["none", "running"]
    who: str = ""
    mine: bool = Field(False, description="false: another user's, who alone can go on with it")
    board: BeginBody | None = None
    width_px: int = 0
    height_px: int = 0
    revision: int = 0
    views: list[ViewRow] = Field([])
    coverage: list[list[int]] = Field([], description="rows of cells of the picture: points seen in each")
    covered: float = Field(0.0, description="share of the cells in which a point was seen")
    distances: float = Field(1.0, description="ratio of the largest to the smallest board in the picture")
    missing: list[Missing] = Field([], description=_meanings(Missing))
    wanted: int = Field(0, description="so many views are good")
    most: int = Field(0, description="so many views are kept")


class Parameter(Body):
    """One number of the lens."""

    name: str = Field(description="fx, fy, cx, cy, k1, ...")
    value: float = Field(description="px; of the distortion: without a unit")
    sigma: float = Field(description="one standard deviation")


class FittedView(Body):
    """What the result makes of a view."""

    name: str
    rms_px: float
    largest_px: float | None = Field(description="largest residual; null: left out")
    tilt_deg: float | None
    distance_mm: float | None
    used: bool = Field(description="false: left out, it fits far worse than the others")


class ResultView(Body):
    """What follows from the views: as `gateway calibrate` has it."""

    why: str = Field(description="why there is no result yet; empty: there is one")
    revision: int = Field(description="of the session's views")
    parameters: list[Parameter] = Field([])
    rms_px: float | None = None
    views: list[FittedView] = Field([], description="in the order in which they were taken, those left out last")
    worst: str | None = Field(None, description="name of the view that fits worst of those used")
    warnings: list[str] = Field([])
    toml: str = ""
    command: str = Field("", description="that gives the same from the pictures of views.zip")
    changes: list[dict[str, Any]] = Field([], description="as /api/setup/preview takes them")
