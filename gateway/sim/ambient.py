"""Light that changes with time: dusk, a lamp that comes on, the sun in the picture. Pure."""

import numpy as np
from numpy.typing import NDArray

from gateway.sim.scenario import Glare, LightChange, Scenario


def ambient(changes: tuple[LightChange, ...], t_s: float) -> float:
    """What the light of a scenario is multiplied with at world time `t_s`: each change goes on from the one before."""
    level = 1.0
    for change in changes:
        if t_s < change.at_s:
            break
        share = min(1.0, (t_s - change.at_s) / change.over_s) if change.over_s else 1.0
        level *= (change.level / level) ** share
    return level


def glare_at(scenario: Scenario, t_s: float) -> tuple[Glare, ...]:
    return tuple(glare for glare in scenario.glare if glare.at_s <= t_s < glare.at_s + glare.for_s)


def glare_map(glare: Glare, width_px: int, height_px: int) -> NDArray[np.float32]:
    """(H, W): its light in units of white: a disc, and round it what the lens scatters, falling with the square."""
    du = np.arange(width_px, dtype=np.float32)[None, :] - np.float32(glare.u_px)
    dv = np.arange(height_px, dtype=np.float32)[:, None] - np.float32(glare.v_px)
    distance = np.hypot(du, dv)
    disc = np.clip(glare.radius_px - distance + 0.5, 0, 1)
    beyond = np.maximum(distance / np.float32(glare.radius_px), 1)
    scattered = np.float32(glare.scatter) / (beyond * beyond)
    return np.asarray(glare.level * (disc + (1 - disc) * scattered), np.float32)
