"""Enumerations whose members say what they mean: `NAME = value, "meaning"`. Pure."""

from enum import IntEnum, StrEnum
from typing import Self


class ExplainedInt(IntEnum):
    """A number and its meaning."""

    _value_: int
    meaning: str

    def __new__(cls, value: int, meaning: str = "") -> Self:  # a value alone looks a member up, and does not come here
        if not meaning:
            raise TypeError(f"{cls.__name__}, {value!r}: without a meaning")
        member = int.__new__(cls, value)
        member._value_, member.meaning = value, meaning
        return member

    @classmethod
    def meanings(cls) -> dict[Self, str]:
        return {member: member.meaning for member in cls}


class ExplainedStr(StrEnum):
    """A name and its meaning."""

    _value_: str
    meaning: str

    def __new__(cls, value: str, meaning: str = "") -> Self:  # a value alone looks a member up, and does not come here
        if not meaning:
            raise TypeError(f"{cls.__name__}, {value!r}: without a meaning")
        member = str.__new__(cls, value)
        member._value_, member.meaning = value, meaning
        return member

    @classmethod
    def meanings(cls) -> dict[Self, str]:
        return {member: member.meaning for member in cls}
