"""Tasks in chains by processes that die, and results in files."""

from contextlib import closing
from pathlib import Path

import msgspec
import pytest

from gateway import __version__
from gateway.errors import ConfigError, LinkError
from gateway.processes import batch
from gateway.processes.batch import ThisProcess, in_turn, keep, kept, name_of, taken
from gateway.processes.batch_workers import DaskWorkers, LocalWorkers
from gateway.processes.codec import Codec
from tests.unit.processes import batch_stand_in
from tests.unit.processes.batch_stand_in import Say

MODULE = batch_stand_in.__name__
CODEC = Codec(Say)


def said(folder: Path, jobs: int, *chains: str, dies: int = 0) -> tuple[list[list[str]], list[int]]:
    """The results of chains, a letter each, of whose tasks `b` kills its process; and which chains went on."""
    tasks = [[Say(results=str(folder), what=w, dies=dies * (w == "b")) for w in chain] for chain in chains]
    moved: list[int] = []
    with closing(ThisProcess(MODULE) if jobs == 1 else LocalWorkers(MODULE, jobs)) as workers:
        return in_turn(tasks, workers, moved.append), sorted(moved)


@pytest.mark.parametrize(("jobs", "dies"), [(1, 0), (2, 0), (2, 2)])
def test_each_task_of_a_chain_gets_the_result_of_the_one_before_it(tmp_path: Path, jobs: int, dies: int) -> None:
    found = said(tmp_path, jobs, "abc", "d", "ef", dies=dies)
    assert found == ([["a", "ab", "abc"], ["d"], ["e", "ef"]], [0, 0, 0, 1, 2, 2])


def test_a_task_at_which_three_processes_die_ends_all(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match="3 processes have died at the same task"):
        said(tmp_path, 2, "ab", dies=3)


@pytest.mark.parametrize(("what", "error"), [("wrong", ConfigError), ("unread", LinkError)])
def test_what_a_task_raises_is_raised(tmp_path: Path, what: str, error: type[Exception]) -> None:
    chains = [[Say(results=str(tmp_path), what=what)]]
    for workers in (ThisProcess(MODULE), LocalWorkers(MODULE, 2)):
        with closing(workers), pytest.raises(error, match=r"wrong: edit it|nowhere: No such file"):
            in_turn(chains, workers, lambda _: None)


def test_another_version_does_no_task(tmp_path: Path) -> None:
    task = Say(results=str(tmp_path), what="a")
    with pytest.raises(ConfigError, match=rf"has version {__version__}, and 0\.0\.1 asks"):
        batch.answer_elsewhere(MODULE, Codec.packed(task), "0.0.1")
    assert batch.answer_elsewhere(MODULE, Codec.packed(task), __version__) == batch.answer(MODULE, Codec.packed(task))


def test_a_result_is_named_by_all_that_it_depends_on(monkeypatch: pytest.MonkeyPatch) -> None:
    names = {name_of("replay", "a", True), name_of("replay", "b", True), name_of("replay", "a", False)}
    assert len(names) == 3
    assert name_of("replay", "a", True) in names
    monkeypatch.setattr(batch, "__version__", "9.9.9")
    assert name_of("replay", "a", True) not in names


def test_a_result_is_complete_or_not_there(tmp_path: Path) -> None:
    result = Say(results="", what="x" * 100)
    keep(str(tmp_path), "abcd", result)
    keep(str(tmp_path), "abcd", result)
    (path,) = (path for path in tmp_path.rglob("*") if path.is_file())
    assert path == tmp_path / "ab" / "abcd"
    assert taken(str(tmp_path), "abcd", CODEC) == result
    assert kept(str(tmp_path), "other", CODEC) is None
    path.write_bytes(path.read_bytes()[:-1])
    assert kept(str(tmp_path), "abcd", CODEC) is None
    with pytest.raises(LinkError, match="is not there"):
        taken(str(tmp_path), "abcd", CODEC)


def test_dask_is_an_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> object:
        raise ImportError(name)

    monkeypatch.setattr("gateway.processes.batch_workers.import_module", missing)
    with pytest.raises(ConfigError, match=r"plc-loading-gateway\[dask\]"):
        DaskWorkers(MODULE, "tcp://127.0.0.1:1")


def test_a_task_is_plain_data() -> None:
    """What Dask carries for us: names and values, no function."""
    assert msgspec.msgpack.decode(Codec.packed(Say(results="r", what="w"))) == [
        "Say",
        "r",
        "",
        "w",
        0,
    ]
