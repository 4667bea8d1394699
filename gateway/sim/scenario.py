"""A scenario is one TOML file: how the truck moves, the camera's conditions, which faults occur when. Checked strictly.

Everything the simulator shows follows from a scenario and a time; there is no other state. World time starts at 0.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from pydantic import Field, ValidationError, model_validator

from gateway.config import Name
from gateway.config.strict.errors import explain
from gateway.config.strict.section import Section
from gateway.config.strict.toml_file import merge, read_toml
from gateway.errors import ConfigError
from gateway.explained import ExplainedStr


class FaultKind(ExplainedStr):
    CAMERA_FREEZE = "camera_freeze", "no frames: the driver hangs"
    CAMERA_LOST = "camera_lost", "the camera is gone, and opening it fails"
    CAMERA_BLACK = "camera_black", "frames arrive, but black, as behind a lens cap"
    CAMERA_STUCK = "camera_stuck", "frames arrive, each with a new time, but all show the same picture"
    CAMERA_LATE = "camera_late", "frames arrive, each with a new time, but show what was `delay_s` ago"
    CAMERA_LOOPED = (
        "camera_looped",
        "frames arrive, each with a new time, but repeat the last `delay_s` before the fault",
    )
    MARKER_HIDDEN = "marker_hidden", "a grey tarpaulin hangs over the marker"
    MARKER_CRUSTED = "marker_crusted", "cement has set on the marker, from below, and covers `share` of its rim"
    SPOUT_DOWN = "spout_down", "the loading spout comes down before the marker, covers it and goes up again at the end"
    DUST_CLOUD = "dust_cloud", "loading raises so much dust that hardly anything can be seen"
    RED_LAMP = "red_lamp", "a round red lamp on the spout is lit, 20 px in radius; the spout need not be down"
    RANGER_SILENT = "ranger_silent", "the port is open, but no line arrives"
    RANGER_NO_ECHO = "ranger_no_echo", "every measurement reports no echo"
    RANGER_STUCK = "ranger_stuck", "every measurement reports that ECHO is held high"
    RANGER_TOO_NEAR = "ranger_too_near", "every measurement reports nearer than 2 cm"
    RANGER_TOO_FAR = "ranger_too_far", "every measurement reports farther than 4 m"
    RANGER_NOISE = "ranger_noise", "bytes are flipped, lost and made up on the wire"
    RANGER_WILD = "ranger_wild", "every other reading is wild, as with known clones"
    RANGER_ECHO = "ranger_echo", "an echo from what is nearer than the truck: the spout, dust, a person; `distance_cm`"
    RANGER_OFFSET = "ranger_offset", "the ranger measures `offset_cm` too much, as one that is loose or out of line"
    RANGER_UNPLUGGED = "ranger_unplugged", "the serial device is gone"
    RANGER_WRONG_VERSION = "ranger_wrong_version", "the ranger reboots with another protocol version"
    RANGER_NO_TEMPERATURE = "ranger_no_temperature", "the board's temperature sensor, where it has one, is not found"


class Fault(Section):
    """One fault for a limited time. The schedule is in world time and does not repeat."""

    kind: FaultKind = Field(description="the fault: one of the kinds listed below")
    at_s: float = Field(ge=0, le=86_400, description="when it starts, s of world time")
    for_s: float = Field(gt=0, le=86_400, description="how long it lasts, s")
    distance_cm: float = Field(
        20.0, ge=2, le=400, description="distance of the echo of a ranger_echo; others have no distance"
    )
    delay_s: float = Field(2.0, gt=0, le=10, description="of a camera_late or camera_looped; others have none")
    offset_cm: float = Field(10.0, ge=-100, le=100, description="of a ranger_offset; negative: it measures too little")
    share: float = Field(0.3, ge=0, le=1, description="of the rim that a marker_crusted covers; others have none")
    ranger: int = Field(1, ge=1, le=3, description="of a ranger's fault: of several rangers at the bay, which one")

    def active(self, t_s: float) -> bool:
        """Does it hold at world time `t_s`?"""
        return self.at_s <= t_s < self.at_s + self.for_s


class Pose(Section):
    distance_cm: float = Field(150.0, ge=4, le=500, description="from the ranger to the marker's plane, cm")
    lateral_mm: float = Field(0.0, ge=-1000, le=1000, description="marker right (+) or left (-) of the optical axis")
    vertical_mm: float = Field(0.0, ge=-1000, le=1000, description="marker below (+) or above (-) the optical axis")


class Leg(Section):
    """Drive in a straight line from the truck's present pose to this one, then stop."""

    another_truck: bool = Field(
        False, description="this truck has left: another one is at this pose at once, which takes no time"
    )
    name: str = Field("", max_length=40, description="for reports; trials are named here")
    distance_cm: float = Field(ge=4, le=500, description="distance at the end of the leg, cm")
    lateral_mm: float = Field(0.0, ge=-1000, le=1000, description="lateral offset at the end of the leg")
    vertical_mm: float = Field(0.0, ge=-1000, le=1000, description="vertical offset at the end of the leg")
    speed_cm_s: float = Field(20.0, ge=0.5, le=300, description="cruising speed, cm/s")
    acceleration_cm_s2: float = Field(40.0, ge=1, le=1000, description="mean acceleration, both ways, cm/s^2")
    hold_s: float = Field(0.0, ge=0, le=86_400, description="time at rest at the end, s")


class Marker(Section):
    radius_mm: float = Field(90.0, ge=20, le=200, description="true radius of the red disc")
    wear: float = Field(0.3, ge=0, le=1, description="scratches and chipped paint; the rim keeps its radius")


DEFAULT_EXPOSURE_MS = 5.0


class Camera(Section):
    width_px: int = Field(640, ge=64, le=1920, description="frame width")
    height_px: int = Field(480, ge=64, le=1440, description="frame height")
    focal_px: float = Field(600.0, ge=50, le=5000, description="focal length, px; square pixels, no distortion")
    cx_px: float | None = Field(None, ge=-2000, le=4000, description="principal point, u; default: the frame's centre")
    cy_px: float | None = Field(None, ge=-2000, le=4000, description="principal point, v; default: the frame's centre")
    fps: float = Field(30.0, ge=1, le=120, description="frames a second")
    offset_mm: float = Field(0.0, ge=-500, le=2000, description="camera behind the ranger (+) or before it (-)")
    exposure_ms: float = Field(DEFAULT_EXPOSURE_MS, ge=0, le=50, description="exposure time: motion blur; 0: none")
    noise: float = Field(
        2.0,
        ge=0,
        le=40,
        description="standard deviation of the sensor noise, grey levels; with a controlled exposure the sensor "
        "has its own noise instead; 0: none",
    )
    exposure_delay: int = Field(
        2, ge=0, le=10, description="frames that still show the exposure before a change; only where it is controlled"
    )
    gain_max_db: float = Field(24.0, ge=0, le=48, description="the highest gain that can be set, likewise")
    exposure_obeyed: bool = Field(True, description="false: the camera accepts every exposure and keeps its own")

    @property
    def centre_px(self) -> tuple[float, float]:
        """Principal point (u, v); pixel centres lie at integers."""
        u = (self.width_px - 1) / 2 if self.cx_px is None else self.cx_px
        v = (self.height_px - 1) / 2 if self.cy_px is None else self.cy_px
        return u, v


class Vibration(Section):
    """Engine and chassis shake the truck on three axes."""

    amplitude_mm: float = Field(1.5, ge=0, le=50, description="largest sideways excursion while driving")
    frequency_hz: float = Field(6.0, ge=0.1, le=50, description="its middle frequency")
    axial_share: float = Field(0.3, ge=0, le=1, description="along the optical axis, as a share of it")
    rest_share: float = Field(0.2, ge=0, le=1, description="share that remains with the truck at rest, engine idling")


class Light(Section):
    level: float = Field(1.0, ge=0, le=3, description="1: well exposed; above: over-exposed, below: dark")
    drift: float = Field(0.05, ge=0, le=1, description="slow change, clouds: share of the level")
    drift_period_s: float = Field(17.0, ge=0.5, le=3600, description="period of the slow change, s")
    flicker: float = Field(0.02, ge=0, le=1, description="lamps on the mains: share of the level")
    flicker_hz: float = Field(100.0, ge=0.1, le=1000, description="frequency of the flicker, Hz")
    gradient: float = Field(0.15, ge=0, le=1, description="one side of the frame brighter: share of the level")
    gradient_deg: float = Field(-120.0, ge=-360, le=360, description="direction of the light; 0 right, 90 below")
    shadow: float = Field(0.0, ge=0, le=1, description="depth of a slanted shadow across the frame")
    warmth: float = Field(0.0, ge=-1, le=1, description="colour cast: 1 sodium lamp, -1 blue hour")


class LightChange(Section):
    """Dusk, a lamp that is switched on: all of the light becomes brighter or darker."""

    at_s: float = Field(ge=0, le=86_400, description="when it begins, s of world time, in ascending order")
    over_s: float = Field(0.0, ge=0, le=86_400, description="how long it takes, evenly in the logarithm, s")
    level: float = Field(ge=0.0001, le=10_000, description="what `light` is multiplied with from then on")


class Glare(Section):
    """The sun or a lamp in the picture: it does not move, and stands before everything else."""

    at_s: float = Field(0.0, ge=0, le=86_400, description="when it appears, s of world time")
    for_s: float = Field(86_400.0, gt=0, le=86_400, description="for how long, s")
    u_px: float = Field(ge=-5000, le=5000, description="its centre, px from the left")
    v_px: float = Field(ge=-5000, le=5000, description="px from the top")
    radius_px: float = Field(20.0, ge=1, le=2000, description="its radius, px")
    level: float = Field(30.0, ge=0, le=100_000, description="its light; white in the scenario's own light is 1")
    scatter: float = Field(0.01, ge=0, le=1, description="share that the lens scatters round it")


class Dust(Section):
    """Cement dust between camera and truck."""

    density: float = Field(0.03, ge=0, le=5, description="extinction per metre of air")
    unevenness: float = Field(0.4, ge=0, le=1, description="clouds: share of the density")
    drift_px_s: float = Field(25.0, ge=0, le=1000, description="how fast the clouds cross the frame, px/s")


class Surface(Section):
    stains: float = Field(0.5, ge=0, le=1, description="cement streaks, water marks and dirt on the truck")
    rust: float = Field(0.0, ge=0, le=1, description="rust round the port, red enough for the paper's threshold")


class Clutter(Section):
    """Red things that are not the marker; each is drawn smaller than it, and none touches it."""

    things: int = Field(5, ge=0, le=10, description="how many: hoses, lamps, handwheels, rust runs; 0: nothing red")
    seed: int = Field(0, ge=0, le=2**31, description="other places and kinds with the same scenario seed")


class Ranger(Section):
    """What the ultrasonic sensor adds to the true distance."""

    jitter_mm: float = Field(1.5, ge=0, le=200, description="standard deviation of a reading")
    step_mm: float = Field(4.0, ge=0, le=50, description="readings have steps of this; 0: none")
    dropout: float = Field(0.0, ge=0, le=1, description="share of the measurements without an echo")
    temperature_c: float = Field(20.0, ge=-40, le=85, description="of the air, which sets the true speed of sound")
    temperature_sensor: bool = Field(False, description="the board measures it (a DS18B20), and its lines carry it")


class Scenario(Section):
    """A truck's visit to one bay. After the last leg it stays at rest, or begins again with `repeat`."""

    seed: int = Field(1, ge=0, le=2**31, description="of everything random")
    duration_s: float = Field(20.0, gt=0, le=86_400, description="length of the show; world and faults go on after it")
    repeat: bool = Field(False, description="after the last leg begin again; it must then end where the start is")
    bay: Name = Field("bay1", description="the bay it is meant for")
    start: Pose = Field(default_factory=Pose)
    legs: tuple[Leg, ...] = Field((), max_length=1000, description="one after the other; none: the truck stays at rest")
    marker: Marker = Field(default_factory=Marker)
    camera: Camera = Field(default_factory=Camera)
    vibration: Vibration = Field(default_factory=Vibration)
    light: Light = Field(default_factory=Light)
    dust: Dust = Field(default_factory=Dust)
    surface: Surface = Field(default_factory=Surface)
    clutter: Clutter = Field(default_factory=Clutter)
    ranger: Ranger = Field(default_factory=Ranger)
    ambient: tuple[LightChange, ...] = Field((), max_length=1000, description="how the light changes with time")
    glare: tuple[Glare, ...] = Field((), max_length=20, description="lamps and the sun in the picture")
    faults: tuple[Fault, ...] = Field((), max_length=1000, description="the schedule of faults")

    @model_validator(mode="after")
    def _camera_stays_in_front(self) -> Self:
        nearest = min([self.start.distance_cm, *(leg.distance_cm for leg in self.legs)])
        room_mm = 10 * nearest + self.camera.offset_mm - 2 * self.vibration.amplitude_mm
        if room_mm < 20:
            raise ValueError(
                f"the camera would be within {room_mm:g} mm of the marker: with camera.offset_mm = "
                f"{self.camera.offset_mm:g} no leg may end at {nearest:g} cm"
            )
        return self

    @model_validator(mode="after")
    def _changes_in_order(self) -> Self:
        times = [change.at_s for change in self.ambient]
        if times != sorted(times):
            raise ValueError("ambient: at_s must ascend")
        return self

    @model_validator(mode="after")
    def _repeats_from_the_start(self) -> Self:
        if not self.repeat:
            return self
        if not self.legs:
            raise ValueError("repeat needs legs to repeat")
        for key in Pose.model_fields:
            if (end := getattr(self.legs[-1], key)) != (start := getattr(self.start, key)):
                raise ValueError(f"repeat: the last leg ends at {key} = {end}, but the start is at {start}")
        return self

    def active(self, kind: FaultKind, t_s: float) -> bool:
        """Does a fault of this kind hold at world time `t_s`?"""
        return self.since_s(kind, t_s) is not None

    def since_s(self, kind: FaultKind, t_s: float) -> float | None:
        """When the fault of this kind began that holds at world time `t_s`; None: there is none."""
        fault = self._fault(kind, t_s)
        return None if fault is None else fault.at_s

    def crusted(self, t_s: float) -> float:
        """Which share of the marker's rim cement covers at world time `t_s`."""
        crust = self._fault(FaultKind.MARKER_CRUSTED, t_s)
        return 0.0 if crust is None else crust.share

    def shown_s(self, t_s: float) -> float:
        """World time of what the camera's picture of `t_s` shows, where it is late or repeats itself."""
        if (late := self._fault(FaultKind.CAMERA_LATE, t_s)) is not None:
            return t_s - late.delay_s
        if (looped := self._fault(FaultKind.CAMERA_LOOPED, t_s)) is not None:
            return looped.at_s - looped.delay_s + (t_s - looped.at_s) % looped.delay_s
        return t_s

    def _fault(self, kind: FaultKind, t_s: float) -> Fault | None:
        return next((fault for fault in self.faults if fault.kind is kind and fault.active(t_s)), None)


def load(path: Path, overrides: Mapping[str, Any] | None = None) -> Scenario:
    """Read and check one scenario; `overrides` (from the command line) are merged over it.

    Raises ConfigError, one line per fault: `file:line: key = value: what is wrong and what is allowed`.
    """
    data, text = read_toml(path)
    return parse(merge(data, overrides or {}), source=str(path), text=text)


def parse(data: Mapping[str, Any], *, source: str = "scenario", text: str = "") -> Scenario:
    """Check a parsed document. `text` is the TOML it came from, for line numbers. Raises ConfigError."""
    try:
        return Scenario.model_validate(data)
    except ValidationError as error:
        raise ConfigError("\n".join(explain(error, source=source, text=text, model=Scenario))) from error
