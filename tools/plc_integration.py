"""The tables of docs/plc-integration.md: formats, the block's interface, diagnoses, what to do on each reason. Pure."""

from collections.abc import Callable, Mapping

from gateway.core.state import Reason
from gateway.modbus.exports.approach import ENDS
from gateway.modbus.exports.diagnosis import CHECKS, MEANING, Diagnosis
from gateway.modbus.exports.interface import INPUTS, OUTPUTS
from gateway.modbus.exports.registry import SUMMARY, export
from gateway.modbus.exports.tables import markdown_table
from gateway.modbus.exports.target import Target

REMEDY: dict[Reason, str] = {
    Reason.NONE: "nothing",
    Reason.TARGET_REACHED: "nothing: the truck is at its mark; in_place turns on when it has stopped there",
    Reason.STOP_LATCHED: "let the truck leave, or reset the stop; handshake.md",
    Reason.MOVED: "look at the truck and the spout; then let it leave, or reset and bring it back; visit.md",
    Reason.CLEARING: "nothing: it ends by itself, as stop off, or with another reason",
    Reason.STARTING: "wait; after 10 s look at vision_quality and range_quality",
    Reason.VISION_STALE: "camera's cable and frame rate; the gateway's load",
    Reason.CAMERA_DOWN: "camera's power, cable and address; `gateway check` shows the configured one",
    Reason.NO_TARGET: "normal without a truck and while in_place is held; else clean the marker and the lens, look at"
    " the light",
    Reason.VISION_FAULT: "it restarts by itself; if it happens again, keep the gateway's log",
    Reason.TARGET_COASTED: "wait: it ends in a moment, as a measurement or as no_target",
    Reason.VISION_AGE_UNPROVEN: "`gateway doctor`: what proves the pictures' age; camera.unproven_age;"
    " vision-processes.md",
    Reason.BEACON_LOST: "does the LED blink, and is it where camera.beacon says; beacon.md",
    Reason.RANGE_STALE: "the ranger's USB cable; the gateway's load",
    Reason.RANGER_DOWN: "the ranger's USB cable and power; `gateway check` shows the configured port",
    Reason.NO_ECHO: "normal without a truck; else the sensor's aim, dirt, steam",
    Reason.RANGE_TOO_NEAR: "back the truck off; look for something in front of the sensor",
    Reason.RANGE_TOO_FAR: "normal without a truck; else the sensor's aim",
    Reason.RANGER_STUCK: "wire of ECHO, 5 V at the sensor; then replace the sensor",
    Reason.RANGE_UNSTABLE: "something moves in the cone; fasten the sensor; look for a second ultrasonic source",
    Reason.RANGER_VERSION: "flash the firmware that came with this gateway; firmware.md",
    Reason.RANGERS_DISAGREE: "one of the bay's rangers sees something else, or is loose; sensors.md",
    Reason.SENSORS_DISAGREE: "an obstacle in front of one of them, or another marker, lens or camera; visit.md",
    Reason.GATEWAY_FAULT: "restart the gateway; keep its log",
    Reason.SHUTDOWN: "the gateway was stopped; start it again",
    Reason.PLC_LOST: "write plc_heartbeat in every cycle, or set heartbeat_required = false",
}


def formats() -> str:
    """Every format with its files."""
    targets = (Target(),)
    rows = ((f"`{name}`", ", ".join(export(name, targets)), what) for name, what in SUMMARY.items())
    return markdown_table(("--format", "files", "what it is"), rows)


def block() -> str:
    """The function block's inputs and outputs."""
    rows = [(side, f"`{var.name}`", var.comment) for side, vars in (("in", INPUTS), ("out", OUTPUTS)) for var in vars]
    return markdown_table(("", "name", "what it is"), rows)


def diagnoses() -> str:
    """Every diagnosis of the generated programs, in the order in which its check is made."""
    fine = ("", str(int(Diagnosis.OK)), "`ok`", MEANING[int(Diagnosis.OK)][1], "")
    checks = (
        (c.needs.outputs, str(int(c.diagnosis)), f"`{c.diagnosis.name.lower()}`", c.meaning, c.action) for c in CHECKS
    )
    return markdown_table(("turns off", "Diagnostic", "name", "what it means", "what to do"), (fine, *checks))


def reasons() -> str:
    """Every reason with what to do about it."""
    rows = ((str(int(r)), f"`{r.name.lower()}`", REMEDY[r]) for r in Reason)
    return markdown_table(("reason", "name", "what to do"), rows)


def causes() -> str:
    """Why an approach of FB_Approach ended early."""
    return markdown_table(("Cause", "what it means"), ((str(int(end)), meaning) for end, (_, meaning) in ENDS.items()))


BLOCKS: Mapping[str, Callable[[], str]] = {
    "formats": formats,
    "block": block,
    "diagnoses": diagnoses,
    "reasons": reasons,
    "causes": causes,
}
