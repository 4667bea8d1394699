"""Where the truck is and what an ideal camera and ranger would measure: a pure function of scenario and time.

In trials also of what `TruckHold` was given: how long the truck is at rest at the end of some legs. With a `DrivenWay`
there is no plan: a PLC moves the vehicle.

Axes as the camera's: X right, Y down, Z along the optical axis, mm. The marker is a disc facing the camera, so its
picture is a circle: u = cx + f X/Z, v = cy + f Y/Z, R = f r/Z. With the defaults (f = 600 px, r = 90 mm) R = 180 px at
Z = 30 cm exactly, the paper's pair of thresholds.
"""

import math
import random
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

from gateway.sim.driven_way import DrivenWay
from gateway.sim.scenario import Camera, FaultKind, Leg, Scenario, Vibration

SPOUT_S = 2.0  # the spout needs this long to move down, and to move up
SPOUT_MM = 200.0  # from the ranger to the spout, which hangs on the camera's axis: nearer than any truck in place
SPOUT_HALF_MM = 75.0
SINES = 4  # per axis of the vibration
LOUD_MM_S = 200.0  # a driven vehicle shakes as much as it can from this speed on
DELTA_S = 1e-4  # for the image speed; vibration is slow against it


class Motion(StrEnum):
    APPROACH = "approach"
    RETREAT = "retreat"
    HOLD = "hold"


class Vector(NamedTuple):
    """Position of the marker's centre against the ranger's line of sight, mm."""

    x: float
    y: float
    z: float


@dataclass(frozen=True, slots=True)
class Truth:
    """What is so at one moment of world time, free of every sensor's error."""

    t_s: float
    distance_mm: float  # Z of equation 12, from the ranger
    camera_mm: float  # the same from the camera
    u_px: float
    v_px: float
    radius_px: float
    u_px_s: float  # speed of the centre in the image
    v_px_s: float
    marker_visible: bool  # completely in the frame and not covered
    stop: bool  # D of equation 14, from the true radius and distance
    phase: Motion
    leg: int  # index of the current leg; -1 before world time 0 and where the scenario has none
    leg_name: str
    speed_mm_s: float = 0.0  # of the truck along its way, vibration left out; never negative
    truck: int = 0  # which truck it is, counted from 0
    spout: float = 0.0  # how far the loading spout is down: 0 above the picture, 1 all the way
    lamp: bool = False  # the red lamp on the spout is lit


@dataclass(frozen=True, slots=True)
class _Segment:
    """One leg with its times. Speed rises and falls as a raised cosine: position, speed and acceleration are smooth."""

    start_s: float
    origin: Vector
    target: Vector
    peak_mm_s: float
    ramp_s: float
    drive_s: float
    end_s: float

    @classmethod
    def plan(cls, leg: Leg, origin: Vector, start_s: float) -> "_Segment":
        target = Vector(leg.lateral_mm, leg.vertical_mm, 10.0 * leg.distance_cm)
        origin = target if leg.another_truck else origin
        way = math.dist(origin, target)
        acceleration = 10.0 * leg.acceleration_cm_s2
        # Two ramps need peak^2 / acceleration of way; a shorter leg never reaches its cruising speed.
        peak = min(10.0 * leg.speed_cm_s, math.sqrt(way * acceleration))
        ramp = peak / acceleration
        drive = way / peak + ramp if way > 0 else 0.0
        return cls(start_s, origin, target, peak, ramp, drive, start_s + drive + leg.hold_s)

    def at(self, t_s: float) -> tuple[Vector, float]:
        """Position and speed (mm/s) at `t_s`."""
        since = t_s - self.start_s
        if since >= self.drive_s:
            return self.target, 0.0
        if since <= 0:
            return self.origin, 0.0
        left = self.drive_s - since
        way = math.dist(self.origin, self.target)
        if since < self.ramp_s:
            done, speed = self._ramp(since)
        elif left < self.ramp_s:
            rest, speed = self._ramp(left)
            done = way - rest
        else:
            done, speed = self.peak_mm_s * (since - self.ramp_s / 2), self.peak_mm_s
        share = done / way
        here = Vector(*(a + (b - a) * share for a, b in zip(self.origin, self.target, strict=True)))
        return here, speed

    def _ramp(self, s: float) -> tuple[float, float]:
        """Way and speed `s` seconds into a ramp from rest."""
        turn = math.pi * s / self.ramp_s
        way = self.peak_mm_s / 2 * (s - self.ramp_s / math.pi * math.sin(turn))
        return way, self.peak_mm_s / 2 * (1 - math.cos(turn))


@dataclass(frozen=True, slots=True)
class TruckHold:
    """At the end of `legs` (by index, ascending) the truck waits beyond the plan until it is let go, `limit_s` at most.

    A file passes departures on, because the world is computed in two processes: the judge's, which has the ranger too,
    and the camera's, to which this record is sent. One line a departure; half a line counts as none.
    """

    path: str
    legs: tuple[int, ...]
    limit_s: float

    def leave(self, leg: int, t_s: float) -> None:
        """Let the truck leave the end of `leg` at world time `t_s`, which must lie a little ahead of all observers."""
        with Path(self.path).open("a", encoding="ascii") as file:
            file.write(f"{leg} {t_s!r}\n")

    def departures(self) -> Mapping[int, float]:
        """World time of each departure so far, by leg."""
        try:
            text = Path(self.path).read_text(encoding="ascii")
        except FileNotFoundError:  # no truck has been let go yet
            return {}
        words = [line.split() for line in text.splitlines(keepends=True) if line.endswith("\n")]
        return {int(leg): float(t_s) for leg, t_s in words}


class World:
    """The truck of one scenario, with the thresholds of equation 14 that decide `stop`."""

    def __init__(
        self,
        scenario: Scenario,
        *,
        radius_threshold_px: float = 180.0,
        distance_threshold_mm: float = 300.0,
        hold: TruckHold | None = None,
        track: DrivenWay | None = None,
    ) -> None:
        self.scenario = scenario
        self._hold = hold
        self._track = track
        self._radius_threshold_px = radius_threshold_px
        self._distance_threshold_mm = distance_threshold_mm
        start = scenario.start
        here = Vector(start.lateral_mm, start.vertical_mm, 10.0 * start.distance_cm)
        self._start = here
        self._segments: list[_Segment] = []
        for leg in scenario.legs:
            self._segments.append(_Segment.plan(leg, here, self.plan_s))
            here = self._segments[-1].target
        self._starts = [segment.start_s for segment in self._segments]
        self._others = [number for number, leg in enumerate(scenario.legs) if leg.another_truck]
        self._sines = _sines(scenario.vibration, scenario.seed)

    @property
    def plan_s(self) -> float:
        """World time at which the last leg's hold ends; from then on the truck is at rest, or begins again."""
        return self._segments[-1].end_s if self._segments else 0.0

    def planned_s(self, t_s: float) -> float:
        """Progress of the plan at world time `t_s`, s: that time less the truck's additional time at rest."""
        return self._leg_and_planned_s(t_s)[1]

    def truth(self, t_s: float, *, image_speed: bool = True) -> Truth:
        """Everything at world time `t_s`; before 0 the truck is at the start.

        Without `image_speed` the speed of the marker in the image is not calculated, and is 0.
        """
        here, speed, leg = self._here(t_s)
        camera = self.scenario.camera
        u, v, radius = self._project(here)
        u_px_s = v_px_s = 0.0
        if image_speed:
            # Central difference, one-sided nowhere: the world is defined for every t.
            u_before, v_before, _ = self._project(self._here(t_s - DELTA_S)[0])
            u_after, v_after, _ = self._project(self._here(t_s + DELTA_S)[0])
            u_px_s, v_px_s = (u_after - u_before) / (2 * DELTA_S), (v_after - v_before) / (2 * DELTA_S)
        down = spout(self.scenario, t_s)
        covered = self.scenario.active(FaultKind.MARKER_HIDDEN, t_s) or self._behind_spout(down, u, v, radius)
        inside = radius <= u <= camera.width_px - 1 - radius and radius <= v <= camera.height_px - 1 - radius
        return Truth(
            t_s=t_s,
            distance_mm=here.z,
            camera_mm=here.z + camera.offset_mm,
            u_px=u,
            v_px=v,
            radius_px=radius,
            u_px_s=u_px_s,
            v_px_s=v_px_s,
            marker_visible=inside and not covered,
            stop=radius >= self._radius_threshold_px and here.z <= self._distance_threshold_mm,
            phase=self._phase(speed, leg),
            leg=leg,
            leg_name=self.scenario.legs[leg].name if leg >= 0 else "",
            speed_mm_s=abs(speed),
            truck=self._truck(t_s, leg),
            spout=down,
            lamp=self.scenario.active(FaultKind.RED_LAMP, t_s),
        )

    def distance_mm(self, t_s: float) -> float:
        """Distance from the ranger, vibration included: the path of the sound."""
        return self._here(t_s)[0].z

    def _project(self, here: Vector) -> tuple[float, float, float]:
        camera = self.scenario.camera
        cx, cy = camera.centre_px
        scale = camera.focal_px / (here.z + camera.offset_mm)
        return cx + scale * here.x, cy + scale * here.y, scale * self.scenario.marker.radius_mm

    def _behind_spout(self, down: float, u: float, v: float, radius: float) -> bool:
        """Does the spout cover anything of the marker?"""
        if down <= 0:
            return False
        left, right, edge = spout_box(self.scenario.camera, down)
        return edge > v - radius and left < u + radius and right > u - radius

    def _phase(self, speed: float, leg: int) -> Motion:
        if leg < 0 and speed:
            return Motion.APPROACH if speed > 0 else Motion.RETREAT
        if speed <= 0:
            return Motion.HOLD
        segment = self._segments[leg]
        return Motion.RETREAT if segment.target.z > segment.origin.z else Motion.APPROACH

    def _truck(self, t_s: float, leg: int) -> int:
        """Each repetition of the legs is another truck, too."""
        if leg < 0:
            return 0
        rounds = int(t_s // self.plan_s) if self.scenario.repeat and self.plan_s > 0 else 0
        return rounds * (len(self._others) + 1) + bisect_right(self._others, leg)

    def _here(self, t_s: float) -> tuple[Vector, float, int]:
        """Where the truck is, its speed in mm/s, and the leg."""
        if self._track is not None:
            way, speed = self._track.at(t_s)
            place = self._start._replace(z=self._start.z - way)
            return self._shaken(place, min(1.0, abs(speed) / LOUD_MM_S), t_s), speed, -1
        if not self._segments or t_s < 0:
            return self._shaken(self._start, 0.0, t_s), 0.0, -1
        leg, planned_s = self._leg_and_planned_s(t_s)
        place, speed = self._segments[leg].at(planned_s)
        return self._shaken(place, speed / (10.0 * self.scenario.legs[leg].speed_cm_s), t_s), speed, leg

    def _leg_and_planned_s(self, t_s: float) -> tuple[int, float]:
        waited_s = 0.0
        if self._hold is not None:
            left = self._hold.departures()
            for leg in self._hold.legs:
                end_s = self._segments[leg].end_s
                due_s = end_s + waited_s
                if t_s < due_s:
                    break
                leaves_s = min(max(due_s, left.get(leg, math.inf)), due_s + self._hold.limit_s)
                if t_s < leaves_s:
                    return leg, end_s
                waited_s += leaves_s - due_s
        planned_s = t_s - waited_s
        if self.scenario.repeat and self.plan_s > 0:
            planned_s %= self.plan_s
        return max(0, bisect_right(self._starts, planned_s) - 1), planned_s

    def _shaken(self, place: Vector, drive: float, t_s: float) -> Vector:
        """Add the vibration; `drive` 0 to 1 is the speed as a share of the cruising speed."""
        rest = self.scenario.vibration.rest_share
        loud = rest + (1 - rest) * drive
        if not loud * self.scenario.vibration.amplitude_mm:
            return place
        x, y, z = self._sines
        return Vector(place.x + loud * _sum(x, t_s), place.y + loud * _sum(y, t_s), place.z + loud * _sum(z, t_s))


def spout(scenario: Scenario, t_s: float) -> float:
    """How far the loading spout is down at world time `t_s`, 0 to 1."""
    if not scenario.faults:
        return 0.0
    ways = (
        min((t_s - fault.at_s) / SPOUT_S, (fault.at_s + fault.for_s - t_s) / SPOUT_S, 1.0)
        for fault in scenario.faults
        if fault.kind is FaultKind.SPOUT_DOWN and fault.active(t_s)
    )
    return max(ways, default=0.0)


def spout_box(camera: Camera, down: float) -> tuple[float, float, float]:
    """Left, right and lower edge of the spout in the picture, px; it hangs in the bay and does not move with trucks."""
    half = camera.focal_px * SPOUT_HALF_MM / (SPOUT_MM + camera.offset_mm)
    cx, _ = camera.centre_px
    return cx - half, cx + half, down * camera.height_px


_Sine = tuple[float, float, float]  # amplitude mm, angular frequency 1/s, phase rad


def _sines(vibration: Vibration, seed: int) -> tuple[tuple[_Sine, ...], ...]:
    """Per axis, sines round the middle frequency whose amplitudes add up to the largest excursion."""
    chance = random.Random(f"vibration {seed}")
    axes = []
    for share in (1.0, 1.0, vibration.axial_share):
        weights = [chance.uniform(0.3, 1.0) for _ in range(SINES)]
        axes.append(
            tuple(
                (
                    vibration.amplitude_mm * share * weight / sum(weights),
                    2 * math.pi * vibration.frequency_hz * chance.uniform(0.4, 1.6),
                    chance.uniform(0, 2 * math.pi),
                )
                for weight in weights
            )
        )
    return tuple(axes)


def _sum(sines: tuple[_Sine, ...], t_s: float) -> float:
    total = 0.0
    for amplitude, omega, phase in sines:
        total += amplitude * math.sin(omega * t_s + phase)
    return total
