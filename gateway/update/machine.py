"""What an update does to the machine, and asks of it: programs, links, files. IO; everything else is handed this."""

import contextlib
import fcntl
import os
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from gateway import status_file, update_request
from gateway.clock import SystemClock
from gateway.durations import NS_PER_S
from gateway.errors import GatewayError, LinkError, ProtocolError
from gateway.files import replacing, sync_folder
from gateway.modbus import client
from gateway.net.listener import from_here
from gateway.shared_state import SharedStateReader, SharedVector, attachable
from gateway.status_file import Status

UNIT = "loading-gateway.service"
WATCHER_UNIT = "loading-gateway-update.service"
SAVED = "gateway.toml.saved-"  # no version has a dash
STALE_S = 5.0  # of the status file, which is written each second
COMMAND_S = 120.0
_SYSTEM_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"


class UpdateError(GatewayError):
    """The update can't go on; the text says why and what to do. The running version is not affected."""


@dataclass(frozen=True, slots=True)
class InstallPaths:
    """Where an installed machine has what (docs/update.md). `root`: of another tree, for tests."""

    root: Path = Path("/")

    @property
    def versions(self) -> Path:
        return self.root / "opt/loading-gateway/versions"

    @property
    def current(self) -> Path:
        return self.root / "opt/loading-gateway/current"

    @property
    def config(self) -> Path:
        return self.root / "etc/loading-gateway/gateway.toml"

    @property
    def new_config(self) -> Path:
        """The migrated copy, beside the original: paths in it may be relative."""
        return self.config.with_name("gateway.toml.update")

    @property
    def keyrings(self) -> tuple[Path, ...]:
        """The plant's own, and the one that is shipped."""
        return self.root / "etc/loading-gateway/release.gpg", self.root / "usr/share/loading-gateway/release.gpg"

    @property
    def status(self) -> Path:
        return self.root / "run/loading-gateway" / status_file.NAME

    @property
    def folder(self) -> Path:
        """The state of updates."""
        return self.root / "var/lib/loading-gateway-update"

    @property
    def state(self) -> Path:
        return self.folder / "state.json"

    @property
    def log(self) -> Path:
        return self.folder / "log.txt"

    @property
    def lock(self) -> Path:
        return self.folder / "lock"

    @property
    def package(self) -> Path:
        """The copy that is verified and installed, whatever happens to the file that was named."""
        return self.folder / "package.deb"

    @property
    def watcher(self) -> Path:
        """Link to the version whose code watches; there is one while an update is under way."""
        return self.folder / "watcher"

    @property
    def spool(self) -> Path:
        """Where the pages leave a package and a request: the service's user's, so nothing in it is trusted."""
        return self.root / "var/lib/loading-gateway" / update_request.SPOOL

    @property
    def shown(self) -> Path:
        """What the pages show of an update: root's own, for everybody to read."""
        return self.versions.parent / update_request.SHOWN

    def executable(self, version: str) -> Path:
        return self.versions / version / "bin" / "gateway"

    def kept_config(self, version: str) -> Path:
        """The configuration as it was when `version` ran last. After an update it stays where that has changed it."""
        return self.folder / f"gateway.toml.{version}"

    def saved_config(self, version: str) -> Path:
        """The configuration as somebody has saved it while `version` was tried, which was not taken. It stays."""
        return self.folder / f"{SAVED}{version}"

    @property
    def rejected(self) -> Path:
        """Names the version of the package that dpkg lists, where it was not taken. packaging/install_version.py, which
        dpkg runs again with each new Python, does not make that version anew."""
        return self.versions.parent / "rejected"


@dataclass(frozen=True, slots=True)
class ProgramResult:
    """What a program has returned and written."""

    code: int
    out: str = ""
    err: str = ""

    @property
    def last_lines(self) -> str:
        """Its last lines, for people."""
        lines = [line.strip() for line in (self.err + "\n" + self.out).splitlines() if line.strip()]
        return "; ".join(lines[-4:]) or f"exit code {self.code}"


@dataclass(frozen=True, slots=True)
class Service:
    """The unit as systemd sees it. `invocation`: another one with each start."""

    state: str = "unknown"  # ActiveState
    pid: int = 0
    invocation: str = ""


@dataclass(slots=True)
class Machine:
    """`programs`: by name, where another one than that on the path is meant."""

    paths: InstallPaths = field(default_factory=InstallPaths)
    programs: dict[str, str] = field(default_factory=dict)
    clock: SystemClock = field(default_factory=SystemClock)

    # Time.

    def now_s(self) -> float:
        return self.clock.now_ns() / NS_PER_S

    def unix_s(self) -> int:
        return self.clock.wall_ns() // NS_PER_S

    def sleep(self, seconds: float) -> None:
        self.clock.block(seconds)

    def boot(self) -> str:
        """Another one after each start of the machine."""
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()

    # Programs.

    def command(self, *words: str | Path, user: str = "", timeout_s: float = COMMAND_S) -> ProgramResult:
        """Run a program to its end. `user`: as whom, where this process is root. Raises UpdateError where it can't be
        started or does not end in time."""
        name, *rest = map(str, words)
        command = [self.programs.get(name, name), *rest]
        # The variables of the caller's shell are not for installation scripts and other versions.
        env = {"PATH": _SYSTEM_PATH, "LC_ALL": "C.UTF-8", "DEBIAN_FRONTEND": "noninteractive"}
        who = {"user": user, "group": user, "extra_groups": []} if user and os.geteuid() == 0 else {}
        try:
            done = subprocess.run(
                command, capture_output=True, timeout=timeout_s, check=False, stdin=subprocess.DEVNULL, env=env,
                text=True, errors="replace", cwd="/", **who,
            )  # type: ignore[call-overload]  # fmt: skip
        except subprocess.TimeoutExpired as error:
            raise UpdateError(f"{name}: has not ended within {timeout_s:.0f} s") from error
        except (OSError, LookupError, ValueError) as error:
            raise UpdateError(f"{name}: can't be started: {error}") from error
        return ProgramResult(done.returncode, done.stdout, done.stderr)

    def service(self) -> Service:
        answer = self.command("systemctl", "show", UNIT, "-p", "ActiveState", "-p", "MainPID", "-p", "InvocationID")
        found = dict(line.partition("=")[::2] for line in answer.out.splitlines())
        pid = found.get("MainPID", "0")
        return Service(
            found.get("ActiveState", "unknown"), int(pid) if pid.isdigit() else 0, found.get("InvocationID", "")
        )

    def service_user(self) -> str:
        """As whom the gateway runs; empty: as root. Raises UpdateError where that is not known: another version must
        not be tried with more rights than it will have."""
        answer = self.command("systemctl", "show", UNIT, "-p", "User")
        key, equals, user = answer.out.strip().partition("=")
        if answer.code != 0 or key != "User" or not equals:
            raise UpdateError(f"systemctl show {UNIT}: the service's user is not known: {answer.last_lines}")
        return user

    def restart(self) -> None:
        """Does not wait: a version that never gets ready must not hold the watcher up."""
        self._system("restart", "--no-block", UNIT)

    def start(self) -> None:
        """Where it has been started already, nothing happens."""
        self._system("start", "--no-block", UNIT)

    def start_watcher(self) -> None:
        self._system("start", "--no-block", WATCHER_UNIT)

    def stop_watcher(self) -> None:
        self._system("stop", WATCHER_UNIT)

    def _system(self, *words: str) -> None:
        answer = self.command("systemctl", *words)
        if answer.code != 0:
            raise UpdateError(f"systemctl {' '.join(words)}: {answer.last_lines}")

    # The running gateway.

    def status(self) -> Status:
        """Of the gateway that runs now. Raises LinkError where there is none, or it is not of now."""
        found = status_file.read(self.paths.status)
        age_s = self.now_s() - found.t_ns / NS_PER_S
        if not -1.0 <= age_s <= STALE_S:
            raise LinkError(f"{self.paths.status}: {age_s:.0f} s old")
        return found

    def registers(self, host: str, port: int, unit_id: int, count: int) -> tuple[int, ...]:
        """The first `count` as a PLC reads them, over plain Modbus TCP. Raises LinkError."""
        here = from_here(host)
        try:
            with client.connect(here, port) as sock:
                return client.holding_registers(sock, unit_id, count)
        except (OSError, ProtocolError) as error:
            why = getattr(error, "strerror", None) or error
            raise LinkError(f"{here} port {port}, unit {unit_id}: {why}") from error

    def decided(self, pid: int, bay: str) -> SharedVector:
        """The shared state of a bay of that process, by this version's layout. Raises LinkError."""
        fault = LinkError("no shared state that this version can read")
        for instance, name in attachable():
            if name != bay:
                continue
            try:
                with SharedStateReader(instance, bay) as reader:
                    vector = reader.read(later=True)
            except LinkError as error:
                fault = error
                continue
            if vector.pid == pid:
                return vector
        raise fault

    # The disk.

    def free_bytes(self, path: Path) -> tuple[int, int]:
        """(file system, free bytes) where `path` is, or would be made."""
        while not path.exists():
            path = path.parent
        found = os.statvfs(path)
        return path.stat().st_dev, found.f_bavail * found.f_frsize

    def size_bytes(self, path: Path) -> int:
        """What a file, or all that is in a folder, takes."""
        if not path.is_dir():
            return path.stat().st_size
        return sum(one.lstat().st_blocks * 512 for one in path.rglob("*"))

    # Links and files: on disk when they return.

    def version(self) -> str:
        """To which `current` points. Raises UpdateError where this is not an installed machine."""
        current = self.paths.current
        try:
            target = os.readlink(current)
        except OSError as error:
            raise UpdateError(f"{current}: {error.strerror}: the gateway was not installed from its package") from error
        return Path(target).name

    def link(self, path: Path, target: Path) -> None:
        """`path` points to `target`, by a relative path; before or after, never without one."""
        if os.path.islink(path) and path.resolve() == target.resolve():
            return
        fresh = scratch(path)
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(os.path.relpath(target, path.parent))
        fresh.replace(path)
        sync_folder(path.parent)

    def write(self, path: Path, data: bytes, like: Path | None = None) -> None:
        """Replace the file at once. `like`: owner and mode of that one; else readable by root only."""
        with replacing(path, fresh=scratch(path)) as file:
            file.write(data)
            if like is not None:
                found = like.stat()
                with contextlib.suppress(PermissionError):
                    os.fchown(file.fileno(), found.st_uid, found.st_gid)
                os.fchmod(file.fileno(), found.st_mode & 0o777)

    def copy(self, source: Path, target: Path) -> None:
        with source.open("rb") as data, replacing(target, 0o644, fresh=scratch(target)) as file:
            shutil.copyfileobj(data, file)

    def remove(self, path: Path) -> None:
        """A file, a link or a folder with all that is in it; nothing where there is none."""
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
        if path.parent.is_dir():
            sync_folder(path.parent)

    def installed(self) -> list[str]:
        """The versions beside each other."""
        if not self.paths.versions.is_dir():
            return []
        return sorted(path.name for path in self.paths.versions.iterdir() if path.is_dir() and path.name[0] != ".")

    @contextlib.contextmanager
    def lock(self, tries: int = 1) -> Iterator[bool]:
        """Held by the one process that works on an update: False: another one does, also after so many `tries`, 0.1 s
        apart. The kernel drops it when that process ends, however it ends."""
        self.paths.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        fd = os.open(self.paths.lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            ours = _locked(fd)
            for _ in range(tries - 1):
                if ours:
                    break
                self.sleep(0.1)
                ours = _locked(fd)
            yield ours
        finally:
            os.close(fd)


def scratch(path: Path) -> Path:
    """Where the next content of `path` is made, beside it. The package's installation does so, too."""
    return path.with_name(f".{path.name}.new")


def _locked(fd: int) -> bool:
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
