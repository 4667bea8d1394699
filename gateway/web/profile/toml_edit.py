"""Set keys of one table in a TOML text, and leave every other byte as it is. Pure.

tomlkit parses the layout, and changes values in place, their comments kept. New keys go below the last key of
their table rather than where tomlkit would append them: below the comment that introduces the next table.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import tomlkit
from tomlkit.container import Container, OutOfOrderTableProxy
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import AoT, InlineTable, Item, Key, Null, Table

from gateway.errors import ConfigError

_SIGN = "\ufeff"  # some editors begin a file with it


def with_keys(text: str, place: Sequence[str | int], keys: Mapping[str, Any], *, source: str) -> str:
    """`text` with `keys` set in the table at `place`, for example ("vision",) or ("bays", 1, "vision").

    The table above must exist; the table itself is made where it is missing. Raises ConfigError where the text's layout
    is beyond that. The caller checks what the result means.
    """
    sign, body = (_SIGN, text.removeprefix(_SIGN)) if text.startswith(_SIGN) else ("", text)
    try:
        document = tomlkit.parse(body)
        if tomlkit.dumps(document) != body:
            raise ConfigError(f"{source}: its layout cannot be kept by a program; change the keys by hand")
        above = _follow(document, place[:-1])
        name = str(place[-1])
        newline = "\r\n" if "\r\n" in body else "\n"
        missing = _replaced(above, name, keys)
        placed = not missing or _placed(above, name, missing, newline)
        changed = tomlkit.dumps(document)
        return sign + changed + ("" if placed else _new_table(changed, name, missing, newline))
    except (TOMLKitError, KeyError, IndexError, TypeError) as error:
        raise ConfigError(f"{source}: cannot be changed by a program ({error}); change the keys by hand") from error


def _follow(tree: Any, place: Sequence[str | int]) -> Any:
    for part in place:
        tree = tree[part]
    return tree


def _replaced(above: Any, name: str, keys: Mapping[str, Any]) -> dict[str, Any]:
    """Change the values of keys that are there; returns the others."""
    table = above.get(name)
    if table is None:
        return dict(keys)
    for key, value in keys.items():
        if key in table:
            table[key] = _plain(value)
    return {key: value for key, value in keys.items() if key not in table}


def _placed(above: Any, name: str, keys: Mapping[str, Any], newline: str) -> bool:
    """Write new keys into the table or beside it; False: there is no place but the end of the file."""
    if isinstance(above, InlineTable):
        _into_inline(above, name, keys)
        return True
    entries = [(key, item) for key, item in _body(above) if key is not None and key.key == name]
    inline = next((item for _, item in entries if isinstance(item, InlineTable)), None)
    if inline is not None:
        for key, value in keys.items():
            inline[key] = _plain(value)
        return True
    dotted = [item for key, item in entries if isinstance(item, Table) and key.is_dotted()]
    headed = [item for key, item in entries if isinstance(item, Table) and not key.is_dotted() and _headed(item)]
    if headed:
        _insert(_last_line(headed[-1]), "", keys, newline)
    elif dotted:
        _insert(_last_line(dotted[-1]), f"{name}.", keys, newline)
    elif isinstance(above, Table):
        _insert(_last_line(above), f"{name}.", keys, newline)
    else:
        return False
    return True


def _into_inline(above: InlineTable, name: str, keys: Mapping[str, Any]) -> None:
    table = above.get(name)
    if table is None:
        table = tomlkit.inline_table()
        table.update({key: _plain(value) for key, value in keys.items()})
        above[name] = table
        return
    for key, value in keys.items():
        table[key] = _plain(value)


def _new_table(text: str, name: str, keys: Mapping[str, Any], newline: str) -> str:
    """A table to append to `text`: at its end it can't take keys away from another one."""
    gap = "" if not text else newline if text.endswith("\n") else 2 * newline
    return gap + newline.join((f"[{name}]", *_lines("", keys))) + newline


def _headed(table: Table) -> bool:
    """Whether `[name]` itself is written, and not only a table below it."""
    return not table.is_super_table()


def _body(table: Any) -> list[tuple[Key | None, Item]]:
    if isinstance(table, OutOfOrderTableProxy):
        raise KeyError("a table in several pieces")
    container: Container = table if isinstance(table, Container) else table.value
    return container.body


def _last_line(table: Table) -> Item:
    """The item whose line is the last of this table's own keys; of a table without any, the table with its header."""
    last: Item = table
    for key, item in _body(table):
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
    lines = [f"{indent}{line}" for line in _lines(prefix, keys)]
    added = newline.join(lines)
    trivia.trail += f"{added}{newline}" if trivia.trail.endswith("\n") else f"{newline}{added}"


def _lines(prefix: str, keys: Mapping[str, Any]) -> list[str]:
    return [f"{prefix}{key} = {tomlkit.item(_plain(value)).as_string()}" for key, value in keys.items()]


def _plain(value: Any) -> Any:
    return list(map(_plain, value)) if isinstance(value, tuple | list) else value
