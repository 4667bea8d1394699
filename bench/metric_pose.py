"""Errors of the metric pose (gateway/core/pose.py) on pictures with exact truth, and whether its deviations hold.

    .venv/bin/python -m bench.metric_pose [--frames 200] [--seed 1]

*Bays* are the simulator's frames, 50 of each bay, the marker anywhere in the picture, found by the robust method.
*Tilted* are drawn discs behind a lens with barrel distortion, leaning by up to 30 degrees (bench/pose.py).
The ranger's readings (jitter, 4 mm steps, the median of three) are of a truck that stands. *exact*: true radius and
temperature are those of the configuration. *drawn*: both are off by their stated deviations, other ones for each frame.
*sensor*: the radius is, and the air is measured by a DS18B20.
"""

import argparse
from collections.abc import Iterator
from itertools import pairwise
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
EXACT = "exact"
Row = tuple[np.ndarray, np.ndarray]  # errors in x, y, z; their stated deviations, mm


def located(found: Detection, lens: Intrinsics, truth: np.ndarray, chance: Random, known: str) -> Row | None:
    """`truth`: x, y, z of the centre in the camera's axes, mm."""
    air_k = {EXACT: 0.0, "drawn": pose.AIR_K, "sensor": pose.MEASURED_AIR_K}[known]
    air_c = AIR_C + chance.gauss(0, air_k)
    echoes = [measure(float(truth[2]), air_c, SensorErrors(1.5, 4.0, 0.0), chance) for _ in range(3)]
    size_mm = RADIUS_MM if known == EXACT else RADIUS_MM / (1 + chance.gauss(0, pose.SIZE_SHARE))
    seen: MetricPose | None = metric_pose(
        VisionReading(0, Quality.GOOD, found.circle, ellipse=found.ellipse, x_n=found.x_n, y_n=found.y_n),
        RangeReading(
            0,
            Quality.GOOD,
            median(distance_mm(e.ticks, AIR_C) for e in echoes),
            air_c=None if known == "drawn" else AIR_C,
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


def bays(distance: float, seed: int, number: int, known: str) -> Iterator[Row]:
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
        row = located(found, LENS, np.array([x, y, z]), chance, known)
        if row is not None:
            yield row


def tilted(seed: int, number: int) -> Iterator[tuple[float, Row]]:
    """Tilt to the line of sight, degrees; errors."""
    for n in range(number):
        seen = seen_disc(10_000 * seed + n)
        if seen is None:
            continue
        u, v = seen.centre
        x_n, y_n = normalise(u, v, seen.lens) or (None, None)
        circle = Circle(u, v, seen.rim.semi_major_px)
        found = Detection(circle, ellipse=seen.rim, x_n=x_n, y_n=y_n)
        truth = seen.scene.position * RADIUS_MM
        row = located(found, seen.lens, truth, Random(f"{seed} {n}"), EXACT)
        if row is not None:
            yield tilt_deg(seen.scene), row


def line(name: str, rows: list[Row], limit_mm: float | None = None) -> str:
    """Errors at the 95th percentile, and the shares of them within one and two stated deviations."""
    if not rows:
        return f"{name:26} no picture"
    errors, deviations = (np.array(part) for part in zip(*rows, strict=True))
    p95 = np.percentile(np.abs(errors), 95, axis=0)
    held = [" ".join(f"{100 * share:.0f}" for share in (np.abs(errors) <= n * deviations).mean(axis=0)) for n in (1, 2)]
    aside, whole = np.percentile(np.hypot(*errors[:, :2].T), 95), np.percentile(np.linalg.norm(errors, axis=1), 95)
    return (
        f"{name:26} {len(rows):5d}  p95 x {p95[0]:5.2f}  y {p95[1]:5.2f}  z {p95[2]:5.2f}  xy {aside:5.2f}  "
        f"xyz {whole:5.2f} mm{'' if limit_mm is None else f' (limit {limit_mm:g})'}; "
        f"x y z within 1 sd: {held[0]}, 2 sd: {held[1]} %; "
        f"median sd {np.median(deviations, axis=0).round(2)}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    for known in (EXACT, "drawn", "sensor"):
        for distance, limit_mm in LIMITS_MM.items():
            rows = list(bays(distance, asked.seed, asked.frames, known))
            print(line(f"bays {distance} mm, {known}", rows, limit_mm), flush=True)
    discs = list(tilted(asked.seed, asked.frames))
    for low, high in pairwise((0, 5, 10, 20, 30, 90)):
        rows = [row for tilt, row in discs if low <= tilt < high]
        print(line(f"tilted {low} to {high} deg", rows), flush=True)


if __name__ == "__main__":
    main()
