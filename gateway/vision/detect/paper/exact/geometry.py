"""Where the red that survives the opening must show, and how far from there it can reach. Pure.

Write K = n (k - 1) + 1 and r = (K - 1) / 2 for a structuring element of side k (odd), n times. Opening with it n times
is opening with one square of side K, whatever the borders: pixels outside the picture take no part, and the picture is
convex. The opened mask is therefore a union of *boxes*: squares of side K cut to the picture, all red, whose middle
lies in the picture. All the shortcuts follow from these boxes.

1. Every box holds a point of any grid whose rows (and columns) begin at 0, are at most K apart, and end at the last
   or the last but one: a box that is not cut is K long, one that an edge cuts holds the edge and its neighbour. So: no
   red grid point, nothing survives. Stronger: the row of the box through that point is a horizontal run of red, K
   long, or r + 1 when cut by an edge.
2. A box reaches at most K - 1 from any of its points. So what survives lies within K - 1 of red grid points.
3. Closing joins two parts of the opened mask only if they are at most K apart (Chebyshev; both grow by r, and grown
   parts that don't touch, diagonally neither, can't hold a square of side K between them). Grid points of boxes that
   are at most K apart are at most 3 K - 2 apart in each axis. Points farther apart than that belong to different
   *clusters*, and no component of the closed mask has parts in two.
4. Closing leaves the box round a cluster only towards an edge of the picture that is at most r away.
5. In a window that reaches r + 1 beyond that box, erosion, with what is nearer than r to the window's own edges put to
   0, dilation and closing give the cluster's part of the mask exactly: nothing of it was put to 0 by 2; nothing else is
   in it by 3, but for parts of other clusters, which leave the box of 2 and 4 and are known by that.
6. The area of a contour is at most (width - 1) (height - 1) of the box round it. A cluster whose box has no more than
   S_min can't hold a candidate.

All of it holds for every K >= 3, any threshold, any blur. K = 1 opens nothing: then every red pixel counts.
"""

from dataclasses import dataclass
from typing import NamedTuple

from gateway.config import VisionConfig


class Box(NamedTuple):
    """Pixels x0 <= x < x1, y0 <= y < y1."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def pixels(self) -> int:
        return (self.x1 - self.x0) * (self.y1 - self.y0)

    @property
    def largest_contour_px2(self) -> int:
        """No contour inside has a larger area (6)."""
        return (self.x1 - self.x0 - 1) * (self.y1 - self.y0 - 1)

    def grown(self, by_px: int, width: int, height: int) -> "Box":
        """Cut to the picture."""
        return Box(
            max(0, self.x0 - by_px), max(0, self.y0 - by_px), min(width, self.x1 + by_px), min(height, self.y1 + by_px)
        )

    def joined(self, other: "Box") -> "Box":
        """Round both."""
        return Box(min(self.x0, other.x0), min(self.y0, other.y0), max(self.x1, other.x1), max(self.y1, other.y1))

    def meets(self, other: "Box") -> bool:
        return self.x0 < other.x1 and other.x0 < self.x1 and self.y0 < other.y1 and other.y0 < self.y1

    def holds(self, other: "Box") -> bool:
        return self.x0 <= other.x0 and self.y0 <= other.y0 and other.x1 <= self.x1 and other.y1 <= self.y1

    def farthest_side(self, other: "Box") -> int:
        """The largest distance between a side of this and the same side of the other, px."""
        pairs = ((self.x0, other.x0), (self.y0, other.y0), (self.x1, other.x1), (self.y1, other.y1))
        return max(abs(a - b) for a, b in pairs)


@dataclass(frozen=True, slots=True)
class Opening:
    """The square that is equivalent to the complete opening: side K, reach r."""

    side_px: int

    @classmethod
    def of(cls, params: VisionConfig) -> "Opening":
        return cls(params.morph_iterations * (params.morph_kernel_px - 1) + 1)

    @property
    def reach_px(self) -> int:
        return self.side_px // 2

    @property
    def uncut_px(self) -> int:
        """Pixels at least so far inside a window's own edges are exactly those of the full frame.

        The window's edge spoils the erosion to r, and each of the three steps after it r farther; one more, so that
        the ring of 0 round a component is known, too.
        """
        return 4 * self.reach_px + 1

    def cluster_box(self, cells: Box, width: int, height: int) -> Box:
        """All that can follow from red grid points whose outermost are the corners of `cells` (2 and 4)."""
        box = cells.grown(self.side_px - 1, width, height)
        r = self.reach_px
        return Box(
            0 if box.x0 <= r else box.x0,
            0 if box.y0 <= r else box.y0,
            width if box.x1 >= width - r else box.x1,
            height if box.y1 >= height - r else box.y1,
        )

    def window(self, box: Box, width: int, height: int) -> Box:
        """The pixels that must be processed for an exact result in `box` (5)."""
        return box.grown(self.reach_px + 1, width, height)
