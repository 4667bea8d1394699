"""The generated parts of docs/modbus-server.md: from the code's own tables. Pure."""

from collections.abc import Callable, Mapping
from itertools import groupby

from gateway.modbus.exports.tables import markdown_table
from gateway.modbus.protocol.adu import EXCEPTION_MEANING
from gateway.modbus.protocol.answers import FUNCTIONS
from gateway.modbus.protocol.identity import ObjectId, objects
from gateway.modbus.registers import bits
from gateway.modbus.server.limits import Refusal

NOT_HERE: Mapping[int, tuple[str, str]] = {
    7: ("read exception status", "serial line only"),
    8: ("diagnostics", "serial line only"),
    11: ("get comm event counter", "serial line only"),
    12: ("get comm event log", "serial line only"),
    20: ("read file record", "there are no files"),
    21: ("write file record", "there are no files"),
    24: ("read FIFO queue", "there is no queue"),
}


def functions() -> str:
    rows = [
        (code, FUNCTIONS[code].name, "with writes on, else 01" if FUNCTIONS[code].writes else "yes")
        for code in FUNCTIONS
    ]
    rows += [(code, name, f"01: {why}") for code, (name, why) in NOT_HERE.items()]
    cells = [(str(code), name, answered) for code, name, answered in sorted(rows)]
    return markdown_table(("code", "function", "answered"), [*cells, ("all others", "", "01")])


def exceptions() -> str:
    return markdown_table(
        ("code", "name", "when"),
        ((f"{code:02X}", code.name.lower().replace("_", " "), why) for code, why in EXCEPTION_MEANING.items()),
    )


def bit_table() -> str:
    """A row a register: the address of each of its bits on function codes 1 and 2."""
    return markdown_table(
        ("register", "bits"),
        (
            (f"`{name}`", ", ".join(f"{bit.address} {bit.name}" for bit in of_register))
            for name, of_register in groupby(bits.table(), key=lambda bit: bit.register)
        ),
    )


def identity() -> str:
    known = objects("SITE/BAY")
    return markdown_table(
        ("object", "name", "value"),
        ((str(key.value), key.name.lower().replace("_", " "), known[key].decode()) for key in ObjectId if key in known),
    )


def refusals() -> str:
    return markdown_table(("counter", "what happened"), ((why.name.lower(), why.value) for why in Refusal))


BLOCKS: Mapping[str, Callable[[], str]] = {
    "functions": functions,
    "exceptions": exceptions,
    "bits": bit_table,
    "identity": identity,
    "refusals": refusals,
}
