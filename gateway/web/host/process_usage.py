"""What the gateway's processes use of the machine, read from /proc. IO."""

import os
from dataclasses import dataclass
from pathlib import Path

PROC = Path("/proc")
MAIN = "main"
MOST = 1000


@dataclass(frozen=True, slots=True)
class ProcessUsage:
    """All processes of one name, which are as many as they are workers of a bay."""

    name: str
    processes: int
    cpu_s: float
    memory_bytes: int


def process_usage(main_pid: int, proc: Path = PROC) -> tuple[ProcessUsage, ...]:
    """The main process and its children. One that ends meanwhile is left out; without /proc there is nothing."""
    found: dict[str, ProcessUsage] = {}
    for pid in (main_pid, *_children(main_pid, proc)):
        name = MAIN if pid == main_pid else None
        one = _usage(pid, name, proc)
        if one is None:
            continue
        known = found.get(one.name)
        found[one.name] = (
            ProcessUsage(one.name, known.processes + 1, known.cpu_s + one.cpu_s, known.memory_bytes + one.memory_bytes)
            if known
            else one
        )
    return tuple(found.values())


def _children(pid: int, proc: Path) -> list[int]:
    """Each thread has its own."""
    children: list[int] = []
    try:
        for thread in (proc / str(pid) / "task").iterdir():
            children += map(int, (thread / "children").read_text().split())
    except OSError:
        pass
    return children[:MOST]


def _usage(pid: int, name: str | None, proc: Path) -> ProcessUsage | None:
    """proc_pid_stat(5): the name in parentheses may hold anything, so what follows it is counted from its end."""
    try:
        stat = (proc / str(pid) / "stat").read_text(errors="replace")
    except OSError:
        return None
    comm = stat[stat.index("(") + 1 : stat.rindex(")")]
    fields = stat[stat.rindex(")") + 2 :].split()  # from field 3 on
    ticks = int(fields[11]) + int(fields[12])  # utime, stime
    pages = int(fields[21])  # rss
    return ProcessUsage(name or comm, 1, ticks / os.sysconf("SC_CLK_TCK"), pages * os.sysconf("SC_PAGE_SIZE"))
