"""The register table in the words of PLC and SCADA tools: one module a format, one table of formats. Pure."""

from collections.abc import Callable
from dataclasses import dataclass

from gateway.modbus import export
from gateway.modbus.exports import ignition, kepware, l5x, node_red, openplc, scl, structured_text
from gateway.modbus.exports.target import Target

Files = dict[str, str]
"""File name -> text."""


@dataclass(frozen=True, slots=True)
class Format:
    """`summary`: what it is and who opens it. `files`: what it makes for one bay."""

    summary: str
    files: Callable[[Target], Files]


def _one(name: str, text: Callable[[Target], str]) -> Callable[[Target], Files]:
    """A format of one file; `{}` in its name is the bay."""
    return lambda target: {name.format(target.identifier): text(target)}


FORMATS: dict[str, Format] = {
    "ignition": Format("Ignition 8.1 tags: Tag Browser, Import Tags", _one("{}-ignition-tags.json", ignition.text)),
    "kepware": Format(
        "KEPServerEX tags of the driver Modbus TCP/IP Ethernet", _one("{}-kepware-tags.csv", kepware.text)
    ),
    "st": Format(
        "IEC 61131-3 structured text, a function block: CODESYS, TwinCAT, WAGO, Schneider",
        _one("{}-loading-gateway.st", structured_text.text),
    ),
    "scl": Format("Siemens SCL source for TIA Portal: S7-1200, S7-1500", _one("{}-loading-gateway.scl", scl.text)),
    "l5x": Format("Rockwell Add-On Instruction for Studio 5000", _one("{}-loading-gateway.L5X", l5x.text)),
    "node-red": Format("Node-RED flow on node-red-contrib-modbus", _one("{}-node-red-flow.json", node_red.text)),
    "openplc": Format("OpenPLC Runtime 3: program and slave device, two files", openplc.files),
    "csv": Format("the table, one line a register", _one("registers.csv", lambda _: export.csv_text())),
    "json": Format("the table with all codes and bits", _one("registers.json", lambda _: export.json_text())),
    "markdown": Format(
        "the table for people, as in docs/registers.md", _one("registers.md", lambda _: export.markdown())
    ),
}
