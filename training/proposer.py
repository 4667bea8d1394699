"""Trains the net that proposes where the marker might be, and writes gateway/vision/detect/robust/proposer.onnx.

    ./dev sync; uv sync --group training          # JAX for the CPU, and onnx
    python -m training.proposer                   # docs: README.md

Seeded: the same versions on the same kind of processor give the same file. Its metadata hold the recipe.
"""

import argparse
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from time import process_time
from typing import Any

os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")

import jax
import jax.numpy as jnp
import numpy as np

from gateway.vision.detect.robust import proposer, proposer_file
from gateway.vision.detect.robust.proposer import CELL, CHANNELS, HEIGHT, RADIUS_PX, WIDTH
from training.export import to_onnx
from training.scene import Chance, Place, Scene
from training.scenes import scenes
from training.source import source_sum
from training.weather import Sample, weathered

ROWS, COLUMNS = HEIGHT // CELL, WIDTH // CELL
SAME = 1e-3  # OpenCV's answer and the framework's
Weights = dict[str, Any]  # name -> array: `<layer>.w` (out, in, height, width) and `<layer>.b` (out,)
Arrays = tuple[Any, ...]

# Name, channels in and out, side, stride, dilation.
LAYERS: tuple[tuple[str, int, int, int, int, int], ...] = (
    ("stem", CHANNELS, 16, 3, 2, 1),
    ("down4", 16, 24, 3, 2, 1),
    ("at4", 24, 24, 3, 1, 1),
    ("down8", 24, 48, 3, 2, 1),
    ("at8", 48, 48, 3, 1, 1),
    ("down16", 48, 64, 3, 2, 1),
    ("at16", 64, 64, 3, 1, 1),
    ("wide16", 64, 64, 3, 1, 2),
    ("down32", 64, 64, 3, 2, 1),
    ("at32", 64, 64, 3, 1, 1),
    ("up16", 64, 64, 1, 1, 1),
    ("side16", 64, 48, 1, 1, 1),
    ("side8", 48, 48, 1, 1, 1),
    ("join8", 48, 48, 3, 1, 1),
    ("up8", 48, 24, 1, 1, 1),
    ("side4", 24, 24, 1, 1, 1),
    ("join", 24, 24, 3, 1, 1),
    ("head", 24, 4, 1, 1, 1),
)


@dataclass(frozen=True, slots=True)
class Recipe:
    seed: int = 1
    scenes: int = 5000
    steps: int = 8000
    batch: int = 8
    rate: float = 1.5e-3


def started(chance: Chance) -> Weights:
    weights: Weights = {}
    for name, inner, outer, side, _, _ in LAYERS:
        scale = np.sqrt(2 / (inner * side * side)) * (0.1 if name == "head" else 1.0)
        weights[f"{name}.w"] = jnp.asarray(chance.standard_normal((outer, inner, side, side)) * scale, jnp.float32)
        weights[f"{name}.b"] = jnp.zeros(outer, jnp.float32)
    weights["head.b"] = weights["head.b"].at[0].set(-4.0)  # a centre is rare
    return weights


def maps(weights: Weights, x: Any) -> Any:
    """(N, CHANNELS, HEIGHT, WIDTH) to (N, 4, ROWS, COLUMNS): logit of a centre, its place in the cell, log radius."""
    strides = {name: (side, stride, wide) for name, _, _, side, stride, wide in LAYERS}

    def layer(name: str, x: Any) -> Any:
        side, stride, wide = strides[name]
        pad = wide * (side // 2)
        y = jax.lax.conv_general_dilated(
            x, weights[f"{name}.w"], (stride, stride), ((pad, pad), (pad, pad)), rhs_dilation=(wide, wide)
        )
        return y + weights[f"{name}.b"][None, :, None, None]

    def twice(x: Any) -> Any:
        return jnp.repeat(jnp.repeat(x, 2, axis=2), 2, axis=3)

    relu = jax.nn.relu
    x = relu(layer("stem", x))
    at4 = relu(layer("down4", x))
    at4 = at4 + relu(layer("at4", at4))
    at8 = relu(layer("down8", at4))
    at8 = at8 + relu(layer("at8", at8))
    at16 = relu(layer("down16", at8))
    at16 = at16 + relu(layer("at16", at16))
    at16 = at16 + relu(layer("wide16", at16))
    at32 = relu(layer("down32", at16))
    at32 = at32 + relu(layer("at32", at32))
    at16 = at16 + twice(layer("up16", at32))
    at8 = relu(layer("side8", at8) + twice(layer("side16", at16)))
    at8 = at8 + relu(layer("join8", at8))
    at4 = relu(layer("side4", at4) + twice(layer("up8", at8)))
    at4 = at4 + relu(layer("join", at4))
    return layer("head", at4)


def targets(markers: Sequence[Place]) -> np.ndarray:
    """(5, ROWS, COLUMNS): how near a cell is to a centre, the three values of the others, and their weight there."""
    wanted = np.zeros((5, ROWS, COLUMNS), np.float32)
    y, x = np.mgrid[0:ROWS, 0:COLUMNS] + 0.5
    for u, v, radius in markers:
        column, row = (u + 0.5) / CELL, (v + 0.5) / CELL  # of the grid of cells
        sigma = max(0.7, 0.18 * radius / CELL)
        near = np.exp(-((x - column) ** 2 + (y - row) ** 2) / (2 * sigma * sigma))
        near[min(ROWS - 1, int(row)), min(COLUMNS - 1, int(column))] = 1.0
        weight = np.where(near > 0.3, near, 0) / near[near > 0.3].sum()
        size = np.full_like(near, np.log(radius / RADIUS_PX))
        wanted = np.where(near > wanted[0], np.stack([near, column - x, row - y, size, weight]), wanted)
    return wanted.astype(np.float32)


def loss(weights: Weights, x: Any, wanted: Any) -> Any:
    """Focal loss of the centres (as in CenterNet) and absolute errors of the place and the size at the centre."""
    out = maps(weights, x)
    near, logit = wanted[:, 0], out[:, 0]
    sure = jax.nn.sigmoid(logit)
    is_centre = near >= 1.0
    hit = jnp.where(is_centre, -((1 - sure) ** 2) * jax.nn.log_sigmoid(logit), 0.0)
    miss = jnp.where(is_centre, 0.0, -((1 - near) ** 4) * sure**2 * jax.nn.log_sigmoid(-logit))
    errors = jnp.abs(out[:, 1:4] - wanted[:, 1:4]) * jnp.array([0.5, 0.5, 1.0])[None, :, None, None]
    return (hit.sum() + miss.sum() + (errors * wanted[:, 4:5]).sum()) / x.shape[0]


def step(state: Arrays, number: Any, rate: Any, x: Any, wanted: Any) -> tuple[Arrays, Any]:
    """Adam, with the gradient's norm limited."""
    weights, first, second = state
    value, slope = jax.value_and_grad(loss)(weights, x, wanted)
    norm = jnp.sqrt(sum(jnp.sum(g * g) for g in slope.values()))
    share = jnp.minimum(1.0, 5.0 / (norm + 1e-6))
    made: tuple[Weights, Weights, Weights] = ({}, {}, {})
    for name, weight in weights.items():
        g = slope[name] * share
        m, s = 0.9 * first[name] + 0.1 * g, 0.99 * second[name] + 0.01 * g * g
        m_hat, s_hat = m / (1 - 0.9**number), s / (1 - 0.99**number)
        made[0][name] = weight - rate * (m_hat / (jnp.sqrt(s_hat) + 1e-8) + 1e-4 * weight)
        made[1][name], made[2][name] = m, s
    return made, value


def batch(known: list[Scene], chance: Chance, size: int) -> tuple[np.ndarray, np.ndarray]:
    x, wanted = np.zeros((size, CHANNELS, HEIGHT, WIDTH), np.float32), np.zeros((size, 5, ROWS, COLUMNS), np.float32)
    for n in range(size):
        sample = weathered(known[int(chance.integers(len(known)))], chance)
        x[n], wanted[n] = example(sample, int(chance.choice([HEIGHT, 120, 120, 90])))
    return x, wanted


def example(sample: Sample, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Of the picture only the upper `rows`: the cameras' formats are wider than the net's."""
    within = [marker for marker in sample.markers if marker[1] < rows]
    return proposer.blob(proposer.inputs(sample.picture[:rows]))[0], targets(within)


def train(recipe: Recipe, known: list[Scene], keep: Callable[[Weights], None]) -> Weights:
    """`keep` gets the weights every 1000 steps, too."""
    chance = np.random.default_rng([recipe.seed, 2])
    weights = started(np.random.default_rng([recipe.seed, 3]))
    state: Arrays = (weights, jax.tree.map(jnp.zeros_like, weights), jax.tree.map(jnp.zeros_like, weights))
    advance, begun, lately = jax.jit(step), process_time(), 0.0
    for number in range(1, recipe.steps + 1):
        done = number / recipe.steps
        rate = recipe.rate * min(1.0, number / 100) * (0.5 * (1 + np.cos(np.pi * done)) + 0.01)
        state, value = advance(state, float(number), float(rate), *batch(known, chance, recipe.batch))
        lately += float(value)
        if number % 250 == 0:
            took_s = process_time() - begun
            print(f"step {number} of {recipe.steps}: loss {lately / 250:.3f}, {took_s:.0f} s", flush=True)
            lately = 0.0
        if number % 1000 == 0:
            keep(dict(state[0]))
    return dict(state[0])


def check_export(data: bytes, weights: Weights, x: np.ndarray) -> None:
    """Raises ValueError where OpenCV's answer to pictures `x` is not the framework's."""
    answers = np.asarray(maps(weights, x)).copy()
    answers[:, 0] = 1 / (1 + np.exp(-answers[:, 0]))
    net = proposer.made(data)
    apart = max(float(np.abs(net.maps(x[n : n + 1]) - answers[n]).max()) for n in range(len(x)))
    print(f"OpenCV and JAX differ by {apart:.1e} at most", flush=True)
    if apart > SAME:
        raise ValueError("OpenCV does not read the net as it was written")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, value in asdict(Recipe()).items():
        parser.add_argument(f"--{name}", type=type(value), default=value)
    parser.add_argument("--out", type=Path, default=proposer_file.PATH)
    args = vars(parser.parse_args())
    out = args.pop("out")
    recipe, begun = Recipe(**args), process_time()
    about = {**{key: str(value) for key, value in asdict(recipe).items()}, "source": source_sum()}

    known: list[Scene] = []

    def keep(weights: Weights) -> None:
        data = to_onnx({name: np.asarray(value) for name, value in weights.items()}, LAYERS, about)
        check_export(data, weights, batch(known, np.random.default_rng([recipe.seed, 4]), recipe.batch)[0])
        out.write_bytes(data)
        count = sum(weight.size for weight in weights.values())
        print(f'{out}: {count} weights, {len(data)} bytes, SHA256 = "{sha256(data).hexdigest()}"', flush=True)

    for scene in scenes(recipe.seed, recipe.scenes):
        known.append(scene)
        if len(known) % 1000 == 0:
            print(f"{len(known)} scenes of {recipe.scenes}, {process_time() - begun:.0f} s", flush=True)
    keep(train(recipe, known, keep))


if __name__ == "__main__":
    main()
