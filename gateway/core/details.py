"""The sentences of events, faults and alarms: each has a code, and an English text with places for its values. Pure.

What reports makes its text from here; what passes texts on, through processes, records and brokers, need not know them.
Where a page or a program is to have the code, `told` finds it again by the same table.
"""

import re
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from gateway.core.plc import RecipeVerdict
from gateway.core.readings import ExposureState, PictureFault
from gateway.core.state import Moved

_NUMBER = r"([-+]?\d[\d.]*)"
MOST_CHARACTERS = 600  # of a text: the time that a search may take grows with the square of it and more
MOST_DEPTH = 6  # of sentences in one another


@dataclass(frozen=True)
class Detail:
    """`text`: English, with {0}, {1} for the values; these are numbers, but for those in `words`: any text."""

    code: str
    text: str
    words: tuple[int, ...] = ()
    pattern: re.Pattern[str] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        parts = re.split(r"\{(\d)\}", self.text)  # text, number of a value, text, ...
        places = [
            (r"(.+?)" if int(part) in self.words else _NUMBER) if n % 2 else re.escape(part)
            for n, part in enumerate(parts)
        ]
        object.__setattr__(self, "pattern", re.compile("".join(places), re.DOTALL))

    def __call__(self, *values: object) -> str:
        """The sentence."""
        return self.text.format(*values)


@dataclass(frozen=True, slots=True)
class Told:
    """A part of a text: its sentence and the values, of which each may be such a text itself."""

    detail: Detail
    values: tuple[str, ...]


# A bay whose control task does not run.
CONTROL_SILENT = Detail("control_silent", "gateway_fault: the control task does not run")
CONTROL_AGAIN = Detail("control_again", "the control task runs again; no decision was valid for {0} s")
# Sensors.
AGE_UNPROVEN = Detail("age_unproven", "nothing proves how old its frames are (camera.unproven_age)")
NO_RESULT = Detail("no_result", "no result for {0} s")
NO_READING = Detail("no_reading", "no reading for {0} s")
RECOVERING = Detail("recovering", "good again, but not for long enough yet")
BEACON_NOT_SEEN = Detail("beacon_not_seen", "the code of the beacon is not in the pictures")
BEACON_LATE = Detail("beacon_late", "by the beacon the pictures are {0} ms older than the camera says")
NO_CIRCLE = Detail("no_circle", "detection without a usable circle")
NO_DISTANCE = Detail("no_distance", "reading without a usable distance")
RAW = Detail("raw", "{0} mm")
READINGS_JUMP = Detail("readings_jump", "readings jump, now {0} mm")
PORT_OPEN = Detail("port_open", "port open, waiting for the ranger")
WAITING_RANGER = Detail("waiting_ranger", "waiting for the ranger")
WAITING_HELLO = Detail("waiting_hello", "waiting for the ranger's hello")
RANGER_VERSION = Detail("ranger_version", "{0} uses protocol version {1}, this gateway {2}", words=(0,))
NOTHING_RECEIVED = Detail("nothing_received", "nothing received for {0} s")
NO_GOOD_LINE = Detail("no_good_line", "bytes, but no good line for {0} s: wrong baud rate, or not a ranger")
NO_MEASUREMENT = Detail("no_measurement", "no measurement for {0} s")
WAITING_SENSOR = Detail("waiting_sensor", "waiting for the sensor")
SENSOR_PORT_OPEN = Detail("sensor_port_open", "port open, waiting for the sensor")
SENSOR_NO_ANSWER = Detail("sensor_no_answer", "no answer")
SENSOR_NOTHING = Detail("sensor_nothing", "nothing received")
SENSOR_NO_LINE_END = Detail("sensor_no_line_end", "text without the end of a line")
SENSOR_OTHER_FORM = Detail("sensor_other_form", "lines of another form")
SENSOR_STORED = Detail("sensor_stored", "lines faster or later than ranger.number.period_ms, as from a store")
SENSOR_UNASKED = Detail("sensor_unasked", "bytes that nobody asked for")
SENSOR_DAMAGED = Detail("sensor_damaged", "damaged answers")
SENSOR_OTHER_REQUEST = Detail("sensor_other_request", "answers to another request, or of another unit")
SENSOR_TOO_SOON = Detail("sensor_too_soon", "answers sooner than the line carries them: late ones, or ranger.baud")
SENSOR_OTHER_LENGTH = Detail("sensor_other_length", "answers of another length")
SENSOR_EXCEPTION = Detail("sensor_exception", "exception {0}", words=(0,))
SENSOR_STATUS = Detail("sensor_status", "its status register holds 0x{0}", words=(0,))
SENSOR_FOR = Detail("sensor_for", "{0} for {1} s", words=(0,))
SENSOR_SENDS = Detail("sensor_sends", "the sensor sends {0}", words=(0,))
SENSOR_STUCK = Detail("sensor_stuck", "the sensor has sent {0} for {1} s", words=(0,))
RANGERS_DIFFER = Detail("rangers_differ", "the rangers measure {0} mm", words=(0,))
RANGER_N = Detail("ranger_n", "ranger {0}: {1}", words=(1,))
VISION_NOT_READY = Detail("vision_not_ready", "vision process not ready within {0} s")
VISION_SLOW = Detail("vision_slow", "vision process gave no result within {0} s")
VISION_SILENT = Detail("vision_silent", "vision process has stopped: no sign of life for {0} s")
DETECTOR_SILENT = Detail("detector_silent", "vision process has stopped: no sign of its detector for {0} s")
NO_FIRST_FRAME = Detail("no_first_frame", "{0}: no first frame within {1} s", words=(0,))
NO_FRAME = Detail("no_frame", "{0}: no frame within {1} s", words=(0,))
EXIT_CODE = Detail("exit_code", "ended with exit code {0}")
KILLED_BY = Detail("killed_by", "was killed by {0}", words=(0,))
COULD_NOT_START = Detail("could_not_start", "could not be started")
VISION_ENDED = Detail("vision_ended", "vision process {0}", words=(0,))
VISION_FAILED = Detail("vision_failed", "vision process: {0}", words=(0,))
DRIVER_CRASHED = Detail("driver_crashed", "{0}: vision process {1} in the source's driver", words=(0, 1))
CAMERA_SEES = Detail("camera_sees", "camera sees {0} mm, ranger {1} mm")
OTHER_SCALE = Detail("other_scale", "R x Z is not that of this marker: {0}", words=(0,))
# Where a truck stands.
WHERE = Detail("where", "Z {0} mm, R {1} px at ({2}, {3})")
WHERE_UNSEEN = Detail("where_unseen", "Z {0} mm, marker not seen")
WHERE_NO_Z = Detail("where_no_z", "Z unknown, R {0} px at ({1}, {2})")
WHERE_UNKNOWN = Detail("where_unknown", "Z unknown, marker not seen")
# A truck in place.
ROLLING = Detail("rolling", "by {0}: {1} -> {2}", words=(0, 1, 2))
NOT_VOUCHED = Detail("not_vouched", "the gateway can't vouch for it")
CLEAR = Detail("clear", "the bay is clear")
TRUCK_MOVED = Detail("truck_moved", "moved")
CAMERA_DEAD = Detail("camera_dead", "camera dead")
RANGER_DEAD = Detail("ranger_dead", "ranger dead")
IN_CHECK = Detail("in_check", "function check")
CONTRADICTION = Detail("contradiction", "contradiction")
DISTANCE_LOST = Detail("distance_lost", "no distance")
HELD_TOO_LONG = Detail("held_too_long", "held for too long")
BY_PLC = Detail("by_plc", "by the PLC")
# What the PLC does.
HEARTBEAT_STOPPED = Detail("heartbeat_stopped", "plc_heartbeat stopped at {0}")
HEARTBEAT_IS = Detail("heartbeat_is", "plc_heartbeat is {0}")
RECIPE_FROM_TO = Detail("recipe_from_to", "recipe {0} -> {1}")
RESET_BY_PLC = Detail("reset_by_plc", "reset by the PLC")
TRUCK_LEFT = Detail("truck_left", "the truck has left")
NOT_REPORTED = Detail("not_reported", "{0} (and {1} before it not reported)", words=(0,))
OTHER_OWNER = Detail("other_owner", "{0}: {1} owns the handshake block until its heartbeat is lost", words=(0, 1))
TWO_PROGRAMS = Detail(
    "two_programs",
    "{0}, connection {1}: its heartbeat arrives on connection {2} already; two of its programs write to this bay",
    words=(0, 1, 2),
)
WRITES_OFF = Detail("writes_off", "{0}: writes are off", words=(0,))
MAY_NOT_WRITE = Detail(
    "may_not_write",
    "{0}: it may not write (modbus.plc_addresses or, over TLS, modbus.tls.write_roles define who may)",
    words=(0,),
)
# A start, a function check.
WITH_BOTH = Detail("with_both", "with a function check on and a truck that was in place")
WITH_CHECK = Detail("with_check", "with a function check on")
WITH_TRUCK = Detail("with_truck", "with a truck that was in place")
KEPT = {(True, True): WITH_BOTH(), (True, False): WITH_CHECK(), (False, True): WITH_TRUCK(), (False, False): ""}
UNTRIED = Detail("untried", "not as last tried: {0}", words=(0,))
# A visit that is over: parts of one text.
VISIT_LENGTH = Detail("visit_length", "{0} s")
VISIT_NEVER = Detail("visit_never", "never in place")
VISIT_IN_PLACE = Detail("visit_in_place", "in place after {0} s for {1} s")
VISIT_R = Detail("visit_r", "R {0} px")
VISIT_Z = Detail("visit_z", "Z {0} mm")
VISIT_CORRECTIONS = Detail("visit_corrections", "corrections {0}")
VISIT_RELEASED = Detail("visit_released", "released")
VISIT_NOT_RELEASED = Detail("visit_not_released", "not released")
VISIT_INTERRUPTED = Detail("visit_interrupted", "interrupted by a restart")
# Alarms.
BOTH_SEE = Detail("both_see", "camera {0} mm, ranger {1} mm")
FROM = Detail("from", "{0}; in place at {1} mm", words=(0,))
STOOD = Detail("stood", "{0}; it stood at {1} mm", words=(0,))
NOW = Detail("now", "{0}, now {1} mm", words=(0,))
BY = Detail("by", "by {0}", words=(0,))
SCALE_JUMP = Detail("scale_jump", "R x Z {0} px mm, {1} %; learned from {2} visits")
RIM_SEEN = Detail("rim_seen", "rim visible {0} %: below {1} %")
RIM_SEEN_SOON = Detail("rim_seen_soon", "rim visible {0} %, falling {1} % a day: below {2} % in about {3} d")
RIM_FADED = Detail("rim_faded", "rim contrast {0}: below {1}")
RIM_FADED_SOON = Detail("rim_faded_soon", "rim contrast {0}, falling {1} a day: below {2} in about {3} d")
RIM_CLEANER = Detail("rim_cleaner", "rim visible {0} %, contrast {1}: better, but not by enough yet")
LOOKS_AWAY = Detail("looks_away", "the marker looks {0} mm away")
CHECK_OFF = Detail("check_may_move_off", "may_move_off")
CHECK_KEPT = Detail("check_may_move_kept", "may_move_kept")
ALARM_STEP = Detail("alarm_step", "{0}: {1}, now {2}", words=(0, 1, 2))
ALARM_STEP_BY = Detail("alarm_step_by", "{0}: {1}, now {2} by {3}", words=(0, 1, 2, 3))
CERT_EXPIRES = Detail("cert_expires", "{0} expires on {1}", words=(0, 1))
CERT_EXPIRED = Detail("cert_expired", "{0} expired on {1}", words=(0, 1))
BROKERS_EXPIRES = Detail("brokers_expires", "the certificate of {0} expires on {1}", words=(0, 1))
BROKERS_EXPIRED = Detail("brokers_expired", "the certificate of {0} expired on {1}", words=(0, 1))
AND_MORE = Detail("and_more", "{0}, and {1} more", words=(0,))
TOPIC_REFUSED = Detail("topic_refused", "{0} is refused: {1}", words=(0, 1))
TOO_LARGE = Detail("too_large", "{0} bytes, the broker accepts {1} (0x95)")
ENDS_AFTER = Detail("ends_after", "{0}; the connection ends after it", words=(0,))
ENDS_AFTER_WHY = Detail("ends_after_why", "the connection ends after it ({0})", words=(0,))
CLIENT_ID_TAKEN = Detail("client_id_taken", "another client is connected with our client id {0}", words=(0,))
CLIENT_ID_SHARED = Detail(
    "client_id_shared",
    "closed soon after it was accepted, {0} times or more: does another client use the client id {1}?",
    words=(1,),
)
BROKER_ENDED = Detail("broker_ended", "ended by the broker: {0}", words=(0,))
NO_PINGRESP = Detail("no_pingresp", "no answer to a PINGREQ")
CLOSED_BARE = Detail("closed_bare", "closed by the broker, or on the way to it, without a reason")
LINK_LOST = Detail("link_lost", "{0}: connection lost", words=(0,))
LINK_LOST_WHY = Detail("link_lost_why", "{0}: connection lost: {1}", words=(0, 1))
NO_LINK = Detail("no_link", "{0}: no connection within {1} s", words=(0,))
NO_ACKNOWLEDGEMENT = Detail("no_acknowledgement", "{0}: no acknowledgement within {1} s", words=(0,))
PICTURES_NOT_KEPT = Detail("pictures_not_kept", "{0} of {1} pictures of {2}: {3}", words=(2, 3))
PICTURES_OF_BAY = Detail("pictures_of_bay", "{0}: {1} of {2} pictures of {3}: {4}", words=(0, 3, 4))
PICTURES_BUDGET = Detail("pictures_budget", "picture_mb_per_day is used up")
PICTURES_NONE = Detail("pictures_none", "none was there")
PICTURES_TOO_LARGE = Detail("pictures_too_large", "too large for the memory")
COUNTED = Detail("counted", "{0} since the start of the gateway")
COUNTED_NEWEST = Detail("counted_newest", "{0} since the start of the gateway; {1}", words=(1,))

RECIPE_REFUSED = {
    verdict: Detail(f"recipe_{name}", f"recipe {{0}}: {name}")
    for verdict, name in ((verdict, verdict.name.lower()) for verdict in RecipeVerdict)
}
_LEFT: dict[Moved, str] = {moved: meaning for moved, meaning in Moved.meanings().items() if moved is not Moved.NO}
VISIT_MOVED: dict[Moved, Detail] = {
    moved: Detail(f"visit_{moved.name.lower()}", f"moved: {moved.name.lower()}") for moved in _LEFT
}
_FROM_TO_MOVED: dict[Moved, Detail] = {
    moved: Detail(f"moved_{moved.name.lower()}", f"{meaning}: {{0}} -> {{1}}", words=(0, 1))
    for moved, meaning in _LEFT.items()
}
_MEANINGS = (
    *(Detail(f"left_{moved.name.lower()}", moved.meaning) for moved in Moved),
    *(Detail(f"exposure_{state.name.lower()}", state.meaning) for state in ExposureState),
)

_NUMBERED = {
    PictureFault.DARK: "brightness {0}%",
    PictureFault.BRIGHT: "{0}% burnt out",
    PictureFault.FLAT: "contrast {0}%",
    PictureFault.BLURRED: "sharpness {0}%",
    PictureFault.DUSTY: "veil {0}%",
    PictureFault.SHIFTED: "shift {0} px",
}
_PICTURE = {
    (fault, known): Detail(f"{name}{'' if known else '_unknown'}", f"{name} ({number})" if known else name)
    for fault, name, number in ((fault, fault.name.lower(), number) for fault, number in _NUMBERED.items())
    for known in (True, False)
}
_TABLES = (*RECIPE_REFUSED.values(), *VISIT_MOVED.values(), *_FROM_TO_MOVED.values(), *_PICTURE.values(), *_MEANINGS)


@dataclass(frozen=True, eq=False)
class Sentences:
    """A table of them. `details`: those with more words of their own first, as a text may fit several."""

    details: tuple[Detail, ...]

    @staticmethod
    def of(*details: Detail) -> "Sentences":
        return Sentences(tuple(sorted(details, key=lambda detail: -len(re.sub(r"\{\d\}", "", detail.text)))))

    @lru_cache(maxsize=2048)  # noqa: B019 - the tables are there as long as the process
    def told(self, text: str) -> tuple[Told, ...]:
        """The sentences of a text, which are joined by "; " or ", " where there are several; empty: it is another's,
        such as an error of a device, or longer than MOST_CHARACTERS.
        """
        if len(text) > MOST_CHARACTERS:
            return ()
        for parts in (text.split("; "), [text], text.split(", ")):
            found = [self._one(part) for part in parts]
            if None not in found:
                return tuple(one for one in found if one is not None)
        return ()

    def said(self, text: str, depth: int = MOST_DEPTH) -> list[dict[str, Any]]:
        """The same as code, English text and values, which may be sentences themselves."""
        return [
            {
                "code": one.detail.code,
                "text": one.detail.text,
                "values": [self.said(value, depth - 1) or value for value in one.values],
            }
            for one in (self.told(text) if depth else ())
        ]

    def _one(self, text: str) -> Told | None:
        matches = ((detail, detail.pattern.fullmatch(text)) for detail in self.details)
        return next((Told(detail, match.groups()) for detail, match in matches if match is not None), None)


SENTENCES = Sentences.of(*(one for one in list(vars().values()) if isinstance(one, Detail)), *_TABLES)
DETAILS = SENTENCES.details
told = SENTENCES.told


def moved_from_to(moved: Moved, before: str, after: str) -> str:
    return _FROM_TO_MOVED[moved](before, after)


def picture(fault: PictureFault, number: str | None) -> str:
    """What is wrong with a picture; `number`: by how much, None: not known."""
    return _PICTURE[fault, number is not None](number)
