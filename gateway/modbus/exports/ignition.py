"""Ignition 8.1 tag import (Tag Browser, Import Tags): a folder for the bay with a tag for every register and bit.

Addresses are of Ignition's own Modbus driver, one-based as it is set by default: HRUS4 is register 3. A register that
may hold no value is read into the folder `raw` unchanged; the tag of its name is an expression that then has bad
quality and no value. Pure.
"""

import json
from typing import Any

from gateway.modbus.exports.fields import describe
from gateway.modbus.exports.target import Target, file_per_bay
from gateway.modbus.registers.register_map import REGISTERS, Register

# (designator of Ignition's Modbus driver, tag data type), by the table's type
_TYPES = {
    "uint16": ("HRUS", "Int4"),
    "int16": ("HR", "Int2"),
    "uint32": ("HRUI", "Int8"),
    "uint64": ("HRUI_64", "Int8"),
    "float32": ("HRF", "Float4"),
}
RAW = "raw"
_EXPONENT = 0x7F80  # of a float32's high word: all bits set: not a number
_OUT_OF_RANGE = 524  # Ignition's subcode Bad_OutOfRange


def text(target: Target) -> str:
    """The JSON file to import. The device in Ignition must bear the bay's name."""
    tags: list[dict[str, Any]] = []
    raw: list[dict[str, Any]] = []
    for register in REGISTERS:
        if register.kind.no_value is None:
            tags.append(_tag(register, target))
        else:
            raw += _raw(register, target)
            tags.append(_expression(register))
        if register.bits is not None:
            tags.append(_bits(register, target))
    tags.append(_right_bay(target))
    tags.append({"name": RAW, "tagType": "Folder", "tags": raw})
    folder = {"name": target.bay, "tagType": "Folder", "tags": tags}
    return json.dumps({"name": "", "tagType": "Provider", "tags": [folder]}, indent=2, ensure_ascii=False) + "\n"


def _tag(register: Register, target: Target) -> dict[str, Any]:
    """A register that always holds a value."""
    designator, data_type = _TYPES[register.kind.name]
    tag = _opc(register.name, f"{designator}{register.address + 1}", data_type, target)
    tag["documentation"] = describe(register) + _codes(register)
    if not register.writable:
        tag["readOnly"] = True
    return tag


def _raw(register: Register, target: Target) -> list[dict[str, Any]]:
    """The register unscaled; of a float its high word, too, whose exponent distinguishes a number from none."""
    designator, data_type = _TYPES[register.kind.name]
    tags = [_opc(register.name, f"{designator}{register.address + 1}", data_type, target)]
    if register.kind.is_float:
        high, _ = target.high_low(register.address)
        tags.append(_opc(f"{register.name}_high", f"HRUS{high + 1}", "Int4", target))
    return [tag | {"readOnly": True, "documentation": f"as in the register: {_none(register)}"} for tag in tags]


def _expression(register: Register) -> dict[str, Any]:
    """The value in its unit; null with bad quality where there is none."""
    source = f"{{[.]{RAW}/{register.name}}}"
    if register.kind.is_float:
        missing = f"({{[.]{RAW}/{register.name}_high}} & {_EXPONENT}) = {_EXPONENT}"
    else:
        missing = f"{source} = {register.kind.sentinel}"
    value = source if register.scale == 1 else f"{source} * {register.scale}"
    tag = {
        "name": register.name,
        "tagType": "AtomicTag",
        "valueSource": "expr",
        "expression": f"if({missing}, qualifiedValue(null, 'Bad', {_OUT_OF_RANGE}, 'no value'), {value})",
        "dataType": "Int4" if register.scale == 1 and not register.kind.is_float else "Float4",
        "documentation": describe(register) + _codes(register),
        "readOnly": True,
    }
    return tag | {"engUnit": register.unit} if register.unit else tag


def _right_bay(target: Target) -> dict[str, Any]:
    """False: the device reads another bay than this one, by its unit id or address."""
    bay = target.identity
    return {
        "name": "right_bay",
        "tagType": "AtomicTag",
        "valueSource": "expr",
        "expression": f"{{[.]unit_id}} = {bay.unit_id} && {{[.]bay_identity}} = {bay.number}",
        "dataType": "Boolean",
        "documentation": f"false: this is not {target.site}/{target.gateway}/{target.bay}; use no tag then",
        "readOnly": True,
    }


def _none(register: Register) -> str:
    return "NaN: no value" if register.kind.is_float else f"{register.kind.sentinel}: no value"


def _bits(register: Register, target: Target) -> dict[str, Any]:
    tags = []
    for bit, (name, meaning) in (register.bits or {}).items():
        tag = _opc(name, f"HR{register.address + 1}.{bit}", "Boolean", target)
        tag |= {"documentation": meaning, "readOnly": True}  # a written bit would rewrite its complete word
        tags.append(tag)
    return {"name": f"{register.name} bits", "tagType": "Folder", "tags": tags}


def _opc(name: str, address: str, data_type: str, target: Target) -> dict[str, Any]:
    return {
        "name": name,
        "tagType": "AtomicTag",
        "valueSource": "opc",
        "opcServer": "Ignition OPC UA Server",
        "opcItemPath": f"ns=1;s=[{target.bay}]{target.unit_id}.{address}",
        "dataType": data_type,
    }


def _codes(register: Register) -> str:
    if register.codes is None:
        return ""
    return "\n" + "\n".join(f"{code} {name}: {meaning}" for code, (name, meaning) in register.codes.items())


files = file_per_bay("{}-ignition-tags.json", text)
