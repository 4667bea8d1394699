"""The register table for people and for other programs: text, Markdown, CSV, JSON. Pure; all from one table.

Reserved addresses are shown to people only: they are no tags, and an importer would make tags of them.
"""

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from gateway.modbus.exports.target import Target, one_file
from gateway.modbus.registers.register_map import BLOCK_WORDS, MAP_VERSION, REGISTERS, RESERVED, Register

HEADER = ("addr", "name", "type", "unit", "meaning")  # for people: the unit of one count
COLUMNS = ("name", "address", "words", "type", "scale", "unit", "meaning")

Row = dict[str, Any]


def rows(targets: Sequence[Target] = ()) -> list[Row]:
    """One plain record per register, in the order of COLUMNS, with `codes` or `bits` where values have names.

    `address` counts from 0; value = register * `scale` in `unit`. `targets`: the bays whose identity is stated.
    """
    known = {
        "unit_id": "".join(f"; {target.bay}: {target.identity.unit_id}" for target in targets),
        "bay_identity": "".join(f"; {target.bay}: {target.identity.number}" for target in targets),
    }
    made: list[Row] = []
    for register in REGISTERS:
        row: Row = {
            "name": register.name,
            "address": register.address,
            "words": register.words,
            "type": register.kind.name,
            "scale": register.scale,
            "unit": register.unit,
            "meaning": register.meaning + _limits(register) + known.get(register.name, ""),
        }
        for key, names in (("codes", register.codes), ("bits", register.bits)):
            if names is not None:
                which = key[:-1]
                row[key] = [{which: n, "name": name, "meaning": meaning} for n, (name, meaning) in names.items()]
        made.append(row)
    return made


def csv_text(targets: Sequence[Target] = ()) -> str:
    """COLUMNS as the header, one line per register."""
    out = io.StringIO()
    writer = csv.DictWriter(out, COLUMNS, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows(targets))
    return out.getvalue()


def plain_text(targets: Sequence[Target] = ()) -> str:
    """Aligned columns for a terminal, then the code tables."""
    table = [HEADER, *_table(targets)]
    widths = [max(len(line[column]) for line in table) for column in range(4)]
    lines = [_headline(), ""]
    for cells in table:
        lines.append("  ".join([*(c.ljust(w) for c, w in zip(cells, widths, strict=False)), cells[4]]))
    for title, _, names in _code_tables():
        lines += ["", f"{title}:"]
        lines += [f"  {number:>3}  {name}: {meaning}" for number, (name, meaning) in names.items()]
    return "\n".join(lines) + "\n"


def markdown(targets: Sequence[Target] = ()) -> str:
    """The same as Markdown tables."""
    parts = [_headline() + "\n", markdown_table(HEADER, _table(targets))]
    for title, key, names in _code_tables():
        cells = ((str(number), f"`{name}`", meaning) for number, (name, meaning) in names.items())
        parts += [f"### {title[0].upper()}{title[1:]}\n", markdown_table((key, "name", "meaning"), cells)]
    return "\n".join(parts)


def _headline() -> str:
    return f"Map version {MAP_VERSION}: {BLOCK_WORDS} registers from address 0, function code 3 or 4."


def _limits(register: Register) -> str:
    """How "no value" and "too large" look in this register."""
    kind, scale = register.kind, register.scale
    if kind.no_value is None:
        return ""
    if kind.is_float:
        return "; NaN: no value"
    sentinel = f"; 0x{kind.no_value:04X}: no value"
    if not register.unit:
        return sentinel
    low = "0" if kind.low == 0 else f"{kind.low * scale:g}"
    return f"{sentinel}; limited to {low}..{kind.high * scale:.{0 if scale == 1 else 1}f}"


def _table(targets: Sequence[Target]) -> list[tuple[str, ...]]:
    """HEADER's columns; reserved places included, in order of address."""
    cells = [
        (
            row["address"],
            (
                _span(row["address"], row["words"]),
                row["name"],
                row["type"],
                row["unit"] if row["scale"] == 1 else f"{row['scale']:g} {row['unit']}",
                row["meaning"],
            ),
        )
        for row in rows(targets)
    ]
    cells += [
        (place.address, (_span(place.address, place.words), "-", "-", "", f"reserved, reads 0: {place.purpose}"))
        for place in RESERVED
    ]
    return [line for _, line in sorted(cells)]


def _span(address: int, words: int) -> str:
    return str(address) if words == 1 else f"{address}-{address + words - 1}"


def _code_tables() -> list[tuple[str, str, Mapping[int, tuple[str, str]]]]:
    """(title, "code" or "bit", names), each table once however many registers use it."""
    tables: list[tuple[str, str, Mapping[int, tuple[str, str]]]] = []
    for register in REGISTERS:
        if register.bits is not None:
            tables.append((f"bits of {register.name}", "bit", register.bits))
    for names in _distinct(register.codes for register in REGISTERS if register.codes is not None):
        users = [register.name for register in REGISTERS if register.codes is names]
        tables.append((f"codes of {' and '.join(users)}", "code", names))
    return tables


def _distinct(tables: Iterable[Mapping[int, tuple[str, str]]]) -> list[Mapping[int, tuple[str, str]]]:
    return list({id(table): table for table in tables}.values())


def markdown_table(header: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """A Markdown table, each line ended."""
    rows = (f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |\n" for line in lines)
    return f"| {' | '.join(header)} |\n|{'---|' * len(header)}\n{''.join(rows)}"


csv_files = one_file("registers.csv", csv_text)
json_files = one_file("registers.json", lambda targets: json.dumps(rows(targets), indent=2, ensure_ascii=False) + "\n")
markdown_files = one_file("registers.md", markdown)
text_files = one_file("registers.txt", plain_text)
