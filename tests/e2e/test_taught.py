"""Thresholds saved, end of the function check, restart, by the addresses that the pages use (docs/install.md): what was
saved is in force before the bay is at work."""

from pathlib import Path
from uuid import uuid4

import pytest

from tests.e2e.page_client import PageClient
from tests.e2e.plc import Plc
from tests.e2e.processes import Gateway

pytestmark = pytest.mark.timeout(240)
STANDING = "seed = 40\ncamera = { fps = 10 }\nstart = { distance_cm = 36.0 }\n"
CONFIG = """\
instance = "{instance}"
initial_function_check = true

[hmi]
enabled = true
port = 0
without_login = "technician"

[camera]
deadline_s = 3.0
"""
PROFILE, CHECK = "/api/bays/bay1/profile", "/api/bays/bay1/function-check"
TAUGHT = {"radius_threshold_px": 145.0, "distance_threshold_mm": 390.0}
PATIENCE_S = 60.0


@pytest.mark.long
def test_what_is_saved_is_in_force_before_the_function_check_can_end(tmp_path: Path) -> None:
    config, story = tmp_path / "plant.toml", tmp_path / "story.toml"
    config.write_text(CONFIG.format(instance=f"test-{uuid4().hex[:12]}"))
    story.write_text(STANDING)
    keys = [f"fusion.{key}" for key in TAUGHT]
    with Gateway(
        *("simulate", "--json", "--config", str(config), "--scenario", str(story)),
        *("--modbus-port", "0", "--hmi-port", "0", "--state-dir", str(tmp_path / "state")),
    ) as gateway:
        started = gateway.started()
        with Plc(started["modbus_port"]) as plc:  # a start may be followed by another one after 10 s: 500 ticks
            plc.wait_for(lambda image: image["heartbeat"] > 550, PATIENCE_S)
        with PageClient(started["hmi"].rstrip("/")) as page:
            assert page.get(PROFILE)["function_check"] == "may_move_off", "its first start"
            changes = [{"path": ["fusion", key], "value": value} for key, value in TAUGHT.items()]
            digest = page.get("/api/setup/settings")["digest"]
            assert page.post("/api/setup/save", {"digest": digest, "changes": changes})["live"] == []
            assert page.get(PROFILE)["file"]["waiting"] == keys
            refused = page.post(CHECK, {"mode": "off"}, 409)
            assert refused["detail"] == f"not while keys of this bay's decision wait for a restart: {', '.join(keys)}"
            assert page.get(PROFILE)["function_check"] == "may_move_off"
            page.post("/api/setup/restart", {"confirmed": True, "despite_trucks": True})
        again = gateway.started()
        with Plc(again["modbus_port"]) as plc, PageClient(again["hmi"].rstrip("/")) as page:
            plc.wait_for(lambda image: image["d"] == 1, PATIENCE_S)  # by the new thresholds
            profile = page.get(PROFILE)
            assert (profile["function_check"], profile["untried"], profile["file"]["waiting"]) == (
                "may_move_off",
                keys,
                [],
            )
            ended = page.post(CHECK, {"mode": "off"})
            assert (ended["function_check"], ended["untried"]) == ("off", [])
            stood = plc.wait_for_beats(300, PATIENCE_S)
            assert not any(poll.image["in_place"] or poll.image["may_move"] for poll in stood), (
                "it was not seen to come"
            )
