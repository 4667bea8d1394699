"""What happens between the bay and the picture: light, weather, lens, motion, and things that stand beside the marker.

Each takes a shot and gives another; what it says of the rim stays true.
"""

import math
from dataclasses import replace

import cv2
import numpy as np

from gateway.sim import weather
from gateway.sim.ambient import glare_map
from gateway.sim.benchmark.scene import Shot, TrueRim
from gateway.sim.render import disc_cover
from gateway.sim.scenario import Glare
from gateway.sim.weather import Chance
from gateway.vision.pixels import Image

OCCLUDED = 0.3  # share of the rim
LOST_GREY = 128
ZOOM = 1.5
FLOOR = (96.0, 98.0, 100.0)  # wet concrete, BGR


def veiled(share: float, shot: Shot, chance: Chance) -> Shot:
    return replace(shot, light=weather.veiled(shot.light, share, chance, at=_inside(shot)))


def brighter(least: float, most: float, shot: Shot, chance: Chance) -> Shot:
    """So many times the light."""
    return replace(shot, light=shot.light * np.float32(chance.uniform(least, most)))


def cast(gains: tuple[float, float, float], shot: Shot, chance: Chance) -> Shot:
    """Blue, green and red times these."""
    return replace(shot, light=shot.light * np.array(gains, np.float32))


def rain(shot: Shot, chance: Chance) -> Shot:
    return replace(shot, light=weather.rain(shot.light, chance))


def snow(shot: Shot, chance: Chance) -> Shot:
    return replace(shot, light=weather.snow(shot.light, chance))


def dirt(shot: Shot, chance: Chance) -> Shot:
    return replace(shot, light=weather.dirt(shot.light, chance, (shot.rim.u, shot.rim.v, shot.rim.a)))


def defocused(shot: Shot, chance: Chance) -> Shot:
    """A point becomes a disc of 2.5 to 6 px, at most a quarter of the marker's radius."""
    return replace(shot, light=weather.defocused(shot.light, min(float(chance.uniform(2.5, 6)), 0.25 * shot.rim.a)))


def moving(shot: Shot, chance: Chance) -> Shot:
    """A straight smear of 6 to 20 px, at most half of the marker's radius."""
    length, turn = min(float(chance.uniform(6, 20)), 0.5 * shot.rim.a), float(chance.uniform(0, math.pi))
    along = np.linspace(-length / 2, length / 2, 161)[:, None]
    return replace(shot, light=weather.smeared(shot.light, along * np.array([math.cos(turn), math.sin(turn)])))


def shaken(shot: Shot, chance: Chance) -> Shot:
    """Full swings of a vibration during the exposure, 3 to 8 px to each side: the ends are seen longest."""
    reach = min(float(chance.uniform(3, 8)), 0.25 * shot.rim.a)
    swing = np.linspace(0, 2 * math.pi, 240, endpoint=False)
    way = np.stack([np.cos(swing), 0.4 * np.cos(2 * swing + chance.uniform(0, 6))], axis=1)
    turn = float(chance.uniform(0, math.pi))
    turned = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    return replace(shot, light=weather.smeared(shot.light, reach * way @ turned))


def sun(shot: Shot, chance: Chance) -> Shot:
    """A low sun beside the marker, and what the lens scatters round it."""
    size = float(chance.uniform(0.015, 0.03)) * shot.light.shape[1]
    u, v = _beside(shot, chance, size * float(chance.uniform(1.8, 3.0)))
    glare = Glare(u_px=u, v_px=v, radius_px=size, level=60.0, scatter=0.02)
    height, width = shot.light.shape[:2]
    return replace(shot, light=shot.light + 255 * glare_map(glare, width, height)[..., None])


def tail_lamps(shot: Shot, chance: Chance) -> Shot:
    """Two lit tail lamps, one on either side."""
    away, size = float(chance.uniform(1.75, 2.2)) * shot.rim.a, float(chance.uniform(0.35, 0.55)) * shot.rim.a
    for side in (-1, 1):
        shot = _lamp(shot, shot.rim.u + side * away, shot.rim.v + 0.3 * away, size)
    return shot


def lamp_glow(shot: Shot, chance: Chance) -> Shot:
    """A tail lamp that blinds the camera: white in the middle, a red glow without an edge round it."""
    u, v = _beside(shot, chance, 1.3 * shot.rim.a)
    distance = np.hypot(*_away(shot, u, v)) / np.float32(shot.rim.a)
    core, halo = np.exp(-((distance / 0.22) ** 2)), np.exp(-((distance / 0.8) ** 2))
    added = core[..., None] * np.array((300, 300, 420), np.float32) + halo[..., None] * np.array(
        (18, 14, 190), np.float32
    )
    return replace(shot, light=shot.light + added)


def second_disc(shot: Shot, chance: Chance) -> Shot:
    """The marker is a little out of focus; beside it stands a smaller, darker disc that is sharp."""
    light = weather.defocused(shot.light, min(2.5, 0.08 * shot.rim.a + 0.5))
    size = float(chance.uniform(0.4, 0.65)) * shot.rim.a
    u, v = _beside(shot, chance, size * float(chance.uniform(1.25, 1.6)))
    height, width = light.shape[:2]
    cover = disc_cover(u, v, size, (0, 0, width, height))[..., None]
    return replace(shot, light=light + cover * (np.array((34, 26, 128), np.float32) - light))


def wet_floor(shot: Shot, chance: Chance) -> Shot:
    """A wet floor below the marker mirrors it: dimmer, stretched downwards and rippled."""
    height, width = shot.light.shape[:2]
    line = round(shot.rim.v + shot.rim.a * float(chance.uniform(1.12, 1.3)))
    if line >= height - 2:
        return shot
    y, x = np.mgrid[line:height, 0:width].astype(np.float32)
    ripple = np.sin(y * 0.35 + 2 * np.sin(x * 0.02)) * (1 + (y - line) / 60)
    mirrored = cv2.remap(
        shot.light, x + ripple, 2 * line - y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=FLOOR
    )
    soft = cv2.GaussianBlur(mirrored, (0, 0), sigmaX=1.2, sigmaY=3.5)
    light = shot.light.copy()
    light[line:] = 0.42 * np.array(FLOOR, np.float32) + 0.55 * np.asarray(soft, np.float32)
    return replace(shot, light=light)


def occluded(shot: Shot, chance: Chance) -> Shot:
    """A dull beam before the marker hides 30 % of its rim."""
    turn = float(chance.uniform(0, 2 * math.pi))
    du, dv = _away(shot, shot.rim.u, shot.rim.v)
    along = (
        du * np.float32(math.cos(turn)) + dv * np.float32(math.sin(turn)) - shot.rim.a * math.cos(OCCLUDED * math.pi)
    )
    wide = 0.75 * shot.rim.a
    cover = np.clip(np.minimum(along, wide - along) + 0.5, 0, 1)[..., None]
    tone = float(chance.uniform(40, 130)) * (1 + 0.35 * np.sin(math.pi * np.clip(along / wide, 0, 1)))[..., None]
    beam = tone * np.array((0.96, 1.0, 1.02), np.float32)
    return replace(shot, light=np.asarray(shot.light + cover * (beam - shot.light), np.float32), visible=1 - OCCLUDED)


def reduced(shot: Shot, chance: Chance) -> Shot:
    """320 x 180 for 640 x 480: the upper and lower eighth are cut away, then both sides are halved."""
    height = shot.light.shape[0]
    cut = height // 8
    light = shot.light[cut : height - cut]
    small = cv2.resize(light, (light.shape[1] // 2, light.shape[0] // 2), interpolation=cv2.INTER_AREA)
    rim = shot.rim
    small_rim = TrueRim((rim.u + 0.5) / 2 - 0.5, (rim.v - cut + 0.5) / 2 - 0.5, rim.a / 2, rim.b / 2)
    return replace(shot, light=np.asarray(small, np.float32), rim=small_rim)


def tilted(shot: Shot, chance: Chance) -> Shot:
    """The truck stands 20 to 40 degrees askew: its plane is turned about the marker's centre."""
    (height, width), rim = shot.light.shape[:2], shot.rim
    focal = shot.z_mm * rim.a / 90.0
    camera = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    axis = float(chance.uniform(0, 2 * math.pi))
    angle = math.radians(float(chance.uniform(20, 40)))
    turn = cv2.Rodrigues(np.array([math.cos(axis), math.sin(axis), 0.0]) * angle)[0]
    place = np.linalg.solve(camera, [rim.u, rim.v, 1.0]) * shot.z_mm
    # Enlarged, so that what was rendered fills the frame.
    nearer = np.array([[ZOOM, 0, (1 - ZOOM) * (width - 1) / 2], [0, ZOOM, (1 - ZOOM) * (height - 1) / 2], [0, 0, 1]])
    facing, askew = (camera @ np.column_stack([axes[:, 0], axes[:, 1], place]) for axes in (np.eye(3), turn))
    seen = nearer @ askew
    light = cv2.warpPerspective(
        shot.light,
        seen @ np.linalg.inv(facing),
        (width, height),
        flags=cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return replace(shot, light=np.asarray(light, np.float32), rim=_projected(seen))


def half_lost(image: Image) -> Image:
    """The lower half never arrived."""
    lost = image.copy()
    lost[image.shape[0] // 2 :] = LOST_GREY
    return lost


def _projected(plane: np.ndarray) -> TrueRim:
    """The image of the circle of 90 mm in a plane: C = H^-T diag(1, 1, -r^2) H^-1."""
    back = np.linalg.inv(plane)
    conic = back.T @ np.diag([1.0, 1.0, -(90.0**2)]) @ back
    centre = np.linalg.solve(conic[:2, :2], -conic[:2, 2])
    axes = 1 / np.sqrt(np.linalg.eigvalsh(-conic[:2, :2] / (conic[:2, 2] @ centre + conic[2, 2])))
    return TrueRim(float(centre[0]), float(centre[1]), float(axes[0]), float(axes[1]))


def _away(shot: Shot, u: float, v: float) -> tuple[np.ndarray, np.ndarray]:
    """Of each pixel from a point, px."""
    height, width = shot.light.shape[:2]
    du = np.arange(width, dtype=np.float32)[None, :] - np.float32(u)
    return du, np.arange(height, dtype=np.float32)[:, None] - np.float32(v)


def _beside(shot: Shot, chance: Chance, gap: float) -> tuple[float, float]:
    """A place so far outside of the rim, in the frame if there is one."""
    height, width = shot.light.shape[:2]
    for _ in range(40):
        turn, reach = float(chance.uniform(0, 2 * math.pi)), shot.rim.a + gap
        u, v = shot.rim.u + reach * math.cos(turn), shot.rim.v + reach * math.sin(turn)
        if 0.6 * gap < u < width - 0.6 * gap and 0.6 * gap < v < height - 0.6 * gap:
            break
    return u, v


def _lamp(shot: Shot, u: float, v: float, size: float) -> Shot:
    distance = np.hypot(*_away(shot, u, v))[..., None]
    cover = np.clip(size - distance + 0.5, 0, 1)
    lens = np.array((52, 40, 236), np.float32) * (1.1 - 0.25 * np.minimum(distance / size, 1))
    glow = np.array((14, 10, 90), np.float32) / np.maximum(distance / size, 1) ** 3
    light = shot.light + cover * (lens - shot.light) + (1 - cover) * glow
    return replace(shot, light=np.asarray(light, np.float32))


def _inside(shot: Shot) -> tuple[float, float]:
    height, width = shot.light.shape[:2]
    return min(max(shot.rim.u, 0), width - 1), min(max(shot.rim.v, 0), height - 1)
