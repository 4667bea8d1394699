"""What every format of names.py makes. Pure."""

from collections.abc import Callable

from gateway.modbus.exports import (
    ignition,
    kepware,
    l5x,
    node_red,
    openplc,
    plcopen,
    scl,
    structured_text,
    tables,
    tcpou,
)
from gateway.modbus.exports.target import Target

Targets = tuple[Target, ...]
"""The bays that an export is for, at least one; all of one gateway."""
Files = dict[str, str]
"""File name -> text."""


def _each(name: str, text: Callable[[Target], str]) -> Callable[[Targets], Files]:
    """One file a bay; `{}` in its name is the bay."""
    return lambda targets: {name.format(target.identifier): text(target) for target in targets}


def _all(name: str, text: Callable[[Targets], str]) -> Callable[[Targets], Files]:
    """One file for all the bays; `{}` in its name is the first."""
    return lambda targets: {name.format(targets[0].identifier): text(targets)}


FORMATS: dict[str, Callable[[Targets], Files]] = {
    "ignition": _each("{}-ignition-tags.json", ignition.text),
    "kepware": _each("{}-kepware-tags.csv", kepware.text),
    "st": _all("{}-loading-gateway.st", structured_text.text),
    "plcopen": _all("{}-loading-gateway.xml", plcopen.text),
    "codesys": _all("{}-loading-gateway-codesys.xml", plcopen.codesys_text),
    "tcpou": tcpou.files,
    "scl": _all("{}-loading-gateway.scl", scl.text),
    "l5x": _all("{}-loading-gateway.L5X", l5x.text),
    "node-red": _each("{}-node-red-flow.json", node_red.text),
    "openplc": openplc.files,
    "csv": _all("registers.csv", lambda _: tables.csv_text()),
    "json": _all("registers.json", lambda _: tables.json_text()),
    "markdown": _all("registers.md", lambda _: tables.markdown()),
}
"""Format -> what makes its files."""
