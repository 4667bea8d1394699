"""Ignition 8.1 tag import (Tag Browser, Import Tags): a folder for the bay with one OPC tag for every register and bit.

Addresses are of Ignition's own Modbus driver, one-based as it is set by default: HRUS4 is register 3. Pure.
"""

import json
from typing import Any

from gateway.modbus.exports.fields import describe
from gateway.modbus.exports.target import Target
from gateway.modbus.registers import REGISTERS, Register

# (designator of Ignition's Modbus driver, tag data type), by the table's type
_TYPES = {
    "uint16": ("HRUS", "Int4"),
    "int16": ("HR", "Int2"),
    "uint32": ("HRUI", "Int8"),
    "uint64": ("HRUI_64", "Int8"),
    "float32": ("HRF", "Float4"),
}


def text(target: Target) -> str:
    """The JSON file to import. The device in Ignition must bear the bay's name."""
    tags: list[dict[str, Any]] = []
    for register in REGISTERS:
        tags.append(_tag(register, target))
        if register.bits is not None:
            tags.append(_bits(register, target))
    folder = {"name": target.bay, "tagType": "Folder", "tags": tags}
    return json.dumps({"name": "", "tagType": "Provider", "tags": [folder]}, indent=2, ensure_ascii=False) + "\n"


def _tag(register: Register, target: Target) -> dict[str, Any]:
    designator, data_type = _TYPES[register.kind.name]
    tag = _opc(register.name, f"{designator}{register.address + 1}", data_type, target)
    tag["documentation"] = describe(register) + _codes(register)
    if not register.writable:
        tag["readOnly"] = True
    if register.unit:
        tag["engUnit"] = register.unit
    if register.scale != 1:
        low, high = register.kind.low, register.kind.high
        tag |= {
            "dataType": "Float4",
            "scaleMode": "Linear",
            "rawLow": low,
            "rawHigh": high,
            "scaledLow": round(low * register.scale, 6),
            "scaledHigh": round(high * register.scale, 6),
            "clampMode": "No_Clamp",
        }
    return tag


def _bits(register: Register, target: Target) -> dict[str, Any]:
    tags = []
    for bit, (name, meaning) in (register.bits or {}).items():
        tag = _opc(name, f"HR{register.address + 1}.{bit}", "Boolean", target)
        tag |= {"documentation": meaning, "readOnly": True}  # a written bit would rewrite its whole word
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
