"""Equation 13's shared state vector x = [u, v, R, Z, tau]: any local process can attach and read it consistently.

One file per bay in shared memory. The gateway holds an exclusive lock on it while it lives; the kernel drops the lock
when the gateway dies, however it dies, so a reader can distinguish a live vector from an abandoned one, and the next
gateway removes abandoned files. Reading and writing never wait for each other: the writer fills one of two slots and
then points to it, a reader takes that slot and accepts it only if it is still pointed to and its checksum matches
(docs/decisions/0003). A gateway that is alive but not running (stopped, hung, its control task dead) holds its lock,
too: each state carries the time up to which it is valid, and a reader withdraws an old one (gateway/core/shown.py).
"""

import contextlib
import fcntl
import math
import mmap
import os
import stat
import struct
import tempfile
import threading
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from gateway.clock import Clock, SystemClock
from gateway.core.fusion import not_good
from gateway.core.readings import Quality
from gateway.core.shown import valid
from gateway.core.state import Moved, Reason, StateVector
from gateway.errors import ConfigError, LinkError

MAGIC = b"LOADBAY2"  # `gateway update` of one version reads the state of another: a new layout is not proven by it
_HEAD = struct.Struct("<8sIIQ")  # magic, slot size, writer's pid, count of writes
_BODY = struct.Struct("<QqqqqQ5dBBHb???B")  # the fields of SharedVector from `seq` on; D: -1 where it is unknown
_CRC = struct.Struct("<I")
_SLOT_SIZE = _BODY.size + _CRC.size
_SIZE = _HEAD.size + 2 * _SLOT_SIZE
_COUNT = struct.Struct("<Q")
_COUNT_AT = _HEAD.size - _COUNT.size
# Any user may write into the folder: a file of our name may be a pipe, or a link to another place.
_LOOK = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK
_TRIES = 100
_PAUSE_S = 0.002  # between two checks of another's lock; a gateway that only sweeps is done by then


@dataclass(frozen=True, slots=True)
class SharedVector:
    """One consistent reading. Values are NaN where the sensor's quality is not GOOD. Times: monotonic ns.

    `valid_until_ns` is the machine's clock, the others are the gateway's, which a simulation may run faster.
    """

    bay: str
    pid: int
    seq: int
    t_ns: int
    t_vision_ns: int
    t_range_ns: int
    valid_until_ns: int
    frame_id: int
    u_px: float
    v_px: float
    radius_px: float
    distance_mm: float
    z_vision_mm: float
    vision_quality: Quality
    range_quality: Quality
    reason: Reason
    d: bool | None
    stop: bool
    may_move: bool
    in_place: bool
    moved: Moved


def folder() -> Path:
    """Where the vectors are kept: memory, not disk, wherever the system has it."""
    shm = Path("/dev/shm")
    return shm if shm.is_dir() else Path(tempfile.gettempdir())


def path_of(instance: str, bay: str) -> Path:
    return folder() / f"loading-gateway.{instance}.{bay}"


def attachable() -> list[tuple[str, str]]:
    """(instance, bay) of every live vector on this machine."""
    return sorted(
        (parts[1], parts[2])
        for path in folder().glob("loading-gateway.*.*")
        if len(parts := path.name.split(".", 2)) == 3 and _held(path)
    )


class SharedStateWriter:
    """Owns one bay's vector; a context manager. Raises ConfigError if it can't be created, or another gateway holds
    it."""

    def __init__(self, instance: str, bay: str, clock: Clock | None = None) -> None:
        self._path = path_of(instance, bay)
        self._instance = instance
        self._count = 0
        self._clock = clock or SystemClock()

    def __enter__(self) -> Self:
        _sweep()
        _refuse_same_instance(self._instance)
        self._fd = _claim(self._path, self._instance)
        try:
            os.posix_fallocate(self._fd, 0, _SIZE)  # a full memory disk must fail here, not by SIGBUS at a write
        except OSError as error:
            os.close(self._fd)
            raise ConfigError(f"{self._path}: no room for the shared state: {error}") from error
        self._map = mmap.mmap(self._fd, _SIZE)
        self._map[: _HEAD.size] = _HEAD.pack(MAGIC, _SLOT_SIZE, os.getpid(), 0)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if _is_at(self._fd, self._path):
            self._path.unlink(missing_ok=True)
        self._map.close()
        os.close(self._fd)

    def write(self, state: StateVector) -> None:
        """Publish one state; a few microseconds, never waits."""
        circle = state.vision.circle
        nan = math.nan
        body = _BODY.pack(
            state.seq,
            state.t_ns,
            state.vision.t_ns,
            state.range.t_ns,
            self._clock.now_ns() + state.valid_until_ns - state.t_ns,
            state.vision.frame_id,
            circle.u_px if circle else nan,
            circle.v_px if circle else nan,
            circle.radius_px if circle else nan,
            nan if state.range.distance_mm is None else state.range.distance_mm,
            nan if state.z_vision_mm is None else state.z_vision_mm,
            state.vision.quality,
            state.range.quality,
            state.reason,
            -1 if state.d is None else state.d,
            state.stop,
            state.may_move,
            state.in_place,
            state.visit.moved,
        )
        self._count += 1
        at = _HEAD.size + (self._count & 1) * _SLOT_SIZE
        self._map[at : at + _SLOT_SIZE] = body + _CRC.pack(zlib.crc32(body))
        self._map[_COUNT_AT : _HEAD.size] = _COUNT.pack(self._count)


class SharedStateReader:
    """Attached to one bay's vector; a context manager. Raises LinkError when no live gateway writes it."""

    def __init__(self, instance: str, bay: str, clock: Clock | None = None) -> None:
        self._path = path_of(instance, bay)
        self._bay = bay
        self._clock = clock or SystemClock()

    def __enter__(self) -> Self:
        try:
            self._fd = os.open(self._path, _LOOK)
        except OSError as error:
            raise LinkError(f"no gateway shares a state for {self._path.name.split('.', 1)[1]!r}: {error}") from error
        try:
            self._map = mmap.mmap(self._fd, _SIZE, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            os.close(self._fd)
            raise LinkError(f"{self._path}: not a state vector of this version: {error}") from error
        magic, slot_size, *_ = _HEAD.unpack(self._map[: _HEAD.size])
        if magic != MAGIC or slot_size != _SLOT_SIZE:
            self.close()
            raise LinkError(f"{self._path}: not a state vector of this version")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        self._map.close()
        os.close(self._fd)

    def read(self, *, later: bool = False) -> SharedVector:
        """The newest complete vector; if it is not valid any more, with stop on and without any value. `later`: codes
        that only a later version knows are left as numbers.

        Raises LinkError when its gateway is dead, or nothing has been written yet.
        """
        if not _locked_elsewhere(self._fd):
            raise LinkError("the gateway that wrote this state is dead")
        for _ in range(_TRIES):
            _, _, pid, count = _HEAD.unpack(self._map[: _HEAD.size])
            at = _HEAD.size + (count & 1) * _SLOT_SIZE
            slot = self._map[at : at + _SLOT_SIZE]
            # Two writes later the same slot is complete again but not yet pointed to: the next read would return an
            # older state.
            if _COUNT.unpack(self._map[_COUNT_AT : _HEAD.size])[0] != count:
                continue
            body, crc = slot[: _BODY.size], _CRC.unpack(slot[_BODY.size :])[0]
            if count and zlib.crc32(body) == crc:
                try:
                    vector = _unpack(self._bay, pid, body, later=later)
                except ValueError as error:  # a quality or reason of a later version
                    raise LinkError(f"{self._path}: not a state vector of this version: {error}") from error
                return vector if valid(vector, self._clock.now_ns()) else _withdrawn(vector)
        raise LinkError("no complete state could be read")


def _unpack(bay: str, pid: int, body: bytes, *, later: bool) -> SharedVector:
    *numbers, vision, distance, reason, d, stop, may_move, in_place, moved = _BODY.unpack(body)

    def code(kind: type[IntEnum], number: int) -> Any:
        return number if later and number not in set(kind) else kind(number)

    codes = code(Quality, vision), code(Quality, distance), code(Reason, reason)
    fields = (bay, pid, *numbers, *codes, None if d < 0 else bool(d), stop, may_move, in_place, code(Moved, moved))
    return SharedVector(*fields)


def _withdrawn(vector: SharedVector) -> SharedVector:
    """As `shown.withdrawn` does to the state that the registers show."""
    no_values: dict[str, Any] = dict.fromkeys(("u_px", "v_px", "radius_px", "distance_mm", "z_vision_mm"), math.nan)
    return replace(
        vector,
        **no_values,
        vision_quality=not_good(vector.vision_quality),
        range_quality=not_good(vector.range_quality),
        reason=Reason.GATEWAY_FAULT,
        d=None,
        stop=True,
        may_move=False,
        in_place=False,
    )


def _claim(path: Path, instance: str) -> int:
    """An open descriptor of `path` with the writer's lock on it. Blocks for 0.2 s at most."""
    for _ in range(_TRIES):
        try:
            fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
        except OSError as error:
            raise ConfigError(f"{path}: cannot be opened for the shared state: {error}") from error
        if not stat.S_ISREG(os.fstat(fd).st_mode) or os.fstat(fd).st_uid != os.geteuid():
            os.close(fd)
            raise ConfigError(f"{path}: is no file of ours; remove it")
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:  # a live gateway; one that only sweeps; or a reader that checks whether a writer lives
            os.close(fd)
            _pause()
            continue
        # The file may have been removed between open and lock: a lock on a file without a name protects nothing.
        if _is_at(fd, path):
            return fd
        os.close(fd)
    raise _already_running(instance, _pid_at(path))


def _refuse_same_instance(instance: str) -> None:
    """Another process with this instance but other bays has other files, but publishes under the same names."""
    for path in folder().glob(f"loading-gateway.{instance}.*"):
        if (pid := _pid_at(path)) not in (0, os.getpid()) and _held_for_long(path):
            raise _already_running(instance, pid)


def _held_for_long(path: Path) -> bool:
    """Longer than a sweep takes: 0.2 s."""
    for _ in range(_TRIES):
        if not _held(path):
            return False
        _pause()
    return True


def _pause() -> None:
    threading.Event().wait(_PAUSE_S)


def _already_running(instance: str, pid: int) -> ConfigError:
    return ConfigError(
        f'a gateway with instance = "{instance}" is already running (process {pid}); give this one another `instance`'
    )


def _is_at(fd: int, path: Path) -> bool:
    """Is the open file still the one at `path`?"""
    try:
        return os.path.samestat(os.fstat(fd), os.stat(path))
    except FileNotFoundError:
        return False


def _pid_at(path: Path) -> int:
    """The writer's; 0: there is none, or it has not written its own yet."""
    with _opened(path) as fd:
        head = b"" if fd is None else os.pread(fd, _HEAD.size, 0)
    return int(_HEAD.unpack(head)[2]) if len(head) == _HEAD.size else 0


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[int | None]:
    try:
        fd = os.open(path, _LOOK)
    except OSError:
        yield None
        return
    try:
        yield fd if stat.S_ISREG(os.fstat(fd).st_mode) else None
    finally:
        os.close(fd)


def _locked_elsewhere(fd: int) -> bool:
    """True while another open file holds the writer's lock. Taking the shared lock for a moment is how to ask."""
    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    fcntl.flock(fd, fcntl.LOCK_UN)
    return False


def _held(path: Path) -> bool:
    with _opened(path) as fd:
        return fd is not None and _locked_elsewhere(fd)


def _sweep() -> None:
    """Remove files of killed gateways, as far as permissions allow."""
    for path in folder().glob("loading-gateway.*.*"):
        with _opened(path) as fd:
            if fd is None:
                continue
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            # Another sweep may have been quicker, and a running gateway's new file may be there by now.
            if _is_at(fd, path):
                with contextlib.suppress(OSError):  # another user's, most likely
                    path.unlink(missing_ok=True)
