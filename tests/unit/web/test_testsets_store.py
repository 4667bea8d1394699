"""The folders of test sets: what is kept, what is refused, what is left of a set when something is wrong with it."""

import errno
import json
import os
from pathlib import Path

import pytest

from gateway.processes.answers import NothingError, QuestionRefusedError
from gateway.vision.offline.evaluation import labels
from gateway.web.ipc.testsets import MAX_FILE_BYTES, MAX_PICTURES, MAX_SETS, MarkerPlace, PictureSet
from gateway.web.testsets import store as module
from gateway.web.testsets.store import SetStore
from tests.unit.web.testsets import plain

PLACE = MarkerPlace(20.123, 11.5, 7.0)


@pytest.fixture
def store(tmp_path: Path) -> SetStore:
    made = SetStore(tmp_path / "test-sets" / "plant.gateway", frozenset(("bay1", "bay2")))
    made.make("bay1", "dusk")
    return made


def dusk(store: SetStore) -> PictureSet:
    (found,) = store.sets("bay1")
    return found


def folder(store: SetStore) -> Path:
    return store.folder / "bay1" / "dusk"


def test_labels_are_those_that_evaluate_reads(store: SetStore) -> None:
    first = store.add("bay1", "dusk", "Low sun (7).png", plain())
    second = store.add("bay1", "dusk", "../../etc/passwd", plain())
    third = store.add("bay1", "dusk", "", plain())
    assert (first, second, third) == ("0001-Low-sun-7.png", "0002-etc-passwd.png", "0003-picture.png")
    store.label("bay1", "dusk", first, PLACE)
    store.label("bay1", "dusk", second, None)
    found = labels.load(folder(store))
    assert [(one.file, one.found, one.u, one.v, one.r) for one in found.labels] == [
        (first, True, 20.12, 11.5, 7.0),
        (second, False, None, None, None),
    ]
    assert found.unused_keys == ()
    kept = dusk(store)
    assert [(one.file, one.labelled, one.marker) for one in kept.pictures] == [
        (first, True, MarkerPlace(20.12, 11.5, 7.0)),
        (second, True, None),
        (third, False, None),
    ]
    assert kept.faults == ()
    assert kept.bytes == 3 * len(plain())
    assert SetStore(store.folder, store.bays).sets("bay1") == (kept,)  # after a restart
    assert {path.stat().st_mode & 0o777 for path in folder(store).iterdir()} == {0o600}


def test_a_new_label_replaces_the_old_one_and_keeps_what_else_is_known(store: SetStore) -> None:
    file = store.add("bay1", "dusk", "a", plain())
    line = {"file": file, "found": True, "u": 1, "v": 2, "r": 3, "a": 4, "group": "dusk", "note": "by hand"}
    (folder(store) / "labels.jsonl").write_text(json.dumps(line) + "\n")
    store.label("bay1", "dusk", file, PLACE)
    text = (folder(store) / "labels.jsonl").read_text()
    assert json.loads(text) == {
        "file": file, "found": True, "u": 20.12, "v": 11.5, "r": 7.0, "group": "dusk", "note": "by hand",
    }  # fmt: skip


def test_removing_the_last_picture_leaves_an_empty_set(store: SetStore) -> None:
    file = store.add("bay1", "dusk", "a", plain())
    store.label("bay1", "dusk", file, None)
    store.remove("bay1", "dusk", file)
    assert list(folder(store).iterdir()) == []
    assert dusk(store).pictures == ()
    with pytest.raises(NothingError, match=r"the test set dusk has no picture '0001-a\.png'"):
        store.remove("bay1", "dusk", file)


@pytest.mark.parametrize(
    "name",
    ["", ".", "..", "../bay2", "a/b", "a.b", ".hidden", " a", "a ", "-a", "a\n", "a\0", "x" * 41, "e\u0301", "\ud800"],
)
def test_a_name_can_not_leave_the_folder(store: SetStore, name: str) -> None:
    before = sorted(store.folder.rglob("*"))
    with pytest.raises(QuestionRefusedError, match="is no name for a test set: 1 to 40 letters"):
        store.make("bay1", name)
    with pytest.raises(QuestionRefusedError, match="is no name for a test set"):
        store.rename("bay1", "dusk", name)
    for action in (store.delete, lambda bay, which: store.add(bay, which, "a", plain())):
        with pytest.raises(NothingError, match="bay1 has no test set"):
            action("bay1", name)
    assert sorted(store.folder.rglob("*")) == before


@pytest.mark.parametrize("name", ["x" * 40, "Dämmerung 2", "alacakaranlık", "7", "a-b_c"])
def test_names_of_every_language_are_taken(store: SetStore, name: str) -> None:
    store.make("bay2", name)
    assert [one.name for one in store.sets("bay2")] == [name]


def test_files_outside_of_a_set_are_not_reached(store: SetStore, tmp_path: Path) -> None:
    (tmp_path / "secret.png").write_bytes(plain())
    (folder(store) / "link.png").symlink_to(tmp_path / "secret.png")
    (store.folder / "bay1" / "linked").symlink_to(tmp_path)
    for file in ("link.png", "../dusk/link.png", "/etc/hostname", "../../../../secret.png", "labels.jsonl"):
        with pytest.raises(NothingError, match="has no picture"):
            store.read("bay1", "dusk", file)
        with pytest.raises(NothingError, match="has no picture"):
            store.remove("bay1", "dusk", file)
    assert [one.name for one in store.sets("bay1")] == ["dusk"]
    with pytest.raises(NothingError, match="no bay 'bay3'"):
        store.sets("bay3")
    with pytest.raises(NothingError):
        store.make("../bay1", "a")


def test_limits(store: SetStore, monkeypatch: pytest.MonkeyPatch) -> None:
    for n in range(MAX_SETS - 1):
        store.make("bay1", f"set {n}")
    with pytest.raises(QuestionRefusedError, match="bay1 has 8 test sets already, and may have no more: delete one"):
        store.make("bay1", "one more")
    with pytest.raises(QuestionRefusedError, match="bay1 has a test set dusk already"):
        store.make("bay1", "dusk")
    with pytest.raises(QuestionRefusedError, match="bay1 has a test set dusk already"):
        store.rename("bay1", "set 1", "dusk")
    for n in range(MAX_PICTURES):
        (folder(store) / f"{n}.png").write_bytes(plain())
    with pytest.raises(QuestionRefusedError, match="the test set dusk has 100 pictures already, and may have no more"):
        store.add("bay1", "dusk", "a", plain())
    with pytest.raises(QuestionRefusedError, match="a file of 8388609 bytes: at most 8388608"):
        store.add("bay1", "set 1", "a", plain() + bytes(MAX_FILE_BYTES + 1 - len(plain())))
    with pytest.raises(QuestionRefusedError, match="not a JPEG or PNG picture"):
        store.add("bay1", "set 1", "a.png", b"GIF89a")
    with pytest.raises(QuestionRefusedError, match="a picture of 8 x 8 px: at least 16 px each way"):
        store.add("bay1", "set 1", "a.png", plain(8, 8))
    monkeypatch.setattr(module, "MAX_SET_BYTES", len(plain()) - 1)
    with pytest.raises(QuestionRefusedError, match="the test set set 1 would be larger than"):
        store.add("bay1", "set 1", "a", plain())
    monkeypatch.undo()
    monkeypatch.setattr(module, "ALL_BYTES", 101 * len(plain()) - 1)
    with pytest.raises(QuestionRefusedError, match="all test sets would be larger than"):
        store.add("bay1", "set 1", "a", plain())
    monkeypatch.undo()
    monkeypatch.setattr(module, "FREE_BYTES", 1 << 62)
    with pytest.raises(QuestionRefusedError, match="of the disk would be free"):
        store.add("bay1", "set 1", "a", plain())
    assert list((store.folder / "bay1" / "set 1").iterdir()) == []


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (b'{"file": "0001-a.png", "found": true}\n', "labels.jsonl:1: found is true, but u, v, r is missing"),
        (b"\xff\xfe", "labels.jsonl: not UTF-8 text: invalid start byte at byte 0"),
        (b"[" * 100_000, "labels.jsonl:1: not valid JSON: "),
        (b" " * 200_001, "labels.jsonl: larger than 200000 bytes"),
        (None, "labels.jsonl: cannot be read: "),
    ],
)
def test_damaged_labels_are_reported_and_not_overwritten(store: SetStore, text: bytes | None, fault: str) -> None:
    file = store.add("bay1", "dusk", "a", plain())
    path = folder(store) / "labels.jsonl"
    if text is None:
        path.mkdir()
    else:
        path.write_bytes(text)
    found = dusk(store)
    assert found.faults[0].startswith(fault)
    assert [(one.file, one.labelled) for one in found.pictures] == [(file, False)]
    with pytest.raises(QuestionRefusedError, match="is damaged: mend it, or delete the set"):
        store.label("bay1", "dusk", file, PLACE)
    assert text is None or path.read_bytes() == text


def test_what_does_not_belong_there_is_reported(store: SetStore) -> None:
    file = store.add("bay1", "dusk", "a", plain())
    rows = [{"file": file, "found": False}, {"file": "gone.png", "found": False}, {"file": "sub/a.png", "found": False}]
    (folder(store) / "labels.jsonl").write_text("\n".join(map(json.dumps, rows)))
    (folder(store) / "notes.txt").write_text("by hand")
    os.close(os.open(os.fsencode(folder(store)) + b"/\xff.png", os.O_CREAT))
    (folder(store) / "0002-b.png.new").write_bytes(b"half")  # a power cut
    found = dusk(store)
    assert found.faults == (
        "not part of a test set, and not used: notes.txt, \\udcff.png",
        "no such picture: gone.png, sub/a.png",
    )
    assert [(one.file, one.labelled, one.missing) for one in found.pictures] == [
        (file, True, False),
        ("gone.png", True, True),
    ]
    store.remove("bay1", "dusk", "gone.png")
    assert "gone" not in (folder(store) / "labels.jsonl").read_text()
    with pytest.raises(QuestionRefusedError, match="holds what does not belong to a test set"):
        store.delete("bay1", "dusk")
    assert file in {one.file for one in dusk(store).pictures}
    (folder(store) / "notes.txt").unlink()
    os.unlink(os.fsencode(folder(store)) + b"/\xff.png")
    store.delete("bay1", "dusk")
    assert store.sets("bay1") == ()


def test_the_digest_is_of_what_a_score_depends_on(store: SetStore) -> None:
    digests = [dusk(store).digest]
    file = store.add("bay1", "dusk", "a", plain())
    digests.append(dusk(store).digest)
    store.label("bay1", "dusk", file, PLACE)
    digests.append(dusk(store).digest)
    store.label("bay1", "dusk", file, None)
    digests.append(dusk(store).digest)
    os.utime(folder(store) / file, ns=(1, 1))
    digests.append(dusk(store).digest)
    assert len(set(digests)) == 5
    store.rename("bay1", "dusk", "evening")
    assert dusk(store).digest == digests[-1]


def test_a_full_disk_leaves_everything_as_it_was(store: SetStore, monkeypatch: pytest.MonkeyPatch) -> None:
    file = store.add("bay1", "dusk", "a", plain())
    store.label("bay1", "dusk", file, PLACE)
    before = {path.name: path.read_bytes() for path in folder(store).iterdir()}

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("gateway.files.os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        store.add("bay1", "dusk", "b", plain())
    with pytest.raises(OSError, match="No space left"):
        store.label("bay1", "dusk", file, None)
    monkeypatch.undo()
    assert {path.name: path.read_bytes() for path in folder(store).iterdir() if path.suffix != ".new"} == before
    assert dusk(store).faults == ()
    store.add("bay1", "dusk", "b", plain())
    assert [path.name for path in folder(store).glob("*.new")] == []
