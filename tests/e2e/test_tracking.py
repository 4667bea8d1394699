"""A covered marker as a PLC sees it: coasted, lost, measured again; a prediction never gives may_move."""

from pathlib import Path

import pytest

from gateway.core.detection import Tracking
from gateway.core.readings import Quality
from gateway.core.state import Reason
from tests.e2e.plc import Plc
from tests.e2e.processes import Gateway
from tests.long import mostly_long

# Nothing else is red. Covered again and again: a machine that stalls at the wrong moment has another chance.
COVERED = """
seed = 3
clutter = { things = 0 }
start = { distance_cm = 45 }
""" + "\n".join(f'[[faults]]\nkind = "marker_hidden"\nat_s = {at_s}\nfor_s = 3' for at_s in range(8, 150, 7))
TRUE_PX = 5400 / 45


@pytest.mark.long
@pytest.mark.timeout(300)
@pytest.mark.parametrize("method", mostly_long(["robust", "paper"]))
def test_a_covered_marker_stops_the_truck_and_is_only_predicted(tmp_path: Path, method: str) -> None:
    path = tmp_path / "covered.toml"
    path.write_text(COVERED)
    args = ("simulate", "--scenario", str(path), "--method", method, "--modbus-port", "0", "--json")
    with Gateway(*args) as gateway, Plc(gateway.started()["modbus_port"]) as plc:
        seen = plc.wait_for(lambda image: image["may_move"] == 1, timeout_s=90).image
        assert (seen["tracking"], seen["reason"]) == (Tracking.MEASURED, Reason.NONE)
        assert seen["radius"] == pytest.approx(TRUE_PX, abs=2.0)
        coasted = plc.wait_for(lambda image: image["tracking"] == Tracking.COASTED, timeout_s=90).image
        assert (coasted["vision_quality"], coasted["reason"]) == (Quality.COASTED, Reason.TARGET_COASTED)
        assert coasted["predicted_radius"] == pytest.approx(TRUE_PX, abs=8.0)
        lost = plc.wait_for(lambda image: image["tracking"] == Tracking.LOST, timeout_s=90).image
        assert (lost["vision_quality"], lost["predicted_radius"]) == (Quality.NO_TARGET, None)
        plc.wait_for(lambda image: image["may_move"] == 1, timeout_s=90)
        for image in (poll.image for poll in plc.polls):
            measured = image["tracking"] == Tracking.MEASURED
            assert (image["radius"] is not None) == (image["vision_quality"] == Quality.GOOD)
            assert measured or image["may_move"] == 0
            assert measured or image["stop"] == 1
            assert (image["predicted_radius"] is not None) == (image["tracking"] == Tracking.COASTED)
        states = [row for row in gateway.rows if row["type"] == "state"]
        assert {row["tracking"] for row in states} >= {"measured", "coasted", "lost"}
        assert all((row["predicted"] is not None) == (row["tracking"] == "coasted") for row in states)
        assert all(row["r"] is None for row in states if row["tracking"] != "measured")
