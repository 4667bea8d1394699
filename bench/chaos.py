"""Harm a running gateway at random, again and again: is an output ever on that the truth forbids, does it recover?

    python -m bench.chaos --minutes 60 --seed 1 --out DIR     an hour; writes DIR/chaos.md and DIR/chaos.json
    python -m bench.chaos --seed 1 --fault 17                 play fault number 17 of that seed once more, alone
    python -m bench.chaos --list                              what is done to it

`gateway simulate` runs at real speed with a truck every 15 s, which heeds nobody; with a broker, the pages and a PLC
that writes its heartbeat and releases most trucks. Every some seconds, most often just before a truck reaches its
mark or leaves it, a fault is drawn by the seed (SIGKILL and SIGSTOP of each process, a full disk, no descriptors,
memory limits, no processor time, storms of brokers and PLCs; one in five times two at once) and taken back after a
time drawn likewise. Judges: an independent Modbus poller (bench/modbus/plc.c) whose outputs follow docs/registers.md,
and the simulator's truth, computed in this process from the scenario alone (bench/plant/judge.py).

Fails, exit code 1, if an output was on that the truth forbids, if the gateway did not recover within 20 s of a
fault's end, if it ended by itself (a memory limit excepted), or if it leaves a process, shared memory, descriptors or
memory behind.

Linux; as root the state folder is a file system of its own that is filled (in a mount namespace), else a limit on the
size of files stands for it. Needs gcc and mosquitto.
"""

import argparse
import random
import shlex
import shutil
import signal
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from bench.plant.faults import FAULTS, Fault, Plant
from bench.plant.judge import LATE_S, STARVED_LATE_S, Judge
from bench.plant.plc_program import Program
from bench.plant.poller import OUTCOMES, Poller
from bench.plant.report import Report, progress, table
from bench.plant.simulated import Simulated, wait_until
from gateway.records.recorded_rules import RecordedRules
from gateway.records.recording import records, segments_of
from gateway.records.replay import Difference, Replay
from tests.e2e.brokers import Mosquitto

RECOVERY_S = 20.0
PAGES_S = 40.0
MOMENTS = ("any", "at the mark", "at the mark", "leaves")
MOMENT_S = 25.0  # a truck reaches each within 15 s
SECOND_FAULT_SHARE = 0.2
MEMORY_MIB = 96  # the main process may grow by so much in one life
DESCRIPTORS = 24
SHARED_MEMORY = Path("/dev/shm")
MQTT = """
[mqtt]
url = "mqtt://127.0.0.1:{port}"
outbox_file = "{folder}/state/outbox.sqlite"
[mqtt.sparkplug]
edge_node_id = "proof"
primary_host_id = "host"
"""


@dataclass(frozen=True)
class Planned:
    """Fault number `number` of a seed: what, after how long, for how long, and perhaps another one beside it."""

    number: int
    faults: tuple[Fault, ...]
    wait_s: float
    lasts_s: float
    moment: str  # "any", or so soon before a moment of the truck that most depends on what is shown
    ahead_s: float

    @property
    def name(self) -> str:
        return " + ".join(fault.name for fault in self.faults)


def planned(seed: int, number: int, names: str = "") -> Planned:
    """The same for a seed and a number, whatever was played before."""
    chance = random.Random(f"chaos {seed} {number}")
    there = [fault for fault in FAULTS if names in fault.name]
    first = chance.choice(there)
    faults = [first]
    if chance.random() < SECOND_FAULT_SHARE:
        second = chance.choice(there)
        one_broker = "roker" in first.name and "roker" in second.name  # one cannot be stopped that was killed
        if second is not first and not (first.restart or second.restart or one_broker):
            faults.append(second)
    wait_s, lasts_s = chance.uniform(0.5, 6.0), chance.uniform(first.least_s, first.most_s)
    return Planned(number, tuple(faults), wait_s, lasts_s, chance.choice(MOMENTS), chance.uniform(0.0, 0.8))


@dataclass
class Seen:
    """What became of the faults played."""

    played: Counter[str] = field(default_factory=Counter)
    recovered_s: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    ended: Counter[str] = field(default_factory=Counter)  # by itself
    memory_mib: list[float] = field(default_factory=list)  # growth of each life
    descriptors: list[int] = field(default_factory=list)


class Chaos:
    """One run: `play` one planned fault after another."""

    def __init__(self, plant: Plant, judge: Judge, report: Report, recovery_s: float = RECOVERY_S) -> None:
        self.plant, self.judge, self.report = plant, judge, report
        self.recovery_s = recovery_s
        self.seen = Seen()
        self._baseline: tuple[int, int] | None = None

    def begin(self) -> None:
        """Start the gateway, or start it again."""
        self.judge.gateway_started(int(self.plant.gateway.start()["world_start_ns"]))
        self._baseline = None

    def recovered(self) -> float | None:
        """Seconds until the PLC sees it alive with both sensors good."""
        return wait_until(self.judge.healthy, self.recovery_s)

    def wait_for(self, plan: Planned) -> None:
        """Until the fault begins: any time, or shortly before a truck that may move reaches its mark, or leaves it."""
        time.sleep(plan.wait_s)
        judge, world = self.judge, self.judge.world

        def soon() -> bool:
            t_s = judge.world_s
            if t_s is None or plan.moment == "any":
                return True
            now, then = world.truth(t_s, image_speed=False), world.truth(t_s + plan.ahead_s, image_speed=False)
            if plan.moment == "leaves":
                return (now.leg_name, then.leg_name) == ("drive in", "leave")
            return then.stop and not now.stop and now.leg_name == "drive in"

        wait_until(soon, MOMENT_S, 0.01)

    def play(self, plan: Planned) -> None:
        self.wait_for(plan)
        judge, gateway, seen = self.judge, self.plant.gateway, self.seen
        self._measure()
        seen.played[plan.name] += 1
        judge.playing = f"{plan.name}, number {plan.number}"
        judge.starved = any(fault.starved for fault in plan.faults)
        if any("web" in fault.name for fault in plan.faults):
            self._page()
        with ExitStack() as stack:
            for fault in plan.faults:
                stack.enter_context(fault.play(self.plant))
            time.sleep(plan.lasts_s)
        if any(fault.restart for fault in plan.faults):
            assert gateway.process is not None
            gateway.process.wait(30)
            self._leave_nothing()
            self.begin()
        took_s = self.recovered()
        if gateway.process is not None and gateway.process.poll() is not None:
            name = f"{plan.name} (exit code {gateway.process.returncode})"
            seen.ended[name] += 1
            if not any(fault.may_end for fault in plan.faults):
                self.report.fail(f"the gateway ended by itself: {name}, number {plan.number}")
            self.begin()
            took_s = self.recovered()
        if took_s is None:
            self.report.fail(f"not recovered in {self.recovery_s:.0f} s: {plan.name}, number {plan.number}")
        else:
            seen.recovered_s[plan.name].append(took_s)
        judge.playing, judge.starved = "none", False

    def _page(self) -> None:
        """The web process runs from the first request on, and must answer one again."""

        def answers() -> bool:
            try:
                with urllib.request.urlopen(f"http://127.0.0.1:{self.plant.gateway.hmi_port}/healthz", timeout=5):
                    return True
            except urllib.error.HTTPError:
                return True  # 503: it answers, and reports what is wrong
            except OSError:
                return False

        if wait_until(answers, PAGES_S, 0.2) is None:
            self.report.fail(f"the pages do not answer within {PAGES_S:.0f} s, before {self.judge.playing}")

    def _measure(self) -> None:
        """Memory and descriptors of the main process, against those of the first calm moment of its life."""
        main = next((usage for usage in self.plant.gateway.usage() if usage.role == "main"), None)
        if main is None:
            return
        if self._baseline is None:
            self._baseline = (main.memory_kib, main.descriptors)
        self.seen.memory_mib.append((main.memory_kib - self._baseline[0]) / 1024)
        self.seen.descriptors.append(main.descriptors - self._baseline[1])

    def _leave_nothing(self) -> None:
        if left := self.plant.gateway.pids("all")[1:]:
            self.report.fail(f"processes left by a main process that ended: {left}")

    def end(self, before: set[str]) -> None:
        """SIGTERM: an orderly end, and nothing left."""
        self._measure()
        code = self.plant.gateway.kill(signal.SIGTERM)
        self.judge.finish()
        if code != 0:
            self.report.fail(f"exit code {code} after SIGTERM")
        instance = str(self.plant.gateway.started.get("instance"))
        left = {path.name for path in SHARED_MEMORY.rglob("*") if instance in path.name} - before
        left -= {f"loading-gateway-bdseq.{instance}"}  # outlives a restart on purpose, until the machine's
        if left:
            self.report.fail(f"shared memory left behind: {sorted(left)}")


@contextmanager
def plant_at_work(seed: int) -> Iterator[tuple[Plant, Judge]]:
    """A broker, a gateway that is not yet started, its judge, the poller and the PLC's program."""
    with tempfile.TemporaryDirectory(prefix="chaos-") as name, ExitStack() as stack:
        folder = Path(name)
        broker = stack.enter_context(Mosquitto(folder))
        gateway = stack.enter_context(Simulated(folder, seed=seed, more=MQTT.format(port=broker.port, folder=folder)))
        judge = Judge(gateway.scenario, gateway.config)
        poller = stack.enter_context(Poller([gateway.port], judge.poll, writing=1))
        stack.enter_context(Program(judge, poller))
        yield Plant(gateway, broker, folder), judge


def run(args: argparse.Namespace) -> int:
    again = f"python -m bench.chaos --seed {args.seed} --fault N (N: the number beside each failure)"
    report = Report("chaos", args.seed, again)
    shared = {path.name for path in SHARED_MEMORY.iterdir()}
    with plant_at_work(args.seed) as (plant, judge):
        chaos = Chaos(plant, judge, report, args.recovery_s)
        chaos.begin()
        if chaos.recovered() is None:
            report.fail("the gateway did not come up")
        plan = [args.fault] if args.fault is not None else range(1_000_000)
        end_s = time.monotonic() + 60 * args.minutes
        for number in plan:
            if args.fault is None and time.monotonic() > end_s:
                break
            planned_fault = planned(args.seed, number, args.only)
            chaos.play(planned_fault)
            progress(
                f"{number:4d} {planned_fault.name}, {planned_fault.lasts_s:.1f} s; "
                f"{len(judge.findings)} forbidden outputs, {len(report.failures)} other failures"
            )
        time.sleep(2)
        chaos.end(shared)
        replayed(plant.gateway.recording, report)
        if args.out is not None:
            args.out.mkdir(parents=True, exist_ok=True)
            shutil.copy(plant.gateway.folder / "gateway.log", args.out / "chaos.log")
    return _report(report, chaos, args.out)


def replayed(folder: Path, report: Report) -> None:
    """Every decision of the run is taken again from what was recorded: the same, but for the gaps that are recorded."""
    replay = Replay(RecordedRules())
    other = [found for found in replay.run(records(segments_of([folder]))) if isinstance(found, Difference)]
    report.row(
        "steps replayed from the recording", f"{replay.steps}; {replay.images} register images, {len(other)} other"
    )
    report.row("missing in the recording", str(len(replay.missing)))
    report.data["missing"] = replay.missing
    for found in other[:5]:
        report.fail(f"replayed otherwise: {found.place}: {found.what}")


def _report(report: Report, chaos: Chaos, folder: Path | None) -> int:
    seen, figures, gateway = chaos.seen, chaos.judge.figures, chaos.plant.gateway
    report.findings(chaos.judge.findings)
    report.row("faults played", f"{seen.played.total()}, of {len(FAULTS)} kinds")
    report.row("gateway started", f"{gateway.starts} times")
    outcomes = {OUTCOMES.get(code, f"exception {code - 256}"): n for code, n in figures.outcomes.items()}
    report.row("polls of the PLC (every 50 ms)", f"{figures.polls}: {table(outcomes)}")
    report.row("moments judged (every 20 ms)", str(figures.judged))
    late = {name: seconds for name, seconds in figures.late_s.items() if seconds}
    every = [value for seconds in late.values() for value in seconds]
    if every:
        worst = max(late, key=lambda name: max(late[name]))
        report.row(
            "truck at its mark until MayMove was off",
            f"{len(every)} times, longest {1e3 * max(every):.0f} ms ({worst}); allowed {1e3 * LATE_S:.0f} ms, "
            f"{1e3 * STARVED_LATE_S:.0f} ms without processor time",
        )
    report.row("in place; releases", f"{figures.visits_in_place}; {figures.releases}")
    share = figures.may_move_s / figures.truth_clear_s if figures.truth_clear_s else 0.0
    report.row("MayMove on, of the time a truck was before the mark or beyond", f"{share:.0%}")
    longest = sorted(((max(times), name) for name, times in seen.recovered_s.items()), reverse=True)
    for seconds, name in longest[:3]:
        report.row("longest recovery", f"{seconds:.1f} s after: {name}")
    report.row("ended by itself, and started again", table(seen.ended))
    memory, descriptors = max(seen.memory_mib, default=0.0), max(seen.descriptors, default=0)
    report.row("main process: most growth in one life", f"{memory:.1f} MiB, {descriptors} descriptors")
    if memory > MEMORY_MIB:
        report.fail(f"the main process grew by {memory:.0f} MiB")
    if descriptors > DESCRIPTORS:
        report.fail(f"the main process kept {descriptors} more descriptors")
    report.row("log lines", table(gateway.log_lines))
    report.data |= {
        "played": seen.played,
        "recovered_s": {name: [round(s, 2) for s in times] for name, times in seen.recovered_s.items()},
        "late_s": {name: [round(s, 3) for s in seconds] for name, seconds in late.items()},
        "unexpected_log_lines": list(gateway.unexpected),
    }
    return report.end(folder)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--fault", type=int, metavar="NUMBER", help="play only this one of the seed")
    parser.add_argument("--only", default="", metavar="TEXT", help="draw only faults whose name contains this")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write chaos.md and chaos.json there")
    parser.add_argument("--recovery-s", type=float, default=RECOVERY_S, help="allowed after a fault (default: 20)")
    parser.add_argument("--list", action="store_true", help="list the faults")
    args = parser.parse_args()
    if args.list:
        for fault in FAULTS:
            print(f"{fault.name}: {fault.least_s:g} to {fault.most_s:g} s")
        return 0
    print(f"again: {shlex.join(['python', '-m', 'bench.chaos', *sys.argv[1:]])}", file=sys.stderr)
    return run(args)


if __name__ == "__main__":
    sys.exit(main())
