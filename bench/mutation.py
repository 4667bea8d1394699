"""Do the tests of the core notice a fault in it? mutmut plants one fault at a time and runs the tests that reach it.

    python -m bench.mutation [--sample 40] [--seed 0] [--jobs N] [--report FILE] [MODULE ...]

A planted fault is a changed operator, number, argument, condition or returned value in a function of gateway/core or
gateway/modbus/registers. It is killed when a test fails, and it survives when none does. Tables at module level
(registers, meanings) are not changed. The tests are those of `[tool.mutmut]` in pyproject.toml: the core's own.

`--sample` takes so many faults a module at random, the same ones for the same seed; without it, all of them: some
hours. Without MODULE (`fusion`, `interlock`, ...) every module is examined. Each survivor is printed with its change;
`mutmut show NAME` shows it again. The first run measures which test reaches which function, some minutes; the folder
mutants/ keeps that and the results.
"""

import argparse
import json
import os
import random
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from fnmatch import fnmatch
from pathlib import Path

ROOT = Path(__file__).parents[1]
MUTMUT = Path(sys.executable).with_name("mutmut")
PLANTED = ROOT / "mutants"
# mutmut's verdicts by the exit status of a test run; a loop without end is as good as a failed test.
KILLED, SURVIVED, NO_TESTS, TIMEOUT = "killed", "survived", "no test reaches it", "killed by time"
VERDICTS: Mapping[int | None, str] = {
    0: SURVIVED,
    1: KILLED,
    3: KILLED,
    5: NO_TESTS,
    33: NO_TESTS,
    24: TIMEOUT,
    -24: TIMEOUT,
    36: TIMEOUT,
}


def outcomes() -> Mapping[str, int | None]:
    """Every planted fault by mutmut's name, and the exit status of its test run; None: not run yet."""
    found: dict[str, int | None] = {}
    for meta in sorted(PLANTED.rglob("*.meta")):
        found |= json.loads(meta.read_text())["exit_code_by_key"]
    return found


def module_of(name: str) -> str:
    """`gateway.core.fusion.x_step__mutmut_7` -> `core.fusion`."""
    return ".".join(name.split("__mutmut_", maxsplit=1)[0].split(".")[1:-1])


def chosen(names: Sequence[str], modules: Sequence[str], sample: int, seed: int) -> list[str]:
    by_module: dict[str, list[str]] = {}
    for name in names:
        module = module_of(name)
        if not modules or any(fnmatch(module, f"*{one}") for one in modules):
            by_module.setdefault(module, []).append(name)
    chance = random.Random(seed)
    return [
        name
        for module, of_module in sorted(by_module.items())
        for name in sorted(chance.sample(of_module, min(sample, len(of_module))) if sample else of_module)
    ]


def report(names: Sequence[str], codes: Mapping[str, int | None], planted: Mapping[str, int]) -> str:
    """One row a module: how many faults there are, how many were tried, and what became of them."""
    lines = ["| module | faults | tried | killed | survived | score |", "|---|---|---|---|---|---|"]
    by_module: dict[str, Counter[str]] = {}
    for name in names:
        code = codes[name]
        by_module.setdefault(module_of(name), Counter())[VERDICTS.get(code, KILLED) if code is not None else "?"] += 1
    for module, counts in [*sorted(by_module.items()), ("**all**", sum(by_module.values(), Counter()))]:
        tried = counts.total() - counts["?"]
        alive = counts[SURVIVED] + counts[NO_TESTS]
        faults = planted.get(module, sum(planted.values()))
        score = f"{100 * (tried - alive) / tried:.1f} %" if tried else "-"
        lines.append(f"| {module} | {faults} | {tried} | {tried - alive} | {alive} | {score} |")
    return "\n".join(lines)


def mutmut(*args: str) -> str:
    done = subprocess.run([MUTMUT, *args], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"mutmut {args[0]}: {done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.stdout


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("modules", nargs="*", metavar="MODULE", help="fusion, interlock, registers.*, ...")
    parser.add_argument("--sample", type=int, default=0, metavar="N", help="so many faults a module; 0: all")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="test runs at the same time")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the table and the survivors there, too")
    args = parser.parse_args()
    jobs = ("--max-children", str(args.jobs))
    if not outcomes():
        print("planting faults, and measuring which test reaches which function ...", flush=True)
        mutmut("run", *jobs, "gateway.core.shown.*")
    planted = Counter(module_of(name) for name in outcomes())
    names = chosen(list(outcomes()), args.modules, args.sample, args.seed)
    if not names:
        raise SystemExit(f"no module {args.modules}; there are {', '.join(sorted(planted))}")
    for module in dict.fromkeys(map(module_of, names)):
        todo = [name for name in names if module_of(name) == module and outcomes()[name] is None]
        print(f"{module}: {len(todo)} faults to try", flush=True)
        if todo:
            mutmut("run", *jobs, *todo)
    codes = outcomes()
    text = report(names, codes, planted)
    alive = [name for name in names if codes[name] in VERDICTS and VERDICTS[codes[name]] in (SURVIVED, NO_TESTS)]
    for name in alive:
        text += f"\n\n### {name}\n\n```diff\n{mutmut('show', name)}```"
    print(text)
    if args.report:
        args.report.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
