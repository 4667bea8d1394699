"""Reduced rights for this process: for one that serves network clients, or decodes what a camera sends. They cannot be
regained.

Given up: the user, where the gateway runs as root and another is named; every capability; the right to gain any; core
dumps and debuggers; and, by `seccomp`, writing files, running programs, reaching other processes, new connections.
Kept: descriptors that are open already, reading what the user may read, threads.
"""

import ctypes
import os
import pwd
import signal
import struct
import sys
from pathlib import Path

from gateway.errors import ConfigError
from gateway.processes import seccomp

PR_SET_PDEATHSIG, PR_SET_DUMPABLE, PR_SET_NO_NEW_PRIVS = 1, 4, 38  # linux/prctl.h
CAPABILITY_VERSION_3 = 0x20080522  # linux/capability.h


def enter(user: str | None) -> list[str]:
    """Best before any thread is started. `user`: which root becomes; None: no change. Returns what is not in force, as
    text.

    Raises ConfigError for a user that does not exist, or that can't read the program.
    """
    lacking = drop_privileges(user)
    if why := seccomp.refuse():
        lacking.append(why)
    return lacking


def drop_privileges(user: str | None) -> list[str]:
    """All of `enter` but the filter of system calls, which may follow later and from any thread."""
    lacking: list[str] = []
    if (others := len(os.listdir("/proc/self/task")) - 1) and _capable():
        lacking.append(f"{others} threads that a library has begun already keep their capabilities")
    libc = ctypes.CDLL(None, use_errno=True)
    if user is not None:
        if os.geteuid() == 0:
            _become(user, libc)
        else:
            lacking.append(f"hmi.run_as = {user}: only root can become another user")
    header = struct.pack("=Ii", CAPABILITY_VERSION_3, 0)
    if libc.capset(header, bytes(24)):
        lacking.append(f"capabilities can't be dropped: {os.strerror(ctypes.get_errno())}")
    libc.prctl(PR_SET_DUMPABLE, 0, 0, 0, 0)
    libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    return lacking


def _capable() -> bool:
    status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    return any(line.startswith("CapPrm:") and int(line.split()[1], 16) for line in status.splitlines())


def _become(user: str, libc: ctypes.CDLL) -> None:
    try:
        found = pwd.getpwnam(user)
    except KeyError:
        raise ConfigError(f"hmi.run_as = {user}: there is no such user") from None
    needed = [path for path in map(Path, sys.path) if path.exists()]
    parent = os.getppid()
    os.initgroups(user, found.pw_gid)
    os.setresgid(found.pw_gid, found.pw_gid, found.pw_gid)
    os.setresuid(found.pw_uid, found.pw_uid, found.pw_uid)
    libc.prctl(PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)  # the kernel forgets it with the user
    if os.getppid() != parent:
        os._exit(1)
    for path in needed:
        if not os.access(path, os.R_OK | (os.X_OK if path.is_dir() else 0)):
            raise ConfigError(f"hmi.run_as = {user}: can't read {path}, which contains the program")
