"""The sentences of an account, as core/details.py has those of events: each page says them in its language. Pure."""

from gateway.core.details import DETAILS, Detail, Sentences


def _of(code: str, text: str) -> Detail:
    """Any value may be a text."""
    return Detail(code, text, words=(0, 1, 2, 3))


# Why stop is on, or may_move off.
SHUT_DOWN = _of("shut_down", "the gateway was stopped: its final state, without any value")
NOT_TICKED = _of(
    "not_ticked", "the control task did not run: without a tick in time every output shows stop, and no value"
)
STOOD_STILL = _of(
    "stood_still", "the gateway's decision stood still: its last step was {0} s earlier; outputs then show stop"
)
MOVED = _of("why_moved", "a truck that was in place moved without release: {0}")
MOVED_FROM = _of("why_moved_from", "{0}; it was in place at {1}, and Z is {2} now")
RESTORED = _of(
    "restored", "a truck was in place before the gateway began anew; until it is again, the bay is clear, or a reset"
)
NO_TRUCK = _of("no_truck", "no truck: no marker in the picture, and no echo")
CONTRADICT = _of("contradict", "camera and ranger contradict each other: {0}")
NOT_FITTING = _of("not_fitting", "camera and ranger do not fit, which ends no stop: {0}")
LATCHED = _of("latched", "the stop is latched: no reset, no release, and the truck has not left")
GONE_ONLY = _of("gone_only", "every cause has been gone for {0} s only; fusion.clear_hold_s is {1} s")
WITHHELD = _of("withheld", "a technician's function check withholds may_move")
NO_HEARTBEAT = _of("no_heartbeat", "no heartbeat of the PLC yet, and it is required")
NO_ENABLE = _of("no_enable", "the PLC has not set enable (plc_control bit 0), and it is required")
NO_TRUCK_BIT = _of("no_truck_bit", "the PLC reports no truck (plc_control bit 1), and one is required")
CAMERA_AGAIN = _of(
    "camera_again", "the camera was {0} and has been good again for {1} s only; fusion.recovery_s is {2} s"
)
RANGER_AGAIN = _of(
    "ranger_again", "the ranger was {0} and has been good again for {1} s only; fusion.recovery_s is {2} s"
)
FRAME_OLD = _of("frame_old", "the newest frame was {0} s old; fusion.vision_deadline_s is {1} s")
READING_OLD = _of("reading_old", "the ranger's newest reading was {0} s old; fusion.range_deadline_s is {1} s")
OF_CAMERA = _of("of_camera", "camera: {0}")
OF_RANGER = _of("of_ranger", "ranger: {0}")
BECAUSE = _of("because", "{0} ({1})")
WRONG_SIZE = _of("wrong_size", "{0}; a red disc of R {1} px does not fit the distance")
BEAT_STANDS = _of("beat_stands", "plc_heartbeat has stood at {0} for {1} s; heartbeat_deadline_s is {2} s")
NOT_WRITTEN = _of("not_written", "plc_heartbeat has not been written for {0} s; heartbeat_deadline_s is {1} s")
IN_PLACE = _of("in_place", "in place")
IN_PLACE_AT = _of("in_place_at", "in place at {0}")
COVERED = _of("covered", "{0}; the marker has been covered for {1} s, and the ranger holds it: Z {2}")
STAYS = _of("d_stays", "D stays 1: {0}; both sensors have not yet shown that the truck moved away")
STAYS_SINCE = _of(
    "d_stays_since", "D stays 1: {0}; both sensors have not yet shown that the truck moved away since {1}"
)
RELEASED = _of("why_released", "the PLC has released the truck: {0}; {1}")
OFF_MARK = _of("off_mark", "it has left the mark")
MAY_LEAVE = _of("may_leave", "it may leave although D is 1 or unknown")
NOTHING_STOPS = _of("nothing_stops", "nothing stops the truck: D = 0, {0}; R_th {1} px, Z_th {2} mm")
PAIR = _of("pair", "R {0}, Z {1}")
# What entered a step.
TICK = _of("tick", "tick")
FRAME = _of("frame", "frame {0}, {1} ms old: {2}")
WRITE = _of("write", "write of {0}: {1}")
NOTHING_NEW = _of("nothing_new", "nothing new")
CONNECTED = _of("connected", "{0} connected")
DISCONNECTED = _of("disconnected", "{0} disconnected")
CHECK = _of("check", "function check: {0}")
WEAR = _of("marker_wear", "the marker's rim over the visits")
NO_TICK = _of("no_tick", "no tick in time")
THE_END = _of("the_end", "the gateway's end")
ANEW = _of("anew", "a new beginning of the recording")
WROTE = _of("wrote", "{0} wrote {1}")
WROTE_REFUSED = _of("wrote_refused", "refused, another writer owns the block")
BITS = _of("bits", "{0}, bits {1}")
# What led to it.
MORE_CHANGES = _of("more_changes", "{0} more changes, not listed")
PLACED = _of("placed", "in place: {0}")
LAST_BEAT = _of("last_beat", "the last change of plc_heartbeat, to {0}, by {1}")
R_FROM_HERE = _of("r_from_here", "R was at least R_th from here on")
Z_FROM_HERE = _of("z_from_here", "Z was at most Z_th from here on")
D_BECAME_1 = _of("d_became_1", "D became 1")
LAST_CAUSE = _of("last_cause", "the last cause ended: {0}")
LAST_FITTING = _of("last_fitting", "the last that fitted: {0}")
NO_FIT = _of("no_fit", "camera and ranger did not fit from here on")
NO_FRAME_HERE = _of("no_frame_here", "no frame arrived from here on")
NEWEST_FRAME = _of("newest_frame", "the newest frame, number {0}, was taken")
LAST_MARKER = _of("last_marker", "the last frame with the marker, number {0}: R {1} px at ({2}, {3})")
LAST_DISTANCE = _of("last_distance", "the last distance: Z {0} mm")
COVERED_HERE = _of("covered_here", "the marker was covered from here on")
STOOD_HERE = _of("stood_here", "D = 1, and the truck stood still, from here on")
COUNT = _of("count", "{0} ({1} -> {2})")
COUNT_WHY = _of("count_why", "{0} ({1} -> {2}: {3})")
REPLACED = _of("replaced", "the vision process was replaced")
CAMERA_OPENED = _of("camera_opened", "the camera was opened again")
FRAME_LOST = _of("frame_lost", "a frame was lost with its process")
PORT_OPENED = _of("port_opened", "the ranger's port was opened again")
# Where nothing was decided, or not all is certain.
NO_STATE = _of("no_state", "no complete state of that moment is recorded")
RECORDS_MISSING = _of("records_missing", "records are missing: {0}")
BEFORE_MISSING = _of("before_missing", "the records before are missing: {0}")
STARTED = _of("started", "the gateway started")
LAST_STEP = _of("last_step", "the last step before was {0} s earlier")
NEXT_STEP = _of("next_step", "{0}; the next one {1} s later")
WAS_OFF = _of("was_off", "no output was served: the gateway had been shut down")
ENDS_BEFORE = _of("ends_before", "the recording ends before that moment: {0}")
DID_NOT_RUN = _of("did_not_run", "the gateway did not run")
KILLED = _of("killed", "no output was served: the gateway did not run: {0}; it ended without shutting down")
CONTROL_STOOD = _of("control_stood", "the control task did not run: {0}")
MISSING = _of("missing", "missing: {0}")
OTHERWISE = _of(
    "otherwise", "{0} records were decided otherwise by gateway {1} than now: the causes are those of this version"
)
SO_FOR_LONGER = _of("so_for_longer", "the outputs have been so for longer than was searched")
# What is missing.
BETWEEN = _of("missing_between", "everything between {0} and {1}")
OF_ANOTHER = _of("of_another", "{0}: of another recording: {1}, not {2}")
START_BEFORE = _of("missing_start", "the start of the gateway before a complete state in {0}")
STEPS_BEFORE = _of("missing_steps", "the {0} steps before a complete state in {1}")
RECORDS_LOST = _of("records_lost", "in {0}, {1} records: {2}")
NOT_IN_TIME = _of("not_in_time", "not written in time")
HEAD_DAMAGED = _of("head_damaged", "all of {0}: its head is damaged")
CUT_OFF = _of("cut_off", "the end of {0}, cut off or damaged: the last {1} bytes")
DAMAGED = _of("bytes_damaged", "a part of {0}: {1} bytes at {2} are damaged")
PART_OF = _of("part_of", "a part of {0}: {1}")
OF_LATER_VERSION = _of("of_later_version", "a part of {0}: not {1} of this version or an earlier one: {2}")
# The answer in one sentence.
MAY_MOVE = _of("was_allowed", "The truck was allowed to move: {0}.")
STOP_ON = _of("stop_on", "Stop was on: {0}.")
BOTH_OFF = _of("both_off", "Stop was off, but may_move too: {0}.")

SENTENCES = Sentences.of(*DETAILS, *(one for one in list(vars().values()) if isinstance(one, Detail)))
said = SENTENCES.said


def happened(kind: str, detail: str, of: str = "") -> list[dict[str, object]]:
    """The same of an event; `of`: what it is about, in words between commas."""
    text = "{0} ({2})" if of else "{0}"
    values: list[object] = [kind.replace("_", " "), said(detail) or detail, of]
    return [{"code": kind, "text": f"{text}: {{1}}" if detail else text, "values": values}]
