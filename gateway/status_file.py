"""The status file of a running gateway: what another program on this machine must know to judge it. IO.

JSON, replaced once a second as `status.json` in the folder that systemd made for the service (`RuntimeDirectory=`);
without one there is no file. It is a contract between versions: `gateway update` of one version reads the file of
another. So fields are only added, each with a default, and a reader ignores those that it does not know.
"""

import asyncio
import contextlib
import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import msgspec

from gateway.clock import Clock
from gateway.errors import LinkError
from gateway.files import plain_bytes

log = logging.getLogger(__name__)

NAME = "status.json"
FORMAT = 1
PERIOD_S = 1.0
MAX_BYTES = 1_000_000  # 64 bays take 20 kB


class BayNow(msgspec.Struct, frozen=True, kw_only=True):
    """One bay as it may be shown. Qualities, phase and the active NE 107 signals by name, in small letters; times:
    monotonic ns."""

    unit_id: int = 1
    heartbeat: int = 0  # control ticks since the start
    vision: str = "waiting"
    vision_ns: int = 0  # when the newest frame was taken
    range: str = "waiting"
    range_ns: int = 0  # when the newest distance was measured
    phase: str = "unknown"
    stop: bool = True
    function_check: str = ""  # off, may_move_off, may_move_kept; empty: not known
    ne107: tuple[str, ...] = ()


class ModbusClient(msgspec.Struct, frozen=True, kw_only=True):
    """One address with open connections. `quiet_s`: since it was last answered."""

    address: str
    is_plc: bool = False
    quiet_s: float = 0.0


class ModbusPort(msgspec.Struct, frozen=True, kw_only=True):
    """One listening port. `requests`: since the start."""

    host: str
    port: int
    tls: bool = False
    requests: int = 0
    clients: tuple[ModbusClient, ...] = ()


class Status(msgspec.Struct, frozen=True, kw_only=True):
    """Of the gateway that wrote it. `alarms`: those with an active cause, or latched: by id, the detail; `high`: which
    of them have high priority. `boot`: another one with every start. Digests: `gateway.config.digest`."""

    format: int = FORMAT
    version: str
    pid: int
    t_ns: int  # CLOCK_BOOTTIME when it was written
    bays: dict[str, BayNow] = {}
    modbus: tuple[ModbusPort, ...] = ()
    alarms: dict[str, str] = {}
    high: tuple[str, ...] = ()
    boot: str = ""
    in_force: str = ""
    reviewed: str = ""  # empty: none is stated


_DECODER = msgspec.json.Decoder(Status)


def read(path: Path) -> Status:
    """Raises LinkError where there is no file, or none that this version understands."""
    try:
        found = _DECODER.decode(plain_bytes(path, MAX_BYTES))  # the folder is the service's, and root may read
    except OSError as error:
        raise LinkError(f"{path}: {error.strerror or error}") from error
    except msgspec.MsgspecError as error:
        raise LinkError(f"{path}: not a status that this version understands: {error}") from error
    if found.format != FORMAT:
        raise LinkError(f"{path}: format {found.format}, and this version reads {FORMAT}")
    return found


@dataclass(slots=True)
class StatusFile:
    """A row of the task table. `folder`: None: no file is wanted. It is in memory (tmpfs), so that writing never waits
    for a disk."""

    folder: Path | None
    status: Callable[[], Status]
    clock: Clock

    async def run(self) -> None:
        """Raises LinkError where it can't be written, which is tried again."""
        if self.folder is None:
            await asyncio.Event().wait()
        else:
            await self._write_all(self.folder / NAME)

    async def _write_all(self, path: Path) -> NoReturn:
        fresh = path.with_name(f"{NAME}.new")
        try:
            while True:
                _write(path, fresh, self.status())
                await self.clock.sleep(PERIOD_S)
        finally:  # an old status must not look like one of now
            _remove(path)


def _write(path: Path, fresh: Path, status: Status) -> None:
    try:
        fresh.write_bytes(msgspec.json.format(msgspec.json.encode(status), indent=1))
        fresh.replace(path)
    except OSError as error:
        raise LinkError(f"{path}: {error.strerror or error}") from error


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink(missing_ok=True)
