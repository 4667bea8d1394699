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
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from gateway.core.plc import TriggerPhase
from gateway.modbus.exports import openplc, structured_text
from gateway.modbus.exports.fields import fields
from gateway.modbus.exports.interface import OUTPUTS
from gateway.modbus.exports.structured_text import FUNCTION_BLOCK
from gateway.modbus.exports.target import Target
from gateway.modbus.registers.register_map import BLOCK_WORDS, REGISTERS
from tests.plc_images import BAY, answered, block_of, doubtful
from tests.structured_text import Instance, Program

INPUTS = ("EnableRequest", "TruckPresent", "Reset", "Trigger", "Acknowledge", "Release", "SpoutUp", "Start")
SHOWN = [var.name for var in OUTPUTS if var.name != "Data"]
MEMBERS = [field.name for field in fields()]
IMAGES = 600
Cycle = tuple[int, bool, list[bool], int, list[int]]
"""now_ms, PollOk, INPUTS, Recipe, Words."""

CPP_MAIN = """
#include "program.hpp"
#include <cstdio>
using namespace strucpp;
int main() {{
    FB_LOADINGGATEWAY fb;
    long long now; int ok, in[{inputs}], recipe, word;
    while (scanf("%lld %d", &now, &ok) == 2) {{
        for (int i = 0; i < {inputs}; i++) scanf("%d", &in[i]);
        scanf("%d", &recipe);
        for (int i = 0; i < {size}; i++) {{ scanf("%d", &word); fb.WORDS[i] = (WORD_t)word; }}
        __CURRENT_TIME_NS = now * 1000000;
        fb.POLLOK = ok != 0; {set_inputs} fb.RECIPE = (UINT_t)recipe;
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
    long long now; int ok, in[{inputs}], recipe, word;
    while (scanf("%lld %d", &now, &ok) == 2) {{
        for (int i = 0; i < {inputs}; i++) scanf("%d", &in[i]);
        scanf("%d", &recipe);
        for (int i = 0; i < {size}; i++) {{ scanf("%d", &word); fb.WORDS.value.table[i] = (WORD)word; }}
        __CURRENT_TIME.tv_sec = now / 1000; __CURRENT_TIME.tv_nsec = now % 1000 * 1000000;
        fb.POLLOK.value = ok; {set_inputs} fb.RECIPE.value = recipe;
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
        bays = tuple(Target(bay=f"bay{n}", unit_id=n, word_order=order, writes=True) for n in range(1, 5))
        for count in (1, 4):
            yield f"st, {count} bays, {order}", structured_text.document(bays[:count])
            yield f"openplc, {count} bays, {order}", openplc.files(bays[:count])[openplc.PROGRAM]


def cycles() -> list[Cycle]:
    """Images with doubts, gaps and failed polls; then two triggered measurements, one without a result."""
    chance = random.Random(3)
    made: list[Cycle] = []
    now = 0
    for image in doubtful(IMAGES):
        now += chance.choice((10, 10, 10, 10, 100, 400, 600))
        inputs = [chance.random() < 0.3 for _ in INPUTS]
        made.append((now, chance.random() > 0.05, inputs, chance.choice((0, 7, 65535)), image))
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
    block = block_of(Program(structured_text.declarations((Target(),))))
    _walk(block, made)
    for n, how in enumerate([*story, {"number": 2, "timed_out": True}, *ready]):
        now += 20
        asked = [True, True, False, n not in (0, 11), n > 6, False, True, False]
        made.append((now, True, asked, 1, answered(100 + n, echo=block["PlcHeartbeat"], **how)))
        _walk(block, made[-1:])
    return made


def walked(made: list[Cycle]) -> list[list[float]]:
    """What the tree walk says."""
    return _walk(block_of(Program(structured_text.declarations((Target(),)))), made)


def _walk(block: Instance, made: list[Cycle]) -> list[list[float]]:
    answers = []
    for now, ok, inputs, recipe, image in made:
        block.call(now, PollOk=ok, Words=image, Recipe=recipe, **dict(zip(INPUTS, inputs, strict=True)))
        answers.append(_row(block))
    return answers


def _row(block: Instance) -> list[float]:
    return [float(block[name]) for name in SHOWN] + [float(block["Data"][name]) for name in MEMBERS]


def strucpp(home: Path, text: str, folder: Path) -> list[str]:
    """Compiles `text`; the command that runs its function block."""
    source = folder / "program.st"
    source.write_text(text)
    _run(["node", str(home / "dist/node/cli.js"), str(source), "-o", str(folder / "program.cpp")])
    show = _show("fb.{}", "fb.DATA.{}", "(double)")
    given = " ".join(f"fb.{name.upper()} = in[{n}] != 0;" for n, name in enumerate(INPUTS))
    given += f" fb.UNITID = {BAY.unit_id}; fb.BAYIDENTITY = {BAY.number};"
    (folder / "main.cpp").write_text(CPP_MAIN.format(inputs=len(INPUTS), size=BLOCK_WORDS, set_inputs=given, show=show))
    include = str(home / "src/runtime/include")
    _run(["g++", "-std=c++17", "-O1", "-w", f"-I{include}", "main.cpp", "program.cpp", "-o", "program"], folder)
    return [str(folder / "program")]


def matiec(home: Path, text: str, folder: Path) -> list[str]:
    """The same by C."""
    source = folder / "program.st"
    source.write_text(text)
    _run([str(home / "iec2c"), "-I", str(home / "lib"), "-T", str(folder), str(source)])
    block = FUNCTION_BLOCK.upper()
    show = _show("fb.{}.value", "fb.DATA.value.{}", "(double)")
    given = " ".join(f"fb.{name.upper()}.value = in[{n}];" for n, name in enumerate(INPUTS))
    given += f" fb.UNITID.value = {BAY.unit_id}; fb.BAYIDENTITY.value = {BAY.number};"
    main = C_MAIN.format(inputs=len(INPUTS), size=BLOCK_WORDS, set_inputs=given, show=show, block=block)
    (folder / "main.c").write_text(main)
    _run(["gcc", "-O1", "-w", f"-I{home / 'lib/C'}", "main.c", "-lm", "-o", "program"], folder)
    return [str(folder / "program")]


def _little(made: list[Cycle]) -> list[Cycle]:
    """The same images from a gateway with the other word order."""
    turned = []
    for now, ok, inputs, recipe, image in made:
        words = list(image)
        for register in REGISTERS:
            part = slice(register.address, register.address + register.words)
            words[part] = reversed(words[part])
        turned.append((now, ok, inputs, recipe, words))
    return turned


def _show(output: str, member: str, cast: str) -> str:
    names = [output.format(name.upper()) for name in SHOWN] + [member.format(name.upper()) for name in MEMBERS]
    return " ".join(f'printf("%.9g ", {cast}{name});' for name in names)


def ran(command: list[str], made: list[Cycle]) -> list[list[float]]:
    lines = (
        " ".join(map(str, (now, int(ok), *map(int, inputs), recipe, *image))) for now, ok, inputs, recipe, image in made
    )
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
    compilers: list[tuple[str, Path, Callable[[Path, str, Path], list[str]]]] = []
    if args.strucpp:
        compilers.append(("STruC++", args.strucpp.resolve(), strucpp))
    if args.matiec:
        compilers.append(("matiec", args.matiec.resolve(), matiec))
    if not compilers:
        parser.error("which compiler? --strucpp DIR, --matiec DIR")
    made = cycles()
    expected = walked(made)
    wrong = 0
    for name, home, build in compilers:
        for title, text in texts():
            with tempfile.TemporaryDirectory() as folder:
                command = build(home, text, Path(folder))
                answers = ran(command, made if "big" in title else _little(made))
                wrong += _compared(f"{name}: {title}", expected, answers)
    return int(wrong > 0)


def _compared(title: str, expected: list[list[float]], answers: list[list[float]]) -> int:
    names = [*SHOWN, *(f"Data.{name}" for name in MEMBERS)]
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
