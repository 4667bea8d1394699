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
OUTPUTS = ("may_move", "in_place", "data", "diagnosis", "write", "rolling")  # never reorder


def text(target: Target) -> str:
    """The JSON to import (menu, Import)."""
    return json.dumps(flow(target), indent=2, ensure_ascii=False) + "\n"


def flow(target: Target) -> list[dict[str, Any]]:
    """The nodes, wired; ids are derived from the bay's name, so that two bays fit into one Node-RED."""
    bay = target.identifier
    ids = {part: f"lg-{bay}-{part}" for part in ("tab", "client", "read", "tick", "judge", *OUTPUTS)}
    polled = {
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
    }
    ticking = {
        "props": [{"p": "topic", "vt": "str"}],
        "repeat": "0.1",
        "crontab": "",
        "once": True,
        "onceDelay": 0.1,
        "topic": "tick",
    }
    judging = {
        "func": code(target),
        "outputs": len(OUTPUTS),
        "timeout": 0,
        "noerr": 0,
        "initialize": "",
        "finalize": "",
        "libs": [],
    }
    written = {
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
    }

    def node(
        part: str, kind: str, name: str, keys: dict[str, Any], at: tuple[int, int], wires: list[list[str]]
    ) -> dict[str, Any]:
        head = {"id": ids[part], "type": kind, "z": ids["tab"], "name": name}
        return head | keys | {"x": at[0], "y": at[1], "wires": wires}

    last = FIRST_WRITTEN + len(WRITTEN) - 1
    return [
        {"id": ids["tab"], "type": "tab", "label": f"Loading bay {target.bay}", "disabled": False, "info": ""},
        _client(ids["client"], target),
        node("read", "modbus-read", f"{BLOCK_WORDS} registers of {bay}", polled, (160, 120), [[ids["judge"]], []]),
        node("tick", "inject", "watchdog", ticking, (140, 180), [[ids["judge"]]]),
        node("judge", "function", "judge and decode", judging, (390, 150), [[ids[name]] for name in OUTPUTS]),
        *(
            node(name, "debug", name, _debug(name), (630, 60 + 50 * n), [])
            for n, name in enumerate(OUTPUTS)
            if name != "write"
        ),
        node("write", "modbus-write", f"registers {FIRST_WRITTEN} to {last} of {bay}", written, (650, 260), [[], []]),
    ]


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


def _debug(name: str) -> dict[str, Any]:
    return {
        "active": name != "data",
        "tosidebar": True,
        "console": False,
        "tostatus": name != "data",
        "complete": "payload",
        "targetType": "msg",
    }


files = file_per_bay("{}-node-red-flow.json", text)
