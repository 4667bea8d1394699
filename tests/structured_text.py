"""Runs IEC 61131-3 structured text from the tree that blark's parser makes of it: for tests only.

This is no compiler and proves nothing about one. It shows that the program's logic does what its comments say. It is
stricter than most tools: it knows only what the generated programs use, mixes no types by itself, refuses numbers that
do not fit their type, computes REAL in 32 bits, and raises on everything else.
"""

import math
import operator
import pickle
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from operator import itemgetter
from typing import Any

import blark.parse
from blark import transform as tree

from tests.kept import made_once

Variables = dict[str, Any]
Code = Callable[[Variables], Any]
Typed = tuple[str, Code]
"""(IEC type, what computes the value). The types INT_LITERAL and REAL_LITERAL take on the type of the other side, and
their code needs no variables."""
NOW_MS = "@now_ms"  # beside the variables, whose names have no @

RANGES = {
    "UINT": (0, 0xFFFF),
    "INT": (-0x8000, 0x7FFF),
    "UDINT": (0, 0xFFFF_FFFF),
    "DINT": (-0x8000_0000, 0x7FFF_FFFF),
    "WORD": (0, 0xFFFF),
}
DEFAULTS: dict[str, Any] = {**dict.fromkeys(RANGES, 0), "REAL": 0.0, "BOOL": False, "TIME": 0}
NUMBERS = ("UINT", "INT", "UDINT", "DINT", "REAL")
LONG = 1000  # characters of a text whose tree is kept
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
    """blark's tree. Raises what its grammar refuses. Takes seconds, an Earley parser: hence the caches."""
    if len(source) < LONG:
        return _tree(source)
    kept = made_once(
        "tree", lambda file: file.write_bytes(pickle.dumps(_tree(source))), source.encode(), version("blark").encode()
    )
    return pickle.loads(kept.read_bytes())


def _tree(source: str) -> Any:
    return blark.parse.parse_source_code(source).transform()


class Program:
    """The types, functions, function blocks and programs of sources; `instance` makes a block or a program to call."""

    def __init__(self, *sources: str) -> None:
        self.structs: dict[str, dict[str, tuple[str, Any]]] = {}
        self.arrays: dict[str, tuple[int, int, str]] = {}
        self.functions: dict[str, Any] = {}
        self.blocks: dict[str, Any] = {}
        self.programs: dict[str, Any] = {}
        for item in (item for source in sources for item in parse(source).items):
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
                    self.programs[str(item.name)] = item
                case _:
                    raise RefusedError(type(item).__name__)
        self._units: dict[str, Unit] = {}

    def instance(self, name: str) -> "Instance":
        return Instance(self.unit(name, self.blocks[name] if name in self.blocks else self.programs[name]))

    def unit(self, name: str, declared: Any) -> "Unit":
        """Translated once, and only where it is used."""
        if name not in self._units:
            self._units[name] = Unit(self, name, declared)
        return self._units[name]

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
        if kind in self.blocks:
            return self.instance(kind)
        raise RefusedError(f"unknown type {kind}")


class Instance:
    """One function block with its variables."""

    def __init__(self, unit: "Unit") -> None:
        self._unit = unit
        self.values = unit.start()

    def call(self, now_ms: int, **inputs: Any) -> None:
        """One cycle."""
        for name, value in inputs.items():
            if name not in self._unit.types:
                raise RefusedError(f"no input {name}")
            self.values[name] = value
        self.values[NOW_MS] = now_ms
        self._unit.body(self.values)

    def __getitem__(self, name: str) -> Any:
        return self.values[name]


class Unit:
    """A function block or a function, translated to functions of its variables: types are compared here, once."""

    def __init__(self, program: Program, name: str, declared: Any) -> None:
        self._program = program
        self.types: dict[str, str] = {}
        self._starts: dict[str, Any] = {}
        for group in declared.declarations:
            for variable, (kind, start) in _members(group.items):
                if variable in self.types:
                    raise RefusedError(f"{variable} is declared twice")
                self.types[variable], self._starts[variable] = kind, start
        if isinstance(declared, tree.Function):  # its name is the variable that it returns
            self.types[name] = kind = str(declared.return_type.type.type)
            self._starts[name] = DEFAULTS[kind]
        self.body = self._block(declared.body)

    def start(self) -> Variables:
        return {
            name: self._program.initial(kind) if kind not in DEFAULTS else self._starts[name]
            for name, kind in self.types.items()
        }

    def _type_of(self, name: str) -> str:
        try:
            return self.types[name]
        except KeyError:
            raise RefusedError(f"{name} is not declared") from None

    def _block(self, statements: Any) -> Code:
        steps = [self._statement(statement) for statement in statements.statements]

        def run(values: Variables) -> None:
            for step in steps:
                step(values)

        return run

    def _statement(self, statement: Any) -> Code:
        match statement:
            case tree.AssignmentStatement(variables=[target]):
                return self._assignment(target, self._value(statement.expression))
            case tree.IfStatement():
                return self._if(statement)
            case tree.WhileStatement():
                return self._while(statement)
            case tree.FunctionCallStatement():
                return self._block_call(statement)
            case _:
                raise RefusedError(type(statement).__name__)

    def _if(self, statement: Any) -> Code:
        clauses = (statement, *statement.else_ifs)
        choices = [(self._bool(each.if_expression), self._block(each.statements)) for each in clauses]
        if statement.else_clause is not None:
            choices.append((lambda _: True, self._block(statement.else_clause.statements)))

        def run(values: Variables) -> None:
            for holds, block in choices:
                if holds(values):
                    block(values)
                    return

        return run

    def _while(self, statement: Any) -> Code:
        holds, block = self._bool(statement.expression), self._block(statement.statements)

        def run(values: Variables) -> None:
            for _ in range(MAX_TURNS):
                if not holds(values):
                    return
                block(values)
            raise RefusedError("a loop that does not end")

        return run

    def _block_call(self, statement: Any) -> Code:
        name = str(statement.name.name)
        given = {str(p.name.name): self._value(p.value) for p in statement.parameters}
        if (block := self._block_of(name)) is not None:
            inputs = {key: _fit(value, block._type_of(key)) for key, value in given.items()}
            return lambda values: values[name].call(
                values[NOW_MS], **{key: code(values) for key, code in inputs.items()}
            )
        kinds = {key: kind for key, (kind, _) in given.items()}
        if self._type_of(name) != "TON" or kinds != {"IN": "BOOL", "PT": "TIME"}:
            raise RefusedError(f"call of {name}")
        on, preset_ms = given["IN"][1], given["PT"][1]
        return lambda values: values[name].call(on(values), preset_ms(values), values[NOW_MS])

    def _block_of(self, name: str) -> "Unit | None":
        """Of a variable that is a function block of the program; None: it is something else."""
        declared = self._program.blocks.get(kind := self._type_of(name))
        return None if declared is None else self._program.unit(kind, declared)

    def _bool(self, expression: Any) -> Code:
        kind, code = self._value(expression)
        if kind != "BOOL":
            raise RefusedError(f"{kind} as a condition")
        return code

    def _assignment(self, target: Any, given: Typed) -> Code:
        match target:
            case tree.SimpleVariable():
                name = str(target.name)
                code = _fit(given, self._type_of(name))
                if given[0] in self._program.structs:
                    return lambda values: values.update({name: dict(code(values))})
                return lambda values: values.update({name: code(values)})
            case tree.MultiElementVariable(elements=[tree.FieldSelector(field=field)]):
                whole, member = str(target.name.name), str(field.name)
                if (block := self._block_of(whole)) is not None:
                    code = _fit(given, block._type_of(member))
                    return lambda values: values[whole].values.update({member: code(values)})
                code = _fit(given, self._program.structs[self._type_of(whole)][member][0])
                return lambda values: values[whole].update({member: code(values)})
            case tree.MultiElementVariable(elements=[tree.SubscriptList(subscripts=[tree.Integer() as place])]):
                whole, (n, of) = str(target.name.name), self._place(str(target.name.name), place)
                code = _fit(given, of)
                return lambda values: values[whole].__setitem__(n, code(values))
            case _:
                raise RefusedError(f"assignment to {target}")

    def _value(self, node: Any) -> Typed:  # noqa: PLR0911, PLR0912  # one case a kind of expression
        match node:
            case tree.HexInteger():
                return "INT_LITERAL", _always(int(str(node.value), 16))
            case tree.Integer(type_name=None):
                return "INT_LITERAL", _always(int(node.value))
            case tree.Integer():
                return str(node.type_name), _fit(("INT_LITERAL", _always(int(node.value))), str(node.type_name))
            case tree.Real(type_name=None):
                return "REAL_LITERAL", _always(_f32(float(node.value)))
            case tree.Boolean():
                return "BOOL", _always(str(node.value) == "TRUE")
            case tree.Duration(milliseconds=ms, seconds=None, minutes=None, hours=None, days=None):
                return "TIME", _always(int(ms))
            case tree.ParenthesizedExpression():
                return self._value(node.expr)
            case tree.SimpleVariable():
                return self._type_of(str(node.name)), itemgetter(str(node.name))
            case tree.MultiElementVariable(elements=[element]):
                return self._element(str(node.name.name), element)
            case tree.UnaryOperation(op="NOT"):
                code = self._bool(node.expr)
                return "BOOL", lambda values: not code(values)
            case tree.FunctionCall():
                return self._call(node)
            case tree.BinaryOperation():
                return _binary(str(node.op), self._value(node.left), self._value(node.right))
            case _:
                raise RefusedError(f"{type(node).__name__}: {node}")

    def _element(self, name: str, element: Any) -> Typed:
        kind = self._type_of(name)
        match element:
            case tree.FieldSelector() if kind == "TON" and str(element.field.name) == "Q":
                return "BOOL", lambda values: values[name].Q
            case tree.FieldSelector() if kind in self._program.structs:
                member = str(element.field.name)
                return self._program.structs[kind][member][0], lambda values: values[name][member]
            case tree.FieldSelector() if (block := self._block_of(name)) is not None:
                member = str(element.field.name)
                return block._type_of(member), lambda values: values[name][member]
            case tree.SubscriptList(subscripts=[tree.Integer() as place]) if kind in self._program.arrays:
                n, of = self._place(name, place)
                return of, lambda values: values[name][n]
            case _:
                raise RefusedError(f"{name}{element}")

    def _place(self, name: str, place: Any) -> tuple[int, str]:
        """Of an array's element: its number from 0 on, and its type."""
        low, high, of = self._program.arrays[self._type_of(name)]
        n = int(place.value) - low
        if not 0 <= n <= high - low:
            raise RefusedError(f"{name}[{place.value}] lies outside of {low}..{high}")
        return n, of

    def _call(self, node: Any) -> Typed:
        name = str(node.name.name)
        if name not in self._program.functions:
            (parameter,) = node.parameters
            return _convert(name, self._value(parameter.value))
        unit = self._program.unit(name, self._program.functions[name])
        given = {
            (key := str(parameter.name.name)): _fit(self._value(parameter.value), unit._type_of(key))
            for parameter in node.parameters
        }

        def run(values: Variables) -> Any:
            made = unit.start() | {key: code(values) for key, code in given.items()}
            unit.body(made)
            return made[name]

        return unit.types[name], run


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
            case tree.Real() as given:
                start = _f32(float(given.value))
            case tree.Duration(milliseconds=ms, seconds=None, minutes=None, hours=None, days=None):
                start = int(ms)
            case other:
                raise RefusedError(f"start value {other}")
        for declared in declaration.variables:
            yield str(getattr(declared, "variable", declared).name), (kind, start)


def _always(value: Any) -> Code:
    return lambda _: value


def _f32(value: float) -> float:
    if math.isinf(value) or math.isnan(value):
        raise RefusedError(f"REAL {value}")
    try:
        return float(struct.unpack("<f", struct.pack("<f", value))[0])
    except OverflowError:
        raise RefusedError(f"REAL {value} is too large") from None


def _ranged(value: int, kind: str) -> int:
    low, high = RANGES[kind]
    if not low <= value <= high:
        raise RefusedError(f"{value} does not fit {kind}")
    return value


def _fit(given: Typed, kind: str) -> Code:
    """The value as a variable of `kind` holds it."""
    have, code = given
    if have == "INT_LITERAL" and kind in RANGES:
        return _always(_ranged(code({}), kind))
    if have != kind and (have, kind) != ("REAL_LITERAL", "REAL"):
        raise RefusedError(f"{have} assigned to {kind}")
    return code


COMPARISONS = {
    "=": operator.eq, "<>": operator.ne, "<": operator.lt, ">": operator.gt, "<=": operator.le, ">=": operator.ge,
}  # fmt: skip
BITWISE = {"AND": operator.and_, "OR": operator.or_, "XOR": operator.xor}
ARITHMETIC: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": lambda a, b: math.trunc(a / b),
}  # fmt: skip


def _binary(op: str, left: Typed, right: Typed) -> Typed:
    kind = _common(left, right)
    a, b = _fit(left, kind), _fit(right, kind)
    if op in COMPARISONS and kind != "BOOL":
        compared = COMPARISONS[op]
        return "BOOL", lambda values: compared(a(values), b(values))
    if op in BITWISE and kind in ("BOOL", "WORD"):
        joined = BITWISE[op]
        return kind, lambda values: joined(a(values), b(values))
    if op in ARITHMETIC and kind in NUMBERS:
        made = operator.truediv if (kind, op) == ("REAL", "/") else ARITHMETIC[op]
        if kind == "REAL":
            return kind, lambda values: _f32(made(a(values), b(values)))
        return kind, lambda values: _ranged(made(a(values), b(values)), kind)
    raise RefusedError(f"{left[0]} {op} {right[0]}")


def _common(left: Typed, right: Typed) -> str:
    kinds = {left[0], right[0]}
    for literal, default in (("INT_LITERAL", "DINT"), ("REAL_LITERAL", "REAL")):
        kinds = (kinds - {literal}) or {default}
    if len(kinds) != 1:
        raise RefusedError(f"{left[0]} with {right[0]}")
    return kinds.pop()


def _convert(name: str, given: Typed) -> Typed:
    """A_TO_B of the standard; from a bit string the bits are kept."""
    have, _, want = name.partition("_TO_")
    if want not in (*NUMBERS, "WORD") or have != given[0]:
        raise RefusedError(f"{name}({given[0]})")
    code = given[1]
    if want == "REAL":
        return want, lambda values: _f32(float(code(values)))
    if have == "REAL":  # to even, as the standard has it
        return want, lambda values: _ranged(round(code(values)), want)
    if (have, want) == ("WORD", "INT"):
        return want, lambda values: (word := code(values)) - (0x10000 if word > 0x7FFF else 0)
    return want, lambda values: _ranged(code(values), want)
