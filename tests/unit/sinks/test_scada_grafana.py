"""The Grafana dashboard names topics and fields; all of them exist in the topic plan and in the payloads' schemas.

Grafana itself is not here: what a panel does with a field is not tested, only that the field comes.
"""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gateway.config import FusionConfig
from gateway.sinks.mqtt.topic_plan import PLAN as TOPIC_PLAN
from gateway.sinks.mqtt.topic_plan import TopicKind
from tests.grafana_board import laid_out

DOCS = Path(__file__).parents[3] / "docs"
BOARD = json.loads((DOCS / "scada" / "grafana-loading-bays.json").read_text(encoding="utf-8"))
PANELS = [panel for panel in BOARD["panels"] if "targets" in panel]
VARIABLES = {variable["name"] for variable in BOARD["templating"]["list"]}
PLAN = {kind.pattern: kind for kind in TOPIC_PLAN}


def kind_of(panel: dict[str, Any]) -> TopicKind:
    """The row of the topic plan that the panel's one target follows."""
    (target,) = panel["targets"]
    pattern = target["topic"].replace("${", "{").replace("{gateway}", "{instance}")
    assert pattern in PLAN, target["topic"]
    return PLAN[pattern]


def schema_of(panel: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((DOCS / "schemas" / kind_of(panel).schema).read_text(encoding="utf-8"))
    return found


def field(schema: dict[str, Any], path: str) -> dict[str, Any]:
    """The schema of a field, `vision.quality.name` say. KeyError where there is none."""
    found = schema
    for name in path.split("."):
        found = found["properties"][name]
        choices = [found, *found.get("anyOf", [])]
        refs = [choice["$ref"] for choice in choices if "$ref" in choice]
        if refs:
            found = schema["$defs"][refs[0].removeprefix("#/$defs/")]
    return found


def extracted(panel: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Alias and path of what its transformations take out of nested objects."""
    for step in panel.get("transformations", []):
        if step["id"] == "extractFields":
            for taken in step["options"]["jsonPaths"]:
                yield taken["alias"], f"{step['options']['source']}.{taken['path']}"


def shown(panel: dict[str, Any]) -> set[str]:
    """The names of the fields that it picks."""
    names = set()
    if "reduceOptions" in panel.get("options", {}):
        pattern = panel["options"]["reduceOptions"]["fields"]
        assert re.fullmatch(r"/\^.+\$/", pattern)
        names |= set(pattern[2:-2].strip("()").split("|"))
    for step in panel.get("transformations", []):
        if step["id"] == "filterFieldsByName":
            names |= set(step["options"]["include"]["names"])
    assert names, panel["title"]
    return names - {"Time"}


@pytest.mark.parametrize("panel", PANELS, ids=lambda panel: panel["title"])
def test_every_field_exists(panel: dict[str, Any]) -> None:
    schema = schema_of(panel)
    aliases = dict(extracted(panel))
    for path in aliases.values():
        assert field(schema, path)
    for name in shown(panel) - set(aliases):
        assert field(schema, name)
    assert set(aliases) <= shown(panel)  # nothing is taken out and not shown


def test_a_field_that_is_none_is_noticed() -> None:
    schema = schema_of(PANELS[1])
    with pytest.raises(KeyError):
        field(schema, "vision.quality.colour")
    with pytest.raises(KeyError):
        field(schema, "radius")


@pytest.mark.parametrize("panel", PANELS, ids=lambda panel: panel["title"])
def test_every_variable_exists(panel: dict[str, Any]) -> None:
    assert set(re.findall(r"\$\{(\w+)\}", json.dumps(panel))) <= VARIABLES | {"DS_MQTT"}
    assert panel["datasource"] == panel["targets"][0]["datasource"] == BOARD_SOURCE


BOARD_SOURCE = {"type": BOARD["__inputs"][0]["pluginId"], "uid": "${" + BOARD["__inputs"][0]["name"] + "}"}


def test_it_shows_what_was_promised() -> None:
    everything = set().union(*(shown(panel) for panel in PANELS))
    assert everything >= {"status", "stop", "may_move", "Reason", "radius_px", "distance_mm", "Camera rate", "NE 107"}
    assert {kind_of(panel).name for panel in PANELS} == {"status", "state", "event"}
    (row,) = [panel for panel in BOARD["panels"] if panel["type"] == "row"]
    assert row["repeat"] == "bay"


@pytest.mark.parametrize(
    ("title", "limit"),
    [
        ("Marker radius R", FusionConfig().radius_threshold_px),
        ("Distance Z", FusionConfig().distance_threshold_mm),
    ],
)
def test_the_lines_are_the_default_thresholds(title: str, limit: float) -> None:
    (panel,) = [panel for panel in PANELS if panel["title"] == title]
    assert [step["value"] for step in panel["fieldConfig"]["defaults"]["thresholds"]["steps"]] == [None, limit]
    assert panel["fieldConfig"]["defaults"]["custom"]["thresholdsStyle"]["mode"] == "line"


def test_true_and_false_have_their_texts() -> None:
    for title, texts in (("Stop", ("STOP", "no stop")), ("May move", ("may move", "may not move"))):
        (panel,) = [panel for panel in PANELS if panel["title"] == title]
        (mapping,) = panel["fieldConfig"]["defaults"]["mappings"]
        assert tuple(mapping["options"][value]["text"] for value in ("true", "false")) == texts


def test_ids_are_unique_and_nothing_overlaps() -> None:
    laid_out(BOARD)
