"""What the gateway's processes use of the machine. IO, by psutil."""

from dataclasses import dataclass

import psutil

MAIN = "main"
MAX_CHILDREN = 1000


@dataclass(frozen=True, slots=True)
class ProcessUsage:
    """All processes of one name, of which there may be several."""

    name: str
    processes: int
    cpu_s: float
    memory_bytes: int


def process_usage(main_pid: int) -> tuple[ProcessUsage, ...]:
    """The main process and its children. One that ends meanwhile is left out."""
    try:
        main = psutil.Process(main_pid)
        children = main.children()[:MAX_CHILDREN]
    except psutil.Error:
        return ()
    return by_name((MAIN, main), *((None, child) for child in children))


def by_name(*processes: tuple[str | None, psutil.Process]) -> tuple[ProcessUsage, ...]:
    """Summed by name: the one given, else the process's own."""
    found: dict[str, ProcessUsage] = {}
    for given, process in processes:
        try:
            with process.oneshot():
                name, times, memory = given or process.name(), process.cpu_times(), process.memory_info()
        except psutil.Error:
            continue
        old = found.get(name, ProcessUsage(name, 0, 0.0, 0))
        found[name] = ProcessUsage(
            name, old.processes + 1, old.cpu_s + times.user + times.system, old.memory_bytes + memory.rss
        )
    return tuple(found.values())
