"""KEPServerEX tag CSV for the driver "Modbus TCP/IP Ethernet" (device, Tag Group, Import CSV). Pure.

Six-digit addresses of holding registers: 400001 is register 0, as in the driver's own setting of zero-based addressing.
"""

import csv
import io

from gateway.modbus.exports.fields import describe
from gateway.modbus.exports.target import Target
from gateway.modbus.registers import REGISTERS, Register

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
    row = _row(register.name, f"{400001 + register.address}", _TYPES[register.kind.name], describe(register))
    row["Eng Units"] = register.unit
    if register.writable:
        row["Client Access"] = "R/W"
    if register.scale != 1:
        low, high = register.kind.low, register.kind.high
        row |= {
            "Scaling": "Linear",
            "Raw Low": low,
            "Raw High": high,
            "Scaled Low": round(low * register.scale, 6),
            "Scaled High": round(high * register.scale, 6),
            "Scaled Data Type": "Float",
            "Clamp Low": 0,
            "Clamp High": 0,
            "Negate Value": 0,
        }
    bits = (register.bits or {}).items()
    return [
        row,
        *(
            _row(f"{register.name}_{name}", f"{400001 + register.address}.{bit}", "Boolean", meaning)
            for bit, (name, meaning) in bits
        ),
    ]


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
