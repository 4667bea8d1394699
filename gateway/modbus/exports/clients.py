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
from gateway.modbus.exports.target import Target
from gateway.modbus.registers.register_map import BLOCK_WORDS

PAUSE_MS = 50
# What follows the end of a read, with the tool's own words for "went well" and for "writing has ended".
_AFTER_THE_READ = """\
  {name}_PollOk := GOOD;
  IF {name}_PollOk THEN
    {name}_Words := {name}_Received;
  END_IF;
  {name}_Stage := 3;
ELSIF {name}_Stage = 3 THEN
  IF {name}_PollOk AND {name}.MayWrite THEN
    {name}_Stage := 4;
  ELSE
    {name}_Stage := 0;
  END_IF;
ELSIF ({name}_Stage = 4) AND WRITTEN THEN
  {name}_Stage := 0;
END_IF;
{call}"""
_TWINCAT = """\
(* {bay} *)
{name}_Pause(IN := {name}_Stage = 0, PT := T#{pause}ms);
IF ({name}_Stage = 0) AND {name}_Pause.Q THEN
  {name}_Stage := 1;
END_IF;
{name}_Read(sIPAddr := '{host}', nTCPPort := {port}, nUnitID := {unit}, nQuantity := {words}, nMBAddr := 0,
  cbLength := SIZEOF({name}_Received), pDestAddr := ADR({name}_Received), bExecute := {name}_Stage = 2,
  tTimeout := T#1s);
{name}_Send(sIPAddr := '{host}', nTCPPort := {port}, nUnitID := {unit}, nQuantity := {written}, nMBAddr := {first},
  cbLength := SIZEOF({name}_Write), pSrcAddr := ADR({name}_Write), bExecute := {name}_Stage = 4,
  tTimeout := T#1s);
IF {name}_Stage = 1 THEN
  {name}_Stage := 2;
ELSIF ({name}_Stage = 2) AND NOT {name}_Read.bBusy THEN
"""
_TWINCAT += _AFTER_THE_READ.replace("GOOD", "NOT {name}_Read.bError").replace("WRITTEN", "NOT {name}_Send.bBusy")

_CODESYS = """\
(* {bay} *)
{name}_Client(xConnect := {name}_Connect, aIPAddr := {name}_Address, uiPort := {port});
{name}_Lost(IN := {name}_Connect AND NOT {name}_Client.xConnected, PT := T#3s);
IF {name}_Client.xError OR {name}_Lost.Q THEN
  {name}_Connect := FALSE;
  {name}_PollOk := FALSE;
  {name}_Stage := 0;
ELSE
  {name}_Connect := TRUE;
END_IF;
{name}_Pause(IN := ({name}_Stage = 0) AND {name}_Client.xConnected, PT := T#{pause}ms);
IF ({name}_Stage = 0) AND {name}_Pause.Q THEN
  {name}_Stage := 2;
END_IF;
{name}_Read(rClient := {name}_Client, xExecute := {name}_Stage = 2, uiUnitId := {unit}, uiStartItem := 0,
  uiQuantity := {words}, pData := ADR({name}_Received), udiReplyTimeout := 1000000);
{name}_Send(rClient := {name}_Client, xExecute := {name}_Stage = 4, uiUnitId := {unit}, uiStartItem := {first},
  uiQuantity := {written}, pData := ADR({name}_Write), udiReplyTimeout := 1000000);
IF ({name}_Stage = 2) AND ({name}_Read.xDone OR {name}_Read.xError) THEN
"""
_CODESYS += _AFTER_THE_READ.replace("GOOD", "{name}_Read.xDone").replace(
    "WRITTEN", "({name}_Send.xDone OR {name}_Send.xError)"
)


def twincat(targets: tuple[Target, ...]) -> Pou:
    """On the library Tc2_ModbusSrv, part of TF6250."""
    return _program(
        targets,
        _TWINCAT,
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
        _CODESYS,
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
    targets: tuple[Target, ...], template: str, blocks: Callable[[Target], tuple[Var, ...]], comment: str
) -> Pou:
    bodies = (
        template.format(
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
