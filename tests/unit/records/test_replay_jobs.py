"""A recording replayed in tasks: what is kept of one run is taken by another only where it is the same."""

from contextlib import closing
from pathlib import Path

import msgspec
import pytest

from gateway.processes.batch import ThisProcess
from gateway.records import replay_jobs
from gateway.records.recorder_service import decides
from gateway.records.replay_portions import Portion, ReplayRules
from tests.recorded_bay import CONFIG, Recorded
from tests.visit_bench import Bench, gateway, truck

pytestmark = pytest.mark.one_interpreter
NEVER = ReplayRules(decides(gateway(fusion={"radius_threshold_px": 280.0})), None)


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A truck that arrives and stands at the mark from some 8 s on, in four segments of 5 s."""
    kept = Recorded(tmp_path_factory.mktemp("visit"))
    bench = Bench(truck({"distance_cm": 28, "speed_cm_s": 60, "hold_s": 20}), CONFIG, record=kept.collector)
    found = []
    for _ in range(4):
        begin_ns = bench.now_ns
        bench.run(bench.t_s + 5)
        found.append(kept.write(begin_ns))
        kept.collector.begin()
    return found


def replayed(rules: ReplayRules, paths: list[Path], results: Path, count: int = 1) -> Portion:
    with closing(ThisProcess(replay_jobs.__name__)) as workers:
        (found,) = replay_jobs.found_by(rules, [paths], str(results), workers, count)
    return found


def test_a_part_that_begins_in_the_middle_is_taken_only_from_where_it_is_the_same(
    paths: list[Path], tmp_path: Path
) -> None:
    whole = replayed(NEVER, paths, tmp_path / "one")
    assert replayed(NEVER, paths, tmp_path / "two", count=2) == whole
    (begin_ns, end_ns, row), *_ = reversed(whole.intervals)
    assert "may_move 0 -> 1" in row["outputs"]
    assert end_ns == whole.last_ns, "it lasts until the end"
    assert end_ns - begin_ns > 10e9, "through the begin of the third segment, too"


def test_other_rules_and_other_bytes_have_results_of_their_own(paths: list[Path], tmp_path: Path) -> None:
    rules = [ReplayRules(None, None), NEVER, msgspec.structs.replace(NEVER, complete=True)]
    rules += [msgspec.structs.replace(NEVER, begin_ns=replayed(NEVER, paths[:1], tmp_path / "first").last_ns)]
    for number, each in enumerate(rules):
        alone = replayed(each, paths, tmp_path / str(number))
        assert replayed(each, paths, tmp_path / "shared") == alone
    cut = tmp_path / paths[1].name
    cut.write_bytes(paths[1].read_bytes()[:-1])
    damaged = [paths[0], cut, *paths[2:]]
    found = replayed(NEVER, damaged, tmp_path / "shared")
    assert len(found.missing) >= 1
    assert found == replayed(NEVER, damaged, tmp_path / "damaged")
