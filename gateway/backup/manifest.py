"""What an archive says of itself: its last member, `manifest.json`. Pure.

The other members are `files/` and the path of each file without its leading slash. Only what the manifest lists is
ever read of an archive, and only where size and SHA-256 are those of the list.
"""

from enum import StrEnum
from pathlib import PurePosixPath
from typing import Annotated

import msgspec
from msgspec import Meta

from gateway.errors import GatewayError

NAME = "manifest.json"
FORMAT = 1
MAX_MANIFEST_BYTES = 16 * 1024 * 1024
MAX_FILE_BYTES = 64 * 1024 * 1024  # but for records
MAX_FILES = 100_000


class BackupError(GatewayError):
    """An archive that is damaged or can't be used, or a file that can't be read or written."""


class Kind(StrEnum):
    CONFIGURATION = "configuration"
    CERTIFICATE = "certificate"
    SECRET = "secret"  # private keys, files with a password
    STATE = "state"  # bay files
    RECORD = "record"
    TEST_SET = "test set"  # pictures and labels
    LANGUAGE = "language"  # the plant's own texts of the pages
    KEYRING = "keyring"  # the plant's own, of packages


class Owned(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Permissions, and names of user and group."""

    mode: Annotated[int, Meta(ge=0, le=0o7777)]
    owner: str
    group: str


class Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One file. `path`: absolute, where it was and will be."""

    path: Annotated[str, Meta(max_length=4096)]
    kind: Kind
    bytes: Annotated[int, Meta(ge=0)]
    sha256: Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
    owned: Owned
    folder: Owned

    @property
    def member(self) -> str:
        return f"files{self.path}"


class Manifest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    format: int
    gateway_version: str
    python_version: str
    made: str  # UTC
    host: str
    site: str
    instance: str
    config: str  # path of the configuration, which is an entry
    secrets: bool  # False: passwords are *** in the configuration, and no SECRET is there
    files: Annotated[list[Entry], Meta(max_length=MAX_FILES)]
    left_out: list[str] = []

    def encoded(self) -> bytes:
        return msgspec.json.format(msgspec.json.encode(self), indent=1)


def decoded(data: bytes) -> Manifest:
    """Raises BackupError for anything that this version could not have written."""
    try:
        found = msgspec.json.decode(data, type=Manifest)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BackupError(f"{NAME}: not a manifest that this version reads: {error}") from error
    if found.format != FORMAT:
        raise BackupError(f"{NAME}: format {found.format}; this version reads {FORMAT}")
    paths = [entry.path for entry in found.files]
    for entry in found.files:
        if not _is_plain(entry.path):
            raise BackupError(f"{NAME}: {entry.path!r} is no plain absolute path")
        if entry.kind is not Kind.RECORD and entry.bytes > MAX_FILE_BYTES:
            raise BackupError(f"{NAME}: {entry.path}: {entry.bytes} bytes; at most {MAX_FILE_BYTES}")
    if len(set(paths)) != len(paths):
        raise BackupError(f"{NAME}: lists a file twice")
    if [entry.path for entry in found.files if entry.kind is Kind.CONFIGURATION] != [found.config]:
        raise BackupError(f"{NAME}: does not list its one configuration")
    return found


def _is_plain(path: str) -> bool:
    """Absolute, and as short as it can be: no `..`, no `//`, no control characters."""
    return (
        len(path) > 1
        and path.startswith("/")
        and path.isprintable()
        and ".." not in PurePosixPath(path).parts
        and str(PurePosixPath(path)) == path
        and not path.startswith("//")
    )
