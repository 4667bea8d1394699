"""A machine for tests of `gateway update`: real files, links and locks below a temporary root, a played dpkg, systemd
and gateway, whose own state is in a file there, too: it outlives a process that is killed. Its time is its own.

A version is a folder with `version.json`, a Version: what it does in operation.
"""

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from gateway.core.state import FunctionCheck, Moved, StateVector, Visit, VisitPhase
from gateway.durations import NS_PER_S
from gateway.errors import LinkError
from gateway.modbus.registers.register_map import REGISTERS, encode
from gateway.shared_state import SharedVector
from gateway.status_file import BayNow, ModbusClient, ModbusPort, Status
from gateway.update.machine import InstallPaths, Machine, ProgramResult, Service

OLD, NEW = "1.0", "2.0"
START_S = 3.0  # of a service, until it is active
CONFIG = "# the plant's own comment\nold_key = 1\n"
KILLED = 9


class Version(msgspec.Struct, kw_only=True):
    """`wants`: a key that its configuration must have; `starts` False: its process ends at once."""

    name: str
    wants: str = ""
    migrates: dict[str, str] = {}
    starts: bool = True
    vision: str = "no_target"
    range: str = "no_echo"
    ticks: bool = True
    alarms: dict[str, str] = {}
    alarm_after_s: float = 0.0
    reads: bool = True  # the PLC comes back
    answers: bool = True  # the registers do
    serves: dict[str, int] = {}  # by the name of a register: what it always holds, whatever was decided
    serves_after_s: float = 0.0
    shares: bool = True  # a state that the old version can read
    function_check: str = "off"
    otherwise: list[dict[str, Any]] = []
    refuses: str = ""  # a key that it does not know
    install: str = ""  # why dpkg refuses it
    configures: bool = True  # at a second try, where `install` is set
    switches: bool = False  # its installation changes `current`

    def reads_config(self, text: str) -> bool:
        return self.wants in text and not (self.refuses and self.refuses in text)


class World(msgspec.Struct, kw_only=True):
    """What is there whatever this program does."""

    now_s: float = 1000.0
    boot: int = 1
    runs: str = ""  # version; empty: the service is not started
    config: str = ""  # with which it was started
    began_s: float = 0.0
    starts: int = 0
    unpacked: str = ""  # version of the package that dpkg lists
    half_installed: bool = False
    phase: str = "empty"
    phases: dict[str, str] = {}  # from a time on
    free_mb: float = 1000.0
    watcher_starts: int = 0


SERVICE_USER = "plc"


@dataclass
class PlayedMachine(Machine):
    """`cut`: end the process by os._exit before its so-manieth action, counted from 1; 0: never."""

    cut: int = 0
    count: int = 0
    actions: list[str] = field(default_factory=list)
    users: dict[str, set[str]] = field(default_factory=dict)  # as whom a version was run, by verb

    # The world.

    @property
    def world(self) -> World:
        return msgspec.json.decode((self.paths.root / "world.json").read_bytes(), type=World)

    @world.setter
    def world(self, world: World) -> None:
        (self.paths.root / "world.json").write_bytes(msgspec.json.encode(world))

    def change(self, **fields: Any) -> World:
        self.world = msgspec.structs.replace(self.world, **fields)
        return self.world

    def played(self, version: str) -> Version:
        return msgspec.json.decode((self.paths.versions / version / "version.json").read_bytes(), type=Version)

    def put(self, version: Version) -> None:
        """Its environment."""
        folder = self.paths.versions / version.name
        (folder / "bin").mkdir(parents=True)
        (folder / "version.json").write_bytes(msgspec.json.encode(version))
        (folder / "bin/gateway").write_text("")

    def act(self, what: str) -> None:
        self.count += 1
        self.actions.append(what)
        if self.count == self.cut:
            os._exit(KILLED)

    # Time.

    def now_s(self) -> float:
        return self.world.now_s

    def unix_s(self) -> int:
        return 1_795_400_000 + round(self.world.now_s)

    def sleep(self, seconds: float) -> None:
        self.change(now_s=self.world.now_s + seconds)

    def boot(self) -> str:
        return f"boot {self.world.boot}"

    # Programs.

    def command(self, *words: str | Path, user: str = "", timeout_s: float = 0.0) -> ProgramResult:
        name, *rest = [str(word) for word in words]
        if name in ("gpgv", "nonexistent"):
            return super().command(*words)
        if name == "dpkg-deb":
            fields = Path(rest[1]).read_text().splitlines()[0]
            return ProgramResult(
                0, f"Package: loading-gateway\nVersion: {msgspec.json.decode(fields, type=Version).name}\n"
            )
        if name == "dpkg-query":
            return ProgramResult(0, "iF " if self.world.half_installed else "ii ")
        if name == "dpkg" and rest == ["--configure", "loading-gateway"]:
            return self._dpkg_again()
        if name == "dpkg":
            return self._dpkg(Path(rest[-1]))
        if name == "nice":
            name, *rest = rest[2:]
        self.users.setdefault(rest[0], set()).add(user)
        return self._version(Path(name).parent.parent.name, *rest)

    def _dpkg(self, package: Path) -> ProgramResult:
        version = msgspec.json.decode(package.read_text().splitlines()[0], type=Version)
        self.act("dpkg begins")
        self.change(half_installed=True, unpacked=version.name)
        folder = self.paths.versions / version.name
        if not folder.exists():
            scratch = self.paths.versions / f".{version.name}.new"
            (scratch / "bin").mkdir(parents=True, exist_ok=True)
            self.act("dpkg in its midst")
            if version.install:
                return ProgramResult(1, err=version.install)
            self._make(version)
        if version.switches:
            self.paths.current.unlink()
            self.paths.current.symlink_to(f"versions/{version.name}")
        self.act("dpkg before its end")
        self.change(half_installed=False)
        return ProgramResult(0)

    def _dpkg_again(self) -> ProgramResult:
        self.act("dpkg --configure")
        if not self.world.half_installed:
            return ProgramResult(0)
        version = msgspec.json.decode(self.paths.package.read_text().splitlines()[0], type=Version)
        if not version.configures:
            return ProgramResult(1, err=version.install)
        self._make(version)
        self.change(half_installed=False)
        return ProgramResult(0)

    def _make(self, version: Version) -> None:
        """As packaging/install_version.py does: complete, or not there."""
        scratch = self.paths.versions / f".{version.name}.new"
        (scratch / "bin").mkdir(parents=True, exist_ok=True)
        (scratch / "version.json").write_bytes(msgspec.json.encode(version))
        (scratch / "bin/gateway").write_text("")
        scratch.rename(self.paths.versions / version.name)

    def python_replaced(self) -> None:
        """The machine gets another Python: dpkg has the package that it lists make its version, where it is not there
        and was not rejected."""
        version, mark = self.world.unpacked, self.paths.rejected
        rejected = mark.read_text().strip() if mark.is_file() else ""
        if version not in ("", rejected, *self.installed()):
            self._make(Version(name=version))

    def _version(self, name: str, verb: str, *rest: str) -> ProgramResult:
        self.act(f"{verb} by {name}")
        version = self.played(name)
        if verb == "--version":
            return ProgramResult(0, f"gateway {name}\n")
        if verb == "update":
            text = Path(rest[1]).read_text()
            changed = text
            for old, new in version.migrates.items():
                changed = changed.replace(old, new)
            if changed != text:
                Path(rest[2]).write_text(changed)
            return ProgramResult(0, "migrated\n" if changed != text else "no key has another name in this version\n")
        if verb == "check":
            return (
                ProgramResult(0, "good\n")
                if version.reads_config(Path(rest[0]).read_text())
                else ProgramResult(2, err="unknown key")
            )
        assert verb == "replay"
        return ProgramResult(0, json.dumps({"steps": 7, "missing": [], "otherwise": version.otherwise}))

    def service_user(self) -> str:
        return SERVICE_USER

    # systemd.

    def _begin(self) -> None:
        current = self.version()
        world = self.world
        self.change(
            runs=current, config=self.paths.config.read_text(), began_s=world.now_s, starts=world.starts + 1
        )  # fmt: skip

    def restart(self) -> None:
        self.act("restart")
        self._begin()
        self.act("restarted")

    def start(self) -> None:
        self.act("start")
        if not self.world.runs:
            self._begin()

    def start_watcher(self) -> None:
        self.change(watcher_starts=self.world.watcher_starts + 1)

    def stop_watcher(self) -> None:
        pass

    def power_cut(self) -> None:
        """And the machine starts again: the services are not started yet."""
        self.change(boot=self.world.boot + 1, runs="", config="")

    def ready(self) -> None:
        """The watcher is: systemd starts what waits for it."""
        if not self.world.runs:
            self._begin()

    def _works(self) -> bool:
        world = self.world
        version = self.played(world.runs)
        return version.starts and version.reads_config(world.config)

    def service(self) -> Service:
        world = self.world
        if not world.runs:
            return Service("inactive")
        if not self._works():  # it ends, and is started again
            self.change(starts=world.starts + 1)
            return Service("activating", 0, f"start {world.starts}")
        state = "active" if world.now_s - world.began_s >= START_S else "activating"
        return Service(state, 100 + world.starts, f"start {world.starts}")

    # The gateway.

    def status(self) -> Status:
        world = self.world
        age_s = world.now_s - world.began_s
        if not world.runs or not self._works() or age_s < START_S:
            raise LinkError("status.json: No such file or directory")
        version = self.played(world.runs)
        phase = world.phase
        for from_s, other in world.phases.items():
            phase = other if world.now_s >= float(from_s) else phase
        bay = BayNow(
            heartbeat=round(age_s * 50) if version.ticks else 5,
            vision=version.vision,
            range=version.range,
            phase=phase,
            function_check=version.function_check,
        )
        plc = ModbusClient(address="10.0.0.7", is_plc=True, quiet_s=0.1 if version.reads and age_s > 10 else 99.0)
        return Status(
            version=world.runs,
            pid=100 + world.starts,
            t_ns=round(world.now_s * NS_PER_S),
            bays={"bay1": bay},
            modbus=(ModbusPort(host="127.0.0.1", port=502, clients=(plc,)),),
            alarms=version.alarms if age_s >= version.alarm_after_s else {},
        )

    def _state(self) -> StateVector:
        bay = self.status().bays["bay1"]
        t_ns = round(self.now_s() * NS_PER_S)
        return StateVector(
            "bay1",
            t_ns=t_ns,
            seq=t_ns // 10_000_000,
            heartbeat=bay.heartbeat,
            visit=Visit(VisitPhase[bay.phase.upper()]),
            function_check=FunctionCheck[bay.function_check.upper()],
        )

    def registers(self, host: str, port: int, unit_id: int, count: int) -> tuple[int, ...]:
        version, world = self.played(self.world.runs), self.world
        if not version.answers:
            raise LinkError("no answer")
        image = list(encode(self._state(), 0, "big"))
        if world.now_s - world.began_s >= version.serves_after_s:
            for register in REGISTERS:
                image[register.address] = version.serves.get(register.name, image[register.address])
        return tuple(image[:count])

    def decided(self, pid: int, bay: str) -> SharedVector:
        if not self.played(self.world.runs).shares:
            raise LinkError("no shared state that this version can read")
        state, nan = self._state(), float("nan")
        return SharedVector(
            bay, pid, state.seq, state.t_ns, 0, 0, state.t_ns, 0, nan, nan, nan, nan, nan, state.vision.quality,
            state.range.quality, state.reason, state.d, state.stop, state.may_move, state.in_place, Moved.NO,
        )  # fmt: skip

    def free_bytes(self, path: Path) -> tuple[int, int]:
        return 1, round(self.world.free_mb * 1e6)

    # Files: each action, and what is between two of them, may be the last.

    def write(self, path: Path, data: bytes, like: Path | None = None) -> None:
        self.act(f"write {path.name}")
        super().write(path, data, like)

    def link(self, path: Path, target: Path) -> None:
        self.act(f"link {path.name}")
        super().link(path, target)

    def copy(self, source: Path, target: Path) -> None:
        self.act(f"copy {target.name}")
        super().copy(source, target)

    def remove(self, path: Path) -> None:
        self.act(f"remove {path.name}")
        if path.is_dir() and not path.is_symlink():
            (path / "bin/gateway").unlink(missing_ok=True)
            self.act(f"remove {path.name} in its midst")
        super().remove(path)


def installed(root: Path, *versions: Version, cut: int = 0) -> PlayedMachine:
    """A machine on which the first of these versions runs and the others lie beside it."""
    machine = PlayedMachine(InstallPaths(root), cut=cut)
    for folder in (machine.paths.config.parent, machine.paths.folder, machine.paths.versions):
        folder.mkdir(parents=True)
    machine.paths.config.write_text(CONFIG)
    machine.world = World()
    for version in versions or (Version(name=OLD),):
        machine.put(version)
    machine.paths.current.symlink_to(f"versions/{(versions or (Version(name=OLD),))[0].name}")
    machine.ready()
    machine.sleep(100)
    return machine


def package(machine: PlayedMachine, version: Version) -> Path:
    path = machine.paths.root / f"loading-gateway_{version.name}.deb"
    path.write_bytes(msgspec.json.encode(version))
    return path
