"""A bay's state vector and the records that it is made of: frozen, plain, units in the names."""

from dataclasses import dataclass, field
from enum import IntEnum

from gateway.core.beacon import FOUND, Beacon, BeaconStatus
from gateway.core.detection import Circle
from gateway.core.marker_wear import MarkerWear
from gateway.core.movement import DriveMemory
from gateway.core.plc import Handshake, PlcLink
from gateway.core.pose import MetricPose
from gateway.core.readings import (
    FRESH_FRAME,
    AgeProof,
    CameraExposure,
    PictureHealth,
    Quality,
    RangeReading,
    VisionReading,
)
from gateway.core.scale import MarkerScale, ScaleSample
from gateway.core.setpoint import Setpoint
from gateway.explained import ExplainedInt
from gateway.replacing import replace


class Reason(ExplainedInt):
    """Why `stop` is on. The numbers are on the wire: never renumber, only add."""

    NONE = 0, "stop is off"
    TARGET_REACHED = 1, "D = 1: the marker is large enough and the distance short enough"
    STOP_LATCHED = 2, "D was 1, or the gateway has started; until a reset, a release, or the truck has left"
    MOVED = 3, "a truck that was in place has moved without release; until it has left, a release or a reset"
    CLEARING = 4, "D is 0, and both sensors are good and fit; until that has been so for clear_hold_s"
    STARTING = 10, "a sensor has sent nothing yet"
    VISION_STALE = 11, "the newest frame is older than its deadline"
    CAMERA_DOWN = 12, "the camera cannot be opened or was lost"
    NO_TARGET = 13, "no marker in the picture"
    VISION_FAULT = 14, "the vision process died, hung or failed"
    TARGET_COASTED = 15, "the marker is hidden for the moment; its place is a prediction, not a measurement"
    VISION_AGE_UNPROVEN = 16, "nothing proves how old the frames are; camera.unproven_age refuses them"
    BEACON_LOST = 17, "the pictures do not show the beacon's code, or show it too late"
    RANGE_STALE = 20, "the newest distance is older than its deadline"
    RANGER_DOWN = 21, "the ranger's port cannot be opened or was lost"
    NO_ECHO = 22, "the ranger hears no echo"
    RANGE_TOO_NEAR = 23, "nearer than the ranger can measure"
    RANGE_TOO_FAR = 24, "farther than the ranger can measure"
    RANGER_STUCK = 25, "the ranger's ECHO pin does not move"
    RANGE_UNSTABLE = 26, "distance readings jump"
    RANGER_VERSION = 27, "the ranger's firmware speaks another protocol version"
    RANGERS_DISAGREE = 28, "the rangers of this bay contradict each other: too few of them agree"
    SENSORS_DISAGREE = 30, "camera and ranger contradict each other: R and Z do not fit"
    GATEWAY_FAULT = 40, "the gateway's own control task does not run"
    SHUTDOWN = 41, "the gateway is shutting down"
    PLC_LOST = 50, "the PLC's heartbeat is missing, or no longer changes; it is required"


@dataclass(frozen=True, slots=True)
class Tick:
    """The mere passing of time; fusion checks ages and advances the heartbeat."""


@dataclass(frozen=True, slots=True)
class TruckPosition:
    """Where both sensors had the truck at one time. `rangers_mm`: of several rangers, what each had that counted."""

    distance_mm: float
    circle: Circle
    rangers_mm: tuple[float | None, ...] = ()

    def way_mm(self, reading: RangeReading) -> float | None:
        """How far the truck has gone from here since, nearer is negative; None: no distance.

        Of several rangers each is compared with itself, and the one that shows most counts: the nearer one of two may
        be another than before, and hide by how much the other has changed; and one that drops out moves no truck.
        """
        if reading.distance_mm is None:
            return None
        pairs = zip(self.rangers_mm, counted_mm(reading), strict=False)
        ways = [now - was for was, now in pairs if was is not None and now is not None]
        return max(ways, key=abs, default=reading.distance_mm - self.distance_mm)


def counted_mm(reading: RangeReading) -> tuple[float | None, ...]:
    """The distance of each of several rangers that counts."""
    return tuple(one.distance_mm if one.agrees else None for one in reading.rangers)


@dataclass(frozen=True, slots=True)
class Failure:
    """How a sensor was dead until it has been alive for recovery_s, and since when it has been without a gap; None: it
    was not, or is not yet."""

    quality: Quality | None = None
    alive_since_ns: int | None = None


@dataclass(frozen=True, slots=True)
class FusionMemory:
    """What the decision must remember between steps. All times monotonic ns; None: not pending."""

    d: bool = False  # D(t) after hysteresis and debounce
    pending_since_ns: int | None = None  # raw D differs from d since
    disagree_since_ns: int | None = None
    disagree: bool = False
    target_seen: bool = False  # what the last frame that could be judged showed
    latched: bool = False  # stop by D stays until reset; only with latch_stop
    mark: TruckPosition | None = None  # the newest pair with D = 1 by equation 14 itself; it ends with D
    no_cause_since_ns: int | None = None  # no cause for a stop since
    vision_failure: Failure = Failure()
    range_failure: Failure = Failure()
    pairs: tuple[tuple[float, float], ...] = ()  # (R px, Z mm), the newest that fit each other, oldest first
    followed: tuple[float, float] | None = None  # R and Z when R was last seen to follow Z
    others: tuple[tuple[float, float], ...] = ()  # as `pairs`, the newest that fit each other and not those
    others_from: tuple[float, float] | None = None  # R and Z when they began
    marker_confirmed: bool = False  # of this visit: R has followed Z, or fitted what was learned
    scale_samples: tuple[ScaleSample, ...] = ()  # one a visit, oldest first; outlives restarts
    scale: MarkerScale | None = None  # learned from them, for the recipe in force
    absent_since_ns: int | None = None  # no truck to be seen since
    track: tuple[tuple[int, float], ...] = ()  # (t_ns, distance_mm) of the newest good distances, for the speed
    drive: DriveMemory = field(default_factory=DriveMemory)
    beacon: Beacon = field(default_factory=Beacon)
    restarts: int = 0  # what had to be restarted, reopened or was lost, in all
    restarted_ns: int | None = None  # `restarts` last grew then


@dataclass(frozen=True, slots=True)
class Fused:
    """What both sensors show, and what they ask for by themselves: fusion's result, of which the interlock makes the
    state. `vision` and `range` are as in the state."""

    t_ns: int = 0  # of the step, monotonic
    vision: VisionReading = field(default_factory=lambda: VisionReading(0, Quality.WAITING))
    range: RangeReading = field(default_factory=lambda: RangeReading(0, Quality.WAITING))
    d: bool | None = None  # D(t); None: unknowable
    z_vision_mm: float | None = None
    stop: bool = True  # they ask for it
    calm: bool = False  # they have shown no cause for a stop, for clear_hold_s
    reason: Reason = Reason.STARTING  # why they ask for `stop`
    memory: FusionMemory = field(default_factory=FusionMemory)


class VisitPhase(ExplainedInt):
    """The phase of a truck's visit (docs/visit.md). The numbers are on the wire: never renumber, only add."""

    UNKNOWN = 0, "a sensor has no usable value, or both contradict each other"
    EMPTY = 1, "no truck: no marker in sight, and nothing before the ranger"
    ARRIVING = 2, "a truck on its way in: a marker in sight, still beyond the ranger's range"
    APPROACHING = 3, "a truck on its way in, D = 0"
    AT_MARK = 4, "D = 1, but not in place: still moving, askew, too far in, moved, or in place was lost"
    IN_PLACE = 5, "in place, seen by both sensors"
    HELD = 6, "in place, with the marker covered: held by the ranger alone"
    RELEASED = 7, "the PLC has released the truck; it has not left its place yet"
    LEAVING = 8, "the truck was in place and is on its way out, until it is out of sight"


class Moved(ExplainedInt):
    """How a truck that was in place left it without release. The numbers are on the wire: never renumber, only add."""

    NO = 0, "it has not, since it was last in place"
    DISTANCE = 1, "the distance left its band"
    MARKER = 2, "the marker was seen elsewhere, at a fitting size"


@dataclass(frozen=True, slots=True)
class WayOut:
    """How far a truck that was in place has been seen on its way out, until it is out of sight or another one comes."""

    farthest_mm: float
    smallest_px: float | None = None  # of its marker, beyond the ranger's range


@dataclass(frozen=True, slots=True)
class ReferencePosition:
    """Where a truck in place has been standing, by each sensor, and since when it rolls (gateway/core/rolling.py)."""

    distance_mm: float | None = None
    range_ns: int = 0  # time of the newest distance compared
    nearer_mm: float = 0.0  # sum of what the newest echoes were nearer than that, less the slack; never negative
    farther_mm: float = 0.0  # likewise
    circle: Circle | None = None
    frame_ns: int = 0
    odd_frames: int = 0  # running, with the marker elsewhere
    rolling_since_ns: int | None = None
    sensor: str = ""  # which one has shown it first: "range" or "vision"
    covered: bool = False  # the marker was, when it began to roll: under the spout
    still_since_ns: int | None = None  # rolling, and stands again since
    still_mm: float | None = None  # the median Z then
    nearer: bool = False  # rolling, and it comes nearer


@dataclass(frozen=True, slots=True)
class Visit:
    """The state of the truck's visit to a bay. Only `in_place` may ever be a condition for loading.

    All times monotonic ns; None: not pending. `place` stays after `in_place` has ended, so that a truck that moves is
    noticed, until the truck has left or is in place again. After a restart, or a time in which the control task did not
    run, it can only make stricter: `restored`.
    """

    phase: VisitPhase = VisitPhase.UNKNOWN
    in_place: bool = False
    moved: Moved = Moved.NO
    moved_covered: bool = False  # it moved while the marker was covered: under the spout
    released: bool = False  # by the PLC, for this visit; it lets the truck go until off_mark
    place: TruckPosition | None = None
    restored: bool = False  # it was in place before a restart or gateway fault; until again, a reset or a clear bay
    still_since_ns: int | None = None  # D = 1 and standing, and nothing against it
    in_place_since_ns: int | None = None
    covered_since_ns: int | None = None  # the camera is alive, and the marker not seen at its place since
    unconfirmed_since_ns: int | None = None  # in place, and nothing confirms it since
    clear_since_ns: int | None = None  # no truck within leave_distance_mm since
    usable_since_ns: int | None = None  # both sensors alive, the distance known and no contradiction since
    candidate: TruckPosition | None = None  # where the truck stood when still_since_ns began
    off_mark: bool = False  # since it was in place, D was 0 and Z well beyond Z_th
    farthest_mm: float | None = None  # Z at most since the release; an approaching truck is not leaving
    way_out: WayOut | None = None  # of a truck that was in place; outlives the visit, and only guides
    unseen_since_ns: int | None = None  # on its way out, and neither sensor has seen it since
    covered: bool = False  # the marker was, while in place, for hold_grace_s: the spout may be down, or it is loaded
    seen_moving: bool = False  # the camera has seen the marker while the truck rolled off its place
    ended: str = ""  # why in_place ended last, in words
    checked: bool = False  # since a function check D was not 0 yet: a truck that stood there meanwhile is not in place
    reference: ReferencePosition | None = None  # of a truck that is in place, or has left its place without release

    @property
    def rolling(self) -> bool:
        """A truck that was in place, and was not released, moves."""
        return self.reference is not None and self.reference.rolling_since_ns is not None

    @property
    def rolled_off(self) -> bool:
        """It has left its place without release and before anything was loaded: no spout is down."""
        begun = self.in_place or self.released or self.restored or self.covered or self.moved_covered
        return self.place is not None and self.seen_moving and not begun

    @property
    def held(self) -> bool:
        """In place by the ranger only: the marker is covered."""
        return self.in_place and self.covered_since_ns is not None

    @property
    def monitored(self) -> bool:
        """A truck is or was in place, and is not known to have left the bay."""
        return self.place is not None or self.restored

    @property
    def unreleased(self) -> bool:
        """A truck is or was in place, and nobody has released it. It may have left its place since."""
        return not self.released and (self.monitored or self.moved is not Moved.NO)

    def withdrawn(self) -> "Visit":
        """For a gateway that can't vouch for it any more: in place must be earned again, and a truck that was not
        released is still monitored."""
        if not self.unreleased:
            return Visit(checked=self.checked)
        return Visit(
            place=self.place,
            restored=True,
            moved=self.moved,
            moved_covered=self.moved_covered,
            checked=self.checked,
        )


class GuidanceCode(ExplainedInt):
    """The instruction for the driver. The numbers are on the wire: never renumber, only add."""

    WAIT = 0, "stand still: no truck to guide yet, or the bay is not in use"
    FORWARD = 1, "drive on; the amount is the distance to go"
    BACK = 2, "standing too far in: go back; the amount is how far"
    LEFT = 3, "drive on and keep more to the left; the amount is how much"
    RIGHT = 4, "drive on and keep more to the right; the amount is how much"
    SLOW = 5, "drive on slowly: nearly there; the amount is the distance to go"
    STOP = 6, "stop now"
    OK = 7, "in place: stay where you are"
    TOO_FAR = 8, "still moving, and already too far in: stop now; the amount is how far"
    FAULT = 9, "stop: something is broken; a display shows it as STOP"
    LEAVE = 10, "leave the bay: released, or on the way out"
    DRIVE_UP = 11, "drive on; too far away for the ranger to measure"
    BRAKE = 12, "the truck rolls or drives off while it is in place: brake now"


@dataclass(frozen=True, slots=True)
class Guidance:
    """The instruction for the driver and its numbers. None: not known now, or not configured."""

    code: GuidanceCode = GuidanceCode.WAIT
    amount_mm: float | None = None  # of what the code names; never negative
    offset_u_px: float | None = None  # marker minus aim point, to the right
    offset_v_px: float | None = None  # downwards
    offset_mm: float | None = None  # offset_u in the plane of the marker
    closing_mm_s: float | None = None  # positive: the truck approaches
    to_go_mm: float | None = None  # until D = 1; negative: past it


class FunctionCheck(IntEnum):
    """Is a technician at work on this bay?"""

    OFF = 0
    MAY_MOVE_OFF = 1
    MAY_MOVE_KEPT = 2


@dataclass(frozen=True, slots=True)
class StateVector:
    """Equation 13's x = [u, v, R, Z, tau] with the decision of equation 14 and what is needed to trust it.

    Replaced with every step, never changed. `vision` and `range` hold the newest observation with its quality as of
    `t_ns`: a reading older than its deadline is here STALE and without a value.
    """

    bay: str
    t_ns: int = 0  # tau: the time this state was computed, monotonic
    seq: int = 0  # +1 with every state
    heartbeat: int = 0  # +1 with every fusion tick
    vision: VisionReading = field(default_factory=lambda: VisionReading(0, Quality.WAITING))
    range: RangeReading = field(default_factory=lambda: RangeReading(0, Quality.WAITING))
    d: bool | None = None  # D(t); None: unknowable
    stop: bool = True
    may_move: bool = False  # the truck may move; never a condition for loading
    reason: Reason = Reason.STARTING
    z_vision_mm: float | None = None  # f r / R, only where configured and vision is GOOD
    memory: FusionMemory = field(default_factory=FusionMemory)
    plc: Handshake = field(default_factory=Handshake)
    guidance: Guidance = field(default_factory=Guidance)
    function_check: FunctionCheck = FunctionCheck.OFF
    visit: Visit = field(default_factory=Visit)
    marker: MarkerWear | None = None  # after the newest visit; None: not known yet
    setpoint: Setpoint = field(default_factory=Setpoint)  # for a drive that moves the vehicle
    pose: MetricPose | None = None  # None: something that it needs is not configured, or not GOOD
    valid_until_ns: int = 0  # without another tick by then, it is no longer valid: gateway/core/shown.py

    @property
    def in_place(self) -> bool:
        return self.visit.in_place

    @property
    def to_stand(self) -> bool:
        """A truck that leaves its place without release was to stand. Where no PLC writes, none is released, and each
        one leaves so: there only one that has moved under the spout.
        """
        return self.visit.moved_covered or self.plc.link is not PlcLink.UNUSED

    @property
    def unintended_motion(self) -> bool:
        """A truck rolls that is to stand: also under the spout, as far as it can be known, or while it comes nearer."""
        reference = self.visit.reference
        if reference is None or not self.visit.rolling:
            return False
        return self.to_stand or reference.covered or reference.nearer

    @property
    def relay_fault(self) -> bool:
        """The outputs of the ranger's board do not follow their commands."""
        return self.range.relay is not None and self.range.relay.fault

    @property
    def running(self) -> bool:
        """The control task has made it; else it is what is shown where that does not run, or has ended."""
        return self.reason not in (Reason.GATEWAY_FAULT, Reason.SHUTDOWN)

    @property
    def vision_age_unproven(self) -> bool:
        """Nothing proves how old the newest frame is, whether it is refused for that or not."""
        return self.vision.age_proof is AgeProof.UNPROVEN and self.running

    @property
    def picture(self) -> PictureHealth | None:
        """The picture's own health; only while the camera's frames are fresh, and the control task runs."""
        return self.vision.picture if self._fresh else None

    @property
    def exposure(self) -> CameraExposure | None:
        """What the camera is set to, likewise; None: the gateway does not control it."""
        return self.vision.exposure if self._fresh else None

    @property
    def beacon(self) -> Beacon:
        """What the beacon proves; nothing where the control task does not run."""
        beacon = self.memory.beacon
        if self.running or beacon.status not in FOUND:
            return beacon
        return replace(beacon, status=BeaconStatus.LOST, lag_ns=None, latency_ns=None)

    @property
    def beacon_unproven(self) -> bool:
        """Frames arrive, but the beacon does not prove them."""
        stale = self.vision.quality is Quality.STALE and not self.vision_age_unproven
        return self.memory.beacon.unproven and stale and self.running

    @property
    def _fresh(self) -> bool:
        return self.vision.quality in FRESH_FRAME and self.running


Sensed = StateVector | Fused
"""What the sensors show at one time, and D: both records have it."""
