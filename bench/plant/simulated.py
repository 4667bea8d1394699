"""`gateway simulate` as a process tree that can be harmed: its processes, their memory and descriptors, its log.

The files of a run are in a folder of its own: configuration, scenario, state, log. Where it may, it gives the gateway a
small file system of its own for its state, which can be filled (Linux, root).
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import psutil

from bench.plant.poller import PLC_ADDRESS
from gateway.config import GatewayConfig, load
from gateway.records.names import PICTURES, SEGMENT
from gateway.sim import scenario as scenarios
from gateway.sim.scenario import Scenario
from tests.e2e.brokers import free_port
from tests.e2e.processes import survivors

ROOT = Path(__file__).resolve().parents[2]
STATE_MB = 64
RECORD_MB = 50  # limit of the recording
RECORDED = (SEGMENT, PICTURES)
STARTED_S = 60.0
# By the beginning of the process's name, as `top` shows it.
ROLES = {"gw-worker": "vision", "gw-hmi": "web", "gw-recorder": "recorder", "gw-template": "template"}
CONFIG = f"""
instance = "{{instance}}"
log_level = "{{log_level}}"
[modbus]
port = {{port}}
writes = {{writes}}
plc_addresses = ["{PLC_ADDRESS}"]
connections_per_address = 16
[hmi]
enabled = true
port = {{hmi_port}}
without_login = "technician"
[records]
max_mb = {RECORD_MB}
picture_mb_per_day = 40
[camera]
deadline_s = 1.0
[guidance]
aim_u_px = 319.5
aim_v_px = 239.5
"""
# A truck every 15 s, which heeds nobody: it drives in whatever the gateway says, and leaves after 4.5 s in place.
TRUCKS = """
seed = {seed}
duration_s = 86400
repeat = true
start = { distance_cm = 120, lateral_mm = -10 }
legs = [
  { name = "drive in", distance_cm = 27, speed_cm_s = 25, hold_s = 4.5 },
  { name = "leave", distance_cm = 120, lateral_mm = -10, speed_cm_s = 40, hold_s = 3 },
]
[clutter]
things = 4
"""


@dataclass(frozen=True, slots=True)
class Usage:
    """Of one process at one moment."""

    role: str
    pid: int
    memory_kib: int  # resident, shared pages included
    descriptors: int
    threads: int
    cpu_s: float


class Simulated:
    """A context manager: the gateway in `folder`. `start` and `kill` may be called again and again.

    `more` is added to the configuration (TOML); `scenario` is the text of one. `writes`: the PLC writes its heartbeat.
    `module`: what is run instead of the gateway's own entry point.
    """

    def __init__(
        self,
        folder: Path,
        *,
        seed: int = 1,
        scenario: str = TRUCKS,
        more: str = "",
        writes: bool = True,
        log_level: str = "warning",
        module: str = "gateway",
    ) -> None:
        self.folder = folder
        self._module = module
        self.port, self.hmi_port = free_port(), free_port()
        self.config_file, self._scenario_file = folder / "gateway.toml", folder / "scenario.toml"
        names = {"instance": f"proof{os.getpid()}", "port": self.port, "hmi_port": self.hmi_port}
        text = CONFIG.format(**names, writes=str(writes).lower(), log_level=log_level) + more
        self.config_file.write_text(text, encoding="utf-8")
        self._scenario_file.write_text(scenario.replace("{seed}", str(seed)), encoding="utf-8")
        self.state = folder / "state"
        self.state.mkdir()
        self.own_disk = os.geteuid() == 0
        self._holder: subprocess.Popen[bytes] | None = None
        self.process: subprocess.Popen[str] | None = None
        self.started: dict[str, Any] = {}
        self.starts = 0
        self.log_lines: Counter[str] = Counter()  # by level
        self.unexpected: deque[str] = deque(maxlen=50)  # lines that report a defect: a traceback, an error
        self.events: Counter[str] = Counter()
        self.log_bytes = 0

    @property
    def scenario(self) -> Scenario:
        return scenarios.load(self._scenario_file)

    @property
    def config(self) -> GatewayConfig:
        return load(self.config_file)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.kill()
        if self._holder is not None:
            self._holder.kill()
            self._holder.communicate()
        with contextlib.suppress(OSError):  # the session number of Sparkplug outlives the gateway on purpose
            Path(f"/dev/shm/loading-gateway-bdseq.{self.started.get('instance')}").unlink()

    # -- its life --------------------------------------------------------------------------------------------------

    def start(self) -> dict[str, Any]:
        """Start it, wait until a PLC could poll; its `started` row."""
        command = [sys.executable, "-m", self._module, "simulate", "--json", "--config", str(self.config_file)]
        command += ["--scenario", str(self._scenario_file), "--state-dir", str(self.state)]
        if self.started:  # the truck goes on meanwhile
            command += ["--world-start-ns", str(self.started["world_start_ns"])]
        if self.own_disk:
            command = [
                "nsenter",
                "-m",
                "-t",
                str(self._disk_of().pid),
                "sh",
                "-c",
                'cd "$0" && exec "$@"',
                str(ROOT),
                *command,
            ]
        self.process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT
        )
        self.starts += 1
        ready = threading.Event()
        self.started = {}
        for reader in (lambda p: self._read_out(p, ready), self._read_err):
            threading.Thread(target=reader, args=(self.process,), daemon=True).start()
        if not ready.wait(STARTED_S) or not self.started:
            raise RuntimeError(f"the gateway did not start: {list(self.unexpected)[-5:]}")
        return self.started

    def kill(self, number: int = signal.SIGKILL) -> int | None:
        """End the main process; its exit code. Raises RuntimeError if a process of it survives."""
        if self.process is None or self.process.poll() is not None:
            return None if self.process is None else self.process.returncode
        family = psutil.Process(self.process.pid).children(recursive=True)
        for one in (*family, psutil.Process(self.process.pid)):
            with contextlib.suppress(psutil.NoSuchProcess):
                one.send_signal(signal.SIGCONT)  # a stopped process could not obey
        self.process.send_signal(number)
        try:
            code = self.process.wait(30)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait(10)
            raise RuntimeError(f"signal {number} did not end the gateway in 30 s") from None
        if left := survivors(family):
            raise RuntimeError(f"processes left behind: {left}")
        return code

    def _disk_of(self) -> subprocess.Popen[bytes]:
        """A process in a mount namespace of its own, where the state folder is a small file system; it outlives the
        gateway, as a disk does, and ends with this program."""
        if self._holder is None:
            script = f'mount -t tmpfs -o size={STATE_MB}m none "$0" && echo && exec cat'
            self._holder = subprocess.Popen(
                ["unshare", "-m", "sh", "-c", script, str(self.state)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
            )
            assert self._holder.stdout is not None
            self._holder.stdout.readline()
        return self._holder

    @property
    def disk(self) -> Path:
        """Its state folder as it sees it."""
        return Path(f"/proc/{self._disk_of().pid}/root{self.state}") if self.own_disk else self.state

    # -- its processes ---------------------------------------------------------------------------------------------

    @property
    def pid(self) -> int:
        assert self.process is not None
        return self.process.pid

    def pids(self, role: str) -> list[int]:
        """Of `main`, `vision`, `web`, `recorder` or `all`."""
        if role == "main":
            return [self.pid]
        try:
            children = psutil.Process(self.pid).children(recursive=True)
            known = [(child.pid, role_of(child.name())) for child in children]
        except psutil.NoSuchProcess:
            return []
        return [self.pid] * (role == "all") + [pid for pid, its in known if role in (its, "all")]

    def usage(self) -> list[Usage]:
        """Of every process of it that is there."""
        found = []
        for pid in self.pids("all"):
            with contextlib.suppress(OSError, psutil.Error):
                process = psutil.Process(pid)
                name = "main" if pid == self.pid else role_of(process.name())
                times = process.cpu_times()
                memory_kib = process.memory_info().rss // 1024
                found.append(
                    Usage(name, pid, memory_kib, process.num_fds(), process.num_threads(), times.user + times.system)
                )
        return found

    @property
    def recording(self) -> Path:
        """The folder of the bay's recording."""
        (found,) = self.disk.glob("records/*/bay1")
        return found

    def files(self) -> tuple[int, int]:
        """Files of its own in its state folder and in shared memory, but for the recordings, and their bytes."""
        instance = str(self.started.get("instance"))
        own = [path for path in Path("/dev/shm").iterdir() if instance in path.name]
        return _count(path for path in (*self.disk.rglob("*"), *own) if path.suffix not in RECORDED)

    def recorded(self) -> tuple[int, int]:
        """Files of the bay's recording, and their bytes."""
        return _count(path for path in self.disk.glob("records/*/bay1/*") if path.suffix in RECORDED)

    # -- what it prints --------------------------------------------------------------------------------------------

    def _read_out(self, process: subprocess.Popen[str], ready: threading.Event) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith('{"type": "state"'):
                continue
            with contextlib.suppress(ValueError):
                row = json.loads(line)
                if row["type"] == "started":
                    self.started = row
                    ready.set()
                elif row["type"] == "event":
                    self.events[row["kind"]] += 1
        ready.set()

    def _read_err(self, process: subprocess.Popen[str]) -> None:
        assert process.stderr is not None
        with (self.folder / "gateway.log").open("a", encoding="utf-8") as log:
            for line in process.stderr:
                log.write(line)
                log.flush()
                self.log_bytes += len(line)
                level = next((word for word in ("DEBUG", "INFO", "WARNING", "ERROR", "CRITICAL") if word in line), "")
                self.log_lines[level or "other"] += 1
                if not level or level in ("ERROR", "CRITICAL"):
                    self.unexpected.append(line.rstrip())


def role_of(name: str) -> str:
    return next((role for start, role in ROLES.items() if name.startswith(start)), name)


def wait_until(true: Any, timeout_s: float, every_s: float = 0.05) -> float | None:
    """Seconds until `true()` is true; None if it is not within `timeout_s`."""
    begun_s = time.monotonic()
    while not true():
        if time.monotonic() - begun_s > timeout_s:
            return None
        time.sleep(every_s)
    return time.monotonic() - begun_s


def _count(paths: Iterable[Path]) -> tuple[int, int]:
    """Regular files, and their bytes; what vanishes meanwhile is left out."""
    sizes = []
    for path in paths:
        with contextlib.suppress(OSError):
            if path.is_file():
                sizes.append(path.stat().st_size)
    return len(sizes), sum(sizes)
