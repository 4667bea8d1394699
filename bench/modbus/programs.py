"""Builds and runs the C programs of these benches, and the gateway's server beside them."""

import json
import os
import shlex
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
ROOT = HERE.parents[1]

realtime = False  # every program started here runs before everybody else's work; needs the privilege


def build(name: str, folder: Path, *libraries: str) -> Path:
    """The program of `name`.c, made in `folder`."""
    program = folder / name
    flags: list[str] = []
    if libraries:
        told = subprocess.run(
            ["pkg-config", "--cflags", "--libs", *libraries], check=True, capture_output=True, text=True
        )
        flags = shlex.split(told.stdout)
    subprocess.run(["gcc", "-O2", "-Wall", "-Wextra", "-o", str(program), str(HERE / f"{name}.c"), *flags], check=True)
    return program


@dataclass
class Server:
    """A running server. Its port is the first line it prints."""

    name: str
    process: subprocess.Popen[str]
    port: int

    def cpu_ns(self) -> int:
        """CPU time of its main thread so far, which answers."""
        return int(Path(f"/proc/{self.process.pid}/schedstat").read_text(encoding="ascii").split()[0])

    def resident_kib(self) -> int:
        status = Path(f"/proc/{self.process.pid}/status").read_text(encoding="ascii")
        return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS"))

    def counters(self) -> dict[str, Any]:
        """Of bench/modbus/our_server.py only."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        return dict(json.loads(self.process.stdout.readline()))


@contextmanager
def running(name: str, command: Sequence[str], cpus: set[int] | None = None) -> Iterator[Server]:
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        cwd=ROOT,
        preexec_fn=lambda: _place(cpus),  # noqa: PLW1509 - no threads yet
    )
    try:
        assert process.stdout is not None
        yield Server(name, process, int(process.stdout.readline()))
    finally:
        process.kill()
        process.wait()


def ours(*arguments: str, cpus: set[int] | None = None) -> Any:
    """The gateway's server: `ours("uvloop", "--churn")`."""
    command = [sys.executable, "-m", "bench.modbus.our_server", *arguments]
    return running(f"gateway on {arguments[0]}", command, cpus)


@dataclass(frozen=True)
class Load:
    """What the load generator tells; times in microseconds."""

    answers: int
    seconds: float
    rate: float
    p50: float
    p99: float
    p999: float
    longest: float
    wrong: int
    torn: int


def load(
    program: Path,
    port: int,
    *,
    connections: int = 1,
    seconds: float = 2.0,
    registers: int = 20,
    period_us: int = 0,
    source: str = "127.0.0.1",
    cpus: set[int] | None = None,
) -> Load:
    numbers = [str(n) for n in (port, connections, seconds, registers, period_us)]
    told = subprocess.run(
        [str(program), "127.0.0.1", *numbers, source],
        check=True,
        capture_output=True,
        text=True,
        preexec_fn=lambda: _place(cpus),
    ).stdout.split()
    seconds, rate, p50, p99, p999, longest = (float(number) for number in told[1:7])
    return Load(int(told[0]), seconds, rate, p50, p99, p999, longest, int(told[7]), int(told[8]))


def favour() -> None:
    """In the child, a whole gateway: as if the machine did nothing else.

    Its main thread runs before other sessions' work; its other processes share as usual, only in a favoured group.
    """
    Path("/proc/self/autogroup").write_text("-20", encoding="ascii")
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))


def _place(cpus: set[int] | None) -> None:
    """In the child: its CPUs, its priority."""
    if cpus is not None:
        os.sched_setaffinity(0, cpus)
    if realtime:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
