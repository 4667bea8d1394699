"""The tables of `gateway evaluate` on a terminal."""

import sys
from collections.abc import Callable, Sequence

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from gateway.vision.offline.evaluation.report import ALL_FRAMES, number
from gateway.vision.offline.evaluation.result import Result
from gateway.vision.offline.evaluation.scoring import Figures

WIDTH = 124  # where the output is no terminal
_ONE_TABLE = 122  # a narrower terminal gets two

_Cell = str | Text
_RATES: tuple[tuple[str, Callable[[Figures], _Cell]], ...] = (
    ("pictures", lambda f: str(f.pictures)),
    ("found %", lambda f: _percent(f.detected_share)),
    ("in 5 %", lambda f: _percent(f.close_share)),
    ("wrong", lambda f: _alarm(f.wrong) if f.with_marker else "–"),
    ("missed", lambda f: str(f.missed) if f.with_marker else "–"),
    ("false", lambda f: _alarm(f.false) if f.without else "–"),
)
_ERRORS: tuple[tuple[str, Callable[[Figures], _Cell]], ...] = (
    ("centre px", lambda f: number(f.centre_median_px)),
    ("p95", lambda f: number(f.centre_p95_px)),
    ("radius %", lambda f: number(f.radius_median_pct)),
    ("p95", lambda f: number(f.radius_p95_pct)),
    ("bias", lambda f: number(f.radius_bias_pct)),
    ("ms", lambda f: number(f.ms_median)),
)


def show(results: Sequence[Result], width: int | None = None) -> None:
    """Prints everything that was measured of every method; `width` in characters, the terminal's by default."""
    console = Console(width=width) if width or sys.stdout.isatty() else Console(width=WIDTH)
    for result in results:
        for columns in (_RATES + _ERRORS,) if console.width >= _ONE_TABLE else (_RATES, _ERRORS):
            console.print(_parts(result, columns))
        if result.sequences:
            console.print(_sequences(result))
        if result.constancy:
            console.print(_constancy(result))
        if result.whole.vague_labels:
            n = result.whole.vague_labels
            console.print(f"{n} of the labels may themselves be off by more than 5 % of R (tol_px)")
    console.print("centre and radius: median, p95 and bias of the answers on the target", style="dim")


def _parts(result: Result, columns: Sequence[tuple[str, Callable[[Figures], _Cell]]]) -> Table:
    table = _table(f"Method {result.method}", "part", *(name for name, _ in columns))

    def add(name: str, part: Figures, style: str = "", *, last: bool = False) -> None:
        table.add_row(Text(name), *(cell(part) for _, cell in columns), style=style, end_section=last)

    add("whole set", result.whole, "bold", last=True)
    for n, (name, part) in enumerate(result.halves.items(), start=1):
        add(name, part, last=n == len(result.halves))
    for name, part in result.groups.items():
        add(name, part)
    return table


def _table(title: str, first: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column(first, no_wrap=True, max_width=22)
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    return table


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.1f}"


def _alarm(count: int) -> Text:
    return Text(str(count), style="bold red" if count else "")


def _sequences(result: Result) -> Table:
    columns = ("frames", "after", "found %", "in 5 %", "wrong", "coasted", "p95 px")
    table = _table(
        f"Followed from frame to frame, method {result.method}: since the first on target", "sequence", *columns
    )
    for found in result.sequences:
        name = Text(found.series or ALL_FRAMES)
        if found.after is None:
            table.add_row(name, str(found.frames), Text("never", style="bold red"), *["–"] * 5)
            continue
        f = found.after
        rates = (_percent(f.detected_share), _percent(f.close_share), _alarm(f.wrong), str(f.coasted))
        table.add_row(name, str(found.frames), str(found.acquired_after), *rates, number(f.centre_p95_px))
    return table


def _constancy(result: Result) -> Table:
    columns = ("pictures", "px cm", "typical", "largest", "labels", "offset cm", "with it")
    table = _table(f"R times Z, method {result.method}: deviation from the median, %", "series", *columns)
    for part in result.constancy:
        shift = "–" if part.offset_cm is None else f"{part.offset_cm:+.1f}"
        row = (str(part.pictures), f"{part.median_px_cm:.0f}", f"{part.typical_pct:.2f}", f"{part.largest_pct:.2f}")
        rest = (f"{part.label_largest_pct:.2f}", shift, number(part.largest_with_offset_pct))
        table.add_row(Text(part.series or "(all)"), *row, *rest)
    return table
