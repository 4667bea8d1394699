"""Let a gateway work for hours with sensors that fail: does anything grow?

    python -m bench.soak --hours 1 --seed 1 --out DIR      an hour; writes DIR/soak.md and DIR/soak.json
    python -m bench.soak --hours 720                       a month; Ctrl-C ends it, with its report

`gateway simulate` runs the scenario `day` at real speed (a truck every 20 s) with the pages, a broker and a PLC that
writes its heartbeat and releases most trucks. About once a minute a sensor fails for some seconds, each way in
turn; every few minutes the broker is restarted, the vision process killed, or the PLC asks without pause. The schedule
follows from the seed; a scenario's faults end after 24 h, the others go on.

Every 10 s it notes memory, descriptors and threads of each process, the files of the gateway and the lines of its log
(at level info, as shipped). The recording grows until its limit, and is counted by itself. Growth a day is the slope of
the line through these points, after a first part that is left out; with it the standard error of that slope. An
independent poller and the simulator's truth judge the outputs all the while, as in bench.chaos.

Fails, exit code 1, if an output was on that the truth forbids, if the gateway ended, if it did not end in order, or if
memory, descriptors, threads or files grow by more than allowed, even less twice the standard error (not judged in a run
shorter than half an hour), or if the recording is larger than its limit.
"""

import argparse
import contextlib
import random
import shutil
import signal
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bench.chaos import MQTT
from bench.plant.faults import FAULTS, Plant
from bench.plant.judge import Judge
from bench.plant.plc_program import Program
from bench.plant.poller import ANSWERED, OUTCOMES, Poll, Poller
from bench.plant.report import Report, answer_times, progress, table
from bench.plant.simulated import RECORD_MB, ROOT, Simulated, wait_until
from tests.e2e.brokers import Mosquitto

DAY_S = 86_400.0
# The memories of fixed length (events for the pages, changes for a Sparkplug host) are full after some 40 min.
WARM_UP_SHARE, WARM_UP_MOST_S = 0.6, 2700.0
JUDGED_S = 1800.0
SENSOR_FAULTS = (
    "camera_freeze", "camera_lost", "camera_black", "camera_stuck", "marker_hidden", "ranger_silent", "ranger_no_echo",
    "ranger_stuck", "ranger_too_near", "ranger_too_far", "ranger_noise", "ranger_wild", "ranger_unplugged",
    "ranger_wrong_version",
)  # fmt: skip
DISTURBANCES = (
    "vision process killed",
    "broker restarted again and again",
    "PLCs ask without end",
    "web process killed",
)
DISTURBED_S = (120.0, 400.0)  # from one to the next
# Growth a day that is allowed: of the main process's memory, MiB, and of what else is counted.
ALLOWED = {"memory MiB": 32.0, "descriptors": 2.0, "threads": 2.0, "files": 2.0}
# Changes kept for a Sparkplug host that never comes: the usual 1,000 would take more than an hour to fill.
HISTORY = "history = 100\n"
RECORDING = "size of the recording KiB"  # grows until its limit
KEPT_TIMES = 2_000_000  # poll times for the percentiles: a day at 20 Hz


def scenario(seed: int, hours: float) -> str:
    """`day`, with sensors that fail."""
    chance = random.Random(f"soak {seed}")
    text = (ROOT / "config" / "scenarios" / "day.toml").read_text(encoding="utf-8")
    text = text.replace("seed = 20\n", f"seed = {seed}\n").replace("duration_s = 60.0\n", "duration_s = 86400.0\n")
    text = "\n".join(line for line in text.splitlines() if not line.startswith("#"))
    at_s = 20.0
    faults: list[str] = []
    while at_s < min(DAY_S - 60, 3600 * hours + 60) and len(faults) < 1000:
        kind = SENSOR_FAULTS[len(faults) % len(SENSOR_FAULTS)]
        lasts_s = chance.uniform(0.2, 6.0)
        faults.append(f'[[faults]]\nkind = "{kind}"\nat_s = {at_s:.2f}\nfor_s = {lasts_s:.2f}\n')
        at_s += lasts_s + chance.uniform(40.0, 110.0)
    return f"{text}\n" + "\n".join(faults)


@dataclass
class Samples:
    """What was noted, by what it is of: moments, s, and values."""

    series: dict[str, tuple[list[float], list[float]]] = field(default_factory=dict)

    def add(self, at_s: float, **values: float) -> None:
        for name, value in values.items():
            moments, noted = self.series.setdefault(name, ([], []))
            moments.append(at_s)
            noted.append(value)

    def forget(self, name: str) -> None:
        """It is of another process from here on."""
        self.series.pop(name, None)

    def a_day(self, name: str) -> tuple[float, float]:
        """Growth a day and its standard error, after the warm-up."""
        return growth(*self.series.get(name, ((), ())))


def growth(at_s: Sequence[float], values: Sequence[float]) -> tuple[float, float]:
    """Slope of the least squares line a day, and its standard error; without the first part. nan of too few."""
    begun_s = at_s[0] + min(WARM_UP_MOST_S, WARM_UP_SHARE * (at_s[-1] - at_s[0])) if at_s else 0.0
    points = [(t / DAY_S, value) for t, value in zip(at_s, values, strict=True) if t >= begun_s]
    if len(points) < 5:
        return float("nan"), float("nan")
    x, y = np.array(points, np.float64).T
    x = x - x.mean()
    slope = float((x * y).sum() / (x * x).sum())
    rest = y - y.mean() - slope * x
    # Samples beside each other are alike: the error is that of a tenth as many.
    error = float(np.sqrt((rest * rest).sum() / max(1, len(points) - 2) / (x * x).sum() * 10))
    return slope, error


class Soak:
    """One run: `work` until its time has come."""

    def __init__(self, plant: Plant, judge: Judge, seed: int, sample_s: float) -> None:
        self.plant, self.judge = plant, judge
        self.samples = Samples()
        self.times_ms: list[float] = []
        self.disturbed: dict[str, int] = {}
        self._chance = random.Random(f"disturbances {seed}")
        self._sample_s = sample_s
        self._beat: int | None = None
        self._pids: dict[str, int] = {}
        self.ticks = 0

    def on_poll(self, poll: Poll) -> None:
        self.judge.poll(poll)
        if poll.outcome == ANSWERED:
            if len(self.times_ms) < KEPT_TIMES:
                self.times_ms.append(poll.took_ms)
            if self._beat is not None:
                self.ticks += (poll.words[2] - self._beat) % 65536
            self._beat = poll.words[2]

    def work(self, seconds: float) -> float:
        """Raises RuntimeError if the gateway ends; seconds worked."""
        begun_s = time.monotonic()
        sample_s, disturb_s = begun_s, begun_s + self._chance.uniform(*DISTURBED_S) / 4
        told_s = begun_s
        with contextlib.suppress(KeyboardInterrupt):
            while (now_s := time.monotonic()) < begun_s + seconds:
                if now_s >= sample_s:
                    sample_s += self._sample_s
                    self._sample(now_s - begun_s)
                    self._look()
                if now_s >= disturb_s:
                    self._disturb()
                    disturb_s = time.monotonic() + self._chance.uniform(*DISTURBED_S)
                if now_s >= told_s:
                    told_s += 60
                    slope, error = self.samples.a_day("memory MiB")
                    newest = self.samples.series["memory MiB"][1][-1]
                    progress(
                        f"{(now_s - begun_s) / 3600:7.2f} h: main process {newest:.1f} MiB, "
                        f"{slope:+.1f} +- {error:.1f} a day; {len(self.judge.findings)} forbidden outputs"
                    )
                time.sleep(0.2)
        return time.monotonic() - begun_s

    def _sample(self, at_s: float) -> None:
        gateway = self.plant.gateway
        if gateway.process is None or gateway.process.poll() is not None:
            raise RuntimeError(f"the gateway ended: {gateway.process and gateway.process.returncode}")
        of = {one.role: one for one in gateway.usage()}
        files, size = gateway.files()
        recorded_files, recorded_size = gateway.recorded()
        for role in ("vision", "web"):
            if (one := of.get(role)) is not None:
                if self._pids.get(role) != one.pid:
                    self.samples.forget(f"memory of the {role} process MiB")
                self._pids[role] = one.pid
                self.samples.add(at_s, **{f"memory of the {role} process MiB": one.memory_kib / 1024})
        self.samples.add(
            at_s,
            **{
                "memory MiB": of["main"].memory_kib / 1024,
                "descriptors": of["main"].descriptors,
                "threads": of["main"].threads,
                "files": files,
                "size of the files KiB": size / 1024,
                "files of the recording": recorded_files,
                RECORDING: recorded_size / 1024,
                "log lines": gateway.log_lines.total(),
                "log KiB": gateway.log_bytes / 1024,
                "processor time of the main process s": of["main"].cpu_s,
            },
        )

    def _look(self) -> None:
        """Somebody loads a page now and then."""
        with contextlib.suppress(OSError, urllib.error.HTTPError):
            urllib.request.urlopen(f"http://127.0.0.1:{self.plant.gateway.hmi_port}/api/state", timeout=5).read()

    def _disturb(self) -> None:
        name = self._chance.choice(DISTURBANCES)
        fault = next(fault for fault in FAULTS if fault.name == name)
        self.disturbed[name] = self.disturbed.get(name, 0) + 1
        self.judge.playing = name
        with fault.play(self.plant):
            time.sleep(self._chance.uniform(fault.least_s, fault.most_s))
        self.judge.playing = "none"


def run(args: argparse.Namespace) -> int:
    report = Report("soak", args.seed, f"python -m bench.soak --hours {args.hours:g} --seed {args.seed}")
    with tempfile.TemporaryDirectory(prefix="soak-") as name, ExitStack() as stack:
        folder = Path(name)
        broker = stack.enter_context(Mosquitto(folder))
        gateway = stack.enter_context(
            Simulated(
                folder,
                seed=args.seed,
                scenario=scenario(args.seed, args.hours),
                more=MQTT.format(port=broker.port, folder=folder) + HISTORY,
                log_level="info",
            )
        )
        judge = Judge(gateway.scenario, gateway.config)
        soak = Soak(Plant(gateway, broker, folder), judge, args.seed, args.sample_s)
        judge.gateway_started(int(gateway.start()["world_start_ns"]))
        poller = stack.enter_context(Poller([gateway.port], soak.on_poll, writing=1))
        stack.enter_context(Program(judge, poller))
        if wait_until(judge.healthy, 30) is None:
            report.fail("the gateway did not come up")
        worked_s = 0.0
        try:
            worked_s = soak.work(3600 * args.hours)
            if (code := gateway.kill(signal.SIGTERM)) != 0:
                report.fail(f"exit code {code} after SIGTERM")
        except RuntimeError as error:
            report.fail(str(error))
        judge.finish()
        if args.out is not None:
            args.out.mkdir(parents=True, exist_ok=True)
            shutil.copy(gateway.folder / "gateway.log", args.out / "soak.log")
    return _report(report, soak, worked_s, args.out)


def _report(report: Report, soak: Soak, worked_s: float, folder: Path | None) -> int:
    figures, samples = soak.judge.figures, soak.samples
    report.findings(soak.judge.findings)
    report.row("hours of work", f"{worked_s / 3600:.2f}")
    outcomes = {OUTCOMES.get(code, f"exception {code - 256}"): n for code, n in figures.outcomes.items()}
    report.row("polls of the PLC (every 50 ms)", f"{figures.polls}: {table(outcomes)}")
    report.row("answer times", answer_times(soak.times_ms))
    report.row("ticks a second", f"{soak.ticks / max(1.0, worked_s):.2f}")
    late = [value for seconds in figures.late_s.values() for value in seconds]
    if late:
        report.row("truck at its mark until MayMove was off", f"{len(late)} times, longest {1e3 * max(late):.0f} ms")
    report.row("in place; releases", f"{figures.visits_in_place}; {figures.releases}")
    report.row("disturbed", table(soak.disturbed))
    judged = worked_s >= JUDGED_S
    if not judged:
        report.row("growth", f"not judged: shorter than {JUDGED_S / 60:.0f} min, most of it is the start")
    for name, (moments, values) in sorted(samples.series.items()):
        slope, error = samples.a_day(name)
        since = f", {moments[0] / 3600:.2f} h after the start" if moments[0] > 60 else ""
        report.row(name, f"{values[0]:.1f} first{since}, {values[-1]:.1f} last; {slope:+.1f} +- {error:.1f} a day")
        if judged and name in ALLOWED and slope - 2 * error > ALLOWED[name]:
            report.fail(f"{name}: {slope:+.1f} +- {error:.1f} a day, allowed {ALLOWED[name]:g}")
    largest_kib = max(samples.series.get(RECORDING, ((), (0.0,)))[1])
    if largest_kib > 1.1 * 1000 * RECORD_MB:  # the file that is being written stays
        report.fail(f"the recording grew to {largest_kib:.0f} KiB; its limit is {RECORD_MB} MB")
    report.data |= {
        "samples": {name: [[round(t, 1) for t in at_s], values] for name, (at_s, values) in samples.series.items()},
        "unexpected_log_lines": list(soak.plant.gateway.unexpected),
        "log_lines": soak.plant.gateway.log_lines,
    }
    return report.end(folder)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=0.1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sample-s", type=float, default=10.0, help="from one note to the next")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write soak.md and soak.json there")
    return run(parser.parse_args())


if __name__ == "__main__":
    sys.exit(main())
