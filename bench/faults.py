"""Faults for `bench.mutation`: made from the modules' source, and planted in a process that runs tests."""

import difflib
import random
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from importlib import import_module, util
from importlib.machinery import ModuleSpec, SourceFileLoader
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

ROOT = Path(__file__).parents[1]
FOLDERS = ("gateway/core", "gateway/modbus/registers")


@dataclass(frozen=True, eq=False)
class Fault:
    """`function`: `step`, `Rules.of`. `tree`, `mutation`: the module's syntax, and the place in it, for mutmut."""

    module: str
    function: str
    number: int
    tree: Any = field(repr=False)
    mutation: Any = field(repr=False)

    @property
    def name(self) -> str:
        return f"{short(self.module)}.{self.function}.{self.number}"

    @property
    def source(self) -> str:
        """The module's text with the fault in it."""
        text: str = _mutmut().deep_replace(self.tree, self.mutation.original_node, self.mutation.mutated_node).code
        return text

    def change(self) -> str:
        """The changed lines, with some around them."""
        lines = path_of(self.module).read_text().splitlines()
        return "\n".join(list(difflib.unified_diff(lines, self.source.splitlines(), lineterm="", n=2))[2:])


def short(module: str) -> str:
    """`gateway.modbus.registers.bits` -> `registers.bits`."""
    return module.removeprefix("gateway.").removeprefix("modbus.")


def path_of(module: str) -> Path:
    return ROOT / f"{module.replace('.', '/')}.py"


def modules() -> list[str]:
    files = (file for folder in FOLDERS for file in sorted((ROOT / folder).glob("*.py")) if file.stem != "__init__")
    return [".".join(file.relative_to(ROOT).with_suffix("").parts) for file in files]


def faults_of(module: str) -> list[Fault]:
    """Every fault that mutmut makes of the functions of `module`, numbered by function."""
    file = path_of(module)
    tree, mutations, *_ = _mutmut().create_mutations(str(file), file.read_text())
    names: dict[Any, str] = {}
    for outer in tree.body:
        inside = outer.body.body if _is(outer, "ClassDef") else ()
        names |= {node: f"{outer.name.value}.{node.name.value}" for node in inside if _is(node, "FunctionDef")}
        if _is(outer, "FunctionDef"):
            names[outer] = outer.name.value
    counts: Counter[str] = Counter()
    found = []
    for mutation in mutations:
        function = names.get(mutation.contained_by_top_level_function)
        if function is not None:
            counts[function] += 1
            found.append(Fault(module, function, counts[function], tree, mutation))
    return found


def _mutmut() -> Any:
    return import_module("mutmut.mutation.file_mutation")  # of the dependency group `mutation`


def _is(node: Any, kind: str) -> bool:
    return type(node).__name__ == kind


def chosen(faults: Iterable[Fault], sample: int, seed: int) -> list[Fault]:
    """So many of each module, 0: all; the same ones whichever modules are examined."""
    by_module: dict[str, list[Fault]] = {}
    for fault in faults:
        by_module.setdefault(fault.module, []).append(fault)
    found: list[Fault] = []
    for module, all_of_it in by_module.items():
        chance = random.Random(f"{seed} {module}")
        found += chance.sample(all_of_it, min(sample, len(all_of_it))) if sample else all_of_it
    return found


def plant(fault: Fault) -> None:
    """Exchanges the code of the function in its module, which is imported: for everyone who has imported it, too."""
    module = import_module(fault.module)
    changed = dict(vars(module))
    exec(compile(fault.source, path_of(fault.module), "exec"), changed)
    function, other = _function(vars(module), fault.function), _function(changed, fault.function)
    function.__code__ = other.__code__
    if repr((function.__defaults__, function.__kwdefaults__)) != repr((other.__defaults__, other.__kwdefaults__)):
        function.__defaults__, function.__kwdefaults__ = other.__defaults__, other.__kwdefaults__


def _function(names: dict[str, Any], qualified: str) -> FunctionType:
    owner, _, name = qualified.rpartition(".")
    found = vars(names[owner])[name] if owner else names[name]
    function: FunctionType = getattr(found, "__func__", found)
    return function


class PlantedImport(SourceFileLoader):
    """For `sys.meta_path`: imports the module with its fault."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault.module, str(path_of(fault.module)))
        self._fault = fault

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        return util.spec_from_loader(fullname, self) if fullname == self._fault.module else None

    def get_code(self, fullname: str) -> CodeType:
        code: CodeType = compile(self._fault.source, self.path, "exec")
        return code
