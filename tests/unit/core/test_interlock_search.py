"""A short share of bench/exhaustive.py: states next to every phase of a visit, judged by the stated conditions."""

from collections.abc import Mapping
from dataclasses import replace

import pytest

from gateway.core.state import VisitPhase
from tests.interlock_search import TIMES, complaints, root, search, spaces, taken, visits
from tests.interlock_walks import ROUND, played, walk
from tests.long import mostly_long
from tests.planted_faults import PLANTED

pytestmark = pytest.mark.one_interpreter

SPACES = spaces()
TRANSITIONS: Mapping[str, int] = {
    "core": 2_000,
    "band": 2_000,
    "visit": 6_000,
    "learned": 4_000,
    "latch": 3_000,
    "owners": 2_000,
    "plain": 2_000,
    "shipped": 4_000,
    "drive": 4_000,
}
AT_LEAST = {phase.name.lower() for phase in VisitPhase} - {"empty", "arriving"}


@pytest.mark.parametrize("name", mostly_long(SPACES, short=4))
def test_no_state_next_to_a_visit_permits_what_a_stated_condition_forbids(name: str) -> None:
    space = SPACES[name]
    found = search(space, visits(space), transitions=TRANSITIONS[name], compare=0.003)
    assert found.faults == []
    assert found.unlike == []
    assert found.states > TRANSITIONS[name] / 5
    more = {"may_move", "moved", "leaves though D is not 0", "in place before the restart"}
    assert found.reached.keys() >= AT_LEAST | more, "a search of nothing"


@pytest.mark.mostly_long(short=3)
@pytest.mark.parametrize(
    ("what", "space", "transitions"),
    [
        ("an old distance counts", "visit", 1500),
        ("stop ends without clear_hold_s", "visit", 500),
        ("a dead camera does not end in_place", "visit", 1500),
        ("a truck that leaves its place has not moved", "visit", 500),
        ("off the mark is as good as released", "band", 500),
        ("a function check is forgotten", "visit", 500),
        ("a PLC is never lost", "visit", 500),
        ("a heartbeat that stands still counts", "owners", 2000),
        ("a state is valid for ever", "visit", 10),
        ("what was shown withdrawn comes back by itself", "shipped", 3000),
        ("a restart forgets the truck in place", "visit", 500),
        ("a place of before the restart is one of now", "visit", 2000),
        ("the latch does not hold", "latch", 1500),
        ("a drive follows the permit alone", "drive", 500),
    ],
)
def test_the_search_reports_a_planted_fault(
    what: str, space: str, transitions: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen = SPACES[space]
    PLANTED[what].plant(monkeypatch.setattr)
    found = search(chosen, visits(chosen), transitions=transitions, most_faults=1)
    assert found.faults, f"{what}: not reported"
    complaint, history = found.faults[0]
    assert complaint in list(complaints(chosen, played(chosen, history))), "the history replays it"


@pytest.mark.parametrize(
    ("what", "then", "complaint"),
    [
        pytest.param(
            "how long a truck has stood counts on over a release",
            (
                *("check:may_move_off", "check:off", "camera:rolled", "ranger:rolled", "plc:idle", "tick"),
                *["camera:mark", "ranger:mark", "plc:idle", "tick"] * 2,
            )[:-1],
            "in_place 0 s after the truck stood",
            marks=pytest.mark.long,
        ),
        (
            "a reset is accepted while the sensors do not fit",
            ("camera:rolled", "ranger:rolled", "plc:idle", "camera:away"),
            "moved is not reported, though the truck has left its place",
        ),
    ],
)
def test_the_search_reports_a_planted_fault_from_a_truck_that_was_in_place(
    what: str, then: tuple[str, ...], complaint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some moves alone, so that a short search comes deep enough."""
    names = {"tick", "camera:mark", "ranger:mark", "ranger:rolled", "plc:idle", "plc:release", "plc:reset", *then}
    space = SPACES["visit"]
    space = replace(space, moves=tuple(move for move in space.moves if move.name in names))
    roots = [["camera:mark", "ranger:mark", "plc:idle", "tick"] * 8 + [*then]]
    PLANTED[what].plant(monkeypatch.setattr)
    found = search(space, roots, transitions=60_000, most_faults=1)
    assert [fault for fault, _ in found.faults] == [complaint]


@pytest.mark.parametrize("name", mostly_long(SPACES, short=2))
def test_no_random_walk_comes_to_a_permit_that_a_stated_condition_forbids(name: str) -> None:
    space = SPACES[name]
    found = walk(space, visits(space), walks=3)
    assert found.faults == []
    assert found.transitions == 600
    assert found.reached.keys() >= {"may_move", "leaving", "unknown"}, "walks to nowhere"


def test_a_walk_reports_a_planted_fault_by_a_history_without_a_move_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    space = SPACES["visit"]
    PLANTED["a function check is forgotten"].plant(monkeypatch.setattr)
    found = walk(space, visits(space)[:1], walks=20, moves=60, most_faults=1)
    (complaint, history), *_ = found.faults
    assert complaint in list(complaints(space, played(space, history)))
    for n in range(len(history)):
        shorter = history[:n] + history[n + 1 :]
        assert complaint not in list(complaints(space, played(space, shorter))), history[n]
    assert walk(space, visits(space)[:1], walks=20, moves=60, most_faults=1).faults == found.faults, "the same again"


def test_each_move_of_a_round_is_one_of_a_space() -> None:
    """What a space leaves out is left out of its rounds; a misspelt move would be, too."""
    names = {move.name for move in SPACES["visit"].moves}
    for camera, ranger, plc in ROUND:
        assert {f"camera:{camera}", f"ranger:{ranger}", f"plc:{plc}"} <= names


def test_a_small_space_is_searched_to_its_end() -> None:
    """Without a camera nothing is ever permitted, and there are few states: every history of any length is covered."""
    space = SPACES["core"]
    moves = tuple(move for move in space.moves if move.name in ("tick", "ranger:mark", "ranger:rolled", "plc:idle"))
    blind = replace(space, name="blind", moves=moves)
    found = search(blind, transitions=200_000)
    assert found.left == 0
    assert found.faults == []
    assert not found.reached.keys() & {"may_move", "in_place", "held", "released", "moved"}


def test_each_time_of_the_state_has_the_age_beyond_which_nothing_distinguishes_it() -> None:
    space = SPACES["visit"]
    assert len(space.time_limits_ns) == len(TIMES)
    limits_ns = dict(zip(TIMES, space.time_limits_ns, strict=True))
    assert limits_ns["visit.covered_since_ns"] == 600_000_000, "hold_limit_s, not an age of it more"
    assert limits_ns["vision.t_ns"] == 300_000_001, "a reading is stale when it is older than that"
    assert max(limits_ns.values()) == 600_000_000


def test_something_red_while_there_is_no_distance_does_not_prolong_how_long_in_place_is_held() -> None:
    """Found by twenty minutes of `visit`: the marker is covered, and a lamp is seen for a moment without a distance."""
    space = SPACES["visit"]
    placed = ["camera:mark", "ranger:mark", "plc:idle", "tick"] * 8
    covered = ["camera:no_target", "ranger:mark", "plc:idle", "tick"]
    node = root(space)
    for name in [*placed, *covered, "camera:lamp", "ranger:no_echo", "camera:no_target", "ranger:mark", "tick"]:
        node = taken(space, node, space.moves[space.named(name)])
    assert list(complaints(space, node)) == []
    assert not node.state.in_place
    assert node.state.visit.ended == "held for too long"
