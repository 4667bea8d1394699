"""IEC 61131-3 structured text: its program organisation units, as records and as text. Pure.

For CODESYS, WAGO, Schneider and OpenPLC: second edition of the standard and nothing vendors disagree on, so that old
tools and matiec take it too. The files of TwinCAT and PLCopen are made from the same records.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from gateway.modbus.exports import interface
from gateway.modbus.exports.approach import APPROACH, EXAMPLE_INPUTS, SEQUENCE, approach, wired
from gateway.modbus.exports.decode import REAL_BODY, UDINT_BODY
from gateway.modbus.exports.diagnosis import MEANING
from gateway.modbus.exports.fields import fields
from gateway.modbus.exports.interface import FIRST_WRITTEN, WRITTEN, FunctionBlock, Var
from gateway.modbus.exports.logic import ascii_only, body, iec
from gateway.modbus.exports.target import Target, one_file
from gateway.modbus.registers.register_map import BLOCK_WORDS, MAP_VERSION

BLOCK = "LG_Block"
WRITE = "LG_Write"
DATA = "ST_LoadingGateway"
FUNCTION_BLOCK = "FB_LoadingGateway"
PROGRAM = "LoadingGateways"
EXAMPLE = "LoadingBayExample"
_KIND = {interface.BLOCK: BLOCK, interface.DATA: DATA, interface.TIMER: "TON"}

Section = tuple[Literal["VAR_INPUT", "VAR_OUTPUT", "VAR"], tuple[Var, ...]]


@dataclass(frozen=True, slots=True)
class Type:
    """A data type: an array, as a declaration names it, or a structure of elementary members."""

    name: str
    of: str | tuple[Var, ...]


@dataclass(frozen=True, slots=True)
class Pou:
    """A function (`returns` is its type), a function block or a program. `body`: statements, each line ended."""

    kind: Literal["FUNCTION", "FUNCTION_BLOCK", "PROGRAM"]
    name: str
    sections: tuple[Section, ...]
    body: str
    returns: str = ""
    comment: str = ""


def types() -> tuple[Type, ...]:
    """In the order that a compiler requires."""
    members = tuple(Var(field.name, field.kind, field.comment) for field in fields())
    arrays = (
        Type(name, f"ARRAY [0..{size - 1}] OF WORD") for name, size in ((BLOCK, BLOCK_WORDS), (WRITE, len(WRITTEN)))
    )
    return *arrays, Type(DATA, members)


def library(target: Target) -> tuple[Pou, ...]:
    """Two functions and the function blocks; they depend on the target's word order and timeouts only."""
    words = (Var("High", "WORD", ""), Var("Low", "WORD", ""))
    real = (Var("Exponent", "DINT", ""), Var("Value", "REAL", ""))
    return (
        Pou("FUNCTION", "LG_UDInt", (("VAR_INPUT", words),), iec(UDINT_BODY), "UDINT", "Two words as one number."),
        Pou(
            "FUNCTION",
            "LG_Real",
            (("VAR_INPUT", words), ("VAR", real)),
            iec(REAL_BODY),
            "REAL",
            "Two words as an IEEE 754 float; 0.0 for what is no number.",
        ),
        *map(_function_block, blocks(target)),
    )


def blocks(target: Target) -> tuple[FunctionBlock, ...]:
    """The function blocks of every format: the gateway's, the approach's, and the example's."""
    comment = (
        "Checks the block of the loading gateway. InPlace is the only condition for loading; MayMove is for the truck."
    )
    own = FunctionBlock(FUNCTION_BLOCK, interface.INPUTS, interface.OUTPUTS, interface.MEMORY, body(target), comment)
    return own, approach(target.wait_s), SEQUENCE


def _function_block(block: FunctionBlock) -> Pou:
    sections: tuple[Section, ...] = (
        ("VAR_INPUT", _typed(block.inputs)),
        ("VAR_OUTPUT", _typed(block.outputs)),
        ("VAR", _typed(block.memory)),
    )
    return Pou("FUNCTION_BLOCK", block.name, sections, iec(block.body), comment=block.comment)


def program(targets: tuple[Target, ...]) -> Pou:
    """One instance a bay, for tools whose Modbus channels are mapped to variables."""
    return Pou(
        "PROGRAM",
        PROGRAM,
        tuple(("VAR", _mapped(target.instance)) for target in targets),
        "\n".join(called(target) for target in targets),
        comment="Map each bay's channels to its variables. Set the inputs of its instance, and use its outputs,"
        f" anywhere:\n   {PROGRAM}.{targets[0].instance}.InPlace is the only condition for loading.",
    )


def example(target: Target, *, polled: bool) -> Pou:
    """A program that drives and loads. `polled`: another program calls the gateway's block."""
    bay = target.instance
    own = () if polled else _mapped(bay)
    drives = (Var(f"{bay}_Approach", APPROACH.name, ""), Var(f"{bay}_Sequence", SEQUENCE.name, "outputs for the plant"))
    calls = "" if polled else called(target)
    return Pou(
        "PROGRAM",
        EXAMPLE,
        (("VAR", (*own, *drives, *EXAMPLE_INPUTS)),),
        calls + iec(wired(bay, f"{PROGRAM}.{bay}" if polled else f"#{bay}")),
        comment=f"An example of a bay with a drive. Call it {'after' if polled else 'instead of'} {PROGRAM}, from a"
        " cyclic task of CycleMs.",
    )


def instance(bay: str) -> tuple[Var, ...]:
    """The variables that every program has for a bay."""
    return (
        Var(bay, FUNCTION_BLOCK, f"inputs and outputs of {bay}"),
        Var(f"{bay}_Words", BLOCK, f"registers 0 to {BLOCK_WORDS - 1}, read in one request"),
        Var(
            f"{bay}_Write",
            WRITE,
            f"registers {FIRST_WRITTEN} to {FIRST_WRITTEN + 2}, to be written",
        ),
    )


def right_bay(target: Target) -> str:
    """The inputs by which the function block knows its bay."""
    return f"UnitId := {target.identity.unit_id}, BayIdentity := UDINT#{target.identity.number}"


def called(target: Target) -> str:
    """The call of a bay's instance, and what is to be written after it."""
    bay = target.instance
    lines = [f"{bay}(PollOk := {bay}_PollOk, Words := {bay}_Words,\n  {right_bay(target)});"]
    lines += [f"{bay}_Write[{place}] := UINT_TO_WORD({bay}.{name});" for place, name in enumerate(WRITTEN)]
    return "\n".join(lines) + "\n"


def type_text(made: Type) -> str:
    """The declaration, `TYPE` to `END_TYPE`."""
    if isinstance(made.of, str):
        return f"TYPE {made.name} : {made.of};\nEND_TYPE\n"
    members = "\n".join(f"  {member.name} : {member.kind}; (* {member.comment} *)" for member in made.of)
    return f"TYPE {made.name} : STRUCT\n{members}\nEND_STRUCT;\nEND_TYPE\n"


def declaration(unit: Pou) -> str:
    """The head with all variables, without body and end."""
    comment = f"(* {unit.comment} *)\n" if unit.comment else ""
    head = f"{unit.kind} {unit.name}" + (f" : {unit.returns}" if unit.returns else "")
    return "\n".join([comment + head, *_sections(unit)]) + "\n"


def text(unit: Pou) -> str:
    """The complete unit."""
    return f"{declaration(unit)}{unit.body}END_{unit.kind}\n"


def _sections(unit: Pou) -> Iterator[str]:
    for keyword, variables in unit.sections:
        yield keyword
        for var in variables:
            start = f" := {var.start}" if var.start else ""
            yield f"  {var.name} : {var.kind}{start};" + (f" (* {var.comment} *)" if var.comment else "")
        yield "END_VAR"


def _typed(variables: tuple[Var, ...]) -> tuple[Var, ...]:
    return tuple(Var(var.name, _KIND.get(var.kind, var.kind), var.comment, var.start) for var in variables)


def _mapped(bay: str) -> tuple[Var, ...]:
    poll = Var(f"{bay}_PollOk", "BOOL", "FALSE while your client reports an error, if it does", "TRUE")
    return (*instance(bay), poll)


def document(targets: tuple[Target, ...]) -> str:
    """Types, functions, function blocks, a program with one instance a bay, and the example."""
    programs = program(targets), example(targets[0], polled=False)
    return "\n".join((declarations(targets), *(ascii_only(text(made)) for made in programs)))


def declarations(targets: tuple[Target, ...]) -> str:
    """All but the program, in the order that a compiler requires."""
    made = (*map(type_text, types()), *map(text, library(targets[0])))
    return ascii_only("\n".join((_head(targets), *made)))


def about(targets: tuple[Target, ...]) -> str:
    """The head of every program of this kind: which gateway, what to poll, what the outputs are for."""
    first = targets[0]
    bays = "\n".join(
        f"     {target.bay}: {target.host}, port {target.port}, unit id {target.unit_id},"
        f" identity {target.identity.number} ({target.site}/{target.gateway}/{target.bay})"
        for target in targets
    )
    codes = "\n".join(f"   {code:>2}  {meaning}" for code, (_, meaning) in MEANING.items())
    return f"""\
Loading gateway: map version {MAP_VERSION}, word order "{first.word_order}".
{bays}

   InPlace is the only condition for loading. MayMove lets the truck move; loading while it is on would be loading
   a truck that moves. Both are FALSE while any check fails; Diagnostic is the number of that check:
{codes}

   Read {BLOCK_WORDS} registers from address 0, function code 3 or 4, in ONE request, every 50 to 100 ms, and call the
   function block in every cycle. While MayWrite, write {", ".join(WRITTEN)}
   to the registers from {FIRST_WRITTEN} on, together, function code 16, as often."""


def _head(targets: tuple[Target, ...]) -> str:
    return f"(* {about(targets)}\n   Generated by: gateway registers --format st. Do not edit; export again. *)\n"


files = one_file("{}-loading-gateway.st", document)
