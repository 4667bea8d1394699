"""Frames from a GStreamer pipeline, which runs as a child process (gst-launch-1.0) and ends with this one.

They come through a pipe as the GStreamer Data Protocol has them, version 1.0: a header, then a buffer or its format.
"""

import math
import os
import re
import select
import struct
import subprocess
from dataclasses import dataclass
from typing import IO, Protocol

import numpy as np

from gateway.clock import Clock
from gateway.durations import NS_PER_MS
from gateway.errors import LinkError
from gateway.vision.source.capture import LiveSource
from gateway.vision.source.contract import Frame
from gateway.vision.source.frame_time import PresentationTime
from gateway.vision.source.gst import GstSpec

PROGRAM = "gst-launch-1.0"
# The newest frame counts: what waits for this process is replaced.
BEFORE_PIPE = "! queue leaky=downstream max-size-buffers=1 ! videoconvert ! video/x-raw,format=BGR ! gdppay ! fdsink"
HEADER = struct.Struct(">BBBxHIQQQQ20x")  # version, flags, type, length, time stamp, duration, offsets
BUFFER, CAPS = 1, 2  # types
NO_TIME = 2**64 - 1
MOST_BYTES = 400_000_000
PIPE_BYTES = 65_536


@dataclass(frozen=True, slots=True)
class Packet:
    """`stamp_ms`: NaN: it has none."""

    kind: int
    payload: bytes
    stamp_ms: float


class Readable(Protocol):
    def read(self, size: int, /) -> bytes: ...


def packet(stream: Readable) -> Packet | None:
    """The next one; None: the stream has ended. Raises ValueError for what is none."""
    header = stream.read(HEADER.size)
    if len(header) < HEADER.size:
        return None
    major, minor, _, kind, length, stamp_ns, *_ = HEADER.unpack(header)
    if (major, minor) != (1, 0) or length > MOST_BYTES:
        raise ValueError("it does not send GStreamer's data protocol")
    payload = stream.read(length)
    return None if len(payload) < length else Packet(kind, payload, _ms(stamp_ns))


def _ms(stamp_ns: int) -> float:
    return math.nan if stamp_ns == NO_TIME else stamp_ns / NS_PER_MS


def size_px(caps: bytes) -> tuple[int, int]:
    """Width and height. Raises ValueError."""
    text = caps.decode(errors="replace")
    found = [re.search(rf"\b{key}=\(int\)(\d{{1,5}})\b", text) for key in ("width", "height")]
    if None in found or "format=(string)BGR" not in text:
        raise ValueError(f"a format without a size: {text[:100]}")
    width, height = (int(one[1]) for one in found if one is not None)
    return width, height


class ChildOutput:
    """What the child sends. Its errors are read meanwhile: a full pipe would stop it. `said`: the first that names an
    ERROR, else the newest."""

    def __init__(self, output: IO[bytes], errors: IO[bytes]) -> None:
        self._output, self._errors = output, errors
        self._open = [output, errors]
        self.said = ""

    def read(self, size: int, /) -> bytes:
        """Less than `size` where it has ended."""
        data = bytearray()
        while len(data) < size:
            ready, _, _ = select.select(self._open, (), ())
            if self._errors in ready:
                self.listen()
            if self._output in ready:
                part = os.read(self._output.fileno(), min(size - len(data), PIPE_BYTES))
                if not part:
                    break
                data += part
        return bytes(data)

    def listen(self) -> None:
        try:
            text = os.read(self._errors.fileno(), PIPE_BYTES)
        except BlockingIOError:
            return
        if not text:
            self._open = [self._output]
        lines = [line for line in text.decode(errors="replace").splitlines() if line.strip()]
        told = [line for line in lines if "ERROR" in line] or lines
        if told and "ERROR" not in self.said:
            self.said = told[0].strip()[:300]


class GstSource(LiveSource):
    def __init__(self, child: subprocess.Popen[bytes], spec: GstSpec, clock: Clock) -> None:
        super().__init__(spec, clock, PresentationTime())
        assert child.stdout is not None
        assert child.stderr is not None
        self._child = child
        self._output = ChildOutput(child.stdout, child.stderr)
        self._size_px = (0, 0)

    def _next(self) -> Frame:
        while True:
            try:
                found = packet(self._output)
                if found is not None and found.kind == CAPS:
                    self._size_px = size_px(found.payload)
            except ValueError as error:
                raise LinkError(f"{self._label}: lost: {error}") from error
            if found is None:
                self._output.listen()
                raise LinkError(f"{self._label}: the pipeline has ended: {self._output.said or 'without a word'}")
            if found.kind == BUFFER:
                break
        t_capture_ns = self._taken_ns(self._clock.now_ns(), found.stamp_ms)
        width, height = self._size_px
        pitch = -(-3 * width // 4) * 4
        if not found.payload or len(found.payload) != pitch * height:
            raise ValueError(f"{len(found.payload)} bytes are no {width} x {height} px")
        rows = np.frombuffer(found.payload, np.uint8).reshape(height, pitch)[:, : 3 * width]
        pixels = np.ascontiguousarray(rows).reshape(height, width, 3)
        return Frame(pixels, t_capture_ns, age_proof=self._frame_time.proof)

    def close(self) -> None:
        """A helper of a plugin may hold the pipes open: they are not read to their end."""
        self._child.kill()
        self._child.wait()
        for pipe in (self._child.stdout, self._child.stderr):
            if pipe is not None:
                pipe.close()


def open_gst(spec: GstSpec, clock: Clock) -> GstSource:
    """Raises LinkError where the system has no GStreamer. What is wrong with the pipeline, the first `read` says."""
    # The camera must be free when this process was killed, also where the pipeline stands still: setpriv is of
    # util-linux, as is the system itself.
    command = ["setpriv", "--pdeathsig", "KILL", PROGRAM, "-q", *spec.pipeline, *BEFORE_PIPE.split()]
    try:
        child = subprocess.Popen(
            command,
            bufsize=0,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=_environment(),
        )
    except OSError as error:
        raise LinkError(f"{spec.label}: {command[0]}: {error.strerror}") from error
    assert child.stderr is not None
    os.set_blocking(child.stderr.fileno(), False)
    return GstSource(child, spec, clock)


def _environment() -> dict[str, str]:
    """Without the gateway's own, which may hold passwords; and GStreamer has no home to write its registry into."""
    return {
        "PATH": "/usr/local/bin:/usr/bin:/bin",
        "LANG": "C",
        "HOME": "/dev/null",  # no folder can be made in it, by root neither
        "GST_REGISTRY_UPDATE": "no",
    } | {key: value for key, value in os.environ.items() if key.startswith(("GST_", "XDG_RUNTIME"))}
