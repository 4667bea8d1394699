"""KEPServerEX tag CSV for the driver "Modbus TCP/IP Ethernet" (device, Tag Group, Import CSV). Pure.

Six-digit addresses of holding registers: 400001 is register 0, as in the driver's own setting of zero-based addressing.

The driver can scale a number but not recognise the one that means "no value". So an integer that may hold none
is not scaled: it is exported as `NAME_raw`, in counts and without a unit, and 65535 is not mistaken for a distance. For
people there are the float mirrors, whose NaN is no number for any client, if the channel's "Non-Normalized Float
Handling" is set to "Unmodified": by default the driver makes 0.0 of it.
"""

import csv
import io

from gateway.modbus.exports.fields import describe, measured
from gateway.modbus.exports.target import Target, file_per_bay
from gateway.modbus.registers.register_map import REGISTERS, Register

COLUMNS = (
    "Tag Name",
    "Address",
    "Data Type",
    "Respect Data Type",
    "Client Access",
    "Scan Rate",
    "Scaling",
    "Raw Low",
    "Raw High",
    "Scaled Low",
    "Scaled High",
    "Scaled Data Type",
    "Clamp Low",
    "Clamp High",
    "Eng Units",
    "Description",
    "Negate Value",
)
_TYPES = {"uint16": "Word", "int16": "Short", "uint32": "DWord", "float32": "Float"}
_SCAN_MS = 100
_DESCRIPTION_MAX = 255  # characters that a description may have

Row = dict[str, str | int | float]


def text(target: Target) -> str:
    """The CSV file to import under the device of this bay, whose "ID" holds host and unit id."""
    out = io.StringIO()
    writer = csv.DictWriter(out, COLUMNS, restval="", lineterminator="\r\n")
    writer.writeheader()
    for register in REGISTERS:
        writer.writerows(_rows(register, target))
    return out.getvalue()


def _rows(register: Register, target: Target) -> list[Row]:
    if register.words == 4:  # the driver has no unsigned 64-bit type
        first, second = ("high", "low") if target.word_order == "big" else ("low", "high")
        return [
            _row(f"{register.name}_{half}", f"{400001 + register.address + 2 * place}", "DWord", describe(register))
            for place, half in enumerate((first, second))
        ]
    counted = measured(register) and not register.kind.is_float
    tag = f"{register.name}_raw" if counted else register.name
    row = _row(
        tag, f"{400001 + register.address}", _TYPES[register.kind.name], _description(register, target, counted=counted)
    )
    row["Eng Units"] = "" if counted else register.unit
    if register.writable:
        row["Client Access"] = "R/W"
    bits = (register.bits or {}).items()
    return [
        row,
        *(
            _row(f"{register.name}_{name}", f"{400001 + register.address}.{bit}", "Boolean", meaning)
            for bit, (name, meaning) in bits
        ),
    ]


def _description(register: Register, target: Target, *, counted: bool) -> str:
    """The meaning, what an unscaled register counts, and the number that means no value, or this bay."""
    known = {"unit_id": target.identity.unit_id, "bay_identity": target.identity.number}
    if register.name in known:
        return f"must be {known[register.name]}. {describe(register)}"
    if register.kind.no_value is None:
        return describe(register)
    none = "NaN" if register.kind.is_float else str(register.kind.sentinel)
    if counted:
        return f"counts of {register.scale:g} {register.unit}; {none}: no value. {register.meaning}"
    return f"{describe(register)}; {none}: no value"


def _row(name: str, address: str, data_type: str, description: str) -> Row:
    return {
        "Tag Name": name,
        "Address": address,
        "Data Type": data_type,
        "Respect Data Type": 1,
        "Client Access": "RO",
        "Scan Rate": _SCAN_MS,
        "Description": description[:_DESCRIPTION_MAX],
    }


files = file_per_bay("{}-kepware-tags.csv", text)
