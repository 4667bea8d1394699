"""The process that keeps test sets: what an answer says, and that a change is made to its end."""

import os
from pathlib import Path

import pytest

from gateway.errors import LinkError
from gateway.processes.answers import QuestionRefusedError
from gateway.web.ipc.testsets import BAY_SETS, AddPicture, ListSets, MakeSet
from gateway.web.testsets import process
from gateway.web.testsets.store import SetStore
from tests.unit.web.testsets import plain


@pytest.fixture
def store(tmp_path: Path) -> SetStore:
    made = SetStore(tmp_path, frozenset(("bay1",)))
    made.make("bay1", "dusk")
    return made


def test_a_picture_comes_as_memory(store: SetStore) -> None:
    memory = os.memfd_create("picture")
    os.write(memory, plain())
    told: list[bytes] = []
    process.answer(store, AddPicture("bay1", "dusk", "a.png"), (memory,), told.append)
    os.close(memory)
    (one,) = BAY_SETS.unpacked(told[0]).sets
    assert (one.name, [picture.file for picture in one.pictures]) == ("dusk", ["0001-a.png"])
    with pytest.raises(QuestionRefusedError, match="no picture came with it"):
        process.answer(store, AddPicture("bay1", "dusk", "a.png"), (), told.append)


def test_a_disk_that_refuses_is_named(store: SetStore, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(SetStore, "make", full)
    with pytest.raises(LinkError, match=f"^{store.folder}: No space left on device$"):
        process.answer(store, MakeSet("bay1", "dawn"), (), lambda piece: None)


def test_one_question_after_the_other_and_each_to_its_end(store: SetStore) -> None:
    """A change that is cut off half-way would be told as none."""
    helper = process.sets_helper(store)
    assert helper.at_once == 1
    assert all(kind.to_its_end for kind in helper.kinds.values())
    assert ListSets in helper.kinds
