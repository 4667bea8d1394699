"""One TOML file, checked strictly: an unknown key or a value out of range is an error that names where it stands.

Top-level `[camera] [vision] [ranger] [fusion]` hold for every bay; a `[[bays]]` entry overrides what differs. Without
any `[[bays]]` there is one bay, `bay1`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, ValidationError, field_validator, model_validator

from gateway.errors import ConfigError
from gateway.strict.faults import PlacedError, explain
from gateway.strict.network import network
from gateway.strict.section import Section
from gateway.strict.tomlfile import merge, read_toml

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
Hsv = tuple[
    Annotated[int, Field(ge=0, le=180, strict=True)],
    Annotated[int, Field(ge=0, le=255, strict=True)],
    Annotated[int, Field(ge=0, le=255, strict=True)],
]
Network = Annotated[str, AfterValidator(network)]
Cpus = Annotated[tuple[Annotated[int, Field(ge=0, strict=True)], ...], Field(min_length=1)]
SHARED_SECTIONS = ("camera", "vision", "ranger", "fusion", "guidance")


class Reconnect(Section):
    """How a lost link is tried again: exponential backoff with full jitter between the two limits."""

    min_s: float = Field(0.25, ge=0.01, le=60, description="first delay before a lost link is tried again")
    max_s: float = Field(5.0, ge=0.05, le=600, description="longest delay between two tries")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.max_s < self.min_s:
            raise PlacedError(f"max_s = {self.max_s} must be at least min_s = {self.min_s}", "max_s")
        return self


class Intrinsics(Section):
    """Pinhole intrinsics, px, with Brown-Conrady distortion; equation 11."""

    fx: float = Field(gt=0, le=100_000, description="focal length along u, px")
    fy: float = Field(gt=0, le=100_000, description="focal length along v, px")
    cx: float = Field(ge=-10_000, le=100_000, description="principal point, u, px")
    cy: float = Field(ge=-10_000, le=100_000, description="principal point, v, px")
    distortion: tuple[Annotated[float, Field(strict=True)], ...] = Field(
        (), max_length=14, description="k1, k2, p1, p2[, k3, ...] as in OpenCV"
    )

    @field_validator("distortion")
    @classmethod
    def _known_length(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if len(value) not in (0, 4, 5, 8, 12, 14):
            raise ValueError("distortion takes 0, 4, 5, 8, 12 or 14 coefficients")
        return value


class CameraConfig(Section):
    url: str = Field(
        "0",
        min_length=1,
        description="camera index, /dev/video*, video file, image folder, rtsp:// or http:// stream",
    )
    width_px: int | None = Field(None, ge=16, le=16384, description="asked of a camera; default: what it offers")
    height_px: int | None = Field(None, ge=16, le=16384, description="asked of a camera; default: what it offers")
    fps: float | None = Field(None, ge=0.1, le=1000, description="asked of a camera; pace of an image folder")
    pace: Literal["realtime", "fast"] = Field(
        "realtime", description="files: at their own pace, or every frame as fast as vision can"
    )
    loop: bool = Field(False, description="files: begin again at the end instead of reporting a lost source")
    deadline_s: float = Field(1.0, ge=0.05, le=60, description="no frame for so long: the source has stalled")
    frozen_s: float = Field(
        2.0,
        ge=0,
        le=60,
        description="cameras and streams: pictures equal to the last bit for so long are a frozen source; 0: off",
    )
    open_deadline_s: float = Field(10.0, ge=0.5, le=120, description="opening a source may take so long")
    max_megapixels: float = Field(25.0, ge=0.01, le=100, description="a larger frame is refused")
    affinity: Cpus | None = Field(None, description="CPUs the camera process may use")
    reconnect: Reconnect = Field(default_factory=Reconnect)


class VisionConfig(Section):
    """Method, tracking and the parameters of both methods; those of the paper's are its Table I."""

    method: Literal["robust", "paper"] = Field("robust", description="how the marker is found in a picture")
    tracking: bool = Field(
        True,
        description="follow the marker from frame to frame: the same answers, sooner; and say how each was come by",
    )
    coast_s: float = Field(
        0.3,
        ge=0,
        le=10,
        description="a followed marker that is not seen is predicted for so long, then lost; stop is on",
    )
    gaussian_kernel_px: int = Field(5, ge=1, le=31, description="paper: side of the Gaussian kernel, odd; 1: off")
    gaussian_sigma_px: float = Field(0.0, ge=0, le=20, description="paper: 0: derived from the kernel, as OpenCV does")
    red_low_1: Hsv = Field((0, 43, 46), description="paper: threshold 1, lower corner (H 0-180, S, V 0-255)")
    red_high_1: Hsv = Field((10, 255, 255), description="paper: threshold 1, upper corner")
    red_low_2: Hsv = Field((156, 43, 46), description="paper: threshold 2, lower corner")
    red_high_2: Hsv = Field((180, 255, 255), description="paper: threshold 2, upper corner")
    morph_kernel_px: int = Field(3, ge=1, le=31, description="paper: side of the square structuring element, odd")
    morph_iterations: int = Field(2, ge=0, le=10, description="paper: of opening, then of closing; 0: off")
    min_area_px2: float = Field(100.0, ge=0, le=1e8, description="paper: S_min of equation 9")
    min_circularity: float = Field(0.0, ge=0, le=1, description="paper: 4 pi area / perimeter^2 at least; 0: off")
    min_fill: float = Field(0.0, ge=0, le=1, description="paper: area / enclosing circle's area at least; 0: off")
    min_radius_share: float = Field(
        0.012, ge=0.002, le=1, description="robust: smallest radius, as a share of the picture's diagonal"
    )
    max_radius_share: float = Field(0.5, ge=0.002, le=1, description="robust: largest radius, likewise")
    min_confidence: float = Field(
        0.5, ge=0, le=1, description="robust: what is less sure to be a red disc is no marker"
    )
    intrinsics: Intrinsics | None = Field(None, description="for equation 11")
    workers: int = Field(1, ge=1, le=16, description="vision processes for this bay")
    affinity: Cpus | None = Field(None, description="CPUs the vision processes may use")
    deadline_s: float = Field(2.0, ge=0.01, le=60, description="a frame may take so long before its worker is replaced")

    def idle(self) -> tuple[str, ...]:
        """The keys that were set and belong to the other method: they have no effect."""
        other = "robust: " if self.method == "paper" else "paper: "
        fields = type(self).model_fields
        return tuple(
            key for key in fields if key in self.model_fields_set and (fields[key].description or "").startswith(other)
        )

    @field_validator("gaussian_kernel_px", "morph_kernel_px")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            raise ValueError("must be odd")
        return value

    @model_validator(mode="after")
    def _radii(self) -> Self:
        if self.min_radius_share > self.max_radius_share:
            raise PlacedError(f"lies above max_radius_share, {self.max_radius_share:g}", "min_radius_share")
        return self

    @model_validator(mode="after")
    def _corners(self) -> Self:
        for n, low, high in ((1, self.red_low_1, self.red_high_1), (2, self.red_low_2, self.red_high_2)):
            for axis, lo, hi in zip("HSV", low, high, strict=True):
                if lo > hi:
                    raise PlacedError(f"{axis} = {lo} lies above red_high_{n}'s {axis} = {hi}", f"red_low_{n}")
        return self


class RangerConfig(Section):
    port: str = Field(
        "/dev/ttyACM0", min_length=1, description="any pyserial URL: device, socket://host:port, rfc2217://host:port"
    )
    baud: int = Field(9600, ge=300, le=2_000_000, description="9600 in the paper")
    temperature_c: float = Field(20.0, ge=-40, le=85, description="of the air; used unless the ranger measures it")
    temperature_tolerance_c: float = Field(
        40.0, ge=0, le=200, description="a measured temperature farther than this from temperature_c is not believed"
    )
    median: int = Field(3, ge=1, le=15, description="readings in the median filter, odd; 1: off")
    glitch_gate_mm: float = Field(
        150.0, ge=0, le=4000, description="a jump larger than this must be confirmed by a second reading; 0: off"
    )
    reconnect: Reconnect = Field(default_factory=Reconnect)

    @field_validator("median")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            raise ValueError("must be odd")
        return value


class CrossCheck(Section):
    """Z_vision = f r / R compared with the ranger's Z."""

    focal_px: float = Field(gt=0, le=100_000, description="focal length, px")
    marker_radius_mm: float = Field(gt=0, le=10_000, description="true radius of the marker")
    camera_offset_mm: float = Field(0.0, ge=-5000, le=5000, description="camera behind the ranger (+) or before it (-)")
    tolerance_mm: float = Field(50.0, ge=1, le=5000, description="largest difference taken for agreement")
    tolerance_share: float = Field(0.1, ge=0, le=1, description="added to it, as a share of the ranger's Z")
    lasting_s: float = Field(1.0, ge=0, le=60, description="a disagreement must last so long to be a fault")


class FusionConfig(Section):
    """Equation 14 and what surrounds it; the defaults decide exactly as the paper does."""

    radius_threshold_px: float = Field(180.0, gt=0, le=20_000, description="R_th")
    distance_threshold_mm: float = Field(300.0, gt=0, le=4000, description="Z_th; the paper's 30 cm")
    vision_deadline_s: float = Field(0.3, ge=0.02, le=10, description="an older frame is stale")
    range_deadline_s: float = Field(
        0.4, ge=0.02, le=10, description="an older distance is stale; the median makes a good one up to 0.15 s old"
    )
    start_grace_s: float = Field(
        5.0, ge=0.1, le=600, description="a sensor that has sent nothing by then is missing, not starting"
    )
    period_s: float = Field(0.02, ge=0.005, le=1, description="fusion tick: ages, heartbeat, registers")
    fail_safe: bool = Field(
        True, description="stop is on whenever D is unknowable; false: a blind gateway does NOT say stop"
    )
    radius_hysteresis_px: float = Field(0.0, ge=0, le=1000, description="stop ends below R_th minus this")
    distance_hysteresis_mm: float = Field(0.0, ge=0, le=1000, description="stop ends above Z_th plus this")
    raise_debounce_s: float = Field(0.0, ge=0, le=5, description="D must be 1 for so long before stop: it delays stop")
    clear_debounce_s: float = Field(0.0, ge=0, le=60, description="D must be 0 for so long before a stop by D ends")
    latch_stop: bool = Field(
        False, description="a stop by D stays until the PLC resets it or the truck leaves; on at every start"
    )
    latch_leave_s: float = Field(
        5.0, ge=0, le=600, description="no truck to be seen for so long: it has left, the latch ends; 0: never"
    )
    cross_check: CrossCheck | None = Field(None, description="absent: no cross-check")

    @model_validator(mode="after")
    def _ages_in_time(self) -> Self:
        shorter_s = min(self.vision_deadline_s, self.range_deadline_s)
        if self.period_s > shorter_s:  # ages are looked at once a tick: a value would stand after its deadline
            raise PlacedError(f"must not be longer than the shorter deadline, {shorter_s:g} s", "period_s")
        return self


class GuidanceConfig(Section):
    """What the driver is told, and when. Decides nothing: stop and permit come from [fusion]."""

    aim_u_px: float | None = Field(
        None, ge=-20_000, le=20_000, description="where the marker should be, u; absent: no guidance to the side"
    )
    aim_v_px: float | None = Field(None, ge=-20_000, le=20_000, description="where the marker should be, v; shown only")
    tolerance_px: float = Field(20.0, ge=0, le=20_000, description="so far to the side of the aim point is fine")
    mirrored: bool = Field(False, description="the camera faces the driver: its right is the driver's left")
    marker_radius_mm: float | None = Field(
        None, gt=0, le=10_000, description="true radius of the marker, for mm to the side; default: the cross-check's"
    )
    slow_mm: float = Field(500.0, ge=0, le=4000, description="SLOW when no more than this is to go")
    slow_s: float = Field(2.0, ge=0, le=60, description="SLOW when it is to go within this time at the present speed")
    overshoot_mm: float = Field(100.0, ge=1, le=4000, description="so far past the stopping place is TOO_FAR or BACK")
    still_mm_s: float = Field(20.0, gt=0, le=1000, description="a truck slower than this stands still")


class RecipeFusion(Section):
    """What a recipe changes in [fusion]; absent keys stay as they are."""

    radius_threshold_px: float | None = Field(None, gt=0, le=20_000, description="R_th")
    distance_threshold_mm: float | None = Field(None, gt=0, le=4000, description="Z_th")
    radius_hysteresis_px: float | None = Field(None, ge=0, le=1000, description="stop ends below R_th minus this")
    distance_hysteresis_mm: float | None = Field(None, ge=0, le=1000, description="stop ends above Z_th plus this")


class RecipeGuidance(Section):
    """What a recipe changes in [guidance]; absent keys stay as they are."""

    aim_u_px: float | None = Field(None, ge=-20_000, le=20_000, description="where the marker should be, u")
    aim_v_px: float | None = Field(None, ge=-20_000, le=20_000, description="where the marker should be, v")
    tolerance_px: float | None = Field(None, ge=0, le=20_000, description="so far to the side is fine")
    marker_radius_mm: float | None = Field(None, gt=0, le=10_000, description="true radius of the marker")


class RecipeConfig(Section):
    """A named set of thresholds that the PLC selects by its id, for all bays."""

    id: int = Field(ge=1, le=65535, description="what the PLC writes to recipe_select; 0 is the configuration as it is")
    name: str = Field(min_length=1, max_length=64, description="for people")
    fusion: RecipeFusion = Field(default_factory=RecipeFusion)
    guidance: RecipeGuidance = Field(default_factory=RecipeGuidance)


class HandshakeConfig(Section):
    """What the gateway asks of the PLC. In force only with modbus.writes = true."""

    heartbeat_required: bool = Field(
        True, description="no heartbeat from the PLC is a fault: permit off, and stop on (fusion.fail_safe)"
    )
    heartbeat_deadline_s: float = Field(
        1.0, ge=0.05, le=60, description="plc_heartbeat must change at least so often; ten times the PLC's period"
    )
    enable_required: bool = Field(False, description="permit needs the PLC's enable bit")
    truck_required: bool = Field(False, description="permit needs the PLC's truck_present bit")
    trigger_timeout_s: float = Field(1.0, ge=0.05, le=60, description="a triggered measurement may take so long")

    @model_validator(mode="after")
    def _watched(self) -> Self:
        for key in ("enable_required", "truck_required"):
            if getattr(self, key) and not self.heartbeat_required:
                raise PlacedError("needs heartbeat_required: the bit of a dead PLC would stand for ever", key)
        return self


class TlsConfig(Section):
    """Modbus/TCP Security (mbaps): TLS with certificates on both sides, and a role in the client's."""

    port: int = Field(802, ge=0, le=65535, description="802 by the specification; 0 picks a free one")
    cert: str = Field(min_length=1, description="PEM file: the gateway's certificate, then any intermediate ones")
    key: str = Field(min_length=1, description="PEM file: its private key, without a passphrase")
    ca: str = Field(min_length=1, description="PEM file: the authorities whose client certificates are accepted")
    crl: str | None = Field(None, min_length=1, description="PEM file: certificates that were taken back")
    read_roles: tuple[str, ...] = Field(("viewer",), description="roles that may read")
    write_roles: tuple[str, ...] = Field(("operator",), description="roles that may read and write")
    handshake_deadline_s: float = Field(5.0, ge=0.5, le=60, description="a TLS handshake may take so long")


class ModbusConfig(Section):
    host: str = Field("127.0.0.1", min_length=1, description="address to listen on; the PLC's network in a plant")
    port: int = Field(502, ge=0, le=65535, description="0 picks a free one")
    word_order: Literal["big", "little"] = Field("big", description="of 32 and 64 bit values: high word first or last")
    max_connections: int = Field(64, ge=1, le=4096, description="at the same time; the quietest makes room")
    plc_addresses: tuple[Network, ...] = Field(
        (), max_length=64, description="addresses or networks of PLCs: room is kept for them, and being quiet is fine"
    )
    plc_connections: int = Field(8, ge=1, le=1024, description="of max_connections, kept for plc_addresses if any")
    allow: tuple[Network, ...] = Field(
        (), max_length=256, description="addresses or networks that may connect; plc_addresses always may; empty: all"
    )
    idle_timeout_s: float = Field(
        120.0, ge=1, le=86_400, description="a connection asked nothing for so long is closed; not one of plc_addresses"
    )
    frame_timeout_s: float = Field(2.0, ge=0.1, le=60, description="a request begun must be whole within this")
    send_timeout_s: float = Field(5.0, ge=0.1, le=60, description="answers not taken for so long: closed")
    keepalive_s: int = Field(10, ge=1, le=3600, description="a peer that vanished is noticed after about twice this")
    writes: bool = Field(
        False, description="the PLC may write to the handshake block; with [modbus.tls]: over TLS only"
    )
    plain: bool = Field(True, description="serve Modbus TCP without TLS; false: only over [modbus.tls]")
    handshake: HandshakeConfig = Field(default_factory=HandshakeConfig)
    tls: TlsConfig | None = Field(None, description="absent: no TLS")

    @model_validator(mode="after")
    def _room(self) -> Self:
        if self.plc_addresses and self.plc_connections > self.max_connections:
            raise PlacedError(f"must not be more than max_connections = {self.max_connections}", "plc_connections")
        return self

    @model_validator(mode="after")
    def _asked(self) -> Self:
        for key in ("enable_required", "truck_required"):
            if getattr(self.handshake, key) and not self.writes:
                raise PlacedError(
                    "needs modbus.writes = true: nobody could set the bit, and permit would not wait for it",
                    "handshake",
                    key,
                )
        return self

    @model_validator(mode="after")
    def _somewhere(self) -> Self:
        if not self.plain and self.tls is None:
            raise PlacedError("nothing would be served: plain = false needs [modbus.tls]", "plain")
        if self.plain and self.tls is not None and self.port == self.tls.port != 0:
            raise PlacedError(f"{self.port} is modbus.port, too", "tls", "port")
        return self


class SparkplugConfig(Section):
    """The gateway as a Sparkplug B 3.0 edge node, on a connection of its own beside the plain topics."""

    group_id: str | None = Field(
        None, pattern=r"^[^#+/\x00-\x1f]{1,128}$", description="first level after the namespace; default: `site`"
    )
    edge_node_id: str | None = Field(
        None, pattern=r"^[^#+/\x00-\x1f]{1,128}$", description="unique in its group; default: `instance`"
    )
    primary_host_id: str | None = Field(
        None, pattern=r"^[^#+/\x00-\x1f]{1,128}$", description="births wait until this host is online; absent: for none"
    )
    period_s: float = Field(0.5, ge=0.05, le=60, description="data at most so often; changes of stop at once")
    history: int = Field(1000, ge=0, le=100_000, description="changes of stop kept while nobody can be told")


class MqttTls(Section):
    """With `url = "mqtts://..."`. Absent: the system's certificate authorities, and no certificate of our own."""

    ca_file: str | None = Field(None, min_length=1, description="PEM; whom to trust; default: what the system trusts")
    cert_file: str | None = Field(None, min_length=1, description="PEM; the certificate we show to the broker")
    key_file: str | None = Field(None, min_length=1, description="PEM; its private key")
    key_password_file: str | None = Field(None, min_length=1, description="file whose one line opens the key")

    @model_validator(mode="after")
    def _paired(self) -> Self:
        if (self.cert_file is None) != (self.key_file is None):
            missing = "key_file" if self.key_file is None else "cert_file"
            raise PlacedError("is missing; cert_file and key_file belong together", missing)
        return self


class MqttConfig(Section):
    url: str = Field(
        pattern=r"^mqtts?://", description="mqtt[s]://[user[:password]@]host[:port]; without [mqtt] none is used"
    )
    root: str = Field("loading", pattern=r"^[^#+/\s][^#+\s]*$", description="first level of every topic")
    client_id: str | None = Field(None, max_length=64, description="default: gateway-<site>-<instance>")
    username: str | None = Field(None, min_length=1, max_length=1000, description="instead of one in the url")
    password_file: str | None = Field(None, min_length=1, description="file whose one line is the password")
    password_env: str | None = Field(
        None, pattern=r"^[A-Za-z_][A-Za-z0-9_]*$", description="environment variable that holds the password"
    )
    protocol: Literal["auto", "5", "3.1.1"] = Field("auto", description="auto: MQTT 5, and 3.1.1 where 5 is refused")
    event_expiry_h: float = Field(
        168.0, ge=0.01, le=87600, description="MQTT 5: the broker drops an event that nobody fetched for so long"
    )
    home_assistant: bool = Field(False, description="every bay appears in Home Assistant by itself (MQTT discovery)")
    home_assistant_prefix: str = Field(
        "homeassistant", pattern=r"^[^#+/\s]+$", description="discovery prefix, as set in Home Assistant"
    )
    sparkplug: SparkplugConfig | None = Field(None, description="absent: no Sparkplug")
    tls: MqttTls | None = Field(None, description="certificates for mqtts://")
    state_period_s: float = Field(
        0.5, ge=0.02, le=60, description="retained state at most so often; changes of stop at once"
    )
    keepalive_s: int = Field(10, ge=2, le=3600, description="the broker sends the last will after 1.5 of these")
    outbox_events: int = Field(10_000, ge=10, le=200_000, description="events kept while the broker is away")
    outbox_mb: int = Field(64, ge=1, le=1000, description="room for them, MB")
    outbox_days: float = Field(30.0, ge=0.01, le=3650, description="an older event is dropped")
    outbox_file: str = Field(
        "auto",
        description="SQLite file that keeps them through a restart or a power cut; auto: "
        "outbox-<site>-<instance>.sqlite in /var/lib/loading-gateway, or in ~/.local/state/loading-gateway for other "
        "users than root; empty: memory only",
    )
    reconnect: Reconnect = Field(default_factory=Reconnect)

    @model_validator(mode="after")
    def _one_password(self) -> Self:
        if self.password_file is not None and self.password_env is not None:
            raise PlacedError("password_file is given, too; keep one of them", "password_env")
        return self


class BayConfig(Section):
    name: Name = Field("bay1", description="in topics and events")
    unit_id: int = Field(1, ge=1, le=247, description="Modbus unit id")
    camera: CameraConfig = Field(default_factory=CameraConfig)
    vision: VisionConfig = Field(default_factory=VisionConfig)
    ranger: RangerConfig = Field(default_factory=RangerConfig)
    fusion: FusionConfig = Field(default_factory=FusionConfig)
    guidance: GuidanceConfig = Field(default_factory=GuidanceConfig)


class GatewayConfig(Section):
    site: Name = Field("site1", description="in topics")
    instance: Name = Field("gateway", description="tells two gateways on one machine apart")
    log_level: Literal["debug", "info", "warning", "error"] = "info"
    modbus: ModbusConfig = Field(default_factory=ModbusConfig)
    mqtt: MqttConfig | None = None
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
                    raise PlacedError(f"an earlier bay has the {key} {value}, too", "bays", n, key)
                seen.add(folded)
        ids: set[int] = set()
        for n, recipe in enumerate(self.recipes):
            if recipe.id in ids:
                raise PlacedError(f"an earlier recipe has the id {recipe.id}, too", "recipes", n, "id")
            ids.add(recipe.id)
        return self


def load(path: Path, overrides: Mapping[str, Any] | None = None) -> GatewayConfig:
    """Read and check one TOML file; `overrides` (from the command line) are merged over it.

    Raises ConfigError, one line per fault: `file:line: key = value: what is wrong and what is allowed`.
    """
    data, text = read_toml(path)
    return parse(merge(data, overrides or {}), source=str(path), text=text)


def parse(data: Mapping[str, Any], *, source: str = "config", text: str = "") -> GatewayConfig:
    """Check a parsed document. `text` is the TOML it came from, for line numbers. Raises ConfigError."""
    try:
        return GatewayConfig.model_validate(_spread(data))
    except ValidationError as error:
        lines = explain(error, source=source, text=text, model=GatewayConfig, shared=SHARED_SECTIONS)
    raise ConfigError("\n".join(lines))  # outside `except`: the checker's error quotes passwords, so it is not chained


def _spread(data: Mapping[str, Any]) -> dict[str, Any]:
    """Push the shared sections down into every bay."""
    rest = {key: value for key, value in data.items() if key not in SHARED_SECTIONS}
    shared = {key: data[key] for key in SHARED_SECTIONS if key in data}
    bays = rest.get("bays", [{}])
    if isinstance(bays, list) and all(isinstance(bay, Mapping) for bay in bays):
        rest["bays"] = [merge(shared, bay) for bay in bays]
    return rest
