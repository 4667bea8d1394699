"""The tilted disc's own centre and pose, from pictures rendered through a perspective camera with lens distortion."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from bench.scene import Recipe, draw
from gateway.config import Intrinsics
from gateway.core.detection import Ellipse
from gateway.vision.detect.robust.perspective import disc_pose
from gateway.vision.detect.robust.refinement import refine

RECIPE = Recipe("pose", noise=3.0, tilt_deg=30.0)
DISTORTION = (-0.25, 0.08, 0.001, -0.0005)


@dataclass(frozen=True)
class PoseError:
    tilt_deg: float
    before_px: float  # from the disc's own centre to the ellipse's
    after_px: float  # to the weighted centre, with the usual prior
    spread_px: float  # and what it was said to be
    first_right: bool  # the likelier pose is the true one
    known_px: float  # to the centre, where the side it tilts to is known (as of a disc that is followed)
    normal_deg: float  # error of that pose's normal
    distance_percent: float  # error of that pose's distance


def pose_error(seed: int) -> PoseError | None:
    """One picture: rendered, refined, corrected."""
    cv2.setNumThreads(1)
    scene = draw(RECIPE, seed, (45.0, 110.0))
    # A larger frame, with the disc anywhere in it.
    wide = 3 * scene.width
    rng = np.random.default_rng([seed, 2])
    depth = float(scene.position[2])
    focal = scene.focal * 2
    reach = (wide - scene.width) / 2
    away = rng.uniform(-reach, reach, 2) * depth * 2 / focal
    scene = replace(
        scene,
        width=wide,
        height=wide,
        focal=focal,
        position=np.array([away[0], away[1], 2 * depth]),
        distortion=DISTORTION,
    )
    own = scene.project(scene.position[np.newaxis])[0]
    truth = scene.truth()  # of the undistorted rim: near enough to start from
    rim = refine(scene.shot(), Ellipse(float(own[0]), float(own[1]), truth.major, truth.minor, truth.angle))
    if rim is None:
        return None
    lens = Intrinsics(fx=scene.focal, fy=scene.focal, cx=scene.width / 2, cy=scene.height / 2, distortion=DISTORTION)
    normal = -scene.rotation[:, 2]
    found = disc_pose(rim.ellipse, lens, 1.0)
    told = disc_pose(
        rim.ellipse,
        lens,
        1.0,
        facing=(float(normal[0]), float(normal[1]), float(normal[2])),
        usual_tilt_rad=0.02,
        usually=1.0,
    )
    if found is None or told is None:
        return None
    best = told.poses[0]
    angles = [float(np.arccos(np.clip(np.dot(pose.normal, normal), -1, 1))) for pose in found.poses]
    sight = scene.position / np.linalg.norm(scene.position)
    return PoseError(
        tilt_deg=float(np.degrees(np.arccos(np.clip(-normal @ sight, -1, 1)))),
        before_px=float(np.hypot(rim.ellipse.u_px - own[0], rim.ellipse.v_px - own[1])),
        after_px=float(np.hypot(found.u_px - own[0], found.v_px - own[1])),
        spread_px=found.spread_px,
        first_right=angles[0] <= angles[1],
        known_px=float(np.hypot(best.u_px - own[0], best.v_px - own[1])),
        normal_deg=float(np.degrees(np.arccos(np.clip(np.dot(best.normal, normal), -1, 1)))),
        distance_percent=100 * abs(best.centre_mm[2] / scene.position[2] - 1) if best.centre_mm else float("nan"),
    )


def table_pose(errors: list[PoseError | None]) -> str:
    rows = [
        "| tilt to the line of sight | pictures | ellipse's centre p50/p95 | weighted centre p50/p95 "
        "| likelier pose right | centre, side known p50/p95 | normal p50 | distance p50 |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for low, high in ((0, 10), (10, 20), (20, 40)):
        some = [error for error in errors if error is not None and low <= error.tilt_deg < high]
        if not some:
            continue

        def spread(field: str, some: list[PoseError] = some) -> str:
            values = [getattr(error, field) for error in some]
            return f"{np.percentile(values, 50):.3f}/{np.percentile(values, 95):.3f}"

        right = sum(error.first_right for error in some) / len(some)
        rows.append(
            f"| {low}° to {high}° | {len(some)} | {spread('before_px')} | {spread('after_px')} | {right:.0%} "
            f"| {spread('known_px')} | {np.median([e.normal_deg for e in some]):.2f}° "
            f"| {np.median([e.distance_percent for e in some]):.3f} % |"
        )
    return "\n".join(rows) + "\n"
