"""The tables of a report, for its page and for a terminal alike, and the numbers in them. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass

Cell = str | tuple[str, str]  # plain text, or with its style: "good", "bad", "left"
Row = tuple[str, Sequence[Cell]]  # its style: "whole", "half", "bad", "faint" or ""


@dataclass(frozen=True, slots=True)
class ReportTable:
    title: str
    heads: Sequence[str]
    rows: Sequence[Row]


def share(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.1f} %".replace("100.0", "100")


def percent(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.1f}"


def number(value: float | None) -> str:
    """Three significant digits, as far as they mean something."""
    if value is None:
        return "–"
    size = abs(value)
    return f"{value:.0f}" if size >= 100 else f"{value:.1f}" if size >= 10 else f"{value:.2f}"


def faults(count: int | None) -> Cell:
    """None: nothing in which there could be any."""
    return "–" if count is None else (str(count), "bad" if count else "good")
