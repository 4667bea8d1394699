"""An answer as rows of words and numbers, the same for a terminal, a page and programs. Pure."""

from collections.abc import Iterator
from typing import Any

import msgspec

from gateway.core import events
from gateway.core.plc import Control, PlcConnection, PlcWrite, WriteVerdict
from gateway.core.readings import FRESH_FRAME, Quality
from gateway.core.state import FunctionCheck, Moved, StateVector
from gateway.durations import NS_PER_S
from gateway.records import sentences as say
from gateway.records.factors import Factor
from gateway.records.inquiry import WINDOW_S, Answer
from gateway.records.moment import shown, unix_ns
from gateway.records.record import EventRecord, NotedKind
from gateway.records.recording import config_of
from gateway.records.segment import RecordedPicture

Row = tuple[str, str]
PEOPLE = frozenset(
    {
        "function_check_begun",
        "function_check_ended",
        "settings_changed",
        "write_refused",
        "operator_mark",
        NotedKind.ALARM_ACTION,
    }
)
ALWAYS = ("fusion.radius_threshold_px", "fusion.distance_threshold_mm")
KEYS: dict[Factor, tuple[str, ...]] = {
    Factor.CAMERA: ("fusion.vision_deadline_s", "fusion.recovery_s"),
    Factor.RANGER: ("fusion.range_deadline_s", "fusion.recovery_s"),
    Factor.CONTRADICTION: ("fusion.scale_tolerance", "fusion.scale_lasting_s", "fusion.cross_check"),
    Factor.TARGET: ("fusion.decision", "fusion.away_px", "fusion.away_mm"),
    Factor.MOVED: ("visit.band_mm", "visit.band_share"),
    Factor.IN_PLACE: ("visit.settle_s", "visit.hold_limit_s", "visit.hold_grace_s"),
    Factor.HOLD: ("fusion.clear_hold_s",),
    Factor.CLEAR: ("fusion.clear_hold_s",),
    Factor.LATCH: ("fusion.latch_stop", "fusion.latch_leave_s"),
    Factor.PLC_LOST: ("handshake.heartbeat_required", "handshake.heartbeat_deadline_s"),
    Factor.ENABLE: ("handshake.enable_required",),
    Factor.TRUCK_PRESENT: ("handshake.truck_required",),
    Factor.RELEASED: ("visit.band_mm", "visit.hold_grace_s"),
    Factor.GATEWAY: ("fusion.period_s",),
}


def outputs(state: StateVector) -> list[Row]:
    """What the PLC was told."""
    moved = "no" if state.visit.moved is Moved.NO else state.visit.moved.name.lower()
    return [
        ("stop", _on(state.stop)),
        ("may_move", _on(state.may_move)),
        ("in_place", _on(state.in_place)),
        ("moved", moved),
        ("reason", f"{state.reason.value} {state.reason.name.lower()}: {state.reason.meaning}"),
    ]


def sensors(answer: Answer, state: StateVector) -> list[Row]:
    """The state vector with its ages, as of its own time."""
    vision, rng, plc, visit = state.vision, state.range, state.plc, state.visit
    frame = f"{vision.quality.name.lower()}, frame {vision.frame_id}, {_measured_before(answer, state, 'vision')}"
    if vision.circle is not None:
        c = vision.circle
        frame += f", R {c.radius_px:.1f} px at u {c.u_px:.1f}, v {c.v_px:.1f}"
    if vision.tracking.value:
        frame += f", tracking {vision.tracking.name.lower()}"
    echo = f"{rng.quality.name.lower()}, {_measured_before(answer, state, 'range')}"
    if rng.distance_mm is not None:
        echo += f", Z {rng.distance_mm:.0f} mm"
    rows = [
        ("camera", _with(frame, vision.detail)),
        ("ranger", _with(echo, rng.detail)),
        (
            "decision",
            f"D {'unknown' if state.d is None else int(state.d)}, step {state.seq}, heartbeat {state.heartbeat}",
        ),
        ("visit", f"{visit.phase.name.lower()}{_since(state, ', in place for', visit.in_place_since_ns)}"),
        ("PLC", _plc(state)),
        ("driver", f"{state.guidance.code.name.lower()}{_speed(state)}"),
    ]
    if state.setpoint.state:
        rows.append(("drive", _drive(state)))
    if (at := state.pose) is not None:
        near = (("x", at.x_mm, at.x_sd_mm), ("y", at.y_mm, at.y_sd_mm), ("z", at.z_mm, at.z_sd_mm))
        rows.append(("pose", ", ".join(f"{axis} {mm:+z.1f} \N{PLUS-MINUS SIGN} {sd:.1f} mm" for axis, mm, sd in near)))
    if plc.recipe:
        rows.append(("recipe", str(plc.recipe)))
    if state.function_check is not FunctionCheck.OFF:
        rows.append(("function check", state.function_check.name.lower()))
    if state.picture is not None and state.picture.faults:
        rows.append(("picture", ", ".join(fault.name.lower() for fault in state.picture.faults)))
    return rows


def done_by(answer: Answer) -> list[tuple[int, str]]:
    """What people and the PLC did in the window: Unix ns and words."""
    found = [(t, _event(e)) for t, e in answer.events if e.kind in PEOPLE]
    for before, step in zip(answer.steps, answer.steps[1:], strict=False):
        at_ns = unix_ns(step.place.head, step.state.t_ns)
        match step.observation:
            case PlcWrite() as write:
                changes = ", ".join(map(str, events.changes(before.state.plc, step.state.plc)))
                if step.state.plc.write_verdict is not WriteVerdict.TAKEN:
                    changes = say.WROTE_REFUSED()
                if changes:
                    found.append((at_ns, _bits(say.WROTE(write.writer, changes), step.state)))
            case PlcConnection() as change:
                found.append((at_ns, (say.CONNECTED if change.open else say.DISCONNECTED)(change.writer)))
    return sorted(found)


def happened(answer: Answer) -> list[tuple[int, str]]:
    """The events of the window: Unix ns and words."""
    return [(t, _event(e)) for t, e in answer.events]


def settings(answer: Answer) -> list[Row]:
    """The configuration in force, as far as it mattered here."""
    gateway = config_of(answer.head)
    bay = next(b for b in gateway.bays if b.name == answer.head.bay)
    recipe = 0 if answer.state is None else answer.state.plc.recipe
    fusion = answer.rules.recipes.get(recipe, answer.rules.recipes[0]).fusion
    sections: dict[str, Any] = {"fusion": fusion, "visit": bay.visit, "handshake": gateway.modbus.handshake}
    wanted = dict.fromkeys([*ALWAYS, *(key for cause in answer.causes for key in KEYS.get(cause.factor, ()))])
    if not fusion.fail_safe:
        wanted["fusion.fail_safe"] = None
    rows = []
    for key in wanted:
        section, name = key.split(".")
        value = getattr(sections[section], name)
        rows.append((f"modbus.{key}" if section == "handshake" else key, "not set" if value is None else str(value)))
    return rows


def as_json(answer: Answer, pictures: list[RecordedPicture]) -> dict[str, Any]:
    """All of it, for programs. Times are local ISO times with their zone. `said`: by each text of a cause, of a change
    or of what was done its sentences as codes with values; a text that has none is missing there."""
    state = answer.state
    return {
        "time": shown(answer.at_ns),
        "bay": answer.head.bay,
        "site": answer.head.site,
        "instance": answer.head.instance,
        "gateway_version": answer.head.gateway_version,
        "headline": headline(answer),
        "warnings": list(warnings(answer)),
        "silence": answer.silence,
        "outputs": None if state is None else dict(outputs(state)) | {"reason": state.reason.name.lower()},
        "reason_meaning": None if state is None else state.reason.meaning,
        "since": None if answer.since_ns is None else shown(answer.since_ns),
        "causes": [{"factor": cause.factor.value, "text": cause.text} for cause in answer.causes],
        "chain": [_link(link) for link in answer.chain],
        "after": [_link(link) for link in answer.after],
        "state": None if state is None else msgspec.to_builtins(state),
        "ages_s": None if state is None else _ages(answer, state),
        "done": [{"time": shown(t), "what": text} for t, text in done_by(answer)],
        "events": [
            {
                "time": shown(t),
                "kind": e.kind,
                "sensor": e.sensor,
                "quality": e.quality.name.lower(),
                "detail": e.detail,
            }
            for t, e in answer.events
        ],
        "settings": dict(settings(answer)),
        "pictures": [{"time": shown(p.head.unix_ns), "frame_id": p.head.frame_id, "why": p.head.why} for p in pictures],
        "missing": list(answer.missing),
        "said": said(answer),
        "decided_otherwise_by_this_version": answer.differing,
    }


def said(answer: Answer) -> dict[str, list[dict[str, object]]]:
    """By each text the sentences in it."""
    links = [text for link in (*answer.chain, *answer.after) for text in (link.by, link.why)]
    texts = [
        *warnings(answer),
        *(cause.text for cause in answer.causes),
        *links,
        *(what for _, what in done_by(answer)),
    ]
    found = {text: say.said(text) for text in texts}
    found |= {_event(e): say.happened(e.kind, e.detail, _about(e)) for _, e in answer.events}
    found[headline(answer)] = say.said(headline(answer) if answer.state is not None else answer.silence)
    return {text: said for text, said in found.items() if said}


def headline(answer: Answer) -> str:
    """The answer in one sentence."""
    if answer.state is None:
        return f"{answer.silence[:1].upper()}{answer.silence[1:]}."
    first = answer.causes[0].text if answer.causes else ""
    if answer.state.may_move:
        return say.MAY_MOVE(first)
    return (say.STOP_ON if answer.state.stop else say.BOTH_OFF)(first)


def warnings(answer: Answer) -> Iterator[str]:
    """What makes the answer less than certain."""
    if answer.silence and answer.state is not None:  # else it is the headline
        yield answer.silence
    for why in answer.missing:
        yield say.MISSING(why)
    if answer.differing:
        yield say.OTHERWISE(answer.differing, answer.head.gateway_version)
    if answer.state is not None and answer.since_ns is None:
        yield say.SO_FOR_LONGER()


def _link(link: Any) -> dict[str, str]:
    return {"time": shown(link.unix_ns), "what": link.what, "by": link.by, "why": link.why, "factor": link.factor or ""}


def _measured_ns(answer: Answer, state: StateVector, sensor: str) -> int | None:
    """When the sensor's newest measurement was taken: a fault has the time of its report. None: before the window."""
    states = [step.state for step in answer.steps if step.place.head.boot == answer.head.boot]
    for known in (state, *(s for s in reversed(states) if s.seq < state.seq)):
        reading = getattr(known, sensor)
        if reading.quality in (FRESH_FRAME if sensor == "vision" else (Quality.GOOD,)):
            return int(reading.t_ns)
    return None


def _measured_before(answer: Answer, state: StateVector, sensor: str) -> str:
    t_ns = _measured_ns(answer, state, sensor)
    if t_ns is None:
        return f"none within {WINDOW_S:g} s"
    good = getattr(state, sensor).t_ns == t_ns
    return f"{_age(state, t_ns)} old" if good else f"the newest one {_age(state, t_ns)} old"


def _ages(answer: Answer, state: StateVector) -> dict[str, float | None]:
    measured = {name: _measured_ns(answer, state, of) for name, of in (("frame", "vision"), ("distance", "range"))}
    times = {**measured, "plc_heartbeat": state.plc.beat_ns}
    return {name: round((state.t_ns - t_ns) / NS_PER_S, 4) if t_ns else None for name, t_ns in times.items()}


def _about(event: EventRecord) -> str:
    bad = event.sensor and event.quality is not Quality.GOOD
    return f"{event.sensor}, {event.quality.name.lower()}" if bad else event.sensor or ""


def _event(event: EventRecord) -> str:
    of = f" ({_about(event).replace(',', '')})" if event.sensor else ""
    return f"{event.kind.replace('_', ' ')}{of}{f': {event.detail}' if event.detail else ''}"


def _plc(state: StateVector) -> str:
    plc = state.plc
    text = plc.link.name.lower()
    if plc.owner is not None:
        text = _bits(f"{text}, {plc.owner}, plc_heartbeat {plc.heartbeat}, {_age(state, plc.beat_ns)} old", state)
    return text


def _bits(text: str, state: StateVector) -> str:
    bits = [bit.name.lower() for bit in Control if state.plc.on(bit)]
    return say.BITS(text, " ".join(bits)) if bits else text


def _drive(state: StateVector) -> str:
    told = state.setpoint
    way = "not known" if told.stopping_mm is None else f"{told.stopping_mm:.0f} mm"
    enable = "enabled" if told.enable else "not enabled"
    return f"{told.state.name.lower()}, {enable}, setpoint {told.speed_mm_s:.0f} mm/s, stopping distance {way}"


def _speed(state: StateVector) -> str:
    speed = state.guidance.closing_mm_s
    return "" if speed is None else f", closing at {speed:.0f} mm/s"


def _since(state: StateVector, words: str, since_ns: int | None) -> str:
    return "" if since_ns is None else f"{words} {(state.t_ns - since_ns) / NS_PER_S:.1f} s"


def _age(state: StateVector, t_ns: int) -> str:
    return f"{(state.t_ns - t_ns) / NS_PER_S:.2f} s"


def _with(text: str, detail: str) -> str:
    return f"{text} ({detail})" if detail else text


def _on(value: bool) -> str:
    return "on" if value else "off"
