"""Rockwell L5X for Studio 5000: Add-On Instructions and their data type, to import into a project. Pure.

Its shape follows the import/export reference of Logix 5000; flags of a data type live in hidden SINTs, eight to each.
Reading and writing is left to what the plant has: a Modbus TCP client instruction of Rockwell's library, or a module.
The instruction is the same for every bay: one instance, one array and one data tag each.
"""

import re
from xml.sax.saxutils import quoteattr

from gateway.modbus.exports import interface, structured_text
from gateway.modbus.exports.approach import APPROACH, SEQUENCE, wired
from gateway.modbus.exports.fields import Field, fields
from gateway.modbus.exports.interface import FunctionBlock, Var
from gateway.modbus.exports.logic import ascii_only, iec
from gateway.modbus.exports.logix import body, off, reset, translated
from gateway.modbus.exports.structured_text import about
from gateway.modbus.exports.target import Target, template
from gateway.modbus.registers.bay_identity import NO_BAY
from gateway.modbus.registers.register_map import BLOCK_WORDS, MAP_VERSION

INSTRUCTION = "LoadingGateway"
INSTRUCTIONS = {APPROACH.name: f"{INSTRUCTION}_Approach", SEQUENCE.name: f"{INSTRUCTION}_Sequence"}
DATA = "LoadingGateway_Data"
# A fixed date, not the clock's: the same table gives the same file.
_EDITED = "2026-01-01T00:00:00.000Z"
_PARAMETERS = {"BOOL": "BOOL", "UINT": "DINT", "INT": "DINT", "UDINT": "DINT", "REAL": "REAL"}
_TYPES = {"UINT": "DINT", "INT": "DINT", "UDINT": "DINT", "REAL": "REAL", "BOOL": "BIT"}


def files(targets: tuple[Target, ...]) -> dict[str, str]:
    """One file an instruction: Assets, Add-On Instructions, Import Add-On Instruction."""
    first = targets[0]
    head = f"{about(targets)}\n   Words is an INT[{BLOCK_WORDS}], as read."
    own, *others = structured_text.blocks(first)
    made = {INSTRUCTION: _text(targets, own, INSTRUCTION, head, off(), body(first))}
    example = f"{head}\n\n   The example, in a periodic task of CycleMs:\n\n{_wired(first.instance)}"
    for block in others:
        name = INSTRUCTIONS[block.name]
        made[name] = _text(targets, block, name, example, reset(block), translated(block.body))
    return {f"{first.identifier}-{_dashed(name)}.L5X": text for name, text in made.items()}


def _wired(bay: str) -> str:
    """The example's calls: each input by its name, then the instruction."""
    text = iec(wired(bay, bay)).replace(f"Data := {bay}.Data, ", "")
    for tag, passed in ((f"{bay}_Sequence", ""), (f"{bay}_Approach", f", {bay}_Data")):
        head, given, tail = re.split(rf"^{tag}\((.*?)\);$", text, flags=re.MULTILINE | re.DOTALL)
        lines = [f"{tag}.{one};" for one in re.split(r",\s+", given)]
        text = head + "\n".join([*lines, f"{INSTRUCTION}{tag.removeprefix(bay)}({tag}{passed});"]) + tail
    return text


def _dashed(name: str) -> str:
    return re.sub(r"_|(?<=[a-z])(?=[A-Z])", "-", name).lower()


def _text(targets: tuple[Target, ...], block: FunctionBlock, name: str, about_it: str, off: str, logic: str) -> str:
    """`off`: what runs while the rung is false, and when the controller starts."""
    bay = targets[0].identity if len(targets) == 1 else NO_BAY  # of several, each instance is told its own
    known = {"UnitId": bay.unit_id, "BayIdentity": bay.number}
    parameters = [
        *_parameter("EnableIn", "Input", "BOOL", "Enable Input - System Defined Parameter", system=True),
        *_parameter("EnableOut", "Output", "BOOL", "Enable Output - System Defined Parameter", system=True),
        *(line for var in block.inputs for line in _input(var, known)),
        *(line for var in block.outputs for line in _output(var)),
    ]
    pair = (_local("Pair", "INT", ' Dimensions="2" Radix="Decimal"'),) if name == INSTRUCTION else ()
    made = template("add_on_instruction.L5X").format(
        instruction=name,
        comment=block.comment,
        data=DATA,
        version=MAP_VERSION,
        edited=_EDITED,
        controller=quoteattr(targets[0].identifier),
        data_type="\n".join(_data_type()),
        help=_cdata(about_it),
        parameters="\n".join(parameters),
        local_tags="\n".join((*pair, *map(_memory, block.memory))),
        off=_routine_lines(off),
        logic=_routine_lines(logic),
    )
    return ascii_only(made)


def _data_type() -> list[str]:
    flags = [field for field in fields() if field.kind == "BOOL"]
    lines = []
    for field in fields():
        if field.kind != "BOOL":
            shape = f'Dimension="0" Radix="{_radix(field.kind)}" Hidden="false"'
            lines += _member(field, f'DataType="{_TYPES[field.kind]}" {shape}')
    for place, field in enumerate(flags):
        hidden = f"ZZZZZZZZZZ{INSTRUCTION}{place // 8}"
        if place % 8 == 0:
            lines.append(
                f'<Member Name="{hidden}" DataType="SINT" Dimension="0" Radix="Decimal" Hidden="true"'
                ' ExternalAccess="Read/Write"/>'
            )
        bit = f'DataType="BIT" Dimension="0" Radix="Decimal" Hidden="false" Target="{hidden}" BitNumber="{place % 8}"'
        lines += _member(field, bit)
    return lines


def _member(field: Field, attributes: str) -> list[str]:
    return [
        f'<Member Name="{field.name}" {attributes} ExternalAccess="Read/Write">',
        _description(field.comment),
        "</Member>",
    ]


def _input(var: Var, known: dict[str, int]) -> list[str]:
    if var.kind == interface.BLOCK:
        return _in_out(var.name, "INT", var.comment, BLOCK_WORDS)
    if var.kind == interface.DATA:
        return _in_out(var.name, DATA, var.comment)
    if var.kind == "TIME":
        return _parameter(f"{var.name}Ms", "Input", "DINT", f"{var.comment}, ms", var.start[2:-2])
    start = str(known.get(var.name, _start(var)))
    return _parameter(var.name, "Input", _PARAMETERS[var.kind], var.comment, start)


def _output(var: Var) -> list[str]:
    if var.kind == interface.DATA:
        return _in_out(var.name, DATA, var.comment)
    return _parameter(var.name, "Output", _PARAMETERS[var.kind], var.comment, _start(var))


def _start(var: Var) -> str:
    return "1" if var.start == "TRUE" else var.start or "0"


def _memory(var: Var) -> str:
    if var.kind in _PARAMETERS:
        return _local(var.name, _PARAMETERS[var.kind], f' Radix="{_radix(var.kind)}"')
    return _local(var.name, {interface.DATA: DATA, interface.TIMER: "FBD_TIMER"}[var.kind])


def _radix(kind: str) -> str:
    return "Float" if kind == "REAL" else "Decimal"


def _parameter(name: str, usage: str, kind: str, meaning: str, start: str = "0", *, system: bool = False) -> list[str]:
    seen = 'Required="false" Visible="false"' if system else 'Required="false" Visible="true"'
    access = "Read/Write" if usage == "Input" and not system else "Read Only"
    lines = [
        f'<Parameter Name="{name}" TagType="Base" DataType="{kind}" Usage="{usage}" Radix="{_radix(kind)}" {seen}'
        f' ExternalAccess="{access}">',
        _description(meaning),
    ]
    if not system:
        lines += [
            f'<DefaultData Format="L5K">\n{_cdata(start)}\n</DefaultData>',
            f'<DefaultData Format="Decorated">\n<DataValue DataType="{kind}" Radix="{_radix(kind)}" Value="{start}"/>\n'
            "</DefaultData>",
        ]
    return [*lines, "</Parameter>"]


def _in_out(name: str, kind: str, meaning: str, size: int | None = None) -> list[str]:
    shape = "" if size is None else f' Dimensions="{size}" Radix="Decimal"'
    return [
        f'<Parameter Name="{name}" TagType="Base" DataType="{kind}"{shape} Usage="InOut" Required="true"'
        ' Visible="true" Constant="false">',
        _description(meaning),
        "</Parameter>",
    ]


def _local(name: str, kind: str, attributes: str = "") -> str:
    return f'<LocalTag Name="{name}" DataType="{kind}"{attributes} ExternalAccess="None"/>'


def _routine_lines(source: str) -> str:
    return "\n".join(f'<Line Number="{n}">\n{_cdata(line)}\n</Line>' for n, line in enumerate(source.splitlines()))


def _description(text: str) -> str:
    return f"<Description>\n{_cdata(text)}\n</Description>"


def _cdata(text: str) -> str:
    return f"<![CDATA[{text.replace(']]>', ']] >')}]]>"
