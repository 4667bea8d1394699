"""Errors of the metric pose (gateway/core/pose.py) on pictures with exact truth, and whether its deviations hold.

    .venv/bin/python -m bench.metric_pose [--frames 200] [--seed 1]

*Bays* are the simulator's frames, 50 of each bay, the marker anywhere in the picture, found by the robust method.
*Tilted* are drawn discs behind a lens with barrel distortion, leaning by up to 30 degrees (bench/pose.py).
The ranger's readings (jitter, 4 mm steps, the median of three) are of a truck that stands. *exact*: true radius and
temperature are those of the configuration. *drawn*: both are off by their stated deviations, other ones for each frame.
"""

import argparse
from collections.abc import Iterator
from random import Random
from statistics import median

import numpy as np

from bench.pose import seen_disc, tilt_deg
from gateway.config import FusionConfig, GuidanceConfig, Intrinsics, VisionConfig
from gateway.core import pose
from gateway.core.detection import Circle, Detection
from gateway.core.pose import MetricPose, Sight, metric_pose
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.ranger.hcsr04.session import distance_mm
from gateway.sim.hcsr04 import SensorErrors, measure
from gateway.sim.render import Painter
from gateway.sim.scenario import Camera, Marker, Pose, Scenario
from gateway.sim.world import World
from gateway.vision.detect import registry
from gateway.vision.detect.lens import normalise

RADIUS_MM = 90.0
LENS = Intrinsics(fx=600.0, fy=600.0, cx=319.5, cy=239.5)
AT_MM = 300.0
AIR_C = 20.0
BAY = 50  # frames of one bay
LIMITS_MM = {300: 2.0, 700: 5.0, 1500: 10.0}
"""Distance: what the centre is to keep in 95 % of the pictures."""
Row = tuple[np.ndarray, np.ndarray]  # errors in x, y, z; their stated deviations, mm


def located(found: Detection, lens: Intrinsics, truth: np.ndarray, chance: Random, *, exact: bool) -> Row | None:
    """`truth`: x, y, z of the centre in the camera's axes, mm."""
    air_c = AIR_C if exact else AIR_C + chance.gauss(0, pose.AIR_K)
    echoes = [measure(float(truth[2]), air_c, SensorErrors(1.5, 4.0, 0.0), chance) for _ in range(3)]
    size_mm = RADIUS_MM if exact else RADIUS_MM / (1 + chance.gauss(0, pose.SIZE_SHARE))
    seen: MetricPose | None = metric_pose(
        VisionReading(0, Quality.GOOD, found.circle, ellipse=found.ellipse, x_n=found.x_n, y_n=found.y_n),
        RangeReading(
            0, Quality.GOOD, median(distance_mm(e.ticks, AIR_C) for e in echoes), air_c=AIR_C if exact else None
        ),
        0,
        Sight(lens, sound=True),
        FusionConfig(distance_threshold_mm=AT_MM),
        GuidanceConfig(marker_radius_mm=size_mm),
        0.0,
    )
    if seen is None:
        return None
    at = np.array([seen.x_mm, seen.y_mm, seen.z_mm + AT_MM])
    return at - truth, np.array([seen.x_sd_mm, seen.y_sd_mm, seen.z_sd_mm])


def bays(distance: float, seed: int, number: int, *, exact: bool) -> Iterator[Row]:
    detect = registry.detector(VisionConfig(method="robust", tracking=False, intrinsics=LENS))
    for n in range(number):
        chance = Random(f"{seed} {distance} {n}")
        z = distance + chance.uniform(-20, 20)
        reach = ((half - LENS.fx * RADIUS_MM / z - 4) * z / LENS.fx for half in (LENS.cx, LENS.cy))
        x, y = (chance.uniform(-most, most) for most in reach)
        scenario = Scenario(
            seed=1000 * seed + n // BAY,
            start=Pose(distance_cm=z / 10, lateral_mm=x, vertical_mm=y),
            camera=Camera(focal_px=LENS.fx, cx_px=LENS.cx, cy_px=LENS.cy),
            marker=Marker(radius_mm=RADIUS_MM),
        )
        if n % BAY == 0:
            painter = Painter(scenario)
        found = detect(painter.frame(World(scenario).truth(0.0), n), 0)
        row = located(found, LENS, np.array([x, y, z]), chance, exact=exact)
        if row is not None:
            yield row


def tilted(low_deg: float, high_deg: float, seed: int, number: int) -> Iterator[Row]:
    for n in range(number):
        seen = seen_disc(10_000 * seed + n)
        if seen is None or not low_deg <= tilt_deg(seen.scene) < high_deg:
            continue
        u, v = seen.centre
        x_n, y_n = normalise(u, v, seen.lens) or (None, None)
        circle = Circle(u, v, seen.rim.semi_major_px)
        found = Detection(circle, ellipse=seen.rim, x_n=x_n, y_n=y_n)
        row = located(found, seen.lens, seen.scene.position * RADIUS_MM, Random(f"{seed} {n}"), exact=True)
        if row is not None:
            yield row


def line(name: str, rows: list[Row], limit_mm: float | None = None) -> str:
    """Errors at the 95th percentile, and the share of them within two stated deviations."""
    if not rows:
        return f"{name:26} no picture"
    errors, deviations = (np.array(part) for part in zip(*rows, strict=True))
    p95 = np.percentile(np.abs(errors), 95, axis=0)
    held = 100 * (np.abs(errors) <= 2 * deviations).mean(axis=0)
    aside, whole = np.percentile(np.hypot(*errors[:, :2].T), 95), np.percentile(np.linalg.norm(errors, axis=1), 95)
    return (
        f"{name:26} {len(rows):5d}  p95 x {p95[0]:5.2f}  y {p95[1]:5.2f}  z {p95[2]:5.2f}  xy {aside:5.2f}  "
        f"xyz {whole:5.2f} mm{'' if limit_mm is None else f' (limit {limit_mm:g})'}; "
        f"within 2 sd: x {held[0]:.0f}  y {held[1]:.0f}  z {held[2]:.0f} %; "
        f"median sd {np.median(deviations, axis=0).round(2)}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    for exact in (True, False):
        for distance, limit_mm in LIMITS_MM.items():
            rows = list(bays(distance, asked.seed, asked.frames, exact=exact))
            print(line(f"bays {distance} mm, {'exact' if exact else 'drawn'}", rows, limit_mm), flush=True)
    for low, high in ((0, 10), (10, 20), (20, 40)):
        print(line(f"tilted {low} to {high} deg", list(tilted(low, high, asked.seed, asked.frames))), flush=True)


if __name__ == "__main__":
    main()
