"""What the two sensors report: quality, value and counters; of the camera also the picture's own health."""

from dataclasses import dataclass, field
from enum import IntEnum

from gateway.core.beacon import BeaconCode, BeaconLight
from gateway.core.detection import Circle, Ellipse, Tracking
from gateway.explained import ExplainedInt, ExplainedStr


class Quality(ExplainedInt):
    """Why a sensor's value may or may not be used. Only GOOD carries a value; the numbers are on the wire."""

    GOOD = 0, "fresh and valid"
    WAITING = 1, "nothing received since the start"
    STALE = 2, "the last value is older than its deadline"
    LINK_DOWN = 3, "camera or serial port cannot be opened, or was lost"
    NO_TARGET = 4, "the frame is fine, but no marker is in it"
    PROCESS_FAULT = 5, "the vision process died, hung or failed on the frame"
    NO_ECHO = 6, "the ranger heard no echo"
    TOO_NEAR = 7, "nearer than the ranger can measure"
    TOO_FAR = 8, "farther than the ranger can measure"
    STUCK = 9, "the ranger's ECHO pin does not move"
    UNSTABLE = 10, "readings jump more than the glitch gate allows"
    WRONG_VERSION = 11, "the ranger speaks another protocol version"
    COASTED = 12, "the marker is not in this frame; only where it should be is known, from its motion"


FRESH_FRAME = frozenset({Quality.GOOD, Quality.NO_TARGET, Quality.COASTED})
"""Of a camera's reading: it is from a fresh frame, with or without a marker."""
VISION_FINE = FRESH_FRAME | {Quality.WAITING}
"""Of a camera's reading: no fault. Every other quality is one."""
RANGE_FINE = frozenset({Quality.GOOD, Quality.WAITING})
"""Of a ranger's reading: no fault. Every other quality is one."""
BEYOND_RANGE = frozenset({Quality.NO_ECHO, Quality.TOO_FAR})
"""Of a ranger: it works, and nothing is within its range."""
MEASURED = BEYOND_RANGE | {Quality.GOOD}
"""Of a ranger: it says where the truck is, or is not."""
DEAD = frozenset({Quality.STALE, Quality.LINK_DOWN, Quality.PROCESS_FAULT, Quality.STUCK, Quality.WRONG_VERSION})
"""Of either sensor: it is broken, or its link is. Every other quality but WAITING is that of a live sensor."""


class AgeProof(ExplainedStr):
    """What shows how old a frame is, counted from its exposure: nothing; the stream's own times against their arrival,
    which do not show a constant delay; a stamp of the driver or of the camera; or it was made on this machine (a film,
    a simulation)."""

    UNPROVEN = "unproven", "not proven"
    PRESENTATION_TIME = "presentation_time", "own times of the stream; a constant delay is not seen"
    BUFFER_TIME = "buffer_time", "time stamp of the driver"
    DEVICE_TIME = "device_time", "time stamp of the camera"
    OWN_CLOCK = "own_clock", "clock of the gateway"


class PictureFault(ExplainedInt):
    """What is wrong with the picture itself: bits of its status, on the wire: never renumber, only add."""

    DARK = 0, "too dark"
    BRIGHT = 1, "over-exposed: too much of it is burnt out"
    FLAT = 2, "without contrast: the lens is covered, or looks into fog"
    BLURRED = 3, "without sharp edges: out of focus, or dirt or water on the lens"
    DUSTY = 4, "veiled for long: dust in the air or on the lens"
    SHIFTED = 5, "the fixed background is not where it was: the camera was moved, turned or zoomed"


@dataclass(frozen=True, slots=True)
class PictureHealth:
    """Quality of the picture itself, with or without a marker. Shares are 0 to 1; None: can't be measured in this
    picture."""

    brightness: float  # mean grey level
    clipped: float  # share of pixels at white
    contrast: float  # from the 5th to the 95th percentile of the grey levels
    sharpness: float | None  # of its strongest edges, 0.6 in focus
    veil: float | None  # share of airlight: haze, dust, a film on the lens
    shift_px: float | None  # how far the fixed background has moved since it was learned
    status: int = 0  # PictureFaults, one bit each
    veil_proven: float | None = None  # the veil up to which this bay was shown to be reliable; None: not shown

    @property
    def faults(self) -> tuple[PictureFault, ...]:
        return tuple(fault for fault in PictureFault if self.status >> fault & 1)


class ExposureState(ExplainedStr):
    """Of a camera whose exposure the gateway controls (`camera.exposure = "marker"`)."""

    CONTROLLED = "controlled", "exposure time and gain follow the light"
    TOO_BRIGHT = "too_bright", "at its shortest time and lowest gain, and still too bright"
    TOO_DARK = "too_dark", "at its longest time and highest gain, and still too dark"
    IGNORED = "ignored", "the camera accepts other settings, but its pictures do not follow them"
    REFUSED = "refused", "the camera refuses to be set"
    NO_CONTROLS = "no_controls", "the camera has no exposure time that can be set"


UNCONTROLLED = frozenset({ExposureState.IGNORED, ExposureState.REFUSED, ExposureState.NO_CONTROLS})
"""The camera does not follow its settings."""


@dataclass(frozen=True, slots=True)
class CameraExposure:
    """What a camera is set to, as far as it reports that."""

    state: ExposureState
    time_ms: float | None = None
    gain_db: float | None = None  # None: not controlled


@dataclass(frozen=True, slots=True)
class VisionStats:
    """Counters since the start of the gateway, one set per bay."""

    frames: int = 0  # results delivered
    skipped: int = 0  # frames replaced by a newer one before it was processed, or damaged
    lost: int = 0  # frames that ended with their process
    restarts: int = 0  # vision processes replaced
    reopens: int = 0  # sources opened again
    rate_hz: float = 0.0  # results a second, over about the last second
    latency_ms: float = 0.0  # capture to result, newest frame


@dataclass(frozen=True, slots=True)
class RangeStats:
    """Counters since the start of the gateway, one set per bay."""

    lines: int = 0  # good measurement lines
    damaged: int = 0  # lines or fragments dropped: checksum, length, syntax
    gaps: int = 0  # measurements missing by sequence number
    rejected: int = 0  # readings held back by the glitch gate, late, or out of a backlog
    reopens: int = 0
    rate_hz: float = 0.0


@dataclass(frozen=True, slots=True)
class VisionReading:
    """One observation from the camera side. `circle` is set if and only if quality is GOOD."""

    t_ns: int  # capture time of the frame, or of the fault
    quality: Quality
    circle: Circle | None = None
    frame_id: int = 0
    x_n: float | None = None
    y_n: float | None = None
    detail: str = ""  # for people: what went wrong, never parsed
    stats: VisionStats = field(default_factory=VisionStats)
    stage_ns: tuple[tuple[str, int], ...] = ()  # time per stage of this frame, in pipeline order; empty: no result
    ellipse: Ellipse | None = None  # of the circle, where the method fits one
    confidence: float | None = None  # 0 to 1; None: no circle, or the method doesn't report it
    visible: float | None = None  # share of the rim that was seen; None: no circle, or the method doesn't report it
    contrast: float | None = None  # fall of redness across the rim, log units; None: likewise
    tracking: Tracking = Tracking.OFF
    frames: int = 1  # summed for this circle; `t_ns` is the oldest one's
    predicted: Circle | None = None  # if and only if quality is COASTED: shown to people, never decided on
    wrong_size: Circle | None = None  # a red disc that the ranger's distance contradicts; NO_TARGET and COASTED only
    picture: PictureHealth | None = None  # of a frame at most some seconds old; shown by `StateVector.picture` only
    exposure: CameraExposure | None = None  # when this frame's result was sent; None: the gateway does not control it
    age_proof: AgeProof | None = None  # of `t_ns`; None: of no frame, or of one whose value has ended since
    beacon: BeaconLight | None = None  # in this frame; None: none configured, or a fault


class RelayOutput(IntEnum):
    """The outputs of the ranger's board, never two at once. The numbers are on the wire: never renumber, only add."""

    NONE = 0
    IN_PLACE = 1
    MAY_MOVE = 2


@dataclass(frozen=True, slots=True)
class RelayStatus:
    """The outputs of the ranger's board as its newest measurement has them."""

    commanded: RelayOutput  # by the gateway
    pins: int  # sum of the RelayOutput whose pins are high, read back
    fault: bool  # pins and command differ for too long


@dataclass(frozen=True, slots=True)
class RangerVote:
    """One of several rangers at a bay, at the time of their vote. `distance_mm` is set if and only if it is GOOD."""

    quality: Quality
    distance_mm: float | None = None
    agrees: bool = False  # it is one of those that the result rests on


@dataclass(frozen=True, slots=True)
class RangeReading:
    """One observation from the ranger side. `distance_mm` is set if and only if quality is GOOD."""

    t_ns: int  # time of the echo, dated back over the wire
    quality: Quality
    distance_mm: float | None = None
    seq: int = 0
    detail: str = ""
    stats: RangeStats = field(default_factory=RangeStats)
    oldest_ns: int | None = None  # time of the oldest echo that counts in the distance; None: t_ns
    echo_mm: float | None = None  # the newest of these echoes by itself; None: the ranger does not report it
    relay: RelayStatus | None = None  # None: not used, or not known now
    rangers: tuple[RangerVote, ...] = ()  # of a bay with several, each in the order of the configuration
    farthest_mm: float | None = None  # what the farthest of two that agree has; None: it is distance_mm
    beacon: BeaconCode | None = None  # of the board's newest cycles; None: not used, or not known now
    air_c: float | None = None  # measured by the board; None: not, and the configured temperature counts
    temperature_lost: bool = False  # air_c was measured before, or is configured to be, and is not for some time

    @property
    def rangers_disagree(self) -> bool:
        """Enough of a bay's rangers are good, and too few of them agree."""
        return self.quality is Quality.UNSTABLE and sum(one.quality in MEASURED for one in self.rangers) > 1
