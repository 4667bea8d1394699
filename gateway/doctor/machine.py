"""The machine that the gateway runs on: versions, clock, disk, processors, priority. IO, and nothing is changed."""

import ctypes
import errno
import os
import platform
import resource
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryFile

import psutil

from gateway import __version__, bay_file
from gateway.config import GatewayConfig
from gateway.records import recorder_service as records
from gateway.web.ipc.devices import Finding, Verdict

GB = 1e9
STA_UNSYNC = 0x0040  # adjtimex(2): nobody keeps this clock right
TIMEX_BYTES = 512  # more than struct timex takes on any machine
STATUS_AT = {8: 40, 4: 20}  # offset of its field `status`, by the size of a long
BUSY_SHARE = 0.7  # of all processors; above it, readings come late
TIMEDATECTL_S = 5.0
CARDS = ("SD", "MMC")  # what /sys calls them; the `type` of other disks is a number
WORN = 8  # of 10: JEDEC's estimate of how much of an eMMC's life is used, in tenths
WRITES_A_DAY_GB = 0.4  # of one bay's recording, at most (docs/records.md)


def versions() -> Finding:
    names = ("opencv-python-headless", "numpy", "pydantic", "aiomqtt")
    parts = [f"gateway {__version__}", f"Python {platform.python_version()}", *(f"{n} {version(n)}" for n in names)]
    system = f"{platform.system()} {platform.release()}, {platform.machine()}"
    return Finding("versions", "", Verdict.OK, "read them", ", ".join([*parts, system]))


def kernel_status() -> int:
    """`status` of adjtimex(2). Raises OSError."""
    libc = ctypes.CDLL(None, use_errno=True)
    timex = ctypes.create_string_buffer(TIMEX_BYTES)  # modes = 0: nothing is set
    if libc.adjtimex(timex) < 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))
    return ctypes.c_int.from_buffer(timex, STATUS_AT[ctypes.sizeof(ctypes.c_long)]).value


def service_manager_status() -> bool:
    """Is the clock kept right, by systemd's own service for it? Raises OSError where it does not say."""
    command = ("timedatectl", "show", "--property=NTPSynchronized", "--value")
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEDATECTL_S, check=False)
    except subprocess.TimeoutExpired as error:
        raise TimeoutError(errno.ETIMEDOUT, "timedatectl does not answer") from error
    answer = done.stdout.strip()
    if answer not in ("yes", "no"):
        lines = (done.stderr or done.stdout).strip().splitlines()
        raise OSError(errno.EIO, f"timedatectl: {lines[0] if lines else 'no answer'}")
    return answer == "yes"


def clock(status: Callable[[], int] = kernel_status, service: Callable[[], bool] = service_manager_status) -> Finding:
    tried = "ask the kernel whether it is kept right"
    try:
        synchronised = not status() & STA_UNSYNC
    except OSError:  # the unit's ProtectClock= forbids even the question
        tried = "ask timedatectl whether it is kept right"
        try:
            synchronised = service()
        except OSError as error:
            remedy = "run timedatectl on the machine: it says whether the clock is synchronised"
            return Finding("clock", "", Verdict.WARNING, tried, str(error.strerror), remedy)
    if not synchronised:
        remedy = "timedatectl set-ntp true; times in records need it, decisions do not"
        return Finding("clock", "", Verdict.WARNING, tried, "it is not synchronised", remedy)
    return Finding("clock", "", Verdict.OK, tried, "synchronised")


def folders(config: GatewayConfig) -> Iterator[Finding]:
    """Of what is kept: can it be written, and is there room?"""
    state = bay_file.folder_of(config)
    if state is None:
        yield Finding("disk", "", Verdict.WARNING, "state_dir", "empty: nothing is kept", "set state_dir")
        return
    yield _folder("state", state, 0.01)
    recordings = records.folder_of(config)
    if recordings is not None:
        kept_gb = len(config.bays) * config.records.max_mb / 1000
        yield _folder("records", recordings, kept_gb, "records.max_mb", config.records.min_free_percent)
        yield from _wear(recordings, len(config.bays))


def _existing(folder: Path) -> Path:
    """Itself, or the nearest folder above it that is there, as far as this user may see."""
    return next(path for path in (folder, *folder.parents) if os.path.exists(path))


def _size_gb(folder: Path) -> float:
    """Of all that is in it; what goes while it is counted is not."""
    total = 0
    for place, _, names in os.walk(folder):
        for name in names:
            with suppress(OSError):
                total += os.stat(os.path.join(place, name), follow_symlinks=False).st_size
    return total / GB


def _folder(name: str, folder: Path, needed_gb: float, key: str = "", free_percent: float = 0.0) -> Finding:
    there = _existing(folder)
    tried = f"write a file to {there}"
    try:
        with TemporaryFile(dir=there) as file:
            file.write(b"\0" * 4096)
            file.flush()
            os.fsync(file.fileno())
        total, _, free = shutil.disk_usage(there)
    except OSError as error:
        remedy = "name a folder that this user may write to"
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            remedy = "free some space"
        elif error.errno in (errno.EROFS, errno.EIO):
            remedy = "the disk takes no writes: look at what the kernel says of it (dmesg); it may have to be replaced"
        elif there == folder:
            remedy = f"give this user ({psutil.Process().username()}) the right to write there"
        return Finding("disk", name, Verdict.FAULT, tried, str(error.strerror), remedy)
    taken_gb = _size_gb(folder) if there == folder else 0.0
    usable_gb = (free - total * free_percent / 100) / GB
    result = f"{free / GB:.1f} GB of {total / GB:.1f} GB are free"
    if usable_gb + taken_gb < needed_gb:
        result += f", up to {needed_gb:.1f} are to be kept"
        return Finding("disk", name, Verdict.WARNING, tried, result, f"free some space{key and f', or lower {key}'}")
    return Finding("disk", name, Verdict.OK, tried, result)


def _wear(folder: Path, bays: int, system: Path = Path("/sys")) -> Iterator[Finding]:
    """Of the SD card or eMMC that holds `folder`; other disks do not say. `system`: the kernel's folder /sys."""
    number = _existing(folder).stat().st_dev
    device = (system / f"dev/block/{os.major(number)}:{os.minor(number)}").resolve()
    for place in (device, device.parent):  # the disk, or the partition of it
        kind, life = place / "device/type", place / "device/life_time"
        if not kind.exists() or (what := kind.read_text().strip()) not in CARDS:
            continue
        tried = f"ask {place.name} ({what}) how worn it is"
        if not life.exists():
            result = f"it does not say; recording writes up to {bays * WRITES_A_DAY_GB:.1f} GB a day"
            remedy = "take a card made for recording, or a disk" if what == "SD" else ""
            yield Finding("disk", "wear", Verdict.WARNING if remedy else Verdict.OK, tried, result, remedy)
            return
        tenths = max(int(word, 16) for word in life.read_text().split())
        worn = tenths >= WORN
        remedy = "replace it before it fails" if worn else ""
        result = f"up to {10 * tenths} % of its life"
        yield Finding("disk", "wear", Verdict.WARNING if worn else Verdict.OK, tried, result, remedy)
        return


def processors(load: float | None = None, cores: int | None = None) -> Finding:
    """What others leave; what vision takes is in the findings of the cameras."""
    cores = len(os.sched_getaffinity(0)) if cores is None else cores
    load = os.getloadavg()[0] if load is None else load
    result = f"load average {load:.1f} on {cores} processors"
    if load > BUSY_SHARE * cores:
        remedy = "end what else runs here, or give the gateway priority (docs/performance.md)"
        return Finding("processor", "", Verdict.WARNING, "read its load", result, remedy)
    return Finding("processor", "", Verdict.OK, "read its load", result)


def priority(pid: int | None = None) -> Finding:
    """Has the running gateway, process `pid`, real-time priority; None: may a process of this user have it?"""
    remedy = "start it as the systemd service, which gives it (docs/performance.md)"
    if pid is not None:
        tried = f"ask for the priority of the running gateway, process {pid}"
        try:
            policy = os.sched_getscheduler(pid)
        except OSError as error:
            return Finding("priority", "", Verdict.WARNING, tried, str(error.strerror), "is it still running?")
        if policy & ~os.SCHED_RESET_ON_FORK in (os.SCHED_FIFO, os.SCHED_RR):
            return Finding("priority", "", Verdict.OK, tried, "real-time")
        return Finding("priority", "", Verdict.WARNING, tried, "ordinary: other programs may delay it", remedy)
    tried = "ask whether this user may have real-time priority"
    if resource.getrlimit(resource.RLIMIT_RTPRIO)[0] or os.geteuid() == 0:
        return Finding("priority", "", Verdict.OK, tried, "yes")
    return Finding("priority", "", Verdict.WARNING, tried, "no: other programs may delay it", remedy)
