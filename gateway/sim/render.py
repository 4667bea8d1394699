"""What the camera sees: `render(scenario, truth, frame_index)` is a pure function; only painted textures are kept.

The disc is drawn analytically, so its sub-pixel centre and radius are those of the truth. Order of the layers: yard,
truck, marker, motion blur, the bay's own spout and lamp, dust, light, sensor noise.
"""

import math
import random
from copy import copy
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.sim.ambient import ambient, glare_at, glare_map
from gateway.sim.canvas import u8
from gateway.sim.led import Led
from gateway.sim.scenario import DEFAULT_EXPOSURE_MS, Camera, Dust, FaultKind, Glare, Light, Scenario
from gateway.sim.sensor import Sensor
from gateway.sim.spout import Spout
from gateway.sim.textures import COVER, NEAR_MM, TANK_AXES, Surfaces, TextureLevel, surfaces
from gateway.sim.world import Truth
from gateway.vision.exposure.settings import Exposure
from gateway.vision.pixels import Image

NOISE_MARGIN_PX = 64  # the noise pool is so much larger than the frame; a window of it moves about
CLOUD_PER_M = 6.0  # extinction that a cloud of dust adds: four fifths of the light are lost on 28 cm
AIRLIGHT = (206, 206, 204)  # cement dust in the light of the bay, BGR
CEMENT = (152, 158, 160)  # that has set
LED_BODY = (44, 44, 44)  # the beacon's, dark
LED_LEVEL = 0.6  # its light, in units of white
LED_SIZE = 0.8  # of `radius_px`, as far as the light reaches
Box = tuple[int, int, int, int]  # x0, y0, x1, y1 of a window of the frame, px, the last two beyond it

NEUTRAL = 128  # light map value for a gain of 1


def render(scenario: Scenario, truth: Truth, frame_index: int) -> Image:
    """(H, W, 3) uint8 BGR of the scenario's camera at `truth`; `frame_index` picks the sensor noise.

    A new array each time. The first call for a scenario paints its textures (most of a second).
    """
    return _painter(scenario).frame(truth, frame_index)


@lru_cache(maxsize=4)
def _painter(scenario: Scenario) -> "Painter":
    return Painter(scenario)


class Painter:
    """The textures and maps of one scenario, and of the beacon in its camera's view."""

    def __init__(self, scenario: Scenario, led: Led | None = None) -> None:
        self._scenario = scenario
        self._size = (scenario.camera.width_px, scenario.camera.height_px)
        self._surfaces = surfaces(scenario)
        self._spout = Spout(scenario)
        self._light = _light_map(scenario.light, self._size)
        self._dust = _dust_map(scenario.dust, self._size, scenario.seed)
        self._air = np.empty((self._size[1], self._size[0], 3), dtype=np.uint8)
        self._air[:] = AIRLIGHT
        self._noise = _noise_pool(scenario)
        self._glares: dict[Glare, NDArray[np.float32]] = {}
        self._sensor: Sensor | None = None
        self._led = None if led is None else _led_cover(led, self._size)

    def repainted(self, surfaces: Surfaces) -> "Painter":
        """The same bay with other surfaces."""
        made = copy(self)
        made._surfaces = surfaces
        return made

    def frame(self, truth: Truth, frame_index: int, exposure: Exposure | None = None, lit: float = 0.0) -> Image:
        """`exposure`: the camera is set to this; None: it always gives what the scenario says. `lit`: for which part of
        the exposure the beacon's LED was."""
        scenario = self._scenario
        if exposure is not None:
            return self._exposed(truth, frame_index, exposure, lit)
        if scenario.active(FaultKind.CAMERA_BLACK, truth.t_s):
            image: Image = np.zeros((self._size[1], self._size[0], 3), dtype=np.uint8)
            return self._noisy(image, frame_index)
        image = self._surface(truth, scenario.camera.exposure_ms / 1000)
        cv2.multiply(image, self._light, dst=image, scale=self._gain(truth.t_s) / NEUTRAL)
        for glare in glare_at(scenario, truth.t_s):
            share = np.minimum(self._glare(glare) * 255, 255).astype(np.uint8)
            cv2.add(image, cv2.merge([share] * 3), dst=image)
        if self._led is not None and lit > 0:
            (x0, y0, x1, y1), cover = self._led
            part = image[y0:y1, x0:x1]
            part[:] = np.minimum(part + (cover * np.float32(255 * LED_LEVEL * lit))[..., None], 255)
        return self._noisy(image, frame_index)

    def _surface(self, truth: Truth, exposure_s: float) -> Image:
        """Everything but light and noise."""
        image = self._truck(truth)
        self._marker(image, truth)
        image = _blurred(image, truth, exposure_s)
        self._spout.draw(image, truth)
        if self._led is not None:
            box, cover = self._led
            _lay(image, box, np.full((*cover.shape, 3), LED_BODY, np.uint8), cover)
        return self._dusty(image, truth)

    def _gain(self, t_s: float) -> float:
        return brightness(self._scenario.light, t_s) * ambient(self._scenario.ambient, t_s)

    def _exposed(self, truth: Truth, frame_index: int, exposure: Exposure, lit: float) -> Image:
        scenario, exposure_s = self._scenario, exposure.time_us / 1e6
        if self._sensor is None:
            self._sensor = Sensor(*self._size, scenario.seed, noise=scenario.camera.noise > 0)
        light = self._surface(truth, exposure_s) * np.float32(self._gain(truth.t_s) / (255 * NEUTRAL))
        light *= self._light
        for glare in glare_at(scenario, truth.t_s):
            light += self._glare(glare)[..., None]
        if self._led is not None:
            (x0, y0, x1, y1), cover = self._led
            light[y0:y1, x0:x1] += (cover * np.float32(LED_LEVEL * lit))[..., None]
        if scenario.active(FaultKind.CAMERA_BLACK, truth.t_s):
            light[:] = 0
        return self._sensor.picture(light, exposure_s / fills_s(scenario.camera), exposure.gain_db, frame_index)

    def _glare(self, glare: Glare) -> NDArray[np.float32]:
        if glare not in self._glares:
            self._glares[glare] = glare_map(glare, *self._size)
        return self._glares[glare]

    def _truck(self, truth: Truth) -> Image:
        width, height = self._size
        scale = truth.radius_px / self._scenario.marker.radius_mm  # px per mm
        left, top = -truth.u_px / scale, -truth.v_px / scale
        right, bottom = (width - 1 - truth.u_px) / scale, (height - 1 - truth.v_px) / scale
        x, y, across, down = NEAR_MM
        if x + 2 < left and y + 2 < top and right < x + across - 2 and bottom < y + down - 2:
            return _warp(self._surfaces.near, truth, scale, (0, 0, width, height))
        level = _fitting(self._surfaces.truck, scale)
        image = _warp(level, truth, scale, (0, 0, width, height))
        # Well inside the tank's ellipse nothing of the yard can be seen.
        reach = max(abs(left), abs(right)) / TANK_AXES[0], (max(abs(top), abs(bottom)) + 10) / TANK_AXES[1]
        if math.hypot(*reach) > 0.99:
            share = _cover(level, truth, scale, (0, 0, width, height))
            cv2.blendLinear(image, self._surfaces.yard, share, 1 - share, image)
        return image

    def _marker(self, image: Image, truth: Truth) -> None:
        radius = truth.radius_px
        scale = radius / self._scenario.marker.radius_mm
        covered = self._scenario.active(FaultKind.MARKER_HIDDEN, truth.t_s)
        box = _window(truth.u_px, truth.v_px, COVER * radius if covered else radius + 1, self._size)
        if box is None:
            return
        if covered:
            level = _fitting(self._surfaces.cover, scale)
            _lay(image, box, _warp(level, truth, scale, box), _cover(level, truth, scale, box))
            return
        if self._surfaces.paint:
            paint = _warp(_fitting(self._surfaces.paint, scale), truth, scale, box)
            _lay(image, box, paint, disc_cover(truth.u_px, truth.v_px, radius, box))
        if crusted := self._scenario.crusted(truth.t_s):
            _crust(image, truth, crusted)
        if self._surfaces.over:
            level = _fitting(self._surfaces.over, scale)
            if wide := _window(truth.u_px, truth.v_px, -level.left_mm * scale, self._size):
                _lay(image, wide, _warp(level, truth, scale, wide), _cover(level, truth, scale, wide))

    def _dusty(self, image: Image, truth: Truth) -> Image:
        dust = self._scenario.dust
        cloud = CLOUD_PER_M if self._scenario.active(FaultKind.DUST_CLOUD, truth.t_s) else 0.0
        veil = 1 - math.exp(-(dust.density + cloud) * truth.camera_mm / 1000)
        if veil < 1 / 512:
            return image
        width, height = self._size
        at = int(dust.drift_px_s * truth.t_s) % (self._dust.shape[1] - width)
        share = np.clip(self._dust[:height, at : at + width] * np.float32(veil), 0, 1)
        return u8(cv2.blendLinear(self._air, image, share, 1 - share))

    def _noisy(self, image: Image, frame_index: int) -> Image:
        if self._noise is None:
            return image
        width, height = self._size
        place = random.Random(f"noise {self._scenario.seed} {frame_index}")
        x, y = place.randrange(NOISE_MARGIN_PX), place.randrange(NOISE_MARGIN_PX)
        for pool, apply in zip(self._noise, (cv2.add, cv2.subtract), strict=True):
            apply(image, pool[y : y + height, x : x + width], dst=image)
        return image


def fills_s(camera: Camera) -> float:
    """The exposure time, s, at which white fills the range without gain: the scenario's own, if it is not 0."""
    return (camera.exposure_ms or DEFAULT_EXPOSURE_MS) / 1000


def brightness(light: Light, t_s: float) -> float:
    """Light of the complete frame at world time `t_s`; 1 is well exposed."""
    drift = light.drift * math.sin(2 * math.pi * t_s / light.drift_period_s)
    flicker = light.flicker * math.sin(2 * math.pi * light.flicker_hz * t_s)
    return max(0.0, light.level * (1 + drift) * (1 + flicker))


def _crust(image: Image, truth: Truth, share: float) -> None:
    """A part of a ring of cement, from inside the rim to beyond it, about its lowest point."""
    turn = math.pi * (0.5 + np.linspace(-share, share, 90))
    reach = truth.radius_px * np.array([[0.6], [1.1]])
    ring = np.stack([truth.u_px + reach * np.cos(turn), truth.v_px + reach * np.sin(turn)], axis=-1)
    outline = np.concatenate([ring[0], ring[1, ::-1]])
    cv2.fillPoly(image, [np.rint(16 * outline).astype(np.int32)], CEMENT, cv2.LINE_AA, 4)


def disc_cover(u_px: float, v_px: float, radius_px: float, box: Box) -> NDArray[np.float32]:
    """How much of each pixel of a window the disc covers, 0 to 1; pixel centres lie at integers.

    A pixel at distance d from the centre is covered to R - d + 1/2. (R^2 - d^2) / 2R is R - d to 1/(8R) px at the rim
    and needs no root.
    """
    x0, y0, x1, y1 = box
    du = np.arange(x0, x1, dtype=np.float32) - np.float32(u_px)
    dv = np.arange(y0, y1, dtype=np.float32) - np.float32(v_px)
    share = (dv * dv)[:, None] + (du * du)[None, :]
    share *= -1 / (2 * radius_px)
    share += radius_px / 2 + 0.5
    return np.clip(share, 0, 1, out=share)


def _fitting(levels: tuple[TextureLevel, ...], scale: float) -> TextureLevel:
    """The coarsest level that still has at least 0.8 texture pixels to one of the frame."""
    return next((level for level in reversed(levels) if level.scale >= 0.8 * scale), levels[0])


def _lay(image: Image, box: Box, over: Image, share: NDArray[np.float32]) -> None:
    """Blend `over` into a window of the frame."""
    x0, y0, x1, y1 = box
    part = image[y0:y1, x0:x1]
    part[:] = cv2.blendLinear(over, np.ascontiguousarray(part), share, 1 - share)


def _window(u_px: float, v_px: float, half: float, size: tuple[int, int]) -> Box | None:
    x0, y0 = max(0, math.floor(u_px - half)), max(0, math.floor(v_px - half))
    x1, y1 = min(size[0], math.ceil(u_px + half) + 1), min(size[1], math.ceil(v_px + half) + 1)
    return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else None


def _warp(level: TextureLevel, truth: Truth, scale: float, box: Box) -> Image:
    """The texture as seen in the frame's window."""
    return _warped(level.image, level, truth, scale, box)


def _cover(level: TextureLevel, truth: Truth, scale: float, box: Box) -> NDArray[np.float32]:
    """Where the texture covers what is behind it, 0 to 1; outside the texture it does not."""
    x0, y0, x1, y1 = box
    if level.cover is None:
        return np.ones((y1 - y0, x1 - x0), dtype=np.float32)
    return np.multiply(_warped(level.cover, level, truth, scale, box), np.float32(1 / 255))


def _warped(image: Image, level: TextureLevel, truth: Truth, scale: float, box: Box) -> Image:
    x0, y0, x1, y1 = box
    step = level.scale / scale
    matrix = np.array(
        [
            [step, 0.0, (x0 - truth.u_px) * step - level.left_mm * level.scale - 0.5],
            [0.0, step, (y0 - truth.v_px) * step - level.top_mm * level.scale - 0.5],
        ]
    )
    return u8(cv2.warpAffine(image, matrix, (x1 - x0, y1 - y0), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP))


def _blurred(image: Image, truth: Truth, exposure_s: float) -> Image:
    """Motion blur: the mean along the way of the centre during the exposure, which is centred on the truth."""
    du, dv = truth.u_px_s * exposure_s, truth.v_px_s * exposure_s
    if math.hypot(du, dv) < 0.25:
        return image
    return u8(cv2.filter2D(image, -1, _streak(du, dv)))


def _streak(du: float, dv: float) -> NDArray[np.float32]:
    """A line of length (du, dv) px through the middle of a kernel, each point shared among its four neighbours."""
    half = (math.ceil(abs(du) / 2), math.ceil(abs(dv) / 2))
    kernel = np.zeros((2 * half[1] + 1, 2 * half[0] + 1), dtype=np.float32)
    samples = 4 * (half[0] + half[1]) + 1
    for k in range(samples):
        along = (k + 0.5) / samples - 0.5
        x, y = half[0] + along * du, half[1] + along * dv
        i, j = math.floor(x), math.floor(y)
        for a, weight_a in ((i, 1 - (x - i)), (i + 1, x - i)):
            for b, weight_b in ((j, 1 - (y - j)), (j + 1, y - j)):
                if weight_a * weight_b > 0:
                    kernel[b, a] += weight_a * weight_b
    return kernel / np.float32(samples)


def _led_cover(led: Led, size: tuple[int, int]) -> tuple[Box, NDArray[np.float32]] | None:
    """Its window, and how much of each pixel it covers; None: it is not in the picture."""
    radius = LED_SIZE * led.radius_px
    box = _window(led.u_px, led.v_px, radius + 1, size)
    return None if box is None else (box, disc_cover(led.u_px, led.v_px, radius, box))


def _light_map(light: Light, size: tuple[int, int]) -> Image:
    """Gain of every pixel and colour, NEUTRAL = 1: gradient, shadow, vignetting and colour cast."""
    width, height = size
    xs = np.linspace(-1, 1, width, dtype=np.float32)[None, :]
    ys = np.linspace(-1, 1, height, dtype=np.float32)[:, None] * np.float32(height / width)
    turn = math.radians(light.gradient_deg)
    gain = 1 + light.gradient * (xs * math.cos(turn) + ys * math.sin(turn)) - 0.10 * (xs * xs + ys * ys)
    if light.shadow > 0:
        edge = np.clip((xs * 0.8 + ys * 0.6 - 0.12) / 0.03 + 0.5, 0, 1)
        gain = gain * (1 - light.shadow * edge)
    warm = max(0.0, light.warmth)
    blue = max(0.0, -light.warmth)
    cast = np.array([1 - 0.5 * warm + 0.1 * blue, 1 - 0.12 * warm - 0.08 * blue, 1 + 0.1 * warm - 0.25 * blue])
    return u8(np.clip(gain[..., None] * cast * NEUTRAL + 0.5, 0, 255).astype(np.uint8))


def _dust_map(dust: Dust, size: tuple[int, int], seed: int) -> NDArray[np.float32]:
    """Unevenness of the veil, mean 1, wider than the frame and periodic across, so that clouds can drift through it."""
    width, height = size
    chance = np.random.default_rng([seed, 12])
    period = 2 * width
    total = np.zeros((height, period + width), dtype=np.float32)
    for cells, weight in (((4, 10), 0.6), ((11, 30), 0.3), ((36, 90), 0.12)):
        small = chance.standard_normal(cells, dtype=np.float32)
        small = np.concatenate([small, small, small[:, : cells[1] // 2]], axis=1)
        large = cv2.resize(small, (round(2.5 * period), height), interpolation=cv2.INTER_CUBIC)
        total += weight * np.asarray(large, dtype=np.float32)[:, period // 2 : period // 2 + period + width]
    return np.asarray(np.maximum(0, 1 + dust.unevenness * total), dtype=np.float32)


def _noise_pool(scenario: Scenario) -> tuple[Image, Image] | None:
    """Sensor noise as what is added and what is taken away, larger than the frame."""
    sigma = scenario.camera.noise
    if sigma <= 0:
        return None
    chance = np.random.default_rng([scenario.seed, 13])
    shape = (scenario.camera.height_px + NOISE_MARGIN_PX, scenario.camera.width_px + NOISE_MARGIN_PX, 3)
    noise = np.rint(chance.standard_normal(shape, dtype=np.float32) * sigma)
    return np.clip(noise, 0, 255).astype(np.uint8), np.clip(-noise, 0, 255).astype(np.uint8)
