"""What outputs show of a bay. To add a value: one row here, and one choice in each output that shows it. Pure.

Every row reads a state as it may be shown now (gateway/core/shown.py).
"""

from collections.abc import Callable
from enum import Enum
from typing import Any, TypeVar

from gateway.core import ne107
from gateway.core.beacon import BeaconStatus
from gateway.core.detection import Tracking
from gateway.core.ne107 import Ne107
from gateway.core.plc import PlcLink, TriggerPhase
from gateway.core.readings import (
    FRESH_FRAME,
    AgeProof,
    ExposureState,
    Quality,
    RangeReading,
    RangerVote,
    RelayOutput,
    VisionReading,
)
from gateway.core.setpoint import DriveState
from gateway.core.state import FunctionCheck, GuidanceCode, Moved, Reason, StateVector, VisitPhase
from gateway.durations import NS_PER_MS
from gateway.values.value import Value, by_name

Part = TypeVar("Part")
Read = Callable[[StateVector], Any]
TEXTS: dict[type[Enum], Any] = {Reason: Reason.meanings(), GuidanceCode: GuidanceCode.meanings()}


def _part(find: Callable[[StateVector], Part | None]) -> Callable[[Callable[[Part], Any]], Read]:
    """Reads of a record that may be missing."""
    return lambda read: lambda state: None if (part := find(state)) is None else read(part)


_circle = _part(lambda s: s.vision.circle)
_ellipse = _part(lambda s: s.vision.ellipse)
_predicted = _part(lambda s: s.vision.predicted)
_picture = _part(lambda s: s.picture)
_exposure = _part(lambda s: s.exposure)
_scale = _part(lambda s: s.memory.scale)
_marker_wear = _part(lambda s: s.marker)
_relay = _part(lambda s: s.range.relay)
_pose = _part(lambda s: s.pose)


def _frame(state: StateVector) -> Quality:
    """A fresh frame, with or without a marker."""
    return Quality.GOOD if state.vision.quality in FRESH_FRAME else state.vision.quality


def _coasted(state: StateVector) -> Quality:
    return Quality.GOOD if state.vision.quality is Quality.COASTED else Quality.NO_TARGET


def _ms(state: StateVector, since_ns: int | None) -> float | None:
    return None if since_ns is None else max(0, state.t_ns - since_ns) / NS_PER_MS


def _age_ms(state: StateVector, reading: VisionReading | RangeReading) -> float | None:
    known = state.running and reading.quality is not Quality.WAITING
    return _ms(state, reading.t_ns if known else None)


def _plc_age_ms(state: StateVector) -> float | None:
    received = state.running and state.plc.link not in (PlcLink.UNUSED, PlcLink.WAITING)
    return _ms(state, state.plc.beat_ns if received else None)


def _signals(state: StateVector) -> tuple[str, ...]:
    found = ne107.active(state)
    return tuple(signal.name for signal in Ne107 if signal in found)


def _marker(state: StateVector) -> Quality:
    """Good only together with a circle."""
    quality = state.vision.quality
    return Quality.NO_TARGET if quality is Quality.GOOD and state.vision.circle is None else quality


def _ranger(state: StateVector) -> Quality:
    return state.range.quality


def _rangers_status(state: StateVector) -> int | None:
    """Bits 0 to 2: good, 4 to 6: agrees. None: one ranger, or none of them can be judged."""
    return (
        None
        if not state.range.rangers
        else sum((one.quality is Quality.GOOD) << n | one.agrees << n + 4 for n, one in enumerate(state.range.rangers))
    )


def _ranger_rows(n: int) -> tuple[Value[StateVector], ...]:
    def of(state: StateVector) -> RangerVote | None:
        return state.range.rangers[n] if n < len(state.range.rangers) else None

    read, null = _part(of), "not one of several"
    return (
        Value(f"rangers.quality_{n + 1}", Quality, "of this ranger by itself", read(lambda r: r.quality), null),
        Value(f"rangers.distance_{n + 1}_mm", float, "its distance", read(lambda r: r.distance_mm), null),
    )


_FEW = "fewer than 10 visits"
_UNLESS_GOOD = "vision is not GOOD"
_NOT_KNOWN = "not known"
_NO_RELAY = "no relay, or not reported"
_NO_DRIVE = "no drive is configured"

ROWS: tuple[Value[StateVector], ...] = (
    Value("seq", int, "number of the state in this bay; begins again when the gateway starts", lambda s: s.seq),
    Value("stop", bool, "the truck must stop; also on whenever D is unknown", lambda s: s.stop),
    Value("may_move", bool, "the truck may move: stop is off, nothing withholds it; no condition for loading",
          lambda s: s.may_move),
    Value("in_place", bool, "the truck is in place: the only condition for loading", lambda s: s.in_place),
    Value("held", bool, "in_place is held by the ranger alone: the marker is covered", lambda s: s.visit.held),
    Value("moved", Moved, "since it was in place, the truck left it without release: NO, DISTANCE, MARKER",
          lambda s: s.visit.moved),
    Value("rolling", bool, "a truck that was in place moves now, without release: stop loading",
          lambda s: s.visit.rolling),
    Value("released", bool, "the PLC has released the truck, which has not left yet", lambda s: s.visit.released),
    Value("phase", VisitPhase, "phase of the visit: a name of VisitPhase (docs/registers.md); for people",
          lambda s: s.visit.phase),
    Value("reason", Reason, "why `stop` is on", lambda s: s.reason),
    Value("d", bool, "D(t), equation 14", lambda s: s.d, "unknowable"),
    Value("u_px", float, "marker centre, to the right", _circle(lambda c: c.u_px), _UNLESS_GOOD, _marker),
    Value("v_px", float, "marker centre, downwards", _circle(lambda c: c.v_px), _UNLESS_GOOD, _marker),
    Value("radius_px", float, "marker radius R", _circle(lambda c: c.radius_px), _UNLESS_GOOD, _marker),
    Value("distance_mm", float, "distance Z from the ranger", lambda s: s.range.distance_mm, "range is not GOOD",
          _ranger),
    Value("z_vision_mm", float, "distance seen by the camera", lambda s: s.z_vision_mm,
          "vision is not GOOD, or not configured", _marker),
    Value("vision.quality", Quality, "may the marker's values be used; else why not", lambda s: s.vision.quality),
    Value("vision.age_ms", float, "of the newest frame or fault", lambda s: _age_ms(s, s.vision), "nothing received"),
    Value("vision.age_proof", AgeProof, "what proves that age", lambda s: s.vision.age_proof if s.running else None,
          "no frame, or a stale one"),
    Value("range.quality", Quality, "may the distance be used; else why not", lambda s: s.range.quality),
    Value("range.age_ms", float, "of the newest distance or fault", lambda s: _age_ms(s, s.range), "nothing received"),
    *(row for n in range(3) for row in _ranger_rows(n)),
    Value("rangers.status", int, "of several rangers, one bit each (register rangers)", _rangers_status,
          "one ranger"),
    Value("heartbeat", int, "+1 with every tick of fusion", lambda s: s.heartbeat),
    Value("frame_id", int, "of the newest observation of the camera", lambda s: s.vision.frame_id),
    Value("x_n", float, "normalised coordinate, equation 11", lambda s: s.vision.x_n, "without intrinsics", _marker),
    Value("y_n", float, "normalised coordinate, equation 11", lambda s: s.vision.y_n, "without intrinsics", _marker),
    Value("tracking", Tracking, "how the position was obtained", lambda s: s.vision.tracking, "no fresh frame", _frame),
    Value("confidence", float, "of the detection, 0 to 1", lambda s: s.vision.confidence,
          "vision is not GOOD, or the method gives none", _marker),
    Value("visible", float, "share of the rim seen, 0 to 1", lambda s: s.vision.visible,
          _UNLESS_GOOD + ", or not known", _marker),
    Value("frames_summed", int, "frames whose sum shows the marker; 1: a single one shows it",
          lambda s: s.vision.frames, _UNLESS_GOOD, _marker),
    Value("semi_minor_px", float, "of the rim's ellipse", _ellipse(lambda e: e.semi_minor_px),
          _UNLESS_GOOD + ", or not fitted", _marker),
    Value("tilt_deg", float, "of the disc against the line of sight", _ellipse(lambda e: e.tilt_deg),
          "as semi_minor_px", _marker),
    Value("predicted.u_px", float, "px from the left", _predicted(lambda c: c.u_px), "vision is not COASTED", _coasted),
    Value("predicted.v_px", float, "px from the top", _predicted(lambda c: c.v_px), "vision is not COASTED", _coasted),
    Value("predicted.radius_px", float, "radius", _predicted(lambda c: c.radius_px), "vision is not COASTED", _coasted),
    Value("in_place_ms", float, "since it is in place, without a break",
          lambda s: _ms(s, s.visit.in_place_since_ns if s.in_place else None), "it is not"),
    Value("held_ms", float, "since the marker was covered, in place",
          lambda s: _ms(s, s.visit.covered_since_ns if s.visit.held else None), "it is not held"),
    Value("scale.px_mm", float, "median of R x Z over the visits, px mm", _scale(lambda m: m.px_mm), "not learned yet"),
    Value("scale.spread", float, "largest minus smallest, as a share of px_mm", _scale(lambda m: m.spread),
          "not learned yet"),
    Value("scale.visits", int, "trucks in place that it was learned from, the newest 60 at most",
          _scale(lambda m: m.visits), "not learned yet"),
    Value("scale.jump", float, "how much the newest differs from those before, as a share", _scale(lambda m: m.jump),
          "by no more than a tenth"),
    Value("marker.visible", float, "share of the rim seen, 0 to 1, median of the newest 10 visits",
          _marker_wear(lambda w: w.visible.value), _FEW),
    Value("marker.visible_a_day", float, "its change a day over the last weeks",
          _marker_wear(lambda w: w.visible.per_day), "none that is certain"),
    Value("marker.contrast", float, "fall of redness across the rim, log units, likewise",
          _marker_wear(lambda w: w.contrast.value), _FEW),
    Value("marker.contrast_a_day", float, "its change a day", _marker_wear(lambda w: w.contrast.per_day),
          "none that is certain"),
    Value("marker.days_left", float, "until one of the two is below its limit; 0: it is",
          _marker_wear(lambda w: w.days_left), "none within 90 days"),
    Value("marker.worn", bool, "clean or repaint the markers (alarm marker_worn)", _marker_wear(lambda w: w.worn),
          _FEW),
    Value("picture.brightness", float, "mean grey level, share of white", _picture(lambda p: p.brightness),
          "no fresh picture", _frame),
    Value("picture.clipped", float, "share of the pixels that are burnt out", _picture(lambda p: p.clipped),
          "no fresh picture", _frame),
    Value("picture.contrast", float, "from the 5th to the 95th percentile of grey levels",
          _picture(lambda p: p.contrast), "no fresh picture", _frame),
    Value("picture.sharpness", float, "of the strongest edges, 0.6 in focus", _picture(lambda p: p.sharpness),
          "too few edges", _frame),
    Value("picture.veil", float, "share of dust or haze over the picture", _picture(lambda p: p.veil),
          "too dark to measure", _frame),
    Value("picture.veil_proven", float, "up to this veil the bay was shown to be reliable",
          _picture(lambda p: p.veil_proven), "not shown", _frame),
    Value("picture.shift_px", float, "how far the fixed background has moved", _picture(lambda p: p.shift_px),
          "hidden, or not learned", _frame),
    Value("picture.status", int, "what is wrong with it, one bit each (register picture_status)",
          _picture(lambda p: p.status), "no fresh picture", _frame),
    Value("picture.faults", tuple, "what is wrong for some time now; empty: nothing",
          _picture(lambda p: tuple(fault.name for fault in p.faults)), "no fresh picture", _frame),
    Value("exposure.state", ExposureState, "of a camera whose exposure the gateway controls",
          _exposure(lambda e: e.state), "left to the camera"),
    Value("exposure.time_ms", float, "exposure time", _exposure(lambda e: e.time_ms), "the camera can't be set"),
    Value("exposure.gain_db", float, "its gain", _exposure(lambda e: e.gain_db), "not controlled"),
    Value("beacon.status", BeaconStatus, "do the pictures show the beacon's code?", lambda s: s.beacon.status or None,
          "no beacon is configured"),
    Value("beacon.latency_ms", float, "from the LED's light to the state, by the beacon",
          lambda s: None if s.beacon.latency_ns is None else s.beacon.latency_ns / NS_PER_MS, "not found"),
    Value("relay.commanded", RelayOutput, "output of the ranger's board that is to be on",
          _relay(lambda r: r.commanded), _NO_RELAY),
    Value("relay.in_place", bool, "the pin of this output is high, read back",
          _relay(lambda r: bool(r.pins & RelayOutput.IN_PLACE)), _NO_RELAY),
    Value("relay.may_move", bool, "likewise", _relay(lambda r: bool(r.pins & RelayOutput.MAY_MOVE)), _NO_RELAY),
    Value("relay.fault", bool, "pins and command differ for too long", _relay(lambda r: r.fault), _NO_RELAY),
    Value("ne107", Ne107, "NAMUR NE 107: the signal that counts most", ne107.status),
    Value("ne107.active", tuple, "every signal that holds, by name", _signals),
    Value("guidance", GuidanceCode, "instruction for the driver", lambda s: s.guidance.code),
    Value("guidance.amount_mm", float, "distance of the instruction", lambda s: s.guidance.amount_mm, _NOT_KNOWN),
    Value("guidance.offset_u_px", float, "marker minus aim point, to the right; where configured",
          lambda s: s.guidance.offset_u_px, "no marker or no aim"),
    Value("guidance.offset_v_px", float, "marker minus aim point, downwards; where configured",
          lambda s: s.guidance.offset_v_px, "no marker or no aim"),
    Value("guidance.offset_mm", float, "offset_u_px at the marker's distance", lambda s: s.guidance.offset_mm,
          "size not known"),
    Value("guidance.closing_mm_s", float, "positive: the truck approaches", lambda s: s.guidance.closing_mm_s,
          _NOT_KNOWN),
    Value("guidance.to_go_mm", float, "until D = 1; negative: past it", lambda s: s.guidance.to_go_mm, _NOT_KNOWN),
    Value("drive.enable", bool, "the drive may run at the setpoint", lambda s: s.setpoint.enable),
    Value("drive.state", DriveState, "how far the approach is", lambda s: s.setpoint.state or None, _NO_DRIVE),
    Value("drive.speed_setpoint_mm_s", float, "speed for the drive, towards the spout positive; 0: stand",
          lambda s: s.setpoint.speed_mm_s),
    Value("drive.stopping_mm", float, "way until standstill, at worst", lambda s: s.setpoint.stopping_mm,
          f"not known, or {_NO_DRIVE}"),
    Value("pose.x_mm", float, "marker's centre minus its place, to the picture's right", _pose(lambda p: p.x_mm),
          "not configured, or a sensor is not GOOD"),
    Value("pose.y_mm", float, "likewise, downwards", _pose(lambda p: p.y_mm), "as pose.x_mm"),
    Value("pose.z_mm", float, "likewise, away from the camera; positive: to go", _pose(lambda p: p.z_mm),
          "as pose.x_mm"),
    Value("pose.x_sd_mm", float, "standard deviation of x", _pose(lambda p: p.x_sd_mm), "as pose.x_mm"),
    Value("pose.y_sd_mm", float, "standard deviation of y", _pose(lambda p: p.y_sd_mm), "as pose.x_mm"),
    Value("pose.z_sd_mm", float, "standard deviation of z", _pose(lambda p: p.z_sd_mm), "as pose.x_mm"),
    Value("plc.link", PlcLink, "of the PLC's heartbeat: UNUSED, WAITING, ALIVE, LOST", lambda s: s.plc.link),
    Value("plc.age_ms", float, "since its heartbeat last changed", _plc_age_ms, "never received"),
    Value("plc.heartbeat", int, "as the PLC has written it last", lambda s: s.plc.heartbeat),
    Value("plc.control", int, "as the PLC has written it last", lambda s: s.plc.control),
    Value("plc.stop_latched", bool, "stop by D stays until a reset", lambda s: s.memory.latched),
    Value("plc.recipe", int, "id of the recipe in force; 0: the configuration as it is", lambda s: s.plc.recipe),
    Value("plc.acquisition_id", int, "number of the newest accepted trigger; 0: none", lambda s: s.plc.acquisition),
    Value("plc.results_valid", bool, "the result of acquisition_id is held for the PLC",
          lambda s: s.plc.phase is TriggerPhase.VALID),
    Value("plc.writes", int, "writes accepted since the start of the gateway", lambda s: s.plc.writes),
    Value("plc.write_conflicts", int, "writes refused since then because another PLC owns the block",
          lambda s: s.plc.conflicts),
    Value("sensors_disagree", bool, "camera and ranger contradict each other", lambda s: s.memory.disagree),
    Value("function_check", FunctionCheck, "is a technician at work?", lambda s: s.function_check),
    Value("rates.vision_hz", float, "vision results a second", lambda s: s.vision.stats.rate_hz),
    Value("rates.range_hz", float, "distances a second", lambda s: s.range.stats.rate_hz),
    Value("rates.vision_latency_ms", float, "capture to result, newest frame", lambda s: s.vision.stats.latency_ms),
    Value("counters.frames", int, "vision results", lambda s: s.vision.stats.frames),
    Value("counters.frames_skipped", int, "frames skipped: replaced by a newer one, or damaged",
          lambda s: s.vision.stats.skipped),
    Value("counters.frames_lost", int, "frames that ended with their process", lambda s: s.vision.stats.lost),
    Value("counters.vision_restarts", int, "vision processes replaced", lambda s: s.vision.stats.restarts),
    Value("counters.camera_reopens", int, "camera opened again", lambda s: s.vision.stats.reopens),
    Value("counters.range_lines", int, "good measurement lines", lambda s: s.range.stats.lines),
    Value("counters.range_damaged", int, "damaged lines from the ranger, dropped", lambda s: s.range.stats.damaged),
    Value("counters.range_gaps", int, "ranger measurements missing by their number", lambda s: s.range.stats.gaps),
    Value("counters.range_rejected", int, "ranger readings held back by the glitch gate",
          lambda s: s.range.stats.rejected),
    Value("counters.ranger_reopens", int, "ranger's port opened again", lambda s: s.range.stats.reopens),
)  # fmt: skip
BAY_VALUES = by_name(ROWS, TEXTS)
