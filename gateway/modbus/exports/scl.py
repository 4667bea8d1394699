"""Siemens SCL for TIA Portal: one external source with data types, functions, the function block and its calls. Pure.

For S7-1500 and S7-1200 from firmware 4.2, which bring MB_CLIENT for Modbus TCP.
"""

from collections.abc import Iterable

from gateway.modbus.exports import interface, structured_text
from gateway.modbus.exports.approach import APPROACH, EXAMPLE_INPUTS, SEQUENCE, wired
from gateway.modbus.exports.clients import PAUSE_MS, octets
from gateway.modbus.exports.decode import REAL_BODY, UDINT_BODY
from gateway.modbus.exports.fields import fields
from gateway.modbus.exports.interface import FIRST_WRITTEN, WRITTEN, FunctionBlock, Var
from gateway.modbus.exports.logic import ascii_only
from gateway.modbus.exports.target import Target, one_file, template
from gateway.modbus.registers.register_map import BLOCK_WORDS

DATA = "LoadingGateway_Data"
BUFFERS = "LoadingGateway_IO"
CYCLE = structured_text.PROGRAM
INSTANCE = f"{CYCLE}_DB"
_HARDWARE = 64  # PROFINET interface X1 of every S7-1200 and S7-1500
_SECTION = {"VAR_INPUT": "VAR_INPUT", "VAR": "VAR_TEMP"}
_KIND = {
    "WORD": "Word",
    "UINT": "UInt",
    "INT": "Int",
    "UDINT": "UDInt",
    "DINT": "DInt",
    "REAL": "Real",
    "BOOL": "Bool",
    "TIME": "Time",
    interface.BLOCK: f"Array[0..{BLOCK_WORDS - 1}] of Word",
    interface.DATA: f'"{DATA}"',
    interface.TIMER: "TON_TIME",
    **{block.name: f'"{block.name}"' for block in (APPROACH, SEQUENCE)},
}


def text(targets: tuple[Target, ...]) -> str:
    """The .scl file: External source files, Add new external file, Generate blocks from source."""
    parts = (
        _head(targets),
        _type(),
        _functions(targets[0]),
        *map(_function_block, structured_text.blocks(targets[0])),
        _buffers(targets),
        _cycle(targets),
        _example(targets[0]),
    )
    return ascii_only("\n".join(parts))


def _head(targets: tuple[Target, ...]) -> str:
    about = "\n".join(f"// {line}".rstrip() for line in structured_text.about(targets).splitlines())
    return template("head.scl").format(
        about=about, instance=INSTANCE, bay=targets[0].instance, buffers=BUFFERS, hardware=_HARDWARE
    )


def _type() -> str:
    members = "\n".join(f"    {field.name} : {_KIND[field.kind]};   // {field.comment}" for field in fields())
    return f"""\
TYPE "{DATA}"
VERSION : 0.1
  STRUCT
{members}
  END_STRUCT;
END_TYPE
"""


def _functions(target: Target) -> str:
    """The functions of structured text, in SCL's words."""
    return "\n".join(
        f"""\
FUNCTION "{made.name}" : {_KIND[made.returns]}
{{ S7_Optimized_Access := 'TRUE' }}
VERSION : 0.1
{_sections((_SECTION[keyword], variables) for keyword, variables in made.sections)}BEGIN
{body}END_FUNCTION
"""
        for made, body in zip(structured_text.library(target), (UDINT_BODY, REAL_BODY), strict=False)
    )


def _sections(sections: Iterable[tuple[str, Iterable[Var]]]) -> str:
    return "".join(f"  {keyword}\n{''.join(map(_variable, variables))}  END_VAR\n" for keyword, variables in sections)


def _function_block(block: FunctionBlock) -> str:
    given = [var for var in block.inputs if var.kind != interface.BLOCK]
    passed = [var for var in block.inputs if var.kind == interface.BLOCK]
    sections = ("VAR_INPUT", given), ("VAR_OUTPUT", block.outputs), ("VAR_IN_OUT", passed), ("VAR", block.memory)
    return _unit(block.name, _sections(section for section in sections if section[1]), block.body)


def _unit(name: str, sections: str, body: str) -> str:
    return f"""\
FUNCTION_BLOCK "{name}"
{{ S7_Optimized_Access := 'TRUE' }}
VERSION : 0.1
{sections}BEGIN
{body}END_FUNCTION_BLOCK
"""


def _example(target: Target) -> str:
    """As structured_text.example, to be called in a cyclic interrupt of CycleMs."""
    bay = target.instance
    drives = Var(f"{bay}_Approach", APPROACH.name, ""), Var(f"{bay}_Sequence", SEQUENCE.name, "outputs for the plant")
    sections = _sections((("VAR_INPUT", EXAMPLE_INPUTS), ("VAR", drives)))
    return _unit(structured_text.EXAMPLE, sections, wired(bay, f'"{INSTANCE}".{bay}'))


def _variable(var: Var) -> str:
    version = " {InstructionName := 'TON_TIME'; LibVersion := '1.0'}" if var.kind == interface.TIMER else ""
    start = f" := {var.start}" if var.start else ""
    comment = f"   // {var.comment}" if var.comment else ""
    return f"    {var.name}{version} : {_KIND[var.kind]}{start};{comment}\n"


def _buffers(targets: tuple[Target, ...]) -> str:
    members, starts = [], []
    for number, target in enumerate(targets, 1):
        bay = target.instance
        members += [
            f"    {bay}_Words : Array[0..{BLOCK_WORDS - 1}] of Word;   // registers 0 to {BLOCK_WORDS - 1}",
            f"    {bay}_Write : Array[0..{len(WRITTEN) - 1}] of Word;   // registers {FIRST_WRITTEN} on",
            f"    {bay}_Connection : TCON_IP_v4;",
        ]
        starts += [
            f"  {bay}_Connection.InterfaceId := {_HARDWARE};",
            f"  {bay}_Connection.ID := {number};",
            f"  {bay}_Connection.ConnectionType := 16#0B;",
            f"  {bay}_Connection.ActiveEstablished := TRUE;",
            *(f"  {bay}_Connection.RemoteAddress.ADDR[{n}] := {octet};" for n, octet in enumerate(octets(target), 1)),
            f"  {bay}_Connection.RemotePort := {target.port};",
        ]
    return "\n".join(
        [
            f'DATA_BLOCK "{BUFFERS}"',
            "{ S7_Optimized_Access := 'FALSE' }",
            "VERSION : 0.1",
            "NON_RETAIN",
            "  STRUCT",
            *members,
            "  END_STRUCT;",
            "BEGIN",
            *starts,
            "END_DATA_BLOCK",
            "",
        ]
    )


def _cycle(targets: tuple[Target, ...]) -> str:
    variables = template("cycle_variables.scl")
    return template("cycle.scl").format(
        cycle=CYCLE,
        instance=INSTANCE,
        variables="\n".join(variables.format(bay=t.instance, block=structured_text.FUNCTION_BLOCK) for t in targets),
        bays="".join(map(_bay, targets)),
    )


def _bay(target: Target) -> str:
    """Read; then write, if the gateway takes writes; then pause. REQ stays TRUE until the job has ended."""
    bay, buffers = target.instance, f'"{BUFFERS}".{target.instance}'
    given = (f"{buffers}_Write[{n}] := UINT_TO_WORD(#{bay}.{name});" for n, name in enumerate(WRITTEN))
    return template("mb_client.scl").format(
        name=target.bay,
        bay=bay,
        buffers=buffers,
        pause=PAUSE_MS,
        unit=target.unit_id,
        first=FIRST_WRITTEN,
        written=len(WRITTEN),
        words=BLOCK_WORDS,
        right_bay=structured_text.right_bay(target),
        given="\n".join(given),
    )


files = one_file("{}-loading-gateway.scl", text)
