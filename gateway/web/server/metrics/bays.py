"""The families with one row for every bay. Pure."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum

from gateway.clock import NS_PER_S
from gateway.config import BayConfig
from gateway.core.detection import Tracking
from gateway.core.ne107 import Ne107, status
from gateway.core.plc import PlcLink
from gateway.core.readings import FRESH_FRAME, PictureFault, PictureHealth, Quality
from gateway.core.scale import MarkerScale
from gateway.core.state import FunctionCheck, GuidanceCode, Moved, Reason, StateVector, VisitPhase
from gateway.web.server.gateway_client import BayReport
from gateway.web.server.metrics.family import Family, Labelled, MetricsSource, Value

MM_PER_M = 1000.0


@dataclass(frozen=True, slots=True)
class BayMetrics:
    """One bay of which something is known."""

    config: BayConfig
    report: BayReport
    now_ns: int

    @property
    def state(self) -> StateVector:
        return self.report.now.state


def _bays(source: MetricsSource) -> Iterator[BayMetrics]:
    now_ns = source.client.clock.now_ns()
    for config in source.client.about.config.bays:
        if (report := source.client.report(config.name)) is not None:
            yield BayMetrics(config, report, now_ns)


def _of_bays(read: Callable[[BayMetrics], Value]) -> Callable[[MetricsSource], Iterator[Labelled]]:
    return lambda source: (((bay.config.name,), read(bay)) for bay in _bays(source))


def _gauge(name: str, help: str, read: Callable[[BayMetrics], Value]) -> Family:
    return Family(f"bay_{name}", "gauge", help, _of_bays(read), ("bay",))


def _counter(name: str, help: str, read: Callable[[StateVector], int]) -> Family:
    return Family(f"bay_{name}", "counter", help, _of_bays(lambda bay: read(bay.state)), ("bay",))


def _states(name: str, help: str, kinds: type[Enum], read: Callable[[StateVector], Enum | None]) -> Family:
    """`read` None: nothing is known, so no state is 1."""
    states = tuple(kind.name.lower() for kind in kinds)

    def place(bay: BayMetrics) -> Value:
        found = read(bay.state)
        return -1 if found is None else states.index(found.name.lower())

    return Family(f"bay_{name}", "state set", help, _of_bays(place), ("bay",), states)


def _seconds(bay: BayMetrics, t_ns: int, *, source: bool = True) -> Value:
    return max(0, bay.now_ns - t_ns) / NS_PER_S if source else None


def _meters(number_mm: float | None) -> Value:
    return None if number_mm is None else number_mm / MM_PER_M


def _scale(bay: BayMetrics, read: Callable[[MarkerScale], Value]) -> Value:
    return None if bay.state.memory.scale is None else read(bay.state.memory.scale)


def _circle(bay: BayMetrics, axis: str) -> Value:
    circle = bay.state.vision.circle if bay.state.vision.quality is Quality.GOOD else None
    return None if circle is None else getattr(circle, axis)


def _picture(read: Callable[[PictureHealth], Value]) -> Callable[[BayMetrics], Value]:
    return lambda bay: None if (health := bay.state.picture) is None else read(health)


def _picture_faults(source: MetricsSource) -> Iterator[Labelled]:
    for bay in _bays(source):
        if (health := bay.state.picture) is not None:
            for fault in PictureFault:
                yield (bay.config.name, fault.name.lower()), int(fault in health.faults)


BAYS: tuple[Family, ...] = (
    _gauge("stop", "1: stop is on", lambda b: b.state.stop),
    _gauge("may_move", "1: the truck may move", lambda b: b.state.may_move),
    _gauge("in_place", "1: the truck is in place, the only condition for loading", lambda b: b.state.in_place),
    _gauge("in_place_held", "1: in place by the ranger alone", lambda b: b.state.visit.held),
    _gauge("truck_rolling", "1: a truck that was in place moves now, without release", lambda b: b.state.visit.rolling),
    _states("moved", "since it was in place, has the truck moved?", Moved, lambda s: s.visit.moved),
    _states("visit_phase", "phase of the visit", VisitPhase, lambda s: s.visit.phase),
    _gauge("decision", "D of equation 14; no sample: unknowable", lambda b: b.state.d),
    _gauge("stop_latched", "1: stop is latched", lambda b: b.state.memory.latched),
    _gauge("sensors_disagree", "1: camera and ranger contradict each other", lambda b: b.state.memory.disagree),
    _states("reason", "why stop is on", Reason, lambda s: s.reason),
    _states("vision_quality", "of the camera's reading", Quality, lambda s: s.vision.quality),
    _states("range_quality", "of the ranger's reading", Quality, lambda s: s.range.quality),
    _states("tracking", "how the position was obtained", Tracking,
            lambda s: s.vision.tracking if s.vision.quality in FRESH_FRAME else None),
    _states("ne107", "NAMUR NE 107: the signal that counts most", Ne107, status),
    _states("guidance", "the guidance to the driver", GuidanceCode, lambda s: s.guidance.code),
    _states("plc_link", "does the PLC live?", PlcLink, lambda s: s.plc.link),
    _states("function_check", "is a technician at work?", FunctionCheck, lambda s: s.function_check),
    _gauge("radius_pixels", "R, the marker's radius", lambda b: _circle(b, "radius_px")),
    _gauge("radius_threshold_pixels", "R_th of the configuration", lambda b: b.config.fusion.radius_threshold_px),
    _gauge("center_u_pixels", "the marker's centre, to the right", lambda b: _circle(b, "u_px")),
    _gauge("center_v_pixels", "the marker's centre, downwards", lambda b: _circle(b, "v_px")),
    _gauge("distance_meters", "Z, the ranger's distance", lambda b: _meters(b.state.range.distance_mm)),
    _gauge("distance_threshold_meters", "Z_th of the configuration",
           lambda b: _meters(b.config.fusion.distance_threshold_mm)),
    _gauge("vision_distance_meters", "distance as the camera sees it", lambda b: _meters(b.state.z_vision_mm)),
    _gauge("scale_pixel_meters", "learned R x Z; no sample: not learned yet",
           lambda b: _scale(b, lambda scale: scale.px_mm / MM_PER_M)),
    _gauge("scale_spread_ratio", "largest minus smallest of it, as a share", lambda b: _scale(b, lambda s: s.spread)),
    _gauge("scale_visits", "trucks in place that it was learned from", lambda b: _scale(b, lambda s: s.visits)),
    _gauge("scale_jump_ratio", "how much the newest visit differs; no sample: by no more than a tenth",
           lambda b: _scale(b, lambda s: s.jump)),
    _gauge("to_go_meters", "until D = 1; negative: past it", lambda b: _meters(b.state.guidance.to_go_mm)),
    _gauge("closing_speed_meters_per_second", "positive: the truck approaches",
           lambda b: _meters(b.state.guidance.closing_mm_s)),
    _gauge("picture_brightness_ratio", "mean grey level of the picture, of white; no sample: no fresh picture",
           _picture(lambda p: p.brightness)),
    _gauge("picture_clipped_ratio", "share of the pixels that are burnt out", _picture(lambda p: p.clipped)),
    _gauge("picture_contrast_ratio", "share of the grey levels in use", _picture(lambda p: p.contrast)),
    _gauge("picture_sharpness_ratio", "of the strongest edges, 0.6 in focus", _picture(lambda p: p.sharpness)),
    _gauge("picture_veil_ratio", "share of dust or haze over the picture", _picture(lambda p: p.veil)),
    _gauge("picture_veil_proven_ratio", "up to this veil the bay was shown to be reliable",
           _picture(lambda p: p.veil_proven)),
    _gauge("picture_shift_pixels", "how far the fixed background has moved", _picture(lambda p: p.shift_px)),
    _gauge("camera_exposure_seconds", 'exposure time, with camera.exposure = "marker"; no sample: left to the camera',
           lambda b: None if (e := b.state.exposure) is None or e.time_ms is None else e.time_ms / 1000),
    _gauge("camera_gain_decibels", "its gain, likewise; no sample: not controlled",
           lambda b: None if (e := b.state.exposure) is None else e.gain_db),
    Family("bay_picture_fault", "gauge", "1: this is wrong with the picture itself", _picture_faults,
           ("bay", "fault")),
    _gauge("state_age_seconds", "of what is reported here of the bay", lambda b: _seconds(b, b.state.t_ns)),
    _gauge("vision_age_seconds", "of the newest frame or fault",
           lambda b: _seconds(b, b.state.vision.t_ns, source=b.state.vision.quality is not Quality.WAITING)),
    _gauge("range_age_seconds", "of the newest distance or fault",
           lambda b: _seconds(b, b.state.range.t_ns, source=b.state.range.quality is not Quality.WAITING)),
    _gauge("plc_heartbeat_age_seconds", "since the PLC's heartbeat changed; no sample: never received",
           lambda b: _seconds(b, b.state.plc.beat_ns, source=b.state.plc.link in (PlcLink.ALIVE, PlcLink.LOST))),
    _gauge("vision_rate_hertz", "vision results a second", lambda b: b.state.vision.stats.rate_hz),
    _gauge("range_rate_hertz", "distances a second", lambda b: b.state.range.stats.rate_hz),
    _counter("ticks", "of fusion; they must go on", lambda s: s.heartbeat),
    _counter("frames", "vision results", lambda s: s.vision.stats.frames),
    _counter("frames_skipped", "frames replaced by newer ones, or damaged", lambda s: s.vision.stats.skipped),
    _counter("frames_lost", "frames that ended with their process", lambda s: s.vision.stats.lost),
    _counter("vision_restarts", "vision processes replaced", lambda s: s.vision.stats.restarts),
    _counter("camera_reopens", "camera opened again", lambda s: s.vision.stats.reopens),
    _counter("range_lines", "good measurement lines", lambda s: s.range.stats.lines),
    _counter("range_lines_damaged", "lines dropped", lambda s: s.range.stats.damaged),
    _counter("range_gaps", "measurements missing by their number", lambda s: s.range.stats.gaps),
    _counter("range_rejected", "readings held back by the glitch gate", lambda s: s.range.stats.rejected),
    _counter("ranger_reopens", "ranger opened again", lambda s: s.range.stats.reopens),
    _counter("plc_writes", "writes of the PLC that were taken", lambda s: s.plc.writes),
    _counter("plc_write_conflicts", "writes refused because another PLC owns the block", lambda s: s.plc.conflicts),
)  # fmt: skip
