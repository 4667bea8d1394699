"""The control step's own `replace` makes what the standard library's makes."""

import dataclasses
from dataclasses import dataclass, field
from typing import Any

import pytest

from gateway.core.plc import Handshake
from gateway.core.state import Fused, FusionMemory, Guidance, StateVector, Visit
from gateway.replacing import replace


@pytest.mark.parametrize("record", [StateVector("bay1"), FusionMemory(), Visit(), Handshake(), Fused(), Guidance()])
def test_each_field_is_replaced_and_no_other(record: Any) -> None:
    assert replace(record) == record
    for one in dataclasses.fields(record):
        new = replace(record, **{one.name: "new"})
        assert new == dataclasses.replace(record, **{one.name: "new"})
        assert getattr(new, one.name) == "new"
    assert record == type(record)(**({"bay": "bay1"} if isinstance(record, StateVector) else {}))


def test_a_field_that_is_not_there() -> None:
    with pytest.raises(KeyError, match="colour"):
        replace(Guidance(), colour="red")  # type: ignore[call-arg]


def test_what_is_checked_at_a_begin_is_checked_again() -> None:
    @dataclass(frozen=True)
    class Pair:
        low: int
        high: int

        def __post_init__(self) -> None:
            if self.low > self.high:
                raise ValueError("low > high")

    with pytest.raises(ValueError, match="low > high"):
        replace(Pair(1, 2), low=3)


@dataclass(frozen=True)
class OneField:
    a: int


@dataclass(frozen=True, kw_only=True)
class ByName:
    a: int
    b: int


@dataclass(frozen=True)
class Made:
    a: int
    b: int = field(init=False, default=3)


@pytest.mark.parametrize("record", [OneField(1), ByName(a=1, b=2), Made(1)])
def test_records_of_another_form_are_refused(record: Any) -> None:
    with pytest.raises(TypeError, match="dataclasses"):
        replace(record, a=2)
