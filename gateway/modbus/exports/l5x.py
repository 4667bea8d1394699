"""Rockwell L5X for Studio 5000: an Add-On Instruction and its data type, to import into a project. Pure.

Its shape follows the import/export reference of Logix 5000; flags of a data type live in hidden SINTs, eight to each.
Reading and writing is left to what the plant has: a Modbus TCP client instruction of Rockwell's library, or a module.
The instruction is the same for every bay: one instance, one array and one data tag each.
"""

from xml.sax.saxutils import quoteattr

from gateway.modbus.exports import interface
from gateway.modbus.exports.diagnosis import HEARTBEAT_TIMEOUT_MS
from gateway.modbus.exports.fields import Field, fields
from gateway.modbus.exports.interface import INPUTS, MEMORY, OUTPUTS, Var
from gateway.modbus.exports.logic import ascii_only
from gateway.modbus.exports.logix import body, off
from gateway.modbus.exports.structured_text import about
from gateway.modbus.exports.target import Target, one_file, template
from gateway.modbus.registers.bay_identity import NO_BAY
from gateway.modbus.registers.register_map import BLOCK_WORDS, MAP_VERSION

INSTRUCTION = "LoadingGateway"
DATA = "LoadingGateway_Data"
# A fixed date, not the clock's: the same table gives the same file.
_EDITED = "2026-01-01T00:00:00.000Z"
_PARAMETERS = {"BOOL": "BOOL", "UINT": "DINT", "UDINT": "DINT"}
_TYPES = {"UINT": "DINT", "INT": "DINT", "UDINT": "DINT", "REAL": "REAL", "BOOL": "BIT"}


def text(targets: tuple[Target, ...]) -> str:
    """The .L5X file: Assets, Add-On Instructions, Import Add-On Instruction."""
    bay = targets[0].identity if len(targets) == 1 else NO_BAY  # of several, each instance is told its own
    known = {"UnitId": bay.unit_id, "BayIdentity": bay.number}
    parameters = [
        *_parameter("EnableIn", "Input", "BOOL", "Enable Input - System Defined Parameter", system=True),
        *_parameter("EnableOut", "Output", "BOOL", "Enable Output - System Defined Parameter", system=True),
        *(line for var in INPUTS for line in _input(var, known)),
        *(line for var in OUTPUTS for line in _output(var)),
    ]
    made = template("add_on_instruction.L5X").format(
        instruction=INSTRUCTION,
        data=DATA,
        version=MAP_VERSION,
        edited=_EDITED,
        controller=quoteattr(targets[0].identifier),
        data_type="\n".join(_data_type()),
        help=_cdata(f"{about(targets)}\n   Words is an INT[{BLOCK_WORDS}], as read."),
        parameters="\n".join(parameters),
        local_tags="\n".join((_local("Pair", "INT", ' Dimensions="2" Radix="Decimal"'), *map(_memory, MEMORY))),
        off=_routine_lines(off()),
        logic=_routine_lines(body(targets[0])),
    )
    return ascii_only(made)


def _data_type() -> list[str]:
    flags = [field for field in fields() if field.kind == "BOOL"]
    lines = []
    for field in fields():
        if field.kind != "BOOL":
            radix = "Float" if field.kind == "REAL" else "Decimal"
            lines += _member(field, f'DataType="{_TYPES[field.kind]}" Dimension="0" Radix="{radix}" Hidden="false"')
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
    if var.kind == "TIME":
        return _parameter(f"{var.name}Ms", "Input", "DINT", f"{var.comment}, ms", HEARTBEAT_TIMEOUT_MS)
    return _parameter(var.name, "Input", _PARAMETERS[var.kind], var.comment, known.get(var.name, _start(var)))


def _output(var: Var) -> list[str]:
    if var.kind == interface.DATA:
        return _in_out(var.name, DATA, var.comment)
    return _parameter(var.name, "Output", _PARAMETERS[var.kind], var.comment, _start(var))


def _start(var: Var) -> int:
    return 1 if var.start == "TRUE" else int(var.start or 0)


def _memory(var: Var) -> str:
    if var.kind in _PARAMETERS:
        return _local(var.name, _PARAMETERS[var.kind], ' Radix="Decimal"')
    return _local(var.name, {interface.DATA: DATA, interface.TIMER: "FBD_TIMER"}[var.kind])


def _parameter(name: str, usage: str, kind: str, meaning: str, start: int = 0, *, system: bool = False) -> list[str]:
    seen = 'Required="false" Visible="false"' if system else 'Required="false" Visible="true"'
    access = "Read/Write" if usage == "Input" and not system else "Read Only"
    lines = [
        f'<Parameter Name="{name}" TagType="Base" DataType="{kind}" Usage="{usage}" Radix="Decimal" {seen}'
        f' ExternalAccess="{access}">',
        _description(meaning),
    ]
    if not system:
        lines += [
            f'<DefaultData Format="L5K">\n{_cdata(str(start))}\n</DefaultData>',
            f'<DefaultData Format="Decorated">\n<DataValue DataType="{kind}" Radix="Decimal" Value="{start}"/>\n'
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


files = one_file("{}-loading-gateway.L5X", text)
