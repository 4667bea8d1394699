"""How soon a truck in place that begins to move is reported, and how often one that stands is: tables of visit.md.

    python -m bench.guidance.rolling --hours 0.25 --days 4 --jobs 2     of standing, for each noise; then ./dev docs

The gateway's pure step in virtual time, on the simulated ranger's bytes and on circles made from the truth with the
robust method's noise (tests/visit_bench.py). Days of standing are those of the ranger alone: the simulated sensor, the
gateway's conditioning and its rule for a truck that rolls, without the bay around them. Equal arguments give equal
results.
"""

import argparse
import json
import math
import random
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any

from rich.progress import track

from gateway.config import GuidanceConfig, RangerConfig, VisitConfig
from gateway.core import rolling
from gateway.core.events import EventKind
from gateway.core.readings import Quality
from gateway.core.state import Fused, ReferencePosition
from gateway.ranger.conditioning import Conditioner
from gateway.ranger.hcsr04.protocol import PERIOD_MS
from gateway.ranger.hcsr04.session import distance_mm
from gateway.sim.hcsr04 import SensorErrors, measure
from tests.visit_bench import Bench, truck

RESULTS = Path(__file__).resolve().parents[2] / "docs" / "data" / "rolling.json"
SPEEDS_CM_S = (1, 2, 5, 10, 20, 50)
SEEDS = range(30)
JITTERS_MM = (1.5, 2.5)
ACCELERATION_CM_S2 = 100
STANDS_S = 10.0
WITHIN_S = 10.0
CYCLE_S = PERIOD_MS / 1000  # of the ranger: the motions begin at moments spread over it
SPAN_S = 450.0  # one bench stands this long: each draws its own noise

DROPOUT = 0.02
STAND_S = 1200.0  # a truck stands this long, then another one
TRACK = 16  # good distances before it is in place
IDLE_MM, IDLE_HZ = 0.2, 6.0  # the engine, along the ranger's line of sight

Motion = tuple[int, bool, int]  # cm/s, covered, seed
Standing = tuple[float, int]  # jitter in mm, seed


def motion(job: Motion) -> tuple[float, float]:
    """From the first motion until it is reported: s, and the way by then, mm. Raises RuntimeError where the truck was
    not in place, AssertionError where it was not reported within WITHIN_S.
    """
    speed_cm_s, covered, seed = job
    arrival = {"distance_cm": 27, "speed_cm_s": 30, "hold_s": STANDS_S + CYCLE_S * seed / len(SEEDS)}
    leg = {"distance_cm": 60, "speed_cm_s": speed_cm_s, "acceleration_cm_s2": ACCELERATION_CM_S2}
    faults = ({"kind": "marker_hidden", "at_s": 8, "for_s": 60},) if covered else ()
    bench = Bench(truck(arrival, leg, faults=faults, start={"distance_cm": 60}, seed=seed), seed=seed)
    begins_s = next(segment.start_s for segment in bench.world._segments[1:])
    bench.run(begins_s)
    if not bench.state.in_place or bench.state.visit.rolling:
        raise RuntimeError(f"{job}: the truck is not in place before it moves")
    stood_mm = bench.world.distance_mm(begins_s)
    bench.run_until(lambda state: state.visit.rolling, WITHIN_S)
    return round(bench.t_s - begins_s, 2), round(abs(bench.world.distance_mm(bench.t_s) - stood_mm), 1)


def standing(job: Standing) -> tuple[int, float]:
    """`rolling` events of a truck that stands in place, and for how many seconds it was in place."""
    jitter_mm, seed = job
    arrival = {"distance_cm": 27, "speed_cm_s": 30, "hold_s": SPAN_S}
    noise = {"jitter_mm": jitter_mm, "dropout": DROPOUT}
    bench = Bench(truck(arrival, start={"distance_cm": 60}, ranger=noise, seed=seed), seed=seed)
    in_place_s = 0.0
    for second in range(round(SPAN_S)):
        bench.run(float(second + 1))
        bench.moments.clear()
        in_place_s += bench.state.in_place
    return sum(event.kind is EventKind.ROLLING for event in bench.events), in_place_s


def echoes(job: Standing) -> tuple[int, int]:
    """False alarms of one truck that stands for STAND_S, by the ranger alone: of the rule, and of the medians only."""
    jitter_mm, seed = job
    chance = random.Random(f"echoes {jitter_mm} {seed}")
    errors, config, guidance = SensorErrors(jitter_mm, dropout=DROPOUT), VisitConfig(), GuidanceConfig()
    conditioner = Conditioner(RangerConfig(), PERIOD_MS * 1_000_000)
    stands_mm, phase = chance.uniform(200, 300), chance.uniform(0, math.tau)
    references: list[ReferencePosition | None] = [None, None]
    alarms, good = [0, 0], 0
    newest: list[tuple[int, float]] = []
    for number in range(round(STAND_S * 1000 / PERIOD_MS)):
        t_ns = (number + 1) * PERIOD_MS * 1_000_000
        here_mm = stands_mm + IDLE_MM * math.sin(math.tau * IDLE_HZ * t_ns / 1e9 + phase)
        echo = measure(here_mm, 20.0, errors, chance)
        quality = Quality.NO_ECHO if echo.flags else Quality.GOOD
        for reading in conditioner.measured(distance_mm(echo.ticks, 20.0), quality, t_ns, number):
            if reading.distance_mm is None:
                continue
            good += 1
            newest = [*newest, (reading.t_ns, reading.distance_mm)][-TRACK:]
            if good < TRACK:
                continue
            for rule, of_rule in enumerate((reading, replace(reading, echo_mm=None))):
                state = Fused(t_ns, range=of_rule)
                if references[rule] is None:
                    state = replace(state, memory=replace(state.memory, track=tuple(newest)))
                reference = rolling.step(references[rule], state, 0.0, config, guidance)
                alarms[rule] += reference.rolling_since_ns is not None
                references[rule] = reference if reference.rolling_since_ns is None else None
    return alarms[0], alarms[1]


def measured(hours: float, days: float, processes: int) -> dict[str, Any]:
    motions = list(product(SPEEDS_CM_S, (False, True), SEEDS))
    spans = list(product(JITTERS_MM, range(max(1, round(hours * 3600 / SPAN_S)))))
    alone = list(product(JITTERS_MM, range(max(1, round(days * 86_400 / STAND_S)))))
    with ProcessPoolExecutor(processes) as pool:
        found = dict(zip(motions, pool.map(motion, motions), strict=True))
        stood = list(zip(spans, pool.map(standing, spans), strict=True))
        heard = list(zip(alone, track(pool.map(echoes, alone, chunksize=4), total=len(alone)), strict=True))
    rows = []
    for speed, covered in product(SPEEDS_CM_S, (False, True)):
        of_seeds = [found[speed, covered, seed] for seed in SEEDS]
        rows.append({"cm_s": speed, "covered": covered} | _middle_and_most(of_seeds))
    still = []
    for jitter in JITTERS_MM:
        these = [result for (of, _), result in stood if of == jitter]
        in_place_h = round(sum(seconds for _, seconds in these) / 3600, 2)
        still.append({"jitter_mm": jitter, "hours": in_place_h, "rolling": sum(count for count, _ in these)})
    alone_rows = []
    for jitter in JITTERS_MM:
        counts = [counts for (of, _), counts in heard if of == jitter]
        alarms, before = (sum(column) for column in zip(*counts, strict=True))
        stood_d = round(len(counts) * STAND_S / 86_400, 2)
        alone_rows.append({"jitter_mm": jitter, "days": stood_d, "rolling": alarms, "medians_only": before})
    return {"seeds": len(SEEDS), "latency": rows, "standing": still, "covered": alone_rows}


def _middle_and_most(results: Sequence[tuple[float, float]]) -> dict[str, list[float]]:
    seconds, ways = zip(*results, strict=True)
    return {"s": [round(median(seconds), 2), max(seconds)], "mm": [round(median(ways), 1), max(ways)]}


def results() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8"))
    return found


def latency_markdown() -> str:
    lines = [
        "| speed | marker seen: s | mm | marker covered, ranger alone: s | mm |",
        "|---|---|---|---|---|",
    ]
    rows = {(row["cm_s"], row["covered"]): row for row in results()["latency"]}
    for speed in dict.fromkeys(speed for speed, _ in rows):
        cells = []
        for covered in (False, True):
            row = rows[speed, covered]
            cells += [", ".join(f"{s:.2f}" for s in row["s"]), ", ".join(f"{mm:.0f}" for mm in row["mm"])]
        lines.append(f"| {speed} cm/s | {' | '.join(cells)} |")
    return "\n".join(lines)


def standing_markdown() -> str:
    lines = ["| noise of the ranger, mm | hours in place | `rolling` | per hour |", "|---|---|---|---|"]
    for row in results()["standing"]:
        per_h = row["rolling"] / row["hours"]
        lines.append(f"| {row['jitter_mm']:g} | {row['hours']:g} | {row['rolling']} | {per_h:.2g} |")
    return "\n".join(lines)


def covered_markdown() -> str:
    head = "| noise of the ranger, mm | days in place | `rolling` | by the medians alone |"
    lines = [head, "|---|---|---|---|"]
    for row in results()["covered"]:
        lines.append(f"| {row['jitter_mm']:g} | {row['days']:g} | {row['rolling']} | {row['medians_only']} |")
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=2.0, help="of standing, for each noise; default %(default)s")
    parser.add_argument("--days", type=float, default=4.0, help="by the ranger alone; default %(default)s")
    parser.add_argument("--jobs", type=int, default=1, help="processes; default 1")
    args = parser.parse_args()
    RESULTS.write_text(json.dumps(measured(args.hours, args.days, args.jobs), indent=1) + "\n", encoding="utf-8")
    print(latency_markdown(), standing_markdown(), covered_markdown(), sep="\n\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
