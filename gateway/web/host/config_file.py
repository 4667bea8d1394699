"""The configuration file on the disk: read unchanged, replaced completely or not at all."""

import errno
import hashlib
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from gateway.errors import ConfigError
from gateway.files import sync_folder
from gateway.web.ipc.messages import ChangedOnDiskError

MAX_BYTES = 4 * 1024 * 1024
NO_FILE = (
    "this gateway runs on the settings it was shipped with, and there is no file of yours to write to; export a "
    "profile, or start with a configuration file of your own"
)
_MEANT = {
    errno.EROFS: "its disk is mounted read-only",
    errno.EBUSY: "it is mounted into a container as a single file; mount its folder instead",
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the quota is used up",
}


@dataclass(frozen=True, slots=True)
class Loaded:
    """A file's text, line ends included, and the digest that identifies it."""

    path: Path  # as it was named; messages show this path
    text: str
    digest: str


def load(path: Path) -> Loaded:
    """Raises ConfigError where there is no readable UTF-8 text."""
    data = _bytes(path)
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8: {error}") from error
    return Loaded(path, text, _digest(data))


def why_not_writable(path: Path | None) -> str:
    """Why `save` would fail, as text; empty: no known reason."""
    if path is None:
        return NO_FILE
    try:
        real = path.resolve(strict=True)
        info = real.stat()
    except OSError as error:
        return f"{path}: {_why(error)}"
    may_write = bool(info.st_mode & 0o222) and os.access(real, os.W_OK)
    checks = (
        (stat.S_ISREG(info.st_mode), f"{path}: is not a regular file"),
        (may_write, f"{path}: is read-only for the gateway"),
        (
            os.access(real.parent, os.W_OK | os.X_OK),
            f"{real.parent}: the gateway may not write in this folder, where the new file is made",
        ),
        (
            os.geteuid() in (0, info.st_uid),
            f"{path}: belongs to another user, and would be the gateway's if it replaced it",
        ),
    )
    return next((reason for holds, reason in checks if not holds), "")


def save(former: Loaded, text: str) -> Path:
    """Replace the file's text; the former one is kept beside it as `.previous`, whose path is returned.

    Written to a new file in the same folder, synced and renamed over the old one: at any moment the old or
    the new file is complete. Mode and owner are kept, a symlink is followed. ChangedOnDiskError: the file is
    not the one that was read; ConfigError: it cannot be written.
    """
    if reason := why_not_writable(former.path):
        raise ConfigError(reason)
    try:
        real = former.path.resolve(strict=True)
        info = real.stat()
        backup = _former(real)
        with _beside(real, former.text, info) as kept, _beside(real, text, info) as fresh:
            if _digest(_bytes(former.path)) != former.digest:
                raise ChangedOnDiskError(f"{former.path}: was changed elsewhere since it was read; nothing was written")
            kept.replace(backup)
            fresh.replace(real)
        sync_folder(real.parent)
    except OSError as error:
        raise ConfigError(f"{former.path}: cannot be written: {_why(error)}") from error
    return backup


def previous(path: Path) -> Loaded | None:
    """The text before the last `save`; None: there is none that can be read."""
    try:
        return load(_former(path.resolve(strict=True)))
    except (OSError, ConfigError):
        return None


def _former(real: Path) -> Path:
    return real.with_name(f"{real.name}.previous")


@contextmanager
def _beside(real: Path, text: str, like: os.stat_result) -> Iterator[Path]:
    """A new file in the folder of `real`, synced to the disk; removed unless it was renamed."""
    handle, name = tempfile.mkstemp(prefix=f".{real.name}.", dir=real.parent)
    path = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(text.encode())
            file.flush()
            made = os.fstat(handle)
            if (like.st_uid, like.st_gid) != (made.st_uid, made.st_gid):
                os.fchown(handle, like.st_uid, like.st_gid)
            os.fchmod(handle, stat.S_IMODE(like.st_mode))  # after the owner: changing that takes bits away
            os.fsync(handle)
        yield path
    finally:
        path.unlink(missing_ok=True)


def _bytes(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {_why(error)}") from error
    if len(data) > MAX_BYTES:
        raise ConfigError(f"{path}: is larger than {MAX_BYTES >> 20} MiB")
    return data


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _why(error: OSError) -> str:
    return _MEANT.get(error.errno or 0) or error.strerror or str(error)
