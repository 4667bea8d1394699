"""OpenPLC Runtime 3: a program and the list of slave devices, both to upload. Pure.

OpenPLC copies what it reads from slave devices into the input image: 100 holding registers of the only device stand
from %IW100 on. It tells a program nothing about failed polls, so the heartbeat alone says whether the link lives.
"""

from gateway.modbus.exports import structured_text
from gateway.modbus.exports.logic import ascii_only
from gateway.modbus.exports.target import Target
from gateway.modbus.registers import BLOCK_WORDS

PROGRAM = "loading_bay.st"
DEVICES = "mbconfig.cfg"
FIRST_INPUT = 100  # OpenPLC's own number: what comes from slave devices begins at %IW100
POLL_MS = 100
_TIMEOUT_MS = 1000


def files(target: Target) -> dict[str, str]:
    """The program (Programs, Upload Program) and mbconfig.cfg (or type its values under Slave Devices)."""
    return {PROGRAM: _program(target), DEVICES: _devices(target)}


def _program(target: Target) -> str:
    inputs = "\n".join(f"  w{n} AT %IW{FIRST_INPUT + n} : WORD;" for n in range(BLOCK_WORDS))
    copies = "\n".join(f"Words[{n}] := w{n};" for n in range(BLOCK_WORDS))
    return structured_text.text(target) + ascii_only(
        f"""
PROGRAM loading_bay
VAR
{inputs}
  LoadingEnable AT %QX0.0 : BOOL;
  StopTruck AT %QX0.1 : BOOL;
  GatewayAlive AT %QX0.2 : BOOL;
  Diagnostic AT %QW0 : UINT;
  Reason AT %QW1 : UINT;
END_VAR
VAR
  Words : {structured_text.BLOCK};
  Gateway : {structured_text.FUNCTION_BLOCK};
END_VAR
{copies}
Gateway(PollOk := TRUE, Words := Words);
LoadingEnable := Gateway.Enable;
StopTruck := Gateway.MustStop;
GatewayAlive := Gateway.Alive;
Diagnostic := Gateway.Diagnostic;
Reason := Gateway.Reason;
END_PROGRAM

CONFIGURATION Config0
  RESOURCE Res0 ON PLC
    TASK Main(INTERVAL := T#20ms, PRIORITY := 0);
    PROGRAM Bay WITH Main : loading_bay;
  END_RESOURCE
END_CONFIGURATION
"""
    )


def _devices(target: Target) -> str:
    none = dict.fromkeys(("RTU_Baud_Rate", "RTU_Parity", "RTU_Data_Bits", "RTU_Stop_Bits", "RTU_TX_Pause"), "None")
    device: dict[str, str | int] = {
        "name": target.identifier,
        "slave_id": target.unit_id,
        "protocol": "TCP",
        "address": target.host,
        "IP_Port": target.port,
        **none,
        "Discrete_Inputs_Start": 0,
        "Discrete_Inputs_Size": 0,
        "Coils_Start": 0,
        "Coils_Size": 0,
        "Input_Registers_Start": 0,
        "Input_Registers_Size": 0,
        "Holding_Registers_Read_Start": 0,
        "Holding_Registers_Read_Size": BLOCK_WORDS,
        "Holding_Registers_Start": 0,
        "Holding_Registers_Size": 0,
    }
    lines = ['Num_Devices = "1"', f'Polling_Period = "{POLL_MS}"', f'Timeout = "{_TIMEOUT_MS}"']
    lines += ["# ------------", "#   DEVICE 0", "# ------------"]
    return "\n".join([*lines, *(f'device0.{key} = "{value}"' for key, value in device.items())]) + "\n"
