"""The generated parts of docs/alarms.md: the alarms, their states and the benchmarks of an operator's load. Pure."""

from collections.abc import Callable, Mapping
from itertools import groupby

from gateway.alarms.bay_alarms import BAY_ALARMS, STOPS
from gateway.alarms.definition import Suppression
from gateway.alarms.states import TRANSITIONS, AlarmEvent, AlarmState
from gateway.alarms.table import ALARM_DEFINITIONS
from gateway.modbus.exports.tables import markdown_table
from gateway.records.alarm_rates import BENCHMARKS, Benchmark

STATE_MEANING: dict[AlarmState, tuple[str, str]] = {
    AlarmState.NORMAL: ("A", "its cause is not active, and no operator action is needed"),
    AlarmState.UNACKNOWLEDGED: ("B", "its cause is active, and no operator has acknowledged it yet"),
    AlarmState.ACKNOWLEDGED: ("C", "its cause is active, and an operator has acknowledged it"),
    AlarmState.RETURNED: ("D", "its cause is no longer active, and no operator has acknowledged it yet"),
    AlarmState.LATCHED_UNACKNOWLEDGED: ("E", "its cause came and went; it must be acknowledged, then reset"),
    AlarmState.LATCHED_ACKNOWLEDGED: ("F", "its cause is no longer active; it stays until an operator resets it"),
    AlarmState.SHELVED: ("G", "put aside by a person for a limited time"),
    AlarmState.SUPPRESSED: ("H", "meaningless for the moment, by design: its row defines when"),
    AlarmState.OUT_OF_SERVICE: ("I", "taken out of service by a person, until they put it back"),
}
EVENT_MEANING: dict[AlarmEvent, str] = {
    AlarmEvent.OCCURS: "its cause holds for its on-delay",
    AlarmEvent.RETURNS: "its cause has not been active for its off-delay",
    AlarmEvent.ACKNOWLEDGE: "a person takes notice; changes nothing but the alarm",
    AlarmEvent.RESET: "an operator ends a latched alarm whose cause is no longer active",
    AlarmEvent.SHELVE: "a person puts it aside for a while",
    AlarmEvent.UNSHELVE: "that while is over, or a person takes it back",
    AlarmEvent.SUPPRESS: "it means nothing for the moment, by design",
    AlarmEvent.UNSUPPRESS: "it means something again; a cause that holds is announced after the on-delay",
    AlarmEvent.REMOVE: "a person takes it out of service",
    AlarmEvent.RESTORE: "a person puts it back into service",
}
SUPPRESSION_MEANING: dict[Suppression, str] = {
    Suppression.FUNCTION_CHECK: "a technician works on the bay and may_move is off",
    Suppression.NOT_COMPUTED: "the control task is dead, so nothing is known of the sensors; control_dead reports it",
    Suppression.SHUTDOWN: "the gateway is shutting down",
}


def summary() -> str:
    """One line an alarm, the most urgent first."""
    bays = {kind.id for kind in BAY_ALARMS}
    return markdown_table(
        ("id", "alarm", "priority", "respond within", "of", "on-delay, s", "off-delay, s", "latching"),
        (
            (
                f"[`{kind.id}`](#{kind.id})",
                kind.title,
                kind.priority.name.lower(),
                _time(kind.respond_min),
                "bay" if kind.id in bays else "gateway",
                f"{kind.on_delay_s:g}",
                f"{kind.off_delay_s:g}",
                "yes" if kind.latching else "",
            )
            for kind in sorted(ALARM_DEFINITIONS.values(), key=lambda kind: -kind.priority)
        ),
    )


def responses() -> str:
    """What each alarm means and what to do: the alarm response procedures."""
    parts = [f"Bay stopped: {STOPS}.\n"]
    for kind in ALARM_DEFINITIONS.values():
        reasons = [f"`{reason.value}`" for reason in Suppression if reason in kind.suppressed_by]
        others = kind in BAY_ALARMS and len(reasons) < len(Suppression)
        consequence = kind.consequence.replace(STOPS, "bay stopped")
        suppressed = f"- Suppressed by design: {', '.join(reasons) or 'never'}.\n" if others else ""
        parts.append(
            f"### {kind.id}\n\n**{kind.title}**: {kind.meaning}.\n\n- Consequence: {consequence}.\n"
            f"- Response: {kind.action}.\n"
            f"- Causes: {'; '.join(kind.causes)}.\n{suppressed}"
        )
    return "\n".join(parts)


def suppressions() -> str:
    return markdown_table(("name", "when"), ((f"`{one.value}`", text) for one, text in SUPPRESSION_MEANING.items()))


def states() -> str:
    """The states, and every arrow."""
    letters = [f"| {letter} | `{state.value}` | {meaning} |" for state, (letter, meaning) in STATE_MEANING.items()]
    arrows: dict[tuple[AlarmEvent, AlarmState, str], list[str]] = {}
    for arrow in TRANSITIONS:
        only = [] if arrow.latching is None else ["latching" if arrow.latching else "not latching"]
        only += [] if arrow.active is None else ["cause holds" if arrow.active else "cause gone"]
        key = (arrow.event, arrow.target, ", ".join(only))
        arrows.setdefault(key, []).append(STATE_MEANING[arrow.source][0])
    rows: list[str] = []
    for event, alike in groupby(sorted(arrows, key=lambda key: list(AlarmEvent).index(key[0])), key=lambda key: key[0]):
        name, meaning = f"`{event.value}`", EVENT_MEANING[event]
        for key in alike:
            rows.append(f"| {name} | {', '.join(arrows[key])} | {STATE_MEANING[key[1]][0]} | {key[2]} | {meaning} |")
            name = meaning = ""  # said in its first row
    head = ["| | state | meaning |", "|---|---|---|", *letters, ""]
    return "\n".join([*head, "| what happens | from | to | only where | |", "|---|---|---|---|---|", *rows])


def benchmarks() -> str:
    def amount(one: Benchmark, value: float) -> str:
        return f"{100 * value:g} %" if one.figure.endswith("_share") else f"{value:g}"

    return markdown_table(
        ("of one operator position", "very likely acceptable", "at most manageable"),
        (
            (
                one.title,
                f"{'below ' if one.below else ''}{amount(one, one.acceptable)}",
                "" if one.acceptable == one.most else amount(one, one.most),
            )
            for one in BENCHMARKS
        ),
    )


def _time(minutes: int) -> str:
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h"


BLOCKS: Mapping[str, Callable[[], str]] = {
    "alarms": summary,
    "states": states,
    "designs": suppressions,
    "responses": responses,
    "benchmarks": benchmarks,
}
