"""When two circles or ellipses are the same thing: the one module for that question. Pure."""

import math
from typing import Protocol

from gateway.core.detection import Circle, Ellipse

SAME_PLACE = 0.5  # of the larger radius: two circles whose centres are closer are at the same place
SAME_SIZE = 1.4  # so much larger or smaller is about the same size


class Centred(Protocol):
    @property
    def u_px(self) -> float: ...

    @property
    def v_px(self) -> float: ...


class Round(Centred, Protocol):
    @property
    def radius_px(self) -> float: ...


def distance_px(one: Centred, other: Centred) -> float:
    """Between the centres."""
    return math.hypot(one.u_px - other.u_px, one.v_px - other.v_px)


def same_place(one: Circle, other: Circle) -> bool:
    """Whatever their sizes."""
    return distance_px(one, other) < SAME_PLACE * max(one.radius_px, other.radius_px)


def same_circle(one: Circle, other: Circle, reach_px: float | None = None) -> bool:
    """The same thing, roughly measured: of about the same size, and no farther off than `reach_px`, or SAME_PLACE."""
    larger, smaller = max(one.radius_px, other.radius_px), min(one.radius_px, other.radius_px)
    return larger <= SAME_SIZE * smaller and distance_px(one, other) <= (
        SAME_PLACE * larger if reach_px is None else reach_px
    )


def same_ellipse(one: Ellipse, other: Ellipse) -> bool:
    """One rim, fitted twice."""
    reach_px = 0.15 * min(one.semi_minor_px, other.semi_minor_px) + 1
    return (
        _within(one, other, reach_px)
        and abs(one.semi_major_px - other.semi_major_px) < reach_px
        and abs(one.semi_minor_px - other.semi_minor_px) < reach_px
    )


def crosses(one: Ellipse, other: Ellipse) -> bool:
    """Two rims of about the same size at the same place, but not one round the other: one of them is wrong."""
    smaller, larger = sorted((one.semi_major_px, other.semi_major_px))
    apart_px = distance_px(one, other)
    return larger <= SAME_SIZE * smaller and (larger - smaller) / 2 < apart_px < SAME_PLACE * larger


def encloses(outer: Ellipse, inner: Ellipse) -> bool:
    """The same rim or one inside it, roughly."""
    return (
        inner.semi_minor_px <= outer.semi_major_px
        and distance_px(outer, inner) + 0.5 * inner.semi_minor_px <= outer.semi_major_px
    )


def same_candidate(one: Round, other: Round) -> bool:
    """Two places that are so alike that measuring one of them is enough."""
    reach_px = 0.22 * min(one.radius_px, other.radius_px)
    return _within(one, other, reach_px) and 0.8 < one.radius_px / other.radius_px < 1.25


def _within(one: Centred, other: Centred, reach_px: float) -> bool:
    return abs(one.u_px - other.u_px) < reach_px and abs(one.v_px - other.v_px) < reach_px
