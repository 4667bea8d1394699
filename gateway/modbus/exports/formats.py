"""What every format of names.py makes. Pure."""

from collections.abc import Callable

from gateway.modbus import export
from gateway.modbus.exports import ignition, kepware, l5x, node_red, openplc, scl, structured_text
from gateway.modbus.exports.target import Target

Files = dict[str, str]
"""File name -> text."""


def _one(name: str, text: Callable[[Target], str]) -> Callable[[Target], Files]:
    """A format of one file; `{}` in its name is the bay."""
    return lambda target: {name.format(target.identifier): text(target)}


FORMATS: dict[str, Callable[[Target], Files]] = {
    "ignition": _one("{}-ignition-tags.json", ignition.text),
    "kepware": _one("{}-kepware-tags.csv", kepware.text),
    "st": _one("{}-loading-gateway.st", structured_text.text),
    "scl": _one("{}-loading-gateway.scl", scl.text),
    "l5x": _one("{}-loading-gateway.L5X", l5x.text),
    "node-red": _one("{}-node-red-flow.json", node_red.text),
    "openplc": openplc.files,
    "csv": _one("registers.csv", lambda _: export.csv_text()),
    "json": _one("registers.json", lambda _: export.json_text()),
    "markdown": _one("registers.md", lambda _: export.markdown()),
}
"""Format -> what makes its files for one bay."""
