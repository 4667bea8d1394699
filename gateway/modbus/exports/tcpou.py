"""TwinCAT 3 source files: one .TcPOU a function, function block or program, one .TcDUT a type. Pure.

Added to a PLC project by "Add, Existing Item". Each object has an id, derived from its name: the same table gives the
same files.
"""

import uuid

from gateway.modbus.exports import structured_text
from gateway.modbus.exports.clients import twincat
from gateway.modbus.exports.logic import ascii_only
from gateway.modbus.exports.target import Target

_NAMESPACE = uuid.uuid5(uuid.NAMESPACE_URL, "plc-loading-gateway/tcpou")


def files(targets: tuple[Target, ...]) -> dict[str, str]:
    """Types, functions, function blocks, a program that polls with the blocks of TF6250, and the example."""
    first = targets[0]
    made = {f"{kind.name}.TcDUT": _object(_type(kind)) for kind in structured_text.types()}
    for unit in (*structured_text.library(first), twincat(targets), structured_text.example(first, polled=True)):
        made[f"{unit.name}.TcPOU"] = _object(_unit(unit))
    return made


def _type(made: structured_text.Type) -> str:
    return (
        f'  <DUT Name="{made.name}" Id="{_id(made.name)}">\n{_declaration(structured_text.type_text(made))}  </DUT>\n'
    )


def _unit(unit: structured_text.Pou) -> str:
    return (
        f'  <POU Name="{unit.name}" Id="{_id(unit.name)}" SpecialFunc="None">\n'
        f"{_declaration(structured_text.declaration(unit))}"
        f"    <Implementation>\n      <ST>{_cdata(unit.body)}</ST>\n    </Implementation>\n  </POU>\n"
    )


def _declaration(text: str) -> str:
    return f"    <Declaration>{_cdata(text)}</Declaration>\n"


def _object(inner: str) -> str:
    head = '<?xml version="1.0" encoding="utf-8"?>\n<TcPlcObject Version="1.1.0.1">\n'
    return ascii_only(f"{head}{inner}</TcPlcObject>\n")


def _cdata(text: str) -> str:
    return f"<![CDATA[{text.rstrip()}\n]]>"


def _id(name: str) -> str:
    return f"{{{uuid.uuid5(_NAMESPACE, name)}}}"
