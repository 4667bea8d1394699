"""The firmware's core on this machine: builds it, drives it in simulated time, and keeps a journal of all commands.

What the core did in the library with the undefined-behaviour sanitizer can be replayed in the executable with the
address sanitizer (`Core.replay`); both must answer the same.
"""

import ctypes
import os
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from gateway.ranger.hcsr04.protocol import TICK_NS, Decoder, Event, Hello, Measurement
from tests.firmware.builds import make

FIRMWARE = Path(__file__).parents[2] / "firmware"
BUILD = FIRMWARE / "build"
COVERED = BUILD / "host" / "covered"
LIBRARY_VARIABLE = "RANGER_CORE_LIBRARY"
"""The coverage test runs the others on another build of the same core."""

MS = 1_000_000 // TICK_NS
"""Ticks of the board's clock in a millisecond."""
RISE = 900
"""ECHO rises 0.45 ms after the trigger, in ticks."""
CYCLE = 60 * MS


@cache
def library() -> ctypes.CDLL:
    make("host")
    lib = ctypes.CDLL(os.environ.get(LIBRARY_VARIABLE, str(BUILD / "host" / "libranger.so")))
    lib.harness_new.restype = ctypes.c_void_p
    lib.harness_free.argtypes = [ctypes.c_void_p]
    lib.harness_command.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_char_p]
    lib.harness_quiet.argtypes = [ctypes.c_void_p, ctypes.c_uint32]
    lib.harness_quiet.restype = ctypes.c_bool
    lib.harness_measurement.argtypes = [
        ctypes.c_uint16, ctypes.c_uint32, ctypes.c_uint8, ctypes.c_int16, ctypes.c_int32, ctypes.c_int32,
        ctypes.c_char_p,
    ]  # fmt: skip
    lib.harness_hello.argtypes = [ctypes.c_char_p, ctypes.c_uint16, ctypes.c_uint8, ctypes.c_char_p]
    lib.ranger_tenths_at_20c.argtypes = [ctypes.c_uint32]
    lib.ranger_tenths_at_20c.restype = ctypes.c_uint32
    lib.ranger_crc.argtypes = [ctypes.c_uint16, ctypes.c_uint8]
    lib.ranger_crc.restype = ctypes.c_uint16
    lib.ranger_tmp36.argtypes = [ctypes.c_uint16, ctypes.c_uint16]
    lib.ranger_tmp36.restype = ctypes.c_int16
    lib.harness_ds18b20.argtypes = [ctypes.c_char_p, ctypes.c_uint32, ctypes.c_uint32]
    lib.harness_ds18b20.restype = ctypes.c_int16
    return lib


@dataclass(frozen=True, slots=True)
class Answer:
    """What one call made the core do."""

    began: bool
    pulses: int  # of TRIG
    light: bool
    flags: int
    lost_lines: int
    late_cycles: int
    sent: bytes
    output: int = 0  # of the relay

    @property
    def said(self) -> list[Event]:
        """The sent lines as the gateway decodes them."""
        return Decoder().feed(self.sent)


def parse(answer: str) -> Answer:
    began, pulses, light, flags, lost, late, output, *sent = answer.split()
    counts = (int(flags), int(lost), int(late))
    return Answer(began == "1", int(pulses), light == "1", *counts, bytes.fromhex("".join(sent)), int(output))


class Core:
    """One `struct ranger` with a board of memory. Times are ticks of 0.5 us; they may grow beyond 32 bits here."""

    def __init__(self, *, name: str = "hcsr04", period_ms: int = 60, mcusr: int = 1, now: int = 0, space: int = 255):
        self._library = library()
        self._harness = self._library.harness_new()
        self._buffer = ctypes.create_string_buffer(1024)
        self.journal: list[tuple[str, str]] = []
        self.period = period_ms * MS
        self.due = now + self.period
        """The next cycle begins."""
        self.space(space)
        self.first = self._do(f"begin {name} {period_ms} {mcusr} {now % 2**32}")

    def close(self) -> None:
        self._library.harness_free(self._harness)

    def poll(self, now: int, high: bool = False) -> Answer:
        return self._do(f"poll {now % 2**32} {int(high)}")

    def quiet(self, now: int) -> bool:
        answer: bool = self._library.harness_quiet(self._harness, now % 2**32)
        return answer

    def edge(self, ticks: int, high: bool) -> Answer:
        return self._do(f"edge {ticks % 2**32} {int(high)}")

    def receive(self, data: bytes) -> None:
        for byte in data:
            self._do(f"receive {byte}")

    def temperature(self, tenths: int) -> None:
        self._do(f"temperature {tenths}")

    def pins(self, high: int) -> None:
        """Pins of the relay that something else holds high, as a sum."""
        self._do(f"pins {high}")

    def space(self, count: int) -> None:
        self._do(f"space {count}")

    def begin(self, high: bool = False) -> Answer:
        """Poll at the moment the next cycle is due."""
        answer = self.poll(self.due, high)
        assert answer.began
        self.due += self.period
        self.space(255)
        return answer

    def cycle(self, width: int | None = None, *, rise: int = RISE) -> Measurement:
        """A whole cycle with an ECHO pulse of `width` ticks, or none; the measurement it ended in, without a hello."""
        start = self.due
        self.begin()
        events: list[Event] = []
        if width is not None:
            events += self.edge(start + rise, True).said
            events += self.edge(start + rise + width, False).said
        for ms in range(1, self.period // MS):
            events += self.poll(start + ms * MS).said
        measured = [event for event in events if isinstance(event, Measurement)]
        assert all(isinstance(event, Measurement | Hello) for event in events)
        assert len(measured) == 1
        return measured[0]

    def replay(self) -> list[tuple[str, str]]:
        """The journal as the executable under the address sanitizer answers it."""
        commands = "".join(f"{command}\n" for command, _ in self.journal)
        done = subprocess.run(
            [BUILD / "host" / "ranger_asan"], input=commands, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return list(zip((command for command, _ in self.journal), done.stdout.splitlines(), strict=True))

    def _do(self, command: str) -> Answer:
        assert self._library.harness_command(self._harness, command.encode(), self._buffer), command
        answer = self._buffer.value.decode()
        self.journal.append((command, answer))
        return parse(answer)
