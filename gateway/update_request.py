"""What the pages may ask of the unit that updates as root, and what it shows of its work: two files between them. IO.

The gateway's user writes a package, its signature and, last, a request into the spool folder; the unit
loading-gateway-update-request takes them. Nothing in the spool is trusted: a request names one of three actions, and
neither a path nor an option. Both files are contracts between versions: fields are only added, each with a default.
"""

import sys
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from gateway import systemd
from gateway.files import plain_bytes

SPOOL = "update"  # below the service's state folder
REQUEST, PACKAGE, SIGNATURE = "request.json", "package.deb", "package.deb.asc"
MAX_REQUEST_BYTES, MAX_SIGNATURE_BYTES, MAX_PACKAGE_BYTES = 4096, 65_536, 1_000_000_000
MAX_SHOWN_BYTES = 1_000_000
VERSIONS = Path("/opt/loading-gateway/versions")
SHOWN = "update.json"  # beside the versions, root's own

NAME_PATTERN = r"^[A-Za-z0-9_.-]{1,64}$"
Names = Annotated[tuple[Annotated[str, Meta(pattern=NAME_PATTERN)], ...], Meta(max_length=64)]


class UpdateRequest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`check`: a dry run. `bays`: where the new version may decide otherwise; `alarms`: that may be new; by name."""

    action: Literal["check", "install", "back"]
    bays: Names = ()
    alarms: Names = ()


class ShownUpdate(msgspec.Struct, frozen=True, kw_only=True):
    """`version`: in use; `previous`: to which `back` returns, empty: none; `differing`: bays in which the new version
    decides otherwise; `log`: its end. The rest as in gateway/update/state.py; `stage` empty: there was no update."""

    version: str = ""
    previous: str = ""
    stage: str = ""
    old: str = ""
    new: str = ""
    outcome: str = ""
    why: str = ""
    differing: tuple[str, ...] = ()
    log: tuple[str, ...] = ()


def request_of(data: bytes) -> UpdateRequest:
    """Raises ValueError."""
    if len(data) > MAX_REQUEST_BYTES:
        raise ValueError("it is too long")
    return msgspec.json.decode(data, type=UpdateRequest)


def shown_now(path: Path) -> ShownUpdate:
    """Nothing where there is no file, or none that this version reads."""
    try:
        return msgspec.json.decode(plain_bytes(path, MAX_SHOWN_BYTES), type=ShownUpdate)
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError):
        return ShownUpdate()


def spool() -> Path | None:
    """Of this gateway; None: it was not installed from its package, or does not run as its service."""
    folder = systemd.state_directory()
    installed = Path(sys.prefix).resolve().parent == VERSIONS
    return folder / SPOOL if installed and folder is not None else None
