"""A request of the pages, taken by root. IO.

Whoever controls the gateway's user controls the spool: only plain files of that user are read, each through one
descriptor, and copied into the folder of updates before anything looks at them. The signature of the copy decides.
"""

import os
import pwd
import stat
from contextlib import suppress
from pathlib import Path

from gateway.files import replacing
from gateway.update.machine import Machine, UpdateError
from gateway.update.package import SPARE_BYTES
from gateway.update.prepare import UpdateOptions
from gateway.update_request import (
    MAX_PACKAGE_BYTES,
    MAX_REQUEST_BYTES,
    MAX_SIGNATURE_BYTES,
    PACKAGE,
    REQUEST,
    SIGNATURE,
    UpdateRequest,
    request_of,
)

PIECE_BYTES = 1 << 20


def taken(machine: Machine) -> UpdateOptions:
    """The request is gone afterwards, whatever it was. Raises UpdateError."""
    folder, uid = _opened_spool(machine)
    try:
        try:
            data = _read(folder, REQUEST, uid, MAX_REQUEST_BYTES)
        finally:
            with suppress(OSError):
                os.unlink(REQUEST, dir_fd=folder)
        request = _understood(data)
        if request.action == "back":
            return UpdateOptions()
        copies = [machine.paths.folder / name for name in ("requested.deb", "requested.deb.asc")]
        machine.paths.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        _copy(machine, folder, PACKAGE, uid, copies[0], MAX_PACKAGE_BYTES)
        _copy(machine, folder, SIGNATURE, uid, copies[1], MAX_SIGNATURE_BYTES)
    except OSError as error:
        raise UpdateError(f"{machine.paths.spool}: {error.filename or ''} {error.strerror or error}") from error
    finally:
        os.close(folder)
    return UpdateOptions(
        package=copies[0],
        signature=copies[1],
        dry=request.action == "check",
        accepted=request.alarms,
        accepted_bays=request.bays,
        newer=True,
    )


def clean(machine: Machine) -> None:
    """The spool, once its package is in use or nobody needs it any more."""
    with suppress(UpdateError):
        folder, _ = _opened_spool(machine)
        try:
            for name in (PACKAGE, SIGNATURE):
                with suppress(OSError):
                    os.unlink(name, dir_fd=folder)
        finally:
            os.close(folder)


def _understood(data: bytes) -> UpdateRequest:
    try:
        return request_of(data)
    except ValueError as error:
        raise UpdateError(f"no request that is known: {error}") from error


def _opened_spool(machine: Machine) -> tuple[int, int]:
    """A descriptor of the folder, and whose files are taken: the service's user's."""
    path = machine.paths.spool
    try:
        uid = pwd.getpwnam(user).pw_uid if (user := machine.service_user()) else os.geteuid()
        folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except (OSError, KeyError) as error:
        raise UpdateError(f"{path}: {getattr(error, 'strerror', None) or error}") from error
    found = os.fstat(folder)
    if found.st_uid != uid or found.st_mode & 0o022:
        os.close(folder)
        raise UpdateError(f"{path}: others than the gateway's user own it or may write into it")
    return folder, uid


def _opened(folder: int, name: str, uid: int, most: int) -> tuple[int, int]:
    """A plain file's descriptor and size: no link, no pipe, of that user, with one name."""
    fd = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=folder)
    found = os.fstat(fd)
    if not stat.S_ISREG(found.st_mode) or found.st_uid != uid or found.st_nlink != 1:
        os.close(fd)
        raise UpdateError(f"{name}: not a plain file of the gateway's user")
    if found.st_size > most:
        os.close(fd)
        raise UpdateError(f"{name}: {found.st_size} bytes, and at most {most} are taken")
    return fd, found.st_size


def _read(folder: int, name: str, uid: int, most: int) -> bytes:
    fd, _ = _opened(folder, name, uid, most)
    with os.fdopen(fd, "rb") as file:
        return file.read(most + 1)


def _copy(machine: Machine, folder: int, name: str, uid: int, target: Path, most: int) -> None:
    """Not more than it had at first: its owner may go on writing."""
    fd, size = _opened(folder, name, uid, most)
    with os.fdopen(fd, "rb") as source:
        if size + SPARE_BYTES > machine.free_bytes(target.parent)[1]:
            raise UpdateError(f"{name}: no room for {size / 1e6:.0f} MB in {target.parent}")
        with replacing(target) as file:
            while size > 0 and (piece := source.read(min(size, PIECE_BYTES))):
                file.write(piece)
                size -= len(piece)
