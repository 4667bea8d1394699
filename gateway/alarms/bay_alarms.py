"""The alarms that each bay has. Pure.

docs/alarms.md is made from the rows. ISA-18.2: an alarm requires an action in time. These do not: an empty bay, a
truck in place, a marker that is hidden for a moment, a sensor that starts.
"""

from collections.abc import Callable

from gateway.alarms.definition import MINUTE_S, AlarmDefinition, BayInputs, Priority, Suppression
from gateway.core import details
from gateway.core.ne107 import degraded
from gateway.core.readings import BEYOND_RANGE, DEAD, FRESH_FRAME, UNCONTROLLED, PictureFault, Quality
from gateway.core.state import FunctionCheck, Moved, Reason

ECHO_DUE_SHARE = 0.625  # of the ranger's range: a truck whose marker looks nearer must give an echo
ECHO_DUE_MM = 2500.0  # where the range is not known
Condition = Callable[[BayInputs], bool]
Detail = Callable[[BayInputs], str]


def _vision(quality: Quality) -> tuple[Condition, Detail]:
    return lambda inputs: inputs.state.vision.quality is quality, lambda inputs: inputs.state.vision.detail


def _range(quality: Quality) -> tuple[Condition, Detail]:
    return lambda inputs: inputs.state.range.quality is quality, lambda inputs: inputs.state.range.detail


def expected_mm(inputs: BayInputs) -> float | None:
    """How far the marker looks: by the cross-check where it is configured, else by R Z = R_th Z_th. None: no marker."""
    state = inputs.state
    if state.z_vision_mm is not None:
        return state.z_vision_mm
    circle = state.vision.circle
    if circle is None or circle.radius_px <= 0:
        return None
    fusion = inputs.config.fusion
    return fusion.distance_threshold_mm * fusion.radius_threshold_px / circle.radius_px


def _no_echo(inputs: BayInputs) -> bool:
    if inputs.state.range.quality not in BEYOND_RANGE:
        return False
    far_mm, max_range_mm = expected_mm(inputs), inputs.config.ranger.max_range_mm
    due_mm = ECHO_DUE_MM if max_range_mm is None else ECHO_DUE_SHARE * max_range_mm
    return far_mm is not None and far_mm < due_mm


def _disagree_detail(inputs: BayInputs) -> str:
    far_mm, near_mm = inputs.state.z_vision_mm, inputs.state.range.distance_mm
    return "" if far_mm is None or near_mm is None else details.BOTH_SEE(f"{far_mm:.0f}", f"{near_mm:.0f}")


def _truck_moved(inputs: BayInputs) -> bool:
    return inputs.state.visit.moved is not Moved.NO and inputs.state.to_stand


def _truck_moved_detail(inputs: BayInputs) -> str:
    place, now_mm = inputs.state.visit.place, inputs.state.range.distance_mm
    was_mm = None if place is None else place.distance_mm
    return _was_and_now(details.FROM, inputs.state.visit.moved.meaning, was_mm, now_mm)


def _was_and_now(was: details.Detail, what: str, was_mm: float | None, now_mm: float | None) -> str:
    told = what if was_mm is None else was(what, f"{was_mm:.0f}")
    return told if now_mm is None else details.NOW(told, f"{now_mm:.0f}")


def _truck_rolling(inputs: BayInputs) -> bool:
    return inputs.state.unintended_motion


def _truck_rolling_detail(inputs: BayInputs) -> str:
    reference, now_mm = inputs.state.visit.reference, inputs.state.range.distance_mm
    if reference is None:
        return ""
    return _was_and_now(details.STOOD, details.BY(reference.sensor), reference.distance_mm, now_mm)


def _in_place_lost(inputs: BayInputs) -> bool:
    state, visit = inputs.state, inputs.state.visit
    was_in_place = visit.monitored and not visit.in_place and not visit.released and visit.moved is Moved.NO
    alive = not {state.vision.quality, state.range.quality} & (DEAD | {Quality.WAITING})
    return was_in_place and alive and state.d is not False and state.function_check is FunctionCheck.OFF


def _jump(inputs: BayInputs) -> float | None:
    scale = inputs.state.memory.scale
    return None if scale is None else scale.jump


def _scale_detail(inputs: BayInputs) -> str:
    scale, jump = inputs.state.memory.scale, _jump(inputs)
    if scale is None or jump is None:
        return ""
    return details.SCALE_JUMP(f"{scale.newest.px_mm:.0f}", f"{100 * jump:+.0f}", scale.visits)


def _wear_detail(inputs: BayInputs) -> str:
    """Of what is below its limit first."""
    wear, limits = inputs.state.marker, inputs.config.camera.picture
    if wear is None:
        return ""
    seen, faded, left = wear.visible, wear.contrast, wear.days_left
    if left is None:
        return details.RIM_CLEANER(f"{100 * seen.value:.0f}", f"{faded.value:.2f}")
    days = f"{left:.0f}" if left >= 1 else f"{max(left, 0.1):.1f}"
    if seen.days_left == left:
        now, least = _told_apart(100 * seen.value, 100 * limits.rim_visible_min, 0)
        fall = _at_least(-100 * (seen.per_day or 0), 1)
        return details.RIM_SEEN_SOON(now, fall, least, days) if left else details.RIM_SEEN(now, least)
    now, least = _told_apart(faded.value, limits.rim_contrast_min, 2)
    fall = _at_least(-(faded.per_day or 0), 3)
    return details.RIM_FADED_SOON(now, fall, least, days) if left else details.RIM_FADED(now, least)


def _told_apart(value: float, limit: float, digits: int) -> tuple[str, str]:
    """Both, with more digits where they would read the same."""
    more = digits if f"{value:.{digits}f}" != f"{limit:.{digits}f}" else digits + 2
    return f"{value:.{more}f}", f"{limit:.{more}f}"


def _at_least(value: float, digits: int) -> str:
    """Not 0 where it is none."""
    return f"{value:.{digits}f}" if round(value, digits) else f"< {10**-digits}"


def _picture(*faults: PictureFault) -> tuple[Condition, Detail]:
    def holds(inputs: BayInputs) -> bool:
        return (health := inputs.state.picture) is not None and any(fault in health.faults for fault in faults)

    return holds, _picture_detail


def _picture_detail(inputs: BayInputs) -> str:
    """What of the picture is wrong, with the numbers."""
    health = inputs.state.picture
    if health is None or not health.faults:
        return ""
    numbers = {
        PictureFault.DARK: f"{100 * health.brightness:.1f}",
        PictureFault.BRIGHT: f"{100 * health.clipped:.0f}",
        PictureFault.FLAT: f"{100 * health.contrast:.1f}",
        PictureFault.BLURRED: None if health.sharpness is None else f"{100 * health.sharpness:.0f}",
        PictureFault.DUSTY: None if health.veil is None else f"{100 * health.veil:.0f}",
        PictureFault.SHIFTED: None if health.shift_px is None else f"{health.shift_px:.0f}",
    }
    return ", ".join(details.picture(fault, numbers[fault]) for fault in health.faults)


STOPS = "stop is on, may_move and in_place are off: no truck may move, and none may be loaded"

BAY_ALARMS: tuple[AlarmDefinition[BayInputs], ...] = (
    AlarmDefinition(
        "control_dead",
        "Control task dead",
        Priority.HIGH,
        "nothing computes this bay's state any more; the PLC reads stop, reason GATEWAY_FAULT",
        STOPS,
        ("a fault in the software", "a machine that is overloaded or short of memory"),
        "work by hand; look at the machine's load and the gateway's log; restart the gateway; report the log",
        5,
        lambda inputs: inputs.state.reason is Reason.GATEWAY_FAULT,
        on_delay_s=0.5,
        suppressed_by=frozenset({Suppression.SHUTDOWN}),
    ),
    AlarmDefinition(
        "plc_lost",
        "PLC heartbeat lost",
        Priority.HIGH,
        "the PLC's heartbeat is required and does not arrive, or does not change",
        "stop is on and may_move off: no truck may move; in_place stays, and a release ends",
        ("the PLC is in stop or was restarted", "network or cable", "the heartbeat is missing in the PLC's program"),
        "look at the PLC and at its network; see docs/handshake.md",
        5,
        lambda inputs: inputs.state.plc.missed,
        on_delay_s=1.0,
        suppressed_by=frozenset({Suppression.NOT_COMPUTED, Suppression.SHUTDOWN}),
    ),
    AlarmDefinition(
        "camera_down",
        "Camera down",
        Priority.HIGH,
        "the camera cannot be opened or was lost",
        STOPS,
        ("cable or power of the camera", "wrong camera.url", "another program has the camera"),
        "look at the camera's power and cable; the detail holds the error that the gateway got",
        10,
        *_vision(Quality.LINK_DOWN),
    ),
    AlarmDefinition(
        "camera_stale",
        "Camera without new pictures",
        Priority.HIGH,
        "the newest picture is older than its deadline",
        STOPS,
        (
            "the stream stalls",
            "pictures that never change",
            "a machine that is overloaded",
            "deadlines that are tight",
            "nothing proves how old the pictures are, and camera.unproven_age refuses them: the detail says so",
        ),
        "look at the live picture and at the rates; restart the camera; `gateway doctor` measures the pictures' age",
        10,
        lambda inputs: inputs.state.vision.quality is Quality.STALE and not inputs.state.beacon_unproven,
        lambda inputs: inputs.state.vision.detail,
    ),
    AlarmDefinition(
        "beacon_lost",
        "Pictures not proven",
        Priority.HIGH,
        "the pictures do not show the code of the beacon's LED, or show it too late: they may not be of the present",
        STOPS,
        (
            "the LED is covered, dirty, outside camera.beacon's place or outshone",
            "the camera or the network repeats or stores pictures",
            "the stream is that of another camera",
        ),
        "does the LED blink, and does the live picture show it where camera.beacon says? Clean both, restart it",
        10,
        lambda inputs: inputs.state.beacon_unproven and inputs.state.range.quality not in DEAD,
        lambda inputs: inputs.state.vision.detail,
        on_delay_s=6.0,
    ),
    AlarmDefinition(
        "camera_age_unproven",
        "Age of the pictures not proven",
        Priority.LOW,
        'nothing proves how old the camera\'s pictures are, and camera.unproven_age is "accept"',
        "a picture that was held up on its way counts as a new one: stop may come too late",
        ("a stream without times", "a driver without time stamps"),
        "`gateway doctor` measures the pictures' age; see docs/vision-processes.md#what-every-frame-must-pass",
        8 * 60,
        lambda inputs: inputs.state.vision_age_unproven and inputs.state.vision.quality in FRESH_FRAME,
        on_delay_s=10.0,
        off_delay_s=60.0,
    ),
    AlarmDefinition(
        "vision_fault",
        "Vision process fault",
        Priority.HIGH,
        "the process that looks for the marker died, hung or failed, and starting it again does not help",
        STOPS,
        (
            "a picture that the software cannot cope with",
            "a machine that is overloaded or short of memory",
            "a camera's driver that hangs and holds up the process: the detail says `no sign of life`",
        ),
        "look at the machine's load and the gateway's log; report the log",
        10,
        *_vision(Quality.PROCESS_FAULT),
    ),
    AlarmDefinition(
        "ranger_down",
        "Ranger down",
        Priority.HIGH,
        "the ranger's port cannot be opened or was lost",
        STOPS,
        ("USB or serial cable", "power of the Arduino", "wrong ranger.port", "another program has the port"),
        "look at the Arduino's light and cable; the detail holds the error that the gateway got",
        10,
        *_range(Quality.LINK_DOWN),
    ),
    AlarmDefinition(
        "ranger_stale",
        "Ranger silent",
        Priority.HIGH,
        "the port is open, but no distance has arrived before its deadline",
        STOPS,
        ("the Arduino hangs or runs another sketch", "wrong ranger.baud", "a damaged cable"),
        "press the Arduino's reset; look at docs/ranger.md",
        10,
        *_range(Quality.STALE),
    ),
    AlarmDefinition(
        "ranger_stuck",
        "Ranger stuck",
        Priority.HIGH,
        "the ultrasonic sensor's ECHO pin does not move",
        STOPS,
        ("a wire to the sensor is off", "the sensor is broken or has no power"),
        "look at the sensor's four wires (docs/wiring.md); exchange the sensor",
        30,
        *_range(Quality.STUCK),
    ),
    AlarmDefinition(
        "ranger_version",
        "Ranger with other firmware",
        Priority.HIGH,
        "the ranger uses another protocol version than the gateway",
        STOPS,
        ("the gateway was updated and the Arduino was not, or the other way round",),
        "flash the firmware that belongs to this gateway (docs/firmware.md)",
        30,
        *_range(Quality.WRONG_VERSION),
    ),
    AlarmDefinition(
        "relay_fault",
        "Relay does not follow",
        Priority.HIGH,
        "the pins of the ranger's board, read back, have differed from the gateway's command for 0.5 s",
        "the wire in place or may move is not what the registers say; with both pins high the board switches both off",
        (
            "a short circuit or foreign voltage at D4 or D5",
            "firmware without the relay",
            "the board measures another distance than the gateway decides with",
        ),
        "do not load by the wire; look at register relay_status and at the wires (docs/wiring.md); flash the board",
        10,
        lambda inputs: inputs.state.relay_fault,
        on_delay_s=0.0,  # it lasts for 0.5 s before it is called one
    ),
    AlarmDefinition(
        "ranger_no_echo",
        "No echo, though the marker is near",
        Priority.MEDIUM,
        "the marker looks well within the ranger's range, and the ranger still hears nothing or something far",
        STOPS,
        ("the sensor points past the truck", "dust or ice on the sensor", "a surface that swallows sound"),
        "look at the sensor: clean it, point it at the truck's flat side",
        10,
        _no_echo,
        lambda inputs: details.LOOKS_AWAY(f"{expected_mm(inputs):.0f}"),
        on_delay_s=5.0,
        off_delay_s=10.0,
    ),
    AlarmDefinition(
        "ranger_unstable",
        "Distances jump",
        Priority.MEDIUM,
        "for a while now readings jump more than the glitch gate allows",
        STOPS,
        ("another ultrasonic sensor nearby", "dust or steam in between", "compressed air", "a loose sensor"),
        "look at what is between sensor and truck, and for other sensors; see docs/ranger.md",
        15,
        *_range(Quality.UNSTABLE),
        on_delay_s=10.0,
        off_delay_s=10.0,
    ),
    AlarmDefinition(
        "ranger_too_near",
        "Something on the ranger",
        Priority.MEDIUM,
        "for a while now something has been nearer than the ranger can measure",
        STOPS,
        ("dirt, ice or a cover on the sensor", "something leans against it"),
        "look at the sensor and clear it",
        15,
        *_range(Quality.TOO_NEAR),
        on_delay_s=10.0,
        off_delay_s=10.0,
    ),
    AlarmDefinition(
        "temperature_lost",
        "Air temperature not measured",
        Priority.LOW,
        "the ranger's board has sent a temperature before, or is configured to, and now sends none that is believed",
        "distances are calculated with ranger.hcsr04.temperature_c instead: they are wrong by 0.18 % for each kelvin "
        "that the air differs, 0.5 mm at 30 cm",
        (
            "the temperature sensor's cable or its resistor",
            "the sensor has no supply",
            "the air differs from temperature_c by more than temperature_tolerance_c",
        ),
        "look at the sensor and its three wires (docs/wiring.md); where it was taken away on purpose, set "
        "temperature_sensor to false and restart the gateway",
        8 * 60,
        lambda inputs: inputs.state.range.temperature_lost,
        off_delay_s=60.0,
    ),
    AlarmDefinition(
        "sensors_disagree",
        "Camera and ranger disagree",
        Priority.HIGH,
        "R and Z do not fit each other: one of the two is wrong",
        STOPS,
        (
            "the ranger measures something else than the truck",
            "a marker of another size, or something that looks like one",
            "the camera was moved, or its focal length is wrong",
            "marker, camera or lens was exchanged, and the learned R x Z (docs/visit.md) is still that of the old one",
        ),
        "measure the distance by hand, see which one is wrong, and mend that one; after an exchange stop the gateway, "
        "delete the bay's file in state_dir and start it: what was learned is forgotten",
        10,
        lambda inputs: inputs.state.memory.disagree,
        _disagree_detail,
        on_delay_s=0.0,  # it lasts for scale_lasting_s or cross_check.lasting_s before it is called one
    ),
    AlarmDefinition(
        "picture_blind",
        "Camera sees nothing",
        Priority.MEDIUM,
        "pictures arrive, but they are dark, over-exposed or without any contrast",
        "no marker can be found: stop is on, and no truck can be in place",
        ("the light is off or failed", "something covers the lens", "the sun or a lamp shines into the lens", "fog"),
        "look at the live picture; switch the light on, clean the lens, take away what covers it; set the exposure",
        30,
        *_picture(PictureFault.DARK, PictureFault.BRIGHT, PictureFault.FLAT),
        off_delay_s=10.0,
    ),
    AlarmDefinition(
        "picture_poor",
        "Picture getting worse",
        Priority.LOW,
        "the picture is blurred, or has been veiled by dust for long",
        "markers are found late or not at all, and their radius is less sure",
        ("dust, dirt, water or a cobweb on the lens", "the focus has moved", "a dust filter that fails"),
        "clean the lens and its window; focus; look at the dust extraction",
        8 * 60,
        *_picture(PictureFault.BLURRED, PictureFault.DUSTY),
        on_delay_s=10.0,
        off_delay_s=60.0,
    ),
    AlarmDefinition(
        "marker_worn",
        "Marker worn or dirty",
        Priority.LOW,
        "in the last visits less of the marker's rim was seen, or with less contrast, than camera.picture allows, or "
        "soon will be",
        "in the end the marker is not found: stop is on",
        (
            "cement crust or dirt on the markers",
            "paint that fades",
            "something before the rim: a hose, a bracket, snow",
        ),
        "clean or repaint the trucks' markers; it returns to normal by itself after some clean visits",
        8 * 60,
        lambda inputs: inputs.state.marker is not None and inputs.state.marker.worn,
        _wear_detail,
        on_delay_s=10.0,
        off_delay_s=60.0,
    ),
    AlarmDefinition(
        "exposure_uncontrolled",
        "Exposure not controlled",
        Priority.LOW,
        'camera.exposure is "marker", but the camera cannot be set, refuses, or its pictures do not follow',
        "a marker in the sun, under a lamp or in the dark is not found: stop is on",
        ("a camera without an exposure time that can be set", "another program sets it, too", "a driver's fault"),
        "look at the log for the reason; see docs/technician.md#exposure, or set the camera by hand and "
        'camera.exposure to "camera"',
        8 * 60,
        lambda inputs: inputs.state.exposure is not None and inputs.state.exposure.state in UNCONTROLLED,
        lambda inputs: "" if inputs.state.exposure is None else inputs.state.exposure.state.meaning,
        on_delay_s=10.0,
        off_delay_s=60.0,
    ),
    AlarmDefinition(
        "camera_moved",
        "Camera moved",
        Priority.MEDIUM,
        "the fixed background is not where it was when the gateway learned it",
        "aim point, offset and the distance seen by the camera are wrong by as much",
        ("something hit the camera or its mount", "a loose screw", "it was turned or zoomed"),
        "put the camera back or align it anew (docs/technician.md#aim-the-camera), then restart the gateway: it learns "
        "the background again",
        60,
        *_picture(PictureFault.SHIFTED),
        off_delay_s=60.0,
    ),
    AlarmDefinition(
        "maintenance",
        "Maintenance required",
        Priority.LOW,
        "NE 107 M: works, but something had to be restarted within 10 minutes, or 1 line in 100 arrives damaged",
        "it may fail soon",
        ("a loose cable", "electric noise on the serial line", "a camera or disk that begins to fail"),
        "look at the counters, and mend what restarts, reopens or is damaged",
        8 * 60,
        lambda inputs: degraded(inputs.state),
        on_delay_s=10.0,
        off_delay_s=60.0,
    ),
    AlarmDefinition(
        "function_check_forgotten",
        "Function check still on",
        Priority.LOW,
        "a function check was begun half an hour ago and has not been ended",
        "may_move is off, or alarms mean less than they seem to",
        ("the technician forgot to end it",),
        "ask the technician; end the function check on the technician's page",
        60,
        lambda inputs: inputs.state.function_check is not FunctionCheck.OFF,
        lambda inputs: inputs.state.function_check.name.lower(),
        on_delay_s=30 * MINUTE_S,
        off_delay_s=0.0,
        suppressed_by=frozenset({Suppression.SHUTDOWN}),
    ),
    AlarmDefinition(
        "truck_rolling",
        "Truck rolls while in place",
        Priority.HIGH,
        "a truck that is in place begins to move: nearer, or with the marker covered, as under the spout, or, where "
        "the PLC writes, without its release; it has not left its place yet",
        "in_place is still on until visit.band_mm is left; a spout that is down may be torn off, or may spill",
        (
            "brakes that do not hold, on a slope or while a person climbs about",
            "the driver drives off",
            "the PLC's program does not set release before the truck leaves (docs/visit.md)",
        ),
        "stop loading and raise the spout; the driver's display shows BRAKE; ask the driver to hold the truck",
        1,
        _truck_rolling,
        _truck_rolling_detail,
        on_delay_s=0.0,
        off_delay_s=5.0,
    ),
    AlarmDefinition(
        "truck_moved",
        "Truck moved",
        Priority.HIGH,
        "a truck that was in place has left it: with the marker covered, as under the spout, or, where the PLC writes, "
        "without its release",
        "in_place is off; a spout that is down may be torn off, or may spill",
        (
            "brakes that do not hold, or a truck that settles on its springs by more than visit.band_mm",
            "the driver drove off",
            "the PLC's program does not set release before the truck leaves (docs/visit.md)",
        ),
        "stop loading and raise the spout; check that no person is hurt; bring the truck into place or let it leave",
        1,
        _truck_moved,
        _truck_moved_detail,
        on_delay_s=0.0,  # the truck has moved further than visit.band_mm before it is called so
    ),
    AlarmDefinition(
        "in_place_lost",
        "In place lost, though the truck has not moved",
        Priority.MEDIUM,
        "a truck that was in place is no longer confirmed, though both sensors are alive, and it has neither "
        "moved nor been released",
        "in_place is off: loading must not go on; stop is on",
        (
            "the marker has been covered for longer than visit.hold_limit_s",
            "dust or the spout before the ranger: no distance, or one that contradicts the camera",
            "a sensor was away for a moment, or the gateway restarted, while the marker was covered",
        ),
        "raise the spout until the camera sees the marker: in_place returns by itself; else look at both sensors",
        5,
        _in_place_lost,
        lambda inputs: inputs.state.visit.ended,
        on_delay_s=5.0,
    ),
    AlarmDefinition(
        "scale_changed",
        "Marker of another size, or camera changed",
        Priority.MEDIUM,
        "R x Z of the newest truck in place differs by more than a tenth from what was learned from those before",
        "D = 1 is reached at another place than before; what was learned does not fit, so good pairs of R and Z may be "
        "taken for a contradiction",
        (
            "a truck whose marker has another size",
            "the camera or the ranger was moved or exchanged",
            "zoom or focus of the lens was changed",
        ),
        "measure where the truck is; put marker, camera or lens right. Where the change is meant to stay: set the "
        "thresholds anew (docs/wiring.md), then stop the gateway, delete the bay's file in state_dir and start it, "
        "with no function check on: what was learned is forgotten",
        60,
        lambda inputs: _jump(inputs) is not None,
        _scale_detail,
        on_delay_s=0.0,
        off_delay_s=5.0,
    ),
)
