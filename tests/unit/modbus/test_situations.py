"""The state table of the PLC's pages agrees with the visit's contract, situation by situation."""

from typing import Any

import pytest

from gateway.core.state import Reason, VisitPhase
from tools import situations

IMAGES = situations.images()
# The lamps, bit by bit: red 1, amber 2, green 4, forward 8.
RED, SLOW, GREEN, FORWARD = 1, 2 + 8, 4, 4 + 8
# (D, stop, may_move, in_place, moved, reason, phase, signal_lamps)
EXPECTED: dict[str, tuple[int | None, int, int, int, int, Reason, VisitPhase, int]] = {
    "empty bay": (None, 1, 0, 0, 0, Reason.NO_ECHO, VisitPhase.EMPTY, RED),
    "arriving, beyond the ranger's range": (0, 0, 1, 0, 0, Reason.NONE, VisitPhase.ARRIVING, FORWARD),
    "approaching": (0, 0, 1, 0, 0, Reason.NONE, VisitPhase.APPROACHING, SLOW),
    "at the mark, still rolling": (1, 1, 0, 0, 0, Reason.TARGET_REACHED, VisitPhase.AT_MARK, RED),
    "in place, seen by both": (1, 1, 0, 1, 0, Reason.TARGET_REACHED, VisitPhase.IN_PLACE, RED),
    "loading: the marker is covered, held by the ranger": (None, 1, 0, 1, 0, Reason.NO_TARGET, VisitPhase.HELD, RED),
    "released by the PLC (`release`)": (1, 0, 1, 0, 0, Reason.NONE, VisitPhase.RELEASED, GREEN),
    "leaving": (0, 0, 1, 0, 0, Reason.NONE, VisitPhase.LEAVING, GREEN),
}


@pytest.mark.parametrize("name", EXPECTED)
def test_a_visit_without_a_fault_reads_as_its_contract(name: str) -> None:
    image = IMAGES[name]
    names = ("d", "stop", "may_move", "in_place", "moved", "reason", "visit_phase", "signal_lamps")
    assert tuple(image[one] for one in names) == EXPECTED[name]


@pytest.mark.parametrize("name", [name for name in IMAGES if name not in EXPECTED])
def test_no_fault_leaves_a_truck_in_place(name: str) -> None:
    assert IMAGES[name]["in_place"] == 0
    if "seen" not in name and "rolls back" not in name:
        assert (IMAGES[name]["stop"], IMAGES[name]["may_move"]) == (1, 0)


@pytest.mark.parametrize("name", [name for name in IMAGES if "rolls" in name or "drives off" in name])
def test_a_truck_that_moves_without_release_is_reported(name: str) -> None:
    assert IMAGES[name]["moved"] == (0 if name == "at the mark, still rolling" else 1)


@pytest.mark.parametrize("image", IMAGES.values(), ids=IMAGES)
def test_no_row_contradicts_itself(image: dict[str, Any]) -> None:
    assert image["stop"] + image["may_move"] <= 1
    assert image["may_move"] + image["in_place"] <= 1
    assert image["in_place"] <= image["stop"]
    assert (image["reason"] != 0) == bool(image["stop"])
    assert image["signal_lamps"] & RED or not image["stop"]


@pytest.mark.one_interpreter
def test_the_table_has_a_row_for_each_and_the_figure_every_phase() -> None:
    rows = situations.markdown().splitlines()[2:]
    assert [row.split("|")[1].strip() for row in rows] == list(IMAGES)
    assert "| approaching | 0 | 0 | **1** | 0 | 0 | 0 `none` | `approaching` | amber, forward |" in rows
    (drawn,) = situations.figures().values()
    for phase in (VisitPhase.EMPTY, VisitPhase.APPROACHING, VisitPhase.AT_MARK, VisitPhase.IN_PLACE, VisitPhase.HELD):
        assert f">{phase.value}</text>" in drawn
    for name in ("stop", "may_move", "in_place", "held", "release"):
        assert f">{name}</text>" in drawn
