"""What bays cost: processor time and memory (PSS) of every process of a gateway, bay by bay, and stale readings.

    python -m bench.bays                                   1, 4 and 8 bays, 20 s each
    python -m bench.bays --bays 16 --seconds 600 --cpus 0,1 --out DIR      16 bays on two cores for ten minutes

`gateway run` with the shipped settings reads an HTTP stream of JPEGs and a ranger on a pty for each bay; a PLC reads
100 registers of each bay ten times a second. Decoding is counted, what sends the frames is not
(bench.plant.stand_ins), and there are no viewers unless `--viewers` opens the pages.

Processor time is that of /proc, so other programs on the machine change it only through the caches. The memory of a
further bay is the slope between the runs, or, of a run by itself, what its newest vision process holds.

Fails, exit code 1, if a reading of a camera was not fresh after the start: seen by the PLC, or reported as an event.
"""

import argparse
import json
import os
import re
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

from bench.plant.report import Report, percentile, progress
from gateway.core.readings import FRESH_FRAME
from tests.e2e.brokers import free_port

STARTED_S = 120.0
POLL_S = 0.1
VISION_QUALITY, VISION_AGE, FRAME_ID, SKIPPED = 7, 15, 20, 26  # docs/registers.md
NO_VALUE = 65535
ROLES = {"gw-worker": "vision", "gw-hmi": "web", "gw-template": "template"}  # as `top` shows them
HEAD = """
instance = "{instance}"
state_dir = "{folder}"
[modbus]
port = {port}
[hmi]
enabled = true
port = {hmi_port}
[camera]
width_px = 640
height_px = 480
fps = {fps}
frozen_s = 0  # the stand-ins show a film in a loop,
unproven_age = "accept"  # by HTTP
"""
BAY = """
[[bays]]
name = "bay{n}"
unit_id = {n}
camera = {{ url = "{camera}" }}
ranger = {{ port = "{ranger}" }}
"""
SENSOR_FAULT = re.compile(r"\bbay\d+: sensor fault \((\w+) (\w+)\)")


@dataclass
class Polls:
    """What the PLC has read of the cameras since `begin`."""

    ages_ms: list[int] = field(default_factory=list)
    wrong: Counter[str] = field(default_factory=Counter)  # polls without a fresh frame, by quality
    frames: dict[int, tuple[int, int]] = field(default_factory=dict)  # bay -> first and last frame number
    skipped: dict[int, tuple[int, int]] = field(default_factory=dict)


@dataclass(frozen=True)
class Cost:
    """Of one process over the run."""

    role: str
    pid: int
    cpu: float  # share of a core
    pss_mb: float


@dataclass
class Run:
    bays: int
    seconds: float
    costs: list[Cost]
    polls: Polls
    faults: Counter[str]  # events of the gateway's log after the start
    started_s: float  # until every bay had its first reading

    def of(self, role: str) -> list[Cost]:
        return [cost for cost in self.costs if cost.role == role]

    @property
    def cpu(self) -> float:
        return sum(cost.cpu for cost in self.costs)

    @property
    def pss_mb(self) -> float:
        return sum(cost.pss_mb for cost in self.costs)


class Plc:
    """Reads every bay's registers every 0.1 s, in a thread."""

    def __init__(self, port: int, bays: int) -> None:
        self._port, self._bays = port, bays
        self.polls = Polls()
        self.ready: set[int] = set()  # bays with a first frame
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def begin(self) -> None:
        self.polls = Polls()

    def end(self) -> None:
        self._over.set()
        self._thread.join(10)

    def _run(self) -> None:
        with socket.create_connection(("127.0.0.1", self._port), timeout=10) as sock:
            while not self._over.wait(POLL_S):
                for unit in range(1, self._bays + 1):
                    sock.sendall(struct.pack(">HHHBBHH", unit, 0, 6, unit, 3, 0, 100))
                    data = b""
                    while len(data) < 209:
                        data += sock.recv(4096)
                    self._note(self.polls, unit, struct.unpack(">100H", data[9:209]))

    def _note(self, polls: Polls, unit: int, words: Sequence[int]) -> None:
        quality, age_ms = words[VISION_QUALITY], words[VISION_AGE]
        frame = words[FRAME_ID] << 16 | words[FRAME_ID + 1]
        if quality in FRESH_FRAME and frame:
            self.ready.add(unit)
        else:
            polls.wrong[str(quality)] += 1
        if age_ms != NO_VALUE:
            polls.ages_ms.append(age_ms)
        for noted, value in ((polls.frames, frame), (polls.skipped, words[SKIPPED])):
            noted[unit] = (noted.get(unit, (value, value))[0], value)


class Log:
    """The gateway's log, line by line: sensor faults after `begin`."""

    def __init__(self, stream: Any, path: Path) -> None:
        self.faults: Counter[str] = Counter()
        self.begun = False
        threading.Thread(target=self._read, args=(stream, path), daemon=True).start()

    def _read(self, stream: Any, path: Path) -> None:
        with path.open("w", encoding="utf-8") as file:
            for line in stream:
                file.write(line)
                file.flush()
                if self.begun and (found := SENSOR_FAULT.search(line)):
                    self.faults[" ".join(found.groups())] += 1


@contextmanager
def stand_ins(bays: int, fps: float) -> Iterator[dict[str, list[str]]]:
    """The addresses of the cameras and rangers."""
    command = [sys.executable, "-m", "bench.plant.stand_ins", str(bays), f"{fps:g}"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield json.loads(process.stdout.readline())
        process.communicate("")


def measured(bays: int, args: argparse.Namespace, folder: Path) -> Run:
    """One gateway with so many bays."""
    port, hmi_port = free_port(), free_port()
    with stand_ins(bays, args.fps) as parts:
        text = HEAD.format(instance=f"bays{os.getpid()}", folder=folder, port=port, hmi_port=hmi_port, fps=args.fps)
        text += Path(args.more).read_text(encoding="utf-8") if args.more else ""
        for n, (camera, ranger) in enumerate(zip(parts["camera"], parts["ranger"], strict=True), start=1):
            text += BAY.format(n=n, camera=camera, ranger=ranger)
        config = folder / f"{bays}.toml"
        config.write_text(text, encoding="utf-8")
        command = [sys.executable, "-m", "gateway", "run", str(config)]
        gateway = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        try:
            if args.realtime:
                os.sched_setscheduler(gateway.pid, os.SCHED_FIFO, os.sched_param(10))
            if args.cpus:
                os.sched_setaffinity(gateway.pid, {int(cpu) for cpu in args.cpus.split(",")})
            return _watched(gateway, Log(gateway.stderr, folder / f"{bays}.log"), port, hmi_port, bays, args)
        finally:
            gateway.terminate()
            try:
                gateway.wait(20)
            except subprocess.TimeoutExpired:
                gateway.kill()
                gateway.wait()


def _watched(
    gateway: subprocess.Popen[str], log: Log, port: int, hmi_port: int, bays: int, args: argparse.Namespace
) -> Run:
    begun_s = time.monotonic()
    _wait_for(port, gateway)
    plc = Plc(port, bays)
    while len(plc.ready) < bays:
        if time.monotonic() - begun_s > STARTED_S or gateway.poll() is not None:
            raise SystemExit(f"only the bays {sorted(plc.ready)} have given a reading")
        time.sleep(0.05)
    started_s = time.monotonic() - begun_s
    if args.viewers:
        _open_pages(hmi_port)
    time.sleep(args.settle)
    plc.begin()
    log.begun = True
    before, from_s = _cpu(gateway.pid), time.monotonic()
    until_s = from_s + args.seconds
    while (left_s := until_s - time.monotonic()) > 0 and gateway.poll() is None:
        time.sleep(min(5.0, left_s))
        progress(f"{bays} bays, {max(0.0, until_s - time.monotonic()):.0f} s left, wrong {dict(plc.polls.wrong)}")
    took_s = time.monotonic() - from_s
    costs = [
        Cost(role, pid, (after - before.get((role, pid), 0.0)) / took_s, _pss_mb(pid))
        for (role, pid), after in _cpu(gateway.pid).items()
    ]
    polls, faults = plc.polls, Counter(log.faults)
    plc.end()
    if gateway.poll() is not None:
        raise SystemExit(f"the gateway ended: {gateway.returncode}")
    return Run(bays, took_s, costs, polls, faults, started_s)


def _wait_for(port: int, gateway: subprocess.Popen[str]) -> None:
    deadline_s = time.monotonic() + STARTED_S
    while time.monotonic() < deadline_s and gateway.poll() is None:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
            return
        time.sleep(0.05)
    raise SystemExit(f"the gateway did not start: {gateway.poll()}")


def _open_pages(port: int) -> None:
    """The web process exists from the first request on."""
    with suppress(OSError):
        urllib.request.urlopen(f"http://127.0.0.1:{port}/healthz", timeout=30).read()


def _cpu(main_pid: int) -> dict[tuple[str, int], float]:
    """(role, pid) -> processor time since its start, s."""
    found: dict[tuple[str, int], float] = {}
    main = psutil.Process(main_pid)
    for process in (main, *main.children(recursive=True)):
        with suppress(psutil.Error):
            name = "main" if process.pid == main_pid else ROLES.get(process.name().split("-bay")[0], process.name())
            times = process.cpu_times()
            found[name, process.pid] = times.user + times.system
    return found


def _pss_mb(pid: int) -> float:
    with suppress(OSError):
        for line in Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii").splitlines():
            if line.startswith("Pss:"):
                return int(line.split()[1]) / 1024
    return 0.0


def table(runs: Sequence[Run]) -> list[str]:
    roles = sorted({cost.role for run in runs for cost in run.costs}, key=lambda role: (role != "main", role))
    head = ["bays", *(f"{role}, CPU % each" for role in roles), "CPU % a bay", *(f"{role}, MB each" for role in roles)]
    head += ["MB in all", "MB a further bay", "frames/s a bay", "age p99, ms", "start, s"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---:|" * len(head)]
    for n, run in enumerate(runs):
        cpu = [_mean([100 * cost.cpu for cost in run.of(role)]) for role in roles]
        pss = [_mean([cost.pss_mb for cost in run.of(role)]) for role in roles]
        further = (run.pss_mb - runs[n - 1].pss_mb) / (run.bays - runs[n - 1].bays) if n else float("nan")
        rates = [(last - first) / run.seconds for first, last in run.polls.frames.values()]
        cells = [str(run.bays), *cpu, f"{100 * run.cpu / run.bays:.1f}", *pss, f"{run.pss_mb:.0f}"]
        cells += [f"{further:.1f}" if n else "-", _mean(rates), f"{percentile(run.polls.ages_ms, 0.99)}"]
        lines.append("| " + " | ".join([*cells, f"{run.started_s:.1f}"]) + " |")
    return lines


def _mean(values: Sequence[float]) -> str:
    return f"{sum(values) / len(values):.1f}" if values else "-"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bays", type=lambda text: [int(part) for part in text.split(",")], default=[1, 4, 8])
    parser.add_argument("--seconds", type=float, default=20.0, help="measured for each (default 20)")
    parser.add_argument("--settle", type=float, default=5.0, help="seconds between start and measurement (default 5)")
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--cpus", default="", help="the gateway's processes may use only these, such as 0,1")
    parser.add_argument("--realtime", action="store_true", help="SCHED_FIFO for the gateway, as recommended (root)")
    parser.add_argument("--viewers", action="store_true", help="open the pages once, so that the web process runs")
    parser.add_argument("--more", help="a file of TOML that is added to the configuration's shared part")
    parser.add_argument("--out", type=Path, help="folder for bays.md, bays.json and the gateway's logs")
    args = parser.parse_args()
    report = Report("bays", 0, "python -m bench.bays " + " ".join(sys.argv[1:]))
    with tempfile.TemporaryDirectory(prefix="bays-") as name:
        folder = args.out or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        runs = [measured(bays, args, folder) for bays in args.bays]
    print("\n".join(table(runs)), end="\n\n")
    for run in runs:
        skipped = sum(last - first for first, last in run.polls.skipped.values())
        frames = sum(last - first for first, last in run.polls.frames.values())
        oldest = max(run.polls.ages_ms, default=0)
        report.row(f"{run.bays} bays", f"{frames} frames, {skipped} skipped, oldest reading {oldest} ms")
        report.data[f"{run.bays} bays"] = {
            "seconds": run.seconds,
            "processes": [vars(cost) for cost in run.costs],
            "age_ms": {share: percentile(run.polls.ages_ms, share) for share in (0.5, 0.99, 0.999)},
            "faults": dict(run.faults),
        }
        cameras = {what: count for what, count in run.faults.items() if what.startswith("vision")}
        if run.polls.wrong or cameras:
            report.fail(f"{run.bays} bays: polls without a fresh frame {dict(run.polls.wrong)}, events {cameras}")
        if others := {what: count for what, count in run.faults.items() if not what.startswith("vision")}:
            report.row(f"{run.bays} bays, other events", str(others))
    return report.end(args.out)


if __name__ == "__main__":
    sys.exit(main())
