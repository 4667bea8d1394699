"""The JavaScript of the Node-RED flow's function node: the checks, the decoding, what is written. Pure."""

import json
import re
from textwrap import indent
from typing import Any

from gateway.modbus.exports.diagnosis import FIRST_ALIVE, HEARTBEAT_TIMEOUT_MS, LAST_ALIVE, MEANING, Diagnosis
from gateway.modbus.exports.interface import REQUESTS
from gateway.modbus.exports.logic import judgement
from gateway.modbus.exports.target import Target, template
from gateway.modbus.registers.register_map import BLOCK_WORDS, REGISTERS, Register

COMMANDS: dict[str, int] = {
    re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name.removesuffix("Bit")).lower(): bit for name, bit in REQUESTS
}
"""What a message of topic "command" may hold besides "recipe", and at which bit it is written."""


def code(target: Target) -> str:
    """The function node's JavaScript."""
    numbers: dict[str, Any] = {diagnosis.name: int(diagnosis) for diagnosis in Diagnosis}
    numbers |= {
        "MAP": json.dumps([_row(register) for register in REGISTERS]),
        "MEANING": json.dumps(MEANING),
        "TIMEOUT_MS": HEARTBEAT_TIMEOUT_MS,
        "LITTLE": json.dumps(target.word_order == "little"),
        "LOGIC": indent(javascript(judgement()), "    "),
        "COMMANDS": json.dumps(COMMANDS),
        "FIRST_ALIVE": FIRST_ALIVE,
        "LAST_ALIVE": LAST_ALIVE,
        "UNIT_ID": target.identity.unit_id,
        "IDENTITY": target.identity.number,
        "WORDS": BLOCK_WORDS,
    }
    made = template("node_red_function.js")
    for name, value in numbers.items():
        made = made.replace(f"@{name}@", str(value))
    return made


_WORDS = {"AND": "&&", "OR": "||", "XOR": "!==", "NOT ": "!", "TRUE": "true", "FALSE": "false", "<>": "!=="}


def javascript(text: str) -> str:
    """Statements of the common language (logic.py), without decoding, as JavaScript on `raw` and `state`."""
    code = re.split(r"(\(\*.*?\*\))", text, flags=re.DOTALL)
    code[1::2] = [f"/*{comment[2:-2]}*/" for comment in code[1::2]]
    code[::2] = map(_statements, code[::2])
    return "".join(code)


def _statements(text: str) -> str:
    text = re.sub(r"#(\w+)\(IN := (.+), PT := (#\w+)\);", r"timer('\1', \2, \3);", text)
    text = re.sub(r"#(?=\w)", "state.", text.replace("#Raw.", "raw."))
    text = re.sub(r"(?<!:)= ", "=== ", re.sub(r"([<>])=", r"\1\\", text)).replace("\\", "=").replace(":=", "=")
    text = re.sub(r"\bAND\b|\bX?OR\b|\bNOT |\bTRUE\b|\bFALSE\b|<>", lambda found: _WORDS[found[0]], text)
    text = re.sub(r"\braw\.(\w+)_valid\b", r"(raw.\1 !== null)", text)
    text = re.sub(r"\bELSIF\s(.*?)\sTHEN", r"} else if (\1) {", text, flags=re.DOTALL)
    text = re.sub(r"\bIF\s(.*?)\sTHEN", r"if (\1) {", text, flags=re.DOTALL)
    return text.replace("ELSE", "} else {").replace("END_IF;", "}")


def _row(register: Register) -> dict[str, Any]:
    row: dict[str, Any] = {
        "name": register.name,
        "address": register.address,
        "words": register.words,
        "type": register.kind.name,
        "scale": register.scale,
        "none": None if register.kind.is_float else register.kind.no_value,
    }
    if register.bits is not None:
        row["bits"] = {bit: name for bit, (name, _) in register.bits.items()}
    return row
