"""Debian machines below a folder each, and the packages to be installed there. Needs root's rights, or `sudo` without a
password.

What takes long is made once for all tests of one process, which carry the xdist group "package"."""

import functools
import os
import platform
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
HERE = {"x86_64": "amd64", "aarch64": "arm64"}[platform.machine()]
CONFIG = "/etc/loading-gateway/gateway.toml"
OPT = "/opt/loading-gateway"
SUDO = [] if os.geteuid() == 0 else ["sudo", "-n"]
CLEAN = ["env", "-i", "PATH=/usr/sbin:/usr/bin:/sbin:/bin", "HOME=/root", "LANG=C.UTF-8"]
CLEAN += ["DEBIAN_FRONTEND=noninteractive"]


def run(*command: str, ok: bool = True, timeout_s: float = 800) -> str:
    """What the command prints, on stderr, too. It can ask nothing: its input is at its end."""
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        timeout=timeout_s, check=False,
    )  # fmt: skip
    assert (done.returncode == 0) is ok, f"{shlex.join(command)}: {done.returncode}\n{done.stdout[-3000:]}"
    return done.stdout


@dataclass(frozen=True)
class Machine:
    """A Debian below `root`, switched off: programs run there, but no systemd."""

    root: Path

    def sh(self, script: str, ok: bool = True) -> str:
        """Run there by root, without any network, with a /proc, /dev/shm and /tmp that end with it."""
        mounted = f"""
            mount -t proc proc {self.root}/proc
            mount -t tmpfs tmpfs {self.root}/dev/shm
            for device in null zero urandom; do
              touch {self.root}/dev/$device; mount --bind /dev/$device {self.root}/dev/$device
            done
            mkdir -p {self.root}/dev/pts; mount -t devpts -o newinstance,ptmxmode=0666 devpts {self.root}/dev/pts
            ln -sf pts/ptmx {self.root}/dev/ptmx
            ip link set lo up
            exec {shlex.join(CLEAN)} chroot {self.root} sh -ec "$1"
        """
        return run(*SUDO, "unshare", "--mount", "--net", "--pid", "--fork", "sh", "-ec", mounted, "sh", script, ok=ok)

    def put(self, source: Path, target: str) -> None:
        run(*SUDO, "cp", "-r", str(source), f"{self.root}{target}")

    def install(self, package: Path, *options: str) -> str:
        self.put(package, "/root/")
        return self.sh(f"dpkg {shlex.join(options)} -i /root/{package.name} 2>&1")


def bootstrapped(root: Path, architecture: str, variant: str, *packages: str) -> None:
    """A Debian 12 in the folder `root`, from Debian's archive. `extract` only unpacks it: none of its programs runs."""
    hooks = ["--hook-dir=/usr/share/mmdebstrap/hooks/merged-usr"] if variant == "extract" else []
    command = ["mmdebstrap", f"--variant={variant}", f"--architectures={architecture}", *hooks]
    command += ["--dpkgopt=force-unsafe-io", *(f"--include={package}" for package in packages)]
    run(*SUDO, *command, "bookworm", str(root), "http://deb.debian.org/debian")


def built(into: Path, architecture: str, version: str = "1.2.3", *more_pythons: str) -> Path:
    """With the wheels of Debian 12's Python alone, and of `more_pythons`: the others are only more of the same."""
    pythons = [f"--python={python}" for python in sorted({"3.11", *more_pythons})]
    run(str(ROOT / "dev"), "package", f"--arch={architecture}", *pythons, f"--into={into}", f"--version={version}")
    return into / f"loading-gateway_{version}_{architecture}.deb"


@functools.cache
def scratch(config: pytest.Config) -> Path:
    """A folder that is removed when all tests have ended, with what root has made in it."""
    folder = Path(tempfile.mkdtemp(prefix="loading-gateway-"))
    config.add_cleanup(lambda: removed(folder))
    return folder


def removed(folder: Path) -> None:
    run(*SUDO, "rm", "-rf", "--one-file-system", str(folder))


@functools.cache
def package(config: pytest.Config) -> Path:
    """Version 1.2.3 for this machine; the archive of its wheels, for the tests' own Python, too, lies beside it."""
    return built(scratch(config) / "dist", HERE, "1.2.3", "{}.{}".format(*sys.version_info))


@functools.cache
def debian(config: pytest.Config) -> Path:
    """A Debian 12 to be copied."""
    root = scratch(config) / "debian"
    bootstrapped(root, HERE, "minbase", "python3", "systemd")
    return root


def debian_copied(config: pytest.Config, name: str) -> Path:
    root = scratch(config) / name
    run(*SUDO, "cp", "-a", "--reflink=auto", str(debian(config)), str(root))
    return root
