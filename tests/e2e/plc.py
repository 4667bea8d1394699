"""PLCs that we did not write: pymodbus's client for whole images, mbpoll for what a technician types."""

import re
import subprocess
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException

from gateway.modbus.registers.register_map import BLOCK_WORDS, decode

Image = dict[str, Any]


@dataclass(frozen=True)
class Poll:
    """One whole image, and when (time.monotonic) it was asked for and read."""

    asked_s: float
    read_s: float
    image: Image


class CyclicProgram:
    """`cycle`, called every `period_s` from a thread; a context manager. What it raises ends it: see `failed`."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._end = threading.Event()
        self._failure: BaseException | None = None

    def cycle(self) -> object:
        raise NotImplementedError

    def close(self) -> None:
        """After the last cycle."""

    def failed(self) -> None:
        """Raises what a cycle has raised."""
        if self._failure is not None:
            raise self._failure

    def __enter__(self) -> Self:
        self._thread = threading.Thread(target=self._cycles, daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end.set()
        self._thread.join(10)
        self.close()
        if kind is None:
            self.failed()

    def _cycles(self) -> None:
        try:
            while not self._end.is_set():
                self.cycle()
                self._end.wait(self._period_s)
        except BaseException as error:  # noqa: BLE001 - raised again where the test waits
            self._failure = error


class Plc(CyclicProgram):
    """Polls one unit's complete block. A failed poll is kept as a time."""

    def __init__(self, port: int, unit: int = 1, period_s: float = 0.02) -> None:
        super().__init__(period_s)
        self.client = ModbusTcpClient("127.0.0.1", port=port, timeout=2, retries=0)
        assert self.client.connect()  # type: ignore[no-untyped-call]  # pymodbus's own
        self._unit = unit
        self._changed = threading.Condition()
        self.polls: list[Poll] = []
        self.failures: list[float] = []

    def close(self) -> None:
        self.client.close()  # type: ignore[no-untyped-call]  # pymodbus's own

    def wait_for(self, wanted: Callable[[Image], bool], timeout_s: float = 30.0) -> Poll:
        """The first image from now on that `wanted` accepts."""
        begun = time.monotonic()
        with self._changed:
            seen = len(self.polls)
            while True:
                for poll in self.polls[seen:]:
                    if wanted(poll.image):
                        return poll
                seen = len(self.polls)
                self.failed()
                left = begun + timeout_s - time.monotonic()
                if left <= 0 or not self._changed.wait(left):
                    last = self.polls[-1].image if self.polls else None
                    raise AssertionError(f"not seen in {timeout_s} s of {len(self.polls)} polls; last image: {last}")

    def wait_for_beats(self, beats: int, timeout_s: float = 30.0) -> list[Poll]:
        """The polls from now on, until the heartbeat has gone on by so many ticks: a second is fifty of them."""
        with self._changed:
            mark, first = len(self.polls), self.polls[-1].image["heartbeat"]
        self.wait_for(lambda image: (image["heartbeat"] - first) % 65536 >= beats, timeout_s)
        return self.polls[mark:]

    @property
    def last(self) -> Image:
        return self.polls[-1].image

    def cycle(self) -> None:
        asked_s = time.monotonic()
        try:
            answer = self.client.read_holding_registers(0, count=BLOCK_WORDS, device_id=self._unit)
        except (ModbusException, OSError):
            with self._changed:
                self.failures.append(asked_s)
                self._changed.notify_all()
            self._end.wait(0.05)
            return
        assert not answer.isError(), answer
        poll = Poll(asked_s, time.monotonic(), decode(answer.registers))
        with self._changed:
            self.polls.append(poll)
            self._changed.notify_all()


def mbpoll(port: int, address: int, count: int, *, unit: int = 1, function: str = "4") -> list[int]:
    """`count` registers from `address` as `mbpoll` prints them. `function`: its -t; 4 holding, 3 input registers."""
    where = ["-t", function, "-a", str(unit), "-r", str(address), "-c", str(count)]
    done = subprocess.run(
        ["mbpoll", "-0", "-B", "-m", "tcp", "-o", "10", *where, "-1", "-p", str(port), "127.0.0.1"],
        check=False,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return [int(value) for value in re.findall(r"^\[\d+\]:\s+(\d+)", done.stdout, re.MULTILINE)]
