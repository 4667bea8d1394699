"""Simulated drivers come to the bay, with the gateway's guidance and with a bell only, and what came of it.

    python -m bench.guidance.campaign --jobs 8                      1,000 approaches for each profile and aid
    python -m bench.guidance.campaign --grid --approaches 100       the thresholds of SLOW and STOP against each other
    python -m bench.guidance.campaign --against slow_s=2 --approaches 500       other settings against the defaults
    python -m bench.guidance.campaign --seed 7 --profile attentive  this one, as it was at each change of the sign

Each approach runs the gateway's own bay control in virtual time (bench/guidance/approach.py); equal seeds draw the same
driver, truck, start and noise for every aid and setting. The comparison is made on seeds that chose no threshold. Both
results are written to one file, from which `python -m bench.guidance.report` makes the plots and `./dev docs` the
tables of bench/reports/guidance.md.

Each approach is kept in a file once it was driven (--kept): the same command goes on where it was interrupted. A file
of other code is begun anew.

An approach takes 0.17 s of a processor for each 25 s of simulated time: 55 % of it in the gateway's own step, the rest
spread over the ranger's session and board, the camera, the driver and the bay's bookkeeping.
"""

import argparse
import gc
import hashlib
import json
import logging
import re
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from itertools import product
from pathlib import Path
from statistics import mean
from typing import Any

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn, TimeRemainingColumn

from bench.guidance.approach import Result, approach, settings
from bench.guidance.driver import Aid, Profile
from gateway.core.state import GuidanceCode

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "docs" / "data" / "guidance.json"
KEPT = ROOT / ".dev" / "guidance.jsonl"
SIMULATED = ("bench/guidance", "gateway", "tests/visit_bench.py", "tests/fault_bay.py")  # what a result depends on
UNSEEN = 10_000  # seeds from here on chose no threshold
EXAMPLE = (Profile.ATTENTIVE, 0)  # of the time series
GRID: Mapping[str, tuple[float, ...]] = {
    "slow_mm": (500.0, 800.0, 1200.0),
    "slow_s": (2.0, 4.0, 6.0),
    "stop_lead_s": (0.5, 1.0, 1.5, 2.0),
}
CHUNK = 5
BIN_MM = 10
BIN_S = 1
COLLISION_MM = -250.0  # of the mark: the truck has come to the end of the way

Job = tuple[Profile, Aid, int, Mapping[str, float]]


def run(job: Job) -> Result:
    profile, aid, seed, changed = job
    return approach(profile, aid, seed, settings(changed))


def figures(results: Sequence[Result]) -> dict[str, Any]:
    """Of the approaches of one profile and aid. Shares are 0 to 1, times s, distances mm."""
    count = len(results)
    times = sorted(r.time_s for r in results if r.time_s is not None)
    errors = sorted(r.error_mm for r in results)
    return {
        "approaches": count,
        "in_place": share(r.in_place for r in results),
        "d": share(r.d for r in results),
        "overshot": share(r.overshoots > 0 for r in results),
        "collided": share(r.deepest_mm <= COLLISION_MM for r in results),
        "overshoots": round(mean(r.overshoots for r in results), 3),
        "corrections": round(mean(r.corrections for r in results), 3),
        "reversals": round(mean(r.reversals for r in results), 3),
        "signs": round(mean(r.signs for r in results), 2),
        "error_mm": [percentile(errors, of) for of in (0.05, 0.5, 0.95)],
        "off_mm": [percentile(sorted(map(abs, errors)), of) for of in (0.5, 0.95)],
        "time_s": [percentile(times, of) for of in (0.5, 0.95)] if times else None,
        "errors": counted(errors, BIN_MM),
        "times": counted(times, BIN_S),
    }


def counted(values: Iterable[float], width: int) -> dict[str, int]:
    """How many are in each bin, by its lower edge."""
    return {str(edge): count for edge, count in sorted(Counter(int(v // width) * width for v in values).items())}


def share(which: Iterable[bool]) -> float:
    return round(mean(map(float, which)), 4)


def percentile(ascending: Sequence[float], of: float) -> float:
    return ascending[min(len(ascending) - 1, int(of * len(ascending)))]


def jobs(profiles: Iterable[Profile], aids: Iterable[Aid], seeds: range, changed: Mapping[str, float]) -> Iterator[Job]:
    for profile, aid in product(profiles, aids):
        for seed in seeds:
            yield profile, aid, seed, changed


def played(todo: Sequence[Job], processes: int, kept: Path | None = None) -> list[Result]:
    """In the order of `todo`. What `kept` has is not driven again, what is driven is appended to it."""
    found = {} if kept is None else read(kept)
    missing = [job for job in todo if name(job) not in found]
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with ProcessPoolExecutor(processes, initializer=worker) as pool, Progress(*columns) as progress:
        bar = progress.add_task("approaches", total=len(todo), completed=len(todo) - len(missing))
        for job, result in zip(missing, pool.map(run, missing, chunksize=CHUNK), strict=True):
            found[name(job)] = result
            if kept is not None:
                with kept.open("a", encoding="ascii") as file:
                    file.write(json.dumps([name(job), asdict(result)]) + "\n")
            progress.advance(bar)
    return [found[name(job)] for job in todo]


def name(job: Job) -> str:
    profile, aid, seed, changed = job
    return " ".join([profile, aid, str(seed), *(f"{key}={value:g}" for key, value in sorted(changed.items()))])


def read(kept: Path) -> dict[str, Result]:
    """What was driven before by this very code; half a line counts as none. A file of other code is begun anew."""
    code = hashlib.sha256()
    for below in SIMULATED:
        path = ROOT / below
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            code.update(file.read_bytes())
    head = json.dumps(code.hexdigest()) + "\n"
    lines = kept.read_text(encoding="ascii").splitlines(keepends=True) if kept.exists() else []
    if lines[:1] != [head]:
        lines = [head]
    whole = [line for line in lines if line.endswith("\n")]
    kept.parent.mkdir(parents=True, exist_ok=True)
    kept.write_text("".join(whole), encoding="ascii")
    return {key: Result(**result) for key, result in map(json.loads, whole[1:])}


def worker() -> None:
    logging.getLogger("gateway").setLevel(logging.ERROR)
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)  # frozen records make no cycles: the collector took a tenth of the time


def compared(seeds: range, processes: int, kept: Path | None = None) -> dict[str, Any]:
    """Each profile with the display and with the bell, at the default settings."""
    # All rows grow together, so that one that was interrupted can be looked at.
    todo = [job for seed in seeds for job in jobs(Profile, Aid, range(seed, seed + 1), {})]
    results = played(todo, processes, kept)
    rows = [
        {"profile": profile, "aid": aid}
        | figures([r for r in results if (r.profile, r.aid) == (profile.value, aid.value)])
        for profile, aid in product(Profile, Aid)
    ]
    guidance = settings().bays[0].guidance
    used = {key: getattr(guidance, key) for key in (*GRID, "overshoot_mm", "still_mm_s")}
    simulated_h = round(sum(r.way_s for r in results) / 3600, 2)
    found = {"first_seed": seeds.start, "settings": used, "simulated_h": simulated_h, "rows": rows}
    return found | {"example": example(*EXAMPLE)}


def example(profile: Profile, seed: int) -> dict[str, Any]:
    """One approach with each aid, ten times a second: s, true Z - Z_th in mm, the sign, 1 while the bell rings."""
    config = settings()
    mark_mm = config.bays[0].fusion.distance_threshold_mm
    rows: dict[str, Any] = {"profile": profile.value, "seed": seed}
    for aid in Aid:
        trace: list[tuple[float, ...]] = []
        approach(profile, aid, seed, config, trace)
        shown = [(t_s, mm, GuidanceCode(int(code)).name, int(bell)) for t_s, mm, _, code, bell in trace[::5]]
        rows[aid.value] = [[round(t_s, 1), round(mm - mark_mm), sign, bell] for t_s, mm, sign, bell in shown]
    return rows


def grid(seeds: range, processes: int, kept: Path | None = None) -> dict[str, Any]:
    """The display alone, over the thresholds; each with the same drivers, compared with the best one."""
    points = [dict(zip(GRID, values, strict=True)) for values in product(*GRID.values())]
    todo = [job for point in points for job in jobs(Profile, (Aid.DISPLAY,), seeds, point)]
    results = played(todo, processes, kept)
    each = len(todo) // len(points)
    of_points = [results[n * each : (n + 1) * each] for n in range(len(points))]
    rows: list[dict[str, Any]] = []
    for point, of_point in zip(points, of_points, strict=True):
        of_all = figures(of_point)
        of_all.pop("errors")
        of_all.pop("times")
        rows.append(point | of_all)
    chosen = of_points[rows.index(dict(best(rows)))]
    for row, of_point in zip(rows, of_points, strict=True):
        row.update(paired(of_point, chosen))
    return {"first_seed": seeds.start, "rows": rows}


def against(changed: Mapping[str, float], seeds: range, processes: int, kept: Path | None = None) -> dict[str, Any]:
    """The display with other settings against the defaults, driver by driver."""
    each = [list(jobs(Profile, (Aid.DISPLAY,), seeds, settings_)) for settings_ in (changed, {})]
    results = played([*each[0], *each[1]], processes, kept)
    other, default = results[: len(each[0])], results[len(each[0]) :]
    return {"first_seed": seeds.start, "settings": dict(changed), "approaches": len(other)} | paired(other, default)


def paired(other: Sequence[Result], one: Sequence[Result]) -> dict[str, int]:
    """Of the same drivers: how many came past the tolerance only with `other`, and only with `one`."""
    past = [(a.overshoots > 0, b.overshoots > 0) for a, b in zip(other, one, strict=True)]
    return {"past_only_here": past.count((True, False)), "past_only_there": past.count((False, True))}


def key_value(text: str) -> tuple[str, float]:
    key, _, value = text.partition("=")
    return key, float(value)


def best(rows: Sequence[Mapping[str, Any]], alike: float = 0.02) -> Mapping[str, Any]:
    """First the fewest that came past the tolerance; of those within `alike`, the shortest median time to the place."""
    least = min(row["overshot"] for row in rows)
    return min((row for row in rows if row["overshot"] <= least + alike), key=lambda row: row["time_s"][0])


def told(profile: Profile, aid: Aid, seed: int) -> None:
    """One approach, at each change of the sign."""
    trace: list[tuple[float, ...]] = []
    result = approach(profile, aid, seed, settings(), trace)
    last: tuple[float, ...] = ()
    for t_s, distance_mm, speed_mm_s, code, bell in trace:
        if (code, bell) != last:
            last = (code, bell)
            sign = GuidanceCode(int(code)).name
            print(f"{t_s:6.2f} s  {distance_mm:6.0f} mm  {speed_mm_s:5.0f} mm/s  {sign}{', bell' * bool(bell)}")
    print(result)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--approaches", type=int, default=1000, help="for each profile and aid, or point of the grid")
    parser.add_argument("--from", type=int, dest="first", help=f"seed of the first; default {UNSEEN}, of the grid 0")
    parser.add_argument("--jobs", type=int, default=1, help="processes; default 1")
    parser.add_argument("--grid", action="store_true", help="the grid of thresholds instead of the comparison")
    parser.add_argument(
        "--against",
        type=key_value,
        nargs="+",
        metavar="KEY=VALUE",
        help="other settings of [guidance] against the defaults instead, driver by driver, on seeds that chose none",
    )
    parser.add_argument("--out", type=Path, default=RESULTS, help="the result file; default %(default)s")
    parser.add_argument("--kept", type=Path, default=KEPT, help="the single approaches; default %(default)s")
    parser.add_argument("--seed", type=int, help="play this one, and print what happens")
    parser.add_argument("--profile", type=Profile, choices=list(Profile), default=Profile.ATTENTIVE)
    parser.add_argument("--aid", type=Aid, choices=list(Aid), default=Aid.DISPLAY)
    args = parser.parse_args()
    if args.seed is not None:
        worker()
        told(args.profile, args.aid, args.seed)
        return 0
    first = args.first if args.first is not None else 0 if args.grid else UNSEEN
    seeds = range(first, first + args.approaches)
    if args.against:
        part, found = "against", against(dict(args.against), seeds, args.jobs, args.kept)
    elif args.grid:
        part, found = "grid", grid(seeds, args.jobs, args.kept)
    else:
        part, found = "comparison", compared(seeds, args.jobs, args.kept)
    data = json.loads(args.out.read_text(encoding="utf-8")) if args.out.exists() else {}
    data[part] = found
    args.out.parent.mkdir(parents=True, exist_ok=True)
    text = re.sub(r"\[[^][{}]*\]", lambda row: " ".join(row[0].split()), json.dumps(data, indent=1))  # a row a line
    args.out.write_text(text + "\n", encoding="utf-8")
    if args.grid:
        print("best:", best(found["rows"]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
