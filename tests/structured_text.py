"""Runs IEC 61131-3 structured text from the tree that blark's parser makes of it: for tests only.

This is no compiler and proves nothing about one. It shows that the program's logic does what its comments say. It is
stricter than most tools: it knows only what the generated programs use, mixes no types by itself, refuses numbers that
do not fit their type, computes REAL in 32 bits, and raises on everything else.
"""

import math
import struct
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import blark.parse
from blark import transform as tree

Value = tuple[str, Any]
"""(IEC type, value). The types INT_LITERAL and REAL_LITERAL take on the type of the other side."""

RANGES = {
    "UINT": (0, 0xFFFF),
    "INT": (-0x8000, 0x7FFF),
    "UDINT": (0, 0xFFFF_FFFF),
    "DINT": (-0x8000_0000, 0x7FFF_FFFF),
    "WORD": (0, 0xFFFF),
}
DEFAULTS: dict[str, Any] = {**dict.fromkeys(RANGES, 0), "REAL": 0.0, "BOOL": False, "TIME": 0}
NUMBERS = ("UINT", "INT", "UDINT", "DINT", "REAL")
MAX_TURNS = 1000  # of one loop: a PLC's cycle has to end


class RefusedError(Exception):
    """The program uses something that this runner, or the standard, does not allow."""


@dataclass
class Ton:
    """The standard's on-delay timer; `now_ms` is handed in by `Program.call`."""

    since_ms: int | None = None
    Q: bool = False

    def call(self, on: bool, preset_ms: int, now_ms: int) -> None:
        if not on:
            self.since_ms, self.Q = None, False
            return
        if self.since_ms is None:
            self.since_ms = now_ms
        self.Q = now_ms - self.since_ms >= preset_ms


@lru_cache(maxsize=32)
def parse(source: str) -> Any:
    """blark's tree. Raises what its grammar refuses. Takes seconds: an Earley parser, hence the cache."""
    return blark.parse.parse_source_code(source).transform()


class Program:
    """The types, functions and function blocks of one source; `instance` makes a function block to call."""

    def __init__(self, source: str) -> None:
        self.structs: dict[str, dict[str, tuple[str, Any]]] = {}
        self.arrays: dict[str, tuple[int, int, str]] = {}
        self.functions: dict[str, Any] = {}
        self.blocks: dict[str, Any] = {}
        self.programs: dict[str, Any] = {}
        for item in parse(source).items:
            match item:
                case tree.DataTypeDeclaration(declaration=tree.StructureTypeDeclaration() as made):
                    self.structs[str(made.name)] = dict(_members(made.declarations))
                case tree.DataTypeDeclaration(declaration=tree.ArrayTypeDeclaration() as made):
                    (subrange,) = made.init.spec.subranges
                    low, high = int(subrange.start.value), int(subrange.stop.value)
                    self.arrays[str(made.name)] = (low, high, str(made.init.spec.type.type_name))
                case tree.Function():
                    self.functions[str(item.name)] = item
                case tree.FunctionBlock():
                    self.blocks[str(item.name)] = item
                case tree.Program():
                    self.programs[str(item.name)] = item  # it calls the blocks; what it adds is compared as text
                case _:
                    raise RefusedError(type(item).__name__)

    def instance(self, name: str) -> "Instance":
        return Instance(self, self.blocks[name])

    def initial(self, kind: str) -> Any:
        """The value a variable of this type starts with."""
        if kind in DEFAULTS:
            return DEFAULTS[kind]
        if kind in self.structs:
            return {member: start for member, (_, start) in self.structs[kind].items()}
        if kind in self.arrays:
            low, high, of = self.arrays[kind]
            return [DEFAULTS[of]] * (high - low + 1)
        if kind == "TON":
            return Ton()
        raise RefusedError(f"unknown type {kind}")


class Instance:
    """One function block, or one call of a function, with its variables."""

    def __init__(self, program: Program, unit: Any) -> None:
        self._program = program
        self._body = unit.body
        self.types: dict[str, str] = {}
        self.values: dict[str, Any] = {}
        for group in unit.declarations:
            for name, (kind, start) in _members(group.items):
                if name in self.types:
                    raise RefusedError(f"{name} is declared twice")
                self.types[name] = kind
                self.values[name] = program.initial(kind) if start is None or kind not in DEFAULTS else start
        self._now_ms = 0

    def call(self, now_ms: int, **inputs: Any) -> None:
        """One cycle."""
        self._now_ms = now_ms
        for name, value in inputs.items():
            if name not in self.types:
                raise RefusedError(f"no input {name}")
            self.values[name] = value
        self._run(self._body)

    def __getitem__(self, name: str) -> Any:
        return self.values[name]

    def _run(self, statements: Any) -> None:
        for statement in statements.statements:
            match statement:
                case tree.AssignmentStatement(variables=[target]):
                    self._assign(target, self._value(statement.expression))
                case tree.IfStatement():
                    self._if(statement)
                case tree.WhileStatement():
                    for _ in range(MAX_TURNS):
                        if not self._bool(statement.expression):
                            break
                        self._run(statement.statements)
                    else:
                        raise RefusedError("a loop that does not end")
                case tree.FunctionCallStatement():
                    self._timer(statement)
                case _:
                    raise RefusedError(type(statement).__name__)

    def _if(self, statement: Any) -> None:
        if self._bool(statement.if_expression):
            self._run(statement.statements)
            return
        for clause in statement.else_ifs:
            if self._bool(clause.if_expression):
                self._run(clause.statements)
                return
        if statement.else_clause is not None:
            self._run(statement.else_clause.statements)

    def _timer(self, statement: Any) -> None:
        timer = self.values[str(statement.name.name)]
        given = {str(p.name.name): self._value(p.value) for p in statement.parameters}
        if (
            not isinstance(timer, Ton)
            or set(given) != {"IN", "PT"}
            or (given["IN"][0], given["PT"][0]) != ("BOOL", "TIME")
        ):
            raise RefusedError(f"call of {statement.name.name}")
        timer.call(given["IN"][1], given["PT"][1], self._now_ms)

    def _bool(self, expression: Any) -> bool:
        kind, value = self._value(expression)
        if kind != "BOOL":
            raise RefusedError(f"{kind} as a condition")
        return bool(value)

    def _assign(self, target: Any, given: Value) -> None:
        match target:
            case tree.SimpleVariable():
                name = str(target.name)
                self.values[name] = _fit(given, self._type_of(name))
            case tree.MultiElementVariable(elements=[tree.FieldSelector(field=member)]):
                struct_name = self._type_of(str(target.name.name))
                kind, _ = self._program.structs[struct_name][str(member.name)]
                self.values[str(target.name.name)][str(member.name)] = _fit(given, kind)
            case _:
                raise RefusedError(f"assignment to {target}")

    def _type_of(self, name: str) -> str:
        try:
            return self.types[name]
        except KeyError:
            raise RefusedError(f"{name} is not declared") from None

    def _value(self, node: Any) -> Value:  # noqa: PLR0911, PLR0912  # one case a kind of expression
        match node:
            case tree.HexInteger():
                return "INT_LITERAL", int(str(node.value), 16)
            case tree.Integer(type_name=None):
                return "INT_LITERAL", int(node.value)
            case tree.Integer():
                return str(node.type_name), _fit(("INT_LITERAL", int(node.value)), str(node.type_name))
            case tree.Real(type_name=None):
                return "REAL_LITERAL", _f32(float(node.value))
            case tree.Boolean():
                return "BOOL", str(node.value) == "TRUE"
            case tree.Duration(milliseconds=ms, seconds=None, minutes=None, hours=None, days=None):
                return "TIME", int(ms)
            case tree.ParenthesizedExpression():
                return self._value(node.expr)
            case tree.SimpleVariable():
                return self._type_of(str(node.name)), self.values[str(node.name)]
            case tree.MultiElementVariable(elements=[element]):
                return self._element(str(node.name.name), element)
            case tree.UnaryOperation(op="NOT"):
                return "BOOL", not self._bool(node.expr)
            case tree.FunctionCall():
                return self._call(node)
            case tree.BinaryOperation():
                return _binary(str(node.op), self._value(node.left), self._value(node.right))
            case _:
                raise RefusedError(f"{type(node).__name__}: {node}")

    def _element(self, name: str, element: Any) -> Value:
        kind, whole = self._type_of(name), self.values[name]
        match element:
            case tree.FieldSelector() if kind == "TON" and str(element.field.name) == "Q":
                return "BOOL", whole.Q
            case tree.FieldSelector() if kind in self._program.structs:
                member = str(element.field.name)
                return self._program.structs[kind][member][0], whole[member]
            case tree.SubscriptList(subscripts=[tree.Integer() as place]) if kind in self._program.arrays:
                low, high, of = self._program.arrays[kind]
                if not low <= int(place.value) <= high:
                    raise RefusedError(f"{name}[{place.value}] lies outside of {low}..{high}")
                return of, whole[int(place.value) - low]
            case _:
                raise RefusedError(f"{name}{element}")

    def _call(self, node: Any) -> Value:
        name = str(node.name.name)
        if name in self._program.functions:
            unit = self._program.functions[name]
            made = Instance(self._program, unit)
            kind = str(unit.return_type.type.type)
            made.types[name], made.values[name] = kind, DEFAULTS[kind]
            for parameter in node.parameters:
                key = str(parameter.name.name)
                made.values[key] = _fit(self._value(parameter.value), made._type_of(key))
            made._run(made._body)
            return kind, made.values[name]
        (parameter,) = node.parameters
        return _convert(name, self._value(parameter.value))


def _members(declarations: Any) -> Any:
    """(name, (type, start)) of every declared variable; start None: the type's own, where that is no elementary one."""
    for declaration in declarations:
        kind = str(declaration.init.spec.type)
        start = DEFAULTS.get(kind)
        match declaration.init.value:
            case None:
                pass
            case tree.Boolean() as given:
                start = str(given.value) == "TRUE"
            case tree.Integer() as given:
                start = int(given.value)
            case tree.Duration(milliseconds=ms, seconds=None, minutes=None, hours=None, days=None):
                start = int(ms)
            case other:
                raise RefusedError(f"start value {other}")
        for declared in declaration.variables:
            yield str(getattr(declared, "variable", declared).name), (kind, start)


def _f32(value: float) -> float:
    if math.isinf(value) or math.isnan(value):
        raise RefusedError(f"REAL {value}")
    try:
        return float(struct.unpack("<f", struct.pack("<f", value))[0])
    except OverflowError:
        raise RefusedError(f"REAL {value} is too large") from None


def _fit(given: Value, kind: str) -> Any:
    """The value as a variable of `kind` holds it."""
    have, value = given
    if have == "INT_LITERAL" and kind in RANGES:
        low, high = RANGES[kind]
        if not low <= value <= high:
            raise RefusedError(f"{value} does not fit {kind}")
        return value
    if have == "REAL_LITERAL" and kind == "REAL":
        return value
    if have != kind:
        raise RefusedError(f"{have} assigned to {kind}")
    return dict(value) if isinstance(value, dict) else value


def _binary(op: str, left: Value, right: Value) -> Value:
    kind = _common(left, right)
    a, b = _fit(left, kind), _fit(right, kind)
    if op in ("=", "<>", "<", ">", "<=", ">="):
        if kind in ("BOOL",):
            raise RefusedError(f"{op} between BOOLs")
        return "BOOL", {"=": a == b, "<>": a != b, "<": a < b, ">": a > b, "<=": a <= b, ">=": a >= b}[op]
    if op in ("AND", "OR", "XOR") and kind in ("BOOL", "WORD"):
        return kind, {"AND": a & b, "OR": a | b, "XOR": a ^ b}[op]
    if op in ("+", "-", "*", "/") and kind in NUMBERS:
        if kind == "REAL":
            return kind, _f32({"+": a + b, "-": a - b, "*": a * b}[op])
        made = {"+": a + b, "-": a - b, "*": a * b, "/": math.trunc(a / b) if b else None}[op]
        return kind, _fit(("INT_LITERAL", made), kind)
    raise RefusedError(f"{left[0]} {op} {right[0]}")


def _common(left: Value, right: Value) -> str:
    kinds = {left[0], right[0]}
    for literal, default in (("INT_LITERAL", "DINT"), ("REAL_LITERAL", "REAL")):
        kinds = (kinds - {literal}) or {default}
    if len(kinds) != 1:
        raise RefusedError(f"{left[0]} with {right[0]}")
    return kinds.pop()


def _convert(name: str, given: Value) -> Value:
    """A_TO_B of the standard; from a bit string the bits are kept."""
    have, _, want = name.partition("_TO_")
    if want not in NUMBERS or have != given[0]:
        raise RefusedError(f"{name}({given[0]})")
    value = given[1]
    if want == "REAL":
        return want, _f32(float(value))
    if (have, want) == ("WORD", "INT") and value > 0x7FFF:
        value -= 0x10000
    return want, _fit(("INT_LITERAL", value), want)
