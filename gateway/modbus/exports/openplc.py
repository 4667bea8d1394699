"""OpenPLC Runtime 3: a program and the list of slave devices, both to upload. Pure.

OpenPLC copies what it reads from slave devices into the input image, one device after the other from %IW100 on, and
what it writes to them from %QW100 on. It does not report failed polls to a program, so only the heartbeat shows
whether the link works.

%QX0.0 stays unused: it was the output of an earlier export that was on while the truck may move, and anything still
wired to it must not get another meaning.
"""

from gateway.errors import ConfigError
from gateway.modbus.exports import structured_text
from gateway.modbus.exports.interface import FIRST_WRITTEN, WRITTEN
from gateway.modbus.exports.logic import ascii_only
from gateway.modbus.exports.structured_text import BLOCK, FUNCTION_BLOCK
from gateway.modbus.exports.target import Target, template
from gateway.modbus.registers.register_map import BLOCK_WORDS

PROGRAM = "loading_bay.st"
DEVICES = "mbconfig.cfg"
FIRST_WORD = 100  # OpenPLC's own number: the area of slave devices begins at %IW100 and %QW100
MOST_WORDS = 400  # OpenPLC's own number, of all slave devices together: it writes on beyond its buffer
MOST_BAYS = MOST_WORDS // BLOCK_WORDS
FIRST_PERMIT = 4  # byte of the first bay's; it stays where the number of bays changes
POLL_MS = 100
_TIMEOUT_MS = 1000
OUTPUTS = ("MustStop", "Alive", "MayMove", "InPlace", "Moved", "Held", "Rolling")  # from bit 1 on
PERMIT = "LoadPermit"  # in a byte of its own, behind those of the last bay
INPUTS = (
    "EnableRequest",
    "TruckPresent",
    "Reset",
    "Release",
    "Trigger",
    "Acknowledge",
    "SpoutUp",
    "Start",
)  # never reorder


def files(targets: tuple[Target, ...]) -> dict[str, str]:
    """The program (Programs, Upload Program) and mbconfig.cfg (or type its values under Slave Devices)."""
    if len(targets) > MOST_BAYS:
        raise ConfigError(f"--bay: OpenPLC has room for {MOST_BAYS} bays, not for {len(targets)}")
    return {PROGRAM: _program(targets), DEVICES: _devices(targets)}


def _program(targets: tuple[Target, ...]) -> str:
    located = "\n".join(line for n, target in enumerate(targets) for line in _located(n, target))
    instances = "\n".join(
        f"  {target.instance} : {FUNCTION_BLOCK};\n  {target.instance}_Words : {BLOCK};" for target in targets
    )
    calls = "\n".join(line for target in targets for line in _calls(target))
    program = template(PROGRAM).format(located=located, instances=instances, calls=calls)
    return structured_text.declarations(targets) + ascii_only(program)


def _located(n: int, target: Target) -> list[str]:
    bay, first = target.instance, FIRST_WORD + n * BLOCK_WORDS
    lines = [f"  {bay}_w{word} AT %IW{first + word} : WORD;" for word in range(BLOCK_WORDS)]
    lines += [f"  {bay}_{name} AT %IX{n}.{bit} : BOOL;" for bit, name in enumerate(INPUTS)]
    lines += [f"  {bay}_{name} AT %QX{n}.{bit} : BOOL;" for bit, name in enumerate(OUTPUTS, 1)]
    lines += [f"  {bay}_{PERMIT} AT %QX{FIRST_PERMIT + n}.0 : BOOL;"]
    lines += [f"  {bay}_Diagnostic AT %QW{2 * n} : UINT;", f"  {bay}_Reason AT %QW{2 * n + 1} : UINT;"]
    lines += [f"  {bay}_Recipe AT %MW{n} : UINT;"]
    first = FIRST_WORD + n * len(WRITTEN)
    return lines + [f"  {bay}_{name} AT %QW{first + place} : UINT;" for place, name in enumerate(WRITTEN)]


def _calls(target: Target) -> list[str]:
    bay = target.instance
    lines = [f"{bay}_Words[{word}] := {bay}_w{word};" for word in range(BLOCK_WORDS)]
    given = "".join(f",\n  {name} := {bay}_{name}" for name in (*INPUTS, "Recipe"))
    # Without --writes it can't be answered: it reads beside whatever writes.
    writes = "TRUE" if target.writes else "FALSE"
    known = structured_text.right_bay(target)
    lines.append(f"{bay}(PollOk := TRUE, Words := {bay}_Words,\n  {known},\n  Writes := {writes}{given});")
    return lines + [f"{bay}_{name} := {bay}.{name};" for name in (*OUTPUTS, PERMIT, "Diagnostic", "Reason", *WRITTEN)]


def _devices(targets: tuple[Target, ...]) -> str:
    head = [f'Num_Devices = "{len(targets)}"', f'Polling_Period = "{POLL_MS}"', f'Timeout = "{_TIMEOUT_MS}"']
    return "\n".join([*head, *(line for n, target in enumerate(targets) for line in _device(n, target))]) + "\n"


def _device(n: int, target: Target) -> list[str]:
    none = dict.fromkeys(("RTU_Baud_Rate", "RTU_Parity", "RTU_Data_Bits", "RTU_Stop_Bits", "RTU_TX_Pause"), "None")
    entries: dict[str, str | int] = {
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
        # A refused write makes OpenPLC close the connection at every poll: only where the gateway takes them.
        "Holding_Registers_Start": FIRST_WRITTEN if target.writes else 0,
        "Holding_Registers_Size": len(WRITTEN) if target.writes else 0,
    }
    lines = ["# ------------", f"#   DEVICE {n}", "# ------------"]
    return [*lines, *(f'device{n}.{key} = "{value}"' for key, value in entries.items())]
