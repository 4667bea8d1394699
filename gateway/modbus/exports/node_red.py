"""A Node-RED flow: modbus-read polls the block, a function node judges and decodes it, debug nodes show it. Pure.

Needs the palette node-red-contrib-modbus. A ticking inject node lets the function notice that answers stay away.
Requests to the gateway are messages of topic "command"; they are written while the gateway accepts writes.
"""

import json
from typing import Any

from gateway.modbus.exports.interface import FIRST_WRITTEN, WRITTEN
from gateway.modbus.exports.node_red_function import code
from gateway.modbus.exports.target import Target, file_per_bay
from gateway.modbus.registers.register_map import BLOCK_WORDS

POLL_MS = 100
OUTPUTS = ("may_move", "in_place", "data", "diagnosis", "write")


def text(target: Target) -> str:
    """The JSON to import (menu, Import)."""
    return json.dumps(flow(target), indent=2, ensure_ascii=False) + "\n"


def flow(target: Target) -> list[dict[str, Any]]:
    """The nodes, wired; ids are derived from the bay's name, so that two bays fit into one Node-RED."""
    bay = target.identifier
    ids = {part: f"lg-{bay}-{part}" for part in ("tab", "client", "read", "tick", "judge", *OUTPUTS)}
    read = {
        "id": ids["read"],
        "type": "modbus-read",
        "z": ids["tab"],
        "name": f"{BLOCK_WORDS} registers of {bay}",
        "topic": "poll",
        "showStatusActivities": True,
        "logIOActivities": False,
        "showErrors": True,
        "showWarnings": True,
        "unitid": str(target.unit_id),
        "dataType": "HoldingRegister",
        "adr": "0",
        "quantity": str(BLOCK_WORDS),
        "rate": str(POLL_MS),
        "rateUnit": "ms",
        "delayOnStart": False,
        "startDelayTime": "",
        "server": ids["client"],
        "useIOFile": False,
        "ioFile": "",
        "useIOForPayload": False,
        "emptyMsgOnFail": True,
        "x": 160,
        "y": 120,
        "wires": [[ids["judge"]], []],
    }
    tick = {
        "id": ids["tick"],
        "type": "inject",
        "z": ids["tab"],
        "name": "watchdog",
        "props": [{"p": "topic", "vt": "str"}],
        "repeat": "0.1",
        "crontab": "",
        "once": True,
        "onceDelay": 0.1,
        "topic": "tick",
        "x": 140,
        "y": 180,
        "wires": [[ids["judge"]]],
    }
    judge = {
        "id": ids["judge"],
        "type": "function",
        "z": ids["tab"],
        "name": "judge and decode",
        "func": code(target),
        "outputs": len(OUTPUTS),
        "timeout": 0,
        "noerr": 0,
        "initialize": "",
        "finalize": "",
        "libs": [],
        "x": 390,
        "y": 150,
        "wires": [[ids[name]] for name in OUTPUTS],
    }
    debugs = [_debug(ids[name], ids["tab"], name, 60 + 50 * n) for n, name in enumerate(OUTPUTS[:-1])]
    write = {
        "id": ids["write"],
        "type": "modbus-write",
        "z": ids["tab"],
        "name": f"registers {FIRST_WRITTEN} to {FIRST_WRITTEN + len(WRITTEN) - 1} of {bay}",
        "showStatusActivities": False,
        "showErrors": True,
        "showWarnings": True,
        "unitid": str(target.unit_id),
        "dataType": "MHoldingRegisters",
        "adr": str(FIRST_WRITTEN),
        "quantity": str(len(WRITTEN)),
        "server": ids["client"],
        "emptyMsgOnFail": False,
        "keepMsgProperties": False,
        "x": 650,
        "y": 260,
        "wires": [[], []],
    }
    tab = {"id": ids["tab"], "type": "tab", "label": f"Loading bay {target.bay}", "disabled": False, "info": ""}
    return [tab, _client(ids["client"], target), read, tick, judge, *debugs, write]


def _client(name: str, target: Target) -> dict[str, Any]:
    return {
        "id": name,
        "type": "modbus-client",
        "name": f"loading gateway {target.host}",
        "clienttype": "tcp",
        "bufferCommands": True,
        "stateLogEnabled": False,
        "queueLogEnabled": False,
        "failureLogEnabled": True,
        "tcpHost": target.host,
        "tcpPort": str(target.port),
        "tcpType": "DEFAULT",
        "unit_id": str(target.unit_id),
        "commandDelay": "1",
        "clientTimeout": "1000",
        "reconnectOnTimeout": True,
        "reconnectTimeout": "2000",
        "parallelUnitIdsAllowed": True,
        "showErrors": True,
        "showWarnings": True,
        "showLogs": True,
    }


def _debug(name: str, tab: str, label: str, y: int) -> dict[str, Any]:
    return {
        "id": name,
        "type": "debug",
        "z": tab,
        "name": label,
        "active": label != "data",
        "tosidebar": True,
        "console": False,
        "tostatus": label != "data",
        "complete": "payload",
        "targetType": "msg",
        "x": 630,
        "y": y,
        "wires": [],
    }


files = file_per_bay("{}-node-red-flow.json", text)
