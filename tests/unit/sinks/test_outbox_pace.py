"""How often the outbox's file is written: seldom where the broker acknowledges, bounded where it does not."""

import shutil
import sqlite3
import time
from collections.abc import Collection, Iterator
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest

from gateway.shared_state import folder
from gateway.sinks.outbox import durable, pace
from gateway.sinks.outbox.durable import DurableOutbox
from gateway.sinks.outbox.outbox import OutboxEntry, OutboxLimits
from gateway.sinks.outbox.pace import AT_ONCE, DELAY_S, PERIOD_S, WRITES, WritePace
from gateway.sinks.outbox.store import EventFile

S = 10**9


@pytest.fixture
def name() -> Iterator[str]:
    name = f"test-{uuid4().hex}"
    yield name
    shutil.rmtree(folder() / f"loading-gateway-journal.{name}", ignore_errors=True)


def entry(number: int) -> OutboxEntry:
    return OutboxEntry(f"b-{number}", "t", b"x" * 100, False)


class Counted(EventFile):
    """Each write: how many entries were added and removed."""

    writes: list[tuple[int, int]]

    def __init__(self, path: Path) -> None:
        self.writes = []
        super().__init__(path)

    def write(self, added: Collection[OutboxEntry], removed: Collection[str], **how: Any) -> None:
        self.writes.append((len(added), len(removed)))
        super().write(added, removed, **how)


class Files:
    def __call__(self, path: Path) -> EventFile:
        self.file = Counted(path)
        return self.file


def written(begins_s: list[float], *, until_s: float) -> list[float]:
    """When a change at each of these times is written, by the pace alone; 10 ms apart at least."""
    kept, waiting, done, now = WritePace(), list(begins_s), list[float](), 0.0
    while now < until_s:
        due = [t for t in waiting if t <= now]
        if due:
            wait_s = kept.wait_s(round(due[0] * S), round(now * S))
            if wait_s == 0:
                waiting = waiting[len(due) :]
                kept.wrote()
                done.append(now)
        now = round(now + 0.01, 2)
    return done


def test_a_change_is_written_a_quarter_of_a_second_later_with_those_that_follow() -> None:
    assert written([1.0, 1.1, 1.24], until_s=3) == [1.25]
    assert written([1.0, 1.26], until_s=3) == [1.25, 1.51]


def test_what_never_ends_is_written_every_five_seconds_after_forty_writes() -> None:
    done = written([n / 10 for n in range(1200)], until_s=120)
    begins, later = done[:WRITES], [b - a for a, b in pairwise(done[WRITES + 5 :])]
    assert len(later) > 10
    assert begins[-1] < WRITES * (DELAY_S + 0.1)
    assert all(step == pytest.approx(PERIOD_S, abs=0.05) for step in later)
    assert len(done) < WRITES + 120 / PERIOD_S + 1


def test_after_a_while_of_silence_it_is_quick_again() -> None:
    kept = WritePace()
    for n in range(WRITES):
        assert kept.wait_s(0, S + n) == 0
        kept.wrote()
    assert kept.wait_s(0, S + WRITES) == pytest.approx(PERIOD_S, abs=1e-3)
    assert kept.wait_s(0, S + 3 * S) == pytest.approx(PERIOD_S - 3, abs=1e-3)
    assert kept.wait_s(0, round((2 + PERIOD_S) * S)) == 0
    for _ in range(3):
        kept.wrote()
    assert kept.wait_s(0, round(1000 * S)) == 0
    for _ in range(WRITES - 1):
        kept.wrote()
    assert kept.wait_s(0, round(1000 * S)) == 0, "as many as at the beginning"
    kept.wrote()
    assert kept.wait_s(0, round(1000 * S)) == pytest.approx(PERIOD_S)


def test_what_is_acknowledged_in_time_never_goes_to_the_disk(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pace, "DELAY_S", 30.0)  # whatever the machine does meanwhile
    files = Files()
    with DurableOutbox(name, tmp_path / "outbox.sqlite", OutboxLimits(100), open_file=files) as outbox:
        for number in range(50):
            outbox.put(entry(number))
            assert outbox.store.unwritten == 1
            outbox.acknowledge(f"b-{number}")
        time.sleep(0.05)
        assert (files.file.writes, outbox.store.unwritten) == ([], 0)
        outbox.put(entry(60))
    assert files.file.writes == [(1, 0)], "at the end at once"


def test_so_many_wait_for_nothing(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pace, "DELAY_S", 1000.0)
    assert AT_ONCE < durable.JOURNAL_EVENTS
    files = Files()
    with DurableOutbox(name, tmp_path / "outbox.sqlite", OutboxLimits(1000), open_file=files) as outbox:
        for number in range(AT_ONCE - 1):
            outbox.put(entry(number))
        time.sleep(0.05)
        assert files.file.writes == []
        outbox.put(entry(AT_ONCE))
        deadline = time.monotonic() + 20
        while outbox.store.unwritten and time.monotonic() < deadline:
            time.sleep(0.005)
        assert files.file.writes == [(AT_ONCE, 0)]
        with closing(sqlite3.connect(tmp_path / "outbox.sqlite")) as db, db:
            assert db.execute("SELECT COUNT(*) FROM events").fetchone() == (AT_ONCE,)
        db.close()
