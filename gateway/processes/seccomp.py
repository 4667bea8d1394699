"""A filter on system calls for this process: the kernel refuses what an intruder in it would need.

seccomp(2), a program of classic BPF; each refused call fails with EPERM. The numbers are those of the kernel's
asm/unistd.h and asm-generic/unistd.h.
"""

import ctypes
import errno
import os
import platform
import struct
from collections.abc import Iterator

REFUSED: dict[str, tuple[tuple[str, int | None, int | None], ...]] = {  # name, number on x86-64 and on AArch64
    "to reach into another process, or to end or slow it": (
        ("ptrace", 101, 117), ("process_vm_readv", 310, 270), ("process_vm_writev", 311, 271),
        ("process_madvise", 440, 440), ("pidfd_getfd", 438, 438), ("pidfd_send_signal", 424, 424), ("kill", 62, 129),
        ("tkill", 200, 130), ("rt_sigqueueinfo", 129, 138), ("rt_tgsigqueueinfo", 297, 240), ("setpriority", 141, 140),
        ("sched_setaffinity", 203, 122), ("sched_setscheduler", 144, 119), ("sched_setparam", 142, 118),
        ("sched_setattr", 314, 274), ("ioprio_set", 251, 30),
    ),
    "to make, change or remove a file": (
        ("creat", 85, None), ("openat2", 437, 437), ("open_by_handle_at", 304, 265), ("truncate", 76, 45),
        ("unlink", 87, None), ("unlinkat", 263, 35), ("rename", 82, None), ("renameat", 264, 38),
        ("renameat2", 316, 276), ("mkdir", 83, None), ("mkdirat", 258, 34), ("rmdir", 84, None), ("link", 86, None),
        ("linkat", 265, 37), ("symlink", 88, None), ("symlinkat", 266, 36), ("mknod", 133, None), ("mknodat", 259, 33),
        ("chmod", 90, None), ("fchmod", 91, 52), ("fchmodat", 268, 53), ("fchmodat2", 452, 452), ("chown", 92, None),
        ("fchown", 93, 55), ("lchown", 94, None), ("fchownat", 260, 54), ("setxattr", 188, 5), ("lsetxattr", 189, 6),
        ("fsetxattr", 190, 7), ("setxattrat", 463, 463), ("io_uring_setup", 425, 425),
    ),
    "to run another program": (("execve", 59, 221), ("execveat", 322, 281)),
}  # fmt: skip
CONNECTING = (("socket", 41, 198), ("connect", 42, 203))  # to open a new connection
LISTENING = (("listen", 50, 201), ("accept", 43, 202), ("accept4", 288, 242))  # refused instead where one may connect
OPEN = ((2, None, 1), (257, 56, 2))  # open, openat: number on both, and which argument holds the access mode
OF_ITSELF = ((234, 131), (302, 261))  # tgkill, prlimit64: may name this process only (0 is this one, too)
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND

MACHINES = {"x86_64": (0, 0xC000003E, 317), "aarch64": (1, 0xC00000B7, 277)}  # column above, AUDIT_ARCH, seccomp itself
_X32 = 0x40000000  # x86-64: another set of numbers for the same calls begins here
_LOAD, _EQUAL, _AT_LEAST, _ANY_BIT, _RETURN = 0x20, 0x15, 0x35, 0x45, 0x06
_NUMBER, _ARCH, _ARGUMENTS = 0, 4, 16  # offsets in struct seccomp_data
_ALLOW, _KILL, _REFUSE = 0x7FFF0000, 0x80000000, 0x00050000 | errno.EPERM
_SET_MODE_FILTER, _ALL_THREADS = 1, 1
Instruction = tuple[int, int, int, int]  # code, jump if true, jump if false, operand


def program(column: int, arch: int, pid: int, *, connects: bool = False) -> Iterator[Instruction]:
    """The filter. Every rule is complete in itself: it decides, or passes the call's number to the next. `connects`:
    it may open connections, and take none."""
    yield from ((_LOAD, 0, 0, _ARCH), (_EQUAL, 1, 0, arch), (_RETURN, 0, 0, _KILL), (_LOAD, 0, 0, _NUMBER))
    yield from ((_AT_LEAST, 0, 1, _X32), (_RETURN, 0, 0, _REFUSE))
    for calls in (*REFUSED.values(), LISTENING if connects else CONNECTING):
        for _, *numbers in calls:
            if (number := numbers[column]) is not None:
                yield from ((_EQUAL, 0, 1, number), (_RETURN, 0, 0, _REFUSE))
    for *opens, flags in OPEN:
        if (number := opens[column]) is not None:
            yield from ((_EQUAL, 0, 4, number), (_LOAD, 0, 0, _ARGUMENTS + 8 * flags))
            yield from ((_ANY_BIT, 0, 1, WRITING), (_RETURN, 0, 0, _REFUSE), (_RETURN, 0, 0, _ALLOW))
    for named in OF_ITSELF:
        yield from ((_EQUAL, 0, 5, named[column]), (_LOAD, 0, 0, _ARGUMENTS))
        yield from ((_EQUAL, 2, 0, pid), (_EQUAL, 1, 0, 0), (_RETURN, 0, 0, _REFUSE), (_RETURN, 0, 0, _ALLOW))
    yield (_RETURN, 0, 0, _ALLOW)


def refuse(*, connects: bool = False) -> str:
    """From now on, irrevocably, in all threads. Needs PR_SET_NO_NEW_PRIVS. Returns what prevented it; empty:
    nothing."""
    machine = platform.machine()
    if machine not in MACHINES:
        return f"no table of system calls for {machine}"
    column, arch, seccomp = MACHINES[machine]
    code = b"".join(
        struct.pack("=HBBI", *instruction) for instruction in program(column, arch, os.getpid(), connects=connects)
    )
    buffer = ctypes.create_string_buffer(code, len(code))
    prog = struct.pack("@HP", len(code) // 8, ctypes.addressof(buffer))
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.syscall(seccomp, _SET_MODE_FILTER, _ALL_THREADS, prog) != 0:
        return f"the kernel takes no filter of system calls: {os.strerror(ctypes.get_errno())}"
    return ""
