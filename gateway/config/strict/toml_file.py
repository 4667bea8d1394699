"""Read a TOML file, merge one document over another, and find the line of a key: `tomllib` does not keep it."""

import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gateway.errors import ConfigError


def read_toml(path: Path) -> tuple[dict[str, Any], str]:
    """The document and its text. Raises ConfigError where there is no readable TOML."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot read the configuration: {error}") from error
    try:
        text = data.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        wide = data.startswith((b"\xff\xfe", b"\xfe\xff"))
        line = 1 if wide else data.count(b"\n", 0, error.start) + 1
        code = "UTF-16" if wide else f"the byte {data[error.start]:#04x} is of another code, as Latin-1"
        raise ConfigError(f"{path}:{line}: not UTF-8 text: {code}; save the file as UTF-8") from None
    return parsed(text, str(path)), text


def parsed(text: str, source: str) -> dict[str, Any]:
    """Raises ConfigError with the line and its key; never a value, which may be a password."""
    try:
        return tomllib.loads(text.removeprefix("\ufeff"))
    except (ValueError, RecursionError) as error:  # TOMLDecodeError, or numbers and nesting that Python refuses
        fault, lines = str(error), text.rstrip().split("\n")
        at = re.search(r" \(at line (\d+), column \d+\)$", fault)
        number = int(at[1]) if at else len(lines) if "end of document" in fault else 0  # 0: not known
        key = _KEY.match(lines[number - 1]) if 0 < number <= len(lines) else None
        where = (f":{number}" if number else "") + (f": {key[1]}" if key else "")
        raise ConfigError(f"{source}{where}: not valid TOML: {fault[: at.start()] if at else fault}") from error


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """`over` wins; tables are merged key by key, everything else is replaced."""
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        merged[key] = merge(below, value) if isinstance(below, Mapping) and isinstance(value, Mapping) else value
    return merged


_HEADER = re.compile(r"^\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(?:#.*)?$")
_KEY = re.compile(r"""^\s*((?:[\w-]+|"[^"]*"|'[^']*')(?:\s*\.\s*(?:[\w-]+|"[^"]*"|'[^']*'))*)\s*=""")
_PART = re.compile(r"""[\w-]+|"[^"]*"|'[^']*'""")
_TOKEN = re.compile(r"""\"{3}|'{3}|"(?:\\.|[^"\\])*"|'[^']*'|\#.*|[\[\]{}]""")
_FENCE_END = {'"""': re.compile(r'(?:\\.|[^\\])*?"{3}'), "'''": re.compile(r".*?'{3}")}
KeyPath = tuple[str | int, ...]


def line_of(text: str, place: Sequence[str | int]) -> int | None:
    """1-based line of the key at `place`, or of the deepest table above it; None: neither is in the text.

    `place` is a path of keys and array indices, as pydantic's `loc`. Line-based on purpose: keys inside inline tables
    are found by the key that opens the table.
    """
    known = _index(text)
    wanted = tuple(place)
    while wanted:
        if wanted in known:
            return known[wanted]
        wanted = wanted[:-1]
    return None


def headers(text: str) -> list[tuple[int, KeyPath]]:
    """1-based line and path of each `[table]` and `[[item]]`, those of a list with their number in it."""
    return _read(text)[1]


def _index(text: str) -> dict[KeyPath, int]:
    return _read(text)[0]


def _read(text: str) -> tuple[dict[KeyPath, int], list[tuple[int, KeyPath]]]:
    known: dict[KeyPath, int] = {}
    heads: list[tuple[int, KeyPath]] = []
    arrays: dict[KeyPath, int] = {}
    table: KeyPath = ()
    fence: str | None = None  # inside a multi-line string
    depth = 0  # inside an array that continues over several lines
    for number, line in enumerate(text.split("\n"), start=1):
        if fence is not None or depth > 0:
            fence, depth = _scan(line, fence, depth)
        elif header := _HEADER.match(line):
            is_array = header[1] == "[["
            table = _enter(_keys(header[2]), arrays, is_array=is_array)
            known.setdefault(table, number)
            heads.append((number, table))
            if is_array:
                known.setdefault(table[:-1], number)
        elif key := _KEY.match(line):
            path = table + _keys(key[1])
            for length in range(len(table) + 1, len(path) + 1):
                known.setdefault(path[:length], number)
            fence, depth = _scan(line[key.end() :], fence, depth)
    return known, heads


def _scan(line: str, fence: str | None, depth: int) -> tuple[str | None, int]:
    """What is still open at the end of the line: a multi-line string's quotes, and how many brackets."""
    at = 0
    while True:
        if fence is not None:
            end = _FENCE_END[fence].match(line, at)
            if end is None:
                return fence, depth
            at, fence = end.end(), None
        token = _TOKEN.search(line, at)
        if token is None:
            return fence, depth
        at = token.end()
        if token[0] in _FENCE_END:
            fence = token[0]
        else:
            depth += {"[": 1, "{": 1, "]": -1, "}": -1}.get(token[0], 0)


def _keys(dotted: str) -> KeyPath:
    return tuple(part.strip("\"'") for part in _PART.findall(dotted))


def _enter(keys: KeyPath, arrays: dict[KeyPath, int], *, is_array: bool) -> KeyPath:
    """The full path of a header, with the index of every array of tables on the way."""
    path: KeyPath = ()
    for depth, key in enumerate(keys, start=1):
        path += (key,)
        last = depth == len(keys)
        if is_array and last:
            arrays[path] = arrays.get(path, -1) + 1
        if path in arrays:
            path += (arrays[path],)
    return path
