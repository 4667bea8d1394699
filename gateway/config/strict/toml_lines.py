"""Where in a TOML text does a key stand? `tomllib` forgets it, and an operator needs the line."""

import re
from collections.abc import Sequence

_HEADER = re.compile(r"^\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(?:#.*)?$")
_KEY = re.compile(r"""^\s*((?:[\w-]+|"[^"]*"|'[^']*')(?:\s*\.\s*(?:[\w-]+|"[^"]*"|'[^']*'))*)\s*=""")
_PART = re.compile(r"""[\w-]+|"[^"]*"|'[^']*'""")
_TOKEN = re.compile(r"""\"{3}|'{3}|"(?:\\.|[^"\\])*"|'[^']*'|\#.*|[\[\]{}]""")
_FENCE_END = {'"""': re.compile(r'(?:\\.|[^\\])*?"{3}'), "'''": re.compile(r".*?'{3}")}
Path = tuple[str | int, ...]


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


def _index(text: str) -> dict[Path, int]:
    known: dict[Path, int] = {}
    arrays: dict[Path, int] = {}
    table: Path = ()
    fence: str | None = None  # inside a multi-line string
    depth = 0  # inside an array that goes on over several lines
    for number, line in enumerate(text.split("\n"), start=1):
        if fence is not None or depth > 0:
            fence, depth = _scan(line, fence, depth)
        elif header := _HEADER.match(line):
            is_array = header[1] == "[["
            table = _enter(_keys(header[2]), arrays, is_array=is_array)
            known.setdefault(table, number)
            if is_array:
                known.setdefault(table[:-1], number)
        elif key := _KEY.match(line):
            path = table + _keys(key[1])
            for length in range(len(table) + 1, len(path) + 1):
                known.setdefault(path[:length], number)
            fence, depth = _scan(line[key.end() :], fence, depth)
    return known


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


def _keys(dotted: str) -> Path:
    return tuple(part.strip("\"'") for part in _PART.findall(dotted))


def _enter(keys: Path, arrays: dict[Path, int], *, is_array: bool) -> Path:
    """The full path of a header, with the index of every array of tables on the way."""
    path: Path = ()
    for depth, key in enumerate(keys, start=1):
        path += (key,)
        last = depth == len(keys)
        if is_array and last:
            arrays[path] = arrays.get(path, -1) + 1
        if path in arrays:
            path += (arrays[path],)
    return path
