"""A lamp that was seen beside the marker is not taken for it when the marker is covered."""

from dataclasses import replace

import numpy as np
import pytest

from gateway.core.detection import Circle, Rejection, Tracking
from gateway.vision.track.distractors import HELD_NS, WEAKER, Distractors
from tests.unit.vision.followed_bay import FRAME_NS, HEIGHT, WIDTH, Bay

MARKER, LAMP = Circle(300.0, 240.0, 60.0), Circle(480.0, 300.0, 24.0)
WEAKER_LAMP = (Rejection(LAMP, WEAKER),)
BESIDE = Distractors(MARKER, 0).updated(MARKER, 0, WEAKER_LAMP)


def test_a_distractor_is_held_for_a_limited_time() -> None:
    assert BESIDE.holds(LAMP, 1, (), WIDTH, HEIGHT)
    assert BESIDE.holds(LAMP, HELD_NS, (), WIDTH, HEIGHT)
    assert not BESIDE.holds(LAMP, HELD_NS + 1, (), WIDTH, HEIGHT)
    assert not BESIDE.holds(LAMP, -1, (), WIDTH, HEIGHT)  # the clock was set back


@pytest.mark.parametrize(
    "other",
    [
        replace(LAMP, u_px=LAMP.u_px + 13),
        replace(LAMP, v_px=LAMP.v_px - 13),
        replace(LAMP, radius_px=35.0),
        replace(LAMP, radius_px=16.0),
        MARKER,
        replace(MARKER, u_px=100.0),
    ],
)
def test_something_else_is_not_held(other: Circle) -> None:
    assert not BESIDE.holds(other, 1, (), WIDTH, HEIGHT)


def test_a_rejected_candidate_that_was_no_red_disc_is_no_distractor() -> None:
    none = Distractors(MARKER, 0).updated(MARKER, 0, (Rejection(LAMP, "leak"),))
    assert not none.holds(LAMP, 1, (), WIDTH, HEIGHT)


def test_a_distractor_is_recognised_on_the_wall_and_on_the_truck() -> None:
    """The truck has come nearer since the lamp was found: all that is on it by as much."""
    nearer = BESIDE.updated(Circle(280.0, 220.0, 90.0), 5, ())
    with_it = Circle(280.0 + 1.5 * 180, 220.0 + 1.5 * 60, 36.0)
    assert nearer.holds(LAMP, 6, (), WIDTH, HEIGHT)
    assert nearer.holds(with_it, 6, (), WIDTH, HEIGHT)
    assert not BESIDE.holds(with_it, 6, (), WIDTH, HEIGHT)
    assert not nearer.holds(replace(with_it, u_px=with_it.u_px - 40), 6, (), WIDTH, HEIGHT)


def test_new_distractors_replace_the_old_ones() -> None:
    elsewhere = Circle(100.0, 100.0, 20.0)
    anew = BESIDE.updated(MARKER, 1, (Rejection(elsewhere, WEAKER),))
    assert anew.holds(elsewhere, 2, (), WIDTH, HEIGHT)
    assert not anew.holds(LAMP, 2, (), WIDTH, HEIGHT)


@pytest.mark.parametrize(
    ("u", "v", "held"),
    [(64.0, 240.0, False), (67.0, 240.0, True), (300.0, 415.0, False), (576.0, 240.0, False), (300.0, 60.0, False)],
)
def test_a_marker_that_may_have_left_the_picture_holds_nothing(u: float, v: float, held: bool) -> None:
    marker = replace(MARKER, u_px=u, v_px=v)
    beside = Distractors(marker, 0).updated(marker, 0, WEAKER_LAMP)
    assert beside.holds(LAMP, 1, (), WIDTH, HEIGHT) is held


def test_a_marker_that_is_still_seen_holds_nothing() -> None:
    """The search has changed its mind, as it may: what was followed first was perhaps the lamp."""
    assert not BESIDE.holds(LAMP, 1, (Rejection(replace(MARKER, u_px=305.0), WEAKER),), WIDTH, HEIGHT)
    assert BESIDE.holds(LAMP, 1, (Rejection(replace(MARKER, u_px=305.0), "fill"),), WIDTH, HEIGHT)
    assert BESIDE.holds(LAMP, 1, (Rejection(Circle(100.0, 100.0, 20.0), WEAKER),), WIDTH, HEIGHT)


# -- followed ----------------------------------------------------------------------------------------------------------


def test_a_lamp_is_not_measured_while_the_marker_is_covered() -> None:
    bay = Bay(narrow=True)
    assert all(one.circle == MARKER for one in bay.frames(20, MARKER, LAMP))
    hidden = bay.frames(200, LAMP)
    assert {one.circle for one in hidden} == {None}
    assert [one.tracking for one in hidden] == [Tracking.COASTED] * 9 + [Tracking.LOST] * 191
    assert all(one.rejected == (Rejection(LAMP, "jump"),) for one in hidden)
    back = [one.circle for one in bay.frames(3, MARKER, LAMP)]
    assert back[-1] == MARKER


def test_a_marker_that_reappears_while_it_is_coasted_is_measured_at_once() -> None:
    bay = Bay(narrow=True)
    bay.frames(20, MARKER, LAMP)
    bay.frames(7, LAMP)
    assert bay.frames(1, MARKER, LAMP)[0].circle == MARKER


def test_a_disc_that_stays_alone_is_measured_in_the_end() -> None:
    """The marker may be gone for good, or it was the lamp that was followed first."""
    bay = Bay(narrow=True)
    bay.frames(20, MARKER, LAMP)
    labels = [one.tracking for one in bay.frames(HELD_NS // FRAME_NS + 2, LAMP)]
    assert Tracking.MEASURED not in labels[: HELD_NS // FRAME_NS - 1]
    assert labels[-1] is Tracking.MEASURED


def test_after_an_empty_frame_the_lamp_is_still_not_measured() -> None:
    bay = Bay(narrow=True)
    bay.frames(20, MARKER, LAMP)
    bay.frames(30, LAMP)
    assert [one.tracking for one in bay.frames(1)] == [Tracking.LOST]
    assert all(one.circle is None for one in bay.frames(10, LAMP))


def test_no_measured_circle_is_a_distractor_of_the_one_before() -> None:
    """Whatever is covered when: a lamp that was found beside it is never reported between two sights of the marker."""
    chance = np.random.default_rng(5)
    bay = Bay(narrow=True)
    bay.frames(5, MARKER, LAMP)
    covered, uncovered = (LAMP,), (MARKER, LAMP)
    for _ in range(40):
        for one in bay.frames(int(chance.integers(1, 40)), *(covered if chance.integers(2) else uncovered)):
            assert one.circle in (None, MARKER)
