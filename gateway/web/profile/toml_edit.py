"""Set keys of one table in a TOML text, and leave every other byte as it is. Pure.

tomlkit parses the layout, and changes values in place, their comments kept. New keys go below the last key of
their table rather than where tomlkit would append them: below the comment that introduces the next table.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Self

import tomlkit
from tomlkit.container import Container, OutOfOrderTableProxy
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import AoT, Comment, InlineTable, Item, Key, Null, Table, Whitespace

from gateway.errors import ConfigError

SIGN = "\ufeff"  # some editors begin a file with it


def with_keys(text: str, place: Sequence[str | int], keys: Mapping[str, Any], *, source: str) -> str:
    """`text` with `keys` set in the table at `place`, for example ("vision",), ("bays", 1, "vision") or () for the keys
    above all tables.

    Tables that are missing are made, items of a list of tables are not. Raises ConfigError where the text's layout is
    beyond that. The caller checks what the result means.
    """
    sign, body = (SIGN, text.removeprefix(SIGN)) if text.startswith(SIGN) else ("", text)
    newline = newline_of(body)
    with by_hand(source):
        document = tomlkit.parse(body)
        if tomlkit.dumps(document) != body:
            raise ConfigError(f"{source}: its layout cannot be kept by a program; change the keys by hand")
        table, depth = _existing(document, place)
        missing = dict(keys)
        if depth == len(place):
            for key in [key for key in keys if key in table]:
                table[key] = _plain(missing.pop(key))
            if not missing and keys:
                return sign + tomlkit.dumps(document)
        if not place:
            return sign + _at_the_top(document, missing, newline)
        placed = _placed(document, place, missing, newline)
        changed = tomlkit.dumps(document)
        return sign + changed + ("" if placed else _new_table(changed, place, missing, newline))


@contextmanager
def by_hand(source: str) -> Iterator[None]:
    """What tomlkit can't do is a ConfigError."""
    try:
        yield
    except (TOMLKitError, KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        raise ConfigError(f"{source}: cannot be changed by a program ({error}); change the keys by hand") from error


def newline_of(text: str) -> str:
    return "\r\n" if "\r\n" in text else "\n"


def lines_of(prefix: str, keys: Mapping[str, Any]) -> list[str]:
    """`key = value` for each; the keys of tables inside are dotted."""
    lines: list[str] = []
    for key, value in keys.items():
        name = f"{prefix}{quoted(key)}"
        if isinstance(value, Mapping) and value:
            lines += lines_of(f"{name}.", value)
        else:
            lines.append(f"{name} = {tomlkit.item(_plain(value)).as_string()}")
    return lines


def quoted(key: str) -> str:
    """As it is written in a file."""
    return tomlkit.key(key).as_string()


def dotted(names: Sequence[str | int]) -> str:
    return ".".join(quoted(str(name)) for name in names)


def inline(value: Any) -> Any:
    """A value with the tables in it in one line."""
    if not isinstance(value, Mapping):
        return _plain(value)
    table = tomlkit.inline_table()
    table.update({key: inline(item) for key, item in value.items()})
    return table


def _existing(document: Any, place: Sequence[str | int]) -> tuple[Any, int]:
    """The deepest table on the way to `place` that is there, and how many steps that is. Items of lists must be."""
    tree = document
    for depth, part in enumerate(place):
        if isinstance(part, int) or part in tree:
            tree = tree[part]
        else:
            return tree, depth
    return tree, len(place)


@dataclass(frozen=True, slots=True)
class _Written:
    """How one table is written. `dotted`: as keys with dots; `headed`: with a header of its own; `below`: only a table
    below it has one."""

    inline: InlineTable | None
    dotted: list[Table]
    headed: list[Table]
    below: list[Table]
    anything: bool

    @classmethod
    def of(cls, above: Any, name: str) -> Self:
        entries = [(key, item) for key, item in body_of(above) if key is not None and key.key == name]
        tables = [(key, item) for key, item in entries if isinstance(item, Table)]
        return cls(
            next((item for _, item in entries if isinstance(item, InlineTable)), None),
            [item for key, item in tables if key.is_dotted()],
            [item for key, item in tables if not key.is_dotted() and not item.is_super_table()],
            [item for key, item in tables if not key.is_dotted() and item.is_super_table()],
            bool(entries),
        )


def _placed(document: Container, place: Sequence[str | int], keys: Mapping[str, Any], newline: str) -> bool:
    """Write new keys into the table or beside it; False: there is no place but the end of the file."""
    tree: Any = document
    prefix = ""  # from the last header down to `tree`
    for depth, part in enumerate(place):
        if isinstance(part, int):
            tree, prefix = tree[part], ""
            if isinstance(tree, InlineTable):
                return _into_inline(tree, place[depth + 1 :], keys)
            continue
        found = _Written.of(tree, part)
        if found.inline is not None:
            return _into_inline(found.inline, place[depth + 1 :], keys)
        if depth == len(place) - 1 or not found.anything:
            return _below(tree, found, f"{prefix}{dotted(place[depth:])}.", keys, newline)
        if found.dotted:
            tree, prefix = found.dotted[-1], f"{prefix}{quoted(part)}."
        else:
            tree, prefix = ([*found.below, *found.headed] or [tree[part]])[-1], ""
    _insert(_last_line(tree), "", keys, newline)
    return True


def _below(above: Any, found: _Written, prefix: str, keys: Mapping[str, Any], newline: str) -> bool:
    if found.headed:
        _insert(_last_line(found.headed[-1]), "", keys, newline)
    elif found.dotted:
        _insert(_last_line(found.dotted[-1]), prefix, keys, newline)
    elif isinstance(above, Table) and (prefix.count(".") > 1 or not above.is_super_table()):
        _insert(_last_line(above), prefix, keys, newline)
    else:
        return False
    return True


def _into_inline(table: InlineTable, names: Sequence[str | int], keys: Mapping[str, Any]) -> bool:
    for depth, name in enumerate(names):
        if isinstance(name, str) and name not in table:
            value: Any = inline(keys)
            for outer in reversed(names[depth + 1 :]):
                value = inline({str(outer): value})
            table[name] = value
            return True
        table = table[name]  # type: ignore[index]
    for key, value in keys.items():
        table[key] = inline(value)
    return True


def _at_the_top(document: Container, keys: Mapping[str, Any], newline: str) -> str:
    """Below the last key above all tables; without one, below the first comment, if it is the file's own."""
    own = [item for key, item in document.body if key is not None and not isinstance(item, Table | AoT | Null)]
    by_dots = [item for key, item in document.body if key is not None and isinstance(item, Table) and key.is_dotted()]
    if own or by_dots:
        _insert(own[-1] if own else _last_line(by_dots[-1]), "", keys, newline)
        return tomlkit.dumps(document)
    text = tomlkit.dumps(document)
    comments: list[Item] = []
    for key, item in document.body:
        if key is not None or not isinstance(item, Comment | Whitespace):
            break
        comments.append(item)
    heads = [n for n, item in enumerate(comments) if isinstance(item, Whitespace)]
    at = sum(len(item.as_string()) for item in comments[: heads[0] + 1]) if heads else 0
    added = newline.join(lines_of("", keys)) + newline
    gap = newline if text[at:] and not text[at:].startswith(("\n", "\r\n")) else ""
    return text[:at] + added + gap + text[at:]


def _new_table(text: str, place: Sequence[str | int], keys: Mapping[str, Any], newline: str) -> str:
    """A table to append to `text`: at its end it can't take keys away from another one."""
    gap = "" if not text else newline if text.endswith("\n") else 2 * newline
    return gap + newline.join((f"[{dotted(place)}]", *lines_of("", keys))) + newline


def body_of(table: Any) -> list[tuple[Key | None, Item]]:
    if isinstance(table, OutOfOrderTableProxy):
        raise KeyError("a table in several pieces")
    container: Container = table if isinstance(table, Container) else table.value
    return container.body


def _last_line(table: Table) -> Item:
    """The item whose line is the last of this table's own keys; of a table without any, the table with its header."""
    last: Item = table
    for key, item in body_of(table):
        if key is None or isinstance(item, Null | AoT):
            continue
        if isinstance(item, Table):
            if key.is_dotted():
                last = _last_line(item)
        else:
            last = item
    return last


def _insert(above: Item, prefix: str, keys: Mapping[str, Any], newline: str) -> None:
    """New lines below the line of `above`, indented as it is."""
    trivia = above.trivia
    indent = trivia.indent.rpartition("\n")[2]
    lines = [f"{indent}{line}" for line in lines_of(prefix, keys)]
    if not lines:
        lines = [f"{indent}{prefix.removesuffix('.')} = {{}}"]
    added = newline.join(lines)
    trivia.trail += f"{added}{newline}" if trivia.trail.endswith("\n") else f"{newline}{added}"


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return inline(value)
    return list(map(_plain, value)) if isinstance(value, tuple | list) else value
