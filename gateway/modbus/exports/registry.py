"""The formats of `gateway registers --format`, by name. Imports no format: the command line's help is quick. Pure.

A format is a function from the bays, at least one and all of one gateway, to its files: name -> text.
"""

from collections.abc import Callable

from gateway.modbus.exports.target import Target
from gateway.registry import Registry

Export = Callable[[tuple[Target, ...]], dict[str, str]]

_PACKAGE = "gateway.modbus.exports"
_FORMATS: dict[str, tuple[str, str]] = {
    "ignition": ("ignition:files", "Ignition 8.1 tags: Tag Browser, Import Tags"),
    "kepware": ("kepware:files", "KEPServerEX tags of the driver Modbus TCP/IP Ethernet"),
    "st": (
        "structured_text:files",
        "IEC 61131-3 structured text: function block, and a program with one instance a bay",
    ),
    "plcopen": ("plcopen:files", "the same as PLCopen XML: CODESYS, WAGO, Schneider"),
    "codesys": (
        "plcopen:codesys_files",
        "PLCopen XML with a program that polls and writes by CODESYS' library ModbusFB",
    ),
    "tcpou": ("tcpou:files", "Beckhoff TwinCAT 3 source files, with a program that polls and writes by TF6250"),
    "scl": ("scl:files", "Siemens SCL source for TIA Portal: S7-1200, S7-1500, with the calls of MB_CLIENT"),
    "l5x": ("l5x:files", "Rockwell Add-On Instruction for Studio 5000"),
    "node-red": ("node_red:files", "Node-RED flow on node-red-contrib-modbus"),
    "openplc": ("openplc:files", "OpenPLC Runtime 3: program and slave devices, two files"),
    "csv": ("tables:csv_files", "the table, one line a register"),
    "json": ("tables:json_files", "the table with all codes and bits"),
    "markdown": ("tables:markdown_files", "the table for people, as in docs/registers.md"),
    "text": ("tables:text_files", "the table for reading in a terminal"),
}
SUMMARY: dict[str, str] = {name: summary for name, (_, summary) in _FORMATS.items()}
"""Format -> its description and the tool that opens it."""
EXPORTS = Registry(
    "export format", "gateway.plc_exports", {name: f"{_PACKAGE}.{where}" for name, (where, _) in _FORMATS.items()}
)
"""By name an `Export`."""


def export(name: str, targets: tuple[Target, ...]) -> dict[str, str]:
    """The files of one format. Raises ConfigError for an unknown one, and for targets that it can't be made for."""
    make: Export = EXPORTS.load(name)
    return make(targets)
