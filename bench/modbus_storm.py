"""Bad neighbours, all at once: does the configured PLC still get its answers, and does memory stay flat?

    python -m bench.modbus_storm [--seconds 60] [--idle 1000] [--held]

One process has the server; another plays 1,000 idle clients, clients of random bytes, half frames, floods of pipelined
requests and clients that never read, all of which come back when they are thrown out; a third is the PLC, which polls
100 registers every 10 ms from 127.0.0.2, an address in plc_addresses. With `--held` the cap is 1,200, so that all of
the idle ones stay connected; without, it is the default of 64, and most are refused again and again. Told are the
PLC's answer times before and during the storm, the server's memory over time, and its counters.
"""

import argparse
import os
import random
import socket
import struct
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from bench.modbus import programs
from bench.modbus.programs import Load, Server, build, load, ours

ASK = struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, 0, 100)
KINDS = {"random": 20, "half": 20, "flood": 8, "deaf": 8}  # how many of each besides the idle ones
PARTS = 6
AT_ONCE = 30  # connections in one go: more than the server's backlog would be lost by the kernel, not refused


class Neighbour:
    """One client that is up to no good, or to nothing."""

    def __init__(self, kind: str, seed: int) -> None:
        self.kind = kind
        self.rng = random.Random(seed)
        self.sock: socket.socket | None = None
        self.again_s = 0.0  # when it may connect again

    def connect(self, port: int, now_s: float) -> None:
        if self.sock is not None or now_s < self.again_s:
            return
        sock = socket.socket()
        if self.kind == "deaf":
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        sock.setblocking(False)
        with suppress(BlockingIOError):
            sock.connect(("127.0.0.1", port))
        self.sock = sock
        if self.kind == "half":
            self.again_s = now_s + 0.02

    def act(self) -> None:
        """Send something, if it is that kind. OSError: thrown out."""
        assert self.sock is not None
        try:
            if self.kind == "random":
                self.sock.send(self.rng.randbytes(self.rng.randrange(1, 300)))
            elif self.kind == "half" and self.again_s:
                self.sock.send(ASK[: self.rng.randrange(1, 11)])
                self.again_s = 0.0
            elif self.kind in ("flood", "deaf"):
                self.sock.send(ASK * 40)
            if self.kind != "deaf" and self.sock.recv(65536) == b"":
                raise ConnectionResetError
        except BlockingIOError:
            pass

    def gone(self, now_s: float) -> None:
        assert self.sock is not None
        self.sock.close()
        self.sock = None
        self.again_s = now_s + self.rng.uniform(0.05, 0.5)


def play(port: int, idle: int, seconds: float) -> None:
    """The storm itself, in a process of its own."""
    crowd = [Neighbour(kind, seed) for kind, count in {"idle": idle, **KINDS}.items() for seed in range(count)]
    end_s = time.monotonic() + seconds
    while (now_s := time.monotonic()) < end_s:
        arriving = 0
        for neighbour in crowd:
            if neighbour.sock is None and arriving < AT_ONCE:
                neighbour.connect(port, now_s)
                arriving += neighbour.sock is not None
            if neighbour.sock is None:
                continue
            try:
                neighbour.act()
            except OSError:
                neighbour.gone(now_s)
        time.sleep(0.001)


def storm(seconds: float, idle: int, held: bool) -> None:
    keys = ['plc_addresses=["127.0.0.2"]', f"max_connections={1200 if held else 64}", "idle_timeout_s=3600"]
    with tempfile.TemporaryDirectory() as folder, ours("uvloop", "--set", *keys) as server:
        generator = build("load", Path(folder))

        def plc(part_s: float) -> Load:
            return load(generator, server.port, seconds=part_s, registers=100, period_us=10_000, source="127.0.0.2")

        calm = plc(5)
        print(f"calm:          p50 {calm.p50:.0f}, p99 {calm.p99:.0f}, longest {calm.longest:.0f} us; {memory(server)}")
        command = [sys.executable, "-m", "bench.modbus_storm", "--play", str(server.port)]
        command += ["--idle", str(idle), "--seconds", str(seconds + 5)]
        bad = subprocess.Popen(command, cwd=programs.ROOT)
        try:
            time.sleep(3)
            for part in range(1, PARTS + 1):
                found = plc(seconds / PARTS)
                print(
                    f"storm, part {part}: p50 {found.p50:.0f}, p99 {found.p99:.0f}, longest {found.longest:.0f} us, "
                    f"{found.answers} polls, wrong {found.wrong}; {memory(server)}, {server.counters()['open']} open"
                )
        finally:
            bad.terminate()
            bad.wait()
        print(server.counters())


def memory(server: Server) -> str:
    return f"{server.resident_kib() / 1024:.1f} MiB"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--idle", type=int, default=1000)
    parser.add_argument("--held", action="store_true")
    parser.add_argument("--realtime", action="store_true", help="SCHED_FIFO for the server and the PLC, not the storm")
    parser.add_argument("--play", type=int, metavar="PORT", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.play is not None:
        play(args.play, args.idle, args.seconds)
        return
    programs.realtime = args.realtime
    print(f"{os.cpu_count()} CPUs, load average {os.getloadavg()[0]:.1f} at the begin")
    storm(args.seconds, args.idle, args.held)


if __name__ == "__main__":
    main()
