"""Do the tests of the core notice a fault in it? One fault at a time is planted, and tests run until one fails.

    python -m bench.mutation [--sample 40] [--seed 0] [--complete] [--report FILE] [NAME ...] [--tests FILE ...]
    python -m bench.mutation --with core.fusion.step.7 tests/unit/core/test_fusion.py     # pytest, with that fault

A fault is a changed operator, number, text, argument, condition or returned value in a function of gateway/core or
gateway/modbus/registers, as mutmut makes them. It is noticed when a test fails or does not end, and it survives when
none does. Tables at module level (registers, meanings) and properties are not changed.

`--sample` takes so many faults a module at random, the same ones for the same seed; without it, all of them. NAME:
`core.fusion`, `registers.*`, `core.fusion.step.7`; without it, every module. Each survivor is printed with its change.

The tests run once without a fault, and each fault gets a copy of that process. In it, first those tests run that
noticed the faults before it, then the module's own, then the others, short ones first. Left out are tests that take
longer than SHORT_S, and most random examples. `--complete` shows what survived to the type checker, and tries it once
more in an interpreter of its own, with all tests and all examples: there the fault is in what a module computes while
it is imported, too.
"""

import argparse
import os
import resource
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from fnmatch import fnmatch
from pathlib import Path
from tempfile import NamedTemporaryFile

import pytest

from bench.faults import ROOT, Fault, PlantedImport, chosen, faults_of, modules, path_of, plant, short

# Tests above the core are left out, so that what survives is not noticed by the tests of the core itself.
TESTS = (
    *("tests/unit/core", "tests/unit/test_shown.py", "tests/unit/test_bay.py", "tests/unit/test_bay_writes.py"),
    *(
        f"tests/unit/modbus/test_{name}.py"
        for name in ("bay_unit", "bits", "register", "register_map", "answers", "handshake")
    ),
    *(f"tests/unit/modbus/test_{name}.py" for name in ("situations", "reaction_time")),
)
LONG_FILES = ("tests/unit/core/test_visit_scenarios.py", "tests/unit/core/test_interlock_search.py", TESTS[-1])
SHORT_S = 0.1  # of processor time, for one test
NOT_PLANTED = 9  # exit code
ARGUMENTS = ("-q", "-p", "no:xdist", "-p", "no:cacheprovider")


class Runs:
    """A plugin of pytest: runs the collected tests once, and then for each fault until one of them fails."""

    def __init__(self, faults: Sequence[Fault], jobs: int) -> None:
        self._faults = faults
        self._jobs = jobs
        self._tests: list[pytest.Item] = []
        self._running: dict[int, tuple[Fault | None, list[pytest.Item], int]] = {}  # by process; a pipe: what failed
        self.survivors: list[Fault | None] = []

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        took = self._without_fault(session)
        self._tests = sorted((item for item in session.items if took[item] <= SHORT_S), key=took.__getitem__)
        self._limit_s = 30 + 5 * round(sum(took.values()))
        print(f"\n{len(self._tests)} tests; {len(self._faults)} faults", flush=True)
        self._start(session, None)
        self._collect()
        if not self.survivors:
            raise session.Failed("tests fail without a fault when they run a second time")
        self.survivors.clear()
        for module in dict.fromkeys(fault.module for fault in self._faults):
            own = f"test_{module.rpartition('.')[2]}"
            self._tests.sort(key=lambda item: (own not in item.path.stem, took[item]))
            for fault in (fault for fault in self._faults if fault.module == module):
                if len(self._running) == self._jobs:
                    self._collect()
                self._start(session, fault)
            while self._running:
                self._collect()
        return True

    def _without_fault(self, session: pytest.Session) -> dict[pytest.Item, float]:
        took = {}
        for item, following in zip(session.items, [*session.items[1:], None], strict=True):
            began_s = time.process_time()
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            took[item] = time.process_time() - began_s
        if session.testsfailed:
            raise session.Failed("tests fail without a fault")
        return took

    def _start(self, session: pytest.Session, fault: Fault | None) -> None:
        result, written = os.pipe()
        child = os.fork()
        if child:
            os.close(written)
            self._running[child] = fault, list(self._tests), result
            return
        status = NOT_PLANTED
        try:
            resource.setrlimit(resource.RLIMIT_CPU, (self._limit_s, self._limit_s))
            session.config.pluginmanager.unregister(name="terminalreporter")
            if fault is not None:
                plant(fault)
            status = 1
            for n, (item, following) in enumerate(zip(self._tests, [*self._tests[1:], None], strict=True)):
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
                if session.testsfailed:
                    os.write(written, n.to_bytes(4, "big"))
                    break
            else:
                status = 0
        finally:
            os._exit(status)

    def _collect(self) -> None:
        child, status = os.wait()
        fault, tests, result = self._running.pop(child)
        failed = os.read(result, 4)
        os.close(result)
        if failed:  # most of its neighbours are noticed by the same one
            item = tests[int.from_bytes(failed, "big")]
            self._tests.remove(item)
            self._tests.insert(0, item)
        if os.waitstatus_to_exitcode(status) == NOT_PLANTED:
            raise pytest.UsageError(f"{fault} could not be planted")
        if status == 0:
            self.survivors.append(fault)
            print(f"survived the short tests: {fault.name if fault else 'no fault at all'}", flush=True)


def reported_by_types(fault: Fault) -> bool:
    """Does the type checker, which is part of `./dev check`, report this fault?"""
    path = path_of(fault.module)
    with NamedTemporaryFile("w", suffix=".py", encoding="utf-8") as file:
        file.write(fault.source)
        file.flush()
        command = (sys.executable, "-m", "mypy", "--shadow-file", path, file.name, path)
        return subprocess.run(command, cwd=ROOT, capture_output=True, check=False).returncode != 0


def noticed_completely(fault: Fault, tests: Sequence[str]) -> bool:
    command = (sys.executable, "-m", "bench.mutation", "--with", fault.name, *ARGUMENTS, "-x", *tests)
    return subprocess.run(command, cwd=ROOT, capture_output=True, check=False).returncode != 0


def report(faults: Sequence[Fault], tried: Sequence[Fault], by_types: Sequence[Fault], alive: Sequence[Fault]) -> str:
    """One row a module: how many faults there are, how many were tried, what noticed them; then each survivor."""
    counted = [Counter(short(fault.module) for fault in some) for some in (faults, tried, by_types, alive)]
    lines = [
        "| module | faults | tried | noticed by tests | by types | survived | noticed |",
        "|---|---|---|---|---|---|---|",
    ]
    for module in [*counted[1], "all"]:
        n, m, types, left = (some.total() if module == "all" else some[module] for some in counted)
        lines.append(f"| `{module}` | {n} | {m} | {m - types - left} | {types} | {left} | {1 - left / m:.1%} |")
    changes = [f"\n### {fault.name}\n\n```diff\n{fault.change()}\n```" for fault in alive]
    return "\n".join(lines + changes)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="core.fusion, registers.*, core.fusion.step.7, ...")
    parser.add_argument("--sample", type=int, default=0, metavar="N", help="so many faults a module; 0: all")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="faults tried at the same time")
    parser.add_argument("--tests", nargs="+", default=TESTS, metavar="FILE", help="these instead of the core's")
    parser.add_argument("--complete", action="store_true", help="try what survived once more, with all tests")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the table and the survivors there, too")
    parser.add_argument("--with", nargs=argparse.REMAINDER, metavar="FAULT", help="run pytest with this fault")
    args = parser.parse_args()
    if planted := vars(args)["with"]:
        sys.meta_path.insert(0, PlantedImport(found(planted[:1])[0]))
        raise SystemExit(pytest.main(planted[1:]))
    faults = found(args.names or ["*"])
    tried = chosen(faults, args.sample, args.seed)
    runs = Runs(tried, args.jobs)
    skipped = (f"--ignore={file}" for file in LONG_FILES)
    if pytest.main([*ARGUMENTS, "--hypothesis-profile=brief", *skipped, *args.tests], plugins=[runs]):
        raise SystemExit("the tests must pass without a fault")
    alive, by_types = [fault for fault in runs.survivors if fault is not None], list[Fault]()
    if args.complete:
        print(f"{len(alive)} faults to try with all tests", flush=True)
        by_types = [fault for fault in alive if reported_by_types(fault)]
        alive = [fault for fault in alive if fault not in by_types]
        with ThreadPoolExecutor(args.jobs) as pool:
            verdicts = pool.map(lambda fault: noticed_completely(fault, args.tests), alive)
            alive = [fault for fault, noticed in zip(alive, verdicts, strict=True) if not noticed]
    text = report(faults, tried, by_types, alive)
    print(text)
    if args.report:
        args.report.write_text(text + "\n", encoding="utf-8")


def found(names: Sequence[str]) -> list[Fault]:
    """The faults that one of `names` matches: a module, a function or a fault. Exits where there are none."""
    asked = [
        module
        for module in modules()
        if any(fnmatch(short(module), name) or name.startswith(f"{short(module)}.") for name in names)
    ]
    every = [fault for module in asked for fault in faults_of(module)]
    some = [fault for fault in every if any(fnmatch(f"{fault.name}.", f"{name}.*") for name in names)]
    if not some:
        raise SystemExit(f"no fault {' '.join(names)}; modules: {', '.join(map(short, modules()))}")
    return some


if __name__ == "__main__":
    main()
