"""The outbox that survives: what is put is delivered in order, whatever the disk does and whichever process is killed.

Real files and a real SQLite; the faults of the disk are the real ones where a test can make them.
"""

import fcntl
import os
import resource
import shutil
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from uuid import uuid4

import pytest

from gateway.errors import ConfigError
from gateway.shared_state import folder
from gateway.sinks.outbox import durable, store
from gateway.sinks.outbox.durable import DurableOutbox, OutboxJournal
from gateway.sinks.outbox.outbox import OutboxEntry, OutboxLimits
from gateway.sinks.outbox.store import EventFile, StoreError

LIMITS = OutboxLimits(100)


def journal_of(name: str) -> Path:
    return folder() / f"loading-gateway-journal.{name}"


@pytest.fixture
def name() -> Iterator[str]:
    name = f"test-{uuid4().hex}"
    yield name
    shutil.rmtree(journal_of(name), ignore_errors=True)


def entry(number: int, *, drop_last: bool = False, unix_ms: int = 0, size: int = 10) -> OutboxEntry:
    return OutboxEntry(f"b-{number}", "loading/s/bay1/event", bytes([number % 256]) * size, drop_last, unix_ms)


def drained(outbox: DurableOutbox) -> list[str]:
    found = []
    while oldest := next(iter(outbox.batch(1)), None):
        found.append(oldest.id)
        outbox.acknowledge(oldest.id)
    return found


def until(fact: Callable[[], bool], timeout_s: float = 20.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not fact():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def written(outbox: DurableOutbox) -> bool:
    return outbox.store.unwritten == 0 and not outbox.store.fault


def rows(path: Path) -> list[str]:
    with closing(sqlite3.connect(path)) as db, db:
        found = [str(row[0]) for row in db.execute("SELECT id FROM events ORDER BY place")]
    db.close()
    return found


def test_what_was_not_acknowledged_is_there_at_the_next_start_in_order(name: str, tmp_path: Path) -> None:
    path = tmp_path / "deep" / "outbox.sqlite"
    with DurableOutbox(name, path, LIMITS) as outbox:
        for number in range(1, 8):
            outbox.put(entry(number, drop_last=number in (2, 5), unix_ms=number))
        outbox.acknowledge("b-1")
        outbox.acknowledge("b-3")  # before the one that is older
        outbox.acknowledge("b-9")  # none of these
    with DurableOutbox(name, path, LIMITS) as outbox:
        assert outbox.batch(1) == [entry(2, drop_last=True, unix_ms=2)]
        assert (len(outbox), outbox.store.recovered, outbox.dropped) == (5, 5, 0)
        outbox.put(entry(8))
        assert drained(outbox) == ["b-2", "b-4", "b-5", "b-6", "b-7", "b-8"]
        until(lambda: written(outbox) and rows(path) == [])
    assert path.stat().st_mode & 0o077 == 0
    assert not journal_of(name).exists()


class Stuck(EventFile):
    """A disk that takes nothing any more."""

    def write(self, *_: object, **__: object) -> None:
        raise StoreError("the disk is full")


@pytest.mark.failure_mode("Q2")
def test_a_full_disk_is_reported_and_loses_nothing(name: str, tmp_path: Path) -> None:
    """Everything is delivered from memory; whatever the disk did not take the next start finds in the journal."""
    path = tmp_path / "outbox.sqlite"
    with DurableOutbox(name, path, LIMITS, open_file=Stuck) as outbox:
        for number in range(1, 6):
            outbox.put(entry(number))
        until(lambda: outbox.store.fault != "")
        assert (outbox.store.fault, outbox.store.faults) == ("the disk is full", 1)
        assert (len(outbox), outbox.store.unwritten) == (5, 5)
        outbox.acknowledge("b-1")
    with DurableOutbox(name, path, LIMITS) as outbox:
        assert drained(outbox) == ["b-2", "b-3", "b-4", "b-5"]


def test_what_is_on_a_disk_that_takes_nothing_is_delivered_before_what_happens_now(name: str, tmp_path: Path) -> None:
    """A restart after a kill. The kernel itself refuses each write; only for the disk, as memory is a file, too."""
    path, full = tmp_path / "outbox.sqlite", True
    code = (
        "import os, sys\n"
        "from pathlib import Path\n"
        "from gateway.sinks.outbox.store import EventFile\n"
        "from gateway.sinks.outbox.outbox import OutboxEntry\n"
        "file = EventFile(Path(sys.argv[1]))\n"
        "for n in range(1, 21):\n"
        "    file.write([OutboxEntry(f'b-{n}', 'loading/s/bay1/event', b'x', False)], [])\n"
        "os._exit(0)\n"
    )
    subprocess.run([sys.executable, "-c", code, str(path)], check=True)
    path.with_name("outbox.sqlite-shm").unlink()  # as after a power cut, so that it must be made anew

    def opened(where: Path) -> EventFile:
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (0 if full else soft, hard))
        try:
            return EventFile(where)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))

    with DurableOutbox(name, path, LIMITS, open_file=opened) as outbox:
        assert outbox.store.fault != ""
        outbox.put(entry(21))
        assert (outbox.store.recovered, len(outbox), outbox.dropped) == (20, 21, 0)
        for number in (1, 2, 3):
            assert outbox.batch(1)[0].id == f"b-{number}"
            outbox.acknowledge(f"b-{number}")
        full = False
        until(lambda: written(outbox))
        with closing(sqlite3.connect(path)) as db:  # only what differs is written: there may be no room for all
            places = db.execute("SELECT place, id FROM events ORDER BY place").fetchall()
        assert places == [(number, f"b-{number}") for number in range(4, 22)]
    assert not journal_of(name).exists()


@pytest.mark.parametrize("killed", [False, True])
def test_a_file_on_a_full_disk_is_read_where_it_is(
    killed: bool, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Shared memory may have no room for a copy of it: 64 MB in a container."""

    def refused(*_: object) -> list[OutboxEntry]:
        raise StoreError("the disk is full")

    path, copy = tmp_path / "outbox.sqlite", tmp_path / "killed.sqlite"
    with closing(EventFile(path)) as file:
        file.write([entry(1), entry(2)], ())
        for tail in ("", "-wal", "-shm"):
            shutil.copyfile(f"{path}{tail}", f"{copy}{tail}")
    found = copy if killed else path
    there = sorted(one.name for one in tmp_path.iterdir())
    monkeypatch.setattr(durable.OutboxJournal, "copy_of", refused)
    with DurableOutbox(name, found, LIMITS, open_file=refused) as outbox:  # type: ignore[arg-type]  # never opens
        outbox.put(entry(3))
        assert [one.id for one in outbox.batch(9)] == ["b-1", "b-2", "b-3"]
        assert sorted(one.name for one in tmp_path.iterdir()) == there


def test_a_file_that_is_opened_is_not_written(tmp_path: Path) -> None:
    path = tmp_path / "outbox.sqlite"
    with closing(EventFile(path)) as file:
        file.write([entry(1)], ())
    with closing(EventFile(path)) as file:
        assert [found.id for found in file.entries()] == ["b-1"]
        assert path.with_name("outbox.sqlite-wal").stat().st_size == 0


def test_what_neither_disk_nor_journal_has_room_for_is_counted_after_a_restart(name: str, tmp_path: Path) -> None:
    """Changes of stop are the last to go."""
    path, limits, left = tmp_path / "outbox.sqlite", OutboxLimits(10_000), durable.JOURNAL_EVENTS
    with DurableOutbox(name, path, limits, open_file=Stuck) as outbox:
        for number in range(left + 500):
            outbox.put(entry(number, drop_last=number < 30))
        outbox.acknowledge("b-40")  # one of those that a kill would lose
        assert outbox.dropped == 0
    with DurableOutbox(name, path, limits) as outbox:
        assert (outbox.store.recovered, outbox.dropped) == (left, 499)
        expected = [*range(30), *range(530, left + 500)]
        assert [found.id for found in outbox.batch(limits.events)] == [f"b-{number}" for number in expected]
        outbox.put(entry(9999))
    with DurableOutbox(name, path, limits) as outbox:
        assert (len(outbox), outbox.dropped) == (left + 1, 0)


@pytest.mark.long
def test_when_the_disk_can_be_written_again_it_holds_what_memory_holds(name: str, tmp_path: Path) -> None:
    path = tmp_path / "outbox.sqlite"
    full = True

    class Sometimes(EventFile):
        def write(self, *args: object, **kwargs: object) -> None:
            if full:
                raise StoreError("no room")
            super().write(*args, **kwargs)  # type: ignore[arg-type]  # handed through

    with DurableOutbox(name, path, LIMITS, open_file=Sometimes) as outbox:
        outbox.put(entry(1))
        until(lambda: outbox.store.fault == "no room")
        outbox.put(entry(2))
        outbox.acknowledge("b-1")
        full = False
        until(lambda: written(outbox))
        assert rows(path) == ["b-2"]
        outbox.put(entry(3))
        until(lambda: rows(path) == ["b-2", "b-3"])


@pytest.mark.one_interpreter
def test_a_real_limit_of_the_system_is_a_full_disk(name: str, tmp_path: Path) -> None:
    """RLIMIT_FSIZE: the kernel itself refuses the write. The limit is the process's: only the disk's file meets it."""
    code = (
        "import resource, sys, threading, time\n"
        "from pathlib import Path\n"
        "from gateway.sinks.outbox.durable import DurableOutbox\n"
        "from gateway.sinks.outbox.outbox import OutboxEntry, OutboxLimits\n"
        "from gateway.sinks.outbox.store import EventFile\n"
        "all_put = threading.Event()\n"
        "class Small(EventFile):\n"
        "    def write(self, *args, **kwargs):\n"
        "        all_put.wait()\n"
        "        resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, resource.RLIM_INFINITY))\n"
        "        super().write(*args, **kwargs)\n"
        "with DurableOutbox(sys.argv[1], Path(sys.argv[2]), OutboxLimits(1000), open_file=Small) as outbox:\n"
        "    for n in range(60):\n"
        "        outbox.put(OutboxEntry(f'b-{n}', 't', b'x' * 2000, True))\n"
        "    all_put.set()\n"
        "    while not outbox.store.fault:\n"
        "        time.sleep(0.01)\n"
        "    print(len(outbox), outbox.store.faults)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, name, str(tmp_path / "outbox.sqlite")],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (done.returncode, done.stdout) == (0, "60 1\n"), done.stderr
    with DurableOutbox(name, tmp_path / "outbox.sqlite", OutboxLimits(1000)) as outbox:
        assert drained(outbox) == [f"b-{n}" for n in range(60)]


@pytest.mark.mostly_long
@pytest.mark.parametrize(
    "damage", [b"this is no database" * 300, b"SQLite format 3\x00" + b"\xff" * 5000], ids=["text", "pages"]
)
@pytest.mark.failure_mode("Q3")
def test_a_corrupt_file_is_put_aside_and_a_new_one_begun(name: str, tmp_path: Path, damage: bytes) -> None:
    path = tmp_path / "outbox.sqlite"
    for _ in range(6):
        path.write_bytes(damage)
        with DurableOutbox(name, path, LIMITS) as outbox:
            assert outbox.store.fault == ""
            outbox.put(entry(1))
            until(lambda outbox=outbox: written(outbox))  # type: ignore[misc]
            assert rows(path) == ["b-1"]
            assert drained(outbox) == ["b-1"]
    aside = sorted(p.name for p in tmp_path.glob("*.corrupt-*"))
    assert aside == ["outbox.sqlite.corrupt-4", "outbox.sqlite.corrupt-5", "outbox.sqlite.corrupt-6"]


def test_a_file_of_another_layout_is_left_alone(name: str, tmp_path: Path) -> None:
    path = tmp_path / "outbox.sqlite"
    with closing(sqlite3.connect(path)) as db, db:
        db.execute("PRAGMA user_version = 99")
    db.close()
    with DurableOutbox(name, path, LIMITS) as outbox:
        assert "layout 99" in outbox.store.fault
        outbox.put(entry(1))
        assert drained(outbox) == ["b-1"]


def test_a_locked_file_is_reported_and_read_when_it_is_free(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(durable, "FIRST_RETRY_S", 0.01)
    path = tmp_path / "outbox.sqlite"
    with DurableOutbox(name, path, LIMITS) as outbox:
        outbox.put(entry(1))
    with ExitStack() as other:
        file = EventFile(path)
        other.callback(file.close)
        outbox = other.enter_context(DurableOutbox(name, path, LIMITS))
        assert "another gateway uses it" in outbox.store.fault
        outbox.put(entry(2))
        assert outbox.batch(1) == [entry(2)]
        file.close()
        until(lambda: written(outbox))
        assert drained(outbox) == ["b-1", "b-2"]


def test_a_folder_that_cannot_be_written_is_reported(name: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    path = tmp_path / "file" / "outbox.sqlite"
    with DurableOutbox(name, path, LIMITS) as outbox:
        assert str(path) in outbox.store.fault
        outbox.put(entry(1))
        assert drained(outbox) == ["b-1"]


def test_two_gateways_of_one_name_do_not_share_a_journal(name: str, tmp_path: Path) -> None:
    with (
        DurableOutbox(name, tmp_path / "a", LIMITS),
        pytest.raises(ConfigError, match="in use by another gateway"),
        DurableOutbox(name, tmp_path / "b", LIMITS),
    ):
        pass


def test_a_journal_s_folder_that_others_can_write_is_not_used(name: str, tmp_path: Path) -> None:
    """Else they could put SQLite's files of theirs beside ours."""
    journal_of(name).mkdir()
    journal_of(name).chmod(0o777)
    with pytest.raises(ConfigError, match="open to others"), OutboxJournal(name):
        pass
    shutil.rmtree(journal_of(name))
    journal_of(name).symlink_to(tmp_path)
    with pytest.raises(ConfigError, match="belongs to another user"), OutboxJournal(name):
        pass
    journal_of(name).unlink()
    assert list(tmp_path.iterdir()) == []


def test_what_is_dropped_is_dropped_on_disk_too(name: str, tmp_path: Path) -> None:
    path = tmp_path / "outbox.sqlite"
    with DurableOutbox(name, path, OutboxLimits(3)) as outbox:
        for number, precious in ((1, True), (2, False), (3, True), (4, False), (5, True)):
            outbox.put(entry(number, drop_last=precious))
        assert outbox.dropped == 2
        until(lambda: written(outbox) and rows(path) == ["b-1", "b-3", "b-5"])


@pytest.mark.long
def test_what_nobody_has_a_use_for_expires_on_disk_too(name: str, tmp_path: Path) -> None:
    path, now_ms = tmp_path / "outbox.sqlite", 1_795_000_000_000
    with DurableOutbox(name, path, LIMITS) as outbox:
        for number in range(1, 6):
            outbox.put(entry(number, unix_ms=now_ms + number))
        until(lambda: written(outbox))
        outbox.set_unused("loading/s/bay1/event", True)
        assert outbox.count(["loading/s/bay1/event", "none"]) == 5
        outbox.expire("loading/s/bay1/event", 10, now_ms + 13, limit=9)
        assert (outbox.dropped, outbox.unused_dropped) == (0, 2)
        until(lambda: written(outbox) and rows(path) == ["b-3", "b-4", "b-5"])
        assert [e.id for e in outbox.batch(9)] == ["b-3", "b-4", "b-5"]
        assert outbox.batch(9, {"loading/s/bay1/event"}) == []


FLOOD = 3000  # events of 3 kB


@pytest.mark.mostly_long
@pytest.mark.one_interpreter
@pytest.mark.parametrize("older", [False, True], ids=["of this version", "of an older version"])
def test_the_file_is_small_again_after_a_flood(name: str, tmp_path: Path, older: bool) -> None:
    """Also one that an older version has left behind large and empty, where nothing is put any more."""
    path = tmp_path / "outbox.sqlite"

    def size() -> int:
        return sum(file.stat().st_size for file in tmp_path.iterdir())

    if older:
        with closing(EventFile(path)) as file:
            file.write([entry(number, size=3000) for number in range(FLOOD)], ())
            file.write((), [f"b-{number}" for number in range(FLOOD - 1)])
    with DurableOutbox(name, path, OutboxLimits(100_000)) as outbox:
        if not older:
            for number in range(FLOOD):
                outbox.put(entry(number, size=3000))
            until(lambda: written(outbox))
            assert size() > 9_000_000
            for number in range(FLOOD - 1):
                outbox.acknowledge(f"b-{number}")
        # What was made smaller in the midst of the flood keeps what was removed after that.
        until(lambda: size() < 100_000 + (0 if older else store.SPARE_BYTES))
        until(lambda: rows(path) == [f"b-{FLOOD - 1}"])
        outbox.put(entry(FLOOD))
        until(lambda: rows(path) == [f"b-{FLOOD - 1}", f"b-{FLOOD}"])
    assert path.stat().st_mode & 0o077 == 0


def test_a_put_does_not_wait_while_the_file_is_made_smaller(name: str, tmp_path: Path) -> None:
    begun, over = threading.Event(), threading.Event()

    class Slow(EventFile):
        def shrink(self) -> None:
            begun.set()
            assert over.wait(20)

    with DurableOutbox(name, tmp_path / "outbox.sqlite", LIMITS, open_file=Slow) as outbox:
        assert begun.wait(20)
        outbox.put(entry(1))
        outbox.acknowledge("b-1")
        outbox.put(entry(2))
        assert (len(outbox), outbox.store.unwritten) == (1, 1)
        over.set()
        until(lambda: written(outbox))


@pytest.mark.long
def test_a_file_that_cannot_be_made_smaller_loses_nothing_and_is_no_fault(
    name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """On a full disk there may be no room for it."""

    class Full(EventFile):
        def shrink(self) -> None:
            raise StoreError("no room to make it smaller")

    path = tmp_path / "outbox.sqlite"
    with DurableOutbox(name, path, LIMITS, open_file=Full) as outbox:
        for number in range(1, 4):
            outbox.put(entry(number))
            until(lambda: written(outbox))
        assert (outbox.store.fault, outbox.store.faults) == ("", 0)
        assert rows(path) == ["b-1", "b-2", "b-3"]
    assert [record.message for record in caplog.records] == ["no room to make it smaller; it is tried again later"]


@pytest.mark.one_interpreter
def test_killed_at_any_moment_nothing_that_happened_is_lost(name: str, tmp_path: Path) -> None:
    """The child reports an event only after it happened: all that it reported must be there afterwards, in order."""
    code = (
        "import os, sys, time\n"
        "from pathlib import Path\n"
        "from gateway.sinks.outbox.durable import DurableOutbox\n"
        "from gateway.sinks.outbox.outbox import OutboxEntry, OutboxLimits\n"
        "with DurableOutbox(sys.argv[1], Path(sys.argv[2]), OutboxLimits(100_000)) as outbox:\n"
        "    first = int(sys.argv[3])\n"
        "    for n in range(first, first + 10_000):\n"
        "        outbox.put(OutboxEntry(f'b-{n}', 't', b'x' * 1500, True))\n"
        "        os.write(1, b'%d\\n' % n)\n"
        "        time.sleep(0.0005)\n"
        "        for old in outbox.batch(n % 3 == 0):\n"
        "            os.write(1, b'-%s\\n' % old.id.encode())\n"
        "            outbox.acknowledge(old.id)\n"
    )
    path = tmp_path / "outbox.sqlite"
    reported: list[str] = []
    acknowledged: set[str] = set()
    for run in range(6):
        first = 100_000 * (run + 1)
        with subprocess.Popen(
            [sys.executable, "-c", code, name, str(path), str(first)], stdout=subprocess.PIPE, text=True
        ) as child:
            assert child.stdout is not None
            seen = 0
            for line in child.stdout:
                word = line.strip()
                if word.startswith("-"):
                    acknowledged.add(word[1:])
                else:
                    reported.append(f"b-{word}")
                    seen += 1
                if seen == 40 + 37 * run:
                    child.kill()
    with DurableOutbox(name, path, OutboxLimits(100_000)) as outbox:
        found = drained(outbox)
    missing = [one for one in reported if one not in acknowledged and one not in set(found)]
    assert missing == []
    assert found == sorted(found, key=lambda one: int(one[2:]))
    assert len(reported) > 600


def test_the_journal_reads_anything_that_a_dead_gateway_can_leave(name: str) -> None:
    with OutboxJournal(name, events=4) as journal:
        for number in range(1, 6):
            journal.put(entry(number))
        journal.put(entry(9, size=5000))
        assert len(journal) == 6
        journal.release(["b-4", "b-1", "b-none"])
        journal.put(entry(6, size=5000))  # any length
        assert len(journal) == 5
    path = journal_of(name) / "events.sqlite"
    with OutboxJournal(name, events=4) as journal:
        assert [e.id for e in journal.recover()] == ["b-3", "b-5", "b-9", "b-6"]
        assert journal.lost == 1
        journal.release(["b-6"])
        journal.put(entry(7))
    for noise in (os.urandom(16_384), path.read_bytes()[:4096] + os.urandom(8192), b""):
        path.write_bytes(noise)
        with OutboxJournal(name, events=4) as journal:
            assert (journal.recover(), journal.lost) == ([], 0)
            journal.put(entry(8))
            assert len(journal) == 1


def test_only_so_many_corrupt_files_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "x.sqlite"
    for _ in range(12):
        path.write_text("")
        store.put_aside(path)
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"x.sqlite.corrupt-{n}" for n in (10, 11, 12)]


@pytest.mark.mostly_long
@pytest.mark.parametrize(
    "damage",
    [
        "UPDATE events SET payload = 'text' WHERE place = 1",
        "UPDATE events SET payload = 1000000000000 WHERE place = 1",
        "UPDATE events SET unix_ms = 'soon'",
        "UPDATE events SET precious = 1.5",
        "UPDATE events SET topic = CAST(x'ff' AS TEXT)",
        "UPDATE events SET id = CAST(x'c328' AS TEXT) WHERE place = 2",
    ],
)
def test_a_file_with_a_row_that_is_no_event_is_a_corrupt_one(name: str, tmp_path: Path, damage: str) -> None:
    """The database is sound, its content is not: neither a crash at the start nor a fault for ever."""
    path = tmp_path / "outbox.sqlite"
    file = EventFile(path)
    file.write([entry(1), entry(2)], [])
    file.close()
    with closing(sqlite3.connect(path)) as db, db:
        db.execute(damage)
    db.close()

    with DurableOutbox(name, path, LIMITS) as outbox:
        outbox.put(entry(3))
        until(lambda: written(outbox))
        assert outbox.store.fault == ""
    assert rows(path) == ["b-3"]
    assert [p.name for p in tmp_path.glob("*.corrupt-*")] == ["outbox.sqlite.corrupt-1"]


def test_an_event_in_journal_and_file_is_delivered_once_though_the_file_is_opened_late(
    name: str, tmp_path: Path
) -> None:
    path = tmp_path / "outbox.sqlite"
    file = EventFile(path)
    file.write([entry(1), entry(2)], [])
    file.close()
    with OutboxJournal(name) as journal:  # killed after the file had it, before the slot was freed
        journal.put(entry(2))
    away = path.rename(tmp_path / "away")

    def opened(where: Path) -> EventFile:
        if not where.exists():
            raise StoreError("the disk is away")
        return EventFile(where)

    with DurableOutbox(name, path, LIMITS, open_file=opened) as outbox:
        assert drained(outbox) == ["b-2"]
        away.rename(path)
        until(lambda: written(outbox))
        assert drained(outbox) == ["b-1"]


def test_what_the_journal_has_beyond_the_limit_is_dropped_everywhere(name: str, tmp_path: Path) -> None:
    path = tmp_path / "outbox.sqlite"
    with OutboxJournal(name) as journal:
        for number in range(1, 6):
            journal.put(entry(number))

    with DurableOutbox(name, path, OutboxLimits(2)) as outbox:
        until(lambda: written(outbox))
        assert outbox.dropped == 3
    assert rows(path) == ["b-4", "b-5"]


def test_a_journal_removed_while_it_is_being_locked_is_not_used(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else two gateways of one name would run, and what the first one journals would be lost with it."""
    leaving = OutboxJournal(name)
    leaving.__enter__()
    lock, first = fcntl.flock, [True]

    def late(fd: int, how: int) -> None:
        if first.pop() if first else False:
            leaving.__exit__(None, None, None)
        lock(fd, how)

    monkeypatch.setattr(fcntl, "flock", late)
    with OutboxJournal(name), pytest.raises(ConfigError, match="in use by another gateway"), OutboxJournal(name):
        pass
