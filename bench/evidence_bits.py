"""Are evidence, votes, blobs and red regions the same on another processor, every bit? `python -m bench.evidence_bits`

As `bench.rim_bits`, whose options it takes.
"""

import ctypes
import math
import struct
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from bench.rim_bits import compared, part
from bench.scene import BEYOND, RECIPES, draw
from gateway.core.detection import Circle
from gateway.vision.detect.robust import candidates, measurement, red_change
from gateway.vision.detect.robust.kernel import candidate_kernel
from gateway.vision.detect.robust.kernel.sparse_kernel import RegionTask
from gateway.vision.detect.robust.redness import LOG, PyramidLevel, pyramid, redness
from gateway.vision.pixels import Colours

SHAPE = struct.Struct("=20d")
EVIDENCE, VOTES, BLOBS, REGIONS = range(4)


def asked(pictures: int) -> bytes:
    """Tables and tasks as the program reads them."""
    kernel = measurement.load()
    if kernel is None:
        sys.exit("the vision kernels are not built: ./dev kernel")
    parts = [bytes(kernel.tables), *(values.tobytes() for values in kernel.kept)]
    for recipe in (*RECIPES, *BEYOND):
        for number in range(pictures):
            scene = draw(recipe, 500 + number, (12.0, 90.0))
            truth = scene.truth()
            levels = pyramid(scene.shot(), 1, 8)
            shapes = [
                (
                    truth.u + off,
                    truth.v,
                    major * truth.major,
                    major * truth.minor,
                    math.cos(truth.angle),
                    math.sin(truth.angle),
                )
                for off, major in ((0.3, 1.0), (0.05 * truth.major, 1.1), (-0.2 * truth.major, 0.8), (truth.major, 1.0))
            ]
            parts += of_evidence(levels, shapes, seeds=False)
            parts += of_evidence(levels, [(u, v, a, a, 1.0, 0.0) for u, v, a, *_ in shapes], seeds=True)
            for level in levels[:2]:
                parts += of_candidates(level)
            parts += of_regions(levels[0].bgr, Circle(truth.u, truth.v, truth.major))
    return b"".join(map(part, parts))


def of_evidence(levels: list[PyramidLevel], shapes: Sequence[tuple[float, ...]], *, seeds: bool) -> list[bytes]:
    head = struct.pack("<4q", EVIDENCE, len(levels), len(shapes), seeds)
    described = b"".join(
        struct.pack("<5q", 0, 3 * level.bgr.shape[1], *level.bgr.shape[:2], level.factor) for level in levels
    )
    rows = b"".join(SHAPE.pack(*shape, *[0.0] * 14) for shape in shapes)
    return [head, described, *(level.bgr.tobytes() for level in levels), rows]


def of_candidates(level: PyramidLevel) -> list[bytes]:
    red = np.asarray(cv2.GaussianBlur(redness(level.bgr), (5, 5), 1.0), np.float32)
    if min(red.shape) < 8:
        return []
    planes, radii = candidates.gradients(red), candidates.RADII
    votes = candidate_kernel.VoteTask(
        height=red.shape[0], width=red.shape[1], radius_count=radii.size,
        outer=candidates.blur_weights()[0], middle=candidates.blur_weights()[1],
    )  # fmt: skip
    shares = (ctypes.c_double * len(candidates.SHARES))(*candidates.SHARES)
    blobs = candidate_kernel.BlobTask(0, *red.shape, level.factor, shares, 2.0, 400.0)
    return [
        struct.pack("<q", VOTES), bytes(votes), *(plane.tobytes() for plane in planes), radii.tobytes(),
        struct.pack("<q", BLOBS), bytes(blobs), red.tobytes(),
    ]  # fmt: skip


def of_regions(picture: Colours, followed: Circle) -> list[bytes]:
    step = red_change.sparse_step(picture)
    at, inner_px, outer_px = red_change.disc_of(followed, step)
    task = RegionTask(0, 3 * picture.shape[1], *picture.shape[:2], step, *at, inner_px, outer_px)
    return [struct.pack("<q", REGIONS), bytes(task), picture.tobytes(), LOG.tobytes()]


def main() -> None:
    here = compared(Path(__file__).with_suffix(".c"), asked, __doc__)
    for kind in ("evidence", "votes", "blobs", "regions"):
        print(f"{sum(line.startswith(kind + ' ') for line in here)} with {kind}")


if __name__ == "__main__":
    main()
