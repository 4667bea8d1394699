"""A spout on a trolley, in virtual time: a tractor comes to its place, then the PLC moves the spout over the marker.

The marker stands beside its taught place, leans a little, and is seen by a lens whose focal length and centre are not
quite as configured; the trolley's axes are turned a little against the camera's. Equal arguments give equal results.
"""

import math
from collections.abc import Mapping
from random import Random
from typing import Any

import cv2
import numpy as np

from bench.closed_loop.approach import FOCAL_PX, RADIUS_MM, Aid, Approach, Result, Seen, settings_with
from bench.closed_loop.faults import Failure, Fault
from bench.closed_loop.plc import SPOUT_MM, Place, PlainTrolleyProgram, TrolleyProgram
from gateway.config import GatewayConfig
from gateway.core.detection import Circle, Ellipse
from gateway.sim.vehicles import STEP_S, SpoutTrolley, VehicleKind

TROLLEY = "spout trolley"
AIDS = {Aid.SETPOINT: "pose", Aid.PLAIN: "plain program"}
CENTRE_PX = (320.0, 240.0)
BESIDE_MM = (55.0, 20.0)  # as far as the picture shows all of the marker at the place
TILT = 0.05  # sine, one standard deviation of each axis
LIMIT_S = 60.0
STOOD_S = 0.5  # lowered for so long: the run is over
TURN_RAD = math.radians(0.5)


def config() -> GatewayConfig:
    lens = {"fx": FOCAL_PX, "fy": FOCAL_PX, "cx": CENTRE_PX[0], "cy": CENTRE_PX[1]}
    return settings_with(VehicleKind.TRACTOR, Aid.SETPOINT, vision={"intrinsics": lens})


def disc_mm(along_x: float, along_y: float) -> Any:
    """12 points of the marker's rim about its centre, 12 x 3. Its normal leans by these sines."""
    normal = np.array([along_x, along_y, math.sqrt(1 - along_x**2 - along_y**2)])
    first = np.cross(normal, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    turns = np.linspace(0, 2 * math.pi, 12, endpoint=False)[:, np.newaxis]
    return RADIUS_MM * (np.cos(turns) * first + np.sin(turns) * np.cross(normal, first))


class TrolleyRun(Approach):
    """Runs with `run`. The vehicle drives by the setpoint, whatever the trolley is told by."""

    def __init__(
        self, aid: Aid, seed: int, *, with_faults: bool = False, trace: list[tuple[float, ...]] | None = None
    ) -> None:
        kind = VehicleKind.TRACTOR
        super().__init__(kind, Aid.SETPOINT, seed, config(), with_faults=with_faults, trace=trace)
        self.told_by, drawn = aid, Random(f"trolley {seed}")
        self.start_mm = drawn.uniform(350, 500)
        self.dust = ()
        self.marker_mm = [drawn.uniform(-most, most) for most in BESIDE_MM]
        self.disc_mm = disc_mm(drawn.gauss(0, TILT), drawn.gauss(0, TILT))
        self.focal_px = FOCAL_PX * (1 + drawn.gauss(0, 0.005))
        self.centre_px = (CENTRE_PX[0] + drawn.gauss(0, 1), CENTRE_PX[1] + drawn.gauss(0, 1))
        self.turn_rad = drawn.uniform(-TURN_RAD, TURN_RAD)
        self.speed_mm_s, self.lag_s = drawn.uniform(30, 100), drawn.uniform(0.1, 0.5)
        self.trolley = SpoutTrolley(self.speed_mm_s, self.lag_s)
        place_mm = self.mark_mm - self.config.bays[0].drive.place_mm  # type: ignore[union-attr]
        plain = PlainTrolleyProgram(CENTRE_PX, place_mm / FOCAL_PX)
        self.over = plain if aid is Aid.PLAIN else TrolleyProgram()
        self.goal: Place = (0.0, 0.0)

    @property
    def at(self) -> Place:
        return self.trolley.x_mm, self.trolley.y_mm

    @property
    def spout_mm(self) -> Place:
        """In the camera's axes."""
        (x, y), along, aside = self.at, math.cos(self.turn_rad), math.sin(self.turn_rad)
        return x * along - y * aside, x * aside + y * along

    @property
    def off_mm(self) -> float:
        return math.dist(self.spout_mm, self.marker_mm)

    def run(self) -> Result:
        begun_s = lowered_s = None
        past_mm, collided = 0.0, False
        while self.t_s < LIMIT_S and not collided:
            self.step()
            self.trolley.move(*self.goal, STEP_S)
            if begun_s is None and self.state is not None and self.state.in_place:
                begun_s = self.t_s
            for at, marker in zip(self.spout_mm, self.marker_mm, strict=True):
                past_mm = max(past_mm, math.copysign(1, marker) * at - abs(marker))
            collided = self.over.lowered and self.off_mm > SPOUT_MM
            lowered_s = None if not self.over.lowered else self.t_s if lowered_s is None else lowered_s
            if lowered_s is not None and self.t_s - lowered_s >= STOOD_S and self.t_s >= self._ended_s(self.t_s):
                break
        way_mm = max(map(abs, self.marker_mm))
        return Result(
            seed=self.seed,
            kind=TROLLEY,
            aid=AIDS[self.told_by],
            error_mm=round(self.off_mm, 2),
            deepest_mm=round(-past_mm, 2),
            time_s=round((lowered_s or self.t_s) - (begun_s or 0.0), 2),
            optimal_s=round(self.lag_s + way_mm / self.speed_mm_s, 2),
            in_place=lowered_s is not None,
            collided=collided,
            dust=False,
            faults=tuple(one.fault.name for one in self.failures),
        )

    def plc(self, t_s: float, active: Mapping[Fault, Failure]) -> None:
        newest = next((image for due_s, image in reversed(self.images) if due_s <= t_s), None)
        super().plc(t_s, active)
        if t_s >= 0:
            self.goal = self.over.scan(t_s, newest, self.at)

    def seen(self) -> Seen:
        """The plain program's circle has the ellipse's centre: it knows no lens."""
        rim, noise = self.rim(), self.chance.gauss
        u_px, v_px = rim.u_px + noise(0, 0.1), rim.v_px + noise(0, 0.1)
        major_px, minor_px = rim.semi_major_px + noise(0, 0.15), rim.semi_minor_px + noise(0, 0.15)
        return Circle(u_px, v_px, major_px), Ellipse(u_px, v_px, major_px, minor_px, rim.angle_rad)

    def rim(self) -> Ellipse:
        """The marker's in the picture, exact."""
        points = self.disc_mm + np.array([*self.marker_mm, self.distance_mm])
        seen = self.focal_px * points[:, :2] / points[:, 2:] + np.array(self.centre_px)
        (u_px, v_px), (width, height), degrees = cv2.fitEllipseDirect(seen.astype(np.float32))
        major = math.radians(degrees if width >= height else degrees + 90) % math.pi
        return Ellipse(u_px, v_px, max(width, height) / 2, min(width, height) / 2, major)
