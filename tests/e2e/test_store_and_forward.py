"""A small share of bench/mqtt_store_forward.py with every run of the tests."""

from pathlib import Path

from tests.e2e import store_and_forward


def test_no_stop_transition_is_lost_or_out_of_order_whoever_is_killed(tmp_path: Path) -> None:
    report = store_and_forward.run(
        tmp_path, transitions=400, broker_kills=8, gateway_kills=4, per_s=150.0, seed=20261121
    )
    assert (report.lost, report.out_of_order) == ([], [])
    assert report.transitions >= 400
    assert (report.broker_kills, report.gateway_kills) == (8, 5)
    assert report.received + report.forgotten >= report.events - 10
