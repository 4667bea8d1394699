"""The families with one row for every bay. Pure."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import partial

from gateway.config import BayConfig
from gateway.core.plc import PlcLink
from gateway.core.readings import PictureFault, Quality
from gateway.core.state import StateVector
from gateway.durations import NS_PER_S
from gateway.values.bay_values import BAY_VALUES
from gateway.values.value import Value as Shown
from gateway.web.server.gateway_client import BayReport
from gateway.web.server.metrics.family import Family, Form, Labelled, MetricsSource, Value

IN_THOUSANDTHS = ("mm", "mm/s", "ms", "px mm")  # of a base unit of Prometheus


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


def _shown(form: Form, picked: Mapping[str, str]) -> Iterator[Family]:
    """Families by the values that they show, in base units; an enumeration is a state set."""
    for family, name in picked.items():
        row = BAY_VALUES[name]
        words = f"{row.meaning}; no sample: {row.null}" if row.null else row.meaning
        if row.kind is bool:
            words = f"1: {words}"
        states = tuple(code.name.lower() for code in row.kind) if issubclass(row.kind, Enum) else ()
        read = partial(_read, row, 1000 if row.unit in IN_THOUSANDTHS else 1)
        yield Family(f"bay_{family}", "state set" if states else form, words, _of_bays(read), ("bay",), states)


def _read(row: Shown[StateVector], divisor: int, bay: BayMetrics) -> Value:
    """Of an enumeration the place of the state that is 1; where nothing is known, none is."""
    found = row.of(bay.state)
    if issubclass(row.kind, Enum):
        return -1 if found is None else list(row.kind).index(found)
    return None if found is None else found / divisor if divisor > 1 else found


def _own(name: str, help: str, read: Callable[[BayMetrics], Value]) -> Family:
    """A gauge that is not only of the state."""
    return Family(f"bay_{name}", "gauge", help, _of_bays(read), ("bay",))


def _seconds(bay: BayMetrics, t_ns: int, *, source: bool = True) -> Value:
    return max(0, bay.now_ns - t_ns) / NS_PER_S if source else None


def _picture_faults(source: MetricsSource) -> Iterator[Labelled]:
    for bay in _bays(source):
        if (health := bay.state.picture) is not None:
            for fault in PictureFault:
                yield (bay.config.name, fault.name.lower()), int(fault in health.faults)


BAYS: tuple[Family, ...] = (
    *_shown("gauge", {
        "stop": "stop",
        "may_move": "may_move",
        "in_place": "in_place",
        "in_place_held": "held",
        "truck_rolling": "rolling",
        "moved": "moved",
        "visit_phase": "phase",
        "decision": "d",
        "stop_latched": "plc.stop_latched",
        "sensors_disagree": "sensors_disagree",
        "reason": "reason",
        "vision_quality": "vision.quality",
        "range_quality": "range.quality",
        "tracking": "tracking",
        "ne107": "ne107",
        "guidance": "guidance",
        "plc_link": "plc.link",
        "function_check": "function_check",
        "radius_pixels": "radius_px",
        "center_u_pixels": "u_px",
        "center_v_pixels": "v_px",
        "distance_meters": "distance_mm",
        "vision_distance_meters": "z_vision_mm",
        "scale_pixel_meters": "scale.px_mm",
        "scale_spread_ratio": "scale.spread",
        "scale_visits": "scale.visits",
        "scale_jump_ratio": "scale.jump",
        "to_go_meters": "guidance.to_go_mm",
        "closing_speed_meters_per_second": "guidance.closing_mm_s",
        "drive_enable": "drive.enable",
        "drive_state": "drive.state",
        "drive_speed_setpoint_meters_per_second": "drive.speed_setpoint_mm_s",
        "drive_stopping_meters": "drive.stopping_mm",
        "pose_x_meters": "pose.x_mm",
        "pose_y_meters": "pose.y_mm",
        "pose_z_meters": "pose.z_mm",
        "picture_brightness_ratio": "picture.brightness",
        "picture_clipped_ratio": "picture.clipped",
        "picture_contrast_ratio": "picture.contrast",
        "picture_sharpness_ratio": "picture.sharpness",
        "picture_veil_ratio": "picture.veil",
        "picture_veil_proven_ratio": "picture.veil_proven",
        "picture_shift_pixels": "picture.shift_px",
        "camera_exposure_seconds": "exposure.time_ms",
        "camera_gain_decibels": "exposure.gain_db",
        "vision_rate_hertz": "rates.vision_hz",
        "range_rate_hertz": "rates.range_hz",
    }),
    *_shown("counter", {
        "ticks": "heartbeat",
        "frames": "counters.frames",
        "frames_skipped": "counters.frames_skipped",
        "frames_lost": "counters.frames_lost",
        "vision_restarts": "counters.vision_restarts",
        "camera_reopens": "counters.camera_reopens",
        "range_lines": "counters.range_lines",
        "range_lines_damaged": "counters.range_damaged",
        "range_gaps": "counters.range_gaps",
        "range_rejected": "counters.range_rejected",
        "ranger_reopens": "counters.ranger_reopens",
        "plc_writes": "plc.writes",
        "plc_write_conflicts": "plc.write_conflicts",
    }),
    Family("bay_picture_fault", "gauge", "1: this is wrong with the picture itself", _picture_faults,
           ("bay", "fault")),
    _own("radius_threshold_pixels", "R_th of the configuration", lambda b: b.config.fusion.radius_threshold_px),
    _own("distance_threshold_meters", "Z_th of the configuration",
         lambda b: b.config.fusion.distance_threshold_mm / 1000),
    _own("state_age_seconds", "of what is reported here of the bay", lambda b: _seconds(b, b.state.t_ns)),
    _own("vision_age_seconds", "of the newest frame or fault",
         lambda b: _seconds(b, b.state.vision.t_ns, source=b.state.vision.quality is not Quality.WAITING)),
    _own("range_age_seconds", "of the newest distance or fault",
         lambda b: _seconds(b, b.state.range.t_ns, source=b.state.range.quality is not Quality.WAITING)),
    _own("plc_heartbeat_age_seconds", "since the PLC's heartbeat changed; no sample: never received",
         lambda b: _seconds(b, b.state.plc.beat_ns, source=b.state.plc.link in (PlcLink.ALIVE, PlcLink.LOST))),
)  # fmt: skip
