"""What the compiled kernels are tried on: discs of all kinds, seeds near them, redness; and one job for each kernel."""

import math
from collections.abc import Callable
from dataclasses import astuple
from typing import Any

import cv2
import numpy as np

from gateway.core.detection import Circle, Ellipse
from gateway.vision.detect.paper.exact.geometry import Box
from gateway.vision.detect.robust.candidates import RADII, SHARES, Seed, blur_weights, gradients
from gateway.vision.detect.robust.red_change import disc_of, sparse_step
from gateway.vision.detect.robust.redness import Plane, pyramid, redness
from gateway.vision.detect.robust.veil import Veil, light_over
from gateway.vision.pixels import Image

Chance = np.random.Generator


def shot(chance: Chance) -> tuple[Image, Ellipse]:
    """A disc of any size, colour, blur and noise, partly hidden, anywhere in or out of a picture of any size."""
    width, height = (int(n) for n in chance.integers(1 if chance.random() < 0.15 else 40, 280, 2))
    middle = np.array((width, height)) / 2
    u, v = (
        middle + chance.uniform(-1.2, 1.2, 2) * middle if chance.random() < 0.5 else middle + chance.uniform(-3, 3, 2)
    )
    major = math.exp(chance.uniform(math.log(2), math.log(140)))
    disc = Ellipse(float(u), float(v), major, major * float(chance.uniform(0.4, 1)), float(chance.uniform(0, math.pi)))
    if chance.random() < 0.1:  # whole numbers: samples on the pixels, edges between two
        disc = Ellipse(round(u), round(v), round(major), round(major), 0.0)
    picture = np.full((height, width, 3), chance.integers(0, 256, 3), np.float64)
    if chance.random() < 0.3:
        picture += chance.normal(0, 30, (height, width, 1))
    drawn = tuple(round(256 * value) for value in astuple(disc)[:4])
    colour = tuple(float(level) for level in chance.integers(0, 256, 3))
    cv2.ellipse(picture, drawn[:2], drawn[2:], math.degrees(disc.angle_rad), 0, 360, colour, -1, cv2.LINE_8, 8)
    if chance.random() < 0.3:
        corner = (round(disc.u_px), round(disc.v_px))
        cv2.rectangle(picture, corner, (corner[0] + 2 * round(major), corner[1] + round(major)), (60, 65, 60), -1)
    if blur := float(chance.choice([0, 0.7, 2, 4])):
        picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), blur), np.float64)
    picture = picture.reshape(height, width, 3)
    picture += chance.normal(0, 1, picture.shape) * chance.choice([0, 0, 3, 10])
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8), disc


def seed_near(chance: Chance, disc: Ellipse) -> Ellipse:
    off = chance.choice([0, 0, 0.03, 0.1]) * disc.semi_major_px * chance.normal(0, 1, 4)
    u, v, major, minor = np.array(astuple(disc)[:4]) + off
    return Ellipse(float(u), float(v), abs(float(major)), abs(float(minor)), disc.angle_rad)


def plane(chance: Chance) -> Plane:
    """The redness of a disc in a picture; a few kinds of noise; few different values, so that many are equal."""
    kind = chance.integers(0, 4)
    if kind == 0:
        return redness(shot(chance)[0])
    shape = tuple(int(n) for n in chance.integers(1, 90, 2))
    if kind == 1:
        return chance.normal(0, 1, shape).astype(np.float32)
    steps = chance.integers(0, 4, shape).astype(np.float32)
    return steps if kind == 2 else np.asarray(cv2.blur(steps, (3, 3)), np.float32)


def paper_job(chance: Chance) -> Callable[[Any], Any]:
    image, _ = shot(chance)
    height, width = image.shape[:2]
    x0, y0 = int(chance.integers(0, width)), int(chance.integers(0, height))
    window = Box(x0, y0, int(chance.integers(x0, width)) + 1, int(chance.integers(y0, height)) + 1)
    red = np.where(chance.random((height, width, 1)) < 0.7, np.array((30, 30, 200), np.uint8), image)
    return lambda kernel: [
        made.tobytes() for some in (image, red) for made in (kernel.mask(some, window), kernel.cleaned(some, window, 5))
    ]


def rim_job(chance: Chance) -> Callable[[Any], Any]:
    image, disc = shot(chance)
    seed, reach = seed_near(chance, disc), (4.0, 10.0, 2.0)[chance.integers(0, 3)]
    opponent = bool(chance.integers(0, 2))

    def job(kernel: Any) -> Any:
        rim = kernel.refine(image, seed, reach, opponent)
        return rim, rim and kernel.fall(image, rim.ellipse, 0.25)

    return job


def evidence_job(chance: Chance) -> Callable[[Any], Any]:
    image, disc = shot(chance)
    levels = pyramid(image, min(int(chance.integers(1, 4)), *image.shape[:2]), 8)
    near = [seed_near(chance, disc) for _ in range(3)]
    seeds = [Seed(e.u_px, e.v_px, max(e.semi_major_px, 1.0), 1.0) for e in near]
    return lambda kernel: (kernel.gather(levels, seeds), kernel.red_ends(levels, disc))


def candidate_job(chance: Chance) -> Callable[[Any], Any]:
    red = plane(chance)
    planes = gradients(red)
    voting = min(red.shape) >= 8
    return lambda kernel: (
        kernel.blobs(red, SHARES, 2, (0.0, 99.0)),
        kernel.votes(planes, RADII, blur_weights()) if voting else None,
    )


def air_job(chance: Chance) -> Callable[[Any], Any]:
    image = np.ascontiguousarray(shot(chance)[0][:150, :150])
    share = chance.random((int(chance.integers(1, 9)), int(chance.integers(1, 9))), np.float32)
    light = light_over(image, Veil(share, (190.0, 200.0, 210.0)))
    gain = float(chance.uniform(1, 8))
    return lambda kernel: (kernel.is_clear(image), kernel.unveiled(image, light, gain).tobytes())


def level_job(chance: Chance) -> Callable[[Any], Any]:
    image = shot(chance)[0].repeat(3, axis=0).repeat(3, axis=1)  # none is too small
    image = image[int(chance.integers(0, 2)) :, int(chance.integers(0, 2)) :]
    return lambda kernel: [kernel.reduced(image, by).tobytes() for by in (2, 3, 8)]


def region_job(chance: Chance) -> Callable[[Any], Any]:
    image, disc = shot(chance)
    step = sparse_step(image)
    place = disc_of(Circle(disc.u_px, disc.v_px, disc.semi_major_px), step)

    def job(kernel: Any) -> Any:
        found = kernel.regions(image, step, *place)
        return found and (found[0].tolist(), found[1])

    return job
