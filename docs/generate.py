"""Write the generated parts of docs/ and bench/reports/ anew: `./dev docs`. `--check` changes nothing, and fails where
something drifted.

A page holds generated blocks between `<!-- generated: NAME -->` and `<!-- end -->`. What stands in them comes from the
tables in the code, so that page and code cannot disagree for longer than one test run.
"""

import ast
import json
import re
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import cv2

from bench.closed_loop import report as closed_loop_report
from bench.guidance import report as guidance_report
from bench.guidance import rolling as rolling_bench
from gateway.config import reference as configdoc
from gateway.modbus.exports import tables as register_tables
from gateway.modbus.exports.registry import export
from gateway.modbus.exports.target import Target
from gateway.modbus.registers.register import WRAPS
from gateway.ranger.hcsr04 import protocol
from gateway.sinks import registry as sink_registry
from gateway.web.server import app, openapi
from tests import doc_pictures
from tools import (
    alarms,
    detection_methods,
    failure_modes,
    hcsr04,
    historian,
    lamps,
    modbus_server,
    mqtt,
    opcua,
    plc_integration,
    reaction_time,
    situations,
    tables,
    timing_diagrams,
)

DOCS = Path(__file__).resolve().parent
BLOCK = re.compile(r"(?<=<!-- generated: )([a-z][a-z ]*)( -->\n).*?(?=<!-- end -->)", re.DOTALL)


def sparkplug_assertions() -> str:
    """Every testable assertion of the Sparkplug Specification 3.0.0, and what becomes of it here."""
    lines = (DOCS / "sparkplug-assertions.tsv").read_text(encoding="utf-8").splitlines()[1:]
    rows = [(name, status, why) for name, status, why in (line.split("\t") for line in lines)]
    tally = ", ".join(
        f"{sum(row[1] == status for row in rows)} {status}" for status in dict.fromkeys(r[1] for r in rows)
    )
    table = [f"| `{name}` | {status} | {why or f'`test_assertion[{name}]`'} |" for name, status, why in rows]
    return "\n".join(
        [f"{len(rows)} assertions: {tally}.", "", "| id | status | test, or why not |", "|---|---|---|", *table]
    )


def registers() -> str:
    """The table without limits and sentinels, which follow from the type; a star marks a type that has a sentinel. What
    the page says of all counters is left out, and the meaning of a name is said once."""
    table = re.sub(r"; limited to [^ ]+", "", register_tables.markdown()).replace(WRAPS, "count")
    table = re.sub(r"\| (u?int\d+|float\d+) (\|.*); (?:0x[0-9A-F]+|NaN): no value", r"| \1* \2", table)
    first: dict[str, str] = {}
    lines: list[str] = []
    title = ""
    for line in table.split("\n"):
        title = line.removeprefix("### ") if line.startswith("### ") else title
        number, _, meaning = line.removeprefix("| ").partition(" | ")
        told = first.setdefault(meaning, title) if meaning.startswith("`") else title
        name = meaning.split(" ")[0]
        lines.append(line if told == title else f"| {number} | {name} | as in {told[0].lower()}{told[1:]} |")
    return "\n".join(lines)


def keys() -> str:
    """The tables of configuration keys; one that is equal to an earlier one refers to it, and a recipe's to what it
    changes."""
    first: dict[str, str] = {}
    parts: list[str] = []
    for section in configdoc.markdown(sink_registry.sections()).split("### ")[1:]:
        title, table = section.strip().split("\n\n", 1)
        same = first.setdefault(table, title)
        if title.startswith("`[recipes."):
            names = ", ".join(re.findall(r"^\| (`\w+`)", table, re.MULTILINE))
            table = f"{names}: as in {title.replace('recipes.', '')}; absent: unchanged."
        elif same != title:
            table = f"As {same}."
        parts.append(f"### {title}\n\n{table}")
    return "\n\n".join(parts)


def layers() -> str:
    """The import contracts' layers, the uppermost first."""
    contracts = tomllib.loads((DOCS.parent / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    lines = ["```"]
    for contract in contracts["contracts"]:
        if contract["type"] == "layers":
            lines += [f"{contract['containers'][0]}:", *(f"    {layer}" for layer in contract["layers"])]
    return "\n".join([*lines, "```"])


def folders() -> str:
    """What each folder at the top holds (its docstring's first paragraph), and the folders in it."""
    top = DOCS.parent / "gateway"
    lines = ["| in `gateway/` | what it is | folders in it |", "|---|---|---|"]
    for path in sorted(top.glob("*/__init__.py")):
        inner = [f"`{sub.parent.name}`" for sub in sorted(path.parent.glob("*/__init__.py"))]
        meaning = (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").split("\n\n")[0]
        lines.append(f"| `{path.parent.name}/` | {' '.join(meaning.split())} | {' '.join(inner)} |")
    return "\n".join(lines)


PAGES: dict[str, Mapping[str, Callable[[], str]]] = {
    "alarms.md": alarms.BLOCKS,
    "architecture.md": {"layers": layers, "folders": folders},
    "technician.md": {
        "labels": tables.labels,
        "requirements": tables.requirements,
        "verdicts": tables.verdicts,
    },
    "config.md": {"live": tables.live_keys, "keys": keys},
    "fmea.md": {"failure modes": failure_modes.markdown},
    "hmi-security.md": {"access": tables.access},
    "modbus-server.md": modbus_server.BLOCKS,
    "hmi-api.md": {"metrics": tables.metrics},
    "mqtt.md": mqtt.BLOCKS,
    "opcua.md": opcua.BLOCKS,
    "plc-integration.md": plc_integration.BLOCKS,
    "ranger.md": {"wire": hcsr04.wire},
    "reaction-time.md": reaction_time.blocks(protocol.PERIOD_MS),
    "registers.md": {"registers": registers, **lamps.BLOCKS},
    "sparkplug.md": {"device metrics": tables.sparkplug},
    "sensors.md": {"ranger profiles": tables.ranger_profiles},
    "simulator.md": {"keys and faults": tables.scenario},
    "visit.md": {"situations": situations.markdown},
    "vision.md": {"stages": detection_methods.paper_stages},
    "vision-robust.md": detection_methods.ROBUST_BLOCKS,
}
REPORTS: dict[str, Mapping[str, Callable[[], str]]] = {
    "closed-loop.md": {"comparison": closed_loop_report.comparison, "faults": closed_loop_report.faults},
    "guidance.md": {
        "comparison": guidance_report.comparison,
        "grid": guidance_report.grid,
        "against": guidance_report.against,
        "rolling": rolling_bench.latency_markdown,
        "standing": rolling_bench.standing_markdown,
        "covered": rolling_bench.covered_markdown,
    },
    "sparkplug.md": {"assertions": sparkplug_assertions},
}
PLC_EXAMPLES = ("ignition", "kepware", "st", "plcopen", "codesys", "tcpou", "scl", "l5x", "node-red", "openplc")


def page(text: str, blocks: Mapping[str, Callable[[], str]]) -> str:
    """`text` with every block written anew. Raises KeyError for a block nobody makes, or one that is missing."""
    found = [match[1] for match in BLOCK.finditer(text)]
    if missing := set(blocks) - set(found):
        raise KeyError(f"the page has no block for {sorted(missing)}")
    return BLOCK.sub(lambda match: f"{match[1]}{match[2]}\n{blocks[match[1]]().strip()}\n\n", text)


def texts() -> Iterator[tuple[Path, str]]:
    """Every generated or partly generated text file with what it should say."""
    for folder, pages in ((DOCS, PAGES), (DOCS.parent / "bench/reports", REPORTS)):
        for name, blocks in pages.items():
            yield folder / name, page((folder / name).read_text(encoding="utf-8"), blocks)
    for name, text in mqtt.schemas().items():
        yield DOCS / "schemas" / name, text
    yield DOCS / "scada" / "postgresql.sql", historian.sql_file()
    yield DOCS / "openapi.json", json.dumps(openapi.document(app.ROUTES), indent=1, ensure_ascii=False) + "\n"
    for name in PLC_EXAMPLES:
        for file, text in export(name, (Target(writes=True),)).items():
            yield DOCS / "plc" / file, text.replace("\r\n", "\n")  # as git keeps it
    for name, text in (timing_diagrams.figures() | situations.figures() | closed_loop_report.figures()).items():
        yield DOCS / "images" / f"{name}.svg", text
    yield DOCS.parent / "firmware" / "ranger" / "src" / "protocol_constants.h", hcsr04.header()


def pictures() -> None:
    """Write the pictures anew. Their own tests compare them within a grey level: processors round differently."""
    for name, image in doc_pictures.pictures().items():
        path = DOCS / "images" / f"{name}.png"
        if not cv2.imwrite(str(path), image, [cv2.IMWRITE_PNG_COMPRESSION, 9]):
            raise OSError(f"cannot write {path}")


def main() -> int:
    check = sys.argv[1:] == ["--check"]
    drifted = [(path, text) for path, text in texts() if not path.is_file() or path.read_text(encoding="utf-8") != text]
    for path, text in drifted:
        print(
            f"{path.relative_to(DOCS.parent)}: {'differs from the code; run ./dev docs' if check else 'written anew'}"
        )
        if not check:
            path.write_text(text, encoding="utf-8")
    if not check:
        pictures()
    return int(check and bool(drifted))


if __name__ == "__main__":
    sys.exit(main())
