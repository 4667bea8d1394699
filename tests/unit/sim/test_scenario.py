"""A scenario file is checked as strictly as the configuration, and every shipped one is good."""

from itertools import pairwise
from pathlib import Path

import pytest
from pydantic import BaseModel

from gateway.config.strict.section import inner_model
from gateway.durations import NS_PER_S
from gateway.errors import ConfigError
from gateway.sim.ranger import OF_SCENARIO, options_of
from gateway.sim.ranger_board import RangerFault
from gateway.sim.scenario import FaultKind, Scenario, load, parse
from gateway.sim.world import World

ROOT = Path(__file__).parents[3]
SHIPPED = sorted((ROOT / "config" / "scenarios").glob("*.toml"))


def complaint(tmp_path: Path, text: str) -> str:
    path = tmp_path / "s.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load(path)
    return str(caught.value).replace(f"{tmp_path}/", "")


def test_the_shipped_scenarios_are_these() -> None:
    names = {path.stem for path in SHIPPED}

    shown = {"approach", "day", "dusk", "dust", "faults", "head-lamp", "rangers", "rusty", "standing"}
    visits = {"", "-creep", "-drive-away", "-echo", "-lamp", "-person", "-two-trucks"}
    assert names == shown | {f"visit{name}" for name in visits}


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.stem)
def test_every_shipped_scenario_loads_runs_through_and_says_what_it_shows(path: Path) -> None:
    scenario = load(path)
    world = World(scenario)
    times = [k * 0.25 for k in range(int(scenario.duration_s / 0.25) + 1)]
    truths = [world.truth(t) for t in times]

    assert path.read_text(encoding="utf-8").startswith("# ")
    assert all(truth.radius_px > 20 for truth in truths), "the marker can be seen from the start"
    assert any(truth.marker_visible for truth in truths)
    assert world.plan_s <= scenario.duration_s, "the show is over before its last leg"
    assert all(fault.at_s + fault.for_s < scenario.duration_s for fault in scenario.faults)
    assert scenario.legs == () or any(truth.stop for truth in truths)


def test_approach_stops_at_28_cm_backs_off_and_comes_again() -> None:
    world = World(load(ROOT / "config" / "scenarios" / "approach.toml"))
    stops = [world.truth(k / 100).stop for k in range(1900)]
    changes = [(k / 100, after) for k, (before, after) in enumerate(pairwise(stops), 1) if before != after]

    assert changes == [(8.20, True), (13.89, False)]
    assert world.truth(11.0).distance_mm == pytest.approx(280, abs=0.2)
    assert world.truth(world.plan_s - 0.5).distance_mm == pytest.approx(1500, abs=0.5)
    assert world.truth(world.plan_s + 11.0).distance_mm == pytest.approx(280, abs=0.5)


LOADING = {FaultKind.SPOUT_DOWN, FaultKind.DUST_CLOUD, FaultKind.RED_LAMP, FaultKind.RANGER_ECHO}
"""What goes wrong, or must be borne, while a truck is loaded: the scenarios of a visit show it."""
BY_BEACON = {FaultKind.CAMERA_LATE, FaultKind.CAMERA_LOOPED}  # nothing else notices them


def test_faults_toml_shows_every_fault_of_a_sensor_once_and_leaves_time_to_recover() -> None:
    faults = load(ROOT / "config" / "scenarios" / "faults.toml").faults

    elsewhere = LOADING | BY_BEACON | {FaultKind.RANGER_OFFSET, FaultKind.MARKER_CRUSTED}
    assert sorted(f.kind for f in faults) == sorted(set(FaultKind) - elsewhere)
    gaps = [b.at_s - (a.at_s + a.for_s) for a, b in pairwise(faults)]
    assert min(gaps) >= 6.0


def test_the_visits_show_everything_that_goes_wrong_while_a_truck_is_loaded() -> None:
    visits = [load(path) for path in SHIPPED if path.stem.startswith("visit")]

    assert {fault.kind for visit in visits for fault in visit.faults} == LOADING
    assert [visit.seed for visit in visits if any(leg.another_truck for leg in visit.legs)] == [77]


def test_unknown_key_names_line_and_what_is_known(tmp_path: Path) -> None:
    said = complaint(tmp_path, "seed = 1\n\n[light]\nlevle = 2\n")

    assert said.startswith("s.toml:4: light.levle = 2: unknown key (misspelt?); known here: level, drift,")


def test_value_out_of_range_names_line_value_and_range(tmp_path: Path) -> None:
    said = complaint(tmp_path, "[[legs]]\ndistance_cm = 50\n[[legs]]\ndistance_cm = 1\n")

    assert (
        said == "s.toml:4: legs.1.distance_cm = 1: Input should be greater than or equal to 4 (allowed: >= 4, <= 500)"
    )


def test_camera_may_not_drive_through_the_marker() -> None:
    with pytest.raises(
        ConfigError, match=r"the camera would be within -3 mm of the marker: .* no leg may end at 10 cm"
    ):
        parse({"legs": [{"distance_cm": 10}], "camera": {"offset_mm": -100}})


def test_repeat_must_end_where_it_starts() -> None:
    legs = [{"distance_cm": 30}, {"distance_cm": 150, "lateral_mm": 5}]

    with pytest.raises(ConfigError, match=r"the last leg ends at lateral_mm = 5\.0, but the start is at 0\.0"):
        parse({"repeat": True, "legs": legs})
    with pytest.raises(ConfigError, match="repeat needs legs"):
        parse({"repeat": True})
    assert parse({"repeat": True, "legs": legs, "start": {"lateral_mm": 5}}).repeat


def test_overrides_win(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text("seed = 1\n[light]\nlevel = 0.5\ndrift = 0.3\n", encoding="utf-8")

    scenario = load(path, {"seed": 9, "light": {"level": 2.0}})

    assert (scenario.seed, scenario.light.level, scenario.light.drift) == (9, 2.0, 0.3)


def test_a_fault_holds_from_its_start_to_just_before_its_end() -> None:
    scenario = parse({"faults": [{"kind": "camera_lost", "at_s": 2, "for_s": 3}]})
    lost = [scenario.active(FaultKind.CAMERA_LOST, t) for t in (1.999, 2.0, 4.999, 5.0)]

    assert lost == [False, True, True, False]
    assert not scenario.active(FaultKind.CAMERA_FREEZE, 3.0)


def test_the_simulated_ranger_knows_every_fault_of_a_ranger() -> None:
    """An offset is one of the truth that it is given."""
    assert {*OF_SCENARIO, FaultKind.RANGER_OFFSET} == {kind for kind in FaultKind if kind.startswith("ranger_")}


def test_a_fault_hits_the_ranger_that_it_names_and_by_default_the_first() -> None:
    faults = [
        {"kind": "ranger_silent", "at_s": 1, "for_s": 1},
        {"kind": "ranger_no_echo", "ranger": 3, "at_s": 1, "for_s": 1},
        {"kind": "ranger_offset", "ranger": 2, "offset_cm": -7, "at_s": 1, "for_s": 1},
    ]
    show = parse({"start": {"distance_cm": 100}, "vibration": {"amplitude_mm": 0}, "faults": faults})
    rangers = [options_of(show, World(show), 0, n) for n in (1, 2, 3)]
    at_ns = [round(t_s * NS_PER_S) for t_s in (0.5, 1.5)]
    assert [[one["distance_mm"](t) for t in at_ns] for one in rangers] == [[1000, 1000], [1000, 930], [1000, 1000]]
    assert [list(one["faults"](at_ns[1])) for one in rangers] == [[RangerFault.SILENT], [], [RangerFault.NO_ECHO]]
    assert [one["seed"] for one in rangers] == [show.seed, show.seed + 1, show.seed + 2]


def test_every_key_is_described() -> None:
    def keys(model: type[BaseModel]) -> None:
        for name, info in model.model_fields.items():
            inner = inner_model(info.annotation)
            assert inner is not None or info.description, f"{model.__name__}.{name}"
            if inner is not None:
                keys(inner)

    keys(Scenario)
