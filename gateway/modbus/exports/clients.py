"""Finished programs that poll and write by themselves: TwinCAT's Modbus TCP blocks, CODESYS' library ModbusFB. Pure.

Both take a bay through the same stages: read, copy the words if that succeeded, write if the gateway accepts writes,
pause. What was received is copied in one statement, so that the function block never sees half of it. A failed write
does not take the outputs away: the gateway itself reports that the PLC is lost.
"""

import re
from collections.abc import Callable

from gateway.errors import ConfigError
from gateway.modbus.exports.interface import FIRST_WRITTEN, WRITTEN, Var
from gateway.modbus.exports.structured_text import BLOCK, PROGRAM, Pou, Section, called, instance
from gateway.modbus.exports.target import Target, template
from gateway.modbus.registers.register_map import BLOCK_WORDS

PAUSE_MS = 50


def twincat(targets: tuple[Target, ...]) -> Pou:
    """On the library Tc2_ModbusSrv, part of TF6250."""
    return _program(
        targets,
        "twincat.st",
        "NOT {name}_Read.bError",
        "NOT {name}_Send.bBusy",
        lambda target: (
            Var(f"{target.instance}_Read", "FB_MBReadRegs", "function code 3"),
            Var(f"{target.instance}_Send", "FB_MBWriteRegs", "function code 16"),
        ),
        "Polls and writes by itself, with the blocks of TF6250. Needs the library Tc2_ModbusSrv.",
    )


def codesys(targets: tuple[Target, ...]) -> Pou:
    """On the library ModbusFB. Raises ConfigError for a host name: the library takes the four numbers only."""
    return _program(
        targets,
        "codesys.st",
        "{name}_Read.xDone",
        "({name}_Send.xDone OR {name}_Send.xError)",
        lambda target: (
            Var(f"{target.instance}_Client", "ModbusFB.ClientTCP", "one connection"),
            Var(f"{target.instance}_Read", "ModbusFB.ClientRequestReadHoldingRegisters", "function code 3"),
            Var(f"{target.instance}_Send", "ModbusFB.ClientRequestWriteMultipleRegisters", "function code 16"),
            Var(f"{target.instance}_Connect", "BOOL", ""),
            Var(f"{target.instance}_Lost", "TON", "no connection for too long: connect again"),
            Var(f"{target.instance}_Address", "ARRAY [0..3] OF BYTE", "", f"[{', '.join(octets(target))}]"),
        ),
        "Polls and writes by itself. Needs the library ModbusFB; no Modbus device in the device tree.",
    )


def octets(target: Target) -> list[str]:
    """The four numbers of the gateway's address. Raises ConfigError where it is none."""
    if not re.fullmatch(r"\d+(\.\d+){3}", target.host):
        raise ConfigError(f"--host: {target.host!r}: this format needs an IPv4 address")
    return target.host.split(".")


def _program(
    targets: tuple[Target, ...],
    file: str,
    good: str,
    written: str,
    blocks: Callable[[Target], tuple[Var, ...]],
    comment: str,
) -> Pou:
    """`file` goes as far as the end of a read; `good` and `written`: the tool's own words for "the read went well" and
    for "writing has ended"."""
    after = template("after_the_read.st").replace("GOOD", good).replace("WRITTEN", written)
    body = (template(file) + after).removesuffix("\n")
    bodies = (
        body.format(
            bay=target.bay,
            name=target.instance,
            host=target.host,
            port=target.port,
            unit=target.unit_id,
            words=BLOCK_WORDS,
            first=FIRST_WRITTEN,
            written=len(WRITTEN),
            pause=PAUSE_MS,
            call=called(target),
        )
        for target in targets
    )
    sections: tuple[Section, ...] = tuple(
        ("VAR", (*instance(target.instance), *_own(target.instance), *blocks(target))) for target in targets
    )
    return Pou("PROGRAM", PROGRAM, sections, "\n".join(bodies), comment=comment)


def _own(name: str) -> tuple[Var, ...]:
    return (
        Var(f"{name}_Received", BLOCK, "what the client writes into"),
        Var(f"{name}_PollOk", "BOOL", "the last completed read had no error"),
        Var(f"{name}_Pause", "TON", ""),
        Var(f"{name}_Stage", "UINT", "0 pause, 1 begin, 2 read, 3 copied, 4 write"),
    )
