"""The function block's body, once for IEC 61131-3 structured text, Siemens SCL and, but for the decoding, Logix. Pure.

Written as SCL, with `#` before local names and function names in quotes; `iec` takes both away, logix.py
translates. Only what every language and tool shares is used: no pointers, no unions, no shifts, no 64-bit numbers. A
float is put together by arithmetic, which is exact because only powers of two are multiplied.
"""

import re
from collections.abc import Iterator, Sequence

from gateway.core.shown import withdrawn
from gateway.core.state import StateVector
from gateway.modbus.exports.decode import NO_VALUE, decode
from gateway.modbus.exports.diagnosis import (
    ALIVE,
    FIRST_ALIVE,
    HALF_CIRCLE,
    HEARTBEAT_CHANGES,
    LAST_ALIVE,
    SOUND,
    VALUES,
    Check,
    Diagnosis,
)
from gateway.modbus.exports.fields import fields
from gateway.modbus.exports.interface import REQUESTS
from gateway.modbus.exports.target import Target
from gateway.modbus.registers.register_map import encode

_PLAIN = {"×": "x", "–": "-", "°": "deg", "±": "+-", "µ": "u"}


def _forward(steps: str, since: str, now: str) -> str:
    """`steps` becomes how far `now` is ahead of `since`, modulo 65536: no language's own overflow is needed."""
    return f"""\
  IF {now} >= {since} THEN
    {steps} := {now} - {since};
  ELSE
    {steps} := (65535 - {since}) + {now} + 1;
  END_IF;
"""


_HEARTBEAT = f"""\
(* The heartbeat counts in valid images only: {HEARTBEAT_CHANGES} changes forward, with no invalid image between.
   An image left over from before and one frozen image make a single change; one that goes back was seen before. *)
#Changed := FALSE;
IF #Sound THEN
{_forward("#Steps", "#LastHeartbeat", "#Raw.heartbeat")}\
  IF #Seen AND (#Steps >= {HALF_CIRCLE}) THEN
    #Changes := 0;
  ELSIF #Seen AND (#Steps > 0) THEN
    #Changed := TRUE;
    IF #Changes < {HEARTBEAT_CHANGES} THEN
      #Changes := #Changes + 1;
    END_IF;
  END_IF;
  #LastHeartbeat := #Raw.heartbeat;
  #Seen := TRUE;
ELSE
  #Seen := FALSE;
  #Changes := 0;
END_IF;
#HeartbeatTimer(IN := NOT #Changed, PT := #HeartbeatTimeout);
IF #HeartbeatTimer.Q THEN
  #Changes := 0;
END_IF;
#Beating := #Changes >= {HEARTBEAT_CHANGES};

(* Where the gateway accepts writes, its plc_heartbeat returns what this block wrote. A number newer than Challenge, but
   not newer than this block's own, proves that the image answers this block: {HEARTBEAT_CHANGES} such answers. *)
#Answered := FALSE;
#MayWrite := #Sound AND #Writes AND #Raw.handshake_status_writes_on;
IF #MayWrite THEN
{_forward("#Steps", "#Challenge", "#Raw.plc_heartbeat")}\
{_forward("#Written", "#Challenge", "#PlcHeartbeat")}\
  #Answered := (#Steps > 0) AND (#Steps <= #Written);
END_IF;
IF #Answered THEN
  #Challenge := #PlcHeartbeat;
  IF #Answers < {HEARTBEAT_CHANGES} THEN
    #Answers := #Answers + 1;
  END_IF;
END_IF;
#AnswerTimer(IN := NOT #Answered, PT := #HeartbeatTimeout);
IF #AnswerTimer.Q THEN
  #Answers := 0;
END_IF;
#Answering := #Answers >= {HEARTBEAT_CHANGES};
"""

_OUTPUTS = """\
(* Whatever is not known to be right turns both outputs off. Nothing of a doubtful image is passed on: Data then reads
   as that of a gateway that has stopped deciding. *)
#Alive := (#Diagnostic = 0) OR ((#Diagnostic >= {first_alive}) AND (#Diagnostic <= {last_alive}));
IF #Alive THEN
  #Data := #Raw;
ELSE
{nothing}
END_IF;
#MayMove := (#Diagnostic = 0) AND (#Data.may_move = 1) AND (#Data.stop = 0);
#InPlace := (#Diagnostic = 0) AND (#Data.in_place = 1) AND (#Data.stop = 1);
#Moved := #Data.moved <> 0;
#Held := #InPlace AND #Data.position_status_held;
#Rolling := #Data.position_status_rolling;
(* What has stopped loading must not let it go on by itself: each begin has its own Start. *)
IF (NOT #InPlace) OR #Rolling THEN
  #LoadPermit := FALSE;
ELSIF #Start AND (NOT #StartWas) THEN
  #LoadPermit := TRUE;
END_IF;
#StartWas := #Start;
#MustStop := #Data.stop <> 0;
#Reason := #Data.reason;
"""

# The trigger's bit goes up only when the gateway knows this PLC and was seen to have the bit off: then it is an edge.
_TRIGGER = """\
(* A triggered measurement, step by step: request, accept, read, acknowledge. Each step but the read has a timeout.
   A result that nobody here has asked for, from before this block's start, is acknowledged: no trigger is accepted
   until then. Its bit is taken back where it had been on already, and made no edge. *)
#Entered := FALSE;
IF #Trigger AND (NOT #TriggerWas) AND (#Stage = 0) THEN
  #Stage := 1;
  #Entered := TRUE;
  #TriggerFailed := FALSE;
END_IF;
#TriggerWas := #Trigger;
IF #Alive THEN
  IF (#Stage < 2) AND (NOT #TriggerBit) THEN
    #AcknowledgeBit := #Data.handshake_status_results_valid AND (NOT #Data.plc_control_results_ack);
  END_IF;
  IF #Stage = 1 THEN
    IF #Data.handshake_status_plc_alive AND #Data.handshake_status_trigger_ready
        AND (NOT #Data.plc_control_trigger) THEN
      #TriggerBit := TRUE;
    END_IF;
    IF #TriggerBit AND #Data.handshake_status_trigger_ack THEN
      #TriggerBit := FALSE;
      #Stage := 2;
      #Entered := TRUE;
    END_IF;
  ELSIF #Stage = 2 THEN
    IF #Data.handshake_status_results_valid AND (#Data.result_id = #Data.acquisition_id) THEN
      #Stage := 3;
      #Entered := TRUE;
    ELSIF #Data.handshake_status_timed_out THEN
      #Stage := 0;
      #TriggerFailed := TRUE;
    END_IF;
  ELSIF #Stage = 3 THEN
    IF NOT #Data.handshake_status_results_valid THEN
      #Stage := 0;
      #TriggerFailed := TRUE;
    ELSIF #Acknowledge THEN
      #AcknowledgeBit := TRUE;
      #Stage := 4;
      #Entered := TRUE;
    END_IF;
  ELSIF #Stage = 4 THEN
    IF NOT #Data.handshake_status_results_valid THEN
      #AcknowledgeBit := FALSE;
      #Stage := 0;
    END_IF;
  END_IF;
END_IF;
#StageTimer(IN := (#Stage <> 0) AND (#Stage <> 3) AND (NOT #Entered), PT := {limit});
IF #StageTimer.Q THEN
  #TriggerBit := FALSE;
  #AcknowledgeBit := FALSE;
  #Stage := 0;
  #TriggerFailed := TRUE;
END_IF;
#TriggerReady := #Alive AND (#Stage = 0) AND #Data.handshake_status_plc_alive
    AND #Data.handshake_status_trigger_ready;
#Measuring := (#Stage = 1) OR (#Stage = 2);
#ResultReady := #Alive AND (#Stage = 3);
"""

_RELEASE = """\
IF (NOT #Release) OR (NOT #SpoutUp) THEN
  #ReleaseBit := FALSE;
ELSIF NOT #ReleaseWas THEN
  #ReleaseBit := TRUE;
END_IF;
#ReleaseWas := #Release;"""

_HEARTBEAT_OUT = """\
#RecipeSelect := #Recipe;
IF #PlcHeartbeat >= 65535 THEN
  #PlcHeartbeat := 0;
ELSE
  #PlcHeartbeat := #PlcHeartbeat + 1;
END_IF;"""


def body(target: Target) -> str:
    """The body of the function block: decode, checks, heartbeat, outputs, triggered measurement, what is written."""
    return f"{decode(target)}\n{logic(target)}"


def logic(target: Target) -> str:
    """All after the decoding: the same in every language of IEC 61131-3 and at Rockwell."""
    outputs = _OUTPUTS.format(first_alive=FIRST_ALIVE, last_alive=LAST_ALIVE, nothing=indented(nothing()))
    trigger = _TRIGGER.format(limit=f"T#{target.step_timeout_ms}ms")
    return "\n".join((judgement(), outputs, trigger, _requests()))


def judgement() -> str:
    """From `Raw` to `Diagnostic`: the checks of an image, the heartbeat, the checks of its values."""
    return "\n".join((_sound(), _HEARTBEAT, _values()))


def nothing() -> str:
    """Data as that of a gateway that has stopped deciding."""
    dead = (f"#Data.{name} := {value};" for name, value in dead_fields())
    return "\n".join(("#Data := #Nothing;", *dead))


def indented(text: str) -> str:
    return "\n".join(f"  {line}" for line in text.splitlines())


def dead_fields() -> Iterator[tuple[str, str]]:
    """(field, value) of every code, flag and bit that is not 0 in the image of a gateway that has stopped deciding, and
    of every REAL without a value.

    Without them an empty structure would mean "quality good, no reason", and a truck that touches the sensor.
    """
    image = encode(withdrawn(StateVector(""), 0), 0, "big")
    for field in fields():
        register = field.register
        if field.kind == "REAL" and register.kind.no_value is not None:
            yield field.name, NO_VALUE
        if register.codes is None and register.bits is None and register.name != "stop":
            continue
        word = image[register.address]
        if field.part == "bit" and word >> field.bit & 1:
            yield field.name, "TRUE"
        elif field.part == "value" and word not in (0, register.kind.no_value):
            yield field.name, str(word)


def _sound() -> str:
    """The checks of an image itself, before anything in it counts."""
    lines = ["(* The first check that fails turns outputs off. First those of the image itself. *)"]
    return "\n".join([*lines, *_chain(SOUND), "#Sound := #Diagnostic = 0;", ""])


def _values() -> str:
    """The checks of a sound image."""
    chain = indented("\n".join(_chain((*ALIVE, *VALUES))))
    return f"(* Then the checks of the values in a valid image. *)\nIF #Sound THEN\n{chain}\nEND_IF;\n"


def _chain(checks: Sequence[Check]) -> Iterator[str]:
    for n, check in enumerate(checks):
        yield f"{'ELSIF' if n else 'IF'} {check.condition} THEN"
        yield f"  #Diagnostic := {int(check.diagnosis)}; (* {check.meaning} *)"
    yield from ("ELSE", "  #Diagnostic := 0;", "END_IF;")


def _requests() -> str:
    """What is written to the gateway: its bits are put together by adding, which every language can."""
    lines = [_RELEASE, "#PlcControl := 0;"]
    for name, bit in REQUESTS:
        lines.append(f"IF #{name} THEN\n  #PlcControl := #PlcControl + {1 << bit};\nEND_IF;")
    return f"""\
(* What is written to the gateway, where it accepts writes. Another bay gets no request of this one, no heartbeat.
   A release begins with its own edge while the spout is up: no spout that goes up releases a truck by itself. *)
IF #Diagnostic <> {int(Diagnosis.WRONG_BAY)} THEN
{indented(chr(10).join([*lines, _HEARTBEAT_OUT]))}
END_IF;
"""


def iec(text: str) -> str:
    """SCL's local names and quoted function names as plain IEC identifiers. Typed literals keep their `#`."""
    return re.sub(r'"(\w+)"', r"\1", re.sub(r"(?<!\w)#(?=[A-Za-z_])", "", text))


def ascii_only(text: str) -> str:
    """PLC tools disagree on encodings; the few signs that are not ASCII have a plain spelling."""
    for sign, plain in _PLAIN.items():
        text = text.replace(sign, plain)
    return text.encode("ascii", "replace").decode("ascii")
