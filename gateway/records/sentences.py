"""The sentences of an account, as core/details.py has those of events: each page says them in its language. Pure."""

from gateway.core.details import DETAILS, Detail, Sentences

# Why stop is on, or may_move off.
SHUT_DOWN = Detail("shut_down", "the gateway was stopped: its final state, without any value")
NOT_TICKED = Detail(
    "not_ticked", "the control task did not run: without a tick in time every output shows stop, and no value"
)
STOOD_STILL = Detail(
    "stood_still", "the gateway's decision stood still: its last step was {0} s earlier; outputs then show stop"
)
MOVED = Detail("why_moved", "a truck that was in place moved without release: {0}", words=(0,))
MOVED_FROM = Detail("why_moved_from", "{0}; it was in place at {1}, and Z is {2} now", words=(0, 1, 2))
RESTORED = Detail(
    "restored", "a truck was in place before the gateway began anew; until it is again, the bay is clear, or a reset"
)
NO_TRUCK = Detail("no_truck", "no truck: no marker in the picture, and no echo")
CONTRADICT = Detail("contradict", "camera and ranger contradict each other: {0}", words=(0,))
NOT_FITTING = Detail("not_fitting", "camera and ranger do not fit, which ends no stop: {0}", words=(0,))
LATCHED = Detail("latched", "the stop is latched: no reset, no release, and the truck has not left")
GONE_ONLY = Detail("gone_only", "every cause has been gone for {0} s only; fusion.clear_hold_s is {1} s")
WITHHELD = Detail("withheld", "a technician's function check withholds may_move")
NO_HEARTBEAT = Detail("no_heartbeat", "no heartbeat of the PLC yet, and it is required")
NO_ENABLE = Detail("no_enable", "the PLC has not set enable (plc_control bit 0), and it is required")
NO_TRUCK_BIT = Detail("no_truck_bit", "the PLC reports no truck (plc_control bit 1), and one is required")
CAMERA_AGAIN = Detail(
    "camera_again",
    "the camera was {0} and has been good again for {1} s only; fusion.recovery_s is {2} s",
    words=(0,),
)
RANGER_AGAIN = Detail(
    "ranger_again",
    "the ranger was {0} and has been good again for {1} s only; fusion.recovery_s is {2} s",
    words=(0,),
)
FRAME_OLD = Detail("frame_old", "the newest frame was {0} s old; fusion.vision_deadline_s is {1} s")
READING_OLD = Detail("reading_old", "the ranger's newest reading was {0} s old; fusion.range_deadline_s is {1} s")
OF_CAMERA = Detail("of_camera", "camera: {0}", words=(0,))
OF_RANGER = Detail("of_ranger", "ranger: {0}", words=(0,))
BECAUSE = Detail("because", "{0} ({1})", words=(0, 1))
WRONG_SIZE = Detail("wrong_size", "{0}; a red disc of R {1} px does not fit the distance", words=(0,))
BEAT_STANDS = Detail("beat_stands", "plc_heartbeat has stood at {0} for {1} s; heartbeat_deadline_s is {2} s")
NOT_WRITTEN = Detail("not_written", "plc_heartbeat has not been written for {0} s; heartbeat_deadline_s is {1} s")
IN_PLACE = Detail("in_place", "in place")
IN_PLACE_AT = Detail("in_place_at", "in place at {0}", words=(0,))
COVERED = Detail("covered", "{0}; the marker has been covered for {1} s, and the ranger holds it: Z {2}", words=(0, 2))
STAYS = Detail("d_stays", "D stays 1: {0}; both sensors have not yet shown that the truck moved away", words=(0,))
STAYS_SINCE = Detail(
    "d_stays_since",
    "D stays 1: {0}; both sensors have not yet shown that the truck moved away since {1}",
    words=(0, 1),
)
RELEASED = Detail("why_released", "the PLC has released the truck: {0}; {1}", words=(0, 1))
OFF_MARK = Detail("off_mark", "it has left the mark")
MAY_LEAVE = Detail("may_leave", "it may leave although D is 1 or unknown")
NOTHING_STOPS = Detail("nothing_stops", "nothing stops the truck: D = 0, {0}; R_th {1} px, Z_th {2} mm", words=(0,))
PAIR = Detail("pair", "R {0}, Z {1}", words=(0, 1))
# What entered a step.
TICK = Detail("tick", "tick")
FRAME = Detail("frame", "frame {0}, {1} ms old: {2}", words=(2,))
WRITE = Detail("write", "write of {0}: {1}", words=(0, 1))
NOTHING_NEW = Detail("nothing_new", "nothing new")
CONNECTED = Detail("connected", "{0} connected", words=(0,))
DISCONNECTED = Detail("disconnected", "{0} disconnected", words=(0,))
CHECK = Detail("check", "function check: {0}", words=(0,))
WEAR = Detail("marker_wear", "the marker's rim over the visits")
NO_TICK = Detail("no_tick", "no tick in time")
THE_END = Detail("the_end", "the gateway's end")
ANEW = Detail("anew", "a new beginning of the recording")
WROTE = Detail("wrote", "{0} wrote {1}", words=(0, 1))
WROTE_REFUSED = Detail("wrote_refused", "refused, another writer owns the block")
BITS = Detail("bits", "{0}, bits {1}", words=(0, 1))
# What led to it.
MORE_CHANGES = Detail("more_changes", "{0} more changes, not listed")
PLACED = Detail("placed", "in place: {0}", words=(0,))
LAST_BEAT = Detail("last_beat", "the last change of plc_heartbeat, to {0}, by {1}", words=(1,))
R_FROM_HERE = Detail("r_from_here", "R was at least R_th from here on")
Z_FROM_HERE = Detail("z_from_here", "Z was at most Z_th from here on")
D_BECAME_1 = Detail("d_became_1", "D became 1")
LAST_CAUSE = Detail("last_cause", "the last cause ended: {0}", words=(0,))
LAST_FITTING = Detail("last_fitting", "the last that fitted: {0}", words=(0,))
NO_FIT = Detail("no_fit", "camera and ranger did not fit from here on")
NO_FRAME_HERE = Detail("no_frame_here", "no frame arrived from here on")
NEWEST_FRAME = Detail("newest_frame", "the newest frame, number {0}, was taken")
LAST_MARKER = Detail("last_marker", "the last frame with the marker, number {0}: R {1} px at ({2}, {3})")
LAST_DISTANCE = Detail("last_distance", "the last distance: Z {0} mm")
COVERED_HERE = Detail("covered_here", "the marker was covered from here on")
STOOD_HERE = Detail("stood_here", "D = 1, and the truck stood still, from here on")
COUNT = Detail("count", "{0} ({1} -> {2})", words=(0,))
COUNT_WHY = Detail("count_why", "{0} ({1} -> {2}: {3})", words=(0, 3))
REPLACED = Detail("replaced", "the vision process was replaced")
CAMERA_OPENED = Detail("camera_opened", "the camera was opened again")
FRAME_LOST = Detail("frame_lost", "a frame was lost with its process")
PORT_OPENED = Detail("port_opened", "the ranger's port was opened again")
# Where nothing was decided, or not all is certain.
NO_STATE = Detail("no_state", "no complete state of that moment is recorded")
RECORDS_MISSING = Detail("records_missing", "records are missing: {0}", words=(0,))
BEFORE_MISSING = Detail("before_missing", "the records before are missing: {0}", words=(0,))
STARTED = Detail("started", "the gateway started")
LAST_STEP = Detail("last_step", "the last step before was {0} s earlier")
NEXT_STEP = Detail("next_step", "{0}; the next one {1} s later", words=(0,))
WAS_OFF = Detail("was_off", "no output was served: the gateway had been shut down")
ENDS_BEFORE = Detail("ends_before", "the recording ends before that moment: {0}", words=(0,))
DID_NOT_RUN = Detail("did_not_run", "the gateway did not run")
KILLED = Detail(
    "killed", "no output was served: the gateway did not run: {0}; it ended without shutting down", words=(0,)
)
CONTROL_STOOD = Detail("control_stood", "the control task did not run: {0}", words=(0,))
MISSING = Detail("missing", "missing: {0}", words=(0,))
OTHERWISE = Detail(
    "otherwise",
    "{0} records were decided otherwise by gateway {1} than now: the causes are those of this version",
    words=(1,),
)
SO_FOR_LONGER = Detail("so_for_longer", "the outputs have been so for longer than was searched")
# The answer in one sentence.
MAY_MOVE = Detail("was_allowed", "The truck was allowed to move: {0}.", words=(0,))
STOP_ON = Detail("stop_on", "Stop was on: {0}.", words=(0,))
BOTH_OFF = Detail("both_off", "Stop was off, but may_move too: {0}.", words=(0,))

SENTENCES = Sentences.of(*DETAILS, *(one for one in list(vars().values()) if isinstance(one, Detail)))


def said(text: str) -> list[dict[str, object]]:
    """The sentences of a text as code, English text and values, which may be sentences; empty: it has none."""
    return [
        {"code": one.detail.code, "text": one.detail.text, "values": [said(value) or value for value in one.values]}
        for one in SENTENCES.told(text)
    ]


def happened(kind: str, detail: str) -> list[dict[str, object]]:
    """The same of an event."""
    what = kind.replace("_", " ")
    values = (what, said(detail) or detail) if detail else (what,)
    return [{"code": kind, "text": ": ".join(("{0}", "{1}")[: len(values)]), "values": values}]
