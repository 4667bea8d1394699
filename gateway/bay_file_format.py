"""The text of a bay file: what of a bay outlives a restart, as JSON. No IO but the log.

What this gateway never writes is refused: a file that was changed or cut counts as damaged (gateway/bay_file.py).
"""

import logging
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from gateway.config import BayConfig
from gateway.core.detection import Circle
from gateway.core.retained import RetainedState, RetainedTruck
from gateway.core.scale import MAX_VISITS, ScaleSample
from gateway.core.state import FunctionCheck, Moved, TruckPosition

log = logging.getLogger(__name__)

VERSION = 1
WITH_TRUCK = 2  # an older gateway, which would forget the truck, takes such a file for damaged: a function check
STRICT = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)
Length = Annotated[float, Field(gt=0, le=1e9)]
Coordinate = Annotated[float, Field(ge=-1e9, le=1e9)]
Pixels = Annotated[int, Field(gt=0)] | None


class _Visit(BaseModel):
    """One truck in place: gateway.core.scale.ScaleSample."""

    model_config = STRICT
    unix_s: int
    recipe: Annotated[int, Field(ge=0)]
    radius_px: Length
    distance_mm: Length


class _Place(BaseModel):
    """Where a truck was in place: gateway.core.state.TruckPosition."""

    model_config = STRICT
    distance_mm: Length
    u_px: Coordinate
    v_px: Coordinate
    radius_px: Length


class _Truck(BaseModel):
    """A truck that was in place and was not released: gateway.core.retained.RetainedTruck."""

    model_config = STRICT
    place: _Place | None
    moved: Literal["NO", "DISTANCE", "MARKER"]
    moved_covered: bool


class _BayFile(BaseModel):
    """The content of the file. `picture_px`: camera.width_px and height_px, visits and place hold for these only.
    `framing`: rotation and crop, the place holds for these only; empty: neither."""

    model_config = STRICT
    version: Annotated[int, Field(ge=VERSION, le=WITH_TRUCK)]
    function_check: Literal["OFF", "MAY_MOVE_OFF", "MAY_MOVE_KEPT"]
    picture_px: tuple[Pixels, Pixels]
    framing: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(max_length=5)] = ()
    visits: Annotated[tuple[_Visit, ...], Field(max_length=MAX_VISITS)]
    truck: _Truck | None = None

    @model_validator(mode="after")
    def _version_of_truck(self) -> Self:
        if (self.version == WITH_TRUCK) != (self.truck is not None):
            raise ValueError(f"version {WITH_TRUCK}, and no other, has a truck")
        return self


def decoded(data: bytes, bay: BayConfig) -> RetainedState:
    """The content of a bay file. Raises ValueError for one that this gateway has not written."""
    try:
        kept = _BayFile.model_validate_json(data)
    except ValidationError as error:
        wrong = error.errors(include_url=False)[0]
        raise ValueError(f"{'.'.join(map(str, wrong['loc'])) or 'file'}: {wrong['msg']}") from None
    same_pixels = kept.picture_px == (bay.camera.width_px, bay.camera.height_px)
    visits = kept.visits if same_pixels else ()
    if len(visits) < len(kept.visits):
        log.warning("%s: the picture size has changed: the learned R x Z is discarded", bay.name)
    return RetainedState(
        FunctionCheck[kept.function_check],
        tuple(ScaleSample(v.recipe, v.radius_px, v.distance_mm, unix_s=v.unix_s) for v in visits),
        None
        if kept.truck is None
        else _retained_truck(kept.truck, same_pixels=same_pixels and kept.framing == _framing(bay)),
    )


def _retained_truck(truck: _Truck, *, same_pixels: bool) -> RetainedTruck:
    at = truck.place if same_pixels else None
    place = None if at is None else TruckPosition(at.distance_mm, Circle(at.u_px, at.v_px, at.radius_px))
    return RetainedTruck(place, Moved[truck.moved], truck.moved_covered)


def _framing(bay: BayConfig) -> tuple[int, ...]:
    crop, rotation_deg = bay.camera.crop, bay.camera.rotation_deg
    if crop is None:
        return (rotation_deg,) if rotation_deg else ()
    return rotation_deg, crop.x_px, crop.y_px, crop.width_px, crop.height_px


def _kept_truck(truck: RetainedTruck) -> _Truck:
    place = None
    if truck.place is not None:
        at, circle = truck.place.distance_mm, truck.place.circle
        place = _Place(distance_mm=at, u_px=circle.u_px, v_px=circle.v_px, radius_px=circle.radius_px)
    return _Truck(place=place, moved=truck.moved.name, moved_covered=truck.moved_covered)


def encoded(retained: RetainedState, bay: BayConfig, offset_ns: int) -> bytes:
    """The file's text. `offset_ns`: Unix time minus monotonic time."""
    truck = retained.truck
    kept = _BayFile(
        version=VERSION if truck is None else WITH_TRUCK,
        function_check=retained.function_check.name,
        picture_px=(bay.camera.width_px, bay.camera.height_px),
        framing=() if truck is None else _framing(bay),
        visits=tuple(
            _Visit(unix_s=s.date_s(offset_ns), recipe=s.recipe, radius_px=s.radius_px, distance_mm=s.distance_mm)
            for s in retained.scale_samples
        ),
        truck=None if truck is None else _kept_truck(truck),
    )
    absent = {key for key in ("truck", "framing") if not getattr(kept, key)}  # an older version knows neither
    return kept.model_dump_json(indent=1, exclude=absent).encode() + b"\n"
