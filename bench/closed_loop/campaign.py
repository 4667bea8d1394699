"""Approaches of driven vehicles: final error, time and collisions, by the setpoint and by a plain program beside it.

    python -m bench.closed_loop.campaign --jobs 2                        1,000 approaches for each vehicle and program
    python -m bench.closed_loop.campaign --faults 100000 --jobs 2        with random faults; collisions are counted
    python -m bench.closed_loop.campaign --seed 7 --kind winch           this one, step by step
    python -m bench.closed_loop.campaign --seed 7 --kind winch --faults 1     this one of those with faults
    python -m bench.closed_loop.campaign --kind "spout trolley"          this one's rows only; the others stay

The gateway's own step runs in virtual time with the PLC's program and the vehicle (bench/closed_loop/approach.py).
Equal seeds draw the same vehicle, start, noise and dust for both programs; five approaches in a row are of one plant,
whose gateway learns from them. The plain program drives the first.

Judged by the vehicle's true place. **Collision**: it comes farther past the mark (Z_th) than `guidance.overshoot_mm`,
where the spout hangs; no setpoint may lead there, whatever has failed. Of a spout on a trolley: it is lowered beside
the marker. Results: docs/data/closed-loop.json, from which
`./dev docs` writes the tables and `python -m bench.closed_loop.report` the figures. The exit status is 1 where a
vehicle that drove by the setpoint, or a spout that followed the pose, collided.
"""

import argparse
import gc
import json
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn, TimeRemainingColumn

from bench.closed_loop.approach import RUNS, Aid, Approach, Result, limits, settings
from bench.closed_loop.plc import SPOUT_MM
from bench.closed_loop.trolley import AIDS, TROLLEY, TrolleyRun
from gateway.core.movement import DriveMemory
from gateway.core.setpoint import DriveState
from gateway.sim.vehicles import VehicleKind

RESULTS = Path(__file__).resolve().parents[2] / "docs" / "data" / "closed-loop.json"
UNSEEN = 100_000  # seeds from here on built nothing
CHUNK = 20
EXAMPLE = (VehicleKind.SHUNTER, UNSEEN + 4)

VEHICLES = "vehicle"
KINDS = (*map(str, VehicleKind), TROLLEY)

Job = tuple[str, Aid, int]


def plant(job: Job) -> list[Result]:
    """All approaches of one plant, whose number is in the job. The plain program learns nothing: one."""
    kind, aid, number = job
    seeds = range(number * RUNS, number * RUNS + (RUNS if aid is Aid.SETPOINT else 1))
    if kind == TROLLEY:
        return [TrolleyRun(aid, seed).run() for seed in seeds]
    return [one.run() for one in _in_a_row(VehicleKind(kind), aid, seeds)]


def _in_a_row(
    kind: VehicleKind, aid: Aid, seeds: range, trace: list[tuple[float, ...]] | None = None
) -> Iterator[Approach]:
    """Each one must have been run before the next is asked for. `trace`: of the last one."""
    learned = None
    for seed in seeds:
        last = seed == seeds[-1]
        one = Approach(kind, aid, seed, settings(kind, aid), learned=learned, trace=trace if last else None)
        yield one
        if aid is Aid.SETPOINT and one.state is not None:
            learned = one.state.memory.drive.resumed()


def faulty(job: Job) -> list[Result]:
    """One approach with faults. What the plant has learned is drawn, too: it may be of another wagon."""
    name, aid, seed = job
    if name == TROLLEY:
        return [TrolleyRun(aid, seed, with_faults=True).run()]
    kind = VehicleKind(name)
    of = limits(kind)
    one = Approach(kind, aid, seed, settings(kind, aid), with_faults=True)
    if aid is Aid.SETPOINT and one.chance.random() < 0.7:
        slips = (one.chance.uniform(0.1, of["lag_s"] + of["latency_s"]),) * 3
        one.state = one.powered(replace(DriveMemory(), slips_s=slips))
    return [one.run()]


def played(todo: Sequence[Job], play: Callable[[Job], list[Result]], jobs: int) -> list[Result]:
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    found: list[Result] = []
    with ProcessPoolExecutor(jobs, initializer=_worker) as pool, Progress(*columns) as progress:
        bar = progress.add_task("", total=len(todo))
        for results in pool.map(play, todo, chunksize=min(CHUNK, max(1, len(todo) // jobs // 4))):
            found += results
            progress.advance(bar)
    return found


def _worker() -> None:
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)


def share_mm(values: Iterable[float], of: float) -> float:
    ascending = sorted(values)
    return ascending[min(len(ascending) - 1, int(of * len(ascending)))]


def figures(results: Sequence[Result], dead_band_mm: float, overshoot_mm: float) -> dict[str, Any]:
    """Of the approaches of one vehicle and program. `clear`: without dust; `later`: not the first of its plant."""
    ended = [one for one in results if one.in_place]
    errors = [one.error_mm for one in results]
    middle = median(errors)
    clear = [one.time_s / one.optimal_s for one in ended if not one.dust] or [0.0]
    later = [one for one in results if one.seed % RUNS] or results
    return {
        "kind": results[0].kind,
        "aid": results[0].aid,
        "approaches": len(results),
        "in_place": round(len(ended) / len(results), 4),
        "error_mm": [round(middle, 1), round(share_mm(map(abs, errors), 0.95), 1)],
        "later_p95_mm": round(share_mm((abs(one.error_mm) for one in later), 0.95), 1),
        "scatter_p95_mm": round(share_mm((abs(error - middle) for error in errors), 0.95), 1),
        "past_band": round(sum(one.error_mm < -dead_band_mm for one in results) / len(results), 4),
        "past_tolerance": sum(-one.deepest_mm > overshoot_mm for one in results),
        "deepest_mm": round(-min(one.deepest_mm for one in results), 1),
        "time_s": [round(median(one.time_s for one in ended), 1), round(share_mm((r.time_s for r in ended), 0.95), 1)],
        "ratio": [round(median(clear), 2), round(share_mm(clear, 0.95), 2)],
        "collisions": sum(one.collided for one in results),
    }


def told_by(kind: str, aid: Aid) -> str:
    return AIDS[aid] if kind == TROLLEY else aid.value


def tolerances_mm(kind: str) -> tuple[float, float]:
    """Past the place, and past the mark; of a spout, past the marker."""
    if kind == TROLLEY:
        return SPOUT_MM, SPOUT_MM
    bay = settings(VehicleKind(kind), Aid.PLAIN).bays[0]
    return limits(VehicleKind(kind))["dead_band_mm"], bay.guidance.overshoot_mm


def compared(first: int, approaches: int, jobs: int, kinds: Sequence[str]) -> dict[str, Any]:
    numbers = range(first // RUNS, (first + approaches) // RUNS)
    todo = [(kind, aid, number) for number in numbers for kind in kinds for aid in Aid]
    results = played(todo, plant, jobs)
    rows = [
        figures(
            [one for one in results if (one.kind, one.aid) == (kind, told_by(kind, aid))],
            *tolerances_mm(kind),
        )
        for kind in kinds
        for aid in Aid
    ]
    examples = {"example": {aid.value: example(aid) for aid in Aid}} if EXAMPLE[0] in kinds else {}
    return {"first_seed": first, "rows": rows, **examples}


def example(aid: Aid) -> list[list[float]]:
    """Time s, distance to the place mm, speed, reference and setpoint mm/s, DriveState; ten a second."""
    kind, seed = EXAMPLE
    trace: list[tuple[float, ...]] = []
    place_mm = 0.0
    for one in _in_a_row(kind, aid, range(seed - seed % RUNS if aid is Aid.SETPOINT else seed, seed + 1), trace):
        one.run()
        place_mm = one.mark_mm - limits(kind)["place_mm"]
    return [[round(t_s, 2), round(mm - place_mm, 1), *(round(v, 1) for v in rest)] for t_s, mm, *rest in trace[::5]]


def with_faults(first: int, approaches: int, jobs: int, kinds: Sequence[str]) -> dict[str, Any]:
    rows = []
    vehicles = [kind for kind in kinds if kind != TROLLEY]
    for aid, some in ((aid, some) for some in (vehicles, [TROLLEY] if TROLLEY in kinds else []) if some for aid in Aid):
        count = approaches if aid is Aid.SETPOINT else approaches // 10
        todo = [(some[seed % len(some)], aid, seed) for seed in range(first, first + count)]
        results = played(todo, faulty, jobs)
        hit = [one for one in results if one.collided]
        rows.append(
            {
                "kind": VEHICLES if some is vehicles else TROLLEY,
                "aid": told_by(some[0], aid),
                "approaches": len(results),
                "collisions": len(hit),
                "collided_with": dict(Counter(name for one in hit for name in set(one.faults)).most_common()),
                "seeds": [f"{one.kind} {one.seed}" for one in hit][:20],
                "faults": dict(Counter(name for one in results for name in one.faults).most_common()),
                "in_place": round(sum(one.in_place for one in results) / len(results), 4),
                "deepest_mm": round(-min(one.deepest_mm for one in results), 1),
            }
        )
    return {"first_seed": first, "rows": rows}


def merged(parts: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What `with_faults` found in blocks of seeds, as if it were one."""
    rows = []
    every = [row for part in parts for row in part["rows"]]
    for kind, aid in dict.fromkeys((row["kind"], row["aid"]) for row in every):
        of = [row for row in every if (row["kind"], row["aid"]) == (kind, aid)]
        count = sum(row["approaches"] for row in of)
        summed = {
            key: dict(sum((Counter(row[key]) for row in of), Counter()).most_common())
            for key in ("collided_with", "faults")
        }
        rows.append(
            {
                "kind": kind,
                "aid": aid,
                "approaches": count,
                "collisions": sum(row["collisions"] for row in of),
                "collided_with": summed["collided_with"],
                "seeds": [seed for row in of for seed in row["seeds"]][:20],
                "faults": summed["faults"],
                "in_place": round(sum(row["in_place"] * row["approaches"] for row in of) / count, 4),
                "deepest_mm": max(row["deepest_mm"] for row in of),
            }
        )
    return {"first_seed": min(part["first_seed"] for part in parts), "rows": rows}


def told(name: str, aid: Aid, seed: int, *, faults: bool) -> None:
    """One approach, at each change of the drive's state and each second; of a trolley the tractor's before it."""
    trace: list[tuple[float, ...]] = []
    kind = VehicleKind.TRACTOR if name == TROLLEY else VehicleKind(name)
    if name == TROLLEY:
        one: Approach = TrolleyRun(aid, seed, with_faults=faults, trace=trace)
    else:
        one = Approach(kind, aid, seed, settings(kind, aid), with_faults=faults, trace=trace)
    for failure in one.failures:
        print(failure)
    result, last = one.run(), (-1.0, -1.0)
    place_mm = one.mark_mm - limits(kind)["place_mm"]
    for t_s, distance_mm, speed, reference, setpoint, state in trace:
        if (int(t_s), state) != last:
            last = (int(t_s), state)
            name = DriveState(int(state)).name if one.aid is Aid.SETPOINT else "stop" if state else ""
            print(f"{t_s:6.2f} s  to the place {distance_mm - place_mm:7.1f} mm  {speed:6.1f} mm/s, reference "
                  f"{reference:5.1f}, setpoint {setpoint:5.1f}  {name}")  # fmt: skip
    print(result)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--approaches", type=int, default=1000, help="for each vehicle and program")
    parser.add_argument("--faults", type=int, metavar="N", help="instead, N approaches with random faults")
    parser.add_argument("--merge", type=Path, nargs="+", metavar="FILE", help="instead, results of --faults in blocks")
    parser.add_argument("--from", type=int, dest="first", default=UNSEEN, help="seed of the first; default %(default)s")
    parser.add_argument("--jobs", type=int, default=1, help="processes; default 1")
    parser.add_argument("--kind", choices=KINDS, help="this one only")
    parser.add_argument("--aid", type=Aid, choices=list(Aid), default=Aid.SETPOINT, help="of one that is told")
    parser.add_argument("--out", type=Path, default=RESULTS, help="the result file; default %(default)s")
    parser.add_argument("--seed", type=int, help="tell this one")
    args = parser.parse_args()
    kinds = [args.kind] if args.kind else list(KINDS)
    if args.seed is not None:
        told(kinds[0], args.aid, args.seed, faults=bool(args.faults))
        return 0
    if args.merge:
        blocks = [json.loads(path.read_text(encoding="utf-8"))["faults"] for path in args.merge]
        part, found = "faults", merged(blocks)
    elif args.faults:
        part, found = "faults", with_faults(args.first, args.faults, args.jobs, kinds)
    else:
        part, found = "comparison", compared(args.first, args.approaches, args.jobs, kinds)
    data = json.loads(args.out.read_text(encoding="utf-8")) if args.out.exists() else {}
    old = data.get(part, {})
    new = {(row["kind"], row["aid"]) for row in found["rows"]}
    rows = [*(row for row in old.get("rows", ()) if (row["kind"], row["aid"]) not in new), *found["rows"]]
    data[part] = old | found | {"rows": rows}
    args.out.parent.mkdir(parents=True, exist_ok=True)
    text = re.sub(r"\[[^][{}]*\]", lambda row: " ".join(row[0].split()), json.dumps(data, indent=1))  # a row a line
    args.out.write_text(text + "\n", encoding="utf-8")
    for row in found["rows"]:
        print(json.dumps(row))
    return int(any(row["collisions"] for row in found["rows"] if row["aid"] != Aid.PLAIN.value))


if __name__ == "__main__":
    sys.exit(main())
