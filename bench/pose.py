"""The tilted disc's own centre, from pictures rendered through a perspective camera with lens distortion."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from bench.scene import Recipe, Scene, draw
from gateway.config import Intrinsics
from gateway.core.detection import Ellipse
from gateway.vision.detect.robust.perspective import disc_centre
from gateway.vision.detect.robust.refinement import refine

RECIPE = Recipe("pose", noise=3.0, tilt_deg=30.0)
DISTORTION = (-0.25, 0.08, 0.001, -0.0005)


@dataclass(frozen=True)
class PoseError:
    tilt_deg: float
    before_px: float  # from the disc's own centre to the ellipse's
    after_px: float  # to the weighted centre, with the usual prior


@dataclass(frozen=True)
class SeenDisc:
    """One picture's disc, as it is and as it was found: its rim, and its own centre, px."""

    scene: Scene
    lens: Intrinsics
    rim: Ellipse
    centre: tuple[float, float]


def seen_disc(seed: int) -> SeenDisc | None:
    """Rendered, refined, corrected. None: not found."""
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
    start = Ellipse(float(own[0]), float(own[1]), truth.major, truth.minor, truth.angle)
    rim = refine(scene.shot(), start, max(4.0, truth.minor / 6))
    if rim is None:
        return None
    lens = Intrinsics(fx=scene.focal, fy=scene.focal, cx=scene.width / 2, cy=scene.height / 2, distortion=DISTORTION)
    found = disc_centre(rim.ellipse, lens)
    return None if found is None else SeenDisc(scene, lens, rim.ellipse, found)


def tilt_deg(scene: Scene) -> float:
    """Of the disc against the line of sight."""
    sight = scene.position / np.linalg.norm(scene.position)
    return float(np.degrees(np.arccos(np.clip(scene.rotation[:, 2] @ sight, -1, 1))))


def pose_error(seed: int) -> PoseError | None:
    seen = seen_disc(seed)
    if seen is None:
        return None
    own, rim = seen.scene.project(seen.scene.position[np.newaxis])[0], seen.rim
    return PoseError(
        tilt_deg=tilt_deg(seen.scene),
        before_px=float(np.hypot(rim.u_px - own[0], rim.v_px - own[1])),
        after_px=float(np.hypot(seen.centre[0] - own[0], seen.centre[1] - own[1])),
    )


def table_pose(errors: list[PoseError | None]) -> str:
    rows = [
        "| tilt to the line of sight | pictures | ellipse's centre p50/p95 | weighted centre p50/p95 |",
        "|---|---|---|---|",
    ]
    for low, high in ((0, 10), (10, 20), (20, 40)):
        some = [error for error in errors if error is not None and low <= error.tilt_deg < high]
        if not some:
            continue

        def spread(field: str, some: list[PoseError] = some) -> str:
            values = [getattr(error, field) for error in some]
            return f"{np.percentile(values, 50):.3f}/{np.percentile(values, 95):.3f}"

        rows.append(f"| {low}° to {high}° | {len(some)} | {spread('before_px')} | {spread('after_px')} |")
    return "\n".join(rows) + "\n"
