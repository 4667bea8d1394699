"""The gateway as a user starts it: a real process, its JSON lines, its signals, and nothing left behind."""

import json
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import psutil

Row = dict[str, Any]


@dataclass(frozen=True)
class Done:
    """What a command returned and wrote."""

    code: int
    out: str
    err: str


def command(*arguments: str, cwd: Path | None = None, stdin: bytes | None = None) -> Done:
    """`python -m gateway ARGUMENTS`, to its end."""
    line = [sys.executable, "-m", "gateway", *arguments]
    done = subprocess.run(line, cwd=cwd, input=stdin, capture_output=True, timeout=100, check=False)
    assert b"Traceback" not in done.stderr, done.stderr.decode()
    return Done(done.returncode, done.stdout.decode(), done.stderr.decode())


def survivors(family: list[psutil.Process], timeout_s: float = 5.0) -> list[psutil.Process]:
    """Those still alive after a while. A zombie is dead: who reaps an orphan, and when, is the system's affair."""
    deadline = time.monotonic() + timeout_s
    while True:
        alive = [process for process in family if _alive(process)]
        if not alive or time.monotonic() > deadline:
            return alive
        time.sleep(0.02)


def _alive(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


class Gateway:
    """`python -m gateway ARGS`; a context manager. With `--json` its lines are collected as they come.

    The pages of a simulation are on a free port, unless ARGS say where: other tests may run beside this one.
    """

    def __init__(self, *args: str) -> None:
        placed = args[0] != "simulate" or {"--hmi-port", "--no-hmi"} & set(args)
        self._args = args if placed else (*args, "--hmi-port", "0")
        self._lines: queue.Queue[Row | None] = queue.Queue()
        self.rows: list[Row] = []
        self.other: list[str] = []
        self.stderr = ""

    def __enter__(self) -> Self:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "gateway", *self._args],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._readers = [threading.Thread(target=f, daemon=True) for f in (self._read_out, self._read_err)]
        for reader in self._readers:
            reader.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        family = self.family()
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            try:
                self.process.wait(10)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait(10)
        for reader in self._readers:
            reader.join(10)
        for stream in (self.process.stdout, self.process.stderr):
            if stream is not None:
                stream.close()
        assert survivors(family) == []
        if kind is not None:
            print(self.stderr[-4000:])  # pytest shows it beside the failure

    def family(self) -> list[psutil.Process]:
        """Every process under the gateway, now."""
        try:
            return psutil.Process(self.process.pid).children(recursive=True)
        except psutil.NoSuchProcess:
            return []

    def wait_for(self, wanted: Callable[[Row], bool], timeout_s: float = 30.0) -> Row:
        """The first row, from now on, that `wanted` accepts."""
        deadline = time.monotonic() + timeout_s
        while True:
            left = deadline - time.monotonic()
            try:
                row = self._lines.get(timeout=max(0.01, left))
            except queue.Empty:
                raise AssertionError(
                    f"not seen in {timeout_s} s; last rows: {self.rows[-3:]}; stderr: {self.stderr[-3000:]}"
                ) from None
            if row is None:
                raise AssertionError(f"the gateway ended ({self.process.wait(10)}): {self.stderr[-3000:]}")
            if wanted(row):
                return row

    def started(self) -> Row:
        return self.wait_for(lambda row: row["type"] == "started")

    def end(self, number: int = signal.SIGTERM) -> int:
        """Send a signal; the exit code. It ends in a second or two; 30 tell one that hangs from a busy machine."""
        self.process.send_signal(number)
        return self.process.wait(30)

    def finish(self, timeout_s: float = 60.0) -> int:
        """Wait for the process to end by itself, with all its lines read."""
        code = self.process.wait(timeout_s)
        for reader in self._readers:
            reader.join(10)
        return code

    def _read_out(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            try:
                row = json.loads(line)
            except ValueError:
                self.other.append(line)
                continue
            self.rows.append(row)
            self._lines.put(row)
        self._lines.put(None)

    def _read_err(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.stderr += line
