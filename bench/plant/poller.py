"""An independent PLC beside the gateway: runs bench/modbus/plc.c and gives each of its polls.

Written from docs/registers.md; uses nothing of the gateway. The C program runs before everybody else's work where it is
permitted to (a PLC has a processor of its own), so that a starved gateway does not starve its judge.
"""

import contextlib
import fcntl
import os
import struct
import subprocess
import tempfile
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from bench.modbus import programs

RECORD = struct.Struct("@QQII100H")
ANSWERED, TIMED_OUT, LOST, WRONG, EXCEPTION = 0, 1, 2, 3, 256
OUTCOMES = {ANSWERED: "answered", TIMED_OUT: "no answer in time", LOST: "connection lost", WRONG: "wrong frame"}
F_SETPIPE_SZ = 1031  # linux/fcntl.h
PIPE_BYTES = 1 << 20  # some ten thousand polls: a busy reader does not hold up the PLC
PLC_ADDRESS = "127.0.0.2"


@dataclass(frozen=True, slots=True)
class Poll:
    """One poll of server number `server`: when it was asked and answered (or given up), CLOCK_BOOTTIME, ns."""

    server: int
    asked_ns: int
    ended_ns: int
    outcome: int
    words: tuple[int, ...]  # 100 registers, if answered

    @property
    def took_ms(self) -> float:
        return (self.ended_ns - self.asked_ns) / 1e6


class Poller:
    """A context manager. `on_poll` is called in a thread, with the polls in their order.

    `ports`: of the servers on 127.0.0.1; the first `writing` of them are also written to (heartbeat and `control`).
    """

    def __init__(
        self,
        ports: Sequence[int],
        on_poll: Callable[[Poll], None],
        *,
        period_s: float = 0.05,
        timeout_s: float = 0.5,
        writing: int = 0,
        source: str = PLC_ADDRESS,
    ) -> None:
        self._ports = [f"{port}{'w' * (n < writing)}" for n, port in enumerate(ports)]
        self._on_poll = on_poll
        self._timing = [str(round(1e6 * period_s)), str(round(1e3 * timeout_s)), source]

    def __enter__(self) -> Self:
        with tempfile.TemporaryDirectory(prefix="plc-") as folder:
            program = programs.build("plc", Path(folder))
            self._process = subprocess.Popen(
                [str(program), *self._timing, *self._ports], stdin=subprocess.PIPE, stdout=subprocess.PIPE
            )
            with contextlib.suppress(PermissionError):
                os.sched_setscheduler(self._process.pid, os.SCHED_FIFO, os.sched_param(1))
            assert self._process.stdout is not None
            with contextlib.suppress(OSError):
                fcntl.fcntl(self._process.stdout, F_SETPIPE_SZ, PIPE_BYTES)
            self._thread = threading.Thread(target=self._read, name="poller", daemon=True)
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.wait()
        self._thread.join(10)
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()

    def control(self, bits: int) -> None:
        """The control word that is written from the next poll on."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.write(f"{bits}\n".encode())
            self._process.stdin.flush()

    def _read(self) -> None:
        assert self._process.stdout is not None
        while len(data := self._process.stdout.read(RECORD.size)) == RECORD.size:
            asked_ns, ended_ns, server, outcome, *words = RECORD.unpack(data)
            self._on_poll(Poll(server, asked_ns, ended_ns, outcome, tuple(words) if outcome == ANSWERED else ()))
