"""What others rely on, now and at an older commit: registers, topics, payload schemas, OpenAPI, keys, command lines.

    python -m bench.wire_contracts COMMIT

Reads what the repository keeps of them (the generated tables and files of docs/, which the tests hold to the code; the
options in the source) at COMMIT and in the working tree, and prints each difference. Words about a thing (meanings,
descriptions) are not compared. Exit code 1 if anything that was there is gone or has changed.
"""

import argparse
import ast
import csv
import io
import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TABLES = {  # page: columns that are words
    "config.md": {"meaning"},
    "hmi-api.md": {"meaning", "answer"},
    "hmi-security.md": {"what"},
    "mqtt.md": {"meaning"},
    "ranger.md": {"meaning"},
    "registers.md": {"meaning"},
    "simulator.md": {"meaning", "does", "what happens"},
    "sparkplug.md": {"meaning"},
    "alarms.md": {"meaning", "when", "", "cause", "consequence", "response", "what it means", "what to do"},
}
NAMES = ("name", "method", "address")  # columns that name a row; else its first
WORDS = {"description", "summary", "title", "info", "tags", "example", "examples"}
NO_WIRE = ("assertions", "calls", "situations")  # of older pages: what tests show, and a copy of another table
BLOCK = re.compile(r"<!-- generated: ([a-z][a-z ]*) -->\n(.*?)<!-- end -->", re.DOTALL)

COMMENTS = re.compile(
    r"\(\*.*?\*\)|/\*.*?\*/|//.*?(?=\n|\\n|\]\]>)|<(documentation|Description|AdditionalHelpText)>.*?</\1>"
    r'|"documentation": "(?:[^"\\]|\\.)*"|const MEANING = .*?;(?=\\n)',
    re.DOTALL,
)

Read = Callable[[str], str | None]
Contract = dict[str, object]


def at(commit: str) -> Read:
    def read(path: str) -> str | None:
        done = subprocess.run(
            ["git", "show", f"{commit}:{path}"], cwd=ROOT, capture_output=True, text=True, check=False
        )
        return done.stdout if done.returncode == 0 else None

    return read


def now(path: str) -> str | None:
    file = ROOT / path
    return file.read_text(encoding="utf-8") if file.is_file() else None


def files(commit: str | None, folder: str) -> list[str]:
    command = ["git", "ls-tree", "-r", "--name-only", commit] if commit else ["git", "ls-files"]
    return subprocess.run([*command, folder], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()


def table_rows(page: str, words: set[str]) -> Iterator[tuple[str, object]]:
    """Each row of each generated table as (place, cells that are no words)."""
    for name, block in BLOCK.findall(page):
        if name in NO_WIRE:
            continue
        heading, columns = "", None
        for line in block.splitlines():
            if line.startswith("#"):
                heading = line.strip("# `")
            if not line.startswith("|"):
                columns = None
                continue
            cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip("|\n"))]
            if columns is None:
                columns = cells
            elif not set(line) <= set("|-: "):
                kept = {key: cell for key, cell in zip(columns, cells, strict=False) if key not in words}
                first = " ".join(kept.get(column, "") for column in NAMES if column in kept) or cells[0]
                yield f"{name}/{heading}/{first}", kept


def leaves(value: object, place: str) -> Iterator[tuple[str, object]]:
    """Each leaf of a JSON document as (place, value), without the words in it."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if key not in WORDS or isinstance(inner, dict):  # a property may be called `title`
                yield from leaves(inner, f"{place}/{key}")
    elif isinstance(value, list) and not any(isinstance(one, dict | list) for one in value):
        yield place, sorted(value, key=str)
    elif isinstance(value, list):
        for n, inner in enumerate(value):
            yield from leaves(inner, f"{place}/{n}")
    else:
        yield place, value


def program(path: str, text: str) -> list[object]:
    """The lines of a PLC export, or its rows, without comments and descriptions."""
    if path.endswith(".csv"):
        return [row | {"Description": ""} for row in csv.DictReader(io.StringIO(text))]
    return [line.strip() for line in COMMENTS.sub("", text).splitlines() if line.strip()]


def options(source: str) -> Iterator[tuple[str, object]]:
    """What `add_argument` and `add_parser` are called with first: option names, positional names, verbs."""
    for node in ast.walk(ast.parse(source)):
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Attribute)
            and node.func.attr in ("add_argument", "add_parser")
        ):
            for argument in node.args:
                if isinstance(argument, ast.Constant) and isinstance(argument.value, str):
                    yield argument.value, "option"
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and node.targets[0].id == "VERBS":
            yield from ((f"verb {name}", "verb") for name in ast.literal_eval(node.value))


def contracts(commit: str | None) -> Contract:
    """Every contract as one flat table, place -> value."""
    read = at(commit) if commit else now
    found: Contract = {}
    for page, words in TABLES.items():
        text = read(f"docs/{page}") or ""
        found.update({f"docs/{page}: {place}": cells for place, cells in table_rows(text, words)})
    for path in ["docs/openapi.json", *files(commit, "docs/schemas")]:
        found.update({f"{path}: {place}": leaf for place, leaf in leaves(json.loads(read(path) or "{}"), "")})
    for path in files(commit, "docs/plc"):
        found[path] = program(path, read(path) or "")
    header = "firmware/ranger/src/protocol_constants.h"
    found[header] = re.sub(r"/\*.*?\*/|//[^\n]*", "", read(header) or "", flags=re.DOTALL)
    for path in files(commit, "gateway/cli"):
        if path.endswith(".py"):
            found.update({f"command line: {name}": kind for name, kind in options(read(path) or "")})
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commit", help="compare the working tree with this commit")
    commit = parser.parse_args().commit
    then, here = contracts(commit), contracts(None)
    added, gone = here.keys() - then.keys(), then.keys() - here.keys()
    changed = {place for place in then.keys() & here.keys() if then[place] != here[place]}
    for what, places in (("added", added), ("gone", gone), ("changed", changed)):
        for place in sorted(places):
            short = isinstance(then.get(place), str) and "\n" in str(then[place])
            print(f"{what}: {place}", "" if what != "changed" or short else f"\n    {then[place]}\n    {here[place]}")
    print(f"{len(here)} entries: {len(added)} added, {len(gone)} gone, {len(changed)} changed since {commit}")
    return int(bool(gone or changed))


if __name__ == "__main__":
    sys.exit(main())
