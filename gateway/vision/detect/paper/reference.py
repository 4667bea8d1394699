"""The stages and the parameters of `[vision]` as tables, for docs/vision.md. Pure."""

from gateway.config import VisionConfig
from gateway.config.reference import key_table
from gateway.vision.detect.paper.pipeline import STAGES


def markdown() -> str:
    """The stages and every parameter of `[vision]` as two Markdown tables."""
    lines = ["| stage | equation | what it does |", "|---|---|---|"]
    lines += [f"| `{name}` | {equation or '–'} | {meaning} |" for name, equation, meaning in STAGES]
    return "\n".join([*lines, "", *key_table(VisionConfig)]) + "\n"
