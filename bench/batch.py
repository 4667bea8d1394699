"""`gateway replay --against` over several recordings: 2 and 4 processes, and a second run, against one process.

Each round runs all of them, one after the other; printed are medians of the ratios to the serial run of the same round.
Every report must be that of the serial run to the byte.
"""

import argparse
import statistics
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.recorded_bay import CONFIG, Recorded, with_visits
from tests.visit_bench import Bench, truck

OTHER = '[fusion]\nradius_threshold_px = 160\n[modbus]\nwrites = true\nplc_addresses = ["10.0.0.9"]\n'
RUNS = {"1 process": ("--jobs", "1"), "2 processes": ("--jobs", "2"), "4 processes": ("--jobs", "4")}


def recorded(folder: Path, number: int, seconds: int, segment_s: int) -> None:
    """One gateway's trucks, every 40 s or so."""
    kept = Recorded(folder, f"plant{number}.gateway")
    legs = [{"distance_cm": cm, "speed_cm_s": 60, "hold_s": 12} for _ in range(seconds // 30) for cm in (28, 390)]
    bench = Bench(truck(*legs, seed=number), CONFIG, seed=number)
    with_visits(kept, bench)
    while bench.t_s < seconds:
        begin_ns = bench.now_ns
        bench.run(bench.t_s + segment_s)
        bench.moments.clear()
        kept.write(begin_ns)
        kept.collector.begin()


def run(folder: Path, *more: str) -> tuple[float, bytes]:
    line = [sys.executable, "-m", "gateway", "replay", str(folder), "--against", str(folder / "other.toml"), "--json"]
    begun = time.perf_counter()
    out = subprocess.run([*line, *more], capture_output=True, check=False).stdout
    return time.perf_counter() - begun, out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=8)
    parser.add_argument("--seconds", type=int, default=240, help="of each recording")
    parser.add_argument("--segment", type=int, default=60, help="seconds of a segment")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    with TemporaryDirectory() as name:
        folder = Path(name) / "plants"
        folder.mkdir()
        (folder / "other.toml").write_text(OTHER)
        for number in range(args.recordings):
            recorded(folder, args.seed + number, args.seconds, args.segment)
        shares: dict[str, list[float]] = {}
        for number in range(args.rounds):
            kept = ("--results", str(Path(name) / f"results{number}"))
            serial_s, expected = run(folder, "--jobs", "1")
            print(f"round {number + 1}: serial {serial_s:.1f} s, {len(expected)} bytes of report", flush=True)
            runs = {**RUNS, "results kept": ("--jobs", "2", *kept), "second run": ("--jobs", "2", *kept)}
            for what, more in runs.items():
                seconds, said = run(folder, *more)
                assert said == expected, f"{what}: another report"
                shares.setdefault(what, []).append(seconds / serial_s)
                print(f"  {what}: {seconds:.1f} s", flush=True)
    for what, of in shares.items():
        print(f"{what:14} {statistics.median(of):.2f} of the serial run ({min(of):.2f} to {max(of):.2f})")


if __name__ == "__main__":
    main()
