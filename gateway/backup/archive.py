"""A backup as one `.tar.gz`: written completely or not at all, readable by its owner only; read with suspicion. IO."""

import grp
import gzip
import hashlib
import io
import os
import platform
import pwd
import re
import stat
import tarfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Protocol, cast

from gateway import __version__
from gateway.backup import contents
from gateway.backup.manifest import (
    FORMAT,
    MAX_FILE_BYTES,
    MAX_FILES,
    MAX_MANIFEST_BYTES,
    NAME,
    BackupError,
    Entry,
    Kind,
    Manifest,
    Owned,
    decoded,
)
from gateway.config import GatewayConfig, parse
from gateway.config.strict.toml_file import read_toml
from gateway.files import replacing
from gateway.web.profile.redact import redacted

CHUNK = 1 << 20
_FOLLOWED = (Kind.CONFIGURATION, Kind.CERTIFICATE, Kind.SECRET)  # the others are where the service's user can put links
_PEM_LABEL = re.compile(rb"-----BEGIN ([^-\r\n]*)-----")
_PUBLIC_PEM = (b"CERTIFICATE", b"TRUSTED CERTIFICATE", b"X509 CERTIFICATE", b"X509 CRL")


class Readable(Protocol):
    def read(self, size: int = -1, /) -> bytes: ...


def write(config_file: Path, out: Path, *, secrets: bool = True, records: bool = False) -> Manifest:
    """Write `out`; the gateway may run. Raises ConfigError for a faulty configuration, BackupError for a file that it
    names and that can't be read, and for an archive that can't be written.

    Each file is one of one moment: what the gateway writes, it replaces as a whole; a recording only grows.
    """
    config_file = config_file.absolute()
    document, text = read_toml(config_file)
    config = parse(document, source=str(config_file), text=text)
    instead = None if secrets else redacted(text, source=str(config_file)).encode()
    others = _others(config_file, config, records=records)
    if len(others) + 1 > MAX_FILES:
        raise BackupError(f"{len(others) + 1} files, and an archive lists at most {MAX_FILES}: leave out the records")
    fresh = out.with_name(f"{out.name}.new")
    try:
        with replacing(out, fresh=fresh) as file:
            with tarfile.open(fileobj=file, mode="w:gz", compresslevel=6) as archive:
                files = [_added(archive, config_file, Kind.CONFIGURATION, instead)]
                left_out: list[str] = []
                for path, (kind, key) in others.items():
                    if not secrets and kind is Kind.TEST_SET:
                        continue
                    try:
                        public = None if secrets or kind is not Kind.CERTIFICATE else _public(path)
                        if not secrets and (kind is Kind.SECRET or (kind is Kind.CERTIFICATE and public is None)):
                            left_out.append(f"{path} ({key})")
                            continue
                        files.append(_added(archive, path, kind, public))
                    except FileNotFoundError as error:
                        if kind not in (Kind.RECORD, Kind.TEST_SET):  # which may be deleted meanwhile
                            raise BackupError(f"{key}: {path}: {error.strerror}") from error
                    except OSError as error:
                        raise BackupError(f"{key}: {path}: cannot be read: {error.strerror or error}") from error
                manifest = Manifest(
                    FORMAT,
                    __version__,
                    platform.python_version(),
                    f"{datetime.now(UTC):%Y-%m-%d %H:%M:%S}",
                    platform.node(),
                    config.site,
                    config.instance,
                    str(config_file),
                    secrets,
                    files,
                    left_out,
                )
                data = manifest.encoded()
                _add(archive, NAME, io.BytesIO(data), len(data))
            file.flush()
            verify(fresh)
    except OSError as error:
        raise BackupError(f"{out}: cannot be written: {error.strerror or error}") from error
    return manifest


def verify(path: Path) -> Manifest:
    """Reads all of an archive. Raises BackupError where it is truncated or damaged, or holds anything that its manifest
    does not list."""
    manifest: Manifest | None = None
    found: list[tuple[str, int, str]] = []
    for name, data in _members(path):
        if manifest is not None or len(found) > MAX_FILES:
            raise BackupError(f"{path}: {name!r} is not what the manifest lists")
        if name == NAME:
            text = data.read(MAX_MANIFEST_BYTES + 1)
            manifest = decoded(text)
        else:
            found.append((name, *_digest(data)))
    if manifest is None:
        raise BackupError(f"{path}: is no backup of a gateway, or truncated: it has no {NAME}")
    listed = [(entry.member, entry.bytes, entry.sha256) for entry in manifest.files]
    if damaged := [name for name, *_ in set(listed) ^ set(found)]:
        raise BackupError(f"{path}: {min(damaged)}: is not what the manifest lists (size or digest)")
    if listed != found:
        raise BackupError(f"{path}: its files are in another order than in its manifest, or one is there twice")
    return manifest


def files(path: Path, manifest: Manifest) -> Iterator[tuple[Entry, Readable]]:
    """The files of an archive that was verified, in order. Raises BackupError."""
    entries = {entry.member: entry for entry in manifest.files}
    for name, data in _members(path):
        if name in entries:
            yield entries[name], data


def _others(config_file: Path, config: GatewayConfig, *, records: bool) -> dict[Path, tuple[Kind, str]]:
    """Each file that belongs to the configuration, with the key that names it first. Raises BackupError."""
    found: dict[Path, tuple[Kind, str]] = {}
    for path, kind, key in _belonging(config_file, config, records=records):
        if path != config_file:
            found.setdefault(path, (kind, key))
    return found


def _belonging(config_file: Path, config: GatewayConfig, *, records: bool) -> Iterator[tuple[Path, Kind, str]]:
    for key, name, kind in contents.named_files(config):
        yield Path(name).absolute(), kind, key
    if os.path.lexists(keyring := config_file.with_name(contents.KEYRING)):
        yield keyring, Kind.KEYRING, contents.KEYRING
    try:
        for path in contents.language_files(config):
            yield path.absolute(), Kind.LANGUAGE, "hmi.languages_folder"
    except OSError as error:
        raise BackupError(f"hmi.languages_folder: {error.filename}: {error.strerror}") from error
    for path in contents.bay_files(config):
        yield path.absolute(), Kind.STATE, "state_dir"
    for path in contents.test_set_files(config):
        yield path.absolute(), Kind.TEST_SET, "state_dir"
    if records:
        for path in contents.record_files(config):
            yield path.absolute(), Kind.RECORD, "records.folder"


def _added(archive: tarfile.TarFile, path: Path, kind: Kind, instead: bytes | None = None) -> Entry:
    """Adds the file as it is now: a later end of a recording is left out. Raises OSError, BackupError."""
    flags = os.O_RDONLY | os.O_NONBLOCK | (0 if kind in _FOLLOWED else os.O_NOFOLLOW)
    with os.fdopen(os.open(path, flags), "rb") as file:
        info, folder = os.fstat(file.fileno()), path.parent.stat()
        if not stat.S_ISREG(info.st_mode):
            raise BackupError(f"{path}: is no plain file")
        if info.st_size > MAX_FILE_BYTES and kind is not Kind.RECORD:
            raise BackupError(f"{path}: larger than {MAX_FILE_BYTES >> 20} MiB")
        source = _Digesting(file if instead is None else io.BytesIO(instead))
        size = info.st_size if instead is None else len(instead)
        _add(archive, f"files{path}", source, size)
    return Entry(str(path), kind, size, source.digest.hexdigest(), _owned(info), _owned(folder))


def _public(path: Path) -> bytes | None:
    """The contents of a file of certificates; None where there is anything else in it: a certificate may have its
    private key beside it, and the configuration may name any file. Raises OSError, BackupError."""
    with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise BackupError(f"{path}: is no plain file")
        data = file.read(MAX_FILE_BYTES)
    found = _PEM_LABEL.findall(data)
    return data if found and all(label in _PUBLIC_PEM for label in found) else None


class _Digesting:
    """Reads a file for `tarfile`, and digests what is read."""

    def __init__(self, source: IO[bytes]) -> None:
        self._source = source
        self.digest = hashlib.sha256()

    def read(self, size: int = -1) -> bytes:
        data = self._source.read(size)
        self.digest.update(data)
        return data


def _add(archive: tarfile.TarFile, name: str, source: Readable, size: int) -> None:
    member = tarfile.TarInfo(name)
    member.size, member.mode = size, 0o600
    archive.addfile(member, cast(IO[bytes], source))


class Member:
    """The contents of one file of an archive. Reading raises BackupError where the archive is damaged."""

    def __init__(self, path: Path, data: IO[bytes]) -> None:
        self._path = path
        self._data = data

    def read(self, size: int = -1, /) -> bytes:
        with _refused(self._path):
            return self._data.read(size)


def _members(path: Path) -> Iterator[tuple[str, Member]]:
    """Each is to be read before the next. Raises BackupError for anything but plain files."""
    with _refused(path), gzip.open(path) as whole:
        with tarfile.open(fileobj=whole, mode="r|") as archive:
            for member in archive:
                data = archive.extractfile(member) if member.isreg() else None
                if data is None:
                    raise BackupError(f"{path}: {member.name!r} is no plain file")
                yield member.name, Member(path, data)
        if any(whole.read(CHUNK)) or whole.read(1):  # to its end, where its checksum is
            raise BackupError(f"{path}: goes on behind its end")


@contextmanager
def _refused(path: Path) -> Iterator[None]:
    try:
        yield
    except (tarfile.TarError, EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise BackupError(f"{path}: is truncated or damaged: {error}") from error
    except OSError as error:
        raise BackupError(f"{path}: cannot be read: {error.strerror or error}") from error


def _digest(data: Readable) -> tuple[int, str]:
    """Size and SHA-256 of what is left to be read."""
    size, digest = 0, hashlib.sha256()
    while chunk := data.read(CHUNK):
        size += len(chunk)
        digest.update(chunk)
    return size, digest.hexdigest()


def _owned(info: os.stat_result) -> Owned:
    owner, group = str(info.st_uid), str(info.st_gid)
    with suppress(KeyError):
        owner = pwd.getpwuid(info.st_uid).pw_name
    with suppress(KeyError):
        group = grp.getgrgid(info.st_gid).gr_name
    return Owned(stat.S_IMODE(info.st_mode), owner, group)
