"""What the margins of a teach-in (gateway/core/teach_in.py) do: D at the taught place on other days, and before it.

    .venv/bin/python -m bench.teach_in [--days 60] [--markdown]

A place is taught from a minute of simulated readings. Then trucks stand there on other days: the air is up to 25 K
colder or warmer, R is up to 0.8 % larger or smaller (light, paint), both swing by a fifth of that, and the decision is
equation 14 at every step (`decision = "plain"`), the hardest case. Reported for each margin: the share of ticks with
D = 1 at the place, on the worst day, too; the share 10 cm before it; where D became 1 on the way in.
"""

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass
from random import Random

from rich.console import Console
from rich.table import Table

from gateway.config import BayConfig, FusionConfig
from gateway.core import fusion, teach_in
from gateway.core.detection import Circle
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import StateVector, Tick
from gateway.core.teach_in import Suggestion, TeachSample
from tests import fused

NS_PER_S = 1_000_000_000
TICK_NS = 20_000_000
FRAME_TICKS = 3  # 17 frames a second
ECHO_TICKS = 2  # 25 readings a second
SECONDS = 20.0  # a truck stands this long on each day
SOUND_SHARE = 0.0017  # of Z, for a kelvin
SWING_S = 47.0


@dataclass(frozen=True, slots=True)
class Place:
    """Where a truck is taught, and the sensors' standard deviations there."""

    distance_mm: float
    radius_px: float
    sigma_px: float = 0.25
    sigma_mm: float = 2.5
    step_mm: float = 4.0


@dataclass(frozen=True, slots=True)
class Day:
    """By how much the readings of a day differ from those of the teach-in, as shares; `colder_k` makes Z longer."""

    colder_k: float = 0.0
    radius_share: float = 0.0


PLACES = (
    Place(300.0, 180.0),
    Place(300.0, 180.0, sigma_px=1.2, sigma_mm=6.0),
    Place(700.0, 77.0),
    Place(1500.0, 110.0, sigma_px=0.3, sigma_mm=4.0),
)

MARGINS = ((0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (4.0, 0.005, 0.02), (4.0, 0.01, 0.05), (6.0, 0.02, 0.08))


def readings(place: Place, day: Day, chance: Random, distance_mm: float, t_s: float) -> tuple[Circle, float]:
    """Of a truck that stands, or passes, at this distance. Every reading is a new one."""
    swing = 1 + 0.2 * math.sin(2 * math.pi * t_s / SWING_S)
    radius_px = place.radius_px * place.distance_mm / distance_mm * (1 + day.radius_share * swing)
    echo_mm = distance_mm * (1 + SOUND_SHARE * day.colder_k * swing) + chance.gauss(0, place.sigma_mm)
    u_px, v_px, seen_px = (chance.gauss(true_px, place.sigma_px) for true_px in (320, 240, radius_px))
    return Circle(u_px, v_px, seen_px), round(echo_mm / place.step_mm) * place.step_mm


def taught(place: Place, bay: BayConfig, chance: Random, seconds: float = 60.0) -> Suggestion:
    """From a minute at ten samples a second."""
    samples = []
    for n in range(round(10 * seconds)):
        t_ns = n * NS_PER_S // 10
        circle, echo_mm = readings(place, Day(), chance, place.distance_mm, n / 10)
        samples.append(TeachSample(t_ns, t_ns, circle, t_ns, echo_mm))
    return teach_in.suggest(samples, bay, (640, 480))


def with_values(config: FusionConfig, suggestion: Suggestion) -> FusionConfig:
    """The configuration with what was suggested for `[fusion]`."""
    found = {value.path[1]: value.value for value in suggestion.values if value.path[0] == "fusion"}
    return FusionConfig.model_validate({**config.model_dump(), **found})


def ticks(
    place: Place,
    day: Day,
    chance: Random,
    config: FusionConfig,
    *,
    seconds: float,
    start_mm: float,
    speed_mm_s: float = 0,
) -> Iterator[tuple[float, StateVector]]:
    """True distance and state after each tick, of a truck that stands or comes nearer, by fusion's own step."""
    state = fusion.initial("bay1", 0)
    for n in range(round(seconds * NS_PER_S / TICK_NS)):
        now_ns = n * TICK_NS
        distance_mm = start_mm - speed_mm_s * now_ns / NS_PER_S
        circle, echo_mm = readings(place, day, chance, distance_mm, now_ns / NS_PER_S)
        if n % FRAME_TICKS == 0:
            state = fused.step(state, VisionReading(now_ns, Quality.GOOD, circle), now_ns, config)
        if n % ECHO_TICKS == 0:
            state = fused.step(state, RangeReading(now_ns, Quality.GOOD, echo_mm), now_ns, config)
        state = fused.step(state, Tick(), now_ns, config)
        if n >= FRAME_TICKS:  # both sensors have sent something
            yield distance_mm, state


def share_of_stop(
    place: Place, day: Day, chance: Random, config: FusionConfig, *, start_mm: float, seconds: float
) -> float:
    """Of the ticks, with a truck that stands at `start_mm`."""
    found = [state.d is True for _, state in ticks(place, day, chance, config, seconds=seconds, start_mm=start_mm)]
    return sum(found) / len(found)


def first_stop_mm(place: Place, day: Day, chance: Random, config: FusionConfig) -> float:
    """How far before the taught place D becomes 1 on the way in at 10 cm/s; negative: beyond it."""
    start_mm = place.distance_mm + 300
    for distance_mm, state in ticks(place, day, chance, config, seconds=4.0, start_mm=start_mm, speed_mm_s=100):
        if state.d:
            return distance_mm - place.distance_mm
    return -math.inf


def days(count: int, chance: Random) -> list[Day]:
    return [Day(chance.uniform(-25, 25), chance.uniform(-0.008, 0.008)) for _ in range(count)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--days", type=int, default=60)
    parser.add_argument("--markdown", action="store_true")
    args = parser.parse_args()
    rows = []
    for place in PLACES:
        for sigmas, of_radius, of_distance in MARGINS:
            teach_in.NOISE_SIGMAS, teach_in.RADIUS_SHARE, teach_in.DISTANCE_SHARE = sigmas, of_radius, of_distance
            margins = f"{sigmas:g} σ, {100 * of_radius:g} % of R, {100 * of_distance:g} % of Z"
            rows.append(_row(place, margins, args.days))
    heads = ("place", "margins", "R_th, Z_th", "D = 1 there", "worst day", "10 cm before", "D = 1 first")
    if args.markdown:
        print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
        print("\n".join(f"| {' | '.join(row)} |" for row in rows))
        return
    table = Table(*heads)
    for row in rows:
        table.add_row(*row)
    Console().print(table)


def _row(place: Place, margins: str, count: int) -> tuple[str, ...]:
    chance = Random(f"{place} {margins}")
    bay = BayConfig(fusion=FusionConfig(decision="plain"))
    suggestion = taught(place, bay, chance)
    name = f"{place.distance_mm:.0f} mm, {place.radius_px:.0f} px, σ {place.sigma_px:g} px, {place.sigma_mm:g} mm"
    if suggestion.refusals:
        return name, margins, suggestion.refusals[0][:40], "", "", "", ""
    config = with_values(bay.fusion, suggestion)
    there, before, first = [], [], []
    for day in days(count, chance):
        there.append(share_of_stop(place, day, chance, config, start_mm=place.distance_mm, seconds=SECONDS))
        start_mm = place.distance_mm + teach_in.BEFORE_MM
        before.append(share_of_stop(place, day, chance, config, start_mm=start_mm, seconds=SECONDS))
        first.append(first_stop_mm(place, day, chance, config))
    return (
        name,
        margins,
        f"{config.radius_threshold_px:.1f} px, {config.distance_threshold_mm:.0f} mm",
        f"{100 * sum(there) / count:.2f} %",
        f"{100 * min(there):.1f} %",
        f"{100 * max(before):.2f} %",
        f"{min(first):.0f} to {max(first):.0f} mm before",
    )


if __name__ == "__main__":
    main()
