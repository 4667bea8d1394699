"""A process that has imported the gateway, and is forked into each box: a hundred share its memory. What systemd is
to a plant's gateways: it starts, ends and restarts them by a line in its pipe.

    echo "restart /tmp/fleet/boxes/bay-017" > /tmp/fleet/starter
"""

import gc
import os
import select
import signal
import sys
import traceback
from contextlib import suppress
from importlib import import_module
from pathlib import Path

from bench.fleet import box

# What each gateway would load by itself, for half a second of a processor.
PRELOADED = (
    "gateway.cli.run",
    "gateway.sinks.mqtt.publisher",
    "gateway.sinks.sparkplug.publisher",
    "gateway.ranger.hcsr04.session",
    "gateway.vision.detect.robust",
    "uvloop",
)
LOOK_S = 0.05  # how soon it is seen that a box has ended


class Starter:
    def __init__(self) -> None:
        self._running: dict[int, Path] = {}
        self._again: set[Path] = set()  # to be started once they have ended

    def order(self, line: str) -> bool:
        """False: it is to end."""
        verb, _, name = line.partition(" ")
        root = Path(name)
        if verb in ("restart", "stop"):
            for pid in [pid for pid, other in self._running.items() if other == root]:
                os.kill(pid, signal.SIGTERM)
        if verb == "start" or (verb == "restart" and root not in self._running.values()):
            self._start(root)
        elif verb == "restart":
            self._again.add(root)
        return verb != "quit"

    def reap(self) -> None:
        """Those that have ended; starts again what is to be."""
        with suppress(ChildProcessError):
            while pid := os.waitpid(-1, os.WNOHANG)[0]:
                if (root := self._running.pop(pid, None)) is not None:
                    (root / box.PID).unlink(missing_ok=True)
                    if root in self._again:
                        self._again.remove(root)
                        self._start(root)

    def _start(self, root: Path) -> None:
        pid = os.fork()
        if not pid:
            code = 1
            try:
                code = box.run(root)
            except BaseException:  # noqa: BLE001 - nothing of the starter may go on in the child
                traceback.print_exc()
            os._exit(code)
        self._running[pid] = root
        (root / box.PID).write_text(f"{pid}\n")

    def serve(self, pipe: Path) -> None:
        """Until it is told `quit`, or its parent is gone, and all boxes have ended."""
        parent = os.getppid()
        orders = os.open(pipe, os.O_RDWR)  # read and write: no end of file between two writers
        on, rest = True, ""
        while on and os.getppid() == parent:
            if select.select([orders], [], [], LOOK_S)[0]:
                *lines, rest = (rest + os.read(orders, 65536).decode()).split("\n")
                on = all(self.order(line) for line in lines)
            self.reap()
        for pid in self._running:
            os.kill(pid, signal.SIGTERM)
        while self._running:
            _, _, _ = select.select([], [], [], LOOK_S)
            self.reap()


if __name__ == "__main__":
    for module in PRELOADED:
        import_module(module)
    gc.freeze()
    Starter().serve(Path(sys.argv[1]))
