"""How fast the Modbus server is, against the plainest libmodbus server in C, in the same run on the same machine.

    python -m bench.modbus_speed [--rounds 15] [--seconds 1]        requests a second, CPU, p99; 20 registers
    python -m bench.modbus_speed --torn 10000000                    an image that is another at every request
    python -m bench.modbus_speed --vision 20                        polls of a whole gateway whose vision never rests

The servers take turns, round by round, so that whatever else the machine does hits all of them. Told are medians over
the rounds; the ratios are taken within each round first. Servers run on one CPU and the load generator on another.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np

from bench.modbus import programs
from bench.modbus.programs import ROOT, Load, Server, build, load, ours, running

REGISTERS = 20


def cpus() -> tuple[set[int] | None, set[int] | None]:
    """One CPU for the server, another for the load."""
    there = sorted(os.sched_getaffinity(0))
    return ({there[0]}, {there[1]}) if len(there) > 1 else (None, None)


def against_libmodbus(rounds: int, seconds: float) -> None:
    server_cpu, load_cpu = cpus()
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        generator = build("load", Path(folder))
        reference = build("libmodbus_server", Path(folder), "libmodbus")
        servers = [
            stack.enter_context(running("libmodbus", [str(reference), "0"], server_cpu)),
            stack.enter_context(ours("uvloop", cpus=server_cpu)),
            stack.enter_context(ours("asyncio", cpus=server_cpu)),
        ]
        for connections in (1, 32):
            told: dict[str, list[tuple[Load, float]]] = {server.name: [] for server in servers}
            for number in range(rounds):
                for server in servers if number % 2 else reversed(servers):
                    told[server.name].append(_measure(server, generator, connections, seconds, load_cpu))
            _tell(connections, told)


def _measure(
    server: Server, generator: Path, connections: int, seconds: float, cpu: set[int] | None
) -> tuple[Load, float]:
    """The load's figures, and the server's CPU time for one request, us."""
    before = server.cpu_ns()
    found = load(generator, server.port, connections=connections, seconds=seconds, registers=REGISTERS, cpus=cpu)
    assert found.wrong == 0
    return found, (server.cpu_ns() - before) / 1000 / found.answers


def _tell(connections: int, told: dict[str, list[tuple[Load, float]]]) -> None:
    print(f"\n{connections} connection{'s' if connections > 1 else ''}, {REGISTERS} registers, medians of rounds")
    print(f"{'server':<20}{'req/s':>9}{'p50 us':>9}{'p99 us':>9}{'CPU us':>8}   to libmodbus: req/s   CPU    p99")
    reference = told["libmodbus"]
    for name, rounds in told.items():
        middle = [statistics.median(getattr(found, key) for found, _ in rounds) for key in ("rate", "p50", "p99")]
        cpu = statistics.median(cpu for _, cpu in rounds)
        pairs = list(zip(rounds, reference, strict=True))
        rate = statistics.median(mine.rate / its.rate for (mine, _), (its, _) in pairs)
        cost = statistics.median(mine / its for (_, mine), (_, its) in pairs)
        tail = statistics.median(mine.p99 / its.p99 for (mine, _), (its, _) in pairs)
        print(
            f"{name:<20}{middle[0]:>9.0f}{middle[1]:>9.1f}{middle[2]:>9.1f}{cpu:>8.2f}"
            f"{rate:>22.2f}{cost:>7.2f}{tail:>7.2f}"
        )


def torn(wanted: int) -> int:
    """Reads all 100 registers of an image that changes at every request, over 8 connections. The torn ones."""
    answers = found = 0
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        generator = build("load", Path(folder))
        with ours("uvloop", "--churn") as server:
            while answers < wanted:
                part = load(generator, server.port, connections=8, seconds=10, registers=100)
                answers, found = answers + part.answers, found + part.torn
                assert part.wrong == 0
                print(f"\r{answers:>9} reads, {found} torn", end="", file=sys.stderr)
            requests = server.counters()["requests"]
    print(f"\n{answers} reads of 100 registers in {time.monotonic() - begun:.0f} s, {requests} images: {found} torn")
    return found


def beside_vision(seconds: float, favoured: bool) -> None:
    """A gateway on one camera made of files, taken as fast as vision can; one PLC that polls every 10 ms.

    Camera and vision process have one CPU to themselves, as `affinity` in the configuration gives it to them.
    """
    other = max(os.sched_getaffinity(0))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "frames").mkdir()
        for n in range(20):
            picture = np.full((720, 1280, 3), (90, 100, 95), np.uint8)
            picture += np.random.default_rng(n).integers(0, 12, picture.shape, dtype=np.uint8)
            cv2.circle(picture, (500 + 10 * n, 360), 150, (30, 30, 210), -1, cv2.LINE_AA)
            cv2.imwrite(str(folder / "frames" / f"{n:03}.png"), picture)
        config = folder / "gateway.toml"
        config.write_text(
            f'instance = "bench{os.getpid()}"\nstate_dir = ""\n[modbus]\nport = 0\n'
            f'[camera]\nurl = "{folder / "frames"}"\n'
            f'pace = "fast"\nloop = true\naffinity = [{other}]\n[vision]\naffinity = [{other}]\n'
            '[ranger]\nport = "loop://"\n',
            encoding="utf-8",
        )
        generator = build("load", folder)
        command = [sys.executable, "-m", "gateway", "run", str(config)]
        process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=ROOT,
            start_new_session=favoured,
            preexec_fn=programs.favour if favoured else None,  # noqa: PLW1509 - no threads yet
        )
        try:
            assert process.stdout is not None
            port = int(process.stdout.readline().partition("127.0.0.1:")[2].partition(",")[0])
            time.sleep(5)
            polls = [load(generator, port, seconds=seconds / 5, registers=100, period_us=10_000) for _ in range(5)]
            print(f"vision at full load, a poll of 100 registers every 10 ms, {seconds:.0f} s in five parts:")
            for part in polls:
                print(f"  {part.answers} polls: p50 {part.p50:.0f}, p99 {part.p99:.0f}, longest {part.longest:.0f} us")
            print(f"load average {os.getloadavg()[0]:.1f}")
        finally:
            process.terminate()
            process.wait(10)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--torn", type=int, metavar="READS")
    parser.add_argument("--vision", type=float, metavar="SECONDS")
    parser.add_argument(
        "--realtime",
        action="store_true",
        help="before whatever else the machine does (SCHED_FIFO)",
    )
    args = parser.parse_args()
    programs.realtime = args.realtime
    print(f"{os.cpu_count()} CPUs, load average {os.getloadavg()[0]:.1f} at the begin")
    if args.torn:
        return int(torn(args.torn) > 0)
    if args.vision:
        beside_vision(args.vision, args.realtime)
        return 0
    against_libmodbus(args.rounds, args.seconds)
    return 0


if __name__ == "__main__":
    sys.exit(main())
