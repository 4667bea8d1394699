"""The tables of `gateway evaluate` on a terminal."""

import sys
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from gateway.vision.evaluation.report import ALL_FRAMES, number, share
from gateway.vision.evaluation.result import Result
from gateway.vision.evaluation.scoring import Figures

WIDTH = 132  # where the output is no terminal
_COLUMNS = (
    "pictures", "detected", "within 5 %", "wrong", "missed", "false",
    "centre px", "p95", "radius %", "p95", "bias", "ms",
)  # fmt: skip


def show(results: Sequence[Result]) -> None:
    """Prints everything that was measured of every method."""
    console = Console() if sys.stdout.isatty() else Console(width=WIDTH)
    for result in results:
        console.print(_parts(result))
        if result.sequences:
            console.print(_sequences(result))
        if result.constancy:
            console.print(_constancy(result))
        if result.whole.vague_labels:
            n = result.whole.vague_labels
            console.print(f"{n} of the labels may themselves be off by more than 5 % of R (tol_px)")
    console.print("centre and radius: median, p95 and bias of the answers on the target", style="dim")


def _parts(result: Result) -> Table:
    table = Table(title=f"Method {result.method}", title_justify="left")
    table.add_column("part")
    for column in _COLUMNS:
        table.add_column(column, justify="right")
    table.add_row("whole set", *_row(result.whole), style="bold", end_section=True)
    for n, (name, part) in enumerate(result.halves.items(), start=1):
        table.add_row(name, *_row(part), end_section=n == len(result.halves))
    for name, part in result.groups.items():
        table.add_row(Text(name), *_row(part))
    return table


def _row(f: Figures) -> list[str | Text]:
    marked = f.with_marker > 0
    return [
        str(f.pictures),
        share(f.detected_share),
        share(f.close_share),
        _alarm(f.wrong) if marked else "–",
        str(f.missed) if marked else "–",
        _alarm(f.false) if f.without else "–",
        number(f.centre_median_px),
        number(f.centre_p95_px),
        number(f.radius_median_pct),
        number(f.radius_p95_pct),
        number(f.radius_bias_pct),
        number(f.ms_median),
    ]


def _alarm(count: int) -> Text:
    return Text(str(count), style="bold red" if count else "")


def _sequences(result: Result) -> Table:
    table = Table(title=f"Followed from frame to frame, method {result.method}", title_justify="left")
    table.add_column("sequence")
    for column in ("frames", "acquired after", "detected since", "within 5 %", "wrong", "coasted", "centre p95 px"):
        table.add_column(column, justify="right")
    for found in result.sequences:
        name = Text(found.series or ALL_FRAMES)
        if found.after is None:
            table.add_row(name, str(found.frames), Text("never", style="bold red"), *["–"] * 5)
            continue
        f = found.after
        rates = (share(f.detected_share), share(f.close_share), _alarm(f.wrong), str(f.coasted))
        table.add_row(name, str(found.frames), f"{found.acquired_after} frames", *rates, number(f.centre_p95_px))
    return table


def _constancy(result: Result) -> Table:
    table = Table(title=f"R times Z, method {result.method}: deviation from the median, %", title_justify="left")
    table.add_column("series")
    for column in (
        "pictures",
        "R Z px cm",
        "typical",
        "largest",
        "of the labels",
        "best offset of Z",
        "largest with it",
    ):
        table.add_column(column, justify="right")
    for part in result.constancy:
        shift = "–" if part.offset_cm is None else f"{part.offset_cm:+.1f} cm"
        row = (str(part.pictures), f"{part.median_px_cm:.0f}", f"{part.typical_pct:.2f}", f"{part.largest_pct:.2f}")
        rest = (f"{part.label_largest_pct:.2f}", shift, number(part.largest_with_offset_pct))
        table.add_row(Text(part.series or "(all)"), *row, *rest)
    return table
