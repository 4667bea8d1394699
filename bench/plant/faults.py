"""What bench.chaos does to a running gateway: each fault begins, lasts, and is taken back.

Signals, limits of the kernel and processes that take the processor, as they happen to a gateway's computer; nothing
here knows the gateway's code. `starved`: the main process may lack processor time, and the bound of docs/reaction-
time.md for that applies. `may_end`: the main process may end of it by itself (it is started again, as a service
manager does).
"""

import contextlib
import errno
import os
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil

from bench.modbus import programs
from bench.plant.poller import PLC_ADDRESS
from bench.plant.simulated import Simulated
from tests.e2e.brokers import Mosquitto

LOW_PRIORITY = 15  # of what stands for other machines: on its own machine the gateway does not compete with them
BURN = "while True: pass"


@dataclass
class Plant:
    """What a fault can reach."""

    gateway: Simulated
    broker: Mosquitto
    programs: Path  # folder of compiled programs


Play = Callable[[Plant], AbstractContextManager[None]]


@dataclass(frozen=True)
class Fault:
    """`play` is in force while its context is open, `least_s` to `most_s`."""

    name: str
    play: Play
    least_s: float
    most_s: float
    starved: bool = False
    may_end: bool = False
    restart: bool = False  # the main process ends, and is started again when the fault is over


def signalled(role: str, number: signal.Signals) -> Play:
    @contextmanager
    def play(plant: Plant) -> Iterator[None]:
        for pid in plant.gateway.pids(role):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, number)
        yield

    return play


def stopped(role: str) -> Play:
    @contextmanager
    def play(plant: Plant) -> Iterator[None]:
        pids = plant.gateway.pids(role)
        for pid in pids:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGSTOP)
        try:
            yield
        finally:
            for pid in reversed(pids):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGCONT)

    return play


def throttled(role: str, stop_s: float, run_s: float) -> Play:
    """It runs `run_s`, then stands still for `stop_s`, again and again."""

    @contextmanager
    def play(plant: Plant) -> Iterator[None]:
        over = threading.Event()

        def duty() -> None:
            while not over.is_set():
                with stopped(role)(plant):
                    over.wait(stop_s)
                time.sleep(run_s)

        thread = threading.Thread(target=duty, daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join(5)

    return play


@contextmanager
def no_processor(plant: Plant) -> Iterator[None]:
    """All of it runs only when nothing else wants to (SCHED_IDLE), beside two programs a CPU that always want to."""
    threads = [int(path.name) for pid in plant.gateway.pids("all") for path in Path(f"/proc/{pid}/task").iterdir()]
    _schedule(threads, os.SCHED_IDLE)
    burning = [subprocess.Popen([sys.executable, "-c", BURN]) for _ in range(2 * len(os.sched_getaffinity(0)))]
    try:
        yield
    finally:
        for one in burning:
            one.kill()
            one.wait()
        _schedule(threads, os.SCHED_OTHER)


def _schedule(threads: list[int], policy: int) -> None:
    for thread in threads:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(thread, policy, os.sched_param(0))


def limited(role: str, what: int, room: Callable[[psutil.Process], int]) -> Play:
    """The soft limit `what` of these processes is set to `room(process)`."""

    @contextmanager
    def play(plant: Plant) -> Iterator[None]:
        before = []
        for pid in plant.gateway.pids(role):
            with contextlib.suppress(OSError, psutil.Error):
                limits = resource.prlimit(pid, what)
                resource.prlimit(pid, what, (room(psutil.Process(pid)), limits[1]))
                before.append((pid, limits))
        try:
            yield
        finally:
            for pid, limits in before:
                with contextlib.suppress(OSError):
                    resource.prlimit(pid, what, limits)

    return play


def both(*plays: Play) -> Play:
    @contextmanager
    def play(plant: Plant) -> Iterator[None]:
        with ExitStack() as stack:
            for one in plays:
                stack.enter_context(one(plant))
            yield

    return play


@contextmanager
def full_disk(plant: Plant) -> Iterator[None]:
    """Its state folder's file system is full; without one of its own, its files may not grow (EFBIG)."""
    gateway = plant.gateway
    if not gateway.own_disk:
        with limited("main", resource.RLIMIT_FSIZE, lambda _: 0)(plant):
            yield
        return
    ballast = gateway.disk / "ballast"
    try:
        with contextlib.suppress(OSError), ballast.open("wb", buffering=0) as file:
            size = 1 << 20
            while size:
                try:
                    file.write(bytes(size))
                except OSError as error:
                    if error.errno != errno.ENOSPC:
                        raise
                    size //= 2
        yield
    finally:
        with contextlib.suppress(OSError):
            ballast.unlink()


@contextmanager
def broker_gone(plant: Plant) -> Iterator[None]:
    plant.broker.kill()
    try:
        yield
    finally:
        plant.broker.start()


@contextmanager
def broker_silent(plant: Plant) -> Iterator[None]:
    plant.broker.pause()
    try:
        yield
    finally:
        plant.broker.resume()


@contextmanager
def broker_again_and_again(plant: Plant) -> Iterator[None]:
    over = threading.Event()

    def restart() -> None:
        while not over.wait(0.3):
            plant.broker.kill()
            plant.broker.start()

    thread = threading.Thread(target=restart, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(30)


FLOOD = """
import os, socket, sys, time
os.nice({nice})
port, topics = int(sys.argv[1]), sys.argv[2:]
text = lambda data: len(data).to_bytes(2, "big") + data
def size(n):
    out = b""
    while True:
        n, low = n >> 7, n & 127
        out += bytes([low | (128 if n else 0)])
        if not n: return out
def packet(kind, body): return bytes([kind]) + size(len(body)) + body
payloads = [b"", b"\\x08", os.urandom(40), os.urandom(3000), b"\\x12\\x10" + os.urandom(14), bytes(60000)]
while True:
    try:
        with socket.create_connection(("127.0.0.1", port), 5) as sock:
            sock.sendall(packet(0x10, text(b"MQTT") + bytes([4, 2, 0, 0]) + text(b"flood%d" % os.getpid())))
            sock.recv(4)
            while True:
                for topic in topics:
                    for payload in payloads:
                        sock.sendall(packet(0x30, text(topic.encode()) + payload))
    except OSError:
        time.sleep(0.05)
"""


@contextmanager
def broker_flood(plant: Plant) -> Iterator[None]:
    """Somebody publishes as fast as the broker takes it, to the topics that the gateway has subscribed to."""
    topics = ["spBv1.0/site1/NCMD/proof", "spBv1.0/site1/DCMD/proof/bay1", "spBv1.0/STATE/host"]
    process = subprocess.Popen([sys.executable, "-c", FLOOD.format(nice=LOW_PRIORITY), str(plant.broker.port), *topics])
    try:
        yield
    finally:
        process.kill()
        process.wait()


@contextmanager
def plc_storm(plant: Plant) -> Iterator[None]:
    """Sixteen connections that ask as fast as they are answered, half of them from the PLC's own address."""
    program = plant.programs / "load"
    if not program.exists():
        programs.build("load", plant.programs)
    command = ["nice", "-n", str(LOW_PRIORITY), str(program), "127.0.0.1", str(plant.gateway.port), "8", "3600", "100"]
    storms = [
        subprocess.Popen([*command, "0", source], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for source in (PLC_ADDRESS, "127.0.0.77")
    ]
    try:
        yield
    finally:
        for one in storms:
            one.kill()
            one.wait()


@contextmanager
def connect_storm(plant: Plant) -> Iterator[None]:
    """Connections without end from the PLC's own address: opened, left or reset, and opened again."""
    over = threading.Event()

    def storm() -> None:
        held: list[socket.socket] = []
        while not over.is_set():
            try:
                sock = socket.create_connection(("127.0.0.1", plant.gateway.port), 1, (PLC_ADDRESS, 0))
            except OSError:
                over.wait(0.05)
                continue
            held.append(sock)
            if len(held) > 40:
                held.pop(0).close()
            over.wait(0.002)
        for sock in held:
            sock.close()

    thread = threading.Thread(target=storm, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(10)


def _descriptors(process: psutil.Process) -> int:
    return process.num_fds()


def _address_space(extra_bytes: int) -> Callable[[psutil.Process], int]:
    return lambda process: int(process.memory_info().vms) + extra_bytes


KILL, TERM = signal.SIGKILL, signal.SIGTERM
FAULTS = (
    Fault("main process killed (SIGKILL)", signalled("main", KILL), 0.1, 1.0, restart=True),
    Fault("main process ended (SIGTERM)", signalled("main", TERM), 0.1, 3.0, restart=True),
    Fault("main process stopped (SIGSTOP), short", stopped("main"), 0.05, 0.6, starved=True),
    Fault("main process stopped (SIGSTOP), long", stopped("main"), 0.6, 8.0, starved=True),
    Fault("vision process killed", signalled("vision", KILL), 0.0, 1.0),
    Fault("vision process stopped", stopped("vision"), 0.05, 6.0),
    Fault("web process killed", signalled("web", KILL), 0.0, 1.0),
    Fault("web process stopped", stopped("web"), 0.5, 8.0),
    Fault("recorder killed", signalled("recorder", KILL), 0.0, 1.0),
    Fault("recorder stopped", stopped("recorder"), 0.5, 40.0),
    Fault("recorder without processor time but 20 ms of 520", throttled("recorder", 0.5, 0.02), 2.0, 20.0),
    Fault("all processes stopped", stopped("all"), 0.1, 6.0, starved=True),
    Fault("main process throttled, 150 ms of 170", throttled("main", 0.15, 0.02), 1.0, 6.0, starved=True),
    Fault("all processes throttled, 60 ms of 80", throttled("all", 0.06, 0.02), 1.0, 6.0, starved=True),
    Fault("no processor time", no_processor, 1.0, 6.0, starved=True),
    Fault("disk full", full_disk, 1.0, 10.0),
    Fault("no descriptors", limited("main", resource.RLIMIT_NOFILE, _descriptors), 1.0, 6.0),
    Fault(
        "no descriptors, and the vision process killed",
        both(limited("main", resource.RLIMIT_NOFILE, _descriptors), signalled("vision", KILL)),
        1.0,
        6.0,
    ),
    Fault(
        "memory limit of the main process",
        limited("main", resource.RLIMIT_AS, _address_space(256 << 10)),
        1.0,
        6.0,
        starved=True,
        may_end=True,
    ),
    Fault("memory limit of the vision process", limited("vision", resource.RLIMIT_AS, _address_space(0)), 1.0, 6.0),
    Fault("broker killed", broker_gone, 0.5, 8.0),
    Fault("broker silent (SIGSTOP)", broker_silent, 0.5, 20.0),
    Fault("broker restarted again and again", broker_again_and_again, 2.0, 6.0),
    Fault("broker floods", broker_flood, 2.0, 6.0),
    Fault("PLCs ask without end", plc_storm, 2.0, 6.0),
    Fault("PLCs connect without end", connect_storm, 2.0, 6.0),
)
