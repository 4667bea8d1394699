"""Compiles every exported structured text with foreign compilers and runs it beside the tree walk: `./dev iec`.

No compiler of IEC 61131-3 comes from the registries that a clean clone may need, so this is no test that runs by
itself (docs/decisions/0006-structured-text-without-a-compiler.md). Whoever has one builds it and says where:

    ./dev iec --strucpp STRUCPP/ --matiec MATIEC/

STRUCPP: a checkout of STruC++ after `npm ci && npm run build`; MATIEC: one of matiec after `make`. Needs node, g++
and gcc.
Ends with 1 where a text is refused, or a compiled program answers one image otherwise than tests/structured_text.py.
"""

import argparse
import random
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gateway.core.plc import TriggerPhase
from gateway.modbus.exports import interface, openplc, structured_text
from gateway.modbus.exports.approach import APPROACH
from gateway.modbus.exports.fields import fields
from gateway.modbus.exports.interface import OUTPUTS
from gateway.modbus.exports.structured_text import FUNCTION_BLOCK
from gateway.modbus.exports.target import Target
from gateway.modbus.registers.register_map import REGISTERS
from tests.plc_images import BAY, answered, block_of, doubtful
from tests.structured_text import Instance, Program

INPUTS = ("EnableRequest", "TruckPresent", "Reset", "Trigger", "Acknowledge", "Release", "SpoutUp", "Start")
IMAGES = 600
Values = list[tuple[int, dict[str, Any]]]
"""(now_ms, input -> value) of each cycle; Words is a list, Data a structure of which some members are given."""


@dataclass(frozen=True)
class Rig:
    """A function block that is run compiled: what each cycle gives it, and which outputs are compared."""

    block: str
    cycles: Values
    shown: tuple[str, ...]


CPP_MAIN = """
#include "program.hpp"
#include <cstdio>
using namespace strucpp;
int main() {{
    {block} fb;
    long long now; double v;
    while (scanf("%lld", &now) == 1) {{
        __CURRENT_TIME_NS = now * 1000000;
        {given}
        fb();
        {show}
        printf("\\n");
    }}
}}
"""
C_MAIN = """
#include "iec_std_lib.h"
#include <stdio.h>
TIME __CURRENT_TIME;
BOOL __DEBUG;
#define __LOCATED_VAR(type, name, ...) static type name##_value; type *name = &name##_value;
#include "LOCATED_VARIABLES.h"
#include "POUS.h"
#include "POUS.c"
int main(void) {{
    static {block} fb; {block}_init__(&fb, 0);
    long long now; double v;
    while (scanf("%lld", &now) == 1) {{
        __CURRENT_TIME.tv_sec = now / 1000; __CURRENT_TIME.tv_nsec = now % 1000 * 1000000;
        {given}
        {block}_body__(&fb);
        {show}
        printf("\\n");
    }}
    return 0;
}}
"""


def texts() -> Iterator[tuple[str, str]]:
    """Every generated structured text: bays, word orders, with OpenPLC's located variables and configuration."""
    for order in ("big", "little"):
        bays = tuple(Target(bay=f"bay{n}", unit_id=n, word_order=order, writes=True) for n in range(1, 4))
        for count in (1, 3):
            yield f"st, {count} bays, {order}", structured_text.document(bays[:count])
            yield f"openplc, {count} bays, {order}", openplc.files(bays[:count])[openplc.PROGRAM]


def gateway_block(program: Program) -> Rig:
    """Images with doubts, gaps and failed polls; then two triggered measurements, one without a result."""
    chance = random.Random(3)
    made: Values = []
    now = 0
    for image in doubtful(IMAGES):
        now += chance.choice((10, 10, 10, 10, 100, 400, 600))
        inputs = {name: chance.random() < 0.3 for name in INPUTS}
        ok, recipe = chance.random() > 0.05, chance.choice((0, 7, 65535))
        made.append((now, {"PollOk": ok, "Words": image, "Recipe": recipe, **inputs}))
    ready: list[dict[str, Any]] = [{}] * 4
    taken = [{"phase": TriggerPhase.ACQUIRING, "number": 1, "ack": True, "control": 8}]
    held = [{"phase": TriggerPhase.VALID, "number": 1}] * 3
    story = [
        *ready,
        *taken,
        *held,
        {"phase": TriggerPhase.CLEARING, "number": 1, "control": 16},
        {"number": 1},
        *ready,
        *taken,
    ]
    block = block_of(program)
    walk(block, made, ())
    for n, how in enumerate([*story, {"number": 2, "timed_out": True}, *ready]):
        now += 20
        asked = dict(zip(INPUTS, (True, True, False, n not in (0, 11), n > 6, False, True, False), strict=True))
        image = answered(100 + n, echo=block["PlcHeartbeat"], **how)
        made.append((now, {"PollOk": True, "Words": image, "Recipe": 1, **asked}))
        walk(block, made[-1:], ())
    known = {"UnitId": BAY.unit_id, "BayIdentity": BAY.number}
    shown = [var.name for var in OUTPUTS if var.name != "Data"] + [f"Data.{field.name}" for field in fields()]
    return Rig(FUNCTION_BLOCK, [(now, given | known) for now, given in made], tuple(shown))


def approach_block() -> Rig:
    """Starts, setpoints, stops and life signs by chance, in every state for a while."""
    chance = random.Random(112)
    made: Values = []
    given: dict[str, Any] = {"CycleMs": 20, "Start": False, "InPlace": False, "ReferenceSpeed": 400.0}
    data = {"heartbeat": 1, "speed_setpoint": 0, "stop": 0, "drive_enable": 1, "reason": 0}
    alive = 0
    for n in range(6000):
        if chance.random() < 0.02:
            given["Start"] = not given["Start"]
        if n % 250 == 0 or chance.random() < 0.004:
            alive, fine = chance.random() < 0.8, chance.random() < 0.8
            given |= {"Alive": alive, "DriveReady": chance.random() < 0.9, "MayMove": fine, "FullScale": 27648}
            data |= {"stop": int(not fine), "drive_enable": int(chance.random() < 0.9)}
            data |= {"speed_setpoint": chance.choice((0, 7, 120, 333, 500)), "reason": chance.choice((0, 1, 4, 13))}
            given["InPlace"] = not fine and chance.random() < 0.3
        data["heartbeat"] = (data["heartbeat"] + (chance.random() < 0.9)) % 65536 if alive else 0
        made.append((20 * (n + 1), {**given, "Data": dict(data)}))
    return Rig(APPROACH.name, made, tuple(var.name for var in APPROACH.outputs))


def walk(block: Instance, made: Values, shown: Sequence[str]) -> list[list[float]]:
    """What the tree walk says."""
    answers = []
    for now, given in made:
        inputs = given | ({"Data": block["Data"] | given["Data"]} if "Data" in given else {})
        block.call(now, **inputs)
        answers.append([float(_member(block, name)) for name in shown])
    return answers


def _member(block: Instance, name: str) -> Any:
    first, _, rest = name.partition(".")
    return block[first][rest] if rest else block[first]


def places(rig: Rig) -> list[tuple[str, int | str | None, str]]:
    """(input, index or member, IEC type) of each number that a cycle gives, in its order."""
    kinds = {var.name: var.kind for var in (*interface.INPUTS, *APPROACH.inputs)}
    members = {field.name: field.kind for field in fields()}
    made: list[tuple[str, int | str | None, str]] = []
    for name, value in rig.cycles[0][1].items():
        if isinstance(value, list):
            made += [(name, n, "WORD") for n in range(len(value))]
        elif isinstance(value, dict):
            made += [(name, member, members[member]) for member in value]
        else:
            made.append((name, None, kinds[name]))
    return made


def numbers(given: dict[str, Any]) -> list[float]:
    """The values of one cycle, in the order of `places`."""
    made: list[float] = []
    for value in given.values():
        made += value if isinstance(value, list) else value.values() if isinstance(value, dict) else [value]
    return [float(one) for one in made]


def strucpp(home: Path, text: str, rig: Rig, folder: Path) -> list[str]:
    """Compiles `text`; the command that runs its function block."""
    source = folder / "program.st"
    source.write_text(text)
    _run(["node", str(home / "dist/node/cli.js"), str(source), "-o", str(folder / "program.cpp")])
    show = " ".join(f'printf("%.9g ", (double)fb.{name.upper()});' for name in rig.shown)
    given = ""
    for name, part, kind in places(rig):
        place = name if part is None else f"{name}[{part}]" if isinstance(part, int) else f"{name}.{part}"
        given += f'scanf("%lf", &v); fb.{place.upper()} = {"v != 0" if kind == "BOOL" else f"({kind}_t)v"};\n'
    (folder / "main.cpp").write_text(CPP_MAIN.format(block=rig.block.upper(), given=given, show=show))
    include = str(home / "src/runtime/include")
    _run(["g++", "-std=c++17", "-O1", "-w", f"-I{include}", "main.cpp", "program.cpp", "-o", "program"], folder)
    return [str(folder / "program")]


def matiec(home: Path, text: str, rig: Rig, folder: Path) -> list[str]:
    """The same by C."""
    source = folder / "program.st"
    source.write_text(text)
    _run([str(home / "iec2c"), "-I", str(home / "lib"), "-T", str(folder), str(source)])
    shown = (name.upper().partition(".") for name in rig.shown)
    show = " ".join(f'printf("%.9g ", (double)fb.{name}.value{dot}{member});' for name, dot, member in shown)
    given = ""
    for name, part, _ in places(rig):
        within = "" if part is None else f".table[{part}]" if isinstance(part, int) else f".{part.upper()}"
        given += f'scanf("%lf", &v); fb.{name.upper()}.value{within} = v;\n'
    (folder / "main.c").write_text(C_MAIN.format(block=rig.block.upper(), given=given, show=show))
    _run(["gcc", "-O1", "-w", f"-I{home / 'lib/C'}", "main.c", "-lm", "-o", "program"], folder)
    return [str(folder / "program")]


def _little(rig: Rig) -> Rig:
    """The same images from a gateway with the other word order."""
    turned: Values = []
    for now, given in rig.cycles:
        words = list(given.get("Words", ()))
        for register in REGISTERS if words else ():
            part = slice(register.address, register.address + register.words)
            words[part] = reversed(words[part])
        turned.append((now, given | ({"Words": words} if words else {})))
    return replace(rig, cycles=turned)


def ran(command: list[str], rig: Rig) -> list[list[float]]:
    lines = (" ".join(map(repr, (now, *numbers(given)))) for now, given in rig.cycles)
    done = _run(command, feed="\n".join(lines) + "\n")
    return [[float(number) for number in line.split()] for line in done.splitlines()]


def _run(command: list[str], where: Path | None = None, feed: str = "") -> str:
    done = subprocess.run(command, cwd=where, input=feed, capture_output=True, text=True, timeout=600, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.stdout


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--strucpp", type=Path, metavar="DIR")
    parser.add_argument("--matiec", type=Path, metavar="DIR")
    args = parser.parse_args()
    compilers: list[tuple[str, Path, Callable[[Path, str, Rig, Path], list[str]]]] = []
    if args.strucpp:
        compilers.append(("STruC++", args.strucpp.resolve(), strucpp))
    if args.matiec:
        compilers.append(("matiec", args.matiec.resolve(), matiec))
    if not compilers:
        parser.error("which compiler? --strucpp DIR, --matiec DIR")
    program = Program(structured_text.declarations((Target(),)))
    wrong = 0
    for rig in (gateway_block(program), approach_block()):
        expected = walk(program.instance(rig.block), rig.cycles, rig.shown)
        for name, home, build in compilers:
            for title, text in texts():
                with tempfile.TemporaryDirectory() as folder:
                    command = build(home, text, rig, Path(folder))
                    answers = ran(command, rig if "big" in title else _little(rig))
                    wrong += _compared(f"{name}: {title}: {rig.block}", rig.shown, expected, answers)
    return int(wrong > 0)


def _compared(title: str, names: Sequence[str], expected: list[list[float]], answers: list[list[float]]) -> int:
    differ = [
        (n, name, mine, theirs)
        for n, (row, answer) in enumerate(zip(expected, answers, strict=True))
        for name, mine, theirs in zip(names, row, answer, strict=True)
        if abs(mine - theirs) > 1e-6 * max(1.0, abs(mine))
    ]
    print(f"{title}: compiled, {len(answers)} cycles, {len(names)} values each: {len(differ)} differ")
    for n, name, mine, theirs in differ[:5]:
        print(f"    cycle {n}: {name} is {theirs:g}, not {mine:g}")
    return len(differ)


if __name__ == "__main__":
    sys.exit(main())
