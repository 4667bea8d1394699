"""Gateways on this machine as Ansible's hosts, each with a folder as its root. systemd is played: a thread starts each
gateway again whose file `restart` was touched. So are the gateways, where nothing is to depend on the machine's load:
what they write of themselves is the product's, with a failure where the camera's folder is missing."""

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Self

import msgspec
import yaml

from gateway import config
from gateway.config import GatewayConfig
from gateway.config.digest import digest
from gateway.gateway_facts import reviewed_digest, reviewed_path
from gateway.status_file import BayNow, Status

ROOT = Path(__file__).parents[2]
COLLECTION = ROOT / "packaging/ansible"
CONFIG = "etc/loading-gateway/gateway.toml"
PROGRAM = f'#!/bin/sh\nPYTHONPATH={ROOT} exec {sys.executable} -m gateway "$@"\n'


@dataclass(slots=True)
class Box:
    """`real`: a gateway's process; else what it would write."""

    root: Path
    real: bool
    starts: int = 0
    process: "subprocess.Popen[bytes] | None" = None
    in_force: GatewayConfig | None = None
    digest: str = ""

    @property
    def name(self) -> str:
        return self.root.name

    @property
    def config(self) -> Path:
        return self.root / CONFIG

    def digests(self) -> tuple[str, str]:
        """Of the file that lies there, by the gateway itself, and the reviewed one; without line's end."""
        reviewed = self.config.with_name("gateway.toml.reviewed")
        command = [str(self.root / "opt/loading-gateway/current/bin/gateway"), "check", str(self.config), "--digest"]
        there = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
        return there, reviewed.read_text().strip() if reviewed.exists() else ""

    def make(self) -> None:
        for folder in ("etc/loading-gateway", "run/loading-gateway", "var/lib", "opt/loading-gateway/current/bin"):
            (self.root / folder).mkdir(parents=True)
        program = self.root / "opt/loading-gateway/current/bin/gateway"
        program.write_text(PROGRAM)
        program.chmod(0o755)

    def end(self) -> None:
        if self.process is not None and self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            try:
                self.process.wait(30)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait(30)
        self.process = None

    def start(self) -> None:
        self.end()
        self.starts += 1
        if not self.real:
            self.in_force = config.load(self.config)
            self.digest = digest(self.in_force)
            return
        with (self.root / "log").open("ab") as log:
            self.process = subprocess.Popen(
                [self.root / "opt/loading-gateway/current/bin/gateway", "run", self.config],
                stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                env={**os.environ, "RUNTIME_DIRECTORY": str(self.root / "run/loading-gateway"),
                     "STATE_DIRECTORY": str(self.root / "var/lib")},
            )  # fmt: skip

    def play(self) -> None:
        """One moment of a gateway that is not real."""
        if self.in_force is None:
            return
        bays = {
            bay.name: BayNow(vision="good", range="good", phase="empty", function_check="off",
                             ne107=() if Path(str(bay.camera.url)).exists() else ("failure",))
            for bay in self.in_force.bays
        }  # fmt: skip
        status = Status(
            version="1.0",
            pid=1,
            t_ns=time.clock_gettime_ns(time.CLOCK_BOOTTIME),
            bays=bays,
            boot=f"start {self.starts}",
            in_force=self.digest,
            reviewed=reviewed_digest(reviewed_path(str(self.config))),
        )
        path = self.root / "run/loading-gateway/status.json"
        fresh = path.with_name("new")
        fresh.write_bytes(msgspec.json.encode(status))
        fresh.replace(path)


@dataclass(slots=True)
class Boxes:
    """A context manager. `folder`: of the control machine: inventory, reviewed files (`gateways/NAME.toml`) and the
    roots (`boxes/NAME`). `variables`: of all hosts."""

    folder: Path
    names: list[str]
    variables: dict[str, object] = field(default_factory=dict)
    real: bool = False
    boxes: dict[str, Box] = field(default_factory=dict)
    _over: threading.Event = field(default_factory=threading.Event)
    _systemd: threading.Thread | None = None

    def __enter__(self) -> Self:
        for name in self.names:
            self.boxes[name] = Box(self.folder / "boxes" / name, self.real)
            self.boxes[name].make()
        self.control()
        self._systemd = threading.Thread(target=self._restarts, daemon=True)
        self._systemd.start()
        return self

    def control(self) -> None:
        """The control machine alone: who calls this instead of entering makes the roots."""
        (self.folder / "gateways").mkdir()
        (self.folder / "ansible.cfg").touch()
        collections = self.folder / "collections/ansible_collections/loading"
        collections.mkdir(parents=True)
        (collections / "gateway").symlink_to(COLLECTION)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        if self._systemd is not None:
            self._systemd.join(60)
        for box in self.boxes.values():
            box.end()
            if kind is not None:
                print(box.name, (box.root / "log").read_text()[-1500:] if (box.root / "log").exists() else "no log")

    def _restarts(self) -> None:
        while not self._over.wait(0.1):
            for box in self.boxes.values():
                if (asked := box.root / "restart").exists():
                    asked.unlink()
                    box.start()
                box.play()

    def play(self, playbook: str, *arguments: str, **extra: object) -> "subprocess.CompletedProcess[str]":
        """To its end, whatever that is."""
        root = str(self.folder / "boxes/{{ inventory_hostname }}")
        variables = {
            "ansible_connection": "local",
            "ansible_become": False,
            "ansible_python_interpreter": sys.executable,
            "loading_gateway_root": root,
            "loading_gateway_user": "",
            "loading_gateway_restart": ["touch", f"{root}/restart"],
            "loading_gateway_wait_s": 0,
            "loading_gateway_steady_s": 1,
            "loading_gateway_within_s": 200,
            **self.variables,
        }
        hosts = {"loading_gateways": {"hosts": dict.fromkeys(self.names), "vars": variables}}
        inventory = self.folder / "inventory.yml"
        inventory.write_text(yaml.safe_dump(hosts, sort_keys=False))
        command = [str(Path(sys.executable).with_name("ansible-playbook")), "-i", str(inventory)]
        command.append(f"loading.gateway.{playbook}")
        for key, value in extra.items():
            command += ["-e", yaml.safe_dump({f"loading_gateway_{key}": value}, default_flow_style=True).strip()]
        return subprocess.run(
            [*command, *arguments], capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL,
            timeout=500, env={**os.environ, **environment(self.folder)},
        )  # fmt: skip


def environment(folder: Path) -> dict[str, str]:
    """Nothing of the user's own Ansible is read or written."""
    return {
        "ANSIBLE_COLLECTIONS_PATH": str(folder / "collections"),
        "ANSIBLE_CONFIG": str(folder / "ansible.cfg"),
        "ANSIBLE_HOME": str(folder / "ansible"),
        "ANSIBLE_LOCAL_TEMP": str(folder / "ansible/tmp"),
        "ANSIBLE_REMOTE_TEMP": str(folder / "ansible/remote"),
        "ANSIBLE_NOCOLOR": "1",
        "ANSIBLE_PIPELINING": "1",
        "LC_ALL": "C.UTF-8",
    }
