"""Short generated tables of several pages, each made of one table of the package. Pure."""

from itertools import groupby

from gateway.config.live import LIVE, LiveKeys
from gateway.config.reference import key_table
from gateway.config.sections.ranger_profiles import PROFILES
from gateway.config.strict.section import inner_model
from gateway.modbus.exports.tables import markdown_table
from gateway.sim.scenario import FaultKind, Scenario
from gateway.sinks.sparkplug import metrics as device
from gateway.sinks.sparkplug.wire import QualityCode
from gateway.vision.offline.evaluation.labels import Label
from gateway.vision.offline.evaluation.requirements import METRICS
from gateway.vision.offline.evaluation.scoring import Closeness
from gateway.web.auth.access import Level, Rule
from gateway.web.server.app import RULES
from gateway.web.server.metrics.family import PREFIX
from gateway.web.server.metrics.text import FAMILIES, INFO, LATENCY, STAGE


def live_keys() -> str:
    """What of a configuration takes effect while the gateway runs: docs/config.md."""
    rows = ((_title(row), ", ".join(f"`{key}`" for key in row.but) or "–", row.effect) for row in LIVE)
    return markdown_table(("live", "but not", "what happens"), rows)


def ranger_profiles() -> str:
    """Ready profiles of distance sensors: docs/sensors.md."""
    return markdown_table(
        ("`ranger.profile`", "device", "you set", "tried", "source, and what to know"),
        (
            (
                f"`{name}`",
                one.device,
                ", ".join(f"`{key}`" for key in one.required),
                one.tried,
                f"{one.source}. {one.note}",
            )
            for name, one in PROFILES.items()
        ),
    )


def access() -> str:
    """Who may call what, a row for each role and method: docs/hmi-security.md."""
    rows: list[tuple[str, str, str]] = []
    for (least, method), rules in groupby(sorted(RULES, key=_access_order), key=_access_order):
        role = least.role if least else "everybody"
        rows.append((role, method, ", ".join(f"`{rule.path}`" for rule in rules)))
    return markdown_table(("role", "method", "addresses"), rows)


def _access_order(rule: Rule) -> tuple[Level, str]:
    return rule.least, rule.method


def metrics() -> str:
    """Every family of /metrics: docs/hmi-api.md. When a value has no sample, its help says."""
    rows = [f"| `{PREFIX}{INFO[0]}` | info: {INFO[1]} |"]
    for family in FAMILIES:
        name = family.name + ("_total" if family.form == "counter" else "")
        labels = ",".join(label for label in family.labels if label != "bay")
        name += f"{{{labels}}}" if labels else ""
        form = "" if family.form in ("gauge", "counter") else f"{family.form}: "
        rows.append(f"| `{PREFIX}{name}` | {form}{family.help.split('; no sample: ')[0]} |")
    rows.append(f"| `{PREFIX}{LATENCY[0]}` | histogram: {LATENCY[1]} |")
    rows.append(f"| `{PREFIX}{STAGE[0]}{{stage}}` | histogram: {STAGE[1]} |")
    return "\n".join(["| name | meaning |", "|---|---|", *rows])


def sparkplug() -> str:
    """The metrics of a device, as its birth has them: docs/sparkplug.md. When one is null, the state's schema says."""
    birth = device.metrics(dict.fromkeys(device.ROWS.keys() - device.NODE, (None, QualityCode.GOOD)), 0, birth=True)
    rows: list[tuple[str, str, str]] = []
    for one in birth:
        kind = one.datatype.name.capitalize() + (one.unit and f", {one.unit}")
        rows.append((f"`{one.name}`", kind, device.ROWS[one.name].meaning))
    alarms = "state (ISA-18.2) of each alarm of the bay; names: [alarms](alarms.md)"
    rows.append((f"`{device.ALARM}<kind>`", "String", alarms))
    rows.append((f"`{device.GATEWAY_ALARM}<kind>`", "String", "of each alarm of the gateway itself"))
    return markdown_table(("metric", "datatype, unit", "meaning"), rows)


def requirements() -> str:
    """What `gateway evaluate --require` takes: docs/technician.md."""
    return markdown_table(
        ("name", "limit is", "unit", "meaning"),
        ((f"`{one.name}`", "at least" if one.at_least else "at most", one.unit, one.meaning) for one in METRICS),
    )


def verdicts() -> str:
    """What `gateway evaluate` says of a picture: docs/technician.md."""
    return markdown_table(("verdict", "meaning"), Closeness.meanings().items())


def labels() -> str:
    """The keys of a label: docs/technician.md."""
    return "\n".join(key_table(Label))


def scenario() -> str:
    """A scenario's keys, a table a section, and the kinds of fault: docs/simulator.md."""
    sections: list[str] = ["### `top level`", "", *key_table(Scenario), ""]
    for name, info in Scenario.model_fields.items():
        if model := inner_model(info.annotation):
            title = f"[[{name}]]" if "tuple" in str(info.annotation) else f"[{name}]"
            sections += [f"### `{title}`", "", *key_table(model), ""]
    faults = ((f"`{kind}`", kind.meaning) for kind in FaultKind)
    return "\n".join([*sections, "### Kinds of fault\n", markdown_table(("kind", "what happens"), faults)])


def _title(row: LiveKeys) -> str:
    name = ".".join(part for part in row.path if part not in ("bays", "*"))
    return f"`[{name}]`" if row.but or "." in name else f"`{name}`"
