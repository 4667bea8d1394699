"""Other processes read complete vectors, know when the writer is dead, and can't disturb it."""

import contextlib
import errno
import fcntl
import json
import math
import mmap
import os
import select
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import cast

import pytest

from gateway import shared_state
from gateway.clock import SystemClock
from gateway.core.detection import Circle
from gateway.core.fusion import initial
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import Moved, Reason, StateVector
from gateway.errors import ConfigError, LinkError
from gateway.shared_state import SharedStateReader, SharedStateWriter, SharedVector, attachable, path_of


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of our own, without other gateways of this machine. Leaks no descriptor."""
    monkeypatch.setattr(shared_state, "folder", lambda: tmp_path)
    before = len(os.listdir("/proc/self/fd"))
    yield tmp_path
    assert len(os.listdir("/proc/self/fd")) == before


Shared = tuple[SharedStateWriter, SharedStateReader]


@pytest.fixture
def shared(own_folder: Path) -> Iterator[Shared]:
    """Writer and reader of one bay."""
    with SharedStateWriter("line1", "bay1") as writer, SharedStateReader("line1", "bay1") as reader:
        yield writer, reader


VALID_NS = 60_000_000_000
"""So long a state of these tests is valid: a machine under load may hold a process for seconds."""

PRELUDE = """
import json, sys
from pathlib import Path
from gateway import shared_state
shared_state.folder = lambda: Path(sys.argv[1])
from gateway.errors import LinkError
from gateway.core.state import StateVector
from gateway.shared_state import SharedStateReader, SharedStateWriter, attachable
"""


@contextlib.contextmanager
def other_process(folder: Path, code: str) -> Iterator["subprocess.Popen[str]"]:
    """Another process that has printed `ready`; killed at the end, whatever happens."""
    process = subprocess.Popen(
        [sys.executable, "-c", PRELUDE + code, str(folder)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[2],
    )
    assert process.stdin is not None
    assert process.stdout is not None
    with process:
        try:
            assert process.stdout.readline() == "ready\n"
            yield process
        finally:
            process.kill()


WRITER = """
import subprocess
with SharedStateWriter("line1", "bay1") as writer:
    writer.write(StateVector("bay1", t_ns=7, valid_until_ns=10**15))
    child = subprocess.Popen(["sleep", "60"], close_fds=False)
    print("ready", flush=True)
    print(child.pid, flush=True)
    sys.stdin.readline()
"""


def numbered(seq: int) -> StateVector:
    """Every field follows from `seq`, so that a mixture of two states would show."""
    return StateVector(
        bay="bay1",
        seq=seq,
        t_ns=seq * 3,
        vision=VisionReading(seq * 5, Quality.GOOD, Circle(seq + 0.25, seq + 0.5, seq + 0.75), frame_id=seq * 7),
        range=RangeReading(-seq, Quality.GOOD, seq * 2.5),
        z_vision_mm=seq * 1.5,
        reason=Reason.NONE,
        d=False,
        stop=False,
        may_move=True,
        valid_until_ns=seq * 3 + VALID_NS,
    )


# What is read is what was written.


def test_a_good_state_is_read_as_it_was_written(shared: Shared) -> None:
    writer, reader = shared
    writer.write(numbered(8))
    found = asdict(reader.read())
    written_ns = found.pop("valid_until_ns") - VALID_NS
    assert 0 <= SystemClock().now_ns() - written_ns < VALID_NS
    assert found == {
        "bay": "bay1",
        "pid": os.getpid(),
        "seq": 8,
        "t_ns": 24,
        "t_vision_ns": 40,
        "t_range_ns": -8,
        "frame_id": 56,
        "u_px": 8.25,
        "v_px": 8.5,
        "radius_px": 8.75,
        "distance_mm": 20.0,
        "z_vision_mm": 12.0,
        "vision_quality": Quality.GOOD,
        "range_quality": Quality.GOOD,
        "reason": Reason.NONE,
        "d": False,
        "stop": False,
        "may_move": True,
        "in_place": False,
        "moved": Moved.NO,
    }


@dataclass(frozen=True)
class Later(SystemClock):
    """The reader's clock, so much ahead."""

    by_ns: int = 0

    def now_ns(self) -> int:
        return SystemClock().now_ns() + self.by_ns


def has_no_number(found: SharedVector) -> bool:
    return all(map(math.isnan, (found.u_px, found.v_px, found.radius_px, found.distance_mm, found.z_vision_mm)))


def test_an_old_state_of_a_live_gateway_is_withdrawn() -> None:
    """Stopped, hung, or its control task dead: its lock is held, and its last state looked good."""
    with SharedStateWriter("line1", "bay1") as writer:
        writer.write(numbered(8))
        with SharedStateReader("line1", "bay1", Later(by_ns=VALID_NS // 2)) as reader:
            assert reader.read().may_move
        with SharedStateReader("line1", "bay1", Later(by_ns=VALID_NS)) as reader:
            found = reader.read()
            writer.write(replace(numbered(8), vision=VisionReading(1, Quality.COASTED)))
            assert reader.read().vision_quality is Quality.STALE
    assert has_no_number(found)
    assert (found.vision_quality, found.range_quality) == (Quality.STALE, Quality.STALE)
    assert (found.d, found.stop, found.may_move, found.reason) == (None, True, False, Reason.GATEWAY_FAULT)
    assert (found.seq, found.t_ns, found.frame_id) == (8, 24, 56)


def test_a_missing_value_is_nan(shared: Shared) -> None:
    writer, reader = shared
    writer.write(replace(initial("bay1", 7), valid_until_ns=VALID_NS))
    found = reader.read()
    assert has_no_number(found)
    assert (found.vision_quality, found.range_quality) == (Quality.WAITING, Quality.WAITING)
    assert (found.d, found.stop, found.may_move, found.reason) == (None, True, False, Reason.STARTING)


def test_every_decision_reason_and_quality_fits_and_the_newest_state_is_read(shared: Shared) -> None:
    writer, reader = shared
    for seq, (d, reason, quality) in enumerate(product((None, False, True), Reason, Quality), 1):
        readings = VisionReading(1, quality), RangeReading(2, quality)
        state = replace(numbered(seq), d=d, reason=reason, stop=bool(d), may_move=not d)
        writer.write(replace(state, vision=readings[0], range=readings[1]))
        found = reader.read()
        assert (found.seq, found.d, found.reason, found.stop, found.may_move) == (seq, d, reason, bool(d), not d)
        assert (found.vision_quality, found.range_quality) == (quality, quality)


def test_bays_and_instances_are_apart() -> None:
    with contextlib.ExitStack() as stack:
        places = [("line1", "a"), ("line1", "b"), ("line2", "a")]
        for n, (instance, bay) in enumerate(places, start=1):
            stack.enter_context(SharedStateWriter(instance, bay)).write(numbered(n))

        assert attachable() == places
        for n, (instance, bay) in enumerate(places, start=1):
            with SharedStateReader(instance, bay) as reader:
                assert (reader.read().seq, reader.read().bay) == (n, bay)
    assert attachable() == []


def test_a_half_written_slot_is_never_shown(shared: Shared) -> None:
    """The writer died, or is paused, while it filled the slot that is not pointed to."""
    writer, reader = shared
    for seq in (1, 2):
        writer.write(numbered(seq))
        other = shared_state._HEAD.size + (seq + 1 & 1) * shared_state._SLOT_SIZE
        with path_of("line1", "bay1").open("r+b") as file:
            file.seek(other)
            file.write(b"\xaa" * 30)
        assert reader.read().seq == seq


def test_a_complete_slot_that_is_not_yet_pointed_to_is_not_shown(shared: Shared) -> None:
    """While the reader reads the count and the slot, one write is made, and most of another one."""

    class Overtaken:
        def __init__(self, memory: mmap.mmap, meanwhile: list[Callable[[], None]]) -> None:
            self.memory, self.meanwhile = memory, meanwhile

        def __getitem__(self, where: slice) -> bytes:
            found = self.memory[where]
            if self.meanwhile:
                self.meanwhile.pop()()
            return found

        def close(self) -> None:
            self.memory.close()

    writer, reader = shared
    writer.write(numbered(1))

    def nearly_twice() -> None:
        writer.write(numbered(2))
        writer.write(numbered(3))
        writer._map[shared_state._COUNT_AT : shared_state._HEAD.size] = shared_state._COUNT.pack(2)

    reader._map = cast("mmap.mmap", Overtaken(reader._map, [nearly_twice]))
    assert [reader.read().seq, reader.read().seq] == [2, 2]


# Other processes.

READER = """
torn = backwards = failed = reads = last = 0
with SharedStateReader("line1", "bay1") as reader:
    reader.read()
    print("ready", flush=True)
    while last < 20_000 or reads < 5_000:
        try:
            x = reader.read()
        except LinkError:
            failed += 1
            continue
        n = x.seq
        found = (x.t_ns, x.t_vision_ns, x.t_range_ns, x.frame_id, x.u_px, x.v_px, x.radius_px, x.distance_mm)
        torn += found != (3 * n, 5 * n, -n, 7 * n, n + 0.25, n + 0.5, n + 0.75, 2.5 * n)
        torn += x.z_vision_mm != 1.5 * n
        backwards += n < last
        last = n
        reads += 1
print(json.dumps([reads, torn, backwards, failed, last]), flush=True)
"""


@pytest.mark.one_interpreter
def test_no_torn_vector_while_the_writer_writes_as_fast_as_it_can(own_folder: Path) -> None:
    with SharedStateWriter("line1", "bay1") as writer:
        writer.write(numbered(1))
        with other_process(own_folder, READER) as process:
            seq = 1
            assert process.stdout is not None
            while not select.select([process.stdout], [], [], 0)[0]:
                for _ in range(100):
                    seq += 1
                    writer.write(numbered(seq))
            reads, torn, backwards, failed, last = json.loads(process.stdout.readline())

    assert (torn, backwards, failed) == (0, 0, 0)
    assert reads >= 5_000
    assert 20_000 <= last <= seq


@pytest.mark.one_interpreter
@pytest.mark.failure_mode("G11")
def test_a_gateway_in_another_process(own_folder: Path) -> None:
    """It keeps others of its instance out; stopped, it is alive; killed, it is dead, even while its children live."""
    path = path_of("line1", "bay1")
    with other_process(own_folder, WRITER) as process, SharedStateReader("line1", "bay1") as reader:
        assert process.stdout is not None
        child = int(process.stdout.readline())
        try:
            for bay in ("bay1", "north"):  # even where its bays have other names
                with pytest.raises(ConfigError) as caught, SharedStateWriter("line1", bay):
                    pass
                assert str(caught.value) == (
                    f'a gateway with instance = "line1" is already running (process {process.pid});'
                    " give this one another `instance`"
                )
            with SharedStateWriter("line2", "bay1"):
                pass
            assert attachable() == [("line1", "bay1")]
            process.send_signal(signal.SIGSTOP)  # a debugger's stop: its state's age shows that, not its lock
            assert (reader.read().t_ns, reader.read().pid) == (7, process.pid)

            process.send_signal(signal.SIGKILL)
            process.wait()
            with pytest.raises(LinkError, match="the gateway that wrote this state is dead"):
                reader.read()
            assert path.exists()
            assert attachable() == []
            with SharedStateWriter("line2", "bay9"):
                assert not path.exists()  # the next gateway removes it, whatever its name
            with SharedStateWriter("line1", "bay1") as writer:
                writer.write(numbered(3))
                with pytest.raises(LinkError):  # still attached to the file of the killed one
                    reader.read()
                with SharedStateReader("line1", "bay1") as again:
                    assert (again.read().seq, again.read().pid) == (3, os.getpid())
        finally:
            os.kill(child, signal.SIGKILL)


def test_a_file_of_the_same_instance_that_names_no_process_yet_is_no_conflict(own_folder: Path) -> None:
    with path_of("line1", "north").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with SharedStateWriter("line1", "bay1"):
            pass


@contextlib.contextmanager
def locked_for_a_moment(path: Path, lock: int) -> Iterator[None]:
    """Another process holds a lock on `path` for 50 ms."""
    holder = os.open(path, os.O_RDONLY)
    fcntl.flock(holder, lock)
    timer = threading.Timer(0.05, os.close, [holder])
    timer.start()
    yield
    timer.join()


def test_an_abandoned_file_of_the_same_instance_that_another_gateway_removes_is_no_conflict() -> None:
    with SharedStateWriter("line1", "north"):
        abandoned = path_of("line1", "north").read_bytes()
    abandoned = abandoned.replace(os.getpid().to_bytes(4, sys.byteorder), b"\1\0\0\0", 1)
    path_of("line1", "north").write_bytes(abandoned)
    with locked_for_a_moment(path_of("line1", "north"), fcntl.LOCK_EX), SharedStateWriter("line1", "bay1"):
        pass


def test_one_bay_twice_in_one_process_is_refused() -> None:
    with SharedStateWriter("line1", "bay1"), pytest.raises(ConfigError, match=f"process {os.getpid()}"):
        SharedStateWriter("line1", "bay1").__enter__()


@pytest.mark.parametrize("lock", [fcntl.LOCK_SH, fcntl.LOCK_EX])
def test_a_moment_s_lock_of_another_does_not_keep_a_writer_out(lock: int) -> None:
    """A reader that checks (shared), or a starting gateway (exclusive), holds an abandoned file's lock briefly."""
    path_of("line1", "bay1").touch()
    with (
        locked_for_a_moment(path_of("line1", "bay1"), lock),
        SharedStateWriter("line1", "bay1") as writer,
        SharedStateReader("line1", "bay1") as reader,
    ):
        writer.write(numbered(4))
        assert reader.read().seq == 4


# Races of starting gateways, made to happen.


def at_first_lock(monkeypatch: pytest.MonkeyPatch, path: Path, what: Callable[[], object]) -> None:
    """Let `what` happen between opening `path` and locking it."""
    flock, pending = fcntl.flock, [what]

    def slow_flock(fd: int, operation: int) -> None:
        if pending and path.exists() and os.path.samestat(os.fstat(fd), path.stat()):
            pending.pop()()
        flock(fd, operation)

    monkeypatch.setattr(fcntl, "flock", slow_flock)


def test_a_slow_sweep_does_not_remove_a_newer_writer_s_file(own_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = path_of("line1", "bay1")
    path.touch()

    def sweep_and_start() -> None:
        path.unlink()
        (own_folder / "new").touch()  # another inode for sure: the old one is still open
        (own_folder / "new").rename(path)

    at_first_lock(monkeypatch, path, sweep_and_start)
    with SharedStateWriter("line2", "bay2"):
        assert path.exists()


def test_a_writer_does_not_use_a_file_that_was_removed_before_it_was_locked(
    own_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = path_of("line1", "bay1")
    at_first_lock(monkeypatch, path, path.unlink)
    with SharedStateWriter("line1", "bay1") as writer, SharedStateReader("line1", "bay1") as reader:
        writer.write(numbered(5))
        assert reader.read().seq == 5


def test_an_abandoned_file_may_vanish_during_the_sweep(own_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    abandoned = path_of("line0", "bay1")
    abandoned.touch()
    monkeypatch.setattr(Path, "glob", lambda *_: iter([own_folder / "loading-gateway.gone.x", abandoned]))
    with SharedStateWriter("line1", "bay1"):
        assert not abandoned.exists()


def test_the_last_state_in_an_abandoned_file_that_is_reused_is_not_shown(
    own_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A gateway killed between our sweep and our claim: its last state must not look like ours."""
    path = path_of("line1", "bay1")
    with SharedStateWriter("line1", "bay1") as writer:
        for seq in (1, 2, 3):
            writer.write(numbered(seq))
        abandoned = path.read_bytes()
    path.write_bytes(abandoned)
    monkeypatch.setattr(shared_state, "_sweep", lambda: None)
    with SharedStateWriter("line1", "bay1") as writer, SharedStateReader("line1", "bay1") as reader:
        with pytest.raises(LinkError, match="no complete state"):
            reader.read()
        writer.write(numbered(9))
        assert reader.read().seq == 9


def test_leaving_does_not_remove_the_file_of_another(own_folder: Path) -> None:
    path = path_of("line1", "bay1")
    with SharedStateWriter("line1", "bay1"):
        path.unlink()  # somebody tidied up by hand,
        path.write_bytes(b"another")  # and another gateway has started since
    assert path.read_bytes() == b"another"


def test_leaving_removes_the_file_if_it_is_there(own_folder: Path) -> None:
    with SharedStateWriter("line1", "bay1"):
        assert [p.name for p in own_folder.iterdir()] == ["loading-gateway.line1.bay1"]
    assert list(own_folder.iterdir()) == []
    with SharedStateWriter("line1", "bay1"):
        path_of("line1", "bay1").unlink()


# What the machine may refuse.


def test_the_abandoned_file_of_another_user_stays(own_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    abandoned = path_of("line0", "bay1")
    abandoned.touch()

    def forbidden(self: Path, missing_ok: bool = False) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted", str(self))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", forbidden)
        writer = SharedStateWriter("line1", "bay1").__enter__()
    writer.__exit__(None, None, None)
    assert abandoned.exists()


def test_a_name_that_is_another_user_s_is_a_config_error(own_folder: Path) -> None:
    path_of("line1", "bay1").mkdir()  # cannot be opened for writing by anybody, root included

    with pytest.raises(ConfigError, match=r"loading-gateway\.line1\.bay1: cannot be opened for the shared state"):
        SharedStateWriter("line1", "bay1").__enter__()


def test_a_full_memory_disk_is_a_config_error_and_not_a_sigbus_later(
    own_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "posix_fallocate", full)
        with pytest.raises(ConfigError, match=r"no room for the shared state: .*No space left"):
            SharedStateWriter("line1", "bay1").__enter__()
    with SharedStateWriter("line1", "bay1"):  # nothing of the failed try is in the way
        pass


# What a reader may find.


def test_no_gateway_shares_that_state() -> None:
    with pytest.raises(LinkError, match=r"no gateway shares a state for 'line1\.bay1'"):
        SharedStateReader("line1", "bay1").__enter__()


def test_nothing_has_been_written_yet(shared: Shared) -> None:
    with pytest.raises(LinkError, match="no complete state could be read"):
        shared[1].read()


SLOT_SIZE = shared_state._SLOT_SIZE.to_bytes(4, "little")


@pytest.mark.parametrize(
    "content", [b"", b"x" * 20, b"LOADBAY0" + SLOT_SIZE + bytes(400), b"LOADBAY1" + b"\1\0\0\0" + bytes(400)]
)
def test_a_file_that_is_no_vector_of_ours(content: bytes) -> None:
    path_of("line1", "bay1").write_bytes(content)

    with pytest.raises(LinkError, match="not a state vector of this version"):
        SharedStateReader("line1", "bay1").__enter__()


def test_damage_in_both_slots_is_no_value(shared: Shared) -> None:
    writer, reader = shared
    writer.write(numbered(1))
    with path_of("line1", "bay1").open("r+b") as file:
        file.seek(shared_state._HEAD.size)
        file.write(b"\xff" * 2 * shared_state._SLOT_SIZE)
    with pytest.raises(LinkError, match="no complete state could be read"):
        reader.read()


def test_a_reason_that_only_a_later_version_knows(shared: Shared) -> None:
    writer, reader = shared
    writer.write(replace(numbered(1), reason=60))  # type: ignore[arg-type]  # not a Reason of this version
    with pytest.raises(LinkError, match="not a state vector of this version: 60 is not a valid Reason"):
        reader.read()
    assert reader.read(later=True).reason == 60


def test_a_writer_that_has_left_is_dead() -> None:
    with contextlib.ExitStack() as stack:
        with SharedStateWriter("line1", "bay1") as writer:
            writer.write(numbered(1))
            reader = stack.enter_context(SharedStateReader("line1", "bay1"))
        with pytest.raises(LinkError, match="dead"):
            reader.read()


# Where.


def test_only_live_vectors_are_offered(own_folder: Path) -> None:
    for name in ("loading-gateway.dead.bay1", "loading-gateway.odd", "other.line1.bay1"):
        (own_folder / name).touch()

    assert attachable() == []
    with SharedStateWriter("line1", "bay1"):
        assert attachable() == [("line1", "bay1")]


def test_the_folder_is_memory_where_there_is_some(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.undo()
    assert shared_state.folder() == Path("/dev/shm")
    monkeypatch.setattr(Path, "is_dir", lambda _: False)
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path))
    assert shared_state.folder() == tmp_path
    assert path_of("line1", "bay1") == tmp_path / "loading-gateway.line1.bay1"


def test_a_pipe_or_a_link_in_the_folder_blocks_nothing(own_folder: Path) -> None:
    """Opening a pipe would wait for its writer for ever: at the start, and in `gateway state`."""
    os.mkfifo(path_of("other", "bay1"))
    path_of("other", "bay2").symlink_to("/dev/zero")
    done = threading.Event()

    def use() -> None:
        assert attachable() == []
        for bay in ("bay1", "bay2"):
            with pytest.raises(LinkError), SharedStateReader("other", bay):
                pass
        with SharedStateWriter("main", "bay1") as writer:
            writer.write(StateVector(bay="bay1"))
            assert attachable() == [("main", "bay1")]
        done.set()

    threading.Thread(target=use, daemon=True).start()
    assert done.wait(30)


def test_the_file_of_another_is_neither_used_nor_written_through(own_folder: Path) -> None:
    victim = own_folder / "victim"
    victim.write_text("precious")
    path_of("main", "bay1").symlink_to(victim)
    with pytest.raises(ConfigError, match="cannot be opened"), SharedStateWriter("main", "bay1"):
        pass
    assert victim.read_text() == "precious"

    os.mkfifo(path_of("main", "bay2"))
    with pytest.raises(ConfigError, match="no file of ours; remove it"), SharedStateWriter("main", "bay2"):
        pass
