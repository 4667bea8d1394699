"""A vision process's record of its progress, in memory that outlives it.

A record wakes no process. The main process reads it when a message arrives or a deadline passes, and when the process
has ended: so it has recorded which frame was being worked on, and which of the two threads has stopped, even where
native code hangs with the interpreter's lock held and no thread of that process can send anything.
"""

import mmap
from dataclasses import dataclass

from gateway.vision.transport.ring_spec import PAGE, RingSpec

TOKEN, CAPTURED_SEQ, CAPTURED_NS, WORK_SEQ, WORK_T_CAPTURE_NS, WORK_BEGAN_NS, DETECTOR_NS, WIDTH, HEIGHT = range(9)


@dataclass(frozen=True, slots=True)
class FrameProgress:
    """Of the process with this token; all zero: it has noted nothing yet."""

    token: int = 0
    captured_seq: int = 0  # newest frame captured
    captured_ns: int = 0  # when
    work_seq: int = 0  # newest frame that the detector has begun
    work_t_capture_ns: int = 0
    work_began_ns: int = 0  # 0: its result has been sent
    detector_ns: int = 0  # when the detector's thread last ran, between frames


class ProgressPage:
    """Page 0 of the ring's memory. Each field is written by one thread, at once; no reader sees half of one."""

    def __init__(self, spec: RingSpec, *, writable: bool) -> None:
        access = mmap.ACCESS_WRITE if writable else mmap.ACCESS_READ
        self._memory = mmap.mmap(spec.fd, PAGE, access=access)
        self._fields = memoryview(self._memory).cast("q")

    def begin(self, token: int, now_ns: int) -> None:
        """A process begins. The size of its predecessor's frames remains."""
        self._fields[TOKEN] = 0
        for field in range(CAPTURED_SEQ, WIDTH):
            self._fields[field] = 0
        self._fields[DETECTOR_NS] = now_ns
        self._fields[TOKEN] = token

    def close(self) -> None:
        self._fields.release()  # else the memory can't be closed
        self._memory.close()

    # The capture thread.

    def captured(self, seq: int, now_ns: int) -> None:
        self._fields[CAPTURED_SEQ], self._fields[CAPTURED_NS] = seq, now_ns

    def size_px(self) -> tuple[int, int] | None:
        """Width and height of the frames so far, those of the processes before included; None: there was none."""
        width, height = self._fields[WIDTH : HEIGHT + 1].tolist()
        return (width, height) if width else None

    def set_size_px(self, width: int, height: int) -> None:
        self._fields[HEIGHT], self._fields[WIDTH] = height, width

    # The detector's thread.

    def detector_runs(self, now_ns: int) -> None:
        self._fields[DETECTOR_NS] = now_ns

    def work_begins(self, seq: int, t_capture_ns: int, now_ns: int) -> None:
        self._fields[WORK_SEQ], self._fields[WORK_T_CAPTURE_NS] = seq, t_capture_ns
        self._fields[WORK_BEGAN_NS] = now_ns

    def work_ends(self, now_ns: int) -> None:
        """After its result has been sent."""
        self._fields[WORK_BEGAN_NS], self._fields[DETECTOR_NS] = 0, now_ns

    # The main process.

    def read(self) -> FrameProgress:
        return FrameProgress(*self._fields[:WIDTH].tolist())
