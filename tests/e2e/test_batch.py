"""Many recordings replayed by processes and by a real Dask cluster, of which some are killed: the same to the byte."""

import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import psutil
import pytest

from tests.e2e.processes import Done, command
from tests.recorded_bay import CONFIG, Recorded, with_visits
from tests.visit_bench import Bench, truck

PLC = '[modbus]\nwrites = true\nplc_addresses = ["10.0.0.9"]\nhandshake = { heartbeat_required = false }\n'
DASK = str(Path(sys.executable).with_name("dask"))
DEADLINE_S = 60
pytestmark = pytest.mark.xdist_group("batch")


@pytest.fixture(scope="module")
def plants(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two gateways' recordings, of five and of three segments of 10 s, and other rules."""
    folder = tmp_path_factory.mktemp("plants")
    kept = Recorded(folder)
    legs = [{"distance_cm": cm, "speed_cm_s": 60, "hold_s": 8} for _ in range(2) for cm in (28, 390)]
    bench = Bench(truck(*legs), CONFIG)
    with_visits(kept, bench)
    while bench.t_s < 50:
        begin_ns = bench.now_ns
        bench.run(bench.t_s + 10)
        kept.write(begin_ns)
        kept.collector.begin()
    second = folder / "hall.gateway" / "bay1"
    second.mkdir(parents=True)
    for path in sorted(kept.path.iterdir())[2:]:
        shutil.copy(path, second)
    (folder / "other.toml").write_text(f"[fusion]\nradius_threshold_px = 160\n{PLC}")
    return folder


@pytest.fixture(scope="module")
def expected(plants: Path) -> Done:
    done = command("replay", *asked(plants), "--jobs", "1")
    said = json.loads(done.out)
    assert (done.code, said["recordings"], len(said["trucks"])) == (1, 2, 3)
    assert {row["recording"] for row in said["trucks"]} == {
        str(plants / f"{name}.gateway" / "bay1") for name in ("hall", "site")
    }
    return done


def asked(plants: Path) -> tuple[str, ...]:
    return str(plants), "--against", str(plants / "other.toml"), "--json"


def awaited(condition: Callable[[], bool], process: "subprocess.Popen[bytes]") -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)


@contextmanager
def running(*line: str) -> Iterator["subprocess.Popen[bytes]"]:
    process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def replay(plants: Path, *more: str) -> list[str]:
    return [sys.executable, "-m", "gateway", "replay", *asked(plants), *more]


def files(results: Path) -> list[Path]:
    return [path for path in results.rglob("*") if path.is_file() and path.suffix != ".new"]


def test_killed_processes_cost_their_segments_and_a_second_run_takes_what_is_there(
    plants: Path, expected: Done, tmp_path: Path
) -> None:
    with running(*replay(plants, "--jobs", "2", "--results", str(tmp_path / "results"))) as process:
        workers: list[psutil.Process] = []

        def begun() -> bool:
            workers[:] = [each for each in psutil.Process(process.pid).children() if each.name() == "gw-batch"]
            return bool(workers)

        awaited(begun, process)
        workers[0].kill()
        out, err = process.communicate(timeout=DEADLINE_S)
    assert b"another one does its task" in err
    assert (process.returncode, out.decode()) == (expected.code, expected.out)
    known = {path: path.stat().st_mtime_ns for path in files(tmp_path / "results")}
    damaged = min(known)
    damaged.write_bytes(damaged.read_bytes()[:-1])
    again = command("replay", *asked(plants), "--jobs", "1", "--results", str(tmp_path / "results"))
    assert again.out == expected.out
    now = {path: path.stat().st_mtime_ns for path in files(tmp_path / "results")}
    assert now.keys() == known.keys()
    assert {path for path in now if now[path] != known[path]} <= {damaged}


@pytest.mark.long
def test_a_killed_worker_of_a_dask_cluster_costs_its_segment(plants: Path, expected: Done, tmp_path: Path) -> None:
    about, results = tmp_path / "scheduler.json", tmp_path / "results"
    with ExitStack() as stack:
        scheduler = stack.enter_context(
            running(
                DASK,
                "scheduler",
                "--host",
                "127.0.0.1",
                "--port",
                "0",
                "--no-dashboard",
                "--scheduler-file",
                str(about),
            )
        )
        awaited(about.exists, scheduler)
        worker = (
            DASK,
            "worker",
            "--host",
            "127.0.0.1",
            "--scheduler-file",
            str(about),
            "--nthreads",
            "1",
            "--no-nanny",
            "--no-dashboard",
        )
        first, _ = (stack.enter_context(running(*worker, "--local-directory", str(tmp_path / name))) for name in "ab")
        awaited(lambda: bool(list(tmp_path.glob("a/**/worker-*"))), first)
        awaited(lambda: bool(list(tmp_path.glob("b/**/worker-*"))), first)
        address = json.loads(about.read_text())["address"]
        process = stack.enter_context(running(*replay(plants, "--dask", address, "--results", str(results))))
        awaited(lambda: bool(files(results)), process)
        first.send_signal(signal.SIGKILL)
        out, err = process.communicate(timeout=DEADLINE_S)
        assert (process.returncode, out.decode()) == (expected.code, expected.out), err.decode()
    assert len(files(results)) >= 8


@pytest.mark.long
def test_no_scheduler_is_said_in_a_line(plants: Path, tmp_path: Path) -> None:
    done = command("replay", *asked(plants), "--dask", "tcp://127.0.0.1:1", "--results", str(tmp_path))
    assert done.code == 1
    assert done.err.startswith("gateway replay: --dask tcp://127.0.0.1:1: ")
    done = command("replay", *asked(plants), "--dask", "tcp://127.0.0.1:1")
    assert (done.code, done.err) == (2, "--dask needs --results FOLDER, one that all workers see under this path\n")
