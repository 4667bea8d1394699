"""The fleet's demonstration, small: does it still run, and is nothing lost while a node is killed?"""

from pathlib import Path

import pytest

from bench.fleet.demonstration import Settings, run


@pytest.mark.long
@pytest.mark.timeout(300)
def test_three_gateways_lose_nothing_while_a_node_is_killed(tmp_path: Path) -> None:
    settings = Settings(
        gateways=3, calm_s=1.0, hang_s=0.0, period_s=5.0, late_ms=1000.0, renew=False, sparkplug=True, roll_out=False
    )
    said: list[str] = []
    report = run(tmp_path, settings, said.append)
    assert report.faults == []
    assert report.verdict is not None
    assert (report.verdict.lost, report.verdict.out_of_order) == (0, 0)
    assert report.verdict.stops_received == report.verdict.stops_made >= 3, "each start clears a stop"
    assert report.good
    assert report.figures["most_online"] == 3
    assert "node 1 is killed" in said
