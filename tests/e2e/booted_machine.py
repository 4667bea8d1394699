"""A Debian that runs: systemd is process 1 of namespaces of its own, of a network of its own, too."""

import shlex
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Self

from tests.e2e.debian_machine import CLEAN, SUDO, Machine, run

# Arguments: root, name of the control group. Prints the number of systemd's process, and ends the machine when its own
# input ends: also where the tests were killed. The host mounts its control groups in one way or another; here they are
# mounted once more, for this process alone.
BOOT = """
mount -t cgroup2 cgroup2 /sys/fs/cgroup
group=/sys/fs/cgroup/$2
mkdir "$group"
(echo 0 >"$group/cgroup.procs"; exec unshare --mount --cgroup --pid --fork --kill-child sh -ec "$3" sh "$1") &
cat >/dev/null
kill -KILL $!
{ wait $!; } 2>/dev/null || true
for n in $(seq 100); do
  find "$group" -depth -type d -exec rmdir {} + 2>/dev/null && break
  sleep 0.1  # its processes are still ending
done
"""
# What a container's systemd expects to find mounted. It may neither set the host's clock nor load drivers, and what it
# could set in /proc/sys and /sys is the host's.
INSIDE = """
read -r pid rest </proc/self/stat  # as the host sees it
echo "$pid"
mount --bind "$1" "$1"
cd "$1"
mount -t proc proc proc
mount --bind proc/sys proc/sys
mount -o remount,bind,ro proc/sys
mount -t sysfs -o ro sysfs sys
mount -t cgroup2 cgroup2 sys/fs/cgroup
mount -t tmpfs -o mode=755 tmpfs dev
for device in null zero full random urandom tty; do
  touch dev/$device
  mount --bind /dev/$device dev/$device
done
mkdir dev/pts dev/shm
mount -t devpts -o newinstance,ptmxmode=0666,mode=620,gid=5 devpts dev/pts
ln -s pts/ptmx dev/ptmx
mount -t tmpfs -o mode=1777 tmpfs dev/shm
pivot_root . mnt
umount -l /mnt
exec env -i container=tests PATH=/usr/sbin:/usr/bin:/sbin:/bin \
  setpriv --bounding-set=-sys_module,-sys_time,-sys_rawio,-sys_boot \
  /lib/systemd/systemd --unit=multi-user.target >/dev/null 2>&1 </dev/null
"""
BOOT_S = 60.0


@dataclass(frozen=True)
class BootedMachine(Machine):
    """A context manager. Its name and that of its control group is `root`'s."""

    _started: list["subprocess.Popen[str]"] = field(default_factory=list)
    _pids: list[str] = field(default_factory=list)

    def __enter__(self) -> Self:
        for timer in ("apt-daily", "apt-daily-upgrade"):  # they would take dpkg's lock
            run(*SUDO, "ln", "-sf", "/dev/null", f"{self.root}/etc/systemd/system/{timer}.timer")
        group = f"{self.root.parent.name}-{self.root.name}"
        command = [*SUDO, "unshare", "--mount", "--net", "--uts", "--ipc"]
        command += ["sh", "-ec", BOOT, "sh", str(self.root), group, INSIDE]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._started.append(process)
        assert process.stdout is not None
        self._pids.append(process.stdout.readline().strip())
        assert self._pids[0], "not booted"
        self.eventually(lambda: self.sh("systemctl is-active multi-user.target || true") == "active\n", BOOT_S)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self._started:
            process.communicate(timeout=60)  # closes the input of the first; the others end with the machine

    def entered(self, *namespaces: str) -> list[str]:
        """The command that runs another one in these namespaces, and else on the host: net, pid."""
        return [*SUDO, "nsenter", f"--target={self._pids[0]}", *(f"--{one}" for one in namespaces)]

    def beside(self, *command: str) -> None:
        """Start a program of the host's in the machine's network; it ends with the machine."""
        process = subprocess.Popen([*self.entered("net", "pid"), *command], stdin=subprocess.DEVNULL, text=True)
        self._started.append(process)

    def sh(self, script: str, ok: bool = True) -> str:
        return run(*self.entered("all", "root", "wd"), *CLEAN, "sh", "-ec", script, ok=ok)

    def install(self, package: Path, *options: str) -> str:
        """As an administrator does."""
        self.put(package, "/root/")
        return self.sh(f"apt-get install -y {shlex.join(options)} /root/{package.name}")

    def address(self, what: str, address: str) -> None:
        """Of the PLC's network: add, delete, replace."""
        run(*self.entered("net"), "ip", "address", what, f"{address}/32", "dev", "lo")

    def shown(self, unit: str) -> dict[str, str]:
        """What systemd knows of the unit."""
        lines = self.sh(f"systemctl show {unit}").splitlines()
        return dict(line.split("=", 1) for line in lines if "=" in line)

    def eventually(self, fact: Callable[[], bool], within_s: float) -> float:
        """After how many seconds it holds."""
        began_s = time.monotonic()
        while not fact():
            assert time.monotonic() - began_s < within_s, f"not within {within_s} s\n{self._told()}"
            time.sleep(0.1)
        return time.monotonic() - began_s

    def _told(self) -> str:
        return self.sh("systemctl status --no-pager loading-gateway 2>&1 || true; journalctl -n 40 --no-pager 2>&1")
