"""The answers to the tuning page, as JSON: names with units, null where a number is not known. Pure."""

from dataclasses import asdict
from typing import Any
from urllib.parse import quote

from gateway.core.detection import Detection
from gateway.vision.offline.tuning import exposure
from gateway.web.profile import parameter_schema
from gateway.web.tuning.eyedropper import ColourPick
from gateway.web.tuning.service import CompletedTrial
from gateway.web.tuning.trial import SideResult


def tried(bay: str, one: CompletedTrial) -> dict[str, Any]:
    result = one.result
    return {
        "number": one.number,
        "frames": result.frames,
        "shown": one.shown,
        "timed": result.timed,
        "cut_short": result.cut_short,
        "settings_in_force": parameter_schema.values(one.in_force),
        "picture": {"width_px": one.width_px, "height_px": one.height_px},
        "tried": side(result.tried),
        "in_force": side(result.in_force),
        "reference": [detection(found) for found in result.reference],
        "from_in_force": result.from_in_force and asdict(result.from_in_force),
        "from_reference": result.from_reference and asdict(result.from_reference),
        "time_ratio": round(result.time_ratio, 3),
        "remarks": [asdict(remark) for remark in one.remarks],
        "panels": [
            {
                "name": panel.name,
                "title": panel.title,
                "detail": panel.detail,
                "url": f"/api/bays/{quote(bay)}/trial/{one.number}/{panel.name}",
                "width_px": panel.image.shape[1],
                "height_px": panel.image.shape[0],
            }
            for panel in one.panels
        ],
        "exposure": None
        if not one.lights
        else {
            "advice": exposure.advice(one.lights),
            "figures": asdict(one.lights[len(one.lights) // 2]),
            "marker_seen": any(found.circle is not None for found in result.reference),
        },
    }


def side(one: SideResult) -> dict[str, Any]:
    return {
        "found_share": one.found_share,
        "jitter": one.jitter and asdict(one.jitter),
        "total_ms": round(one.times.total_ms, 3),
        "stages": [{"name": name, "ms": round(ms, 3)} for name, ms in one.times.stages],
        "frames": [detection(found) for found in one.found],
    }


def detection(found: Detection) -> dict[str, Any]:
    circle = found.circle
    return {
        "found": circle is not None,
        "u_px": circle and circle.u_px,
        "v_px": circle and circle.v_px,
        "radius_px": circle and circle.radius_px,
        "confidence": found.confidence,
        "candidates": found.candidates,
    }


def picked(one: ColourPick) -> dict[str, Any]:
    return {
        "patch": {**asdict(one.patch), "hue": one.patch.hue},
        "keys": one.keys,
        "admitted_px": one.admitted_px,
        "admitted_share": one.admitted_px / one.picture_px,
        "hanging_px": one.hanging_px,
        "warnings": one.warnings,
    }
