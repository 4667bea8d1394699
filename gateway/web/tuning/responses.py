"""The answers to the tuning page and to programs, made from what was measured. Pure."""

from urllib.parse import quote

from gateway.core.detection import Detection
from gateway.vision.offline.tuning import exposure
from gateway.web.profile import parameter_schema
from gateway.web.server.models import view_of
from gateway.web.tuning.response_models import (
    CaptureView,
    DetectionView,
    ExposureView,
    LightView,
    PanelView,
    SideView,
    SizeView,
    StageView,
    TrialView,
)
from gateway.web.tuning.snapshots import Capture
from gateway.web.tuning.trial import SideResult
from gateway.web.tuning.tuning_service import CompletedTrial


def described(capture: Capture) -> CaptureView:
    height, width = capture.frames[0].image.shape[:2]
    return view_of(
        CaptureView,
        capture,
        kind="recording" if capture.recorded else "snapshot",
        frames=len(capture.frames),
        frame_ids=[frame.seq for frame in capture.frames],
        seconds=round(capture.seconds, 3),
        width_px=width,
        height_px=height,
        taken_ms=capture.wall_ns // 1_000_000,
    )


def tried(bay: str, one: CompletedTrial) -> TrialView:
    result = one.result
    return view_of(
        TrialView,
        result,
        number=one.number,
        shown=one.shown,
        frame_id=one.frame_id,
        settings_in_force=parameter_schema.values(one.in_force),
        picture=SizeView(width_px=one.width_px, height_px=one.height_px),
        tried=_side(result.tried),
        in_force=_side(result.in_force),
        reference=[_detection(found) for found in result.reference],
        time_ratio=round(result.time_ratio, 3),
        remarks=one.remarks,
        panels=[
            view_of(
                PanelView,
                panel,
                url=f"/api/bays/{quote(bay)}/trial/{one.number}/{panel.name}",
                width_px=panel.image.shape[1],
                height_px=panel.image.shape[0],
            )
            for panel in one.panels
        ],
        exposure=None
        if not one.lights
        else ExposureView(
            advice=exposure.advice(one.lights),
            figures=LightView.model_validate(one.lights[len(one.lights) // 2]),
            marker_seen=any(found.circle is not None for found in result.reference),
        ),
    )


def _side(one: SideResult) -> SideView:
    return view_of(
        SideView,
        one,
        total_ms=round(one.times.total_ms, 3),
        stages=[StageView(name=name, ms=round(ms, 3)) for name, ms in one.times.stages],
        frames=[_detection(found) for found in one.found],
    )


def _detection(found: Detection) -> DetectionView:
    circle = found.circle
    return DetectionView(
        found=circle is not None,
        u_px=circle and circle.u_px,
        v_px=circle and circle.v_px,
        radius_px=circle and circle.radius_px,
        confidence=found.confidence,
        candidates=found.candidates,
    )
