"""Remove keys and tables from a TOML text, and add items to its lists of tables; every other byte stays. Pure.

A table with a header goes with the comment directly above it; a key's line with the comment at its end. The comment
that introduces the next table stays.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import tomlkit
from tomlkit.items import Array

from gateway.config.strict.toml_file import KeyPath, headers
from gateway.web.profile.toml_edit import SIGN, by_hand, dotted, inline, lines_of, newline_of

Blocks = list[tuple[KeyPath, list[str]]]


def without(text: str, place: Sequence[str | int], *, source: str) -> str:
    """`text` without the key, the table or the item of a list at `place`. Raises ConfigError.

    The caller checks what the result means.
    """
    sign, body = (SIGN, text.removeprefix(SIGN)) if text.startswith(SIGN) else ("", text)
    path = tuple(place)
    with by_hand(source):
        left = _joined([block for block in _blocks(body) if block[0][: len(path)] != path])
        if left != body and isinstance(path[-1], int):  # the next item has its number now
            return sign + left
        document = tomlkit.parse(left)
        tree: Any = document
        for part in path[:-1]:
            if not isinstance(part, int) and part not in tree:
                return sign + left  # only headers below it had named it
            tree = tree[part]
        if isinstance(path[-1], int) or path[-1] in tree:
            del tree[path[-1]]
        return sign + tomlkit.dumps(document)


def with_item(text: str, place: Sequence[str], keys: Mapping[str, Any], *, source: str) -> str:
    """`text` with one more item in the list of tables at `place`, below those that are there. Raises ConfigError."""
    sign, body = (SIGN, text.removeprefix(SIGN)) if text.startswith(SIGN) else ("", text)
    newline = newline_of(body)
    with by_hand(source):
        document = tomlkit.parse(body)
        tree: Any = document
        for part in place:
            tree = tree.get(part, {})
        if isinstance(tree, Array):
            if len(tree):
                tree.append(inline(keys))
                return sign + tomlkit.dumps(document)
            body = without(body, place, source=source)
        blocks = _blocks(body)
        path = tuple(place)
        same = [n for n, (head, _) in enumerate(blocks) if head[: len(path)] == path]
        near = [n for n, (head, _) in enumerate(blocks) if head[:1] == path[:1]]
        last = (same or near or [len(blocks) - 1])[-1]
        before, after = _joined(blocks[: last + 1]), _joined(blocks[last + 1 :])
        if before and not before.endswith("\n"):
            before += newline
        gap = "" if not before or before.endswith(2 * newline) else newline
        added = newline.join((f"[[{dotted(place)}]]", *lines_of("", keys))) + newline
        return sign + before + gap + added + (newline if after else "") + after


def _blocks(text: str) -> Blocks:
    """The lines above the first header, then each header with the comment directly above it and the lines below."""
    lines = [f"{line}\n" for line in text.split("\n")]
    lines[-1] = lines[-1].removesuffix("\n")
    starts: list[int] = []
    paths: list[KeyPath] = []
    for number, path in headers(text):
        first = number - 1
        while first > 0 and lines[first - 1].lstrip().startswith("#"):
            first -= 1
        starts.append(first)
        paths.append(path)
    ends = [*starts[1:], len(lines)]
    above = lines[: starts[0]] if starts else lines
    return [((), above), *((path, lines[a:b]) for path, a, b in zip(paths, starts, ends, strict=True))]


def _joined(blocks: Blocks) -> str:
    return "".join(line for _, lines in blocks for line in lines)
