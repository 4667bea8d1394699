"""Distractors: round red objects that were seen beside the marker, and so are not the marker. Pure.

A bay has one marker. A candidate that passed every gate in the frame in which the marker was measured (`weaker`: a tail
lamp, a valve wheel) is another object, and remains one when the marker is covered and it is the only red disc left.
A distractor is recognised where it was, for it may hang on the wall, or at the same place beside the marker, for it may
move with the truck, nearer and larger as the marker does.

A distractor is accepted as the marker when the marker may have left the picture, when the marker is still seen beside
it (then the search has changed its mind, and the tracked object was perhaps the lamp), and HELD_NS after the last
measurement of the marker.

With the radii that the ranger allows, a disc of another radius is not the marker, distractor or not (`size`).
"""

from collections.abc import Iterable
from dataclasses import dataclass

from gateway.core.detection import Circle, Rejection
from gateway.vision.detect.geometry import same_circle

HELD_NS = 10_000_000_000
WEAKER = "weaker"  # rejection code: passed every gate, beside a better candidate
SIZE = "size"  # rejection code: passed every gate but the radii that the ranger's distance allows
RED_DISC = (WEAKER, SIZE)
ROOM = 1.1  # of the marker's radius to the picture's edge: with less it may have left the picture


@dataclass(frozen=True, slots=True)
class Distractors:
    """Replaced with every measurement of the marker."""

    marker: Circle  # as measured last
    t_ns: int  # then
    others: tuple[Circle, ...] = ()  # as seen last
    beside: Circle | None = None  # the marker in that frame
    fitted: bool = False  # the marker has had a radius that the ranger's distance allows

    def updated(self, marker: Circle, t_ns: int, rejected: Iterable[Rejection], *, fits: bool = False) -> "Distractors":
        """`rejected`: of the same frame. A search in a window sees nothing elsewhere: the old ones are kept."""
        others = tuple(refused.circle for refused in rejected if refused.why in RED_DISC)
        if others:
            return Distractors(marker, t_ns, others, marker, self.fitted or fits)
        return Distractors(marker, t_ns, self.others, self.beside, self.fitted or fits)

    def holds(self, found: Circle, t_ns: int, rejected: Iterable[Rejection], width: int, height: int) -> bool:
        """Whether `found`, in the frame of `t_ns`, is a distractor beside a covered marker."""
        if not 0 <= t_ns - self.t_ns <= HELD_NS or not self._inside(width, height):
            return False
        if any(refused.why == WEAKER and same_circle(refused.circle, self.marker) for refused in rejected):
            return False
        return self.has(found)

    def refused_for_size(self, rejected: Iterable[Rejection]) -> Circle | None:
        """The tracked object, if this frame shows it with a radius that the marker cannot have."""
        return next((r.circle for r in rejected if r.why == SIZE and same_circle(r.circle, self.marker)), None)

    def wrong_size(self, rejected: Iterable[Rejection]) -> Circle | None:
        """The best red disc that was rejected for its radius and is not a distractor: presumably the marker."""
        return next((r.circle for r in rejected if r.why == SIZE and not self.has(r.circle)), None)

    def has(self, found: Circle) -> bool:
        """Whether it was seen beside the marker, at any time."""
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
