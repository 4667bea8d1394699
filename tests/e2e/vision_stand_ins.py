"""Detectors and sources that fail on purpose. Vision processes import this module, so it imports little."""

import ctypes
import os
import signal
import socket
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, ClassVar

import numpy as np

from gateway.clock import Clock
from gateway.core.detection import Circle, Detection
from gateway.errors import ConfigError, LinkError
from gateway.vision.pixels import Image
from gateway.vision.source.contract import Frame, Needs

if TYPE_CHECKING:  # the main process need not load OpenCV
    from gateway.vision.detect.method import Detector

THROW, HANG, DIE, EXIT, HANG_LOCKED = 200, 210, 220, 230, 240  # pictures of this shade are poison


def shade_reader(params: object, now_ns: object) -> "Detector":
    """`u` is the shade of the picture's first pixel; some shades are poison, see above."""

    def detect(image: Image, t_ns: int = 0) -> Detection:
        if image.flags.writeable or image.flags.owndata:
            raise AssertionError("the frame was copied, or can be scribbled over")
        match shade := int(image[0, 0, 0]):
            case _ if shade == THROW:
                raise ValueError("poison")
            case _ if shade == HANG:
                signal.pause()
            case _ if shade == HANG_LOCKED:
                hang_locked()
            case _ if shade == DIE:
                signal.raise_signal(signal.SIGKILL)  # os.kill is refused
            case _ if shade == EXIT:
                os._exit(7)
        return Detection(Circle(float(shade), float(image.shape[0]), 1.0))

    return detect


def hang_locked() -> None:
    """Native code that never returns, and holds the interpreter's lock: no thread of this process runs any more."""
    ctypes.PyDLL(None).pause()


def hung_reader(params: object, now_ns: object) -> "Detector":
    """Never comes back from its first frame, and hears nothing."""

    def detect(image: Image, t_ns: int = 0) -> Detection:
        print("hung", flush=True)
        signal.pause()
        raise AssertionError("not reached")

    return detect


def broken_detector(params: object, now_ns: object) -> "Detector":
    """A detector that cannot be built."""
    raise RuntimeError("no such model")


def intruder(params: object, now_ns: object) -> "Detector":
    """What a decoder's fault would be used for, tried with each frame: a stage of the result is what was tried, its
    time the error number, or 0 where it was done."""
    new = Path(tempfile.gettempdir(), f"intruder-{os.getpid()}")

    def ran() -> None:
        if (child := os.fork()) == 0:
            try:
                os.execv("/bin/true", ["true"])
            except OSError as error:
                os._exit(error.errno or 1)
        if code := os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]):
            raise OSError(code, "")

    def connected() -> None:
        with socket.socket() as sock, suppress(ConnectionRefusedError):
            sock.connect(("127.0.0.1", 1))

    def listened() -> None:
        with socket.socket() as sock:
            sock.listen()

    def traced() -> None:
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.ptrace(3, 0, 0, 0) == -1:  # PTRACE_PEEKUSER, of no process
            raise OSError(ctypes.get_errno(), "")

    tries: dict[str, Callable[[], object]] = {
        "write a file": lambda: Path(os.devnull).write_bytes(b"x"),
        "make a file": new.touch,
        "remove a file": lambda: new.unlink(missing_ok=True),
        "run a program": ran,
        "reach the gateway": lambda: os.kill(os.getppid(), 0),
        "trace": traced,
        "open a connection": connected,
        "take connections": listened,
        "read a file": lambda: Path("/etc/passwd").read_bytes(),
    }

    def tried(what: Callable[[], object]) -> int:
        try:
            what()
        except OSError as error:
            return error.errno or -1
        return 0

    def detect(image: Image, t_ns: int = 0) -> Detection:
        stages = tuple((name, tried(what)) for name, what in tries.items())
        return Detection(None, stage_ns=stages)

    return detect


@dataclass(frozen=True)
class DeviceSpec:
    """A device is a file that is open for writing; once it is open, no other can be."""

    device: str
    needs: ClassVar[Needs] = Needs.DEVICE
    label: str = "device"

    def open(self, clock: Clock) -> "Shades":
        return Shades(clock, 0, "", device=Path(self.device).open("r+b"))


@dataclass
class Shades:
    """A live source of plain pictures, 50 a second; `then` is what happens after so many. "": it never ends."""

    clock: Clock
    frames: int
    then: str
    given: int = 0
    lossless: bool = False
    may_repeat: bool = True
    finite: bool = False
    device: BinaryIO | None = None

    def read(self) -> Frame:
        self.clock.block(0.02)
        if self.device is not None:
            self.device.write(b"set")
            self.device.flush()
        side = 16
        if self.given == self.frames:
            match self.then:
                case "end":
                    raise LinkError("shades: ended")
                case "crash":
                    raise ZeroDivisionError("a bug in the driver")
                case "driver crash":
                    self.clock.block(0.3)  # the detector is done with the frame before
                    ctypes.string_at(0)  # this very thread, as a driver does
                case "driver hangs locked":
                    self.clock.block(0.3)
                    hang_locked()
                case "large":
                    side = 200
                case "stall":
                    print("stalled", flush=True)
                    signal.pause()
        self.given += 1
        return Frame(np.full((side, side, 3), self.given % 200, np.uint8), self.clock.now_ns())

    def close(self) -> None:
        pass


@dataclass(frozen=True)
class ShadesSpec:
    """`frames` frames, then the first of `then`; the next of `then` when opened again; from the last on it never ends.

    `diary` is a file that counts the openings.
    """

    diary: str
    frames: int
    then: tuple[str, ...]
    label: str = "shades"

    def open(self, clock: Clock) -> Shades:
        with Path(self.diary).open("ab") as file:
            file.write(b".")
            nth = file.tell()
        then = self.then[nth - 1] if nth <= len(self.then) else ""
        if then == "hopeless":
            raise ConfigError("shades: this could never work")
        return Shades(clock, self.frames, then)
