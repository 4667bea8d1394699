"""The scenario's own words about itself: the tables of keys and faults for docs/simulator.md. Pure."""

from collections.abc import Iterator

from pydantic import BaseModel

from gateway.config.reference import key_table
from gateway.config.strict.section import inner_model
from gateway.sim.scenario import FAULT_MEANING, Scenario


def markdown() -> str:
    """One table of keys per section, then the kinds of fault."""
    parts = ["\n".join([f"### `{title}`", "", *key_table(model), ""]) for title, model in _sections()]
    parts += ["### Kinds of fault\n", "| kind | what happens |", "|---|---|"]
    parts += [f"| `{kind}` | {meaning} |" for kind, meaning in FAULT_MEANING.items()]
    return "\n".join(parts) + "\n"


def _sections() -> Iterator[tuple[str, type[BaseModel]]]:
    yield "top level", Scenario
    for name, info in Scenario.model_fields.items():
        model = inner_model(info.annotation)
        if model is not None:
            yield (f"[[{name}]]" if "tuple" in str(info.annotation) else f"[{name}]"), model
