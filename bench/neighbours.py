"""Hostile neighbours at every door of a running gateway: does its PLC notice, and does anything stay behind?

    python -m bench.neighbours --minutes 60 --seed 1 --out DIR   an hour; writes DIR/neighbours.md, DIR/neighbours.json
    python -m bench.neighbours --doors modbus pages              only these (modbus, tls, pages, mqtt)

`gateway simulate` runs at real speed with a truck every 15 s. Its doors are played by a process each, at low
priority: Modbus TCP, Modbus/TCP Security and the pages by clients from thousands of addresses of 127.0.0.0/8 whose
frames, handshakes, requests and WebSockets are right, nearly right and random; slow, half open, never reading,
flooding, connecting without end (bench/hostile); MQTT by a broker that does the same to the gateway as its client.
Answers of Modbus are judged by tests/modbus_oracle.py, those of the pages by their form.

Meanwhile an independent poller (bench/modbus/plc.c) polls the gateway and, beside it, a libmodbus server in C to
which nobody else connects: that one shows what the machine itself does to a poll. The simulator's truth judges what
the PLC is shown (bench/plant/judge.py). Before and after the storm the machine is left alone for a while.

Fails, exit code 1, if the PLC's poll is later than libmodbus's by more than 5 ms at p99 during the storm, if an
output was on that the truth forbids, if an answer was wrong, if the gateway or a process of it ended, if a door does
not serve an honest client again within 30 s after the storm, or if memory or descriptors stay behind.

Needs gcc and libmodbus (Debian: libmodbus-dev, pkg-config).
"""

import argparse
import json
import os
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path

from bench.hostile import broker, client, modbus, pages, tls
from bench.modbus import programs
from bench.plant.judge import Judge
from bench.plant.poller import ANSWERED, OUTCOMES, PLC_ADDRESS, Poll, Poller
from bench.plant.report import Report, answer_times, percentile, progress, table
from bench.plant.simulated import ROOT, Simulated, Usage, wait_until
from tests.e2e.brokers import Mosquitto, free_port
from tests.plant_certs import Plant as Certificates

DOORS = ("modbus", "tls", "pages", "mqtt")
GATEWAY, LIBMODBUS = 0, 1
LATER_MS = 5.0
OPEN_AGAIN_S = 30.0
# What may stay behind: a process keeps what it has once used (the web process reached its level after two minutes of
# storm). What is still growing in the second half of the storm is a leak.
MEMORY_MIB = {"main": 48.0, "vision": 48.0, "web": 96.0, "recorder": 96.0, "template": 16.0}
SECOND_HALF_MIB = 16.0
HALVED_S = 60.0  # storms that are shorter have no second half: what is loaded once, some 25 MiB, falls into either
DESCRIPTORS = 8
HONEST = "127.0.0.9"
FROM_PLC = "tls from a PLC's address"
PLC_SERVED_SHARE = 0.95
HEARTBEAT, TICKS_HZ = 2, 50
MORE = """
[modbus.tls]
port = {tls_port}
cert = "{cert}"
key = "{key}"
ca = "{ca}"
crl = "{crl}"
[mqtt]
url = "mqtt://127.0.0.1:{mqtt_port}"
outbox_file = "{folder}/state/outbox.sqlite"
[mqtt.sparkplug]
edge_node_id = "proof"
primary_host_id = "host"
"""


@dataclass
class Times:
    """Answer times of one part of the run, by server, ms; and what else its polls showed."""

    took_ms: tuple[list[float], list[float]] = field(default_factory=lambda: ([], []))
    ticks: int = 0
    begun_s: float = field(default_factory=time.monotonic)
    ended_s: float = 0.0
    failed: int = 0

    @property
    def ticks_hz(self) -> float:
        return self.ticks / max(1e-9, (self.ended_s or time.monotonic()) - self.begun_s)

    def later_ms(self, share: float) -> float:
        return percentile(self.took_ms[GATEWAY], share) - percentile(self.took_ms[LIBMODBUS], share)


class Watch:
    """Gets every poll; the judge gets those of the gateway."""

    def __init__(self, judge: Judge) -> None:
        self._judge = judge
        self._beat: int | None = None
        self.part = Times()
        self.minute = Times()
        self.worst_minute_ms: list[float] = []

    def on_poll(self, poll: Poll) -> None:
        if poll.server == GATEWAY:
            self._judge.poll(poll)
            if poll.outcome == ANSWERED:
                beat = poll.words[HEARTBEAT]
                if self._beat is not None:
                    self.part.ticks += (beat - self._beat) % 65536
                self._beat = beat
            else:
                self.part.failed += 1
        if poll.outcome == ANSWERED or poll.server == GATEWAY:
            for times in (self.part, self.minute):
                times.took_ms[poll.server].append(poll.took_ms)

    def next_part(self) -> Times:
        self.part.ended_s = time.monotonic()
        done, self.part = self.part, Times()
        return done

    def next_minute(self) -> None:
        done, self.minute = self.minute, Times()
        self.worst_minute_ms.append(done.later_ms(0.99))


@dataclass
class Bay:
    """A gateway with all its doors, certificates for its clients, and libmodbus beside it."""

    folder: Path
    seed: int
    certificates: Certificates
    gateway: Simulated
    tls_port: int
    mqtt_port: int

    def files(self, name: str) -> tuple[Path, Path]:
        return self.certificates.folder.certificate_path(name), self.certificates.folder.key_path(name)

    @property
    def ca(self) -> Path:
        return self.certificates.folder.certificate_path("ca")


def bay_in(folder: Path, seed: int) -> Bay:
    certificates = Certificates(folder / "certs")
    certificates.client("viewer", "viewer")
    strange = Certificates(folder / "strange")
    strange.client("stranger", "viewer")
    for kind in ("certificate_path", "key_path"):
        source = getattr(strange.folder, kind)("stranger")
        shutil.copy(source, getattr(certificates.folder, kind)("stranger"))
    tls_port, mqtt_port = free_port(), free_port()
    cert, key = certificates.folder.certificate_path("gateway"), certificates.folder.key_path("gateway")
    more = MORE.format(
        tls_port=tls_port, mqtt_port=mqtt_port, cert=cert, key=key, folder=folder,
        ca=certificates.folder.certificate_path("ca"), crl=certificates.folder.crl_path,
    )  # fmt: skip
    gateway = Simulated(folder, seed=seed, more=more, writes=False)
    return Bay(folder, seed, certificates, gateway, tls_port, mqtt_port)


def play(args: argparse.Namespace) -> None:
    """One door, in a process of its own."""
    about = json.loads(args.about)
    folder = Path(about["certs"])
    match args.play:
        case "mqtt":
            broker.run(about["mqtt"], args.seed)
        case "modbus":
            client.run(client.Door("modbus", about["modbus"], modbus.SCRIPTS, args.clients), args.seed)
        case "pages":
            client.run(client.Door("pages", about["pages"], pages.SCRIPTS, args.clients), args.seed)
        case "tls":
            scripts = tls.scripts(folder / "ca.pem", *[(Path(c), Path(k)) for c, k in about["clients"]])
            client.run(client.Door("tls", about["tls"], scripts, args.clients), args.seed)


def start_doors(bay: Bay, doors: Sequence[str], clients: int) -> dict[str, subprocess.Popen[str]]:
    about = json.dumps(
        {
            "modbus": bay.gateway.port, "pages": bay.gateway.hmi_port, "tls": bay.tls_port, "mqtt": bay.mqtt_port,
            "certs": str(bay.ca.parent), "clients": [[*map(str, bay.files(name))] for name in ("viewer", "stranger")],
        }
    )  # fmt: skip
    command = [sys.executable, "-m", "bench.neighbours", "--seed", str(bay.seed), "--clients", str(clients)]
    command += ["--about", about, "--play"]
    played = {door: subprocess.Popen([*command, door], cwd=ROOT, stdout=subprocess.PIPE, text=True) for door in doors}
    for door, process in played.items():
        assert process.stdout is not None
        if process.stdout.readline() != f"{client.PLAYING}\n":
            raise RuntimeError(f"the program that plays {door} did not start")
    return played


def end_doors(played: dict[str, subprocess.Popen[str]]) -> dict[str, dict[str, object]]:
    """What each has seen."""
    for process in played.values():
        process.send_signal(signal.SIGTERM)
    told = {}
    for door, process in played.items():
        try:
            out, _ = process.communicate(timeout=30)
            told[door] = json.loads(out) if out else {"seen": {}, "wrong": ["the program ended"], "wrong_count": 1}
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            told[door] = {"seen": {}, "wrong": [], "wrong_count": 0}
    return told


def honest_doors(bay: Bay) -> dict[str, Callable[[], bool]]:
    """Door -> does it serve an honest client now? Not MQTT, where the gateway is the client."""

    def ask(raw: socket.socket) -> bool:
        raw.sendall(modbus.ASK)
        data = b""
        while len(data) < modbus.ANSWER_BYTES:
            more = raw.recv(4096)
            if not more:
                return False
            data += more
        return data[7] == 3

    def connected(port: int, source: str = HONEST) -> socket.socket:
        return socket.create_connection(("127.0.0.1", port), 5, (source, 0))

    def by_modbus() -> bool:
        with connected(bay.gateway.port) as raw:
            return ask(raw)

    def by_tls(source: str = HONEST) -> bool:
        made = tls.context(bay.ca, bay.files("viewer"))
        with connected(bay.tls_port, source) as raw, made.wrap_socket(raw, server_hostname="127.0.0.1") as within:
            return ask(within)

    def by_pages() -> bool:
        with connected(bay.gateway.hmi_port) as raw:
            raw.settimeout(10)
            raw.sendall(pages.head("/healthz", Connection="close"))
            return raw.recv(4096).startswith(b"HTTP/1.1 ")

    def whole(try_it: Callable[[], bool]) -> Callable[[], bool]:
        def tried() -> bool:
            with suppress(OSError, ssl.SSLError):
                return try_it()
            return False

        return tried

    return {
        "modbus": whole(by_modbus),
        "tls": whole(by_tls),
        "pages": whole(by_pages),
        FROM_PLC: whole(lambda: by_tls(PLC_ADDRESS)),
    }


def favour(gateway: Simulated, libmodbus: int) -> None:
    """Main and vision process, and libmodbus, run before other programs; their children inherit it."""
    for pid in (*gateway.pids("main"), *gateway.pids("vision"), libmodbus):
        with suppress(FileNotFoundError, ProcessLookupError):
            for thread in Path(f"/proc/{pid}/task").iterdir():
                os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, os.sched_param(1))


def by_role(usage: Sequence[Usage]) -> dict[str, Usage]:
    return {one.role: one for one in usage}


def run(args: argparse.Namespace) -> int:
    storm_s = 60 * args.minutes
    calm_s = args.calm_s or min(60.0, max(10.0, storm_s / 10))
    report = Report(
        "neighbours", args.seed, f"python -m bench.neighbours --minutes {args.minutes:g} --seed {args.seed}"
    )
    with tempfile.TemporaryDirectory(prefix="neighbours-") as name, ExitStack() as stack:
        bay = bay_in(Path(name), args.seed)
        gateway = stack.enter_context(bay.gateway)
        libmodbus = stack.enter_context(
            programs.running("libmodbus", [str(programs.build("libmodbus_server", bay.folder, "libmodbus")), "0"])
        )
        judge = Judge(gateway.scenario, gateway.config)
        watch = Watch(judge)
        judge.gateway_started(int(gateway.start()["world_start_ns"]))
        stack.enter_context(Poller([gateway.port, libmodbus.port], watch.on_poll, period_s=args.period_ms / 1e3))
        if wait_until(judge.healthy, args.again_s) is None:
            report.fail("the gateway did not come up")
        doors = honest_doors(bay)
        for door, serves in doors.items():  # the web process runs from here on
            if wait_until(serves, args.again_s, 0.2) is None:
                report.fail(f"{door}: an honest client is not served before the storm")
        if args.realtime:
            favour(gateway, libmodbus.process.pid)
        watch.next_part()
        time.sleep(calm_s)
        before, calm = by_role(gateway.usage()), watch.next_part()
        played = start_doors(bay, args.doors, args.clients)
        judge.playing = "hostile neighbours"
        half, most, served = _storm(bay, watch, storm_s, doors)
        storm = watch.next_part()
        told = end_doors(played)
        judge.playing = "none"
        _doors_again(report, bay, doors, args.again_s)
        time.sleep(calm_s)
        after, afterwards = by_role(gateway.usage()), watch.next_part()
        usage = {"before": before, "half": half, "most": most, "after": after}
        restarts = _restarts(judge)
        code = gateway.kill(signal.SIGTERM)
        judge.finish()
        if args.out is not None:
            args.out.mkdir(parents=True, exist_ok=True)
            with suppress(OSError):
                shutil.copy(gateway.folder / "gateway.log", args.out / "neighbours.log")
    if code != 0:
        report.fail(f"exit code {code} after SIGTERM")
    if restarts:
        report.fail(f"vision process replaced {restarts} times")
    return _report(report, args, judge, watch, (calm, storm, afterwards), told, served, usage, gateway)


def _report(
    report: Report,
    args: argparse.Namespace,
    judge: Judge,
    watch: Watch,
    parts: tuple[Times, Times, Times],
    told: dict[str, dict[str, object]],
    served: dict[str, list[bool]],
    usage: dict[str, dict[str, Usage]],
    gateway: Simulated,
) -> int:
    report.row("priority of the gateway and libmodbus", "SCHED_FIFO" if args.realtime else "as others")
    report.findings(judge.findings)
    _times(report, dict(zip(("before", "during", "after"), parts, strict=True)), watch, args.later_ms)
    _hostile(report, told, served)
    _usage(report, usage, 60 * args.minutes)
    report.row("log lines", f"{table(gateway.log_lines)}; {gateway.log_bytes / 1024:.0f} KiB")
    outcomes = {OUTCOMES.get(code, f"exception {code - 256}"): n for code, n in judge.figures.outcomes.items()}
    report.row("polls of the gateway", f"{judge.figures.polls}: {table(outcomes)}")
    figures = judge.figures
    share = figures.may_move_s / figures.truth_clear_s if figures.truth_clear_s else 0.0
    report.row("in place", f"{figures.visits_in_place} times")
    report.row("MayMove on, of the time a truck was before the mark or beyond", f"{share:.0%}")
    report.data |= {"unexpected_log_lines": list(gateway.unexpected), "hostile": told}
    return report.end(args.out)


def _storm(
    bay: Bay, watch: Watch, seconds: float, doors: dict[str, Callable[[], bool]]
) -> tuple[dict[str, Usage], dict[str, Usage], dict[str, list[bool]]]:
    """The most memory of each process in the first half, and in all; which honest clients were served, asked every
    second in turn."""
    half: dict[str, Usage] = {}
    most: dict[str, Usage] = {}
    served: dict[str, list[bool]] = {door: [] for door in doors}
    end_s, minute_s, turn = time.monotonic() + seconds, time.monotonic() + 60, 0
    watch.next_minute()
    watch.worst_minute_ms.clear()
    while (now_s := time.monotonic()) < end_s:
        door = list(doors)[turn % len(doors)]
        turn += 1
        served[door].append(doors[door]())
        for one in bay.gateway.usage():
            if one.role not in most or one.memory_kib > most[one.role].memory_kib:
                most[one.role] = one
        if end_s - now_s > seconds / 2:
            half = dict(most)
        if now_s > minute_s or end_s - now_s < 1:
            watch.next_minute()
            minute_s = now_s + 60
            memory = ", ".join(f"{role} {one.memory_kib // 1024} MiB" for role, one in sorted(most.items()))
            progress(
                f"{seconds - (end_s - now_s):5.0f} s: {memory}; p99 later than libmodbus's by "
                f"{watch.worst_minute_ms[-1]:.2f} ms"
            )
        time.sleep(max(0.0, min(1.0, end_s - time.monotonic())))
    return half, most, served


def _doors_again(report: Report, bay: Bay, doors: dict[str, Callable[[], bool]], within_s: float) -> None:
    for door, serves in doors.items():
        took_s = wait_until(serves, within_s, 0.2)
        if took_s is None:
            report.fail(f"{door}: an honest client is not served within {within_s:.0f} s after the storm")
    with tempfile.TemporaryDirectory(prefix="broker-") as name:
        honest = Mosquitto(Path(name))
        honest.port = bay.mqtt_port
        honest.start()
        try:
            if wait_until(lambda: " as gateway-" in honest.log, within_s, 0.2) is None:
                report.fail(f"mqtt: no connection to an honest broker within {within_s:.0f} s after the storm")
        finally:
            honest.kill()


def _restarts(judge: Judge) -> int:
    """Register worker_restarts."""
    return judge.last.words[28] if judge.last is not None and judge.last.words else 0


def _times(report: Report, parts: dict[str, Times], watch: Watch, allowed_ms: float) -> None:
    for name, part in parts.items():
        report.row(f"the PLC's poll, {name} the storm", answer_times(part.took_ms[GATEWAY]))
        report.row(f"libmodbus's, {name} the storm", answer_times(part.took_ms[LIBMODBUS]))
        report.row(f"ticks a second, {name} the storm", f"{part.ticks_hz:.1f}; {part.failed} polls failed")
    later_ms = parts["during"].later_ms(0.99)
    worst = f"{max(watch.worst_minute_ms, default=float('nan')):.2f} ms in the worst minute"
    report.row(
        "later than libmodbus's at p99, during the storm", f"{later_ms:.2f} ms; {worst}; allowed {LATER_MS:g} ms"
    )
    if not later_ms <= allowed_ms:
        report.fail(f"the PLC's poll is later than libmodbus's by {later_ms:.1f} ms at p99")
    report.data["later_ms_by_minute"] = [round(value, 3) for value in watch.worst_minute_ms]


def _hostile(report: Report, told: dict[str, dict[str, object]], served: dict[str, list[bool]]) -> None:
    for door, what in told.items():
        seen = what["seen"]
        assert isinstance(seen, dict)
        report.row(f"played at {door}", table(seen))
        if what["wrong_count"]:
            report.fail(f"{door}: {what['wrong_count']} wrong answers: {what['wrong']}")
    for door, answers in served.items():
        report.row(f"an honest client of {door} during the storm", f"served {sum(answers)} of {len(answers)} times")
    if sum(served[FROM_PLC]) < PLC_SERVED_SHARE * len(served[FROM_PLC]):
        report.fail("a PLC's new connection over TLS is not served during the storm")


def _usage(report: Report, usage: dict[str, dict[str, Usage]], storm_s: float) -> None:
    before, half, most, after = usage.values()
    for role in sorted(before):
        parts = [
            f"{of[role].memory_kib / 1024:.1f} MiB, {of[role].descriptors} descriptors" if role in of else "-"
            for of in usage.values()
        ]
        report.row(f"{role}: before; most in the first half, most in all; after", "; ".join(parts))
        if role not in after or after[role].pid != before[role].pid:
            report.fail(f"the {role} process ended")
            continue
        if (grown := (after[role].memory_kib - before[role].memory_kib) / 1024) > MEMORY_MIB[role]:
            report.fail(f"{role}: {grown:.0f} MiB stay behind")
        if (
            role in half
            and role != "recorder"
            and storm_s >= HALVED_S
            and (grown := (most[role].memory_kib - half[role].memory_kib) / 1024) > SECOND_HALF_MIB
        ):
            report.fail(f"{role}: grew by {grown:.0f} MiB in the second half of the storm")
        if (kept := after[role].descriptors - before[role].descriptors) > DESCRIPTORS:
            report.fail(f"{role}: {kept} descriptors stay behind")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=5.0, help="of storm")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--doors", nargs="+", choices=DOORS, default=list(DOORS))
    parser.add_argument("--calm-s", type=float, help="before and after the storm (default: a tenth of it)")
    parser.add_argument("--clients", type=int, default=32, help="at a time, of each door")
    parser.add_argument("--period-ms", type=float, default=20.0, help="of the PLC's poll")
    parser.add_argument(
        "--realtime",
        action="store_true",
        help="the gateway and libmodbus run before other programs (SCHED_FIFO), as docs/performance.md recommends; "
        "needs the privilege",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="write neighbours.md and neighbours.json there")
    parser.add_argument("--later-ms", type=float, default=LATER_MS, help="allowed at p99 (default: 5)")
    parser.add_argument("--again-s", type=float, default=OPEN_AGAIN_S, help="until a door is open again (default: 30)")
    parser.add_argument("--play", choices=DOORS, help=argparse.SUPPRESS)
    parser.add_argument("--about", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.play is not None:
        play(args)
        return 0
    return run(args)


if __name__ == "__main__":
    sys.exit(main())
