"""The line that `gateway state` prints."""

import math
from dataclasses import replace

import pytest

from gateway.cli.state import _line, _row
from gateway.core.readings import Quality
from gateway.core.state import Moved, Reason
from gateway.shared_state import SharedVector

GOOD = SharedVector(
    bay="bay1", pid=7, seq=9, t_ns=20, t_vision_ns=10, t_range_ns=11, valid_until_ns=20, frame_id=3,
    u_px=1.0, v_px=2.0, radius_px=30.0, distance_mm=900.0, z_vision_mm=math.nan,
    vision_quality=Quality.GOOD, range_quality=Quality.GOOD, reason=Reason.NONE, d=False, stop=False, may_move=True,
    in_place=False, moved=Moved.NO,
)  # fmt: skip


@pytest.mark.parametrize(
    ("vector", "verdict"),
    [
        (GOOD, "may move"),
        (replace(GOOD, may_move=False), "may not move"),  # the bay is not wanted, say
        (replace(GOOD, may_move=False, stop=True, in_place=True), "STOP in place"),
        (replace(GOOD, may_move=False, stop=True, reason=Reason.TARGET_COASTED), "STOP target_coasted"),
    ],
)
def test_stop_off_alone_is_not_shown_as_leave_to_go(vector: SharedVector, verdict: str) -> None:
    assert _line(_row("gateway", vector, 20)).endswith(f"  good/good  {verdict}")
