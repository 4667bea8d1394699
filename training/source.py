"""From which program a net was made: a sum over the code that its weights depend on, whatever the commit."""

import ast
from hashlib import sha256
from pathlib import Path

from gateway.vision.detect.robust import proposer

SHARED = {"inputs", "blob", "WIDTH", "HEIGHT", "CELL", "CHANNELS", "AROUND", "LEAST_SPREAD", "RADIUS_PX"}
"""Of the module that runs the net: how a picture is prepared for it."""


def source_sum() -> str:
    """16 hexadecimal digits. Comments, docstrings and layout do not count."""
    parts = [_code(ast.parse(path.read_text(encoding="utf-8"))) for path in sorted(Path(__file__).parent.glob("*.py"))]
    running = ast.parse(Path(proposer.__file__).read_text(encoding="utf-8"))
    parts += [_code(node) for node in running.body if _names(node) & SHARED]
    return sha256("\n".join(parts).encode()).hexdigest()[:16]


def _names(node: ast.stmt) -> set[str]:
    if isinstance(node, ast.FunctionDef):
        return {node.name}
    return {name.id for name in ast.walk(node) if isinstance(name, ast.Name) and isinstance(name.ctx, ast.Store)}


def _code(tree: ast.AST) -> str:
    """Without docstrings, and without other strings that are statements."""
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [each for each in body if not _is_text(each)]  # type: ignore[attr-defined]
    return ast.unparse(tree)


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
