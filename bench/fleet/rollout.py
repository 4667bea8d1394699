"""Ansible rolls out a configuration that every gateway's check accepts and that is bad all the same: a camera that is
not there. With the collection in packaging/ansible, on the boxes' root folders, by its rings."""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from bench.fleet import box
from bench.fleet.roots import Roots

COLLECTION = Path(__file__).parents[2] / "packaging/ansible"
PROGRAMS = Path(sys.executable).parent
NOT_THERE = "/dev/video9"
WITHIN_S = 20  # a changed gateway must be well within this time
STEADY_S = 5


@dataclass(frozen=True)
class Before:
    """Of one box: how its configuration lay there, and which process ran."""

    config: bytes
    written_ns: int
    reviewed: str
    pid: str

    @classmethod
    def of(cls, root: Path) -> "Before":
        file = root / box.CONFIG
        reviewed = file.with_name(f"{file.name}.reviewed").read_text().strip()
        return cls(file.read_bytes(), file.stat().st_mtime_ns, reviewed, (root / box.PID).read_text())


def possible() -> bool:
    """Are the collection and ansible-core here?"""
    return COLLECTION.is_dir() and (PROGRAMS / "ansible-playbook").exists()


class Rollout:
    def __init__(self, folder: Path, roots: Roots, orders: Path) -> None:
        self._folder, self._roots = folder, roots
        self._inventory = folder / "hosts.yml"
        (folder / "gateways").mkdir()
        (folder / "ansible.cfg").touch()
        collections = folder / "collections/ansible_collections/loading"
        collections.mkdir(parents=True)
        (collections / "gateway").symlink_to(COLLECTION)
        root = str(folder / "boxes/{{ inventory_hostname }}")
        variables = {
            "ansible_connection": "local",
            "ansible_become": False,
            "ansible_python_interpreter": sys.executable,
            "loading_gateway_root": root,
            "loading_gateway_user": "",
            "loading_gateway_command": [str(PROGRAMS / "gateway")],
            "loading_gateway_restart": ["/bin/sh", "-c", f"echo restart {root} > {orders}"],
            "loading_gateway_wait_s": 0,
            "loading_gateway_within_s": WITHIN_S,
            "loading_gateway_steady_s": STEADY_S,
        }
        hosts = {one.name: None for one in roots.boxes}
        self._inventory.write_text(json.dumps({"loading_gateways": {"hosts": hosts, "vars": variables}}))

    def run_bad(self) -> list[str]:
        """What was not as it should be: it must end in the first ring, which is one box, and leave all as it was."""
        for root in self._roots.boxes:
            reviewed = self._roots.reviewed(root, camera=NOT_THERE)
            (self._folder / f"gateways/{root.name}.toml").write_text(reviewed)
        before = {root: Before.of(root) for root in self._roots.boxes}
        code, out = self._play()
        first, *others = self._roots.boxes
        faults = [] if code else ["the bad roll-out was not stopped"]
        if f"{first.name}: back at what it was" not in out:
            faults.append(f"{first.name} did not go back by itself: {out[-1500:]}")
        now = Before.of(first)
        if (now.config, now.reviewed) != (before[first].config, before[first].reviewed):
            faults.append(f"{first.name} has another configuration than before")
        if now.pid == before[first].pid:
            faults.append(f"{first.name} was not changed at all")
        return faults + [f"{root.name} was touched" for root in others if Before.of(root) != before[root]]

    def _play(self) -> tuple[int, str]:
        command = [str(PROGRAMS / "ansible-playbook"), "-i", str(self._inventory)]
        done = subprocess.run(
            [*command, "loading.gateway.configure"], capture_output=True, text=True, check=False, timeout=600,
            stdin=subprocess.DEVNULL, env={**os.environ, **self._environment()},
        )  # fmt: skip
        (self._folder / "ansible.log").write_text(done.stdout + done.stderr)
        return done.returncode, done.stdout + done.stderr

    def _environment(self) -> dict[str, str]:
        """Nothing of the user's own Ansible is read or written."""
        return {
            "ANSIBLE_COLLECTIONS_PATH": str(self._folder / "collections"),
            "ANSIBLE_CONFIG": str(self._folder / "ansible.cfg"),
            "ANSIBLE_HOME": str(self._folder / "ansible"),
            "ANSIBLE_LOCAL_TEMP": str(self._folder / "ansible/tmp"),
            "ANSIBLE_REMOTE_TEMP": str(self._folder / "ansible/remote"),
            "ANSIBLE_NOCOLOR": "1",
            "LC_ALL": "C.UTF-8",
        }
