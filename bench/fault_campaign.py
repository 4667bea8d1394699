"""Seeded schedules of faults over the gateway's control path in virtual time, judged by the simulator's truth.

    python -m bench.fault_campaign                                      1,000 schedules
    python -m bench.fault_campaign --schedules 1000000 --jobs 8         a million, in eight processes
    python -m bench.fault_campaign --seed 4711                          exactly this one, step by step
    python -m bench.fault_campaign --seed 4711 --only 0,2               with its first and third fault alone

A schedule begins in one phase of a truck's visit and lets up to five faults of camera, picture, vision process, ranger,
wire, control task, main process, clocks, PLC, network and people overlap within two seconds, while the truck stands,
creeps, drives off, comes, or is another one at once (tests/fault_schedules.py). The gateway's own code runs: ranger
session, vision process monitor, bay control, hub, register image, Modbus request handler (tests/fault_bay.py). A PLC
that follows docs/registers.md polls and writes.

Judged at each scan of the PLC (tests/fault_judge.py): no permit to move or to load that is unsafe by the truth, and
none later than docs/reaction-time.md guarantees. When the faults have ended, the truck must be able to drive up and be
in place again.

Printed: schedules a second, how often each fault and configuration occurred, times to recover, and for each failure
its seed, the fewest faults that still bring it, and the command that replays it. The exit status is 1 if one failed.
"""

import argparse
import json
import logging
import sys
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field

from tests.fault_judge import Outcome, play, shrunk
from tests.fault_schedules import Schedule, schedule

EVERY_S = 10.0  # between two lines of progress
CHUNK = 250  # schedules that a process is given at once


@dataclass
class Failed:
    """One schedule that failed."""

    seed: int
    what: str
    fewest: str  # the schedule with the fewest faults that still fails
    command: str


@dataclass
class Summary:
    """What came of some schedules."""

    schedules: int = 0
    simulated_s: float = 0.0
    faults: Counter[str] = field(default_factory=Counter)
    settings: Counter[str] = field(default_factory=Counter)
    phases: Counter[str] = field(default_factory=Counter)
    failed: list[Failed] = field(default_factory=list)
    cleared: list[int] = field(default_factory=list)  # seeds after which the bay had to be clear first
    moved_ms: Counter[int] = field(default_factory=Counter)  # times to recover, in steps of 20 ms
    placed_ms: Counter[int] = field(default_factory=Counter)

    def add(self, other: "Summary") -> None:
        self.schedules += other.schedules
        self.simulated_s += other.simulated_s
        self.failed += other.failed
        self.cleared += other.cleared
        for name in ("faults", "settings", "phases", "moved_ms", "placed_ms"):
            getattr(self, name).update(getattr(other, name))


def run(seeds: range) -> Summary:
    """Play the schedules of these seeds."""
    summary = Summary()
    for seed in seeds:
        made = schedule(seed)
        outcome = play(made)
        summary.schedules += 1
        summary.simulated_s += outcome.simulated_s
        summary.settings[made.settings] += 1
        summary.phases[f"{made.phase}, {made.truck.split()[0]}"] += 1
        summary.cleared += [seed] if outcome.cleared else []
        summary.faults.update(failure.fault.value for failure in made.failures)
        if outcome.failed:
            summary.failed.append(_failed(made, outcome))
        else:
            summary.moved_ms[round(outcome.moved_s * 1000)] += 1
            summary.placed_ms[round(outcome.placed_s * 1000)] += 1
    return summary


def _failed(made: Schedule, outcome: Outcome) -> Failed:
    fewest = shrunk(made)
    numbers = ",".join(str(made.failures.index(failure)) for failure in fewest.failures)
    command = f"python -m bench.fault_campaign --seed {made.seed} --only {numbers or 'none'}"
    return Failed(made.seed, (outcome.unsafe or [outcome.stuck])[0], str(fewest), command)


def chunks(first: int, count: int) -> Iterator[range]:
    for at in range(first, first + count, CHUNK):
        yield range(at, min(at + CHUNK, first + count))


def share(times: Counter[int], of: float) -> int:
    """The time that this share of them does not exceed, ms."""
    due = of * sum(times.values())
    for ms in sorted(times):
        due -= times[ms]
        if due <= 0:
            return ms
    return 0


def report(total: Summary, seconds: float) -> None:
    print(
        f"{total.schedules:,} schedules in {seconds:.0f} s: {total.schedules / seconds:.1f} a second, "
        f"{total.simulated_s / 3600:.1f} h simulated, {total.simulated_s / seconds:.0f} times real time"
    )
    for what, counts in (("configurations", total.settings), ("truck", total.phases), ("faults", total.faults)):
        print(f"{what}: " + "; ".join(f"{name} {count:,}" for name, count in counts.most_common()))
    for what, times in (
        ("may move again", total.moved_ms),
        ("in place, the way to the mark included", total.placed_ms),
    ):
        if times:
            print(f"{what}: p50 {share(times, 0.5)} ms, p99 {share(times, 0.99)} ms, longest {max(times)} ms")
    seeds = ", ".join(map(str, total.cleared))
    print(f"the bay had to be clear before the sensors agreed again: {len(total.cleared)} {seeds}".rstrip())
    for failed in total.failed:
        print(f"FAILED seed {failed.seed}: {failed.what}\n  {failed.fewest}\n  {failed.command}")
    if not total.failed:
        print("no unsafe permit, and each recovered")


def only_errors() -> None:
    """A simulated gateway that is harmed logs many warnings."""
    logging.getLogger("gateway").setLevel(logging.ERROR)


def replay(seed: int, only: str | None) -> int:
    """One schedule, with each change of an output."""
    made = schedule(seed)
    if only is not None:
        made = made.only(tuple(int(n) for n in only.split(",") if n.strip().isdigit()))
    print(made)
    for leg in made.legs:
        print(f"  leg: {leg}")
    outcome = play(made, print)
    for line in outcome.unsafe:
        print(f"UNSAFE {line}")
    if not outcome.unsafe:
        print(
            "recovered" + ", after the bay was clear" * outcome.cleared
            if outcome.recovered
            else f"NOT RECOVERED: {outcome.stuck}"
        )
    return int(outcome.failed)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--schedules", type=int, default=1000, help="how many; default 1000")
    parser.add_argument("--from", type=int, default=0, dest="first", help="seed of the first; default 0")
    parser.add_argument("--jobs", type=int, default=1, help="processes; default 1")
    parser.add_argument("--json", action="store_true", help="the figures as JSON")
    parser.add_argument("--seed", type=int, help="play this one, and print what happens")
    parser.add_argument("--only", metavar="N,N", help="with --seed: only these of its faults, counted from 0")
    args = parser.parse_args()
    if args.seed is not None:
        only_errors()
        return replay(args.seed, args.only)
    total, begun = Summary(), time.monotonic()
    due = begun + EVERY_S
    with ProcessPoolExecutor(args.jobs, initializer=only_errors) as pool:
        for part in pool.map(run, chunks(args.first, args.schedules)):
            total.add(part)
            for failed in part.failed:
                print(f"FAILED seed {failed.seed}: {failed.what}", file=sys.stderr, flush=True)
            now = time.monotonic()
            if now >= due:
                due = now + EVERY_S
                rate = total.schedules / (now - begun)
                left_s = (args.schedules - total.schedules) / rate
                print(
                    f"{total.schedules:,} of {args.schedules:,}, {rate:.1f} a second, {len(total.failed)} failed, "
                    f"{left_s / 60:.0f} min left",
                    file=sys.stderr,
                    flush=True,
                )
    seconds = time.monotonic() - begun
    if args.json:
        print(json.dumps({"seconds": round(seconds, 1)} | vars(total), default=vars))
    else:
        report(total, seconds)
    return int(bool(total.failed))


if __name__ == "__main__":
    sys.exit(main())
