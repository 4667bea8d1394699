"""A measurement triggered by an OPC UA client, in the main process: writes to the handshake block as a PLC would make
them, of the trigger's bits only.

The block belongs to one writer: while it is a PLC's, nothing is triggered. The client keeps it no longer than
`handshake.heartbeat_deadline_s`, so that it can't exclude the PLC (decision 16).
"""

from gateway.bay import BayControl
from gateway.core.plc import Control, PlcConnection, PlcWrite, TriggerPhase, Writer, WriteVerdict

TRIGGER, ACK = 1 << Control.TRIGGER, 1 << Control.RESULTS_ACK


def trigger(bay: BayControl, who: Writer) -> str:
    """Why nothing was triggered; empty: a measurement has begun. A result that is still held is given up."""
    try:
        for control in (0, ACK, 0, TRIGGER, 0) if bay.state().plc.phase is TriggerPhase.VALID else (0, TRIGGER, 0):
            verdict = bay.on_write(PlcWrite(who, control=control, mask=TRIGGER | ACK))
            if verdict is not WriteVerdict.TAKEN:
                return f"the handshake block was not free: {verdict.name.lower()}"
    finally:
        bay.on_connection(PlcConnection(who, open=False))
    plc = bay.state().plc
    return "" if plc.phase is TriggerPhase.ACQUIRING and not plc.overrun else "a measurement was running"
