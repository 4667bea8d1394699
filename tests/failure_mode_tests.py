"""Which tests play which row of the table of failure modes: read from their marks, without importing them."""

import ast
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path

MARK = "pytest.mark.failure_mode"


def marked_tests(folder: Path) -> Mapping[str, list[str]]:
    """Id of a row -> pytest's node id, below `folder`, of each test marked `@pytest.mark.failure_mode(ID, ...)`."""
    found: dict[str, list[str]] = defaultdict(list)
    for path in sorted(folder.rglob("test_*.py")):
        text = path.read_text(encoding="utf-8")
        if MARK in text:
            for name, id in _marked(ast.parse(text), str(path.relative_to(folder))):
                found[id].append(name)
    return found


def _marked(body: ast.Module | ast.ClassDef, prefix: str) -> Iterator[tuple[str, str]]:
    for node in body.body:
        if isinstance(node, ast.ClassDef):
            yield from _marked(node, f"{prefix}::{node.name}")
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            for decorator in node.decorator_list:
                if isinstance(decorator, ast.Call) and ast.unparse(decorator.func) == MARK:
                    yield from ((f"{prefix}::{node.name}", ast.literal_eval(id)) for id in decorator.args)
