"""Tables of reports on a terminal."""

import sys

from rich import box
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from gateway.vision.offline.reports.tables import ReportTable

WIDTH = 124  # where the output is not a terminal
_STYLES = {"whole": "bold", "bad": "red", "faint": "dim"}


def console(width: int | None = None) -> Console:
    """`width` in characters, the terminal's by default."""
    return Console(width=width or (None if sys.stdout.isatty() else WIDTH), highlight=False)


def show(out: Console, table: ReportTable, columns: slice = slice(1, None), *, widest: int | None = None) -> None:
    """The first of the table's columns, at most `widest` characters of it, and those of `columns`."""
    shown = RichTable(title=table.title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    shown.collapse_padding = True
    shown.add_column(table.heads[0], no_wrap=True, max_width=widest)
    marks = {at: cell[1] for _, cells in table.rows for at, cell in enumerate(cells) if not isinstance(cell, str)}
    for at, head in list(enumerate(table.heads))[columns]:
        shown.add_column(head, justify="left" if marks.get(at) == "left" else "right", overflow="fold")
    following = [*(style for style, _ in table.rows), ""][1:]
    for (style, cells), after in zip(table.rows, following, strict=True):
        texts = [Text(cell) if isinstance(cell, str) else _marked(*cell) for cell in (cells[0], *cells[columns])]
        shown.add_row(*texts, style=_STYLES.get(style, ""), end_section=style in ("whole", "half") and after != style)
    out.print(shown)


def _marked(text: str, style: str) -> Text:
    return Text(text, style="bold red" if style == "bad" else "")
