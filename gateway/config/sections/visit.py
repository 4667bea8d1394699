"""`[visit]`: when a truck counts as in place, how long that may be held, when it has moved or left. Pure."""

from pydantic import Field

from gateway.config.strict.section import Section


class VisitConfig(Section):
    """A truck's visit after D = 1: in place, held while the marker is covered, moved, gone (docs/visit.md)."""

    settle_s: float = Field(
        1.0, ge=0.1, le=60, description="in_place needs D = 1 and a standing truck (guidance.still_mm_s) for so long"
    )
    band_mm: float = Field(
        40.0, ge=5, le=1000, description="a Z that differs more from its value when in place came about: moved"
    )
    band_share: float = Field(
        0.35, ge=0.05, le=2, description="a centre or radius that differs more, as a share of R: the marker has moved"
    )
    hold_limit_s: float = Field(
        1800.0, ge=0, le=86_400, description="in_place is held by the ranger alone for so long at most; 0: never"
    )
    hold_grace_s: float = Field(
        0.5, ge=0, le=5, description="a contradiction, or a live ranger without a distance, ends in_place after so long"
    )
    leave_distance_mm: float | None = Field(
        None, ge=100, le=4000, description="a truck farther away than this has left; default: 700 mm beyond Z_th"
    )
    leave_s: float = Field(2.0, ge=0.1, le=600, description="the bay must be clear for so long before a visit is over")
