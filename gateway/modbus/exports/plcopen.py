"""PLCopen XML (TC6, in CODESYS' namespace) of the same units as the structured text. Pure."""

import re
from xml.sax.saxutils import escape, quoteattr

from gateway.modbus.exports import structured_text
from gateway.modbus.exports.clients import codesys
from gateway.modbus.exports.interface import Var
from gateway.modbus.exports.logic import ascii_only
from gateway.modbus.exports.target import Target, one_file, template

_XHTML = "http://www.w3.org/1999/xhtml"
_MADE = "2026-01-01T00:00:00"  # a fixed date, not the clock's: the same table gives the same file
_SECTIONS = {"VAR_INPUT": "inputVars", "VAR_OUTPUT": "outputVars", "VAR": "localVars"}
_KINDS = {"FUNCTION": "function", "FUNCTION_BLOCK": "functionBlock", "PROGRAM": "program"}
_ELEMENTARY = frozenset({"BOOL", "BYTE", "WORD", "UINT", "INT", "UDINT", "DINT", "REAL", "TIME"})


def text(targets: tuple[Target, ...]) -> str:
    """With a program whose variables are to be mapped to the tool's own Modbus channels."""
    return _project(targets, structured_text.program(targets))


def codesys_text(targets: tuple[Target, ...]) -> str:
    """With a program that polls by itself, with CODESYS' library ModbusFB."""
    return _project(targets, codesys(targets))


def _project(targets: tuple[Target, ...], program: structured_text.Pou) -> str:
    types = "".join(map(_type, structured_text.types()))
    first = targets[0]
    made = *structured_text.library(first), program, structured_text.example(first, polled=True)
    units = "".join(map(_unit, made))
    return ascii_only(template("project.xml").format(made=_MADE, types=types, units=units))


def _type(made: structured_text.Type) -> str:
    base = _kind(made.of) if isinstance(made.of, str) else f"<struct>\n{''.join(map(_variable, made.of))}</struct>"
    return f"<dataType name={quoteattr(made.name)}>\n<baseType>{base}</baseType>\n</dataType>\n"


def _unit(unit: structured_text.Pou) -> str:
    returns = f"<returnType>{_kind(unit.returns)}</returnType>\n" if unit.returns else ""
    sections = "".join(
        f"<{_SECTIONS[keyword]}>\n{''.join(map(_variable, variables))}</{_SECTIONS[keyword]}>\n"
        for keyword, variables in unit.sections
    )
    comment = f"(* {unit.comment} *)\n" if unit.comment else ""
    return (
        f'<pou name={quoteattr(unit.name)} pouType="{_KINDS[unit.kind]}">\n'
        f"<interface>\n{returns}{sections}</interface>\n"
        f'<body>\n<ST>\n<xhtml xmlns="{_XHTML}">{escape(comment + unit.body)}</xhtml>\n</ST>\n</body>\n</pou>\n'
    )


def _variable(var: Var) -> str:
    start = _start(var)
    note = f'<documentation>\n<xhtml xmlns="{_XHTML}">{escape(var.comment)}</xhtml>\n</documentation>\n'
    return (
        f"<variable name={quoteattr(var.name)}>\n<type>{_kind(var.kind)}</type>\n{start}"
        f"{note if var.comment else ''}</variable>\n"
    )


def _start(var: Var) -> str:
    if not var.start:
        return ""
    if var.start.startswith("["):
        values = "".join(f'<value><simpleValue value="{one.strip()}" /></value>' for one in var.start[1:-1].split(","))
        return f"<initialValue><arrayValue>{values}</arrayValue></initialValue>\n"
    return f"<initialValue><simpleValue value={quoteattr(var.start)} /></initialValue>\n"


def _kind(kind: str) -> str:
    if found := re.fullmatch(r"ARRAY \[(\d+)\.\.(\d+)\] OF (\w+)", kind):
        low, high, of = found.groups()
        return f'<array><dimension lower="{low}" upper="{high}" /><baseType><{of} /></baseType></array>'
    return f"<{kind} />" if kind in _ELEMENTARY else f"<derived name={quoteattr(kind)} />"


files = one_file("{}-loading-gateway.xml", text)
codesys_files = one_file("{}-loading-gateway-codesys.xml", codesys_text)
