"""Odds of the beacon: how often good pictures are taken for bad ones, and bad ones for good ones.

    python -m bench.beacon [--minutes 100000] [--seed 1]

Simulated are the brightness at the LED's place, and the code; no pictures. Each minute has one camera: frames at 10, 15
or 30 a second, an exposure of 2 to 30 ms that mixes two states of the LED, a row of a rolling shutter and a delay that
the camera does not report (together 0 to 300 ms), times claimed that scatter by 0 to 5 ms, and a board whose clock is
up to 0.5 % off. The light: an LED that is 6 to 100 grey levels brighter than what is around it, of which dust takes up
to three quarters in waves; noise of 0.5 to 1.5 levels a frame; JPEG as rounding to a step of 0.5 to 2 levels; a lamp
that blinks beside it with up to a fifth of its brightness; and a shadow that drifts. In half of all minutes it is
milder: at least 20 levels, no dust and no lamp.

The correlation is that of gateway/core/beacon.py, over all looks of many minutes at a time; with the first minutes it
is compared with the original.
"""

import argparse
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gateway.core import beacon
from gateway.core.beacon import STEP_NS, Beacon, BeaconLight, BeaconStatus

Array = NDArray[np.float64]
MINUTE_S = 60.0
CYCLE_S = 0.06
BATCH = 120  # minutes at a time, of one frame rate
RATES = (10, 15, 30)
BEFORE_S = 10.0  # the code begins so long before the frames
KINDS = ("frozen", "looped", "foreign", "delayed by 1 s")


@dataclass(frozen=True)
class Minutes:
    """Some minutes of one frame rate, one a row."""

    fps: int
    code: NDArray[np.int8]  # 1 lit, -1 dark, from -BEFORE_S on
    cycle_s: Array
    claimed_s: Array
    level: Array
    lag_s: Array
    hard: NDArray[np.bool_]


def simulated(fps: int, rng: np.random.Generator, shown: NDArray[np.int8] | None = None, late_s: float = 0) -> Minutes:
    """`shown`: the code in the pictures, where it is another than the board's; `late_s`: a further delay."""
    count, frames = BATCH, int(MINUTE_S * fps)
    column = (count, 1)
    code = rng.choice(np.array([-1, 1], dtype=np.int8), (count, int((MINUTE_S + BEFORE_S) / CYCLE_S * 1.01) + 20))
    cycle_s = CYCLE_S * rng.uniform(0.995, 1.005, column)
    true_s = np.arange(frames) / fps + rng.uniform(0, 1 / fps, column)
    lag_s = rng.uniform(0, 0.3, column)
    claimed_s = true_s + rng.uniform(0, 0.005, column) * rng.standard_normal((count, frames))
    claimed_s = np.maximum.accumulate(claimed_s, axis=1)
    hard = rng.random(column) < 0.5
    exposure_s = rng.uniform(0.002, 0.030, column)
    in_picture = code if shown is None else shown
    lit = np.zeros((count, frames))
    for part in np.linspace(-0.5, 0.5, 7):
        lit += states(in_picture, cycle_s, true_s - lag_s - late_s + part * exposure_s) / 7
    contrast = np.where(hard, np.exp(rng.uniform(math.log(6), math.log(100), column)), rng.uniform(20, 100, column))
    dust = np.where(hard, rng.uniform(0, 0.75, column), 0.0)
    wave = 0.5 + 0.5 * np.sin(2 * np.pi * (true_s / rng.uniform(2, 20, column) + rng.random(column)))
    level = contrast * (1 - dust * wave) * (lit + 1) / 2
    lamp = np.where(hard, rng.uniform(0, 0.2, column), 0.0)
    level += contrast * lamp * (((true_s * rng.uniform(1, 3, column)) % 1.0) < 0.5)
    level += contrast * rng.uniform(0, 0.2, column) * np.sin(2 * np.pi * true_s / rng.uniform(3, 60, column))
    level += rng.uniform(0.5, 1.5, column) * rng.standard_normal((count, frames))
    step = rng.uniform(0.5, 2, column)
    return Minutes(fps, code, cycle_s, claimed_s, np.round(level / step) * step, lag_s + late_s, hard[:, 0])


def states(code: NDArray[np.int8], cycle_s: Array, t_s: NDArray[np.floating]) -> NDArray[np.int8]:
    cells = np.floor((t_s + BEFORE_S) / cycle_s).astype(np.int64)
    return np.take_along_axis(code, np.clip(cells, 0, code.shape[1] - 1), axis=1)


def in_steps(minutes: Minutes) -> tuple[NDArray[np.int8], NDArray[np.int64]]:
    """The code at each step, as the original has it: what began within a step counts for all of it. And where in that,
    flat, each frame is at lag 0."""
    step_s = STEP_NS / 1e9
    steps = np.arange(int((BEFORE_S + MINUTE_S) / step_s) + 2 - beacon.EARLIEST)[None, :]
    code = states(minutes.code, minutes.cycle_s, (steps + 1) * step_s - BEFORE_S - 1e-7)
    at = np.clip(np.floor((minutes.claimed_s + BEFORE_S) / step_s + 1e-7), 0, steps.size - 1 + beacon.EARLIEST).astype(
        np.int64
    )
    return code.ravel(), at + np.arange(len(at))[:, None] * steps.size


def followed(minutes: Minutes, lags: NDArray[np.int64]) -> Array:
    """The best r about each minute's lag (steps), for the window that ends at each frame."""
    code, at = in_steps(minutes)
    size, level = int(beacon.FOLLOW_NS / 1e9 * minutes.fps) + 1, minutes.level
    sums = _moving(level, size)
    power = _moving(level * level, size) - sums**2 / size
    found = []
    for offset in range(-beacon.FOLLOW_STEPS, beacon.FOLLOW_STEPS + 1):
        lit = code[at - lags[:, None] - offset].astype(np.float64)
        found.append(_r(_moving(level * lit, size), sums, power, _moving(lit, size), size))
    best: Array = np.maximum.reduce(found)
    return best


def _r(product: Array, sums: Array, power: Array, lit: Array, size: int) -> Array:
    spread = power * (size - lit**2 / size)
    return np.where(spread > 1e-9, (product - sums * lit / size) / np.sqrt(np.maximum(spread, 1e-9)), 0.0)


def _moving(values: Array, size: int) -> Array:
    sums = np.cumsum(values, axis=1)
    sums[:, size:] -= sums[:, :-size].copy()
    return sums[:, size - 1 :]


def searched(minutes: Minutes) -> tuple[Array, NDArray[np.int64]]:
    """The largest significance at each look, and its lag in steps."""
    every, count = int(beacon.SEARCH_LOOK_NS / 1e9 * minutes.fps), beacon.SEARCH_NS // beacon.SEARCH_LOOK_NS
    blocks, size = minutes.level.shape[1] // every, every * count
    shape = len(minutes.level), blocks, every
    code, at = in_steps(minutes)
    at, level = at[:, : blocks * every].reshape(shape), minutes.level[:, : blocks * every].reshape(shape)
    sums = _moving(level.sum(2), count)
    power = _moving((level * level).sum(2), count) - sums**2 / size
    best, lags = np.full(sums.shape, -1.0), np.zeros(sums.shape, dtype=np.int64)
    for lag in range(beacon.EARLIEST, beacon.LATEST + 1, beacon.SEARCH_STEPS):
        lit = code[at - lag]
        product = np.einsum("sbk,sbk->sb", level, lit)
        r = _r(_moving(product, count), sums, power, _moving(lit.sum(2, dtype=np.float64), count), size)
        lags, best = np.where(r > best, lag, lags), np.maximum(best, r)
    independent = min(size, beacon.SEARCH_NS / 1e9 / CYCLE_S)
    return np.arctanh(np.minimum(best, 0.999999)) * math.sqrt(independent - 3), lags


@dataclass
class Count:
    """Of one frame rate."""

    minutes: int = 0
    lost: list[int] = field(default_factory=lambda: [0, 0])  # interruptions of good pictures: mild, hard minutes
    unseen: list[int] = field(default_factory=lambda: [0, 0])  # minutes in which they are never found
    wrong_lag: int = 0  # good pictures found at another lag
    false: int = 0  # looks at which foreign pictures are found
    delays_s: dict[str, list[Array]] = field(default_factory=lambda: {kind: [] for kind in KINDS})


def run_batch(fps: int, rng: np.random.Generator, count: Count) -> None:
    good = simulated(fps, rng)
    count.minutes += BATCH
    lags = np.rint(good.lag_s[:, 0] / (STEP_NS / 1e9)).astype(np.int64)
    every = max(1, math.ceil(beacon.LOOK_NS / 1e9 * fps))
    kept = followed(good, lags)[:, ::every] >= beacon.KEEP_R
    interrupted = (kept[:, :-1] & ~kept[:, 1:]).sum(axis=1)
    z, found = searched(good)
    sure = z >= beacon.FOUND_Z
    count.wrong_lag += int((sure & (np.abs(found - lags[:, None]) > 6)).sum())
    for hard in (0, 1):
        rows = good.hard == bool(hard)
        count.lost[hard] += int(interrupted[rows].sum())
        count.unseen[hard] += int((~sure[rows].any(axis=1)).sum())
    other = rng.choice(np.array([-1, 1], dtype=np.int8), good.code.shape)
    count.false += int((searched(simulated(fps, rng, shown=other))[0] >= beacon.FOUND_Z).sum())


def run_changes(fps: int, rng: np.random.Generator, count: Count) -> None:
    """Good pictures, which at 30 s become bad ones: how long until they are given up."""
    good = simulated(fps, rng)
    lags = np.rint(good.lag_s[:, 0] / (STEP_NS / 1e9)).astype(np.int64)
    frames, at = good.level.shape[1], good.level.shape[1] // 2
    every = max(1, math.ceil(beacon.LOOK_NS / 1e9 * fps))
    size = int(beacon.FOLLOW_NS / 1e9 * fps) + 1
    looked = np.arange(size - 1, frames)[::every]
    for kind in KINDS:
        level = good.level.copy()
        if kind == "frozen":
            level[:, at:] = level[:, at - 1 : at]
        elif kind == "looped":
            loop = 2 * fps
            level[:, at:] = np.tile(level[:, at - loop : at], (1, frames // loop + 1))[:, : frames - at]
        elif kind == "foreign":
            level[:, at:] = level[::-1, at:] * (
                level[:, :at].std(1, keepdims=True) / level[::-1, at:].std(1, keepdims=True)
            )
        else:
            level[:, at:] = good.level[:, at - fps : frames - fps]
        bad = Minutes(fps, good.code, good.cycle_s, good.claimed_s, level, good.lag_s, good.hard)
        kept = followed(bad, lags)[:, ::every] >= beacon.KEEP_R
        usable = kept[:, np.searchsorted(looked, at) - 1]  # else they were given up before
        gone = (looked >= at) & ~kept
        first = looked[np.argmax(gone, axis=1)]
        delay_s = np.where(gone.any(axis=1), (first - at) / fps, np.inf)
        count.delays_s[kind].append(delay_s[usable])


def compared(fps: int, rng: np.random.Generator) -> float:
    """The largest difference of the followed r from the original's, in one minute."""
    minutes = simulated(fps, rng)
    lag, size = 12, int(beacon.FOLLOW_NS / 1e9 * fps) + 1
    theirs = followed(minutes, np.full(BATCH, lag))[0]
    begin_ns = 100_000_000_000
    cycle_ns = float(minutes.cycle_s[0, 0]) * 1e9
    code = tuple((begin_ns + round(n * cycle_ns), bool(lit > 0)) for n, lit in enumerate(minutes.code[0]))
    lags = range(lag - beacon.FOLLOW_STEPS, lag + beacon.FOLLOW_STEPS + 1)
    worst = 0.0
    for end in range(size - 1, minutes.level.shape[1], fps):
        light = tuple(
            BeaconLight(begin_ns + round((minutes.claimed_s[0, n] + BEFORE_S) * 1e9 + 100), float(minutes.level[0, n]))
            for n in range(end - size + 1, end + 1)
        )
        original = Beacon(BeaconStatus.PROVEN, light=light, code=code, period_ns=round(cycle_ns))
        _, r, _ = beacon.best(original, 10**12, lags, beacon.LEAST_FRAMES)
        worst = max(worst, abs(r - max(0.0, float(theirs[end - size + 1]))))
    return worst


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--minutes", type=int, default=100_000, help="simulated, of good and of foreign pictures each")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    print("largest difference from the original's r:", max(compared(fps, rng) for fps in RATES))
    counts = {fps: Count() for fps in RATES}
    rounds = -(-arguments.minutes // (BATCH * len(RATES)))
    for n in range(rounds):
        for fps in RATES:
            run_batch(fps, rng, counts[fps])
            if n % 8 == 0:
                run_changes(fps, rng, counts[fps])
    for fps, count in counts.items():
        print(f"{fps} frames/s, {count.minutes} minutes: interruptions mild {count.lost[0]} hard {count.lost[1]}, "
              f"minutes not found mild {count.unseen[0]} hard {count.unseen[1]}, wrong lag {count.wrong_lag}, "
              f"foreign pictures found {count.false}")  # fmt: skip
        for kind, parts in count.delays_s.items():
            delays = np.concatenate(parts)
            print(f"  {kind}: {delays.size} times, median {np.median(delays):.2f} s, "
                  f"99 % {np.quantile(delays, 0.99):.2f} s, longest {delays.max():.2f} s, "
                  f"later than 2 s {(delays > 2).sum()}")  # fmt: skip


if __name__ == "__main__":
    main()
