"""What more than one part of the gateway does with files, beyond what pathlib does. IO."""

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO


def sync_folder(folder: Path) -> None:
    """A new name in it survives a power cut."""
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def device_at(address: str, devices: Path = Path("/dev")) -> Path | str:
    """What the address of a camera or a ranger names, the same for each way to write it: a device's or a file's own
    path behind number and links; else the address without name and password. `devices`: the kernel's folder."""
    text = address.strip()
    if text.isdecimal():
        return (devices / f"video{text}").resolve()
    if text.startswith("/"):
        return Path(text).resolve()
    scheme, separator, rest = text.partition("://")
    if not separator:
        return text
    host, slash, path = rest.partition("/")
    return f"{scheme.lower()}{separator}{host.rpartition('@')[2].lower()}{slash}{path}"


def plain_bytes(path: Path, most: int = -1) -> bytes:
    """The first `most` bytes of a file in a folder that another user can write, the whole by default: never waits for a
    pipe, never follows a link, for root may read. Raises OSError."""
    with os.fdopen(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        return file.read(most)


def write_all(fd: int, data: bytes) -> None:
    """All of it: waits for room, and continues a short write (a full disk), which fails then. Raises OSError."""
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(fd, rest) :]


def write_file(path: Path, data: bytes) -> None:
    """On disk when it returns; see `replacing`. Its folder is made where it is missing. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    with replacing(path) as file:
        file.write(data)


@contextmanager
def replacing(path: Path, mode: int = 0o600, *, fresh: Path | None = None) -> Iterator[BinaryIO]:
    """A file to write, which takes the place of `path` at the end of the block and is on disk then: the old file or the
    new one, never a part, whenever the power fails. Where the block raises, the old one stays. `fresh`: where it is
    written, in the same folder. Raises OSError."""
    fresh = fresh or path.with_name(f"{path.name}.new")
    fresh.unlink(missing_ok=True)
    try:
        fd = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, mode)
        with os.fdopen(fd, "wb") as file:
            yield file
            file.flush()
            os.fsync(fd)
        fresh.replace(path)
    except BaseException:
        with suppress(OSError):
            fresh.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)
