"""What is legal in a configuration and makes no sense: each is named by its key, and nothing else is."""

from pathlib import Path
from typing import Any

import pytest

from gateway.config import GatewayConfig, load, parse
from gateway.doctor.settings import of_picture, warnings

VGA = {"width_px": 640, "height_px": 480}
LENS = {"fx": 600, "fy": 600, "cx": 320, "cy": 240}
SLOW = {"fusion": {"vision_deadline_s": 4}}
CHECK = {"focal_px": 600, "marker_radius_mm": 90}


def config(**sections: Any) -> GatewayConfig:
    return parse(sections)


@pytest.mark.parametrize("path", sorted(Path("config").glob("*.toml")), ids=lambda path: path.name)
def test_the_shipped_files_make_sense(path: Path) -> None:
    assert warnings(load(path)) == []


@pytest.mark.parametrize(
    ("sections", "expected"),
    [
        ({"camera": VGA, "fusion": {"radius_threshold_px": 241}}, "fusion.radius_threshold_px = 241: a circle of that"),
        ({"vision": {"intrinsics": LENS | VGA}, "fusion": {"radius_threshold_px": 241}}, "does not fit into a picture"),
        (
            {"camera": VGA, "vision": {"max_radius_share": 0.2}},
            "no circle above 160 px (vision.max_radius_share",
        ),
        ({"camera": VGA, "guidance": {"aim_u_px": 640}}, "guidance.aim_u_px = 640: outside a picture of 640 x 480 px"),
        ({"camera": VGA, "guidance": {"aim_v_px": -1}}, "guidance.aim_v_px = -1: outside"),
        ({"camera": VGA, "guidance": {"aim_u_px": 179}}, "guidance.aim_u_px = 179: a marker of R_th = 180 px there is"),
        ({"vision": {"intrinsics": LENS}, "fusion": {"cross_check": CHECK | {"focal_px": 661}}}, "differ by more than"),
        ({"camera": {"fps": 5}}, "fusion.vision_deadline_s = 0.3: at camera.fps = 5 a frame comes every 0.2 s"),
        ({**SLOW, "camera": {"fps": 0.5, "deadline_s": 3}}, "camera.open_deadline_s = 10: at camera.fps = 0.5 the 5"),
        ({"fusion": {"range_deadline_s": 0.17}}, "fusion.range_deadline_s = 0.17: the ranger measures every 60 ms"),
        ({"fusion": {"fail_safe": False}}, "fusion.fail_safe = false"),
        ({"fusion": {"decision": "plain"}}, 'fusion.decision = "plain" without [fusion.cross_check]'),
        ({"fusion": {"scale_tolerance": 0}}, "fusion.scale_tolerance = 0 without [fusion.cross_check]"),
        ({"camera": {"frozen_s": 0}}, "camera.frozen_s = 0"),
        ({"camera": {"url": "film.avi"}}, "camera.url = film.avi: a film or a folder, which ends as a lost camera"),
        ({"state_dir": ""}, 'state_dir = ""'),
        ({"mqtt": {"url": "mqtt://10.0.0.9", "username": "u", "password_file": "/f"}}, "the password travels unencr"),
    ],
)
def test_what_makes_no_sense_is_named_with_its_key(sections: dict[str, Any], expected: str) -> None:
    found = warnings(config(**sections))
    assert len(found) == 1
    assert expected in found[0]


@pytest.mark.parametrize(
    "sections",
    [
        {"camera": VGA, "fusion": {"radius_threshold_px": 240}},
        {"camera": VGA, "guidance": {"aim_u_px": 180, "aim_v_px": 300}},
        {"vision": {"intrinsics": LENS}, "fusion": {"cross_check": CHECK | {"focal_px": 659}}},
        {"camera": {"fps": 7}},
        {**SLOW, "camera": {"fps": 0.5, "deadline_s": 3, "open_deadline_s": 11}},
        {**SLOW, "camera": {"fps": 0.5, "deadline_s": 3, "url": "folder/", "loop": True}},
        {"fusion": {"range_deadline_s": 0.18}},
        {"fusion": {"decision": "plain", "cross_check": CHECK}},
        {"mqtt": {"url": "mqtts://10.0.0.9", "username": "u", "password_file": "/f"}},
        {"mqtt": {"url": "mqtt://127.0.0.1", "username": "u", "password_file": "/f"}},
    ],
)
def test_what_just_makes_sense_is_not_named(sections: dict[str, Any]) -> None:
    assert warnings(config(**sections)) == []


def test_each_bay_is_named() -> None:
    found = warnings(config(bays=[{"name": "a"}, {"name": "b", "unit_id": 2, "fusion": {"fail_safe": False}}]))
    assert [line.partition(": ")[0] for line in found] == ["bay b"]


def test_the_size_that_a_camera_gives_is_judged_likewise() -> None:
    bay = config().bays[0]
    assert list(of_picture(bay, 640, 360)) == []
    assert len(list(of_picture(bay, 640, 359))) == 1
