"""One TOML file, checked strictly: an unknown key or a value out of range is an error that names its place.

Top-level `[camera] [vision] [ranger] [fusion]` hold for every bay; a `[[bays]]` entry overrides what differs. Without
any `[[bays]]` there is one bay, `bay1`. The sections are in gateway/config/sections.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from gateway.config.sections.camera_controls import ControlsConfig
from gateway.config.sections.common import Reconnect
from gateway.config.sections.drive import DriveConfig, RecipeDrive
from gateway.config.sections.fusion import (
    CrossCheck,
    FusionConfig,
    GuidanceConfig,
    RecipeConfig,
    RecipeFusion,
    RecipeGuidance,
    VisitConfig,
)
from gateway.config.sections.hmi import HmiConfig, HmiUser
from gateway.config.sections.modbus import HandshakeConfig, ModbusConfig, TlsConfig
from gateway.config.sections.mqtt import MqttConfig, MqttTls, SparkplugConfig
from gateway.config.sections.opcua import OpcuaConfig
from gateway.config.sections.ranger import BayRangerConfig, RangerConfig, with_own_sections
from gateway.config.sections.records import RecordsConfig
from gateway.config.sections.vision import (
    BeaconConfig,
    CameraConfig,
    CropConfig,
    GigeConfig,
    Intrinsics,
    PictureConfig,
    VisionConfig,
)
from gateway.config.strict import forms
from gateway.config.strict.errors import FaultsError, FieldError, faults_of
from gateway.config.strict.section import Section
from gateway.config.strict.toml_file import merge, read_toml

__all__ = [
    "SHARED_SECTIONS",
    "BayConfig",
    "BayRangerConfig",
    "BeaconConfig",
    "CameraConfig",
    "ControlsConfig",
    "CropConfig",
    "CrossCheck",
    "DriveConfig",
    "FusionConfig",
    "GatewayConfig",
    "GigeConfig",
    "GuidanceConfig",
    "HandshakeConfig",
    "HmiConfig",
    "HmiUser",
    "Intrinsics",
    "ModbusConfig",
    "MqttConfig",
    "MqttTls",
    "OpcuaConfig",
    "PictureConfig",
    "RangerConfig",
    "RecipeConfig",
    "RecipeDrive",
    "RecipeFusion",
    "RecipeGuidance",
    "Reconnect",
    "RecordsConfig",
    "SparkplugConfig",
    "TlsConfig",
    "VisionConfig",
    "VisitConfig",
    "load",
    "parse",
]

Name = Annotated[str, Field(pattern=forms.NAME)]
RELAY_PERIOD_S = 0.025
"""The ranger's relay is renewed from a decision of the last 50 ms: two ticks."""
SHARED_SECTIONS = ("camera", "vision", "ranger", "fusion", "guidance", "visit", "drive")


class BayConfig(Section):
    name: Name = Field("bay1", description="in topics and events")
    title: str = Field("", max_length=64, description="beside the name on the pages, for people only")
    unit_id: int = Field(1, ge=1, le=247, description="Modbus unit id")
    camera: CameraConfig = Field(default_factory=CameraConfig)
    vision: VisionConfig = Field(default_factory=VisionConfig)
    ranger: BayRangerConfig = Field(default_factory=BayRangerConfig)
    fusion: FusionConfig = Field(default_factory=FusionConfig)
    guidance: GuidanceConfig = Field(default_factory=GuidanceConfig)
    visit: VisitConfig = Field(default_factory=VisitConfig)
    drive: DriveConfig | None = Field(None, description="absent: no setpoint for a drive")

    @model_validator(mode="after")
    def _leaves_beyond_the_threshold(self) -> Self:
        least_mm = self.fusion.distance_threshold_mm + self.fusion.distance_hysteresis_mm + self.visit.band_mm
        if self.visit.leave_distance_mm is not None and self.visit.leave_distance_mm < least_mm:
            raise FieldError(
                f"must be at least {least_mm:g} mm: Z_th, its hysteresis and visit.band_mm",
                "visit",
                "leave_distance_mm",
            )
        return self

    @model_validator(mode="after")
    def _rangers_notice_what_moves(self) -> Self:
        if self.ranger.more and self.ranger.agree_mm > self.visit.band_mm:
            raise FieldError(
                f"must be at most visit.band_mm, {self.visit.band_mm:g}: else a truck could leave its place by one of "
                "them and stand by another",
                "ranger",
                "agree_mm",
            )
        return self

    @model_validator(mode="after")
    def _drive_stops_in_time(self) -> Self:
        if self.drive is not None:
            self._sees_a_wrong_distance(self.fusion.distance_threshold_mm, "fusion", "cross_check")
            for key, what in self.drive.faults(self.guidance.overshoot_mm, self.fusion.range_deadline_s):
                raise FieldError(what, "drive", key)
        return self

    def _sees_a_wrong_distance(self, threshold_mm: float, *place: str | int) -> None:
        """By the ranger alone, one that hears something else would let the drive run past the mark."""
        check, overshoot_mm = self.fusion.cross_check, self.guidance.overshoot_mm
        if check is None:
            raise FieldError("is needed with [drive]: nothing else finds a ranger that hears something else", *place)
        if (tolerance_mm := check.tolerance_at(threshold_mm)) >= overshoot_mm:
            raise FieldError(
                f"with [drive], tolerance_mm and tolerance_share at Z_th, {tolerance_mm:g} mm, must be less than "
                f"guidance.overshoot_mm, {overshoot_mm:g}",
                *place,
            )

    @model_validator(mode="after")
    def _decides_in_time(self) -> Self:
        if self.ranger.has_relay and self.fusion.period_s > RELAY_PERIOD_S:
            raise FieldError(f"must be {RELAY_PERIOD_S:g} s at most with ranger.hcsr04.relay", "fusion", "period_s")
        return self

    @model_validator(mode="after")
    def _beacon_blinks(self) -> Self:
        if self.camera.beacon is not None and not self.ranger.has_beacon:
            raise FieldError('needs ranger.type = "hcsr04" and ranger.hcsr04.beacon = true', "camera", "beacon")
        return self

    @model_validator(mode="after")
    def _one_picture_size(self) -> Self:
        lens = self.vision.intrinsics
        camera = self.camera
        what = (
            "camera.{}" if camera.crop is None and not camera.rotation_deg else "{} after camera.crop and rotation_deg"
        )
        for key, asked in zip(("width_px", "height_px"), camera.picture_px, strict=True):
            held = None if lens is None else getattr(lens, key)
            if None not in (asked, held) and asked != held:
                raise FieldError(f"{what.format(key)} is {asked}: other intrinsics", "vision", "intrinsics", key)
        return self


class GatewayConfig(Section):
    site: Name = Field("site1", description="in topics")
    instance: Name = Field("gateway", description="distinguishes two gateways on one machine")
    log_level: Literal["debug", "info", "warning", "error"] = Field(
        "info", description="lines below it are not written; debug: repeated lines are written, too"
    )
    log_format: Literal["text", "json"] = Field(
        "text", description="json: one object a line, with UTC, bay, R, Z and reason (docs/operations.md)"
    )
    state_dir: str = Field(
        "auto",
        description="folder of the bay files, which keep what outlives a restart: a function check, the learned R x Z, "
        "a truck in place; "
        "auto: the folder of `StateDirectory=` under systemd, else ~/.local/state/loading-gateway, and for root or a "
        "user without a home /var/lib/loading-gateway; empty: nothing is kept",
    )
    initial_function_check: bool = Field(
        default=False,
        description="a bay of which state_dir keeps no file, because it has never run, begins with a function check: "
        "may_move and in_place stay off until a technician ends it",
    )
    modbus: ModbusConfig = Field(default_factory=ModbusConfig)
    mqtt: MqttConfig | None = None
    opcua: OpcuaConfig | None = Field(None, description="absent: no OPC UA server")
    sinks: dict[str, dict[str, Any]] = Field(
        default_factory=dict,
        description="tables `[sinks.<name>]`, one for each further sink (docs/extending.md); the sink checks its keys",
    )
    hmi: HmiConfig = Field(default_factory=HmiConfig)
    records: RecordsConfig = Field(default_factory=RecordsConfig)
    recipes: tuple[RecipeConfig, ...] = Field((), max_length=1000, description="thresholds that the PLC may select")
    bays: tuple[BayConfig, ...] = Field(default_factory=lambda: (BayConfig(),), min_length=1, max_length=64)

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        for key in ("name", "unit_id"):
            seen: set[str | int] = set()
            for n, bay in enumerate(self.bays):
                value = getattr(bay, key)
                folded = value.lower() if isinstance(value, str) else value  # `Bay1` beside `bay1` is a trap
                if folded in seen:
                    raise FieldError(f"an earlier bay has the {key} {value}, too", "bays", n, key)
                seen.add(folded)
        ids: set[int] = set()
        for n, recipe in enumerate(self.recipes):
            if recipe.id in ids:
                raise FieldError(f"an earlier recipe has the id {recipe.id}, too", "recipes", n, "id")
            ids.add(recipe.id)
        return self

    @model_validator(mode="after")
    def _recipes_stop_in_time(self) -> Self:
        for bay in self.bays:
            for n, recipe in enumerate(self.recipes):
                drive = bay.drive and recipe.drive.of(bay.drive)
                if drive is not None and (threshold_mm := recipe.fusion.distance_threshold_mm) is not None:
                    bay._sees_a_wrong_distance(threshold_mm, "recipes", n, "fusion", "distance_threshold_mm")
                for key, what in drive.faults(bay.guidance.overshoot_mm, bay.fusion.range_deadline_s) if drive else ():
                    raise FieldError(f"{what} (with [drive] of bay {bay.name!r})", "recipes", n, "drive", key)
        return self

    @model_validator(mode="after")
    def _keeps_its_certificate(self) -> Self:
        if self.hmi.own_certificate and not self.state_dir:
            raise FieldError('"auto" needs state_dir, where the certificate is kept', "hmi", "tls_cert")
        return self


def load(path: Path, overrides: Mapping[str, Any] | None = None) -> GatewayConfig:
    """Read and check one TOML file; `overrides` (from the command line) are merged over it.

    Raises ConfigError where it can't be read, FaultsError with one line per fault: `file:line: key = value: what is
    wrong and what is allowed`.
    """
    data, text = read_toml(path)
    return parse(merge(data, overrides or {}), source=str(path), text=text)


def parse(data: Mapping[str, Any], *, source: str = "config", text: str = "") -> GatewayConfig:
    """Check a parsed document. `text` is its TOML, for line numbers. Raises FaultsError."""
    try:
        return GatewayConfig.model_validate(_with_shared_sections(data))
    except ValidationError as error:
        faults = faults_of(error, source=source, text=text, model=GatewayConfig, shared=SHARED_SECTIONS)
    raise FaultsError(faults)  # outside `except`: the checker's error quotes passwords, so it is not chained


def _with_own_sections(table: Mapping[str, Any]) -> Mapping[str, Any]:
    """Before bays are merged: a bay's own value counts, wherever it is written."""
    return {**table, "ranger": with_own_sections(table["ranger"])} if "ranger" in table else table


def _with_shared_sections(data: Mapping[str, Any]) -> dict[str, Any]:
    """Push the shared sections down into every bay."""
    rest = {key: value for key, value in data.items() if key not in SHARED_SECTIONS}
    shared = {key: data[key] for key in SHARED_SECTIONS if key in data}
    bays = rest.get("bays", [{}])
    if isinstance(bays, list) and all(isinstance(bay, Mapping) for bay in bays):
        rest["bays"] = [merge(_with_own_sections(shared), _with_own_sections(bay)) for bay in bays]
    return rest
