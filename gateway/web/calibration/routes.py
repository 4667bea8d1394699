"""The addresses of the calibration, /api/bays/{bay}/calibration. `security` has checked who calls.

Nothing here changes the bay or the file: what was found is saved by /api/setup.
"""

import tomllib
from collections.abc import AsyncIterator, Iterator
from typing import Annotated, Any

import cv2
from fastapi import Depends, Query
from starlette.responses import Response, StreamingResponse

from gateway.durations import NS_PER_MS
from gateway.vision.offline.calibration import drawing, report
from gateway.vision.offline.calibration.boards import (
    LEAST_MM,
    LEAST_POINTS,
    MOST_MM,
    MOST_POINTS,
    Board,
    CalibrationBoardKind,
)
from gateway.vision.offline.calibration.selection import HOLD_S, appearance, progress
from gateway.vision.offline.calibration.solve import GOOD_VIEWS, Calibration
from gateway.web.auth.access import Level
from gateway.web.auth.addresses import ApiAddresses, whole_number
from gateway.web.auth.refusals import RefusalError
from gateway.web.calibration import archive
from gateway.web.calibration.models import (
    BeginBody,
    BoardKind,
    CalibrationView,
    FittedView,
    LookBody,
    LookView,
    Parameter,
    ResultView,
    ViewRow,
)
from gateway.web.calibration.sessions import MAX_VIEWS, Calibrations, CalibrationSession, KeptView
from gateway.web.server.models import view_of
from gateway.web.server.services import Bay, RequestCaller, WebServices

Number = Annotated[int, whole_number(0, 1 << 53)]
MarkerRadius = Annotated[
    float | None, Query(gt=0, le=10_000, description="true radius of the marker, mm: for [fusion.cross_check], too")
]
ADDRESSES = ApiAddresses(
    "/api/bays/{bay}/calibration",
    least=Level.TECHNICIAN,
    errors={404: "no such bay", 409: "no calibration is under way, or another user's"},
)
_BUSY = {503: "no picture, or too many requests at the same time"}
_RESULT = {400: "marker_radius_mm is not allowed"} | _BUSY
_REPORT = {422: "there is no result yet"} | _RESULT


async def _calibrations(services: WebServices) -> Calibrations:
    return services.calibrations


async def _who(caller: RequestCaller) -> str:
    return caller.name or caller.address


Who = Annotated[str, Depends(_who)]


async def _session(services: WebServices, bay: Bay, who: Who) -> CalibrationSession:
    return services.calibrations.mine(bay.name, who)


All = Annotated[Calibrations, Depends(_calibrations)]
Mine = Annotated[CalibrationSession, Depends(_session)]


@ADDRESSES.get("", "calibration_state", "the calibration that is under way, with its views")
async def _state(calibrations: All, bay: Bay, who: Who) -> CalibrationView:
    return _view(calibrations.of(bay.name), who)


@ADDRESSES.post("", "calibration_begin", "begin to calibrate this bay's camera", errors=_BUSY, audited=False)
async def _begin(calibrations: All, bay: Bay, who: Who, body: BeginBody) -> CalibrationView:
    board = Board(CalibrationBoardKind(body.kind), body.columns, body.rows, body.pitch_mm)
    coefficients = None if body.distortion == "auto" else int(body.distortion)
    return _view(await calibrations.begin(bay.name, board, coefficients, who), who)


@ADDRESSES.delete("", "calibration_end", "end the calibration; its views are lost")  # audited: it may be another user's
async def _end(calibrations: All, bay: Bay) -> CalibrationView:
    calibrations.end(bay.name)
    return _view(None, "")


@ADDRESSES.post(
    "/look",
    "calibration_look",
    "look at the live picture; takes a view of a board that is held still",
    errors=_BUSY,
    audited=False,
)
async def _look(calibrations: All, session: Mine, body: LookBody) -> LookView:
    look = await calibrations.look(session, body.after, body.width_px, take=body.take)
    found = look.examined
    return view_of(
        LookView,
        look,
        verdict=found.verdict,
        points=[] if found.points is None else _pairs(found.points),
        held_s=round(found.held_s, 2),
        hold_s=HOLD_S,
        width_px=look.size_px[0],
        height_px=look.size_px[1],
        work_ms=round(look.work_ms, 1),
        other_board=None if look.other is None else list(look.other),
        revision=session.revision,
    )


@ADDRESSES.get(
    "/look/{number}/picture", "calibration_picture", "the picture of one of the newest looks", media="image/jpeg"
)
async def _picture(session: Mine, number: Number) -> Response:
    if (jpeg := session.pictures.get(number)) is None:
        raise RefusalError(404, "gone", "the picture of this look is not kept any more")
    return Response(jpeg, media_type="image/jpeg")


@ADDRESSES.get("/views/{number}/picture", "calibration_view", "a view that was taken", media="image/jpeg")
async def _thumbnail(session: Mine, number: Number) -> Response:
    return Response(_kept(session, number).thumbnail, media_type="image/jpeg")


@ADDRESSES.delete("/views/{number}", "calibration_remove_view", "remove a view that was taken", audited=False)
async def _remove(calibrations: All, session: Mine, number: Number) -> CalibrationView:
    _kept(session, number)
    calibrations.remove(session, number)
    return _view(session, session.who)


@ADDRESSES.get(
    "/views.zip", "calibration_views", "the views as pictures, for gateway calibrate", media="application/zip"
)
async def _zip(session: Mine) -> Response:
    async def sent(parts: Iterator[bytes]) -> AsyncIterator[bytes]:
        for part in parts:
            yield part

    headers = {"Content-Disposition": f'attachment; filename="calibration-{session.bay}.zip"'}
    parts = archive.pieces(session.board, session.coefficients, session.views)
    return StreamingResponse(sent(parts), media_type="application/zip", headers=headers)


@ADDRESSES.get("/result", "calibration_result", "what follows from the views", errors=_RESULT)
async def _result(calibrations: All, session: Mine, marker_radius_mm: MarkerRadius = None) -> ResultView:
    found = await calibrations.result(session)
    if isinstance(found, str):
        return ResultView(why=found, revision=session.solved)
    return _result_view(session, found, marker_radius_mm)


@ADDRESSES.get("/report.html", "calibration_report", "the result as a report", media="text/html", errors=_REPORT)
async def _report(calibrations: All, session: Mine, marker_radius_mm: MarkerRadius = None) -> Response:
    """To be saved: the pages' own policy lets no page have styles inside."""
    found = await calibrations.result(session)
    if isinstance(found, str):
        raise RefusalError(422, "settings", found)
    text = report.toml(session.board, found, marker_radius_mm)
    html = report.html(session.board, found, text, (f"camera of {session.bay}",), ())
    headers = {"Content-Disposition": f'attachment; filename="calibration-{session.bay}.html"'}
    return Response(html, media_type="text/html; charset=utf-8", headers=headers)


@ADDRESSES.get(
    "/board.svg", "calibration_board", "a board to print", media="image/svg+xml", errors={400: "not such a board"}
)
async def _board(
    bay: Bay,
    kind: BoardKind,
    columns: Annotated[int, Query(ge=LEAST_POINTS, le=MOST_POINTS)],
    rows: Annotated[int, Query(ge=LEAST_POINTS, le=MOST_POINTS)],
    pitch_mm: Annotated[float, Query(ge=LEAST_MM, le=MOST_MM)],
) -> Response:
    return Response(drawing.svg(Board(CalibrationBoardKind(kind), columns, rows, pitch_mm)), media_type="image/svg+xml")


def _kept(session: CalibrationSession, number: int) -> KeptView:
    for view in session.views:
        if view.number == number:
            return view
    raise RefusalError(404, "gone", f"there is no view {number} (any more)")


def _pairs(points: Any) -> list[list[float]]:
    return [[round(float(u), 1), round(float(v), 1)] for u, v in points]


def _view(session: CalibrationSession | None, who: str) -> CalibrationView:
    if session is None:
        return CalibrationView(phase="none")
    lens = session.outcome.lens if isinstance(session.outcome, Calibration) else None
    board = session.board
    found = progress(board, [view.points for view in session.views], session.size_px, lens)
    rows = []
    for view in session.views:
        seen = appearance(board, view.points, session.size_px, lens)
        rows.append(
            ViewRow(
                number=view.number,
                name=view.name,
                taken_ms=view.wall_ns // NS_PER_MS,
                outline=_pairs(cv2.convexHull(view.points).reshape(-1, 2)),
                size_share=round(seen.size**2, 4),
                right_deg=round(seen.right_deg, 1),
                bottom_deg=round(seen.bottom_deg, 1),
            )
        )
    return CalibrationView(
        phase="running",
        who=session.who,
        mine=session.who == who,
        board=BeginBody(
            kind=board.kind.value,
            columns=board.columns,
            rows=board.rows,
            pitch_mm=board.pitch_mm,
            distortion="auto" if session.coefficients is None else str(session.coefficients),  # type: ignore[arg-type]
        ),
        width_px=session.size_px[0],
        height_px=session.size_px[1],
        revision=session.revision,
        views=rows,
        coverage=found.coverage.tolist(),
        covered=round(float((found.coverage > 0).mean()), 3),
        distances=round(found.distances, 2),
        missing=list(found.missing),
        wanted=GOOD_VIEWS,
        most=MAX_VIEWS,
    )


def _result_view(session: CalibrationSession, found: Calibration, marker_radius_mm: float | None) -> ResultView:
    lens = found.lens
    values = (lens.fx, lens.fy, lens.cx, lens.cy, *lens.distortion)
    text = report.toml(session.board, found, marker_radius_mm)
    used = [
        view_of(
            FittedView,
            view,
            rms_px=round(view.rms_px, 4),
            largest_px=round(view.largest_px, 3),
            tilt_deg=round(view.tilt_deg, 1),
            distance_mm=round(view.distance_mm, 1),
            used=True,
        )
        for view in found.views
    ]
    left_out = [
        FittedView(name=name, rms_px=round(rms, 4), largest_px=None, tilt_deg=None, distance_mm=None, used=False)
        for name, rms in found.rejected
    ]
    return ResultView(
        why="",
        revision=session.solved,
        parameters=[
            Parameter(name=name, value=value, sigma=sigma)
            for (name, sigma), value in zip(found.sigma, values, strict=True)
        ],
        rms_px=round(found.rms_px, 4),
        views=used + left_out,
        worst=max(found.views, key=lambda view: view.rms_px).name,
        warnings=list(found.warnings),
        toml=text,
        command=archive.command(session.board, session.coefficients, marker_radius_mm),
        changes=_changes(session.bay, text),
    )


def _changes(bay: str, toml: str) -> list[dict[str, Any]]:
    """The very numbers of the snippet. Other keys of [fusion.cross_check] stay."""
    document = tomllib.loads(toml)
    changes = [{"path": ["bays", bay, "vision", "intrinsics"], "value": document["vision"]["intrinsics"]}]
    check = document.get("fusion", {}).get("cross_check", {})
    changes += [{"path": ["bays", bay, "fusion", "cross_check", key], "value": value} for key, value in check.items()]
    return changes
