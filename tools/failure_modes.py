"""Failure modes and effects: what can fail, how it is detected, and what every output then shows. Pure.

The table of docs/fmea.md, after the worksheet of IEC 60812 without its ratings, because how often a part fails depends
on the plant. Each row is played by at least one test, which names it by `@pytest.mark.failure_mode(ID)`; a row without
a test fails the build (tests/unit/alarms/test_failure_modes.py).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from gateway.core.state import Reason


@dataclass(frozen=True, slots=True)
class Outputs:
    """What every output shows: Modbus, MQTT, Sparkplug, pages and shared memory (gateway/core/shown.py)."""

    stop: bool
    may_move: bool
    in_place: bool
    reason: Reason

    def text(self) -> str:
        on = [name for name in ("stop", "may_move", "in_place") if getattr(self, name)]
        return f"{', '.join(on)}; `{self.reason.name.lower()}`"


def stop(reason: Reason) -> Outputs:
    """Nothing but stop."""
    return Outputs(stop=True, may_move=False, in_place=False, reason=reason)


UNCHANGED_APPROACHING = Outputs(stop=False, may_move=True, in_place=False, reason=Reason.NONE)
UNCHANGED_IN_PLACE = Outputs(stop=True, may_move=False, in_place=True, reason=Reason.TARGET_REACHED)
HELD = Outputs(stop=True, may_move=False, in_place=True, reason=Reason.NO_TARGET)
SILENT = "PLC block off"


@dataclass(frozen=True, slots=True)
class FailureMode:
    """One row. `within_ms`: from the failure to the registers, at most, with the default configuration; None: the
    registers do not change because of it, or it is refused at once. `approaching`, `in_place`: the outputs after that
    time, for a truck that approached or was in place when it happened; None: it does not happen then. `alarm`: an id of
    gateway/alarms/bay_alarms.py and gateway_alarms.py."""

    id: str
    failure: str
    effect: str
    detection: str
    within_ms: int | None
    approaching: Outputs | str | None
    in_place: Outputs | str | None
    alarm: str = ""


def _same(id: str, failure: str, effect: str, detection: str, alarm: str = "") -> FailureMode:
    """A failure that may not reach the registers."""
    return FailureMode(id, failure, effect, detection, None, UNCHANGED_APPROACHING, UNCHANGED_IN_PLACE, alarm)


def _stops(
    id: str, failure: str, effect: str, detection: str, within_ms: int, reason: Reason, alarm: str = ""
) -> FailureMode:
    """A failure that stops a truck on its way and ends in_place."""
    return FailureMode(id, failure, effect, detection, within_ms, stop(reason), stop(reason), alarm)


UNSEEN = "the truck's movement is not seen"
MODES: Mapping[str, tuple[FailureMode, ...]] = {
    "Camera": (
        _stops("C1", "unplugged, or cannot be opened", UNSEEN, "the driver's error; opened again with backoff",
               100, Reason.CAMERA_DOWN, "camera_down"),
        _stops("C2", "hangs: no frame arrives", UNSEEN, "`fusion.vision_deadline_s` since the newest frame",
               320, Reason.VISION_STALE, "camera_stale"),
        _stops("C3", "the same picture again and again, with new times", "an old place is taken for the present one",
               "equal pictures keep the time of the first one; a clock in the picture does not count", 320,
               Reason.VISION_STALE, "camera_stale"),
        FailureMode("C4", "covered, dark or blinded", "no marker can be found", "no marker; the picture's own health",
                    320, stop(Reason.NO_TARGET), HELD, "picture_blind"),
        _same("C5", "blurred, dirty, veiled by dust", "markers are found late, and R is less sure",
              "sharpness and veil of the picture; once no marker is found: C4", "picture_poor"),
        _same("C6", "moved or turned on its mount", "the aim point is wrong by as much",
              "the fixed background is elsewhere; R x Z of a truck in place differs", "camera_moved"),
        _stops("C7", "pictures of another size than configured", "R in pixels means another distance",
               "the size of every frame; a lost camera, whose error names both sizes", 100, Reason.CAMERA_DOWN,
               "camera_down"),
        _stops("C8", "frames arrive late: a stall, a growing backlog", "an old place is taken for the present one",
               "each frame's own time (buffer or stream); values age from there", 320, Reason.VISION_STALE,
               "camera_stale"),
        _stops("C9", "a film or stream ends", "the end of a film gives values for ever",
               "the source's end; without `loop` it is not begun again", 100, Reason.CAMERA_DOWN, "camera_down"),
        _stops("C10", "set otherwise than `[camera.controls]` says: by another program, or another camera in its place",
               "the marker is darker, clipped or out of focus",
               "each is read back at the opening and every 10 s; a lost camera, whose error names the key", 10_100,
               Reason.CAMERA_DOWN, "camera_down"),
        _stops("C11", "nothing proves how old its frames are", "a picture that waited on its way counts as a new one",
               "no time in the stream; where `camera.unproven_age` accepts it, only a warning",
               100, Reason.VISION_AGE_UNPROVEN, "camera_stale"),
        _stops("C12", "with a beacon: pictures frozen, looped, stored, or of another camera, whatever their times say",
               "an old or foreign place is taken for the present one", "the code of the beacon's LED in the pictures",
               2000, Reason.BEACON_LOST, "beacon_lost"),
    ),
    "Vision process": (
        _stops("V1", "dies: killed, out of memory, a crash in a driver", UNSEEN, "the process's end; it is replaced",
               100, Reason.VISION_FAULT, "vision_fault"),
        _stops("V2", "stands still (stopped, or starved of processor time)", UNSEEN,
               "`fusion.vision_deadline_s`, then the monitor's deadlines; it is replaced", 320, Reason.VISION_STALE,
               "vision_fault"),
        _stops("V3", "the detector raises an error on a frame", "that frame has no result",
               "the error is reported; the process is replaced", 100, Reason.VISION_FAULT, "vision_fault"),
        _stops("V4", "the detector does not return", UNSEEN, "`fusion.vision_deadline_s`, then `vision.deadline_s`",
               320, Reason.VISION_STALE, "vision_fault"),
        _stops("V5", "reports what cannot be: negative radius, frames never taken, times from the future",
               "a wrong place is taken for the present one", "every message is checked; the process is replaced", 100,
               Reason.VISION_FAULT, "vision_fault"),
        _stops("V6", "a driver hangs and lets no other thread run", UNSEEN,
               "`fusion.vision_deadline_s`, then the monitor from outside", 320, Reason.VISION_STALE, "vision_fault"),
        _stops("V7", "its settings are changed while a truck is there (tuning page, settings page, reload)",
               "a value of the old settings counts beside the new ones",
               "all values are withdrawn at once; those of the new process count after `fusion.recovery_s`", 50,
               Reason.VISION_STALE),
    ),
    "Marker": (
        FailureMode("M1", "hidden: by dust, a tarpaulin, the spout", "no place is measured", "no marker in the picture",
                    500, stop(Reason.NO_TARGET), HELD),
        FailureMode("M2", "a red lamp is lit while the marker is covered", "the lamp is taken for the marker: R falls,"
                    " D would be 0, the truck would be sent away", "R x Z does not fit; after `visit.hold_grace_s`"
                    " in_place ends", 1300, None, stop(Reason.SENSORS_DISAGREE), "sensors_disagree"),
        FailureMode("M3", "something else, red and round, is seen from the first moment on",
                    "D follows the wrong circle", "R does not follow Z; R x Z learned from earlier trucks", None,
                    stop(Reason.SENSORS_DISAGREE), None, "sensors_disagree"),
        FailureMode("M4", "hidden for a few frames", "a predicted place is taken for a measured one",
                    "coasted values are never decided on", 100, stop(Reason.TARGET_COASTED),
                    Outputs(stop=True, may_move=False, in_place=True, reason=Reason.TARGET_COASTED)),
        _same("M5", "crusted or faded, little by little", "in the end no marker is found: C4",
              "visible share and contrast of the rim over the visits, with a forecast", "marker_worn"),
    ),
    "Ranger": (
        _stops("R1", "unplugged, or the port cannot be opened", UNSEEN, "the port's error; opened again with backoff",
               50, Reason.RANGER_DOWN, "ranger_down"),
        _stops("R2", "silent: no line arrives", UNSEEN, "`fusion.range_deadline_s` since the newest distance", 420,
               Reason.RANGE_STALE, "ranger_stale"),
        _stops("R3", "no echo, though a truck is there", "no distance", "the status in each line", 720, Reason.NO_ECHO,
               "ranger_no_echo"),
        _stops("R4", "ECHO held high: a broken sensor or wire", "no distance", "the status in each line", 250,
               Reason.RANGER_STUCK, "ranger_stuck"),
        _stops("R5", "something lies on the sensor (nearer than 2 cm)", "a distance that is not the truck's",
               "the status in each line", 700, Reason.RANGE_TOO_NEAR, "ranger_too_near"),
        _stops("R6", "every echo is beyond the range, though a truck is there", "no distance",
               "the status in each line", 700, Reason.RANGE_TOO_FAR),
        FailureMode("R7", "bytes on the wire are flipped, lost, invented", "a wrong number is taken for a distance",
                    "CRC of each line; a damaged line is counted and is no distance", None,
                    "as before while lines arrive undamaged within 400 ms, else as R2", "the same", "maintenance"),
        _stops("R8", "every other distance is wrong (known clones of the sensor)", "a wrong distance",
               "glitch gate: a jump counts only when it stays", 1500, Reason.RANGE_UNSTABLE, "ranger_unstable"),
        _stops("R9", "an echo of something nearer: spout, dust, a person", "Z is not the truck's",
               "Z jumps while R does not: a contradiction after `fusion.scale_lasting_s`; one short echo is a glitch",
               1300, Reason.SENSORS_DISAGREE, "sensors_disagree"),
        _stops("R10", "firmware of another protocol version", "lines may mean something else",
               "the version in the hello line; no distance is taken", 700, Reason.RANGER_VERSION, "ranger_version"),
        FailureMode("R11", "the board restarts", "distances are missing; sequence numbers begin anew",
                    "the hello line; nothing is taken before it", None,
                    "as before where distances are back within 400 ms, else as R2", "the same", "maintenance"),
        _stops("R12", "a serial server holds lines back, or delivers old ones",
               "an old distance is taken for the present one", "sequence numbers and the sensor's pace date each line",
               420, Reason.RANGE_STALE, "ranger_stale"),
        _same("R13", "a serial server floods the port", "the control task gets no processor time",
              "reads are bounded; the reader is a thread of its own"),
        FailureMode("R14", "another baud rate, or not a ranger at all", "random bytes are taken for distances",
                    "no line is whole; the log names the baud rate", None, stop(Reason.RANGE_STALE), None,
                    "ranger_stale"),
        _stops("R15", "one of two rangers is wrong, or two of three", "a wrong distance",
               "too few agree within `ranger.agree_mm`", 1300, Reason.RANGERS_DISAGREE, "ranger_unstable"),
        _same("R16", "the board's temperature sensor is lost", "Z is wrong by 0.18 % for each kelvin that the air is "
              "not at `temperature_c`", "lines without a temperature that is believed, for 5 s", "temperature_lost"),
    ),
    "Truck": (
        FailureMode("T1", "rolls while in place, marker seen or covered", "the spout is torn, material is spilled",
                    "it begins to move: `rolling`, BRAKE; Z leaves its band, or the marker is seen "
                    "elsewhere: `moved`", 300, None,
                    "stop; `moved`, or `no_target` while the marker is covered", "truck_rolling"),
        FailureMode("T2", "drives off without release", "the same", "as T1", 300, None,
                    "stop, until it has left or a reset; `moved`, or `no_target` while the marker is covered",
                    "truck_moved"),
        FailureMode("T3", "a second truck closes up behind the first",
                    "the place of the first is taken for the second's",
                    "in_place needs both sensors anew; a release is the first truck's alone", None,
                    "as for any truck", "as for any truck"),
        FailureMode("T4", "comes in too far, or stands askew", "the spout misses the port",
                    "distance below `guidance.overshoot_mm`; offset from the aim point", None, None,
                    stop(Reason.TARGET_REACHED)),
    ),
    "Gateway": (
        _stops("G1", "the control task crashes or hangs, sensors and servers run",
               "old values with a live server", "each state is valid for 250 ms; every output asks the same function",
               250, Reason.GATEWAY_FAULT, "control_dead"),
        FailureMode("G2", "killed, frozen, or its machine without power", "old values in the PLC",
                    "the PLC's function block: heartbeat", 500, SILENT, SILENT),
        _stops("G3", "stopped by an operator", "old values in the PLC", "the last state is stop", 50, Reason.SHUTDOWN),
        FailureMode("G4", "restarts in any phase of a visit",
                    "something is remembered as good; a truck in place is forgotten, and leaves without a release",
                    "nothing good is: in_place needs both sensors, a release is gone; latch, function check and the "
                    "place of a truck that was in place stay", None,
                    stop(Reason.STARTING), stop(Reason.STARTING)),
        FailureMode("G5", "the bay's file is damaged", "a function check is forgotten",
                    "strict: what no gateway has written is refused; it is put aside, and the bay starts in a function "
                    "check", None,
                    "stop or not as the sensors say; may_move and in_place off", "the same", "bay_file_damaged"),
        _same("G6", "the disk of the bay's file is full, slow or hangs", "what shall outlive a restart is lost",
              "an alarm; nothing waits for the disk", "bay_file_fault"),
        _same("G12", "the recorder process is killed, stopped, or its disk refuses", "decisions wait for a disk",
              "nothing waits for it; an alarm; what is missing is recorded as a gap", "recorder_fault"),
        _same("G13", "the index of the records cannot be written", "recording waits for it, or ends",
              "it is made of the records and never waited for; it catches up", "index_fault"),
        _same("G7", "another bay's camera or ranger fails", "one bay stops the others",
              "each bay has its own tasks, process and thread"),
        FailureMode("G8", "a task crashes again and again", "a gateway that works by halves",
                    "five crashes of a vital task in a minute end the gateway: G2", None, SILENT, SILENT),
        FailureMode("G9", "a wrong configuration", "another machine than intended",
                    "strict: unknown keys and values out of range are refused at the start", None,
                    "the gateway does not start", "the gateway does not start"),
        _stops("G10", "the register image cannot be encoded", "old registers", "an exception is a fault image", 50,
               Reason.GATEWAY_FAULT),
        FailureMode("G11", "another process reads the state vector of a dead gateway", "old values",
                    "a lock that only a living gateway holds", None, "no value, and an error", "the same"),
    ),
    "PLC and its network": (
        FailureMode("P1", "the network between gateway and PLC fails", "old values in the PLC",
                    "the PLC's function block: heartbeat", 500, SILENT, SILENT, "plc_not_reading"),
        FailureMode("P2", "the PLC stops, with writes on", "a truck moves while nobody controls the spout",
                    "the PLC's heartbeat: `modbus.handshake.heartbeat_deadline_s`", 1020, stop(Reason.PLC_LOST),
                    replace(UNCHANGED_IN_PLACE, reason=Reason.PLC_LOST), "plc_lost"),
        FailureMode("P3", "something between serves the same image for ever", "old values in the PLC",
                    "the function block counts a heartbeat only in images that pass all its checks", 500, SILENT,
                    SILENT),
        FailureMode("P4", "words or bytes in another order than the PLC expects", "numbers without meaning",
                    "the function block checks magic, version and the status word's copy", None, SILENT, SILENT),
        _same("P5", "a second master writes", "two masters command one bay",
              "the first writer owns the block until its heartbeat is lost; refused, counted, in a register"),
        _same("P6", "a stranger writes", "anybody commands the bay",
              "writes only from `plc_addresses` or by a TLS role"),
        _same("P7", "strangers take all connections or handshakes", "the PLC cannot connect",
              "shares for each address; room is kept for `plc_addresses`"),
        _same("P8", "malformed, endless or half requests", "the server hangs or crashes",
              "each connection has its own limits and ends alone"),
        _same("P9", "a certificate is revoked or expires while its connection is open", "a stranger goes on",
              "checked again while connected; the connection ends"),
        FailureMode("P10", "the PLC's `release` bit is always 1", "every truck is sent away from the mark",
                    "only a rising edge counts, and only for a truck that was in place", None, UNCHANGED_APPROACHING,
                    UNCHANGED_IN_PLACE),
        FailureMode("P11", "the PLC polls the unit id of another bay", "a spout is opened over another bay's truck",
                    "the function block compares `unit_id` and `bay_identity`: `Diagnostic` 13", None, SILENT, SILENT),
        FailureMode("P12", "the addresses of two gateways are swapped", "a spout is opened over another bay's truck",
                    "the function block compares `bay_identity`: `Diagnostic` 13", None, SILENT, SILENT),
        _same("P13", "two programs of one PLC write to one bay", "a truck is released by a program of another bay",
              "a heartbeat is taken from one connection at a time; refused, counted, in a register"),
        FailureMode("P14", "something between serves recorded images in turn", "old values in the PLC",
                    "the function block: the heartbeat goes back; where writes are on, `plc_heartbeat` does not return "
                    "the block's own numbers: `Diagnostic` 6, 14", 500, SILENT, SILENT),
    ),
    "MQTT": (
        _same("Q1", "broker dead, hung, or unreachable", "the registers wait for the broker; events are lost",
              "timeouts; events wait in the outbox, in order", "broker_lost"),
        _same("Q2", "the outbox's disk is full", "events are lost",
              "they stay in memory, up to its limit, and are written later", "event_store_fault"),
        _same("Q3", "the outbox's file is corrupt", "the gateway does not start", "put aside; a new one is begun"),
        FailureMode("Q4", "the gateway is killed, its retained state says otherwise", "SCADA shows old values",
                    "the broker publishes the last will: offline", None, "offline", "offline"),
        _same("Q5", "the broker has forgotten who subscribes to events", "it acknowledges them, and nobody gets them",
              "MQTT 5: kept, and tried again, for `mqtt.unsubscribed_h`", "events_unsubscribed"),
        _same("Q6", "the broker's ACL denies one topic", "the connection ends with every message of it",
              "its events wait, everything else of it is dropped; other topics go on", "messages_refused"),
        _same("Q7", "a message is larger than the broker accepts", "the same", "the same; MQTT 5: it is not sent",
              "messages_refused"),
    ),
    "Historian": (
        _same("H1", "database dead, hung, slow, full, or unreachable", "the registers wait for it; events are lost",
              "timeouts; events wait in the outbox, in order; states are skipped and counted", "sink_lost"),
        _same("H2", "the gateway or the database is killed while events are written", "events are lost, or there twice",
              "an event stays in the outbox until its commit; the database keeps each id once"),
    ),
    "Pages": (
        _same("W1", "the web process dies", "pages hang; the gateway waits for it", "replaced; the port stays open"),
        _same("W2", "the web process hangs", "the same", "silent for 15 s, or late to start: replaced"),
        _same("W3", "the web process is taken over, or floods", "a stranger commands the bay",
              "few rights; only named records, checked again; rates limited"),
        _same("W4", "viewers read slowly, or many look", "frames and ticks are late",
              "the web process has low priority and its own copy of a frame"),
        FailureMode("W5", "the driver's display loses the gateway, or its browser hangs",
                    "the driver goes on by an old sign", "three watches in the page, one needs no script", 500,
                    "STOP on the display", "STOP on the display"),
    ),
}  # fmt: skip

HEADER = (
    "| id | failure | effect, undetected | detected by | at most, ms | approaching | in place | alarm |\n"
    "|---|---|---|---|---|---|---|---|"
)


def rows() -> Iterator[FailureMode]:
    for modes in MODES.values():
        yield from modes


def markdown() -> str:
    """One table a component."""
    text = []
    for component, modes in MODES.items():
        text += [f"## {component}", "", HEADER, *map(_row, modes), ""]
    return "\n".join(text)


def _row(mode: FailureMode) -> str:
    cells = (
        mode.id,
        mode.failure,
        mode.effect,
        mode.detection,
        "-" if mode.within_ms is None else str(mode.within_ms),
        _shown(mode.approaching),
        _shown(mode.in_place),
        f"[`{mode.alarm}`](alarms.md#{mode.alarm})" if mode.alarm else "-",
    )
    return f"| {' | '.join(cells)} |"


def _shown(outputs: Outputs | str | None) -> str:
    if outputs is None:
        return "n/a"
    if outputs in (UNCHANGED_APPROACHING, UNCHANGED_IN_PLACE):
        return "unchanged"
    return outputs if isinstance(outputs, str) else outputs.text()
