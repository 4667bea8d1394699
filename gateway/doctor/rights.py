"""Whose rights an examination has: those of the service. With root's it would find that everything is permitted. IO."""

import ctypes
import grp
import os
import pwd
import struct
from pathlib import Path

from gateway.errors import GatewayError

SERVICE_USER = "loading-gateway"  # packaging/sysusers
SERVICE_GROUPS = ("dialout", "video")  # of its unit: serial ports, cameras
SERVICE_FOLDER = Path("/etc/loading-gateway")
SERVICE_STATE = "/var/lib/loading-gateway"  # StateDirectory= of the unit
PR_SET_KEEPCAPS = 8  # linux/prctl.h
CAPABILITY_VERSION_3 = 0x20080522  # linux/capability.h
NET_BIND_SERVICE = 1 << 10  # the one capability of the unit: ports below 1024


def of_service(config: Path) -> str:
    """The service's user; empty: this process is not root's, or the configuration is not the service's."""
    if os.geteuid() != 0 or SERVICE_FOLDER not in config.resolve().parents:
        return ""
    try:
        return pwd.getpwnam(SERVICE_USER).pw_name
    except KeyError:
        return ""


def become(user: str, groups: tuple[str, ...] = SERVICE_GROUPS) -> None:
    """Take the user's rights, with `groups` as far as they exist, the capability and the state folder of the unit.
    There is no way back.

    Raises GatewayError where the kernel refuses.
    """
    found = pwd.getpwnam(user)
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(PR_SET_KEEPCAPS, 1, 0, 0, 0)
    os.setgroups(sorted({*os.getgrouplist(user, found.pw_gid), *_numbers(groups)}))
    os.setresgid(found.pw_gid, found.pw_gid, found.pw_gid)
    os.setresuid(found.pw_uid, found.pw_uid, found.pw_uid)
    header = struct.pack("=Ii", CAPABILITY_VERSION_3, 0)
    # Twice effective, permitted, inheritable: the lower 32 capabilities, then the upper ones.
    kept = struct.pack("=6I", NET_BIND_SERVICE, NET_BIND_SERVICE, 0, 0, 0, 0)
    if libc.capset(header, kept):
        raise GatewayError(f"the rights of {user} can't be taken: {os.strerror(ctypes.get_errno())}")
    os.environ["STATE_DIRECTORY"] = SERVICE_STATE  # as the service has it; root's home would be looked into otherwise


def _numbers(groups: tuple[str, ...]) -> set[int]:
    numbers: set[int] = set()
    for name in groups:
        try:
            numbers.add(grp.getgrnam(name).gr_gid)
        except KeyError:
            continue
    return numbers
