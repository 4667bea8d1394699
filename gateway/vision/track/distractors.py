"""Round red things that stood beside the marker are not the marker. Pure.

There is one marker in a bay. What the search found as red and as round in the very frame in which it measured the
marker (`weaker`, a tail lamp, a valve wheel) is something else, and stays so when the marker is covered and the other
is all that is left to be found. A bystander is known again where it was, for it may hang on the wall, or where it was
beside the marker, for it may come with the truck, nearer and larger as the marker does.

It is not held against it when the marker may have left the picture, when the marker is still seen beside it (then the
search has changed its mind, which it may: the thing followed first was perhaps the lamp), nor for longer than HELD_NS
after the marker was measured last.

Where the ranger's distance tells which radii are possible, what has another radius is not the marker, whether it stood
beside it or not (`size`).
"""

from collections.abc import Iterable
from dataclasses import dataclass

from gateway.core.model import Circle, Rejection
from gateway.vision.detect.geometry import same_circle

HELD_NS = 10_000_000_000
WEAKER = "weaker"  # the search's code for a candidate that passed every gate, beside a better one
SIZE = "size"  # and for one that passed all but that of the radii that the ranger's distance allows
RED_DISC = (WEAKER, SIZE)
ROOM = 1.1  # of its radius round the marker: with less to the picture's edge it may have driven out


@dataclass(frozen=True, slots=True)
class Bystanders:
    """Replaced with every measurement of the marker."""

    marker: Circle  # as measured last
    t_ns: int  # then
    others: tuple[Circle, ...] = ()  # as heard last
    beside: Circle | None = None  # the marker in that frame
    fitted: bool = False  # it has had a radius that the ranger's distance allows

    def with_measured(
        self, marker: Circle, t_ns: int, rejected: Iterable[Rejection], *, fits: bool = False
    ) -> "Bystanders":
        """`rejected`: of the same frame. A search in a window hears of nothing elsewhere: the old ones stay."""
        others = tuple(refused.circle for refused in rejected if refused.why in RED_DISC)
        if others:
            return Bystanders(marker, t_ns, others, marker, self.fitted or fits)
        return Bystanders(marker, t_ns, self.others, self.beside, self.fitted or fits)

    def holds(self, found: Circle, t_ns: int, rejected: Iterable[Rejection], width: int, height: int) -> bool:
        """Is `found` a bystander, left alone in the frame of `t_ns`, `width` x `height` px, by a covered marker?"""
        if not 0 <= t_ns - self.t_ns <= HELD_NS or not self._inside(width, height):
            return False
        if any(refused.why == WEAKER and same_circle(refused.circle, self.marker) for refused in rejected):
            return False
        return self.has(found)

    def refused_for_size(self, rejected: Iterable[Rejection]) -> Circle | None:
        """The thing followed, if this frame shows it and it has no radius that the marker can have."""
        return next((r.circle for r in rejected if r.why == SIZE and same_circle(r.circle, self.marker)), None)

    def wrong_size(self, rejected: Iterable[Rejection]) -> Circle | None:
        """The best red disc that was refused for its radius and is no bystander: the marker, for all one can see."""
        return next((r.circle for r in rejected if r.why == SIZE and not self.has(r.circle)), None)

    def has(self, found: Circle) -> bool:
        """Was it seen beside the marker, at whatever time?"""
        return any(same_circle(found, place) for other in self.others for place in self._places(other))

    def _places(self, other: Circle) -> Iterable[Circle]:
        yield other
        if self.beside is not None:
            grown = self.marker.radius_px / self.beside.radius_px
            u = self.marker.u_px + grown * (other.u_px - self.beside.u_px)
            v = self.marker.v_px + grown * (other.v_px - self.beside.v_px)
            yield Circle(u, v, grown * other.radius_px)

    def _inside(self, width: int, height: int) -> bool:
        m, room = self.marker, ROOM * self.marker.radius_px
        return room <= m.u_px <= width - 1 - room and room <= m.v_px <= height - 1 - room
