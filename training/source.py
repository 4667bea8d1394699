"""From which program a net was made: a sum over the code that its weights depend on, whatever the commit."""

import ast
from hashlib import sha256
from pathlib import Path

HERE = Path(__file__).parent
RUNNING = HERE.parent / "gateway" / "vision" / "detect" / "robust" / "proposer.py"
SHARED = {"inputs", "blob", "WIDTH", "HEIGHT", "CELL", "CHANNELS", "AROUND", "LEAST_SPREAD", "RADIUS_PX"}
"""Of the module that runs the net: how a picture is prepared for it."""


def source_sum() -> str:
    """16 hexadecimal digits, the same on every version of Python.

    Docstrings, empty lines and lines that only comment do not count.
    """
    parts = [_code(path) for path in sorted(HERE.glob("*.py")) if path.name != Path(__file__).name]
    parts.append(_code(RUNNING, SHARED))
    return sha256("\n".join(parts).encode()).hexdigest()[:16]


def _code(path: Path, names: set[str] | None = None) -> str:
    """The lines of a module, or of what it defines by these names."""
    text = path.read_text(encoding="utf-8")
    tree, lines = ast.parse(text), text.splitlines()
    kept = list(range(len(lines)))
    if names is not None:
        kept = [at for node in tree.body if _defined(node) & names for at in _lines(node)]
    texts = {at for node in ast.walk(tree) if _is_text(node) for at in _lines(node)}
    code = (lines[at] for at in kept if at not in texts)
    return "\n".join(line for line in code if line.strip() and not line.lstrip().startswith("#"))


def _lines(node: ast.AST) -> range:
    return range(node.lineno - 1, node.end_lineno)  # type: ignore[attr-defined]


def _defined(node: ast.stmt) -> set[str]:
    if isinstance(node, ast.FunctionDef):
        return {node.name}
    return {name.id for name in ast.walk(node) if isinstance(name, ast.Name) and isinstance(name.ctx, ast.Store)}


def _is_text(node: ast.AST) -> bool:
    """A docstring, or another text that is a statement."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
