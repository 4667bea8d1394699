"""The PLC's two programs on virtual time: the exported FB_Approach, and the plain one that it is compared with. Pure.

Each is called once a scan with what the newest poll brought, and returns the speed reference for the drive, mm/s. What
both know of the gateway is what the exported FB_LoadingGateway gives (tests/e2e/test_structured_text_model.py runs the
exported blocks beside them). Where an approach has ended early, the program begins another one with a new start edge,
START_AGAIN_S after the vehicle may move again.
"""

from dataclasses import dataclass
from typing import Protocol

from gateway.core.detection import Circle
from gateway.core.pose import MetricPose
from gateway.core.readings import BEYOND_RANGE, FRESH_FRAME, Quality
from gateway.core.state import Reason, StateVector, VisitPhase
from gateway.modbus.exports.approach import LIFE_MS, WAIT_S, ApproachEnd
from gateway.modbus.exports.diagnosis import HALF_CIRCLE, HEARTBEAT_CHANGES, HEARTBEAT_TIMEOUT_MS

SCAN_S = 0.02
POLL_S = 0.2
START_AGAIN_S = 1.0
WAIT_MS = 1000 * WAIT_S  # of FB_Approach for every vehicle here
SCAN_MS = round(1000 * SCAN_S)
AT_MARK = frozenset({Reason.TARGET_REACHED, Reason.CLEARING})  # a stop by these does not end an approach
NEVER_MS = -1_000_000
SPOUT_MM, SIGMAS = 20.0, 3.0  # a spout may be so far from the marker's centre, by so many standard deviations


@dataclass(frozen=True, slots=True)
class Image:
    """What one poll reads, of the registers that a program uses. `may_move`, `in_place`: as FB_LoadingGateway judges
    the image, where it is alive."""

    heartbeat: int
    may_move: bool
    reason: Reason
    distance_mm: float | None
    drive_enable: bool = False
    speed_mm_s: int = 0
    in_place: bool = False
    pose: MetricPose | None = None
    circle: Circle | None = None


def image_of(told: StateVector) -> Image:
    """Of a state as it is shown. A truck that has been released is driven by no program here."""
    heard = told.range.quality
    coming = told.d is False and told.visit.phase in (VisitPhase.ARRIVING, VisitPhase.LEAVING)
    measured = heard is Quality.GOOD or (coming and heard in BEYOND_RANGE)
    return Image(
        told.heartbeat,
        told.may_move and not told.stop and told.vision.quality is Quality.GOOD and measured,
        told.reason,
        told.range.distance_mm,
        told.setpoint.enable,
        round(told.setpoint.speed_mm_s),
        told.visit.in_place and told.stop and heard is Quality.GOOD and told.vision.quality in FRESH_FRAME,
        told.pose,
        told.vision.circle,
    )


class Program(Protocol):
    def scan(self, now_s: float, image: Image | None) -> float:
        """`image`: None where no poll has been answered since the last scan."""
        ...


class StartAgain:
    """The start edge: START_AGAIN_S after the vehicle may move."""

    def __init__(self) -> None:
        self._allowed_ms: int | None = None
        self._was = False

    def __call__(self, now_ms: int, may_move: bool, busy: bool) -> bool:
        if not may_move:
            self._allowed_ms = None
        elif self._allowed_ms is None:
            self._allowed_ms = now_ms
        waited = self._allowed_ms is not None and now_ms - self._allowed_ms >= START_AGAIN_S * 1000
        self._was = waited and not busy and not self._was
        return self._was


class Sequence:
    """Is an approach on its way? By life sign, stop and start edge, as in FB_LoadingGateway and FB_Approach."""

    def __init__(self) -> None:
        self.image: Image | None = None
        self.alive = self.busy = self.done = self.fault = False
        self.cause = ApproachEnd.NONE
        self._changes = 0
        self._changed_ms = self._life_ms = NEVER_MS
        self._waits_ms: int | None = None
        self._lost = True
        self._start = StartAgain()

    def scan(self, now_ms: int, image: Image | None, *, runs: bool) -> None:
        """`runs`: the reference of the scan before is above 0."""
        self._lost = now_ms - self._life_ms >= LIFE_MS  # whatever arrives now
        self._judge(now_ms, image)
        if runs or not self.busy:
            self._waits_ms = None
        elif self._waits_ms is None:
            self._waits_ms = now_ms
        problem = self._problem(now_ms)
        start = self._start(now_ms, self.may_move, self.busy)
        if start or (self.busy and problem):
            self.busy, self.fault, self.cause = start and not problem, bool(problem), problem
        if self.busy and self.in_place:
            self.busy = False
            self.done = True
        self.done &= self.in_place

    @property
    def may_move(self) -> bool:
        return self.alive and self.image is not None and self.image.may_move

    @property
    def in_place(self) -> bool:
        return self.alive and self.image is not None and self.image.in_place

    def _judge(self, now_ms: int, image: Image | None) -> None:
        """The heartbeat must have changed twice; both blocks time it, each by its own timer."""
        was, changed = self.image, False
        if image is not None:
            steps = 0 if was is None else (image.heartbeat - was.heartbeat) % 0x10000
            changed = 0 < steps < HALF_CIRCLE
            self._changes = 0 if steps >= HALF_CIRCLE else min(HEARTBEAT_CHANGES, self._changes + changed)
            if was is None or steps:
                self._life_ms = now_ms
            self.image = image
        if changed:
            self._changed_ms = now_ms + SCAN_MS  # a timer that is off begins with the next call
        elif now_ms - self._changed_ms >= HEARTBEAT_TIMEOUT_MS:
            self._changes = 0
        self.alive = self._changes >= HEARTBEAT_CHANGES

    def _problem(self, now_ms: int) -> ApproachEnd:
        if not self.alive or self._lost:
            return ApproachEnd.LIFE
        reached = self.busy and self.image is not None and self.image.reason in AT_MARK
        if not (self.may_move or self.in_place or reached):
            return ApproachEnd.STOP
        waited = self._waits_ms is not None and now_ms - self._waits_ms >= WAIT_MS
        return ApproachEnd.WAIT if waited else ApproachEnd.NONE


class ApproachBlock:
    """As FB_Approach: never above the setpoint, up along its own ramp, down by itself without a life sign."""

    def __init__(self, acceleration_mm_s2: float, deceleration_mm_s2: float) -> None:
        self._up_mm_s, self._down_mm_s = acceleration_mm_s2 * SCAN_S, deceleration_mm_s2 * SCAN_S
        self.sequence = Sequence()
        self._reference_mm_s = 0.0

    def scan(self, now_s: float, image: Image | None) -> float:
        sequence = self.sequence
        sequence.scan(round(now_s * 1000), image, runs=self._reference_mm_s > 0)
        newest = sequence.image
        if sequence.alive and newest is not None and not (newest.may_move and newest.drive_enable):
            self._reference_mm_s = 0.0
        else:
            self._reference_mm_s += self._up_mm_s if sequence.busy else -self._down_mm_s
        if sequence.alive and newest is not None:
            self._reference_mm_s = min(self._reference_mm_s, newest.speed_mm_s)
        self._reference_mm_s = max(0.0, self._reference_mm_s)
        return self._reference_mm_s


class PlainProgram:
    """Full speed, slow from a distance on, stop at D: what is written without a setpoint."""

    def __init__(self, full_mm_s: float, creep_mm_s: float, slow_mm: float, acceleration_mm_s2: float) -> None:
        self._full_mm_s, self._creep_mm_s, self._slow_mm = full_mm_s, creep_mm_s, slow_mm
        self._up_mm_s = acceleration_mm_s2 * SCAN_S
        self._sequence = Sequence()
        self._reference_mm_s = 0.0

    def scan(self, now_s: float, image: Image | None) -> float:
        sequence = self._sequence
        sequence.scan(round(now_s * 1000), image, runs=self._reference_mm_s > 0)
        newest, allowed_mm_s = sequence.image, 0.0
        if sequence.busy and newest is not None and newest.may_move and newest.distance_mm is not None:
            allowed_mm_s = self._full_mm_s if newest.distance_mm > self._slow_mm else self._creep_mm_s
        self._reference_mm_s = min(allowed_mm_s, self._reference_mm_s + self._up_mm_s)
        return self._reference_mm_s


Place = tuple[float, float]  # of the spout against its home position, mm


class TrolleyProgram:
    """Moves the spout's trolley while the vehicle is in place, then lowers the spout: to the first pose that is known
    well enough. Ended by anything, it stays where it is, and begins anew with the next vehicle in place.
    """

    def __init__(self, arrived_mm: float = 1.0) -> None:
        self.goal: Place | None = None
        self.lowered = False
        self._arrived_mm = arrived_mm
        self._sequence = Sequence()

    def scan(self, now_s: float, image: Image | None, at: Place) -> Place:
        """`at`: where the trolley's encoders have it. Returns where it is to go."""
        sequence = self._sequence
        sequence.scan(round(now_s * 1000), image, runs=False)
        if not sequence.in_place:
            self.goal = None
        elif self.goal is None and image is not None:
            self.goal = self.read(image)
        goal = self.goal or at
        arrived = all(abs(to - now) <= self._arrived_mm for to, now in zip(goal, at, strict=True))
        self.lowered = self.goal is not None and arrived
        return goal

    def read(self, image: Image) -> Place | None:
        """Of one poll: registers 114 to 117 with 120 and 121."""
        pose = image.pose
        fits = pose is not None and SIGMAS * max(pose.x_sd_mm, pose.y_sd_mm) <= SPOUT_MM
        return (pose.x_mm, pose.y_mm) if pose and fits else None


class PlainTrolleyProgram(TrolleyProgram):
    """By the newest centre in the picture, and one factor from pixels to millimetres, taught at the place."""

    def __init__(self, taught_px: Place, mm_per_px: float) -> None:
        super().__init__()
        self._taught_px, self._mm_per_px = taught_px, mm_per_px

    def read(self, image: Image) -> Place | None:
        if image.circle is None:
            return None
        u_px, v_px = self._taught_px
        return (image.circle.u_px - u_px) * self._mm_per_px, (image.circle.v_px - v_px) * self._mm_per_px
