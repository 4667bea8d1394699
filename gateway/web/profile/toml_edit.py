"""Set and remove keys, tables and items of lists in a TOML text, and leave every other byte as it is. Pure.

tomlkit changes and removes what is there, its comments kept. What is new is put in as lines, below the last key of its
block: tomlkit would append it below the comment that introduces the next table. A block is a header with the comment
directly above it, and the lines below. The caller checks what the result means.
"""

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import Array, InlineTable

from gateway.config.strict.toml_file import KeyPath, headers
from gateway.errors import ConfigError

SIGN = "\ufeff"  # some editors begin a file with it
Blocks = list[tuple[KeyPath, list[str]]]


def with_keys(text: str, place: Sequence[str | int], keys: Mapping[str, Any], *, source: str) -> str:
    """`text` with `keys` set in the table at `place`, for example ("vision",), ("bays", 1, "vision") or () for the keys
    above all tables.

    Tables that are missing are made, items of a list of tables are not. Raises ConfigError where the text's layout is
    beyond that.
    """
    sign, body = _signed(text)
    with by_hand(source):
        document = tomlkit.parse(body)
        if tomlkit.dumps(document) != body:
            raise ConfigError(f"{source}: its layout cannot be kept by a program; change the keys by hand")
        table, below, in_line = _existing(document, place)
        missing = dict(keys)
        if not below:
            for key in [key for key in keys if key in table]:
                table[key] = _plain(missing.pop(key))
        if in_line:
            for name in reversed(below):
                missing = {str(name): missing}
            table.update({key: inline(value) for key, value in missing.items()})
        changed = tomlkit.dumps(document)
        if in_line or (keys and not missing):
            return sign + changed
        return sign + _with_lines(changed, tuple(place), missing, _newline_of(body))


def without(text: str, place: Sequence[str | int], *, source: str) -> str:
    """`text` without the key, the table or the item of a list at `place`. A table with a header goes with the comment
    directly above it; a key's line with the comment at its end. Raises ConfigError."""
    sign, body = _signed(text)
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
    sign, body = _signed(text)
    newline = _newline_of(body)
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


@contextmanager
def by_hand(source: str) -> Iterator[None]:
    """What tomlkit can't do is a ConfigError."""
    try:
        yield
    except (TOMLKitError, KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        raise ConfigError(f"{source}: cannot be changed by a program ({error}); change the keys by hand") from error


def lines_of(prefix: str, keys: Mapping[str, Any]) -> list[str]:
    """`key = value` for each; the keys of tables inside are dotted."""
    lines: list[str] = []
    for key, value in keys.items():
        name = f"{prefix}{dotted((key,))}"
        if isinstance(value, Mapping) and value:
            lines += lines_of(f"{name}.", value)
        else:
            lines.append(f"{name} = {tomlkit.item(_plain(value)).as_string()}")
    return lines


def dotted(names: Sequence[str | int]) -> str:
    """As it is written in a file."""
    return ".".join(tomlkit.key(str(name)).as_string() for name in names)


def inline(value: Any) -> Any:
    """A value with the tables in it in one line."""
    if not isinstance(value, Mapping):
        return _plain(value)
    table = tomlkit.inline_table()
    table.update({key: inline(item) for key, item in value.items()})
    return table


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return inline(value)
    return list(map(_plain, value)) if isinstance(value, tuple | list) else value


def _existing(document: Any, place: Sequence[str | int]) -> tuple[Any, Sequence[str | int], bool]:
    """The deepest table on the way to `place` that is there, what of the way is missing below it, and whether it is
    written in one line. Items of lists must be there."""
    tree, in_line = document, False
    for depth, part in enumerate(place):
        if not isinstance(part, int) and part not in tree:
            return tree, place[depth:], in_line
        tree = tree[part]
        in_line = in_line or isinstance(tree, InlineTable)
    return tree, (), in_line


def _with_lines(text: str, path: KeyPath, keys: Mapping[str, Any], newline: str) -> str:
    """New keys of the table at `path`: in its own block, else as dotted keys in that of the nearest table above it, or
    else in a new table at the end, where it can't take keys away from another one."""
    blocks = _blocks(text)
    near = [(_known(path, *block), n) for n, block in enumerate(blocks) if path[: len(block[0])] == block[0]]
    known, chosen = max(near)
    if path and not known:
        gap = "" if not text else newline if text.endswith("\n") else 2 * newline
        return text + gap + newline.join((f"[{dotted(path)}]", *lines_of("", keys))) + newline
    head, lines = blocks[chosen]
    below = path[len(head) :]
    end = _end_of_keys(lines)
    added = lines_of(f"{dotted(below)}." if below else "", keys) or [f"{dotted(below)} = {{}}"]
    if end:
        last = lines[end - 1]
        indent = last[: len(last) - len(last.lstrip())]
        added = [f"{indent}{line}" for line in added]
        more = newline.join(added)
        lines[end - 1] = f"{last}{more}{newline}" if last.endswith("\n") else f"{last}{newline}{more}"
        return _joined(blocks)
    blank = next((n for n, line in enumerate(lines) if not line.strip() and line), -1)  # below the file's own comment
    before, after = "".join(lines[: blank + 1]), "".join(lines[blank + 1 :]) + _joined(blocks[1:])
    gap = newline if after and not after.startswith(("\n", "\r\n")) else ""
    return before + newline.join(added) + newline + gap + after


def _known(path: KeyPath, head: KeyPath, lines: Sequence[str]) -> int:
    """How much of the way to `path` this block names: by its header, and by dotted keys below it."""
    own = next((n + 1 for n, line in enumerate(lines) if head and not line.lstrip().startswith("#")), 0)
    tree: Any = tomllib.loads("".join(lines[own:]))
    known = len(head)
    for part in path[len(head) :]:
        if not isinstance(tree, dict) or part not in tree:
            break
        tree, known = tree[part], known + 1
    return known


def _end_of_keys(lines: Sequence[str]) -> int:
    """How many lines there are without the blank ones and comments at the end."""
    whole, end = tomllib.loads("".join(lines)), len(lines)
    while end and _read(lines[: end - 1]) == whole:
        end -= 1
    return end


def _read(lines: Sequence[str]) -> dict[str, Any] | None:
    try:
        return tomllib.loads("".join(lines))
    except tomllib.TOMLDecodeError:
        return None  # the end of a value is missing


def _blocks(text: str) -> Blocks:
    """The lines above the first header, then each header's block."""
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
    ends = [*starts, len(lines)]
    parts = zip([(), *paths], [0, *starts], ends, strict=True)
    return [(path, lines[begin:end]) for path, begin, end in parts]


def _joined(blocks: Blocks) -> str:
    return "".join(line for _, lines in blocks for line in lines)


def _signed(text: str) -> tuple[str, str]:
    return (SIGN, text.removeprefix(SIGN)) if text.startswith(SIGN) else ("", text)


def _newline_of(text: str) -> str:
    return "\r\n" if "\r\n" in text else "\n"
