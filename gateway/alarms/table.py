"""All alarms, and docs/alarms.md. Pure."""

from gateway.alarms.bay_alarms import BAY_ALARMS
from gateway.alarms.definition import (
    MINUTE_S,
    SUPPRESSION_MEANING,
    AlarmDefinition,
    BayInputs,
    GatewayInputs,
    Suppression,
)
from gateway.alarms.gateway_alarms import GATEWAY_ALARMS

ALARM_DEFINITIONS: dict[str, AlarmDefinition[BayInputs] | AlarmDefinition[GatewayInputs]] = {
    kind.id: kind for kind in BAY_ALARMS
} | {kind.id: kind for kind in GATEWAY_ALARMS}


def alarm_id(kind: str, bay: str | None = None) -> str:
    """`bay1.camera_down`, or `broker_lost` of the gateway itself. A bay's name holds no dot."""
    return kind if bay is None else f"{bay}.{kind}"


def _time(minutes: int) -> str:
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h"


def _seconds(seconds: float) -> str:
    return f"{seconds:g} s" if seconds < 2 * MINUTE_S else f"{seconds / MINUTE_S:g} min"


def summary_markdown() -> str:
    """One line an alarm, the most urgent first."""
    rows = sorted(ALARM_DEFINITIONS.values(), key=lambda kind: -kind.priority)
    bays = {kind.id for kind in BAY_ALARMS}
    lines = [
        f"| [`{kind.id}`](#{kind.id}) | {kind.title} | {kind.priority.name.lower()} | {_time(kind.respond_min)} | "
        f"{'each bay' if kind.id in bays else 'gateway'} | {_seconds(kind.on_delay_s)} | "
        f"{_seconds(kind.off_delay_s)} | {'yes' if kind.latching else ''} |"
        for kind in rows
    ]
    head = "| id | alarm | priority | respond within | of | on-delay | off-delay | latching |"
    return "\n".join([head, "|---|---|---|---|---|---|---|---|", *lines]) + "\n"


def responses_markdown() -> str:
    """What each alarm means and what to do: the alarm response procedures."""
    parts: list[str] = []
    for kind in ALARM_DEFINITIONS.values():
        reasons = [f"`{reason.value}`" for reason in Suppression if reason in kind.suppressed_by]
        others = kind in BAY_ALARMS and len(reasons) < len(Suppression)
        suppressed = f"- Suppressed by design: {', '.join(reasons) or 'never'}.\n" if others else ""
        parts.append(
            f"### {kind.id}\n\n**{kind.title}**: {kind.meaning}.\n\n- Consequence: {kind.consequence}.\n"
            f"- What to do, within {_time(kind.respond_min)}: {kind.action}.\n"
            f"- Likely causes: {'; '.join(kind.causes)}.\n{suppressed}"
        )
    return "\n".join(parts)


def suppressions_markdown() -> str:
    rows = [f"| `{suppression.value}` | {meaning} |" for suppression, meaning in SUPPRESSION_MEANING.items()]
    return "\n".join(["| name | when |", "|---|---|", *rows]) + "\n"
