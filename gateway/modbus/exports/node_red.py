"""A Node-RED flow: modbus-read polls the block, a function node judges and decodes it, debug nodes show it. Pure.

Needs the palette node-red-contrib-modbus. A ticking inject node lets the function notice that answers stay away.
Requests to the gateway are messages of topic "command"; they are written while the gateway accepts writes.

programs/node_red_flow.json is the flow as Node-RED exports it, with places to fill in. The outputs of its
function node are never reordered.
"""

import json

from gateway.modbus.exports.interface import FIRST_WRITTEN, WRITTEN
from gateway.modbus.exports.node_red_function import code
from gateway.modbus.exports.target import Target, file_per_bay, template
from gateway.modbus.registers.register_map import BLOCK_WORDS


def text(target: Target) -> str:
    """The JSON to import (menu, Import). Ids are derived from the bay's name: two bays fit into one Node-RED."""
    made = template("node_red_flow.json")
    for name, value in (
        ("NAME", target.identifier),
        ("BAY", target.bay),
        ("HOST", target.host),
        ("PORT", target.port),
        ("UNIT", target.unit_id),
        ("WORDS", BLOCK_WORDS),
        ("FIRST", FIRST_WRITTEN),
        ("LAST", FIRST_WRITTEN + len(WRITTEN) - 1),
        ("WRITTEN", len(WRITTEN)),
    ):
        made = made.replace(f"@{name}@", str(value))
    return made.replace('"@FUNC@"', json.dumps(code(target), ensure_ascii=False))


files = file_per_bay("{}-node-red-flow.json", text)
