"""Pictures made to catch a shortcut out: seeded, small, and of every kind that could matter to an opening."""

from collections.abc import Callable, Iterator

import cv2
import numpy as np

from gateway.config import VisionConfig
from gateway.vision.pixels import Image

Chance = np.random.Generator
Colour = tuple[int, int, int]
PAPER = VisionConfig(method="paper", tracking=False)
SETTINGS = 13  # no multiple of the number of kinds: each kind meets each setting


def frames(seed: int, count: int) -> Iterator[tuple[str, Image, VisionConfig]]:
    """`count` pictures with the name of their kind and a setting to look at them with; half of the settings are the
    paper's."""
    settings = [_setting(np.random.default_rng([seed, 1, n])) for n in range(SETTINGS)]
    for n in range(count):
        chance = np.random.default_rng([seed, n])
        kind = KINDS[n % len(KINDS)]
        yield kind.__name__, kind(chance, _canvas(chance)), PAPER if chance.random() < 0.5 else settings[n % SETTINGS]


def _canvas(chance: Chance) -> Image:
    small = chance.random() < 0.7
    height, width = (int(side) for side in (chance.integers(1, 150, 2) if small else chance.integers(150, 420, 2)))
    return np.full((height, width, 3), chance.integers(0, 256, 3), np.uint8)


def _setting(chance: Chance) -> VisionConfig:
    return VisionConfig(
        method="paper",
        tracking=False,
        gaussian_kernel_px=int(chance.choice([1, 3, 5, 5, 7, 11])),
        gaussian_sigma_px=float(chance.choice([0, 0, 0, 1.3])),
        red_low_2=(int(chance.integers(0, 181)), 43, int(chance.integers(0, 120))),
        morph_kernel_px=int(chance.choice([3, 3, 5, 7])),
        morph_iterations=int(chance.integers(1, 4)),
        min_area_px2=float(chance.choice([0, 20, 100, 400])),
        min_circularity=float(chance.choice([0, 0, 0.3, 0.7])),
        min_fill=float(chance.choice([0, 0, 0.5, 0.7])),
    )


def red(chance: Chance) -> Colour:
    b, g = (int(v) for v in chance.integers(0, 90, 2))
    return b, g, int(chance.integers(90, 256))


def _at(chance: Chance, image: Image, beyond: int = 10) -> tuple[int, int]:
    height, width = image.shape[:2]
    return int(chance.integers(-beyond, width + beyond)), int(chance.integers(-beyond, height + beyond))


def discs(chance: Chance, image: Image) -> Image:
    for _ in range(int(chance.integers(1, 9))):
        cv2.circle(image, _at(chance, image), int(chance.integers(1, 60)), red(chance), -1)
    return image


def bars(chance: Chance, image: Image) -> Image:
    """Long and thin: what plain decimation loses."""
    for _ in range(int(chance.integers(1, 12))):
        x, y = _at(chance, image)
        long, thin = int(chance.integers(5, 200)), int(chance.integers(1, 9))
        across, down = (long, thin) if chance.random() < 0.5 else (thin, long)
        cv2.rectangle(image, (x, y), (x + across - 1, y + down - 1), red(chance), -1)
    return image


def lines(chance: Chance, image: Image) -> Image:
    for _ in range(int(chance.integers(1, 12))):
        cv2.line(image, _at(chance, image), _at(chance, image), red(chance), int(chance.integers(1, 10)))
    return image


def rings(chance: Chance, image: Image) -> Image:
    """With islands in their holes, which are not outside."""
    for _ in range(int(chance.integers(1, 5))):
        at, radius = _at(chance, image), int(chance.integers(5, 90))
        cv2.circle(image, at, radius, red(chance), int(chance.integers(1, 9)))
        cv2.circle(image, at, radius // 3, red(chance), -1)
    return image


def equals(chance: Chance, image: Image) -> Image:
    """Blobs of one size at gaps round the closing's reach: ties, and joined or not by a single pixel."""
    side, colour = int(chance.integers(3, 20)), red(chance)
    x = int(chance.integers(0, 8))
    while x < image.shape[1]:
        y = int(chance.integers(0, 8))
        while y < image.shape[0]:
            if chance.random() < 0.6:
                cv2.rectangle(image, (x, y), (x + side - 1, y + side - 1), colour, -1)
            y += side + int(chance.integers(2, 9))
        x += side + int(chance.integers(2, 9))
    return image


def all_red(chance: Chance, image: Image) -> Image:
    image[:] = red(chance)
    for _ in range(int(chance.integers(0, 6))):
        cv2.circle(image, _at(chance, image), int(chance.integers(1, 40)), (120, 120, 120), -1)
    return image


def edges(chance: Chance, image: Image) -> Image:
    """Red that leaves the picture, a few pixels of it inside."""
    height, width = image.shape[:2]
    for _ in range(int(chance.integers(1, 6))):
        depth, start, colour = int(chance.integers(1, 8)), int(chance.integers(0, max(height, width))), red(chance)
        span = slice(start, start + int(chance.integers(1, 80)))
        match int(chance.integers(4)):
            case 0:
                image[:depth, span] = colour
            case 1:
                image[-depth:, span] = colour
            case 2:
                image[span, :depth] = colour
            case _:
                image[span, -depth:] = colour
    return image


def colour_noise(chance: Chance, image: Image) -> Image:
    return chance.integers(0, 256, image.shape, dtype=np.uint8)


def threshold_noise(chance: Chance, image: Image) -> Image:
    """Smooth colours that wander to and fro across the thresholds."""
    rough = chance.normal((90, 90, 130), (25, 25, 30), (*image.shape[:2], 3))
    smooth = np.asarray(cv2.GaussianBlur(rough, (0, 0), float(chance.uniform(0.8, 5))))
    return np.asarray(np.clip((smooth - smooth.mean()) * float(chance.uniform(1, 8)) + 110, 0, 255), np.uint8)


def greenest_red(chance: Chance, image: Image) -> Image:
    """The red with the most green, and a little less or more of it: here a few pixels, there all, or row by row and
    column by column so that only the blur makes it red. Beside much green, in which nothing can be."""
    height, width = image.shape[:2]
    r = int(chance.integers(46, 90) if chance.random() < 0.5 else chance.integers(60, 256))
    image[:] = (0.7 * r, r, r) if chance.random() < 0.5 else (0.83 * r, 0.89 * r + 3, r)
    bound = np.array([0.832 * r, 0.888 * r, r])
    for _ in range(int(chance.integers(1, 12))):
        x, y = int(chance.integers(0, width)), int(chance.integers(0, height))
        patch = image[y : y + int(chance.integers(1, 40)), x : x + int(chance.integers(1, 70))]
        swing = np.zeros(patch.shape)
        if chance.random() < 0.5:
            swing[:: int(chance.integers(2, 4))] = chance.integers(-40, 41, 3)
        if chance.random() < 0.5:
            swing[:, :: int(chance.integers(2, 4))] += chance.integers(-40, 41, 3)
        near = bound + chance.integers(-4, 5, 3) + chance.normal(0, float(chance.choice([0, 0, 2])), patch.shape)
        patch[:] = np.clip(near + swing - swing.mean(axis=(0, 1)), 0, 255).astype(np.uint8)
    return image


def speckles(chance: Chance, image: Image) -> Image:
    image[chance.random(image.shape[:2]) < chance.uniform(0.02, 0.9)] = red(chance)
    return image


def scene(chance: Chance, image: Image) -> Image:
    """Some of everything, blurred and noisy."""
    for draw in chance.choice(np.array([discs, bars, lines, rings, edges]), 3):
        image = draw(chance, image)
    image = np.asarray(cv2.GaussianBlur(image, (0, 0), 1.0), np.uint8)
    noisy = image + chance.normal(0, chance.uniform(1, 40), image.shape)
    return np.asarray(np.clip(noisy, 0, 255), np.uint8)


KINDS: tuple[Callable[[Chance, Image], Image], ...] = (
    *(discs, bars, lines, rings, equals, all_red, edges, colour_noise, threshold_noise, greenest_red, speckles, scene),
)


class Things:
    """Red discs, bars and rings that move, turn round at the edges, come, go, jump and flicker."""

    def __init__(self, chance: Chance) -> None:
        self._chance = chance
        self._size = (int(chance.integers(60, 300)), int(chance.integers(60, 300)))
        self._noise = float(chance.choice([0, 0, 3, 8]))
        self._things = [self._thing() for _ in range(int(chance.integers(1, 6)))]

    def _thing(self) -> dict[str, float]:
        width, height = self._size
        x, y, vx, vy = (*self._chance.uniform(0, (width, height)), *self._chance.normal(0, 3, 2))
        kind, size, grow = self._chance.integers(3), self._chance.uniform(4, 40), self._chance.normal(0, 0.2)
        return {"x": x, "y": y, "vx": vx, "vy": vy, "kind": kind, "size": size, "grow": grow}

    def frame(self) -> Image:
        chance, (width, height) = self._chance, self._size
        if chance.random() < 0.04:
            self._things.append(self._thing())
        if self._things and chance.random() < 0.03:
            self._things.pop(int(chance.integers(len(self._things))))
        if self._things and chance.random() < 0.03:
            self._things[int(chance.integers(len(self._things)))] |= {"x": chance.uniform(0, width)}
        image = np.full((height, width, 3), 110, np.uint8)
        for thing in self._things:
            thing["x"], thing["y"] = thing["x"] + thing["vx"], thing["y"] + thing["vy"]
            thing["size"] = max(2, thing["size"] + thing["grow"])
            for axis, end in (("x", width), ("y", height)):
                if not 0 < thing[axis] < end:
                    thing["v" + axis] *= -1
            if chance.random() < 0.02:
                continue  # flickers
            x, y, size = int(thing["x"]), int(thing["y"]), int(thing["size"])
            match int(thing["kind"]):
                case 0:
                    cv2.circle(image, (x, y), size, red(chance), -1)
                case 1:
                    cv2.rectangle(image, (x, y), (x + 2 * size, y + 6), red(chance), -1)
                case _:
                    cv2.circle(image, (x, y), size, red(chance), 5)
        noisy = image + chance.normal(0, self._noise, image.shape)
        return np.asarray(np.clip(noisy, 0, 255), np.uint8)
