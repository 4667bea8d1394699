"""What a process in the sandbox can't do any more, tried for real; and each time that it could before."""

import errno
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from gateway.processes import seccomp

ROOT = Path(__file__).parents[3]
OTHER_UID = 65534

# A gateway (the parent, which holds a frame ring for writing), and one of its processes: what can the latter do?
TRIED = """
import ctypes, json, mmap, os, resource, signal, socket, sys, threading
from pathlib import Path
from gateway.processes import sandbox
from gateway.vision.transport.ring import Ring
from gateway.vision.transport.ring_spec import RingSpec

if os.geteuid() == 0:  # the ordinary case: not root, and the same user as the gateway
    os.setgroups([])
    os.setresgid(65534, 65534, 65534)
    os.setresuid(65534, 65534, 65534)
ctypes.CDLL(None).prctl(4, 1, 0, 0, 0)  # PR_SET_DUMPABLE: as it is where the user was never changed
libc = ctypes.CDLL(None, use_errno=True)
libc.mmap.restype = ctypes.c_void_p
folder, confined = Path(sys.argv[1]), sys.argv[2] == "confined"
spec = RingSpec.create(0.02)
gateway = os.getpid()
reader = spec.reader()
reading, writing = os.pipe()


def system(call):
    if call == -1:
        raise OSError(ctypes.get_errno(), "")


def reopened(path):
    os.pwrite(os.open(path, os.O_RDWR), b"x", 0)


def remapped():
    memory = libc.mmap(None, ctypes.c_size_t(4096), mmap.PROT_READ, mmap.MAP_SHARED, reader.fd, ctypes.c_long(0))
    system(libc.mprotect(ctypes.c_void_p(memory), 4096, mmap.PROT_READ | mmap.PROT_WRITE))


def stolen(number):
    pidfd = os.pidfd_open(gateway)
    fd = libc.syscall(438, pidfd, number, 0)  # pidfd_getfd
    system(fd)


def ran():
    if (child := os.fork()) == 0:
        try:
            os.execv("/bin/true", ["true"])
        except OSError as error:
            os._exit(error.errno)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code:
        raise OSError(code, "")


tries = {
    "map the frames for writing": lambda: mmap.mmap(reader.fd, reader.size_bytes, access=mmap.ACCESS_WRITE),
    "make a mapping writable": remapped,
    "write to the frames": lambda: os.pwrite(reader.fd, b"x", 0),
    "allow oneself to": lambda: os.fchmod(reader.fd, 0o600),
    "open the frames anew": lambda: reopened(f"/proc/self/fd/{reader.fd}"),
    "open the gateway's descriptor": lambda: reopened(f"/proc/{gateway}/fd/{spec.fd}"),
    "take the gateway's descriptor": lambda: stolen(spec.fd),
    "write the gateway's memory": lambda: os.open(f"/proc/{gateway}/mem", os.O_RDWR),
    "signal the gateway": lambda: os.kill(gateway, 0),
    "slow the gateway": lambda: os.setpriority(os.PRIO_PROCESS, gateway, 19),
    "move the gateway": lambda: os.sched_setaffinity(gateway, os.sched_getaffinity(gateway)),
    "limit the gateway": lambda: resource.prlimit(gateway, 4, (0, 0)),
    "write a file": lambda: (folder / "old").open("w"),
    "append to a file": lambda: (folder / "old").open("a"),
    "make a file": lambda: (folder / "new").touch(),
    "make a folder": lambda: (folder / "folder").mkdir(),
    "rename a file": lambda: (folder / "old").rename(folder / "other"),
    "link a file": lambda: (folder / "link").symlink_to("old"),
    "change a file's mode": lambda: (folder / "other").chmod(0o600),
    "cut a file": lambda: os.truncate(folder / "other", 0),
    "remove a file": lambda: (folder / "other").unlink(),
    "run a program": ran,
    "open a connection": lambda: socket.socket(),
}
works = {
    "read a file": lambda: Path("/etc/passwd").read_bytes(),
    "see the frames": lambda: Ring(reader, writable=False).snapshot(),
    "list a folder": lambda: os.listdir(folder),
    "have a pair of sockets": lambda: [sock.close() for sock in socket.socketpair()],
    "raise a signal": lambda: signal.raise_signal(signal.SIGCONT),
    "ask for one's limits": lambda: resource.getrlimit(4),
    "start a thread": lambda: (thread := threading.Thread(target=len, args=("",)), thread.start(), thread.join()),
}


def tried(what):
    try:
        what()
    except OSError as error:
        return error.errno
    return 0


if (child := os.fork()) == 0:
    lacking = sandbox.enter(None) if confined else []
    status = dict(line.split(":\\t") for line in Path("/proc/self/status").read_text().splitlines() if ":\\t" in line)
    found = {
        "lacking": lacking,
        "status": {key: status[key] for key in ("CapPrm", "CapEff", "CapAmb", "NoNewPrivs", "Seccomp")},
        "dumpable": libc.prctl(3, 0, 0, 0, 0),
        "works": {name: tried(what) for name, what in works.items()},
        "tries": {name: tried(what) for name, what in tries.items()},
    }
    os.write(writing, json.dumps(found).encode())
    os._exit(0)
os.close(writing)
os.waitpid(child, 0)
print(os.read(reading, 1 << 16).decode())
"""


def output_of(script: str, *words: str) -> Any:
    """What a script prints as JSON, run by an interpreter of its own."""
    command = [sys.executable, "-c", script, *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def tried(folder: Path, how: str) -> dict[str, Any]:
    (folder / "old").write_text("old")
    if os.geteuid() == 0:  # who tries is another user, and pytest's folders are closed to others
        folder.chmod(0o777)
        for parent in folder.parents[:2]:
            parent.chmod(parent.stat().st_mode | 0o055)
        os.chown(folder / "old", OTHER_UID, OTHER_UID)
    found: dict[str, Any] = output_of(TRIED, str(folder), how)
    return found


def test_in_the_sandbox_nothing_can_be_written_run_or_reached(tmp_path: Path) -> None:
    found = tried(tmp_path, "confined")

    assert found["lacking"] == []
    assert {name for name, error in found["tries"].items() if error == 0} == set()
    assert found["tries"]["map the frames for writing"] == errno.EACCES
    assert found["tries"]["make a mapping writable"] == errno.EACCES
    assert set(found["works"].values()) == {0}
    assert found["status"] == {
        "CapPrm": "0" * 16, "CapEff": "0" * 16, "CapAmb": "0" * 16, "NoNewPrivs": "1", "Seccomp": "2",
    }  # fmt: skip
    assert found["dumpable"] == 0
    assert [path.name for path in tmp_path.iterdir()] == ["old"]
    assert (tmp_path / "old").read_text() == "old"


def test_without_it_a_process_of_the_same_user_could_do_all_of_that_but_what_the_descriptor_forbids(
    tmp_path: Path,
) -> None:
    found = tried(tmp_path, "free")

    refused = {name for name, error in found["tries"].items() if error}
    assert refused - {"take the gateway's descriptor", "write the gateway's memory"} == {  # what Yama may forbid
        "map the frames for writing",
        "make a mapping writable",
        "write to the frames",
    }


# The filter itself, for every machine that it knows.

READ = {"x86_64": 0, "aarch64": 63}
PID = 4711


def answered(machine: str, number: int, *arguments: int, arch: int | None = None, connects: bool = False) -> int:
    """What the kernel would do: the same few instructions of classic BPF."""
    column, own, _ = seccomp.MACHINES[machine]
    code = list(seccomp.program(column, own, PID, connects=connects))
    data = {0: number, 4: own if arch is None else arch}
    data |= {16 + 8 * n: value & 0xFFFFFFFF for n, value in enumerate(arguments)}
    at, loaded = 0, 0
    while True:
        kind, if_true, if_false, operand = code[at]
        at += 1
        match kind:
            case 0x20:
                loaded = data[operand]
            case 0x15:
                at += if_true if loaded == operand else if_false
            case 0x35:
                at += if_true if loaded >= operand else if_false
            case 0x45:
                at += if_true if loaded & operand else if_false
            case 0x06:
                return operand


ALLOWED, REFUSED, KILLED = 0x7FFF0000, 0x50000 | errno.EPERM, 0x80000000


@pytest.mark.parametrize("machine", seccomp.MACHINES)
class TestFilter:
    @pytest.mark.parametrize("connects", [False, True])
    def test_every_row_is_refused_and_what_is_in_none_is_allowed(self, machine: str, connects: bool) -> None:
        column = seccomp.MACHINES[machine][0]
        calls = [call for row in seccomp.REFUSED.values() for call in row]
        calls += seccomp.LISTENING if connects else seccomp.CONNECTING
        rows = {call[1 + column] for call in calls} - {None}
        for number in range(470):
            opens = {call[column] for call in seccomp.OPEN} | {call[column] for call in seccomp.OF_ITSELF}
            if number not in opens:
                expected = REFUSED if number in rows else ALLOWED
                assert answered(machine, number, connects=connects) == expected, number
        assert answered(machine, READ[machine]) == ALLOWED

    def test_files_are_opened_for_reading_only(self, machine: str) -> None:
        column = seccomp.MACHINES[machine][0]
        for *numbers, place in seccomp.OPEN:
            if (number := numbers[column]) is None:
                continue
            before = (0,) * place
            assert answered(machine, number, *before, os.O_RDONLY | os.O_CLOEXEC | os.O_DIRECTORY) == ALLOWED
            for flag in (os.O_WRONLY, os.O_RDWR, os.O_CREAT, os.O_TRUNC, os.O_APPEND, os.O_TMPFILE | os.O_RDWR):
                assert answered(machine, number, *before, flag) == REFUSED, flag

    def test_only_this_process_is_signalled_or_limited(self, machine: str) -> None:
        column = seccomp.MACHINES[machine][0]
        for named in seccomp.OF_ITSELF:
            assert answered(machine, named[column], PID) == ALLOWED
            assert answered(machine, named[column], 0) == ALLOWED
            assert answered(machine, named[column], PID - 1) == REFUSED
            assert answered(machine, named[column], -1) == REFUSED

    def test_other_numbers_for_the_same_calls_are_no_way_round(self, machine: str) -> None:
        assert answered(machine, READ[machine], arch=0x40000003) == KILLED  # 32 bit x86
        assert answered(machine, 0x40000000 | 2) == REFUSED


def test_numbers_are_those_of_the_kernel_s_own_list() -> None:
    """Of this machine, as the C library's headers have them; newer calls than the headers are left out."""
    headers = [
        Path(f"/usr/include/{os.uname().machine}-linux-gnu/asm/unistd_64.h"),
        Path("/usr/include/asm-generic/unistd.h"),
    ]
    pattern = re.compile(r"#define __NR(?:3264)?_(\w+)\s+(\d+)")
    for column, header in enumerate(headers):
        known = dict(pattern.findall(header.read_text())) if header.is_file() else {}
        for calls in (*seccomp.REFUSED.values(), seccomp.CONNECTING, seccomp.LISTENING):
            for name, *numbers in calls:
                if numbers[column] is not None and name in known:
                    assert int(known[name]) == numbers[column], name


# Another user.

BECOME = """
import ctypes, json, os, sys
from gateway.processes import sandbox
from gateway.errors import ConfigError
sys.path[:] = [sys.argv[2]] if sys.argv[2] else []
try:
    lacking = sandbox.enter(sys.argv[1])
except ConfigError as error:
    lacking = [f"ConfigError: {error}"]
signal = ctypes.c_int()
ctypes.CDLL(None).prctl(2, ctypes.byref(signal), 0, 0, 0)
print(json.dumps([lacking, os.getresuid(), os.getgroups(), signal.value]))
"""


def became(user: str, *, path: str = "") -> list[Any]:
    found: list[Any] = output_of(BECOME, user, path)
    return found


def test_only_root_becomes_another_user_and_dies_with_its_parent_still() -> None:
    lacking, uids, groups, signal = became("nobody")
    if os.geteuid() == 0:
        assert (lacking, uids) == ([], [OTHER_UID] * 3)
        assert 0 not in groups
        assert signal == 9
    else:
        assert lacking == ["hmi.run_as = nobody: only root can become another user"]
        assert uids == list(os.getresuid())


def test_a_user_that_there_is_not_or_who_cannot_read_the_program_is_a_configuration_error(tmp_path: Path) -> None:
    tmp_path.chmod(0o700)
    if os.geteuid() == 0:
        assert became("no-such-user")[0] == ["ConfigError: hmi.run_as = no-such-user: there is no such user"]
        expected = f"ConfigError: hmi.run_as = nobody: can't read {tmp_path}, which contains the program"
        assert became("nobody", path=str(tmp_path))[0] == [expected]
    else:
        assert became("no-such-user")[0] == ["hmi.run_as = no-such-user: only root can become another user"]


THREADED = """
import ctypes, json, os, threading
from pathlib import Path
from gateway.processes import sandbox
begun, go, found = threading.Event(), threading.Event(), []
def at_work():
    begun.set()
    go.wait()
    try:
        found.append(Path("/dev/null").open("w"))
    except OSError as error:
        found.append(error.errno)
thread = threading.Thread(target=at_work)
thread.start()
begun.wait()
lacking = sandbox.enter(None)
go.set()
thread.join()
print(json.dumps([lacking, found]))
"""


def test_a_thread_that_is_there_already_is_filtered_too_and_reported_where_it_keeps_rights() -> None:
    lacking, found = output_of(THREADED)
    assert found == [errno.EPERM]
    capable = os.geteuid() == 0
    assert lacking == (["1 threads that a library has begun already keep their capabilities"] if capable else [])
